"""Tables of columns for files, and files that cannot be read."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import scancell
from scancell.calibration.measured_table import MeasuredTable, read_profiles
from scancell.cell.fmu_info import describe_fmu
from scancell.cell.recording import read_table
from scancell.config.files import read_toml
from scancell.config.table_format import shipped_formats
from scancell.config.urdf import read_urdf
from scancell.files import arrow_table, atomic_write, read_json
from scancell.output.image_files import read_index
from scancell.planning.views.sensor_paths import recorded_poses
from scancell.programs.taught import TaughtFile
from scancell.reconstruction.cloud_files.formats import read_npz
from scancell.reconstruction.cloud_files.read import read_cloud_file
from scancell.recorded.reconstruct import read_calibration


@pytest.mark.parametrize("dtype", ["u1", "u4", "i4", "i8", "f4", "f8"])
def test_table_equals_that_of_pyarrow(dtype: str) -> None:
    rng = np.random.default_rng(3)
    columns = {name: rng.uniform(0, 200, (50, 2)).astype(dtype) for name in ("a", "b")}
    strided = {name: values[::2, 1] for name, values in columns.items()}
    if dtype.startswith("f"):
        strided["a"][3] = np.nan
    found, expected = arrow_table(strided), pa.table({name: pa.array(values) for name, values in strided.items()})
    assert found.schema == expected.schema
    assert all(np.array_equal(found[name], expected[name], equal_nan=True) for name in strided)
    assert found["a"].null_count == 0
    assert arrow_table({"a": strided["a"][:0]}).num_rows == 0


def test_pandas_is_not_imported() -> None:
    program = (
        "import sys, numpy; from scancell.files import arrow_table; arrow_table({'a': numpy.zeros(3)});"
        " sys.exit('pandas' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def named(path: Path, suffix: str) -> Path:
    """A link to the path, with a name that ends with the suffix."""
    link = path.with_name(f"link{suffix}")
    link.symlink_to(path)
    return link


# What may hang a reader, or end it with an error that names no file. To read /proc/kmsg is to wait for the kernel.
UNREADABLE = ["pipe", "/dev/zero", "folder", "/proc/kmsg", "deep", "digits", "latin", "zero bytes"]
READERS: dict[str, Callable[[Path], object]] = {
    "toml": read_toml,
    "json": read_json,
    "plan": scancell.Plan.load,
    "calibration": read_calibration,
    "yaml": lambda path: MeasuredTable(named(path, ".yaml")),
    "urdf": lambda path: read_urdf(path, "tip"),
    "recording": lambda path: read_table(named(path, ".parquet")),
    "table": lambda path: read_table(named(path, ".csv")),
    "poses": recorded_poses,
    "mesh": lambda path: scancell.load_part(named(path, ".stl")),
    "obj": lambda path: scancell.load_part(named(path, ".obj")),
    "points": lambda path: read_cloud_file(named(path, ".xyz")),
    "npz": lambda path: read_cloud_file(named(path, ".npz")),
    "index": read_index,
    "archive": read_npz,
    "taught program": lambda path: TaughtFile(path).program.steps,
    "fmu": describe_fmu,
}


@pytest.mark.parametrize("content", UNREADABLE)
@pytest.mark.parametrize("reader", READERS)
def test_readers_refuse_what_is_no_file_of_theirs_by_name(tmp_path: Path, reader: str, content: str) -> None:
    path = tmp_path / "file"
    match content:
        case "pipe":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case "deep":
            path.write_text("a = " * (reader == "toml") + "[" * 200_000)
        case "digits":
            path.write_text(f"a = {'9' * 5000}" if reader == "toml" else f"[{'9' * 5000}]")
        case "latin":
            path.write_bytes("name = 'Prüfkörper'".encode("latin-1"))
        case "zero bytes":
            path.write_bytes(bytes(100))
        case device:
            path.symlink_to(device)
    try:
        assert not READERS[reader](path)  # a file of size 0 is read as empty
    except scancell.ScancellError as error:
        assert re.search(r"\b(file|link)\b", str(error))


# Texts whose reading took a time that grows with the square of their length, which is hours for these.
REPEATED = {
    "points": ("", "["),
    "table": ("", "("),
    "sequence": ("", "a"),
    "mesh": ("solid a\n", "end solid facet "),
}


@pytest.mark.parametrize("reader", REPEATED)
def test_repeated_text_is_refused(tmp_path: Path, reader: str) -> None:
    begin, text = REPEATED[reader]
    (tmp_path / "file").write_text(begin + text * (10_000_000 // len(text)))
    with pytest.raises(scancell.ScancellError):
        {**READERS, "sequence": lambda path: read_profiles(path, shipped_formats()["opencv_yaml"])}[reader](
            tmp_path / "file"
        )


def test_threads_that_write_one_file_leave_one_of_their_contents(tmp_path: Path) -> None:
    file, texts = tmp_path / "table.csv", [letter * 200_000 for letter in "abcd"]

    def write(text: str) -> None:
        for _ in range(10):
            with atomic_write(file) as temporary:
                temporary.write_text(text)
            assert file.read_text() in texts

    with ThreadPoolExecutor(len(texts)) as pool:
        list(pool.map(write, texts))
    assert os.listdir(tmp_path) == ["table.csv"]
