"""Runs named tasks, each at most once, on all cores, on a Dask cluster, or as one shard of a job array.

A `Job` says where results go, how a worker prepares itself, and what all tasks share; a `Task` has a name and plain
data of its own. A worker process calls ``job.open_worker(job.spec)`` once and then the returned function for each of
its tasks, which leaves files in the folder that it is handed. What is finished is kept on disk (`TaskStore`), so that
the same call after any kill goes on where it stopped, and a task that two workers ran by accident exists once.

    def open_worker(spec):                      # importable by name on every node
        scene = expensive(spec["cell"])
        return lambda payload, folder: (folder / "x.json").write_text(measure(scene, payload))

    job = Job(Path("out/tasks"), open_worker, {"cell": ...})
    outcome = run_tasks(job, [Task("a-0001", {"seed": 1}), ...], Where(), progress)
    job.store.path("a-0001") / "x.json"
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from orchestrator.errors import OutputError
from orchestrator.progress import Progress
from orchestrator.studies.task import Job, Task, TaskReport, Where, run_here

# Hears of the address of Dask's dashboard.
Announce = Callable[[str], None] | None


@dataclass
class RunOutcome:
    """Names of the tasks that were finished in this run and before it, messages of those that failed, and seconds.

    `busy_seconds` adds up what the workers spent in tasks, `seconds` is the time of the whole run, of which
    `start_seconds` went by before the first task could begin.
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
            If the task's result could not be written: no other one could be either.
        """
        if report.state == "no output":
            raise OutputError(report.message)
        if report.state == "failed":
            self.failed[report.name] = report.message
        else:
            # Present by now: a worker died after it had finished the task and before it could say so.
            self.done.append(report.name)
        self.busy_seconds += report.seconds


def run_tasks(
    job: Job, tasks: Sequence[Task], where: Where, progress: Progress, unit: str = "task", announce: Announce = None
) -> RunOutcome:
    """Bring all tasks to an end that are not finished yet; those that fail do not keep others from it.

    Parameters
    ----------
    announce
        Called with the address of Dask's dashboard, where there is one.

    Raises
    ------
    EngineError
        If there is no such scheduler, or it goes away.
    OutputError
        If results cannot be written; the earlier ones stay.
    """
    began = time.perf_counter()
    outcome = RunOutcome()
    chosen = _shard(tasks, where.shard)
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
    reports = _reports(job, todo, where, outcome, announce, began)
    try:
        for report in reports:
            outcome.add(report)
            progress.advance(1)
    finally:
        reports.close()  # ends the workers now, not when memory is collected
        job.store.sweep()  # what those left who died on the way
    outcome.seconds = time.perf_counter() - began
    return outcome


def _reports(
    job: Job, todo: Sequence[Task], where: Where, outcome: RunOutcome, announce: Announce, began: float
) -> Generator[TaskReport, None, None]:
    if where.shard is not None or not todo:
        outcome.start_seconds = time.perf_counter() - began
        yield from (run_here(job, task) for task in todo)
        return
    from orchestrator.studies.dask_cluster import run_on_dask  # noqa: PLC0415  (takes half a second to import)

    def started(dashboard: str) -> None:
        outcome.start_seconds = time.perf_counter() - began
        if announce is not None:
            announce(dashboard)

    yield from run_on_dask(job, todo, where, started)


def _shard(tasks: Sequence[Task], shard: tuple[int, int] | None) -> Sequence[Task]:
    return tasks if shard is None else tasks[shard[0] - 1 :: shard[1]]


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None


def chunks(count: int, size: int) -> Iterable[range]:
    """Ranges of at most `size` numbers that cover 0 … count - 1."""
    return (range(start, min(start + size, count)) for start in range(0, count, size))
