"""Zip files of run folders: which files are unpacked, where to, and what is refused."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest

from scancell.errors import DescriptionError
from scancell.files import first_free
from scancell.workspace import run_archive

UNPACKED = ("resolved.toml", "recording.parquet", "plan.json", "cloud.ply", "my part.STL")


def zipped(files: dict[str, bytes]) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return made.getvalue()


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, bytes]]:
    """Files of the folders that are read as runs."""
    found: list[dict[str, bytes]] = []

    def open_run(folder: str) -> None:
        found.append({path.name: path.read_bytes() for path in Path(folder).iterdir()})

    monkeypatch.setattr(run_archive, "open_run", open_run)
    return found


@pytest.mark.parametrize("root", ["", "run/", "deep/er/", "../", "/etc/"])
def test_files_of_the_run_alone_are_unpacked_whatever_their_folder(root: str, opened: list[dict[str, bytes]]) -> None:
    others = {f"{root}images/1.png": b"x", f"{root}report.json": b"x", "other/cloud.ply": b"x", f"{root}run.py": b"x"}
    run_archive.open_archive(zipped({f"{root}{name}": name.encode() for name in UNPACKED} | others), "run.zip")
    assert opened == [{name: name.encode() for name in UNPACKED}]


@pytest.mark.parametrize("name", ["../../escaped.stl", "..\\escaped.stl", "/tmp/escaped.stl", ".hidden.stl", "a:b.stl"])
def test_no_path_of_the_archive_is_followed(name: str, opened: list[dict[str, bytes]]) -> None:
    run_archive.open_archive(zipped({"resolved.toml": b"", name: b"x"}), "run.zip")
    assert opened == [{"resolved.toml": b""}]


def test_large_archives_are_refused_before_they_are_unpacked(opened: list[dict[str, bytes]]) -> None:
    content = zipped({"resolved.toml": b"", "cloud.ply": bytes(10_000_000)})
    assert len(content) < 100_000
    with pytest.raises(DescriptionError, match=r"run.zip: 10 MB unpacked: expected at most 1 MB"):
        run_archive.open_archive(content, "run.zip", most_bytes=1_000_000)
    assert opened == []


def test_what_is_no_archive_of_a_run_is_refused() -> None:
    whole = zipped({"resolved.toml": b"x" * 1000})
    broken = whole[:30] + b"????" + whole[34:]
    for content in (b"", b"not a zip file", whole[: len(whole) // 2], broken):
        with pytest.raises(DescriptionError, match=r"run.zip: expected a zip file"):
            run_archive.open_archive(content, "run.zip")
    for files in ({"cloud.ply": b""}, {"a/resolved.toml": b"", "b/resolved.toml": b""}):
        with pytest.raises(DescriptionError, match=r"expected the zip file of one run folder"):
            run_archive.open_archive(zipped(files), "run.zip")


def test_first_free_name(tmp_path: Path) -> None:
    for number in (1, 2, 4):
        (tmp_path / f"scan_{number}").touch()
    assert first_free(tmp_path, "scan_{}") == tmp_path / "scan_3"
