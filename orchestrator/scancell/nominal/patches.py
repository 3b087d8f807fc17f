"""Pieces of a part with materials of their own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.config.cell import MaterialRegionDescription, PartDescription
from scancell.config.material import Material
from scancell.errors import CellError
from scancell.files import require_file
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeMesh


@dataclass(frozen=True)
class Patch:
    """Faces (n,) of a mesh that have a material of their own."""

    faces: NDArray[np.int64]
    material: Material


def part_patches(part: Mesh, description: PartDescription) -> tuple[Patch, ...]:
    """Patches of the part, none of them empty or overlapping.

    Raises `CellError` if the file of face materials cannot be read or does not fit the mesh, or the part has no faces.
    """
    regions = description.material_region
    if isinstance(part, ShapeMesh):
        if regions or description.face_materials is not None:
            raise CellError(
                "an artefact has one material, that of the part", file=part.source, key="part.material_region"
            )
        return ()
    number = np.zeros(len(part.faces), np.int64)
    middle_mm = part.vertices[part.faces].mean(axis=1) * 1e3
    for i, region in enumerate(regions, 1):
        if region.min_mm is not None or region.max_mm is not None:
            number[_inside(middle_mm, region)] = i
    if description.face_materials is not None:
        listed = _read_numbers(Path(description.face_materials), len(part.faces), len(regions))
        number = np.where(listed > 0, listed, number)
    patches = [Patch(np.flatnonzero(number == i), region.material.resolved()) for i, region in enumerate(regions, 1)]
    return tuple(patch for patch in patches if len(patch.faces))


def _inside(middle_mm: NDArray[np.float64], region: MaterialRegionDescription) -> NDArray[np.bool_]:
    low = np.full(3, -np.inf) if region.min_mm is None else np.array(region.min_mm)
    high = np.full(3, np.inf) if region.max_mm is None else np.array(region.max_mm)
    return np.asarray(((middle_mm >= low) & (middle_mm <= high)).all(axis=1))


def _read_numbers(path: Path, faces: int, regions: int) -> NDArray[np.int64]:
    try:
        require_file(path, CellError)
        values = np.load(path) if path.suffix == ".npy" else np.loadtxt(path, delimiter=",", ndmin=1)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise CellError(f"cannot be read as numbers: {error}", file=path, key="part.face_materials") from None
    if values.shape != (faces,):
        raise CellError(f"{values.size} numbers for a mesh of {faces} faces", file=path, key="part.face_materials")
    if not np.isin(values, np.arange(regions + 1)).all():
        raise CellError(
            file=path, key="part.face_materials", expected=f"0 or the number of a material_region, 1 to {regions}"
        )
    return values.astype(np.int64)
