"""A task, the job that it belongs to, who may do it, and how one is done in this process."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from orchestrator.errors import OutputError
from orchestrator.studies.task_store import TaskStore, digest_of, disk_error

# Does one task: takes its payload and an empty folder for its files.
Perform = Callable[[Any, Path], None]
# Prepares a worker process from what all tasks share.
OpenWorker = Callable[[Mapping[str, Any]], Perform]


@dataclass(frozen=True)
class Task:
    """One piece of work; `name` is unique in its job and fit for a file name, `payload` plain data.

    `request` is what of the payload decides the result, where that also says where files lie.
    """

    name: str
    payload: Any
    request: Any = None


def request_digest(open_worker: OpenWorker, spec: Mapping[str, Any]) -> str:
    """Stands for a worker's preparation from plain data."""
    return digest_of(f"{open_worker.__module__}.{open_worker.__qualname__}", spec)


@dataclass(frozen=True)
class Job:
    """What all tasks share: the folder of the results (seen by every node), the worker's preparation, plain data.

    `request` is the digest that finished results carry, where `spec` says in other words what they were made for.
    """

    folder: Path
    open_worker: OpenWorker
    spec: Mapping[str, Any]
    request: str | None = None

    @cached_property
    def digest(self) -> str:
        """Stands for the worker's preparation and the shared data."""
        return self.request or request_digest(self.open_worker, self.spec)

    @property
    def store(self) -> TaskStore:
        """The results."""
        return TaskStore(self.folder)

    def digest_of_task(self, task: Task) -> str:
        """What a result must carry to count as the answer to `task`."""
        return digest_of(self.digest, task.name, task.payload if task.request is None else task.request)


@dataclass(frozen=True)
class Where:
    """Who does the work: a cluster on this machine (`workers` processes, 0: one per core), the Dask cluster of
    `scheduler`, or, with ``shard = (i, n)``, this process alone and only every n-th task, beginning with the i-th."""

    workers: int = 0
    scheduler: str | None = None
    shard: tuple[int, int] | None = None


@dataclass(frozen=True)
class TaskReport:
    """What became of a task; `seconds` is the worker's own time for it, `message` says why it failed."""

    name: str
    state: Literal["done", "present", "failed", "no output"]
    message: str = ""
    seconds: float = 0.0


_open_workers: dict[str, Perform] = {}


def run_here(job: Job, task: Task) -> TaskReport:
    """Do one task in this process, unless its result is there. Never raises but for an interrupt."""
    start, digest = time.perf_counter(), job.digest_of_task(task)
    try:
        if job.store.holds(task.name, digest):
            return TaskReport(task.name, "present")
        with job.store.publish(task.name, digest) as folder:
            _opened(job)(task.payload, folder)
    except OutputError as error:
        return TaskReport(task.name, "no output", str(error))
    except Exception as error:  # whatever goes wrong in one task must not end the others
        state: Literal["failed", "no output"] = "no output" if disk_error(error) else "failed"
        return TaskReport(task.name, state, f"{type(error).__name__}: {error}", time.perf_counter() - start)
    return TaskReport(task.name, "done", seconds=time.perf_counter() - start)


def _opened(job: Job) -> Perform:
    """The worker of `job` in this process, prepared at its first task; one job at a time keeps memory bounded."""
    if job.digest not in _open_workers:
        close_workers()
        _open_workers[job.digest] = job.open_worker(job.spec)
    return _open_workers[job.digest]


def close_workers() -> None:
    """Let go of what this process prepared for earlier jobs; workers with a method `close` are told."""
    for worker in _open_workers.values():
        close = getattr(worker, "close", None)
        if close is not None:
            close()
    _open_workers.clear()
