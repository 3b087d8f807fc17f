"""Foreign points: points on neighbouring bodies, found from the nominal geometry of these bodies.

A point is foreign if it lies inside a neighbour or within a tolerance of its surface. The distance to the scanned part
is not used, so that no measurement error can be removed as foreign. Where a neighbour touches or nearly touches the
part, the two are indistinguishable: points in this contact zone are assigned to the part. The zone follows from the
nominal poses of both meshes alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell
from scancell.sensor import closest_points

Array = NDArray[np.float64]

TOLERANCE = 1e-3  # m: more than as-built errors move points, less than parts stand apart
_CONTACT = 1.5  # tolerances between surfaces of neighbour and part up to which points count as the part's


@dataclass(frozen=True)
class Neighbour:
    """A body beside the part; `mesh` is in the frame of the part's support with the axes at 0, m.

    `rides`: whether it moves with the support.
    """

    name: str
    mesh: Mesh
    rides: bool


@dataclass(frozen=True)
class Neighbours:
    """Nominal bodies around the scanned part, the part itself, and the distance (m) that tells them apart.

    The part rests on its support at `support_from_part` (4, 4); the support turns about its z or `slides` along its x
    with the axis in the column `axis` of the positions of axes.
    """

    bodies: tuple[Neighbour, ...]
    part: Mesh
    support_from_part: Array
    axis: int
    slides: bool = False
    tolerance: float = TOLERANCE

    def moved(self, points: Array, position: Array) -> Array:
        """Points (n, 3) of the support moved with it by positions (n,) of its axis, rad or m."""
        if self.slides:
            return np.asarray(points + position[:, None] * np.array([1.0, 0.0, 0.0]))
        return _turned(points, position)

    @cached_property
    def part_on_support(self) -> Mesh:
        """The scanned part, used only to find where neighbours touch it."""
        return self.part.transformed(self.support_from_part)


def neighbours_of(nominal: NominalCell) -> Neighbours:
    """Bodies that stand in the cell, without the arm and the part's support (which the envelope removes).

    Where other axes than that of the support move them, they are where they start.
    """
    frames, tree = nominal.frame_poses(nominal.home), nominal.tree
    support_from_world, (axis,) = pose.inverse(nominal.world_from(nominal.support)), tree.axes_of(nominal.support)
    support = "table" if nominal.support == "table" else nominal.required_belt().name
    bodies = tuple(
        Neighbour(
            body.name,
            body.mesh.transformed(support_from_world @ frames[body.moves_with]),
            tree.axes_of(body.moves_with) == (axis,),
        )
        for body in nominal.bodies
        if body.name not in ("part", support) and body.moves_with.partition("[")[0] in ("world", "table", "part")
    )
    slides = tree[nominal.support].kind == "prismatic"
    return Neighbours(bodies, nominal.part, nominal.support_from_part, tree.axes.index(axis), slides)


def foreign_points(points_on_support: Array, position: Array, neighbours: Neighbours) -> NDArray[np.int64]:
    """Number (n,) of the neighbour that each point lies on, -1 for none.

    Parameters
    ----------
    points_on_support
        (n, 3) in the frame that moves with the part's support, m.
    position
        (n,) measured position of the support's axis at each point, rad or m.
    """
    owner = np.full(len(points_on_support), -1, np.int64)
    tolerance = neighbours.tolerance
    for number, rows, points in _candidates(points_on_support, position, neighbours):
        body = neighbours.bodies[number]
        nearest, _, signed = closest_points(body.mesh.vertices, body.mesh.faces.astype(np.uint32), points)
        inside = (np.asarray(signed) < 0.0) & body.mesh.is_closed
        on_it = np.flatnonzero(inside | (np.abs(signed) <= tolerance))
        place = np.asarray(nearest)[on_it]
        if not body.rides:
            place = neighbours.moved(place, -position[rows[on_it]])
        contact = _nearer(place, neighbours.part_on_support, _CONTACT * tolerance)
        owner[rows[on_it[~contact]]] = number
    return owner


def _candidates(
    points: Array, position: Array, neighbours: Neighbours
) -> Iterator[tuple[int, NDArray[np.int64], Array]]:
    """Number of each neighbour with points in its bounding box, their rows, and the points in the frame of its mesh."""
    if not len(points):
        return
    height, radius = points[:, 2], np.hypot(points[:, 0], points[:, 1])
    margin = np.array([[-neighbours.tolerance], [neighbours.tolerance]])
    for number, body in enumerate(neighbours.bodies):
        low, high = body.mesh.bounds + margin
        from_axis = 0.0 if neighbours.slides else np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)[:2])
        rows = np.flatnonzero((radius >= from_axis) & (height >= low[2]) & (height <= high[2]))
        placed = points[rows] if body.rides else neighbours.moved(points[rows], position[rows])
        inside = ((placed >= low) & (placed <= high)).all(1)
        if inside.any():
            yield number, rows[inside], placed[inside]


def _turned(points: Array, angle: Array) -> Array:
    """Points (n, 3) turned about z by angles (n,)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = points.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], 1)


def _nearer(points: Array, mesh: Mesh, distance: float) -> NDArray[np.bool_]:
    """Whether points (n, 3) are nearer than `distance` to a mesh."""
    low, high = mesh.bounds + np.array([[-distance], [distance]])
    near = ((points >= low) & (points <= high)).all(1)
    if near.any():
        near[near] = np.abs(closest_points(mesh.vertices, mesh.faces.astype(np.uint32), points[near])[2]) <= distance
    return np.asarray(near)
