"""Tasks on a Dask cluster: one on this machine, or one that is already there."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, KilledWorker, LocalCluster, WorkerPlugin, as_completed
from distributed.client import FutureCancelledError

from orchestrator.errors import EngineError
from orchestrator.studies.task import Job, Task, TaskReport, Where, run_here

# Tasks known to the scheduler at a time: enough to keep many workers busy, few enough for a million tasks in all.
_AHEAD_PER_WORKER = 20
_LEAST_AHEAD = 200
_CONNECT_S = 15
# Dask looks after itself and samples what it runs many times a second, all of which takes 2.7 % of two workers' time
# with the defaults, 0.5 % with these intervals.
_SELDOM = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.admin.tick.interval": "1s",
}
_SETTINGS = {
    **_SELDOM,
    "distributed.comm.timeouts.connect": f"{_CONNECT_S}s",
    "distributed.comm.retry.count": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.admin.tick.limit": "60s",  # a busy machine is no reason to warn people
    "distributed.nanny.pre-spawn-environ.DASK_LOGGING__DISTRIBUTED": "critical",
}
_LOST = (FutureCancelledError, OSError, TimeoutError)


class _LeaveInterruptsToTheCommand(WorkerPlugin):  # type: ignore[misc]
    """A terminal sends Ctrl-C to the workers too; it is the command that ends them."""

    def setup(self, worker: Any) -> None:
        """Called once in every worker process."""
        with suppress(ValueError):  # not in the main thread: then the signal does not come here
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_on_dask(job: Job, todo: Sequence[Task], where: Where, started: Callable[[str], None]) -> Iterator[TaskReport]:
    """Reports in the order in which tasks end; `started` is called with the dashboard's address.

    Raises
    ------
    EngineError
        If there is no such scheduler, or it goes away.
    """
    with dask.config.set(_SETTINGS), _quiet(), _client(where) as client:
        started(client.dashboard_link)
        waiting = iter(todo)
        threads = max(1, sum(client.nthreads().values()))
        ahead = max(_LEAST_AHEAD, _AHEAD_PER_WORKER * threads)
        futures: dict[str, Task] = {}

        def submit() -> Any:
            for task in waiting:
                future = client.submit(run_here, job, task, key=f"{job.digest[:8]}-{task.name}", pure=False)
                futures[future.key] = task
                return future
            return None

        running = as_completed([future for _ in range(ahead) if (future := submit()) is not None], loop=client.loop)
        for future in running:
            yield _report(client, future, futures.pop(future.key))
            following = submit()
            if following is not None:
                running.add(following)


def _report(client: Client, future: Any, task: Task) -> TaskReport:
    try:
        report: TaskReport = future.result()
    except KilledWorker:
        limit = dask.config.get("distributed.scheduler.allowed-failures")
        return TaskReport(task.name, "failed", f"{limit + 1} workers that ran it died")
    except _LOST as error:
        raise EngineError(f"the scheduler {client.scheduler.address} is gone; resume to go on") from error
    finally:
        future.release()
    return report


@contextmanager
def _client(where: Where) -> Iterator[Client]:
    if where.scheduler is not None:
        try:
            client = Client(where.scheduler, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise EngineError(f"--scheduler {where.scheduler}: no Dask scheduler answers: {error}") from None
        with client:
            yield client
        return
    with _local_cluster(where) as cluster, Client(cluster, set_as_default=False) as client:
        client.register_plugin(_LeaveInterruptsToTheCommand())
        yield client


def _local_cluster(where: Where) -> LocalCluster:
    try:
        return LocalCluster(
            n_workers=where.workers or len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
    except (RuntimeError, OSError, TimeoutError) as error:  # a worker was killed before it was there, for one
        raise EngineError(f"the workers do not start: {error} Resume to go on") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """What the user needs to know comes as an error of ours; Dask's own remarks about lost workers do not help."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
