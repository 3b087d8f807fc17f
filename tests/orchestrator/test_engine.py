"""Named tasks: each finishes once, whatever fails or is killed, and finished tasks are not repeated."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from distributed import LocalCluster
from engine_work import open_counter

from scancell.errors import OutputError, WorkersError
from scancell.progress import NullProgress
from scancell.studies.engine import DONE, ExecutionTarget, Job, Task, TaskStore, close_workers, run_tasks

ALONE = ExecutionTarget(shard=(1, 1))
TWO = ExecutionTarget(workers=2)


@pytest.fixture(autouse=True)
def _no_worker_left():
    yield
    close_workers()


def make_job(folder: Path) -> Job:
    return Job(folder / "tasks", open_counter, {"log": str(folder / "log")})


def make_tasks(count: int, **orders: dict[int, object]) -> list[Task]:
    return [Task(f"n{n:03d}", {"n": n, **{k: v[n] for k, v in orders.items() if n in v}}) for n in range(count)]


def runs(folder: Path) -> list[int]:
    log = folder / "log"
    return sorted(int(line.split()[0]) for line in log.read_text().splitlines()) if log.exists() else []


def squares(job: Job, tasks: list[Task]) -> list[int]:
    return [json.loads((job.store.path(task.name) / "square.json").read_text()) for task in tasks]


@pytest.mark.parametrize("target", [ALONE, TWO], ids=["alone", "two workers"])
def test_every_task_runs_once(tmp_path, target) -> None:
    job, tasks = make_job(tmp_path), make_tasks(12)
    outcome = run_tasks(job, tasks, target, NullProgress())
    assert sorted(outcome.done) == [task.name for task in tasks]
    assert squares(job, tasks) == [n * n for n in range(12)]
    assert runs(tmp_path) == list(range(12))


def test_finished_tasks_are_not_repeated(tmp_path) -> None:
    job, tasks = make_job(tmp_path), make_tasks(6)
    run_tasks(job, tasks[:4], ALONE, NullProgress())
    outcome = run_tasks(job, tasks, ALONE, NullProgress())
    assert (outcome.present, outcome.done) == (["n000", "n001", "n002", "n003"], ["n004", "n005"])
    assert runs(tmp_path) == list(range(6))


def test_failing_task_is_reported_and_the_others_finish(tmp_path) -> None:
    job, tasks = make_job(tmp_path), make_tasks(5, fail={2: True})
    outcome = run_tasks(job, tasks, ALONE, NullProgress())
    assert outcome.failed == {"n002": "ValueError: number 2 is broken"}
    assert sorted(outcome.done) == ["n000", "n001", "n003", "n004"]
    assert not job.store.path("n002").exists()


def test_task_that_kills_its_worker_is_reported_and_the_others_finish(tmp_path) -> None:
    job, tasks = make_job(tmp_path), make_tasks(6, die={3: True})
    outcome = run_tasks(job, tasks, TWO, NullProgress())
    assert list(outcome.failed) == ["n003"]
    assert "died" in outcome.failed["n003"]
    assert len(outcome.done) == 5
    assert not list(job.folder.glob(".*")), "files of killed workers are removed"


def test_failure_to_close_the_workers_keeps_the_outcome(tmp_path, monkeypatch) -> None:
    """Dask fails so when it is just restarting a worker that died."""
    close = LocalCluster.close

    def failing(cluster, *arguments, **options):
        close(cluster, *arguments, **options)
        raise AssertionError("can only join a started process")

    monkeypatch.setattr(LocalCluster, "close", failing)
    job, tasks = make_job(tmp_path), make_tasks(2)
    assert sorted(run_tasks(job, tasks, TWO, NullProgress()).done) == ["n000", "n001"]


@pytest.mark.parametrize("damage", ["cut", "other request", "no record", "removed"])
def test_damaged_result_is_repeated(tmp_path, damage) -> None:
    job, tasks = make_job(tmp_path), make_tasks(3)
    run_tasks(job, tasks, ALONE, NullProgress())
    folder = job.store.path("n001")
    if damage == "cut":
        (folder / "square.json").write_text("")
    elif damage == "no record":
        (folder / DONE).unlink()
    elif damage == "removed":
        shutil.rmtree(folder)
    else:
        tasks[1] = Task("n001", {"n": 7})
    outcome = run_tasks(job, tasks, ALONE, NullProgress())
    assert outcome.done == ["n001"]
    assert squares(job, tasks) == [0, 49 if damage == "other request" else 1, 4]


def test_shards_divide_the_tasks(tmp_path) -> None:
    job, tasks = make_job(tmp_path), make_tasks(7)
    done = [run_tasks(job, tasks, ExecutionTarget(shard=(i, 3)), NullProgress()).done for i in (1, 2, 3)]
    assert done == [["n000", "n003", "n006"], ["n001", "n004"], ["n002", "n005"]]
    assert runs(tmp_path) == list(range(7))


def test_two_workers_that_finish_the_same_task_leave_one_result(tmp_path) -> None:
    store = TaskStore(tmp_path)
    with store.publish("a", "d") as first, store.publish("a", "d") as second:
        (first / "x").write_text("same")
        (second / "x").write_text("same")
    assert store.holds("a", "d")
    assert sorted(os.listdir(tmp_path)) == ["a"]


def test_folder_that_cannot_be_created_is_named(tmp_path) -> None:
    (tmp_path / "tasks").write_text("a file is in the way")
    with pytest.raises(OutputError, match="tasks: cannot be written"):
        run_tasks(make_job(tmp_path), make_tasks(2), ALONE, NullProgress())


def test_full_disk_ends_the_run_and_keeps_earlier_results(tmp_path, monkeypatch) -> None:
    job, tasks = make_job(tmp_path), make_tasks(4)
    run_tasks(job, tasks[:2], ALONE, NullProgress())

    def full(self: Path, *_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(OutputError, match=r"n002: cannot be written: No space left"):
            run_tasks(job, tasks, ALONE, NullProgress())
    assert sorted(os.listdir(job.folder)) == ["n000", "n001"]
    assert run_tasks(job, tasks, ALONE, NullProgress()).done == ["n002", "n003"]


def test_missing_scheduler_is_named(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("scancell.studies.dask_cluster._CONNECT_S", 1)
    with pytest.raises(WorkersError, match=r"tcp://127.0.0.1:1"):
        run_tasks(make_job(tmp_path), make_tasks(2), ExecutionTarget(scheduler="tcp://127.0.0.1:1"), NullProgress())


def test_workers_that_do_not_start_are_reported(tmp_path, monkeypatch) -> None:
    def fails(**_: object) -> None:
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr("scancell.studies.dask_cluster.LocalCluster", fails)
    with pytest.raises(WorkersError, match="do not start"):
        run_tasks(make_job(tmp_path), make_tasks(1), ExecutionTarget(workers=1), NullProgress())
