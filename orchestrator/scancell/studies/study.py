"""A study: its trials, and the collection of their results.

Besides the files of every `ScanSeries`, its folder holds:

OUT/results.parquet    all rows by trial number (without clock times: equal for equal seeds)
OUT/timings.parquet    seconds by station, processor time, worker and memory of every trial
OUT/study.json, report.html
"""

from __future__ import annotations

import json
import os
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from scancell.calibration.cell.report import CalibrationReport
from scancell.config.description import to_si, validate
from scancell.config.loading import Setup
from scancell.config.study import FittedSphereDescription, StudyDescription, VaryingScansDescription, load_study
from scancell.errors import DescriptionError, FitError, OutputError, require
from scancell.files import read_json, split_solids
from scancell.geometry.fits import fit_sphere
from scancell.nominal.parts import load_part
from scancell.output.run_folder import build_version, named_files
from scancell.progress import Progress, Stopwatch
from scancell.reconstruction.cloud import Cloud
from scancell.results import ScanResult
from scancell.studies.engine import (
    Announce,
    ExecutionTarget,
    Job,
    OpenWorker,
    RunOutcome,
    ScanWorker,
    Task,
    Trial,
    chunks,
    disk_error,
    request_digest,
    run_tasks,
    sweep_temporary,
    trial_of,
)
from scancell.studies.factors import SETUP_KEYS, Factors, checked_sections, nominal_setup, trial_seed
from scancell.studies.run_record import (
    DESCRIPTION,
    FILES,
    Comparison,
    checksums,
    compare_with_record,
    plain_terms,
    recorded_terms,
    write_record,
)
from scancell.visibility import MeasurableSurface, cache_folder, measurable_surface

ROWS = "rows.json"
TIMINGS = "timings.json"

_SPHERE_FIGURES = ("x_um", "y_um", "z_um", "diameter_error_um", "form_um", "rms_um")
_LEAST_POINTS = 10  # for the figures of a sphere
_FORM_QUANTILES = (0.025, 0.975)  # 95 % of the points, against outliers of a noisy cloud

# Designs whose first trials stay the same when `design.trials` grows.
EXTENDABLE = ("monte_carlo", "sobol")

# Number of the trial whose seed all trials have with noise = "common"; the trials themselves count from 1.
_COMMON_SEED_TRIAL = 0


class TrialWorker(ScanWorker):
    """Runs trials of one study in this process."""

    def __init__(self, study: StudyDescription, setup: Setup, part: Path) -> None:
        super().__init__(study, setup, load_part(part, study.unit), study.name)
        self._study = study

    @cached_property
    def _measurable(self) -> MeasurableSurface:
        """Measurable surface in the nominal cell of the study: the denominator of coverage in all trials."""
        return measurable_surface(self.nominal, self.setup.sensor, cache=cache_folder(), threads=1)

    def __call__(self, payload: Sequence[Mapping[str, Any]], folder: Path) -> None:
        """Make the trials of a task and write their rows and their timings into `folder`."""
        rows, timings = [], []
        for plain in payload:
            watch, start = Stopwatch(), time.process_time()
            rows.append(self.row(trial_of(plain), watch))
            spent = time.process_time() - start
            timings.append({"trial": plain["number"], **_process(), "processor_s": spent, "seconds": watch.seconds})
        (folder / ROWS).write_text(json.dumps(rows, indent=1, allow_nan=False) + "\n")
        (folder / TIMINGS).write_text(json.dumps(timings, indent=1) + "\n")

    def row(self, trial: Trial, watch: Stopwatch) -> dict[str, Any]:
        """Figures of a trial, or the message of its failure."""
        plain = {**asdict(trial), "values": list(trial.values)}
        try:
            with watch.measure("all"):
                figures = self._trial(trial, watch)
        except Exception as error:  # a trial that fails is a result, too; the others go on
            if disk_error(error):
                raise
            return {**plain, "status": "failed", "message": f"{type(error).__name__}: {error}", "figures": {}}
        return {**plain, "status": "ok", "message": "", "figures": figures}

    def _trial(self, trial: Trial, watch: Stopwatch) -> dict[str, Any]:
        """Figures of the scan, and of a calibration before it where the study has one."""
        figures, estimated = {}, None
        if self._study.calibrate is not None:
            with watch.measure("calibrate"):
                report = self.calibrated(trial, self._study.calibrate)
            figures, estimated = calibration_figures(report), report.estimated
        scan = self.scan(trial, estimated=estimated)
        figures = {**self._figures(scan), **figures}
        watch.seconds.update(scan.timings)
        return figures

    def _figures(self, scan: ScanResult) -> dict[str, Any]:
        figures = deviation_figures(scan)
        if self._study.coverage_samples:
            covered = scan.coverage_of(self._study.coverage_samples, self._measurable).fraction
            figures["coverage"] = None if np.isnan(covered) else covered
        for sphere in self._study.sphere:
            figures.update(_sphere_figures(sphere, scan.cloud))
        return figures


def deviation_figures(scan: ScanResult) -> dict[str, Any]:
    """Numbers of profiles and points, and the deviation from the mesh in um."""
    in_um = {name: value for name, value in scan.deviation.figures.as_um().items() if name != "count"}
    return {"profiles": len(scan.recording), "points": len(scan.cloud), **in_um}


def calibration_figures(report: CalibrationReport) -> dict[str, Any]:
    """Errors of the deviations that were found, and the half widths of their intervals, by name and unit."""
    figures: dict[str, Any] = {"calibration.rms_um": 1e6 * report.result.rms}
    for row in report.rows:
        figures[f"calibration.{row.name}_error_{row.unit}"] = row.error
        figures[f"calibration.{row.name}_half_width_{row.unit}"] = row.half_width
    return figures


def open_trials(spec: Mapping[str, Any]) -> TrialWorker:
    """A worker from plain data, see `Study.spec`."""
    sweep_temporary()
    study = validate(StudyDescription, spec["study"], "study")
    return TrialWorker(study, Setup(**checked_sections(spec["setup"])), Path(spec["part"]))


def _sphere_figures(description: FittedSphereDescription, cloud: Cloud) -> dict[str, Any]:
    """Displacement of the centre, error of the diameter, form and rms in um of the points near a nominal sphere."""
    si = to_si(description.model_dump(exclude={"name"}))
    lowest = -np.inf if si["above"] is None else si["above"]
    centre, points = np.array(si["centre"]), cloud.points_in_part
    near = np.abs(np.linalg.norm(points - centre, axis=1) - si["radius"]) <= si["reach"]
    chosen = points[near & (points[:, 2] >= lowest)]
    values = np.full(len(_SPHERE_FIGURES), np.nan)
    if len(chosen) >= _LEAST_POINTS:
        with suppress(FitError):
            found = fit_sphere(chosen)
            form = np.ptp(np.quantile(found.residuals, _FORM_QUANTILES))
            values = 1e6 * np.array([*(found.centre - centre), 2 * (found.radius - si["radius"]), form, found.rms])
    named = dict(zip(_SPHERE_FIGURES, values.tolist(), strict=True))
    plain = {"points": len(chosen), **{key: None if np.isnan(value) else value for key, value in named.items()}}
    return {f"{description.name}.{key}": value for key, value in plain.items()}


def _process() -> dict[str, Any]:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    memory_mb = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    return {
        "host": socket.gethostname(),
        "worker": os.getpid(),
        "memory_mb": memory_mb,
        "scancell": build_version(),
    }


@dataclass(frozen=True)
class ScanSeries(ABC):
    """A checked description with the nominal setup that it names; messages call the description `source`."""

    source: str
    description: VaryingScansDescription
    setup: Setup

    kind: ClassVar[str]
    unit: ClassVar[str]  # of progress
    folder: ClassVar[str]  # of the finished tasks, in the folder of the results

    @property
    @abstractmethod
    def open_worker(self) -> OpenWorker:
        """Prepares a worker process from `spec`."""

    @property
    @abstractmethod
    def tasks(self) -> list[Task]:
        """All scans, in tasks."""

    @abstractmethod
    def worker(self) -> ScanWorker:
        """A worker in this process."""

    def _inputs(self) -> dict[str, str]:
        """Paths of input files besides those that the setup and the factors name, by what they are."""
        return {}

    @property
    def ignored_keys(self) -> frozenset[str]:
        """Keys of `request` that leave finished results valid; input files are compared by content, not by path."""
        return self._unrecorded | {f"{self.kind}.{name}" for name in self._inputs()}

    @property
    def _unrecorded(self) -> frozenset[str]:
        """Keys that took effect in the setup, and the number of trials where more of them can follow."""
        keys = [*SETUP_KEYS, *(["design.trials"] if self.description.design.kind in EXTENDABLE else [])]
        return frozenset(f"{self.kind}.{key}" for key in keys)

    @cached_property
    def factors(self) -> Factors:
        """Factors of the description."""
        return Factors(self.description, self.setup, self.source)

    @cached_property
    def request(self) -> dict[str, Any]:
        """Everything that decides the results."""
        inputs = self._inputs()
        files = checksums([*inputs.values(), *named_files(self.setup), *self.factors.files])
        return {self.kind: self.description, "setup": vars(self.setup), **inputs, FILES: files}

    @cached_property
    def spec(self) -> dict[str, Any]:
        """Plain data from which a worker on any node prepares itself (the files are on a disk that all nodes see)."""
        return plain_terms(self.request, frozenset(f"{self.kind}.{key}" for key in SETUP_KEYS))

    def job(self, out: Path) -> Job:
        """The work for the engine, in the folder `out` that it was begun in."""
        request = request_digest(self.open_worker, recorded_terms(out))
        return Job(out.absolute() / self.folder, self.open_worker, self.spec, request)

    def check(self) -> None:
        """Refuse factors and deviations that the cell does not have; loads the cell's FMU, which takes a second.

        Raises
        ------
        ScancellError
            Naming file, factor, value and what was expected.
        """
        with closing(self.worker()) as worker:
            self.factors.check(worker.units())

    def begin(self, out: Path) -> None:
        """Claim the folder `out`, unless it was begun already.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        if not (out / DESCRIPTION).exists():
            write_record(plain_terms(self.request, self._unrecorded), out)

    def check_same(self, out: Path) -> Comparison:
        """Compare with what the folder was begun for.

        Raises
        ------
        DescriptionError
            If nothing was begun there, or naming the keys that differ.
        """
        try:
            found = compare_with_record(self.request, self.ignored_keys, out)
        except FileNotFoundError:
            raise DescriptionError(f"no {self.kind} was begun in this folder", file=out) from None
        if found.differences:
            raise DescriptionError(
                f"differs from the {self.kind} in {found.record}: {found}{self._hint(found)};"
                " `out` names another folder",
                file=self.source,
            )
        return found

    def _hint(self, found: Comparison) -> str:
        design = self.description.design.kind
        if any(text.startswith(f"{self.kind}.design.trials ") for text in found.differences):
            return f" (only {' and '.join(EXTENDABLE)} designs can be extended; {design} would have other points)"
        return ""

    def run(self, out: Path, target: ExecutionTarget, progress: Progress, announce: Announce = None) -> RunOutcome:
        """Run all tasks that are not finished, see `run_tasks`."""
        try:
            return run_tasks(self.job(out), self.tasks, target, progress, self.unit, announce)
        finally:
            sweep_temporary()

    def complete(self, out: Path, workers: int, progress: Progress) -> dict[str, str]:
        """Check the series and run all tasks that `out` does not hold; returns messages of failed tasks by name.

        Raises
        ------
        ScancellError
            If the series cannot run, or the folder was begun for another one.
        """
        self.check()
        self.begin(out)
        self.check_same(out)
        return self.run(out, ExecutionTarget(workers=workers), progress).failed

    def results(self, out: Path) -> Iterator[tuple[Task, Path | None]]:
        """Every task, with the folder of its files; None where it is not finished."""
        job = self.job(out)
        for task in self.tasks:
            finished = job.store.holds(task.name, job.digest_of_task(task))
            yield task, job.store.path(task.name) if finished else None


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
        is_common = described.noise == "common"
        trials = [
            Trial(n, trial_seed(described.seed, _COMMON_SEED_TRIAL if is_common else n), described.engine, row)
            for n, row in enumerate(values, 1)
        ]
        again = trials[: described.ray_traced_trials]
        return trials + [Trial(count + trial.number, trial.seed, "ray-traced", trial.values) for trial in again]

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
    if not split_solids(part)[0].is_file():
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
