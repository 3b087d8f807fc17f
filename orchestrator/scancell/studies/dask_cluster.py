"""Tasks on a Dask cluster: a local one, or the one of a given scheduler."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import dask
from distributed import Client, KilledWorker, LocalCluster, WorkerPlugin, wait
from distributed.client import FutureCancelledError

from scancell.errors import WorkersError
from scancell.studies.engine import ExecutionTarget, Job, Task, TaskReport, run_here

# Tasks known to the scheduler at a time: enough to keep many workers busy, few enough for a million tasks in all.
_TASKS_PER_WORKER = 20
_MIN_TASKS = 200
_CONNECT_S = 15
# Dask's monitoring and profiling takes 2.7 % of the time of two workers with the default intervals, 0.5 % with these.
_MONITORING = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.admin.tick.interval": "1s",
}
_SETTINGS = {
    **_MONITORING,
    "distributed.comm.timeouts.connect": f"{_CONNECT_S}s",
    "distributed.comm.retry.count": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.admin.tick.limit": "60s",  # no warnings about a busy machine
    "distributed.nanny.pre-spawn-environ.DASK_LOGGING__DISTRIBUTED": "critical",
}
_HEARTBEAT_S = 1.0
_LOST = (FutureCancelledError, OSError, TimeoutError)


class _IgnoreInterrupts(WorkerPlugin):  # type: ignore[misc]
    """A terminal sends Ctrl-C to the workers too; the command ends them."""

    def setup(self, worker: Any) -> None:
        """Run once in every worker process."""
        with suppress(ValueError):  # outside the main thread, which alone receives the signal
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_on_dask(
    job: Job, todo: Sequence[Task], target: ExecutionTarget, started: Callable[[str], None]
) -> Iterator[TaskReport | None]:
    """Reports of the tasks in the order in which they end, and None every second without one.

    `started` is called with the dashboard's address.

    Raises
    ------
    WorkersError
        If the scheduler does not answer, or the connection is lost.
    """
    with dask.config.set(_SETTINGS), _quiet(), _client(target) as client:
        started(client.dashboard_link)
        waiting = iter(todo)
        threads = max(1, sum(client.nthreads().values()))
        ahead = max(_MIN_TASKS, _TASKS_PER_WORKER * threads)
        futures: dict[str, Task] = {}

        def submit() -> Any:
            for task in waiting:
                future = client.submit(run_here, job, task, key=f"{job.digest[:8]}-{task.name}", pure=False)
                futures[future.key] = task
                return future
            return None

        running = {future for _ in range(ahead) if (future := submit()) is not None}
        while running:
            try:
                with client.as_current():
                    done, running = wait(running, timeout=_HEARTBEAT_S, return_when="FIRST_COMPLETED")
            except TimeoutError:
                yield None
                continue
            except _LOST as error:
                raise _lost(client) from error
            for future in done:
                yield _report(client, future, futures.pop(future.key))
                following = submit()
                if following is not None:
                    running.add(following)


def _report(client: Client, future: Any, task: Task) -> TaskReport:
    try:
        report: TaskReport = future.result()
    except KilledWorker:
        limit = dask.config.get("distributed.scheduler.allowed-failures")
        return TaskReport(task.name, "failed", f"{limit + 1} workers died while they ran it")
    except _LOST as error:
        raise _lost(client) from error
    finally:
        future.release()
    return report


def _lost(client: Client) -> WorkersError:
    return WorkersError(f"lost the scheduler {client.scheduler.address}; resume to continue")


@contextmanager
def _client(target: ExecutionTarget) -> Iterator[Client]:
    if target.scheduler is not None:
        try:
            client = Client(target.scheduler, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise WorkersError(f"no Dask scheduler answers: {error}", key="scheduler", value=target.scheduler) from None
        with client:
            yield client
        return
    cluster = _local_cluster(target)
    try:
        with Client(cluster, set_as_default=False) as client:
            client.register_plugin(_IgnoreInterrupts())
            yield client
    finally:
        # All reports are in.  Dask fails to close a worker that it is restarting just then; the end of this process
        # ends that worker.
        with suppress(AssertionError, TimeoutError):
            cluster.close()


def _local_cluster(target: ExecutionTarget) -> LocalCluster:
    try:
        return LocalCluster(
            n_workers=target.workers or len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
    except (RuntimeError, OSError, TimeoutError) as error:  # a worker was killed while it started, for example
        # Each worker imports the script that starts it.
        guarded = 'a call under `if __name__ == "__main__":`, where a script makes it'
        raise WorkersError(f"the workers do not start: {error}", expected=guarded) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress Dask's log: failures reach the user as errors of ours."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
