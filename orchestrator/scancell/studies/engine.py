"""Tasks run each at most once, on all cores, on a Dask cluster, or as one shard of a job array.

A `Job` has the folder of the results, the preparation of a worker, and the data common to all tasks; a `Task` has a
name and plain data of its own. A worker process calls ``job.open_worker(job.spec)`` once and then the returned function
for each of its tasks, which writes files into the given folder. Finished tasks are kept on disk (`TaskStore`), so that
the same call after any kill continues, and a task that two workers ran by accident exists once.

    def open_worker(spec):                      # importable by name on every node
        scene = expensive(spec["cell"])
        return lambda payload, folder: (folder / "x.json").write_text(measure(scene, payload))

    job = Job(Path("out/tasks"), open_worker, {"cell": ...})
    outcome = run_tasks(job, [Task("a-0001", {"seed": 1}), ...], ExecutionTarget(), progress)
    job.store.path("a-0001") / "x.json"
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import socket
import tempfile
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from scancell.calibration.cell.report import CalibrationReport
from scancell.calibration.cell.scan import CalibrationRequest
from scancell.config.cell import EstimatedDescription
from scancell.config.choices import Engine
from scancell.config.loading import Setup
from scancell.config.study import CalibrateDescription, VaryingScansDescription
from scancell.errors import DescriptionError, OutputError, require
from scancell.files import read_json
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell
from scancell.output.run_folder import sha256
from scancell.progress import Progress
from scancell.results import ScanResult
from scancell.scanner import Scanner
from scancell.scanning.pipeline import FOLDER_PREFIX
from scancell.scanning.sense import OnImages
from scancell.studies.factors import Factors, Units, Value

DONE = "done.json"
_PARTIAL = ".partial"
_HOST = socket.gethostname().replace(".", "-")
# Errors of a full or write-protected disk, which are no failure of the task.
_DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO})

# Runs one task: its payload, and an empty folder for its files.
Perform = Callable[[Any, Path], None]
# Prepares a worker process from what all tasks share.
OpenWorker = Callable[[Mapping[str, Any]], Perform]

# Called with the address of Dask's dashboard.
Announce = Callable[[str], None] | None


def digest_of(*content: Any) -> str:
    """SHA-256 of plain data; the order of keys does not matter."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def disk_error(error: BaseException | None) -> OSError | None:
    """The disk error that `error` is or was caused by."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
            return error
        error = error.__cause__ or error.__context__
    return None


class TaskStore:
    """A folder with one folder of files per finished task."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, name: str) -> Path:
        """Folder with the files of a finished task."""
        return self._folder / name

    def holds(self, name: str, digest: str) -> bool:
        """Whether the task `name` is finished for the request `digest`, with every file as it was written."""
        folder = self.path(name)
        try:
            done = read_json(folder / DONE)
            return bool(
                done["digest"] == digest
                and all(sha256(folder / file) == checksum for file, checksum in done["files"].items())
            )
        except (OSError, DescriptionError, KeyError, TypeError, AttributeError):
            return False

    @contextmanager
    def publish(self, name: str, digest: str) -> Iterator[Path]:
        """Yield an empty folder to write into; it becomes the task's if the block ends without an error.

        If another process has published the same result meanwhile, that one stays and this one is dropped.

        Raises
        ------
        OutputError
            If the disk is full or the folder cannot be written; nothing of the task is left behind.
        """
        partial = self._partial(name)
        try:
            partial.mkdir(parents=True)
            yield partial
            files = sorted(file for file in partial.rglob("*") if file.is_file())
            checksums = {str(file.relative_to(partial)): sha256(file) for file in files}
            (partial / DONE).write_text(json.dumps({"digest": digest, "files": checksums}, indent=1) + "\n")
            self._rename(partial, name, digest)
        except Exception as error:
            fault = disk_error(error)
            if fault is None:
                raise
            raise OutputError(f"cannot be written: {fault.strerror}", file=self.path(name)) from error
        finally:
            shutil.rmtree(partial, ignore_errors=True)

    def _partial(self, name: str) -> Path:
        return self._folder / f".{name}.{_HOST}.{os.getpid()}.{uuid.uuid4().hex[:8]}{_PARTIAL}"

    def _rename(self, partial: Path, name: str, digest: str) -> None:
        if self.holds(name, digest):
            return
        self.discard(name)
        try:
            partial.rename(self.path(name))
        except OSError as error:
            if error.errno not in {errno.ENOTEMPTY, errno.EEXIST} or not self.holds(name, digest):
                raise

    def discard(self, name: str) -> None:
        """Remove a task's folder, if it exists; it is renamed first, so that it disappears at once."""
        renamed = self._partial(name)
        with suppress(FileNotFoundError):
            self.path(name).rename(renamed)
            shutil.rmtree(renamed, ignore_errors=True)

    def sweep(self) -> None:
        """Remove unfinished folders of killed processes of this machine."""
        for partial in self._folder.glob(f".*{_PARTIAL}"):
            host, pid = partial.name.removesuffix(_PARTIAL).rsplit(".", 3)[-3:-1]
            if host == _HOST and not is_running(int(pid)):
                shutil.rmtree(partial, ignore_errors=True)


def is_running(pid: int) -> bool:
    """Whether the process exists on this machine."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


@dataclass(frozen=True)
class Task:
    """One piece of work; `name` is unique in its job and fit for a file name, `payload` plain data.

    `request` is the part of the payload that decides the result, where the payload also has paths of files.
    """

    name: str
    payload: Any
    request: Any = None


# Preparations in the digests of stored results, which stay valid when a function moves to another module.
_DIGEST_NAMES = {
    "open_trials": "scancell.studies.trial.open_trials",
    "open_batch_worker": "scancell.studies.batch_worker.open_batch_worker",
}


def request_digest(open_worker: OpenWorker, spec: Mapping[str, Any]) -> str:
    """Digest of a worker's preparation from plain data."""
    name = open_worker.__qualname__
    return digest_of(_DIGEST_NAMES.get(name, f"{open_worker.__module__}.{name}"), spec)


@dataclass(frozen=True)
class Job:
    """Common data of tasks: the folder of the results (visible to every node), the worker's preparation, plain data.

    `request` is the digest that finished results carry, where it is not that of `spec`.
    """

    folder: Path
    open_worker: OpenWorker
    spec: Mapping[str, Any]
    request: str | None = None

    @cached_property
    def digest(self) -> str:
        """Digest of the worker's preparation and the common data."""
        return self.request or request_digest(self.open_worker, self.spec)

    @property
    def store(self) -> TaskStore:
        """The results."""
        return TaskStore(self.folder)

    def digest_of_task(self, task: Task) -> str:
        """Digest that a valid result of `task` carries."""
        return digest_of(self.digest, task.name, task.payload if task.request is None else task.request)


@dataclass(frozen=True)
class ExecutionTarget:
    """Where tasks run: on a cluster on this machine (`workers` processes, 0: one per core), on the Dask cluster of
    `scheduler`, or, with ``shard = (i, n)``, in this process, and then only every n-th task from the i-th."""

    workers: int = 0
    scheduler: str | None = None
    shard: tuple[int, int] | None = None

    def check(self) -> None:
        """Refuse a target that needs Dask if it is not installed.

        Raises
        ------
        MissingExtraError
            With the command that installs it.
        """
        if self.shard is None:
            require("distributed", "studies")


@dataclass(frozen=True)
class TaskReport:
    """Result of a task; `seconds` is the worker's wall time, `message` the reason of a failure."""

    name: str
    state: Literal["done", "present", "failed", "no output"]
    message: str = ""
    seconds: float = 0.0


_open_workers: dict[str, Perform] = {}


def run_here(job: Job, task: Task) -> TaskReport:
    """Run one task in this process, unless its result exists. Raises nothing but interrupts."""
    start, digest = time.perf_counter(), job.digest_of_task(task)
    try:
        if job.store.holds(task.name, digest):
            return TaskReport(task.name, "present")
        with job.store.publish(task.name, digest) as folder:
            _opened(job)(task.payload, folder)
    except OutputError as error:
        return TaskReport(task.name, "no output", str(error))
    except Exception as error:  # an error in one task must not end the others
        state: Literal["failed", "no output"] = "no output" if disk_error(error) else "failed"
        return TaskReport(task.name, state, f"{type(error).__name__}: {error}", time.perf_counter() - start)
    return TaskReport(task.name, "done", seconds=time.perf_counter() - start)


def _opened(job: Job) -> Perform:
    """The worker of `job` in this process, prepared at its first task; only one job at a time, to bound memory."""
    if job.digest not in _open_workers:
        close_workers()
        _open_workers[job.digest] = job.open_worker(job.spec)
    return _open_workers[job.digest]


def close_workers() -> None:
    """Drop the workers of earlier jobs in this process; those with a method `close` are closed."""
    for worker in _open_workers.values():
        close = getattr(worker, "close", None)
        if close is not None:
            close()
    _open_workers.clear()


@dataclass
class RunOutcome:
    """Names of the tasks finished in this run (`done`) and before it (`present`), and messages of those that failed.

    `busy_seconds` is the sum of the workers' time in tasks, `seconds` the wall time of the run, `start_seconds` the
    part of it before the first task could begin.
    """

    done: list[str] = field(default_factory=list)
    present: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    busy_seconds: float = 0.0
    start_seconds: float = 0.0
    seconds: float = 0.0

    def add(self, report: TaskReport) -> None:
        """Count a task.

        Raises
        ------
        OutputError
            If the task's result could not be written, as then no other could.
        """
        if report.state == "no output":
            raise OutputError(report.message)
        if report.state == "failed":
            self.failed[report.name] = report.message
        else:
            # "present": a worker died after it had finished the task and before it could report.
            self.done.append(report.name)
        self.busy_seconds += report.seconds


def run_tasks(
    job: Job,
    tasks: Sequence[Task],
    target: ExecutionTarget,
    progress: Progress,
    unit: str = "task",
    announce: Announce = None,
) -> RunOutcome:
    """Run all tasks that are not finished; one that fails does not stop the others.

    Parameters
    ----------
    announce
        Called with the address of Dask's dashboard, if there is one.

    Raises
    ------
    WorkersError
        If the scheduler does not answer, or the connection is lost.
    OutputError
        If results cannot be written; earlier results stay.
    MissingExtraError
        If Dask is needed and not installed.
    """
    began = time.perf_counter()
    outcome = RunOutcome()
    chosen = tasks if target.shard is None else tasks[target.shard[0] - 1 :: target.shard[1]]
    try:
        job.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=job.folder) from None
    job.store.sweep()
    progress.stage("running", len(chosen), unit)
    todo = []
    for task in chosen:
        if job.store.holds(task.name, job.digest_of_task(task)):
            outcome.present.append(task.name)
            progress.advance(1)
        else:
            todo.append(task)
    reports = _reports(job, todo, target, outcome, announce, began)
    try:
        for report in reports:
            if report is not None:
                outcome.add(report)
            progress.advance(0 if report is None else 1)
    finally:
        reports.close()  # ends the workers now, not when the generator is collected
        job.store.sweep()  # files of workers that were killed
    outcome.seconds = time.perf_counter() - began
    return outcome


def _reports(
    job: Job, todo: Sequence[Task], target: ExecutionTarget, outcome: RunOutcome, announce: Announce, began: float
) -> Generator[TaskReport | None, None, None]:
    if target.shard is not None or not todo:
        outcome.start_seconds = time.perf_counter() - began
        try:
            yield from (run_here(job, task) for task in todo)
        finally:
            close_workers()
        return
    target.check()
    from scancell.studies.dask_cluster import run_on_dask  # noqa: PLC0415  (takes half a second to import)

    def started(dashboard: str) -> None:
        outcome.start_seconds = time.perf_counter() - began
        if announce is not None:
            announce(dashboard)

    yield from run_on_dask(job, todo, target, started)


def chunks(count: int, size: int) -> Iterable[range]:
    """Ranges of at most `size` numbers that cover 0 … count - 1."""
    return (range(start, min(start + size, count)) for start in range(0, count, size))


@dataclass(frozen=True)
class Trial:
    """A numbered scan: the seed of its random numbers, its engine, and the drawn value of each factor."""

    number: int
    seed: int
    engine: Engine
    values: tuple[Value, ...]


class ScanWorker:
    """Scans one part in this process; `source` names the file of the variation in messages."""

    def __init__(self, scans: VaryingScansDescription, setup: Setup, part: Mesh, source: str) -> None:
        self._part = part
        self._factors = Factors(scans, setup, source)
        self._scanner = Scanner(setup=setup, threads=1)

    def calibrated(self, trial: Trial, calibrate: CalibrateDescription) -> CalibrationReport:
        """Calibrate the cell of the trial.

        Raises
        ------
        ScancellError
            If any of it cannot be done.
        """
        inputs = self._factors.inputs(trial.values)
        return self._scanner.calibrate(
            CalibrationRequest.of(calibrate),
            calibrate.artefact,
            engine=trial.engine,
            as_built=inputs.as_built,
            seed=trial.seed,
            setup=inputs.setup,
        )

    def scan(
        self,
        trial: Trial,
        on_images: OnImages | None = None,
        normals: bool = False,
        estimated: EstimatedDescription | None = None,
    ) -> ScanResult:
        """Scan with the values of the trial; `estimated` are deviations that reconstruction assumes.

        Raises
        ------
        ScancellError
            If any of it cannot be done.
        """
        inputs = self._factors.inputs(trial.values)
        return self._scanner.scan(
            self._part,
            engine=trial.engine,
            as_built=inputs.as_built,
            seed=trial.seed,
            setup=inputs.setup,
            estimated=estimated,
            normals=normals,
            samples=False,
            on_images=on_images,
        )

    @property
    def setup(self) -> Setup:
        """The nominal descriptions around which factors vary."""
        return self._scanner.setup

    @cached_property
    def nominal(self) -> NominalCell:
        """The cell of these descriptions."""
        return self._scanner.pipeline.load(self.setup, self._part).nominal

    def units(self) -> Units:
        """Units of the deviations of the FMU."""
        pipeline = self._scanner.pipeline
        return pipeline.runner.units(pipeline.load(self.setup, self._part))

    def close(self) -> None:
        """Free the FMU and the files of this worker."""
        self._scanner.close()


def trial_of(plain: Mapping[str, Any]) -> Trial:
    """A trial from plain data."""
    return Trial(plain["number"], plain["seed"], plain["engine"], tuple(plain["values"]))


def sweep_temporary() -> None:
    """Remove the temporary files of workers of this machine that were killed."""
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER_PREFIX}*"):
        pid = folder.name.removeprefix(FOLDER_PREFIX).split("-")[0]
        if pid.isdigit() and not is_running(int(pid)):
            shutil.rmtree(folder, ignore_errors=True)
