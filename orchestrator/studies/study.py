"""A study from its file to its folder: `study.toml` as given, tasks, rows, and what they say.

OUT/description.json   everything that decides the results, after defaults; resuming demands that it says the same
OUT/tasks/             rows of finished trials, one folder per task
OUT/results.parquet    all rows by trial number (no clock in it: equal for equal seeds)
OUT/timings.parquet    seconds by station, processor time, worker and memory of every trial
OUT/study.json, report.html
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from orchestrator.config.loading import Setup
from orchestrator.config.study import StudyDescription, load_study
from orchestrator.errors import DescriptionError, OutputError
from orchestrator.evaluation.manifest import named_files
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.progress import Progress
from orchestrator.studies.designs import trial_seed
from orchestrator.studies.engine import Announce, RunOutcome, chunks, run_tasks
from orchestrator.studies.factors import SETUP_KEYS, Factors, nominal_setup
from orchestrator.studies.run_record import (
    DESCRIPTION,
    FILES,
    Comparison,
    checksums,
    compare_with_record,
    plain_terms,
    recorded_terms,
    write_record,
)
from orchestrator.studies.scan_worker import Trial, sweep_temporary, trial_of
from orchestrator.studies.task import Job, Task, Where, request_digest
from orchestrator.studies.trial import ROWS, TIMINGS, TrialWorker, open_trials

# Numbered shares of the random numbers; the trials of a study count from 1.
_COMMON_SEED_TRIAL = 0
_RESOLVED = frozenset(f"study.{key}" for key in SETUP_KEYS)
# The part is told by what its file holds, not by how the study names it.
_APART = _RESOLVED | {"study.part"}


@dataclass(frozen=True)
class Study:
    """A checked study file with the descriptions that it names."""

    source: Path
    description: StudyDescription
    setup: Setup
    part: Path

    @cached_property
    def factors(self) -> Factors:
        """What varies."""
        return Factors(self.description, self.setup, str(self.source))

    @cached_property
    def trials(self) -> list[Trial]:
        """All trials of the design, and after them those that are made a second time with images."""
        described = self.description
        values = self.factors.draw()
        count = len(values)
        if described.ray_traced_trials > count:
            raise DescriptionError(
                f"{self.source}: ray_traced_trials = {described.ray_traced_trials}: the design has {count} trials"
            )
        trials = [Trial(n, self._seed(n), described.engine, row) for n, row in enumerate(values, 1)]
        again = trials[: described.ray_traced_trials]
        return trials + [Trial(count + trial.number, trial.seed, "ray-traced", trial.values) for trial in again]

    def _seed(self, trial: int) -> int:
        common = self.description.noise == "common"
        return trial_seed(self.description.seed, _COMMON_SEED_TRIAL if common else trial)

    @cached_property
    def asked(self) -> dict[str, Any]:
        """Everything that decides the results."""
        files = checksums([self.part, *named_files(self.setup), *self.factors.files])
        return {"study": self.description, "setup": vars(self.setup), "part": str(self.part), FILES: files}

    @cached_property
    def spec(self) -> dict[str, Any]:
        """Plain data from which a worker on any node prepares itself (the files are on a disk that all nodes see)."""
        return plain_terms(self.asked, _RESOLVED)

    def job(self, out: Path) -> Job:
        """The study as work for the engine, in the folder `out` that it was begun in."""
        request = request_digest(open_trials, recorded_terms(out))
        return Job(out.absolute() / "tasks", open_trials, self.spec, request)

    @cached_property
    def tasks(self) -> list[Task]:
        """The trials in tasks of so many as the study says."""
        plain = [{**asdict(trial), "values": list(trial.values)} for trial in self.trials]
        size = self.description.trials_per_task
        return [Task(f"trial-{group[0] + 1:07d}", [plain[n] for n in group]) for group in chunks(len(plain), size)]


def open_study(path: Path, overrides: Sequence[str] = ()) -> Study:
    """Read a study and all that it names, and refuse what is wrong before anything runs.

    Raises
    ------
    ScancellError
        Naming file, key, value and what was expected.
    """
    description = load_study(path, overrides)
    setup = nominal_setup(description, path.parent, str(path))
    study = Study(path, description, setup, (path.parent / description.part).resolve())
    if not study.part.is_file():
        raise DescriptionError(f"{path}: part = {description.part!r}: no such file ({study.part})")
    return study


def check_study(study: Study) -> None:
    """Refuse factors that the cell does not have; needs the cell's FMU, and so a second.

    Raises
    ------
    ScancellError
        Naming file, factor, value and what was expected.
    """
    with closing(TrialWorker(study.description, study.setup, study.part)) as worker:
        study.factors.check(worker.units())


def begin(study: Study, out: Path, join: bool = False) -> None:
    """Claim an empty folder for a study; with `join` another process may have done so already.

    Raises
    ------
    OutputError
        If the folder holds a study already, or cannot be written.
    """
    if (out / DESCRIPTION).exists():
        if join:
            return
        raise OutputError(f"{out}: holds a study already; `study resume` goes on with it, --out names another folder")
    write_record(study.spec, out)


def check_same(study: Study, out: Path) -> Comparison:
    """Refuse to go on in a folder whose results answer another question.

    Raises
    ------
    DescriptionError
        Naming the keys that differ.
    """
    try:
        found = compare_with_record(study.asked, _APART, out)
    except FileNotFoundError:
        raise DescriptionError(f"{out}: holds no study; `study run` begins one") from None
    if found.differences:
        raise DescriptionError(f"{study.source}: differs from the study in {found.record}: {found}")
    return found


def run_study(study: Study, out: Path, where: Where, progress: Progress, announce: Announce = None) -> RunOutcome:
    """Make all trials that are not there yet, see `run_tasks`."""
    try:
        return run_tasks(study.job(out), study.tasks, where, progress, "task", announce)
    finally:
        sweep_temporary()


def replay(study: Study, number: int) -> tuple[dict[str, Any], Stopwatch]:
    """Make a single trial again, here and now; its row has the same bytes as in the study.

    Raises
    ------
    DescriptionError
        If there is no such trial.
    """
    if not 1 <= number <= len(study.trials):
        raise DescriptionError(f"--trial {number}: {study.source} has trials 1 to {len(study.trials)}")
    watch = Stopwatch()
    with closing(TrialWorker(study.description, study.setup, study.part)) as worker:
        return worker.row(study.trials[number - 1], watch), watch


@dataclass(frozen=True)
class Collected:
    """Rows and timings of the finished trials, by number, and messages of the tasks that have none."""

    rows: list[dict[str, Any]]
    timings: list[dict[str, Any]]
    missing: list[Trial]


def collect(study: Study, out: Path, failed: Mapping[str, str] | None = None) -> Collected:
    """Read what the workers left. Trials of `failed` tasks (by name, with their message) become rows that say so."""
    job = study.job(out)
    rows: list[dict[str, Any]] = []
    timings: list[dict[str, Any]] = []
    missing: list[Trial] = []
    for task in study.tasks:
        if job.store.holds(task.name, job.digest_of_task(task)):
            folder = job.store.path(task.name)
            rows.extend(json.loads((folder / ROWS).read_text()))
            timings.extend(json.loads((folder / TIMINGS).read_text()))
        elif failed and task.name in failed:
            said = {"status": "failed", "message": failed[task.name], "figures": {}}
            rows.extend({**plain, **said} for plain in task.payload)
        else:
            missing.extend(trial_of(plain) for plain in task.payload)
    return Collected(rows, timings, missing)
