"""A run folder, or a zip file of one, opened for pictures: the cell, its motion, and its cloud."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from scancell.cell.recording import read_any_recording, read_exposure_times
from scancell.config.loading import Setup, load_resolved
from scancell.errors import DescriptionError
from scancell.files import split_solids
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell, as_estimated, nominal_cell, with_unknown_obstacles
from scancell.nominal.parts import load_part
from scancell.planning.plan import Plan
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import read_ply, read_ply_comments, transformed_columns
from scancell.views.motion import RunMotion, scan_motion

MOST_BYTES = 1 << 30  # of the files that are unpacked
MOST_RATIO, _ANY_RATIO = 50, 1 << 20  # of these files to the archive, beyond some bytes
MOST_SECONDS, MOST_MEMORY = 30, 3 << 29  # s of the processor and bytes in which a run must be read
MOST_FACES = 2_000_000  # of the part

# Files may be far larger when read than on disk, such as tables of equal values: only reading them shows it.
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
_FILES = {_START, "manifest.json", "recording.parquet", "motion.parquet", "plan.json", "cloud.ply"}
_PART = re.compile(r"\w[\w .+-]*\.(stl|obj|ply|toml)", re.IGNORECASE)


@dataclass(frozen=True)
class RecordedRun:
    """Content of a run folder.

    Attributes
    ----------
    name
        File name of the part.
    setup, cell
        Nominal descriptions, and the cell with all its obstacles.
    motion
        Poses at any time.
    cloud
        Points of the part in the part frame, in the order of their time, thinned; None where there is no cloud.ply.
    cloud_points
        Number of points in the file.
    """

    name: str
    setup: Setup
    cell: NominalCell
    motion: RunMotion
    cloud: Cloud | None
    cloud_points: int

    @property
    def part(self) -> Mesh | None:
        """The part; None on an empty table."""
        return self.cell.part if any(body.moves_with == "part" for body in self.cell.bodies) else None


def open_run(folder: str | Path, most_points: int = 200_000) -> RecordedRun:
    """Read a run folder that `scancell scan`, `rerun`, `render`, `reconstruct` or `run` wrote.

    Where the file of the part is missing, one of this name in the folder is read.

    Parameters
    ----------
    most_points
        Points of the cloud that are kept at most, evenly chosen.

    Raises
    ------
    ScancellError
        Naming the file that is missing or wrong, and what was expected.
    """
    folder = Path(folder)
    if not (folder / "resolved.toml").is_file():
        raise DescriptionError(file=folder, expected="a run folder with resolved.toml and recording.parquet")
    setup, made = load_resolved(folder / _START)
    for key in ("part", "unit"):
        if not isinstance(made.get(key), str):
            raise DescriptionError(
                file=folder / _START, key=f"run.{key}", value=made.get(key), expected="a text, as of a scan or program"
            )
    nominal = nominal_cell(setup.cell, _part(folder, made))
    if setup.scan.belt is not None:
        nominal = nominal.on_belt()
    cell, estimated = with_unknown_obstacles(nominal, setup.cell), as_estimated(nominal, setup.cell)
    motion = (_motion_of_program if "program" in made else _motion_of_scan)(folder, cell)
    cloud, count = _cloud(folder / "cloud.ply", estimated, most_points)
    return RecordedRun(Path(made["part"] or folder).name, setup, cell, motion, cloud, count)


def _motion_of_scan(folder: Path, cell: NominalCell) -> RunMotion:
    file = folder / "recording.parquet"
    recording = read_any_recording(file)
    plan = Plan.load(folder / "plan.json") if (folder / "plan.json").is_file() else None
    if plan is not None:
        plan.require_joints(len(cell.home))
    with _naming(file):
        return scan_motion(cell, recording, plan)


def _motion_of_program(folder: Path, cell: NominalCell) -> RunMotion:
    file = folder / "motion.parquet"
    recording = read_any_recording(file)
    exposures = read_exposure_times(folder / "recording.parquet")
    with _naming(file):
        return RunMotion(cell, recording, None, exposures)


@contextmanager
def _naming(file: Path) -> Iterator[None]:
    """Errors name the file."""
    try:
        yield
    except DescriptionError as error:
        raise DescriptionError(str(error), file=file) from None


def _part(folder: Path, made: dict[str, Any]) -> Mesh | None:
    """The part, from the folder where its own file is missing; None of a run without one."""
    if not made["part"]:
        return None
    file = Path(made["part"])
    beside = folder / file.name
    is_moved = split_solids(beside)[0].is_file() and not split_solids(file)[0].is_file()
    return load_part(beside if is_moved else file, made["unit"])


def _cloud(path: Path, cell: NominalCell, most: int) -> tuple[Cloud | None, int]:
    """The thinned cloud in the part frame, from any frame of the file, and the number of points there.

    The cell is the one that reconstruction assumed, as it was estimated.
    """
    if not path.is_file():
        return None, 0
    frame = next((note.split()[1] for note in read_ply_comments(path) if note.startswith("frame ")), "part")
    placed = cell.tree.place(cell.start, ["part", cell.support, "base", "world"])
    world_from_part = placed["part"]
    world_from_frame = {**placed, cell.support_kind: placed[cell.support]}
    if frame not in world_from_frame:
        raise DescriptionError(file=path, key="frame", value=frame, expected=", ".join(world_from_frame))
    whole = read_ply(path)
    cloud = whole[:: max(1, -(-len(whole) // most))]
    cloud = cloud[np.argsort(cloud.time, kind="stable")]
    if frame != "part":
        cloud = transformed_columns(cloud, pose.inverse(world_from_part) @ world_from_frame[frame])
    return cloud, len(whole)


def open_archive(content: bytes, name: str, most_bytes: int = MOST_BYTES) -> RecordedRun:
    """Read a run from a zip file of its folder.

    Only files that `open_run` reads are unpacked, into a temporary folder under names of their own: no path of the
    archive is followed. A mesh or artefact beside them is the part where the file that the run names is missing.

    Parameters
    ----------
    name
        Name of the file, for messages.
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
    last_line = done.stderr.strip().rpartition("\n")[2]
    if last_line.startswith("scancell: "):
        raise DescriptionError(last_line.removeprefix("scancell: ").replace(f"{folder}/", f"{name}: "))
    raise DescriptionError(
        f"it cannot be read within {seconds} s of processor time and {memory / 1e6:.0f} MB of memory", file=name
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
