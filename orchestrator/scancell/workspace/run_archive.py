"""Run folders that come as zip files."""

from __future__ import annotations

import io
import re
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from scancell.errors import DescriptionError
from scancell.workspace.recorded_run import RecordedRun, open_run

MOST_BYTES = 1 << 30  # of the files that are unpacked

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
            raise DescriptionError(f"{name}: expected a zip file of a run folder: {error}") from None
        return open_run(folder)


def _unpack(archive: zipfile.ZipFile, name: str, folder: Path, most: int) -> None:
    entries = [entry for entry in archive.infolist() if not entry.is_dir()]
    starts = [PurePosixPath(entry.filename) for entry in entries if PurePosixPath(entry.filename).name == _START]
    if len(starts) != 1:
        raise DescriptionError(f"{name}: expected the zip file of one run folder, found {len(starts)} {_START}")
    wanted = {}
    for entry in entries:
        path = PurePosixPath(entry.filename)
        if path.parent == starts[0].parent and (path.name in _FILES or _PART.fullmatch(path.name)):
            wanted[path.name] = entry
    size = sum(entry.file_size for entry in wanted.values())
    if size > most:
        raise DescriptionError(f"{name}: {size / 1e6:.0f} MB unpacked: expected at most {most / 1e6:.0f} MB")
    for file, entry in wanted.items():
        (folder / file).write_bytes(archive.read(entry))  # at most `file_size`, else an error
