"""Surfaces of artefacts for calibration: exact shapes, or the mesh of any part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.calibration.cell.problem import Surface
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeGroup, ShapeMesh

Array = NDArray[np.float64]

REACH = 5e-3  # m: points farther from the nominal surface are not the artefact's
_EDGE = 0.7e-3  # m: points nearer to two shapes than this belong to neither
_COARSE = 1e-4  # m: chord error of surfaces from which targets are sampled


def surface_of(part: Mesh) -> Surface:
    """The measured surfaces of a part."""
    return MeasuredShapes(part.shapes) if isinstance(part, ShapeMesh) else MeasuredMesh(part)


def measured_meshes(part: Mesh) -> list[Mesh]:
    """A coarse mesh of each measured surface, in the part frame."""
    if not isinstance(part, ShapeMesh):
        return [part]
    return [one.shape.mesh(_COARSE).transformed(one.frame_from_shape) for one in part.shapes.measured]


def distances_to(part: Mesh, points: Array) -> Array:
    """Distances (n,) of points (n, 3) in the part frame from its nearest surface, supports included, m."""
    if isinstance(part, ShapeMesh):
        return np.abs(part.shapes.nearest(points)[0])
    return np.abs(sensor_rt.MeshSurface(part.vertices, part.faces).signed_distances(points)[0])


@dataclass(frozen=True)
class MeasuredShapes:
    """Shapes, see `Surface`: supports, edges and points beyond `REACH` are not used."""

    group: ShapeGroup

    def assign(self, points: Array) -> NDArray[np.intp]:
        """See `Surface.assign`."""
        signed, _, number = self.group.nearest(points)
        usable = np.array([one.role == "measured" for one in self.group.shapes])[number] & (np.abs(signed) < REACH)
        for other, placed in enumerate(self.group.shapes):
            usable &= (number == other) | (np.abs(placed.nearest(points)[0]) > _EDGE)
        return np.where(usable, number, -1)

    def distance(self, points: Array, shape: NDArray[np.intp]) -> tuple[Array, Array]:
        """See `Surface.distance`."""
        signed, normal = np.zeros(len(points)), np.zeros((len(points), 3))
        for number, placed in enumerate(self.group.shapes):
            rows = np.flatnonzero(shape == number)
            signed[rows], normal[rows] = placed.nearest(points[rows])
        return signed, normal


class MeasuredMesh:
    """A mesh, see `Surface`: points beyond `REACH` are not used."""

    def __init__(self, mesh: Mesh) -> None:
        self._surface = sensor_rt.MeshSurface(mesh.vertices, mesh.faces)
        self._normals = mesh.normals

    def assign(self, points: Array) -> NDArray[np.intp]:
        """See `Surface.assign`."""
        return np.where(np.abs(self._surface.signed_distances(points)[0]) < REACH, 0, -1)

    def distance(self, points: Array, shape: NDArray[np.intp]) -> tuple[Array, Array]:
        """See `Surface.distance`; the normal is that of the closest face."""
        signed, face = self._surface.signed_distances(points)
        return signed, self._normals[face]
