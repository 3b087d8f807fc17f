"""Run folders that come as zip files."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from scancell.errors import DescriptionError
from scancell.views.recorded_run import RecordedRun, open_run

MOST_BYTES = 1 << 30  # of the files that are unpacked
MOST_RATIO, _ANY_RATIO = 50, 1 << 20  # of these files to the archive, beyond some bytes
MOST_SECONDS, MOST_MEMORY = 30, 3 << 29  # s of the processor and bytes in which a run must be read
MOST_FACES = 2_000_000  # of the part

# Files may hold far more than their size says, as tables of equal values do: only reading them shows it.
_READ = """import resource, sys
limits = resource.RLIMIT_CPU, resource.RLIMIT_DATA
for limit, most in zip(limits, map(int, sys.argv[2:])):
    resource.setrlimit(limit, (most, most))
from scancell.errors import ScancellError
from scancell.views.recorded_run import open_run
try:
    open_run(sys.argv[1])
except ScancellError as error:
    sys.exit(f"scancell: {error}")
"""

_START = "resolved.toml"
_FILES = {_START, "recording.parquet", "plan.json", "cloud.ply"}
_PART = re.compile(r"\w[\w .+-]*\.(stl|obj|ply|toml)", re.IGNORECASE)


def open_archive(content: bytes, name: str, most_bytes: int = MOST_BYTES) -> RecordedRun:
    """Read a run from a zip file of its folder.

    Only files that `open_run` reads are unpacked, into a temporary folder under names of their own: no path of the
    archive is followed. A mesh or artefact beside them is the part where the file that the run names is missing.

    Parameters
    ----------
    name
        Of the file, for messages.
    most_bytes
        Largest size of these files.

    Raises
    ------
    ScancellError
        If it is no such archive, or too large, or the run cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="scancell-run-") as folder:
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                _unpack(archive, name, Path(folder), most_bytes)
        except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:  # the last two: encrypted
            raise DescriptionError(str(error), file=name, expected="a zip file of a run folder") from None
        require_readable(Path(folder), name)
        run = open_run(folder)
    if (faces := len(run.cell.part.faces)) > MOST_FACES:
        raise DescriptionError(f"a part of {faces} faces", file=name, expected=f"at most {MOST_FACES}")
    return run


def require_readable(folder: Path, name: str, seconds: int = MOST_SECONDS, memory: int = MOST_MEMORY) -> None:
    """Read a run in a process of its own, within limits of time (s) and memory (bytes).

    Raises
    ------
    DescriptionError
        If that fails.
    """
    words = [sys.executable, "-c", _READ, str(folder), str(seconds), str(memory)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return
    said = done.stderr.strip().rpartition("\n")[2]
    if said.startswith("scancell: "):
        raise DescriptionError(said.removeprefix("scancell: ").replace(f"{folder}/", f"{name}: "))
    raise DescriptionError(
        f"it cannot be read within {seconds} s of the processor and {memory / 1e6:.0f} MB of memory", file=name
    )


def _unpack(archive: zipfile.ZipFile, name: str, folder: Path, most: int) -> None:
    entries = [entry for entry in archive.infolist() if not entry.is_dir()]
    starts = [PurePosixPath(entry.filename) for entry in entries if PurePosixPath(entry.filename).name == _START]
    if len(starts) != 1:
        raise DescriptionError(f"found {len(starts)} {_START}", file=name, expected="the zip file of one run folder")
    wanted = {}
    for entry in entries:
        path = PurePosixPath(entry.filename)
        if path.parent == starts[0].parent and (path.name in _FILES or _PART.fullmatch(path.name)):
            wanted[path.name] = entry
    size = sum(entry.file_size for entry in wanted.values())
    if size > most:
        raise DescriptionError(f"{size / 1e6:.0f} MB unpacked", file=name, expected=f"at most {most / 1e6:.0f} MB")
    packed = sum(entry.compress_size for entry in wanted.values())
    if size > _ANY_RATIO + MOST_RATIO * packed:
        raise DescriptionError(
            f"{size / 1e6:.1f} MB in {packed / 1e6:.1f} MB",
            file=name,
            expected=f"at most {MOST_RATIO} times as much",
        )
    for file, entry in wanted.items():
        (folder / file).write_bytes(archive.read(entry))  # at most `file_size`, else an error
