"""Measured occupied space for planning: voxels of a survey, or of a point cloud."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scancell.config.description import si_value
from scancell.config.material import Material
from scancell.config.scan import OccupiedDescription
from scancell.errors import DescriptionError
from scancell.files import atomic_write, require_file
from scancell.geometry.pose import transform_points
from scancell.geometry.voxels import VoxelGrid
from scancell.nominal.cell import OCCUPIED, Body, NominalCell
from scancell.reconstruction.cloud_files.read import read_cloud_file

Array = NDArray[np.float64]

_KIND = "scancell voxels 1"
_FRAMES = ("world", "table", "fixed")


def with_occupied_space(nominal: NominalCell, files: tuple[OccupiedDescription, ...]) -> NominalCell:
    """The cell with the occupied space of the files as bodies, which exist for planning only.

    Raises `DescriptionError` if a file is missing, of another kind, empty, or has values that are not finite.
    """
    made: list[Body] = []
    for item in files:
        made += occupied_bodies(_grids(item, nominal), nominal, first=len(made) + 1)
    return replace(nominal, bodies=(*nominal.bodies, *made)) if made else nominal


def occupied_bodies(grids: Mapping[str, VoxelGrid], nominal: NominalCell, first: int = 1) -> list[Body]:
    """Bodies of the grids by their frame, numbered from `first`: ``world``, ``table`` (turns), ``fixed``.

    ``fixed`` is the frame of the table at angle 0, which does not turn.
    """
    made: list[Body] = []
    for frame, grid in grids.items():
        if not grid.occupied.any():
            continue
        mesh = grid.surface()
        if frame == "fixed":
            mesh = mesh.transformed(nominal.world_from_table)
        made.append(
            Body(f"{OCCUPIED}{first + len(made)}]", "table" if frame == "table" else "world", mesh, Material(0.0))
        )
    return made


def _grids(item: OccupiedDescription, nominal: NominalCell) -> dict[str, VoxelGrid]:
    """Grids by frame: ``world``, ``table`` or ``fixed``."""
    path, inflation = Path(item.file), si_value(item, "inflate_mm")
    if path.suffix.lower() == ".npz" and _holds_voxels(path):
        return {frame: grid.inflated(inflation) for frame, grid in read_voxels(path).items()}
    points = read_cloud_file(path, item.unit).points
    frame, frame_from_points = {
        "world": ("world", np.eye(4)),
        "base": ("world", nominal.arm.world_from_base),
        "table": ("table", np.eye(4)),
        "part": ("table", nominal.table_from_part),
    }[item.frame]
    try:
        return {
            frame: VoxelGrid.around(transform_points(frame_from_points, points), si_value(item, "voxel_mm"), inflation)
        }
    except ValueError as error:
        raise DescriptionError(str(error), file=path) from None


def write_voxels(path: Path, grids: Mapping[str, VoxelGrid], **more: NDArray[np.generic]) -> None:
    """Write grids by frame, see `occupied_bodies`, and further arrays as NPZ, atomically.

    Raises `OutputError` if the file cannot be written.
    """
    arrays: dict[str, NDArray[np.generic]] = {"kind": np.array(_KIND), **more}
    for frame, grid in grids.items():
        arrays[f"{frame}_origin_mm"] = grid.origin * 1e3
        arrays[f"{frame}_spacing_mm"] = np.array(grid.spacing * 1e3)
        arrays[f"{frame}_occupied"] = grid.occupied
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def _holds_voxels(path: Path) -> bool:
    require_file(path)
    try:
        with np.load(path) as arrays:
            return "kind" in arrays
    except (OSError, ValueError, EOFError, MemoryError, BadZipFile) as error:
        raise DescriptionError(f"not a file of voxels or points (NPZ): {error}", file=path) from None


def read_voxels(path: Path) -> dict[str, VoxelGrid]:
    """Grids by frame from a file of `write_voxels`.

    Raises `DescriptionError` if it is of another kind, or its grids are not complete, finite and of three dimensions.
    """
    with np.load(path) as arrays:
        if str(arrays["kind"]) != _KIND:
            raise DescriptionError(file=path, key="kind", value=str(arrays["kind"]), expected=f"'{_KIND}'")
        found = [frame for frame in _FRAMES if f"{frame}_occupied" in arrays]
        if not found:
            raise DescriptionError(file=path, expected="an array world_occupied, table_occupied or fixed_occupied")
        return {frame: _grid(path, frame, arrays) for frame in found}


def _grid(path: Path, frame: str, arrays: Mapping[str, NDArray[np.generic]]) -> VoxelGrid:
    names = [f"{frame}_{key}" for key in ("origin_mm", "spacing_mm", "occupied")]
    missing = [name for name in names if name not in arrays]
    if missing:
        raise DescriptionError(f"lacks the array {missing[0]}", file=path)
    origin, spacing, occupied = (arrays[name] for name in names)
    if origin.shape != (3,) or not np.isfinite(np.asarray(origin, float)).all():
        raise DescriptionError(file=path, key=names[0], value=origin.tolist(), expected="3 finite numbers")
    if spacing.shape != () or not 0.0 < float(spacing) < np.inf:
        raise DescriptionError(file=path, key=names[1], value=spacing.tolist(), expected="a positive number")
    if occupied.ndim != 3 or occupied.dtype != np.bool_:
        shape = f"{occupied.dtype} of shape {occupied.shape}"
        raise DescriptionError(shape, file=path, key=names[2], expected="bool with three dimensions")
    return VoxelGrid(np.asarray(origin, float) / 1e3, float(spacing) / 1e3, np.asarray(occupied, bool))
