"""Runs named tasks, each at most once, on all cores, on a Dask cluster, or as one shard of a job array.

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

import time
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scancell.errors import OutputError
from scancell.progress import Progress
from scancell.studies.task import ExecutionTarget, Job, Task, TaskReport, close_workers, run_here

# Called with the address of Dask's dashboard.
Announce = Callable[[str], None] | None


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
    chosen = _shard(tasks, target.shard)
    _make_folder(job.folder)
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


def _shard(tasks: Sequence[Task], shard: tuple[int, int] | None) -> Sequence[Task]:
    return tasks if shard is None else tasks[shard[0] - 1 :: shard[1]]


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}", file=folder) from None


def chunks(count: int, size: int) -> Iterable[range]:
    """Ranges of at most `size` numbers that cover 0 … count - 1."""
    return (range(start, min(start + size, count)) for start in range(0, count, size))
