"""Zip files of run folders: which files are unpacked, where to, and what is refused."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from scancell.cell.recording import INTEGER_COLUMNS, RecordLayout
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import DescriptionError
from scancell.files import first_free
from scancell.output.run_folder import resolved_toml
from scancell.views import recorded_run

PART = assets_dir() / "parts" / "step_block.stl"
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

    def open_run(folder: str) -> Any:
        found.append({path.name: path.read_bytes() for path in Path(folder).iterdir()})
        return SimpleNamespace(cell=SimpleNamespace(part=SimpleNamespace(faces=[])))

    monkeypatch.setattr(recorded_run, "open_run", open_run)
    monkeypatch.setattr(recorded_run, "require_readable", lambda *_: None)
    return found


@pytest.mark.parametrize("root", ["", "run/", "deep/er/", "../", "/etc/"])
def test_files_of_the_run_alone_are_unpacked_whatever_their_folder(root: str, opened: list[dict[str, bytes]]) -> None:
    others = {f"{root}images/1.png": b"x", f"{root}report.json": b"x", "other/cloud.ply": b"x", f"{root}run.py": b"x"}
    recorded_run.open_archive(zipped({f"{root}{name}": name.encode() for name in UNPACKED} | others), "run.zip")
    assert opened == [{name: name.encode() for name in UNPACKED}]


@pytest.mark.parametrize("name", ["../../escaped.stl", "..\\escaped.stl", "/tmp/escaped.stl", ".hidden.stl", "a:b.stl"])
def test_no_path_of_the_archive_is_followed(name: str, opened: list[dict[str, bytes]]) -> None:
    recorded_run.open_archive(zipped({"resolved.toml": b"", name: b"x"}), "run.zip")
    assert opened == [{"resolved.toml": b""}]


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ({"most_bytes": 1_000_000}, r"run.zip: 10 MB unpacked; expected at most 1 MB"),
        ({}, r"run.zip: 10.0 MB in 0.0 MB; expected at most 50 times as much"),
    ],
)
def test_large_archives_are_refused_before_they_are_unpacked(limit, message: str, opened: list[Any]) -> None:
    content = zipped({"resolved.toml": b"", "cloud.ply": bytes(10_000_000)})
    assert len(content) < 100_000
    with pytest.raises(DescriptionError, match=message):
        recorded_run.open_archive(content, "run.zip", **limit)
    assert opened == []


def test_run_that_takes_too_much_memory_or_time_is_refused(tmp_path: Path) -> None:
    """A table of equal values is small in its file and large in memory."""
    setup = load_setup()
    (tmp_path / "resolved.toml").write_text(resolved_toml(setup, {"part": str(PART), "unit": "mm"}))
    layout = RecordLayout()
    columns = (*INTEGER_COLUMNS, *layout.measured, *layout.truth)
    values = pa.array(np.ones(2_000_000))
    pyarrow.parquet.write_table(pa.table(dict.fromkeys(columns, values)), tmp_path / "recording.parquet")
    assert (tmp_path / "recording.parquet").stat().st_size < 2_000_000
    with pytest.raises(DescriptionError, match=r"run.zip: it cannot be read within 30 s .* and 1611 MB of memory"):
        recorded_run.require_readable(tmp_path, "run.zip")
    with pytest.raises(DescriptionError, match=r"run.zip: it cannot be read within 1 s"):
        recorded_run.require_readable(tmp_path, "run.zip", seconds=1, memory=1 << 40)


def test_errors_name_the_archive_and_no_path_of_the_server() -> None:
    with pytest.raises(DescriptionError, match=r"^run.zip: resolved.toml") as refused:
        recorded_run.open_archive(zipped({"resolved.toml": b"x = ["}), "run.zip")
    assert "scancell-run-" not in str(refused.value)


def test_what_is_no_archive_of_a_run_is_refused() -> None:
    whole = zipped({"resolved.toml": b"x" * 1000})
    broken = whole[:30] + b"????" + whole[34:]
    for content in (b"", b"not a zip file", whole[: len(whole) // 2], broken):
        with pytest.raises(DescriptionError, match=r"run.zip: .*; expected a zip file"):
            recorded_run.open_archive(content, "run.zip")
    for files in ({"cloud.ply": b""}, {"a/resolved.toml": b"", "b/resolved.toml": b""}):
        with pytest.raises(DescriptionError, match=r"expected the zip file of one run folder"):
            recorded_run.open_archive(zipped(files), "run.zip")


def test_first_free_name(tmp_path: Path) -> None:
    for number in (1, 2, 4):
        (tmp_path / f"scan_{number}").touch()
    assert first_free(tmp_path, "scan_{}") == tmp_path / "scan_3"
