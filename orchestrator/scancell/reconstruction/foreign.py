"""Foreign points: points on neighbouring bodies, found from the nominal geometry of these bodies.

A point is foreign if it lies inside a neighbour or within a tolerance of its surface. The distance to the scanned part
is not used, so that no measurement error can be removed as foreign. Where a neighbour touches or nearly touches the
part, the two are indistinguishable: points in this contact zone are assigned to the part. The zone follows from the
nominal poses of both meshes alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array, Flags
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.sensor import closest_points

TOLERANCE = 1e-3  # m: more than as-built errors move points, less than parts stand apart
_CONTACT = 1.5  # tolerances between surfaces of neighbour and part up to which points count as the part's

_WALL = 0.1  # vertical component of the normal up to which a face is a wall, which has no footprint
_THIN = 0.05  # tolerances: height of the part over the table up to which measured heights do not tell them apart
_CELLS = 4  # of the grid in a tolerance
_MOST_CELLS = 2000  # along a side
# Directions from the table to light that comes from above: elevations up to which sensors are tilted.
_TO_LIGHT = [
    np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    for up in np.radians([20.0, 40.0, 60.0])
    for around in np.radians(np.arange(0.0, 360.0, 30.0) + 7.0)
]
# Position of the rays in their cells: no symmetry of a part puts all of them on edges, where rays may miss.
_OFF_CENTRE = np.array([0.4571, 0.5312])


@dataclass(frozen=True)
class Neighbour:
    """A body beside the part; `mesh` is in the frame of the part's support with the axes at 0, m.

    `rides`: whether it moves with the support.
    """

    name: str
    mesh: Mesh
    rides: bool


@dataclass(frozen=True)
class CarriedBodies:
    """Bodies with their meshes, each in its frame, m, and the cell that places them by positions of its axes."""

    cell: NominalCell
    bodies: tuple[Body, ...]

    def poses(self, axes: Array) -> list[Array]:
        """Poses (n, 4, 4) of each body in the frame of the part's support at positions (n, k) of the axes."""
        placed = self.cell.tree.place(axes, [self.cell.support, *(body.moves_with for body in self.bodies)])
        support_from_world = pose.inverse(placed[self.cell.support])
        return [np.asarray(support_from_world @ placed[body.moves_with]) for body in self.bodies]


@dataclass(frozen=True)
class Neighbours:
    """Nominal bodies around the scanned part, and the part itself.

    The part rests on its support at `support_from_part` (4, 4); the support turns about its z or `slides` along its x
    with the axis in the column `axis` of the positions of axes. `carried` are bodies that other axes move, such as
    those of the arm, which a sensor that it does not carry sees.
    """

    bodies: tuple[Neighbour, ...]
    part: Mesh
    support_from_part: Array
    axis: int
    slides: bool = False
    carried: CarriedBodies | None = None

    def moved(self, points: Array, position: Array) -> Array:
        """Points (n, 3) of the support moved with it by positions (n,) of its axis, rad or m."""
        if self.slides:
            return np.asarray(points + position[:, None] * np.array([1.0, 0.0, 0.0]))
        return _turned(points, position)

    @cached_property
    def part_on_support(self) -> Mesh:
        """The scanned part, used only to find where neighbours touch it."""
        return self.part.transformed(self.support_from_part)


def neighbours_of(nominal: NominalCell, moved: Collection[str] = ()) -> Neighbours:
    """Bodies that stand in the cell, without the part's support (which the envelope removes).

    Where other axes than that of the support move them, they are where they start, or, if these are among the names
    `moved`, counted as carried. The arm, and what it carries, is in view of further sensors alone. A part that the arm
    holds moves past all that the flange does not carry.
    """
    frames, tree = nominal.frame_poses(nominal.start), nominal.tree
    support_from_world, axis = (
        pose.inverse(nominal.world_from(nominal.support, nominal.start)),
        tree[nominal.support].axis,
    )
    if nominal.holds_part:
        moving, own = set(nominal.arm.tree.axes), set(tree.axes_of(nominal.support))
        others = [body for body in nominal.bodies if body.name != "part"]
        rigid = [body for body in others if moving <= set(tree.axes_of(body.moves_with)) <= own]
        passed = [body for body in others if not moving <= set(tree.axes_of(body.moves_with)) <= own]
        return Neighbours(
            tuple(
                Neighbour(b.name, b.mesh.transformed(support_from_world @ frames[b.moves_with]), True) for b in rigid
            ),
            nominal.part,
            nominal.support_from_part,
            tree.axes.index(axis),
            carried=CarriedBodies(nominal, tuple(passed)),
        )
    standing = {"world", "table", "part", *(one.name for one in nominal.further_axes)} - {nominal.arm_on} | {"world"}
    support = "table" if nominal.support == "table" else nominal.required_belt().description.name
    bodies = tuple(
        Neighbour(
            body.name,
            body.mesh.transformed(support_from_world @ frames[body.moves_with]),
            tree.axes_of(body.moves_with) == tree.axes_of(nominal.support),
        )
        for body in nominal.bodies
        if body.name not in ("part", support) and nominal.carrier(body.moves_with).partition("[")[0] in standing
    )
    on_support, moving = set(tree.axes_of(nominal.support)), set(moved)
    by_axes = {body.name: (set(tree.axes_of(body.moves_with)) ^ on_support) & moving for body in nominal.bodies}
    travelling = {body.name for body in bodies if by_axes[body.name]}
    bodies = tuple(body for body in bodies if body.name not in travelling) if travelling else bodies
    slides, carried = tree[nominal.support].kind == "prismatic", None
    if nominal.further_sensors:
        known = {"part", support, *(body.name for body in bodies)}
        carried = CarriedBodies(nominal, tuple(body for body in nominal.bodies if body.name not in known))
    elif travelling:
        carried = CarriedBodies(nominal, tuple(body for body in nominal.bodies if body.name in travelling))
    return Neighbours(bodies, nominal.part, nominal.support_from_part, tree.axes.index(axis), slides, carried=carried)


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
    for number, rows, points in _candidates(points_on_support, position, neighbours):
        body = neighbours.bodies[number]
        nearest, _, signed = closest_points(body.mesh.vertices, body.mesh.faces.astype(np.uint32), points)
        inside = (np.asarray(signed) < 0.0) & body.mesh.is_closed
        on_it = np.flatnonzero(inside | (np.abs(signed) <= TOLERANCE))
        place = np.asarray(nearest)[on_it]
        if not body.rides:
            place = neighbours.moved(place, -position[rows[on_it]])
        contact = _nearer(place, neighbours.part_on_support, _CONTACT * TOLERANCE)
        owner[rows[on_it[~contact]]] = number
    return owner


def carried_points(
    points_on_support: Array, frame: NDArray[np.int64], axes: Array, neighbours: Neighbours
) -> NDArray[np.int64]:
    """Number (n,) of the carried body that each point lies on, -1 for none.

    Parameters
    ----------
    points_on_support
        (n, 3) in the frame that moves with the part's support, m.
    frame
        (n,) exposure of each point.
    axes
        (exposures, k) measured positions of the axes, rad or m.
    """
    owner = np.full(len(points_on_support), -1, np.int64)
    if neighbours.carried is None:
        return owner
    for number, (body, poses) in enumerate(zip(neighbours.carried.bodies, neighbours.carried.poses(axes), strict=True)):
        mesh = body.mesh
        centre = mesh.bounds.mean(0)
        radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max()) + TOLERANCE
        away = np.linalg.norm(points_on_support - pose.transform_points(poses, centre[None])[:, 0][frame], axis=1)
        rows = np.flatnonzero((away <= radius) & (owner < 0))
        if not len(rows):
            continue
        points = pose.transform_each(pose.inverse(poses)[frame[rows]], points_on_support[rows])
        near = ((points >= mesh.bounds[0] - TOLERANCE) & (points <= mesh.bounds[1] + TOLERANCE)).all(1)
        rows, points = rows[near], points[near]
        signed = np.asarray(closest_points(mesh.vertices, mesh.faces.astype(np.uint32), points)[2])
        owner[rows[((signed < 0.0) & mesh.is_closed) | (np.abs(signed) <= TOLERANCE)]] = number
    return owner


def _candidates(
    points: Array, position: Array, neighbours: Neighbours
) -> Iterator[tuple[int, NDArray[np.int64], Array]]:
    """Number of each neighbour with points in its bounding box, their rows, and the points in the frame of its mesh."""
    if not len(points):
        return
    height, radius = points[:, 2], np.hypot(points[:, 0], points[:, 1])
    margin = np.array([[-TOLERANCE], [TOLERANCE]])
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


@dataclass(frozen=True)
class Footprint:
    """Grid of the heights of the part's low upper sides, in the frame of the table at angle 0, m.

    Attributes
    ----------
    corner, step
        Lower corner (2,) of the grid and edge of its cells.
    covered
        (nx, ny) whether the part covers the table in the cell, so that no ray from above meets it there.
    surely_covered
        (nx, ny) whether it covers the table everywhere within the tolerance.
    lowest_top, highest_top
        (nx, ny) extremes of the heights of the low upper sides within the tolerance; infinite, and -infinite, without.
    base
        Height of the lowest point of the part.
    """

    corner: Array
    step: float
    covered: Flags
    surely_covered: Flags
    lowest_top: Array
    highest_top: Array
    base: float

    def part_points(self, points_in_table: Array) -> tuple[Flags, Flags]:
        """Flags (n,) of the low points (n, 3) that are the part's, and of those that may be the table's as well."""
        shape = np.array(self.covered.shape)
        index = np.floor((points_in_table[:, :2] - self.corner) / self.step)
        rows = np.flatnonzero(((index >= 0) & (index < shape)).all(1) & (points_in_table[:, 2] > self.base - TOLERANCE))
        cell = tuple(index[rows].astype(np.intp).T)
        height, sure = points_in_table[rows, 2], self.surely_covered[cell]
        top = np.where(sure, self.lowest_top[cell], self.highest_top[cell])
        near = np.isfinite(top)
        least = _THIN * TOLERANCE
        thin = top - self.base < least
        high = near & ((height >= self.base + np.maximum(top - self.base, least) / 2) | (thin & self.covered[cell]))
        kept, ambiguous = np.zeros((2, len(points_in_table)), bool)
        kept[rows] = high | (near & sure)
        ambiguous[rows] = near & (high != self.covered[cell])
        return kept, ambiguous


def footprint_of(part: Mesh, table_from_part: Array, lowest: float) -> Footprint | None:
    """The footprint of the nominal part; None if it has no upper side near or below the height `lowest`, m."""
    ceiling = lowest + TOLERANCE
    height = part.vertices @ table_from_part[2, :3] + table_from_part[2, 3]
    below = height < ceiling
    a, b, c = part.faces.T
    low_faces = part.faces[below[a] | below[b] | below[c]]
    corners = pose.transform_points(table_from_part, part.vertices[low_faces].reshape(-1, 3)).reshape(-1, 3, 3)
    low = corners[_upwards(corners) > _WALL]
    if not len(low):
        return None
    bounds = low[..., :2].reshape(-1, 2)
    corner, end = bounds.min(0) - 2 * TOLERANCE, bounds.max(0) + 2 * TOLERANCE
    step = max(TOLERANCE / _CELLS, float((end - corner).max()) / _MOST_CELLS)
    reach = 2 * int(np.ceil(TOLERANCE / step)) + 1
    shape = np.ceil((end - corner) / step).astype(int)
    x, y = (corner[axis] + step * (np.arange(shape[axis]) + _OFF_CENTRE[axis]) for axis in (0, 1))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    rays = _Rays(part, table_from_part)
    top = rays.tops(places, ceiling)
    covered = ~np.isnan(top)
    covered[covered] = rays.covers(places[covered], float(height.min()), _THIN * TOLERANCE)

    from scipy.ndimage import maximum_filter, minimum_filter  # noqa: PLC0415

    is_low = np.isfinite(top)
    return Footprint(
        corner=corner,
        step=step,
        covered=covered,
        surely_covered=minimum_filter(covered, reach),
        lowest_top=minimum_filter(np.where(is_low, top, np.inf), reach),
        highest_top=maximum_filter(np.where(is_low, top, -np.inf), reach),
        base=float(height.min()),
    )


class _Rays:
    """Rays cast at a part on the table; places (..., 2) are in the frame of the table, m."""

    def __init__(self, part: Mesh, table_from_part: Array) -> None:
        self._part, self._table_from_part = part, table_from_part
        self._scene = sensor_rt.Scene()
        self._scene.add_mesh("part", part.vertices, part.faces, 0.5)

    def tops(self, places: Array, ceiling: float) -> Array:
        """Height (...) of the upper side below the ceiling; infinite where it is above, NaN where there is no part."""
        distance, face = self._cast(places.reshape(-1, 2), ceiling, np.array([0.0, 0.0, -1.0]))
        hit = np.flatnonzero(np.isfinite(distance))
        top = np.full(len(distance), np.nan)
        upwards = self._part.normals[face[hit]] @ self._table_from_part[2, :3]
        # A ray that starts inside the part leaves it by its lower side.
        top[hit] = np.where(upwards > _WALL, ceiling - distance[hit], np.inf)
        return top.reshape(places.shape[:-1])

    def covers(self, places: Array, base: float, gap: float) -> Flags:
        """Whether the part keeps all rays from above from the table at places (n, 2).

        It does where its lower side is no more than `gap` above its lowest point, `base`.
        """
        height, _ = self._cast(places, base - gap, np.array([0.0, 0.0, 1.0]))
        covered = np.isfinite(height)
        rest = np.flatnonzero(covered & (height > 2 * gap))
        for direction in _TO_LIGHT:
            distance, _ = self._cast(places[rest], base - gap, direction)
            covered[rest[np.isinf(distance)]] = False
            rest = rest[np.isfinite(distance)]
        return covered

    def _cast(self, places: Array, height: float, direction: Array) -> tuple[Array, NDArray[np.int64]]:
        """Distance (n,) to the part from places (n, 2) at a height, infinite without any, and its face (n,)."""
        origins = np.column_stack([places, np.full(len(places), height)])
        along = np.tile(direction, (len(places), 1))
        distance, body, face = sensor_rt.cast_rays(self._scene, self._table_from_part[None], origins, along)
        return np.where(body >= 0, distance, np.inf), face


def _upwards(corners: Array) -> Array:
    """Vertical component (n,) of the unit normals of triangles (n, 3, 3)."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return np.asarray(cross[:, 2] / np.where(length > 0, length, 1.0))
