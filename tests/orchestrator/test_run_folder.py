"""Run folders are written atomically."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from scancell.errors import OutputError
from scancell.output.run_folder import RunFolder


def test_files_appear_on_success(tmp_path: Path) -> None:
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
def test_interrupted_run_keeps_previous_results(tmp_path: Path, fault: type[BaseException]) -> None:
    target = tmp_path / "run"
    target.mkdir()
    (target / "cloud.ply").write_text("old")
    with pytest.raises(fault), RunFolder(target) as folder:
        folder.path("cloud.ply").write_text("half")
        raise fault
    assert (target / "cloud.ply").read_text() == "old"
    assert os.listdir(tmp_path) == ["run"]


def test_interrupt_on_entry_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> bool:
        raise KeyboardInterrupt

    (tmp_path / "run").mkdir()
    monkeypatch.setattr(os, "access", interrupted)
    with pytest.raises(KeyboardInterrupt), RunFolder(tmp_path / "run"):
        pytest.fail("the block must not start")
    assert os.listdir(tmp_path) == ["run"]


def test_run_replaces_existing_folders(tmp_path: Path) -> None:
    target = tmp_path / "run"
    for name in ("one", "two"):
        with RunFolder(target) as folder:
            folder.path(f"images/{name}.png").write_text(name)
    assert os.listdir(target / "images") == ["two.png"]


def test_file_as_target_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("mine")
    with pytest.raises(OutputError, match="expected a folder"), RunFolder(tmp_path / "run"):
        pytest.fail("the block must not start")
    with pytest.raises(OutputError, match="cannot be written"), RunFolder(tmp_path / "run" / "deeper"):
        pytest.fail("the block must not start")
    assert (tmp_path / "run").read_text() == "mine"


def test_optional_files_of_an_earlier_run_do_not_stay(tmp_path: Path) -> None:
    target = tmp_path / "run"
    for names in (("cloud.ply", "cloud.npz", "images/one.png", "notes.txt"), ("cloud.ply",)):
        with RunFolder(target, ("cloud.ply", "cloud.npz", "images")) as folder:
            folder.path("manifest.json").write_text("{}")
            for name in names:
                folder.path(name).write_text(names[0])
    assert sorted(os.listdir(target)) == ["cloud.ply", "manifest.json", "notes.txt"]


@pytest.mark.parametrize("manifest", ["", "{}", '{"files": 3}', '{"files": ["cloud.ply", 1]}', "[" * 9000])
def test_files_of_others_with_the_names_of_optional_files_stay(tmp_path: Path, manifest: str) -> None:
    """Images of a user, from which a run may be made, lie where it is written."""
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "own.png").write_text("mine")
    (tmp_path / "manifest.json").write_text(manifest)
    with RunFolder(tmp_path, ("cloud.ply", "images")) as folder:
        folder.path("manifest.json").write_text("{}")
    assert (tmp_path / "images" / "own.png").read_text() == "mine"


def test_folder_that_a_killed_process_left_does_not_block_the_next(tmp_path: Path) -> None:
    """Numbers of processes repeat, in containers at once."""
    killed = RunFolder(tmp_path / "run").__enter__()
    killed.path("cloud.ply").write_text("half")
    with RunFolder(tmp_path / "run") as folder:
        folder.path("cloud.ply").write_text("whole")
    assert (tmp_path / "run" / "cloud.ply").read_text() == "whole"
