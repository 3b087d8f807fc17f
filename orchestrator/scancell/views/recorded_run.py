"""A run folder opened for pictures: the cell, its motion, and its cloud."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scancell.cell.recording import read_recording
from scancell.config.loading import Setup, load_resolved
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, nominal_cell, with_unknown_obstacles
from scancell.nominal.parts import load_part
from scancell.planning.plan import Plan
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import read_ply, read_ply_comments, transformed_columns
from scancell.views.motion import RunMotion


@dataclass(frozen=True)
class RecordedRun:
    """What a run folder says.

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


def open_run(folder: str | Path, most_points: int = 200_000) -> RecordedRun:
    """Read a run folder that `scancell scan`, `rerun` or `render` wrote.

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
    setup, made = load_resolved(folder / "resolved.toml")
    file = Path(made["part"])
    beside = folder / file.name
    part = load_part(beside if beside.is_file() and not file.is_file() else file, made["unit"])
    cell = with_unknown_obstacles(nominal_cell(setup.cell, part), setup.cell)
    recording = read_recording(folder / "recording.parquet")
    plan = Plan.load(folder / "plan.json") if (folder / "plan.json").is_file() else None
    try:
        motion = RunMotion(cell, recording, None if plan is None else plan.program)
    except DescriptionError as error:
        raise DescriptionError(str(error), file=folder / "recording.parquet") from None
    cloud, count = _cloud(folder / "cloud.ply", cell, most_points)
    return RecordedRun(Path(made["part"]).name, setup, cell, motion, cloud, count)


def _cloud(path: Path, cell: NominalCell, most: int) -> tuple[Cloud | None, int]:
    """The thinned cloud in the part frame, whichever frame its file is in, and the number of points there."""
    if not path.is_file():
        return None, 0
    frame = next((note.split()[1] for note in read_ply_comments(path) if note.startswith("frame ")), "part")
    world_from_frame = {
        "part": cell.world_from_part(0.0),
        "table": cell.world_from_table,
        "base": cell.arm.world_from_base,
        "world": np.eye(4),
    }
    if frame not in world_from_frame:
        raise DescriptionError(file=path, key="frame", value=frame, expected=", ".join(world_from_frame))
    whole = read_ply(path)
    cloud = whole[:: max(1, -(-len(whole) // most))]
    cloud = cloud[np.argsort(cloud.time, kind="stable")]
    if frame != "part":
        cloud = transformed_columns(cloud, pose.inverse(cell.world_from_part(0.0)) @ world_from_frame[frame])
    return cloud, len(whole)
