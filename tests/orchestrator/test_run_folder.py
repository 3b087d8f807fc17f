"""Results appear whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from orchestrator.errors import OutputError
from orchestrator.evaluation.run_folder import RunFolder


def test_files_appear_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "a" / "run"
    with RunFolder(target) as folder:
        folder.path("cloud.ply").write_text("x")
        folder.path("images/one.png").write_text("y")
        assert not target.exists()
    assert (target / "cloud.ply").read_text() == "x"
    assert (target / "images" / "one.png").read_text() == "y"
    assert os.listdir(tmp_path / "a") == ["run"]
    assert sorted(folder.names) == ["cloud.ply", "images"]


@pytest.mark.parametrize("fault", [KeyboardInterrupt, ValueError])
def test_an_interrupted_run_leaves_the_old_results_and_nothing_else(tmp_path: Path, fault: type[BaseException]) -> None:
    target = tmp_path / "run"
    target.mkdir()
    (target / "cloud.ply").write_text("old")
    with pytest.raises(fault), RunFolder(target) as folder:
        folder.path("cloud.ply").write_text("half")
        raise fault
    assert (target / "cloud.ply").read_text() == "old"
    assert os.listdir(tmp_path) == ["run"]


def test_a_new_run_replaces_folders_of_the_old_one(tmp_path: Path) -> None:
    target = tmp_path / "run"
    for name in ("one", "two"):
        with RunFolder(target) as folder:
            folder.path(f"images/{name}.png").write_text(name)
    assert os.listdir(target / "images") == ["two.png"]


def test_a_target_that_is_a_file_is_refused_before_work(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("mine")
    with pytest.raises(OutputError, match="expected a folder"), RunFolder(tmp_path / "run"):
        pytest.fail("the block must not start")
    with pytest.raises(OutputError, match="cannot be written"), RunFolder(tmp_path / "run" / "deeper"):
        pytest.fail("the block must not start")
    assert (tmp_path / "run").read_text() == "mine"
