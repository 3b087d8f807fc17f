"""A study: its trials, and the collection of their results.

Besides the files of every `ScanSeries`, its folder holds:

OUT/results.parquet    all rows by trial number (without clock times: equal for equal seeds)
OUT/timings.parquet    seconds by station, processor time, worker and memory of every trial
OUT/study.json, report.html
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from scancell.config.study import StudyDescription, load_study
from scancell.errors import DescriptionError, OutputError
from scancell.extras import require
from scancell.files import read_json
from scancell.stopwatch import Stopwatch
from scancell.studies.designs import trial_seed
from scancell.studies.engine import OpenWorker, Task, chunks
from scancell.studies.factors import nominal_setup
from scancell.studies.run_record import DESCRIPTION
from scancell.studies.scan_worker import Trial, trial_of
from scancell.studies.series import ScanSeries
from scancell.studies.trial import ROWS, TIMINGS, TrialWorker, open_trials

# Number of the trial whose seed all trials have with noise = "common"; the trials themselves count from 1.
_COMMON_SEED_TRIAL = 0


@dataclass(frozen=True)
class Study(ScanSeries):
    """A checked study file with the descriptions that it names."""

    description: StudyDescription
    part: Path

    kind = "study"
    unit = "task"
    folder = "tasks"

    @property
    def open_worker(self) -> OpenWorker:
        """Prepares a worker process from `spec`."""
        return open_trials

    @cached_property
    def trials(self) -> list[Trial]:
        """All trials of the design, and after them those that are repeated with rendered camera images."""
        described = self.description
        values = self.factors.draw()
        count = len(values)
        if described.ray_traced_trials > count:
            raise DescriptionError(
                f"the design has {count} trials",
                file=self.source,
                key="ray_traced_trials",
                value=described.ray_traced_trials,
            )
        trials = [Trial(n, self._seed(n), described.engine, row) for n, row in enumerate(values, 1)]
        again = trials[: described.ray_traced_trials]
        return trials + [Trial(count + trial.number, trial.seed, "ray-traced", trial.values) for trial in again]

    def _seed(self, trial: int) -> int:
        common = self.description.noise == "common"
        return trial_seed(self.description.seed, _COMMON_SEED_TRIAL if common else trial)

    def _inputs(self) -> dict[str, str]:
        return {"part": str(self.part)}

    def worker(self) -> TrialWorker:
        """A worker in this process."""
        return TrialWorker(self.description, self.setup, self.part)

    def check(self) -> None:
        """Also requires what the report needs, before hours of scans."""
        for package in ("jinja2", "matplotlib"):
            require(package, "studies")
        super().check()

    @cached_property
    def tasks(self) -> list[Task]:
        """The trials, `trials_per_task` in each task."""
        plain = [{**asdict(trial), "values": list(trial.values)} for trial in self.trials]
        size = self.description.trials_per_task
        return [Task(f"trial-{group[0] + 1:07d}", [plain[n] for n in group]) for group in chunks(len(plain), size)]


def open_study(path: Path, settings: Sequence[str] = ()) -> Study:
    """Read a study and the files that it names, and refuse errors before any trial runs.

    Raises
    ------
    ScancellError
        Naming file, key, value and what was expected.
    """
    description = load_study(path, settings)
    setup = nominal_setup(description, path.parent, str(path))
    part = (path.parent / description.part).resolve()
    if not part.is_file():
        raise DescriptionError(f"no such file ({part})", file=path, key="part", value=description.part)
    return Study(str(path), description, setup, part)


def begin_new(study: Study, out: Path) -> None:
    """Claim an empty folder for a study.

    Raises
    ------
    OutputError
        If the folder holds a study already, or cannot be written.
    """
    if (out / DESCRIPTION).exists():
        raise OutputError("holds a study already; `study resume` continues it, `out` names another folder", file=out)
    study.begin(out)


def replay(study: Study, number: int) -> tuple[dict[str, Any], Stopwatch]:
    """Run a single trial in this process; its row has the same bytes as in the study.

    Raises
    ------
    DescriptionError
        If there is no such trial.
    """
    if not 1 <= number <= len(study.trials):
        raise DescriptionError(
            f"{study.source} has trials 1 to {len(study.trials)}",
            key="trial",
            value=number,
            expected=f"1 to {len(study.trials)}",
        )
    watch = Stopwatch()
    with closing(study.worker()) as worker:
        return worker.row(study.trials[number - 1], watch), watch


@dataclass(frozen=True)
class Collected:
    """Rows and timings of the finished trials, by number, and the trials that are missing."""

    rows: list[dict[str, Any]]
    timings: list[dict[str, Any]]
    missing: list[Trial]


def collect(study: Study, out: Path, failed: Mapping[str, str] | None = None) -> Collected:
    """Read the finished trials. Those of `failed` tasks (by name, with their message) get rows that say so."""
    rows: list[dict[str, Any]] = []
    timings: list[dict[str, Any]] = []
    missing: list[Trial] = []
    for task, folder in study.results(out):
        if folder is not None:
            rows.extend(read_json(folder / ROWS))
            timings.extend(read_json(folder / TIMINGS))
        elif failed and task.name in failed:
            outcome = {"status": "failed", "message": failed[task.name], "figures": {}}
            rows.extend({**plain, **outcome} for plain in task.payload)
        else:
            missing.extend(trial_of(plain) for plain in task.payload)
    return Collected(rows, timings, missing)
