"""Triangle meshes: reading them with every fault named, the solids they bound, and samples of their surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell import sensor as sensor_rt
from scancell.arguments import Shape, checked_arguments, checked_fields
from scancell.arrays import Array
from scancell.errors import MeshError
from scancell.files import CAD_FORMATS, split_solids
from scancell.geometry import orientation, pose
from scancell.geometry.mesh_files import FORMATS, Vertices, read_mesh, weld, weld_seams
from scancell.geometry.orientation import Orientation, Winding, connected_components
from scancell.values import Value

_SHARP_DEG = 30.0  # angle between faces from which on their edge separates regions
_FLAT_COSINE = np.cos(np.radians(0.5))  # of all normals of a plane region with their mean

LEAST_TIP_ANGLE = np.radians(6.0)
"""Poses that tip over at a smaller tilt of the plane do not count: the facets of a ball."""
_SAME_PLANE = 1e-4  # m between a corner of the hull and the plane of a face in which it counts as lying

_STANDS = 1e-5  # m above the lowest corner, where a corner still carries, and the margin of stability
_TOLERANCE = 0.1e-3  # m: the bound exceeds the largest distance that was found by no more
_MAX_TRIANGLES = 2_000_000  # in a round of subdivision; then the bound is what has been proved so far


__all__ = [
    "FORMATS",
    "METRES_PER_UNIT",
    "MassProperties",
    "Mesh",
    "box_mesh",
    "clustered",
    "is_stable_pose",
    "joined",
    "load_mesh",
    "mass_properties",
]


METRES_PER_UNIT = {"mm": 1e-3, "m": 1.0, "inch": 0.0254}

_USABLE = (0.5e-3, 5.0)  # m: largest extent of meshes that are accepted
_EXPECTED = (10e-3, 2.0)  # m: the same without a remark; parts in inches that fit on a table are smaller as mm
_MANY_POINTS = 50_000  # from which on the hull is an approximation
_HULL_ERROR = 1e-4  # of the largest extent by which points may lie outside an approximated hull
_BLOCK = 1 << 14  # faces worked on at a time, which stay in the cache


@checked_fields
@dataclass(frozen=True, eq=False, repr=False)
class Mesh(Value):
    """Triangle mesh, as `load_part` reads it or of your own arrays, which are copied: a mesh does not change.

    Attributes
    ----------
    vertices
        Positions (n, 3), m.
    faces
        Numbers of vertices (m, 3), from 0; anticlockwise as seen from outside.
    source
        File or name, for messages.
    warnings
        What was found, and repaired, when the file was read.

    Raises
    ------
    DescriptionError
        If an array has another shape, or `faces` are no integers. Numbers of vertices are checked where the mesh is
        used, see `usable`.

    Examples
    --------
    >>> corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    >>> mesh = scancell.Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), "corner")
    >>> mesh.is_closed, mesh.orientation
    (True, 'outward')
    >>> print(mesh.transformed(scancell.pose.translation((0.5, 0, 0))).bounds.round(3))
    [[0.5 0.  0. ]
     [0.6 0.1 0.1]]
    """

    vertices: Annotated[Array, Shape((None, 3), finite=False)]
    faces: Annotated[NDArray[np.int64], Shape((None, 3), int)]
    source: str = ""
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        # What follows from the arrays is kept, so that they must not change: arrays that could are copied.
        for name, array in (("vertices", self.vertices), ("faces", self.faces)):
            if array.flags.writeable:
                kept = array.copy()
                kept.flags.writeable = False
                object.__setattr__(self, name, kept)

    @cached_property
    def usable(self) -> Mesh:
        """The mesh itself; `MeshError` unless it has finite vertices and faces of them, one of which has an area."""
        _check_mesh(self.vertices, self.faces, self.source or "mesh")
        return self

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) lower and upper corner of the vertices that faces use, m."""
        used = self._used_vertices
        return np.stack([used.min(0), used.max(0)])

    @cached_property
    def areas(self) -> Array:
        """(m,) area of each face, m²."""
        return np.asarray(np.linalg.norm(self._cross, axis=-1) / 2)

    @cached_property
    def normals(self) -> Array:
        """(m, 3) unit normals, right-hand rule; zero for a face without area."""
        length = np.linalg.norm(self._cross, axis=-1, keepdims=True)
        return np.asarray(self._cross / np.where(length > 0, length, 1.0))

    @cached_property
    def is_closed(self) -> bool:
        """Whether the faces are wound consistently and leave no boundary, so that the mesh has an inside.

        Where it is not, signed distances from the mesh mean nothing.
        """
        return orientation.is_closed(self.faces) or orientation.is_closed(self._welded_faces)

    @cached_property
    def orientation(self) -> Orientation:
        """``outward``, ``inward``, ``open`` or ``inconsistent``; a mesh from `load_mesh` is never ``inward``."""
        return orientation.orientation_of(self.vertices, self._welded_faces)

    @cached_property
    def _welded_faces(self) -> NDArray[np.int64]:
        """Faces by the first vertex at each position."""
        first, number = weld(self.vertices)
        return first[number][self.faces]

    @cached_property
    def _used_vertices(self) -> Array:
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        return self.vertices if used.all() else self.vertices[used]

    @cached_property
    def _cross(self) -> Array:
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.cross(b - a, c - a)

    @checked_arguments
    def transformed(self, target_from_part: Annotated[ArrayLike, Shape((4, 4))]) -> Mesh:
        """The mesh in the frame to which `target_from_part`, a pose (4, 4), leads."""
        return Mesh(pose.transform_points(target_from_part, self.vertices), self.faces, self.source, self.warnings)

    @cached_property
    def hull(self) -> Mesh:
        """Convex hull, faces outwards; `MeshError` when the vertices have no volume.

        Of more than 50 000 vertices it is an approximation: some may lie outside by 1e-4 of the largest extent.
        """
        from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  (a third of a second)

        points = self._used_vertices
        extent = np.ptp(points, axis=0)
        options = "QbB Pp Qt"
        if len(points) > _MANY_POINTS:
            options = f"Pp Qt W{_HULL_ERROR * extent.max():.3g}"
        try:
            hull = ConvexHull(points, qhull_options=options)
        except (QhullError, ValueError) as error:
            raise MeshError("all vertices lie in one plane, the part has no volume", file=self.source) from error
        corner = np.sort(hull.vertices)
        faces = np.searchsorted(corner, hull.simplices)
        shell = Mesh(points[corner], faces.astype(np.int64), self.source)
        # Qhull's own normals know which side is outside; QbB scales the points by their extents.
        outside = hull.equations[:, :3] * (extent if options.startswith("QbB") else 1.0) ** -1
        inward = np.einsum("mi,mi->m", shell._cross, outside) < 0
        return Mesh(shell.vertices, np.where(inward[:, None], faces[:, ::-1], faces).astype(np.int64), self.source)


@checked_arguments
def box_mesh(size: Annotated[ArrayLike, Shape((3,))], source: str = "box") -> Mesh:
    """A box with edges `size` (3,) along its axes, m, centred on the origin; `source` is its name in messages.

    Examples
    --------
    >>> print(scancell.box_mesh((0.04, 0.03, 0.02)).bounds)
    [[-0.02  -0.015 -0.01 ]
     [ 0.02   0.015  0.01 ]]
    """
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    # Two triangles for each of the sides -x, -y, -z, +z, +y, +x; corner 4 i + 2 j + k has signs i, j, k.
    quads = [(0, 1, 3, 2), (0, 4, 5, 1), (0, 2, 6, 4), (1, 5, 7, 3), (2, 3, 7, 6), (4, 6, 7, 5)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Mesh(corners * np.asarray(size, float), np.array(faces, np.int64), source)


def joined(meshes: Sequence[Mesh], source: str) -> Mesh:
    """All meshes as one; vertices are not shared between them."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), source)


def clustered(mesh: Mesh, grid: float) -> Mesh:
    """The mesh with all vertices in a cube of the grid (m) drawn together into one of them; coarser by < 2 `grid`.

    The hull may shrink or grow by that much. Meant for proximity checks on scans of millions of triangles.
    """
    cell = np.floor((mesh.vertices - mesh.vertices.min(0)) / grid).astype(np.int64)
    size = cell.max(0) + 1
    _, first, place = np.unique(
        (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2], return_index=True, return_inverse=True
    )
    faces = place[mesh.faces]
    a, b, c = faces.T
    whole = faces[(a != b) & (b != c) & (c != a)]
    # A part smaller than the grid would vanish: leave it as it is.
    return Mesh(mesh.vertices[first], whole, mesh.source) if len(whole) else mesh


@dataclass(frozen=True)
class MassProperties:
    """Mass (kg), centre of mass (3,), m, and inertia (3, 3) about it, kg m², of a rigid body, all in one frame."""

    mass: float
    centre_of_mass: Array
    inertia: Array

    def seen_from(self, frame_from_body: Array) -> MassProperties:
        """The same body in another frame."""
        rotation = frame_from_body[:3, :3]
        centre = rotation @ self.centre_of_mass + frame_from_body[:3, 3]
        return MassProperties(self.mass, centre, rotation @ self.inertia @ rotation.T)

    def joined_with(self, other: MassProperties) -> MassProperties:
        """Both as one rigid body; Huygens and Steiner's theorem moves the inertias to the common centre of mass."""
        mass = self.mass + other.mass
        centre = (self.mass * self.centre_of_mass + other.mass * other.centre_of_mass) / mass
        return MassProperties(mass, centre, self._inertia_about(centre) + other._inertia_about(centre))

    def _inertia_about(self, point: Array) -> Array:
        arm = self.centre_of_mass - point
        return np.asarray(self.inertia + self.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm)))


def load_mesh(path: str | Path, unit: str = "mm") -> Mesh:
    """Read an STL, OBJ or PLY file with coordinates in `unit` (mm, m or inch), or a CAD file, which states its unit.

    ``FILE.step#NAME`` are the solids of this name, or of this number from 0, of a CAD file; ``#NAME#NAME`` are several.

    Equal vertices are joined, also those of open edges that differ by rounding only; repeated faces are removed, and
    faces without an area where the mesh is closed without them; faces that certainly point the wrong way are flipped.
    `Mesh.warnings` reports each. The order of the faces is that of the file.

    Raises `MeshError` with the file and the fault: missing, not a mesh, empty, NaN or infinite vertices, a face index
    out of range, no face with an area, or a size that cannot be meant.
    """
    path = Path(path)
    if unit not in METRES_PER_UNIT:
        raise MeshError(key="unit", value=unit, expected=f"one of {', '.join(METRES_PER_UNIT)}")
    if split_solids(path)[0].suffix.lower() in CAD_FORMATS:
        from scancell.geometry.cad import load_cad  # noqa: PLC0415  (it imports this module)

        return load_cad(path)
    vertices, faces, found = read_mesh(path)
    _check_mesh(vertices, faces, str(path))
    first, number = weld(vertices)
    faces = number[faces]
    remarks = found
    if not orientation.is_closed(faces):
        positions = vertices[first].astype(float)
        faces = weld_seams(positions, faces)
        has_area = _has_area(positions, faces)
        # Of a small part far from the origin, no face exceeds the rounding.
        if has_area.any() and not has_area.all() and orientation.is_closed(faces[has_area]):
            count = len(faces) - int(has_area.sum())
            remarks = (*remarks, f"{path}: {count} of {len(faces)} faces have no area and were removed")
            faces = faces[has_area]
    used = np.zeros(len(first), bool)
    used[faces] = True
    faces = (np.cumsum(used) - 1)[faces]
    metres = vertices[first[used]].astype(float) * METRES_PER_UNIT[unit]
    remarks = (*remarks, *_size_remarks(float(np.ptp(metres, axis=0).max()), unit, str(path)))
    once = _first_of_equal_faces(faces)
    if len(once) < len(faces):
        remarks = (*remarks, f"{path}: {len(faces) - len(once)} of {len(faces)} faces repeat another and were removed")
        faces = faces[once]
    winding = orientation.wind_outwards(metres, faces)
    return Mesh(metres, winding.faces, str(path), (*remarks, *_winding_remarks(winding, str(path))))


def _check_mesh(vertices: Vertices, faces: NDArray[np.int64], source: str) -> None:
    """Raise `MeshError` unless the mesh is a finite, non-empty set of faces of which at least one has an area."""
    if len(vertices) == 0 or len(faces) == 0:
        raise MeshError(f"no triangles ({len(vertices)} vertices, {len(faces)} faces)", file=source)
    if faces.min() < 0 or faces.max() >= len(vertices):
        face = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(1))[0])
        raise MeshError(
            f"face {face} uses vertex {faces[face].tolist()}, but the vertices are 0 to {len(vertices) - 1}",
            file=source,
        )
    finite = np.isfinite(vertices)
    if not finite.all():
        wrong = np.flatnonzero(~finite.all(1))
        row = int(wrong[0])
        raise MeshError(f"vertex {row} is {vertices[row].tolist()}; {len(wrong)} are NaN or infinite", file=source)
    blocks = (vertices[faces[start : start + _BLOCK]].astype(float) for start in range(0, len(faces), _BLOCK))
    if not any(np.cross(b[:, 1] - b[:, 0], b[:, 2] - b[:, 0]).any() for b in blocks):
        raise MeshError(f"all {len(faces)} triangles are degenerate (no area)", file=source)


def _has_area(vertices: Array, faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask (m,) of the faces (m, 3) whose height exceeds the rounding of coordinates in single precision."""
    corners = vertices[faces]
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1).max(1)
    rounding = float(np.abs(corners).max() * np.finfo(np.float32).eps)
    return np.asarray(orientation.doubled_areas(vertices, faces) > longest * rounding)


def _first_of_equal_faces(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of the faces (m, 3) that are no repetition of another with the same winding, in their order."""
    words = np.random.default_rng(0).integers(2**64, size=faces.max() + 1, dtype=np.uint64)
    a, b, c = words[faces].T
    with np.errstate(over="ignore"):
        key = a + b + c  # different for different vertices, but for a chance of 2^-64
    ordered = np.sort(key)
    suspects = np.flatnonzero(np.isin(key, ordered[1:][ordered[1:] == ordered[:-1]]))
    # The same three vertices: compare them in their order, beginning with the lowest.
    begin = faces[suspects].argmin(1)[:, None]
    turned = np.take_along_axis(faces[suspects], (begin + np.arange(3)) % 3, axis=1)
    _, first = np.unique(turned, axis=0, return_index=True)
    removed = np.delete(suspects, first)
    return np.delete(np.arange(len(faces)), removed)


def _size_remarks(extent: float, unit: str, source: str) -> tuple[str, ...]:
    """Warnings about an unlikely largest extent (m); raises `MeshError` for an impossible one."""
    if _EXPECTED[0] <= extent <= _EXPECTED[1]:
        return ()
    in_unit = extent / METRES_PER_UNIT[unit]
    others = [
        f"`unit` {other} makes it {_length(in_unit * metres)}"
        for other, metres in METRES_PER_UNIT.items()
        if _EXPECTED[0] <= in_unit * metres <= _EXPECTED[1]
    ]
    hint = f"is its unit really {unit}? ({'; '.join(others) or 'scale the file'})"
    found = f"the largest extent is {_length(extent)}"
    if not _USABLE[0] <= extent <= _USABLE[1]:
        raise MeshError(f"{found}: {hint}", file=source, expected=f"{_length(_USABLE[0])} to {_length(_USABLE[1])}")
    return (f"{source}: {found}: {hint}",)


def _length(metres: float) -> str:
    return f"{metres:.3g} m" if metres >= 1.0 else f"{metres * 1e3:.3g} mm"


def _winding_remarks(winding: Winding, source: str) -> tuple[str, ...]:
    total, remarks = len(winding.faces), []
    if winding.turned == total:
        remarks.append(f"{source}: all {total} faces pointed into the material and were turned over")
    elif winding.turned:
        remarks.append(f"{source}: {winding.turned} of {total} faces pointed to the wrong side and were turned over")
    if winding.orientation == "inconsistent":
        remarks.append(
            f"{source}: {winding.contradictory} of {total} faces form one-sided surfaces and cannot be oriented: "
            "signs of deviations mean nothing there"
        )
    elif winding.orientation == "open":
        rim = f"{winding.rim} edges belong to one face only" if winding.rim else "edges belong to more than two faces"
        remarks.append(f"{source}: the surface is not closed ({rim}): signs of deviations depend on the winding")
    return tuple(remarks)


def mass_properties(mesh: Mesh, density: float) -> MassProperties:
    """Mass properties of the solid of uniform `density` (kg/m³) inside the mesh.

    A mesh that is not closed has no inside: its convex hull is used instead.
    """
    solid = mesh if mesh.is_closed else mesh.hull
    volume, first, second = _moments(solid)
    if abs(volume) < 1e-18:
        volume, first, second = _moments(mesh.hull)
    # An inside-out mesh has the negative of all three.
    centre = first / volume
    about_centre = (second - volume * np.outer(centre, centre)) * np.sign(volume)
    inertia = density * (np.trace(about_centre) * np.eye(3) - about_centre)
    return MassProperties(abs(volume) * density, centre + solid.bounds.mean(0), inertia)


def _moments(mesh: Mesh) -> tuple[float, Array, Array]:
    """∫ dV, ∫ x dV (3,) and ∫ x xᵀ dV (3, 3), x from the middle of the bounds.

    Sums over the tetrahedra from the middle to each face (closed form: Tonon 2004).
    """
    local = mesh.vertices - mesh.bounds.mean(0)
    volume, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for start in range(0, len(mesh.faces), _BLOCK):
        corners = local[mesh.faces[start : start + _BLOCK].T]
        a, b, c = corners
        volumes = np.einsum("mi,mi->m", a, np.cross(b, c)) / 6
        total = corners.sum(0)
        volume += float(volumes.sum())
        first += volumes @ total / 4
        for points in (*corners, total):
            second += (points * volumes[:, None]).T @ points / 20
    return volume, first, second


def is_stable_pose(mesh: Mesh, table_from_part: ArrayLike) -> bool:
    """Whether the part rests stably by gravity on the plane z = 0 of the table.

    Stable: the vertices of the hull within 0.01 mm of the lowest one enclose the centre of mass, seen from above, with
    a margin of as much.
    """
    hull = pose.transform_points(table_from_part, mesh.hull.vertices)
    centre = pose.transform_points(table_from_part, mass_properties(mesh, 1.0).centre_of_mass[None])[0]
    feet = hull[hull[:, 2] <= hull[:, 2].min() + _STANDS][:, :2] - centre[:2]
    # In every direction the farthest foot must lie beyond the centre; 720 directions miss the narrowest by 1e-5.
    angle = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    support = (feet @ np.stack([np.cos(angle), np.sin(angle)])).max(0)
    return bool(support.min() > _STANDS)


def sample_surface(mesh: Mesh, count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Area-stratified random points (count, 3), m, and their faces (count,).

    One point in each of `count` equal intervals of the cumulative face area, uniformly distributed within its face.
    """
    rng = np.random.default_rng(seed)
    cumulated = np.cumsum(mesh.areas / mesh.areas.sum())
    face = np.searchsorted(cumulated, (np.arange(count) + rng.uniform(size=count)) / count)
    face = np.minimum(face, len(cumulated) - 1)  # rounding may leave the sum below 1
    u, v = rng.uniform(size=(2, count, 1))
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face]], 1, 0)
    root = np.sqrt(u)
    return (1 - root) * a + root * (1 - v) * b + root * v * c, face


@dataclass(frozen=True)
class Regions:
    """Regions of a mesh by falling area, numbered from 0.

    Attributes
    ----------
    of_face
        (m,) region of each face.
    areas
        (k,) m².
    normals
        (k, 3) mean unit normals.
    centres
        (k, 3) centroids, m.
    is_plane
        (k,) whether all faces have the mean normal.
    """

    of_face: NDArray[np.int64]
    areas: Array
    normals: Array
    centres: Array
    is_plane: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.areas)


def smooth_regions(mesh: Mesh) -> Regions:
    """Regions whose neighbouring faces meet at less than 30 deg; edges of more than two faces separate, too."""
    _, a, b = _edges(mesh)
    shared = b >= 0
    a, b = a[shared], b[shared]
    smooth = np.einsum("ni,ni->n", mesh.normals[a], mesh.normals[b]) > np.cos(np.radians(_SHARP_DEG))
    label = connected_components(len(mesh.faces), a[smooth], b[smooth])
    areas = np.bincount(label, mesh.areas).astype(float)
    rank = np.empty(len(areas), np.int64)
    rank[np.argsort(-areas, kind="stable")] = np.arange(len(areas))
    of_face = rank[label]
    summed, moment = (
        np.stack([np.bincount(of_face, mesh.areas * values[:, axis]) for axis in range(3)], 1)
        for values in (mesh.normals, mesh.vertices[mesh.faces].mean(1))
    )
    areas = np.sort(areas)[::-1]
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    normals = summed / np.where(length > 0, length, 1.0)
    aligned = np.einsum("ni,ni->n", mesh.normals, normals[of_face]) >= _FLAT_COSINE
    bent = np.bincount(of_face, ~aligned & (mesh.areas > 0))
    centres = moment / np.where(areas > 0, areas, 1.0)[:, None]
    return Regions(of_face, areas, normals, centres, (bent == 0) & (length[:, 0] > 0))


def sharp_edges(mesh: Mesh) -> Array:
    """Ends (k, 2, 3), m, of the edges at which two faces meet at 30 deg or more, or not exactly two faces."""
    ends, a, b = _edges(mesh)
    cosine = np.einsum("ni,ni->n", mesh.normals[a], mesh.normals[b])
    has_area = mesh.areas > 0
    is_bent = (cosine <= np.cos(np.radians(_SHARP_DEG))) & has_area[a] & has_area[b]
    return np.asarray(mesh.vertices[ends[is_bent | (b < 0)]], np.float64)


def _edges(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Vertices (k, 2) of each edge, a face at it, and the other one; -1 where there are not exactly two faces."""
    first, number = weld(mesh.vertices)
    faces = first[number][mesh.faces]
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, owner = ends[order], owner[order]
    begin = np.flatnonzero(np.append(True, (ends[1:] != ends[:-1]).any(1)))
    count = np.diff(np.append(begin, len(ends)))
    last = begin + count - 1
    return ends[begin], owner[begin], np.where(count == 2, owner[last], -1)


@dataclass(frozen=True)
class RestingPose:
    """A stable pose.

    Attributes
    ----------
    rotation
        (3, 3) ``table_from_part``; the part rests on its lowest points. The turn about the vertical is arbitrary.
    tip_angle
        Tilt of the plane at which the part tips over, rad.
    """

    rotation: Array
    tip_angle: float


def resting_poses(part: Mesh) -> list[RestingPose]:
    """Stable poses of the part on a plane, the most stable first.

    A part of uniform density rests on a face of its convex hull if its centre of mass is above the inside of that face.
    """
    hull, centre = part.hull, mass_properties(part, 1.0).centre_of_mass
    order = np.argsort(-hull.areas, kind="stable")
    used = np.unique(hull.faces)
    corners = hull.vertices[used]
    done = np.zeros(len(hull.faces), bool)
    result = []
    for face in order:
        if done[face] or not hull.areas[face] > 0:
            continue
        normal = hull.normals[face]
        offset = float(hull.vertices[hull.faces[face, 0]] @ normal)
        done |= (np.abs(hull.vertices[hull.faces] @ normal - offset) < _SAME_PLANE).all(1)
        feet = corners[np.abs(corners @ normal - offset) < _SAME_PLANE]
        height = offset - float(centre @ normal)
        rotation = _turned_down(normal)
        margin = _margin((feet - centre) @ rotation.T)
        tip_angle = float(np.arctan2(margin, height))
        if tip_angle < LEAST_TIP_ANGLE:
            continue
        if is_stable_pose(part, pose.from_rotation(rotation)):
            result.append(RestingPose(rotation, tip_angle))
    return sorted(result, key=lambda rest: -rest.tip_angle)


def _turned_down(normal: Array) -> Array:
    """Rotation (3, 3) by the smallest angle that turns a unit vector (3,) to -z."""
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine, cosine = float(np.linalg.norm(axis)), -float(normal[2])
    if sine < 1e-9:
        return np.asarray(pose.rotation_about(0, 0.0 if cosine > 0 else np.pi))
    return np.asarray(pose.exp_rotation(axis / sine * np.arctan2(sine, cosine)))


def _margin(feet: Array) -> float:
    """Distance from the centre, the origin, to the rim of the hull of the feet (n, 3) in the plane, m; < 0 outside."""
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  (a third of a second)

    try:
        # Half planes of the hull: normal @ x + offset <= 0.
        return float(-ConvexHull(feet[:, :2]).equations[:, 2].max())
    except QhullError:  # all on one line, nearly
        return 0.0


def decimated(mesh: Mesh, max_faces: int) -> Mesh:
    """The mesh (m) simplified to `max_faces` triangles by quadric edge collapse; unchanged if it has no more.

    Boundary and non-manifold edges do not collapse: open or non-manifold meshes may keep more triangles.

    Raises `MeshError` if no triangle remains.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    import fast_simplification  # noqa: PLC0415

    # The library works in single precision: millimetres, about the centre.
    centre = mesh.bounds.mean(0)
    corners = ((mesh.vertices - centre) * 1e3).astype(np.float32)
    # Vertices must be shared: triangles without neighbours would be removed.
    first, number = weld(corners)
    vertices, faces = fast_simplification.simplify(
        corners[first], number[mesh.faces].astype(np.int32), target_count=max_faces
    )
    if len(faces) == 0:
        raise MeshError(f"cannot be simplified from {len(mesh.faces)} to {max_faces} triangles", file=mesh.source)
    return Mesh(np.asarray(vertices, np.float64) * 1e-3 + centre, np.asarray(faces, np.int64), mesh.source)


def deviation(mesh: Mesh, other: Mesh) -> float:
    """Largest distance (m) from a vertex or face centre of either mesh to the surface of the other."""
    return max(_one_sided(mesh, other), _one_sided(other, mesh))


def _one_sided(source: Mesh, target: Mesh) -> float:
    corners = source.vertices[np.unique(source.faces)]
    probes = np.concatenate([corners, source.vertices[source.faces].mean(1)])
    distance, _ = sensor_rt.MeshSurface(target.vertices, target.faces).signed_distances(probes)
    return float(np.abs(distance).max())


@dataclass(frozen=True)
class ReducedMesh:
    """A mesh in place of one with more faces.

    Attributes
    ----------
    mesh
        The mesh, or the original if that has few faces.
    original_faces
        Number of faces of the original.
    error
        Bound (m) on the distance of any point of the original from the mesh, or from its inside if it is closed.
    """

    mesh: Mesh
    original_faces: int
    error: float = 0.0

    def transformed(self, target_from_part: Array) -> ReducedMesh:
        """The mesh in the frame to which `target_from_part`, a pose (4, 4), leads."""
        return replace(self, mesh=self.mesh.transformed(target_from_part))

    def line(self, name: str) -> str:
        """Line of text for messages."""
        return (
            f"{name}: {self.original_faces} triangles reduced to {len(self.mesh.faces)}, beyond which the body reaches"
            f" at most {1e3 * self.error:.2f} mm"
        )


def reduced(mesh: Mesh, max_faces: int, max_error: float) -> ReducedMesh:
    """The mesh simplified to `max_faces` triangles by quadric edge collapse; unchanged if it has no more.

    Where the error would exceed `max_error` (m), it keeps four times as many, and so on.

    Raises `MeshError` if no triangle remains.
    """
    while True:
        light = decimated(mesh, max_faces)
        if light is mesh:
            return ReducedMesh(mesh, len(mesh.faces))
        error = protrusion_bound(mesh, light, limit=max_error)
        if error <= max_error:
            return ReducedMesh(light, len(mesh.faces), error)
        max_faces *= 4


def protrusion_bound(mesh: Mesh, solid: Mesh, limit: float = np.inf) -> float:
    """Bound (m) on the distance by which any point of a mesh lies outside a solid, or off an open surface.

    Triangles whose bound, see `scancell.sensor.MeshSurface.triangle_distances`, exceeds the largest distance found so
    far by more than `_TOLERANCE` are divided in four. Beyond `limit` the bound is not sought: the result is a distance
    above it.
    """
    surface = sensor_rt.MeshSurface(solid.vertices, solid.faces.astype(np.uint32))
    triangles = mesh.vertices[mesh.faces]
    corners = surface.signed_distances(mesh.vertices[np.unique(mesh.faces)])[0]
    largest = max(0.0, float((corners if solid.is_closed else np.abs(corners)).max()))
    while largest <= limit:
        distance, bound = surface.triangle_distances(triangles, solid.is_closed)
        largest = max(largest, float(distance.max(initial=0.0)))
        rest = np.flatnonzero(bound > largest + _TOLERANCE)
        if not len(rest) or 4 * len(rest) > _MAX_TRIANGLES:
            return max(largest + _TOLERANCE, float(bound[rest].max(initial=0.0)))
        triangles = _divided(triangles[rest])
    return largest


def _divided(triangles: Array) -> Array:
    """Four triangles (4 n, 3, 3) in place of each (n, 3, 3), between its corners and the middles of its edges."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(corners, 1) for corners in quarters])
