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
    """A body beside the part; `mesh` is in the frame of the table at angle 0, or of the belt at travel 0, m.

    `on_table`: whether it turns with the table, or moves with the belt.
    """

    name: str
    mesh: Mesh
    on_table: bool


@dataclass(frozen=True)
class Neighbours:
    """Nominal bodies around the scanned part, the part itself, and the distance (m) that tells them apart.

    `on_belt`: whether a belt carries the part; then `table_from_part` is its pose on the belt, and travels of the belt
    (m) replace the angles of the table.
    """

    bodies: tuple[Neighbour, ...]
    part: Mesh
    table_from_part: Array
    tolerance: float = TOLERANCE
    on_belt: bool = False

    def moved(self, points: Array, travel: Array) -> Array:
        """Points (n, 3) moved by the table about its axis by angles (n,), or by the belt along x by travels (n,)."""
        if self.on_belt:
            return np.asarray(points + travel[:, None] * np.array([1.0, 0.0, 0.0]))
        return _turned(points, travel)

    @cached_property
    def part_in_table(self) -> Mesh:
        """The scanned part, used only to find where neighbours touch it."""
        return self.part.transformed(self.table_from_part)


def neighbours_of(nominal: NominalCell) -> Neighbours:
    """Bodies that stand in the cell, without the arm and the table (which the envelope removes).

    A part on a belt is where it starts.
    """
    frames = nominal.frame_poses(nominal.home, np.array(0.0))
    table_from_world = pose.inverse(frames["table"])
    riding = {f"part[{i}]" for i, further in enumerate(nominal.further_parts, start=2) if further.carrier == "table"}
    bodies = tuple(
        Neighbour(
            body.name,
            body.mesh.transformed(table_from_world @ frames[body.moves_with]),
            body.moves_with in riding | {"table"},
        )
        for body in nominal.bodies
        if body.name not in ("part", "table") and body.moves_with.partition("[")[0] in ("world", "table", "part")
    )
    return Neighbours(bodies, nominal.part, nominal.table_from_part)


def neighbours_on_belt(nominal: NominalCell) -> Neighbours:
    """Bodies beside the belt of a part and on it, without the arm and the belt itself (which the envelope removes).

    Further parts on the belt move with it; the table is at angle 0.
    """
    belt = nominal.required_belt()
    frames = nominal.frame_poses(nominal.home, np.array(0.0))
    belt_from_world = pose.inverse(belt.world_from_belt)
    riding = {
        f"part[{i}]"
        for i, further in enumerate(nominal.further_parts, start=2)
        if further.description.conveyor == belt.conveyor
    }
    bodies = tuple(
        Neighbour(
            body.name, body.mesh.transformed(belt_from_world @ frames[body.moves_with]), body.moves_with in riding
        )
        for body in nominal.bodies
        if body.name not in ("part", belt.name) and body.moves_with.partition("[")[0] in ("world", "table", "part")
    )
    return Neighbours(bodies, nominal.part, belt.belt_from_part, on_belt=True)


def foreign_points(points_in_table: Array, table_angle: Array, neighbours: Neighbours) -> NDArray[np.int64]:
    """Number (n,) of the neighbour that each point lies on, -1 for none.

    Parameters
    ----------
    points_in_table
        (n, 3) in the frame that turns with the table, or moves with the belt, m.
    table_angle
        (n,) measured angle of the table, rad, or travel of the belt, m, at each point.
    """
    owner = np.full(len(points_in_table), -1, np.int64)
    tolerance = neighbours.tolerance
    for number, rows, points in _candidates(points_in_table, table_angle, neighbours):
        body = neighbours.bodies[number]
        nearest, _, signed = closest_points(body.mesh.vertices, body.mesh.faces.astype(np.uint32), points)
        inside = (np.asarray(signed) < 0.0) & body.mesh.is_closed
        on_it = np.flatnonzero(inside | (np.abs(signed) <= tolerance))
        place = np.asarray(nearest)[on_it]
        if not body.on_table:
            place = neighbours.moved(place, -table_angle[rows[on_it]])
        contact = _nearer(place, neighbours.part_in_table, _CONTACT * tolerance)
        owner[rows[on_it[~contact]]] = number
    return owner


def _candidates(points: Array, angle: Array, neighbours: Neighbours) -> Iterator[tuple[int, NDArray[np.int64], Array]]:
    """Number of each neighbour with points in its bounding box, their rows, and the points in the frame of its mesh."""
    if not len(points):
        return
    height, radius = points[:, 2], np.hypot(points[:, 0], points[:, 1])
    margin = np.array([[-neighbours.tolerance], [neighbours.tolerance]])
    for number, body in enumerate(neighbours.bodies):
        low, high = body.mesh.bounds + margin
        from_axis = 0.0 if neighbours.on_belt else np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)[:2])
        rows = np.flatnonzero((radius >= from_axis) & (height >= low[2]) & (height <= high[2]))
        placed = points[rows] if body.on_table else neighbours.moved(points[rows], angle[rows])
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
