"""Tasks, the job that they belong to, where they run, and how one runs in this process."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from scancell.errors import OutputError
from scancell.extras import require
from scancell.studies.task_store import TaskStore, digest_of, disk_error

# Runs one task: its payload, and an empty folder for its files.
Perform = Callable[[Any, Path], None]
# Prepares a worker process from what all tasks share.
OpenWorker = Callable[[Mapping[str, Any]], Perform]


@dataclass(frozen=True)
class Task:
    """One piece of work; `name` is unique in its job and fit for a file name, `payload` plain data.

    `request` is the part of the payload that decides the result, where the payload also has paths of files.
    """

    name: str
    payload: Any
    request: Any = None


def request_digest(open_worker: OpenWorker, spec: Mapping[str, Any]) -> str:
    """Digest of a worker's preparation from plain data."""
    return digest_of(f"{open_worker.__module__}.{open_worker.__qualname__}", spec)


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
    except Exception as error:  # whatever goes wrong in one task must not end the others
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
