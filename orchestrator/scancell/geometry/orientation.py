"""Winding of triangle meshes: whether faces point outwards, and which of them can be flipped with certainty.

A *shell* is a set of faces connected through edges that exactly two faces share. Faces of one shell are wound
consistently when each shared edge is run through once in each direction; a closed shell that is wound consistently has
an inside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.geometry import pose

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


Faces = NDArray[np.int64]
Mask = NDArray[np.bool_]

# outward: closed, every normal looks out of the material; inward: closed, and all of them look into it;
# open: wound consistently, but the surface has a rim (or edges of three and more faces), so that nothing is inside;
# inconsistent: neighbouring faces look to opposite sides.
Orientation = Literal["outward", "inward", "open", "inconsistent"]

_MOST_SHELLS = 2000  # of negative volume that are looked for in other shells; more are left as they are
_SHARE_INSIDE = 0.75  # of a full turn around a point that is taken as inside of a shell

_LENGTHS = {"mm": 1e-3, "m": 1.0}
_ANGLES = {"deg": np.pi / 180, "rad": 1.0}
_UNIT_TOLERANCE = 1e-3  # of the length of a quaternion, and of the elements of RᵀR
_MUCH_BETTER = 1 / 3  # of the misfit of the stated reading
_FITS = 5e-3  # m: a reading with a larger misfit is wrong, too
_REACH = (0.01, 50.0)  # m: of the flange from the base
_LARGEST_ANGLE = 4 * np.pi  # rad


@dataclass(frozen=True)
class Winding:
    """Faces (m, 3) after the repair, in the order given, and what it found.

    Attributes
    ----------
    orientation
        Orientation of the repaired faces.
    turned
        Number of faces that were turned over.
    rim
        Number of edges with one face only.
    contradictory
        Number of faces that cannot be wound consistently (one-sided surfaces).
    """

    faces: Faces
    orientation: Orientation
    turned: int = 0
    rim: int = 0
    contradictory: int = 0


def is_closed(faces: Faces) -> bool:
    """Whether every edge is traversed equally often in both directions: closed, and wound consistently.

    `faces` (m, 3) number welded vertices. A random antisymmetric form is summed over all edges, modulo 2^64; the
    chance that a mesh with a rim sums to 0 is below 1e-15.
    """
    count = int(faces.max()) + 1
    a, b, c = faces.T
    u, v = _random_words(count, 1), _random_words(count, 2)
    total = 0
    for start in range(0, len(faces), 1 << 16):
        part = slice(start, start + (1 << 16))
        va, vb, vc = v[a[part]], v[b[part]], v[c[part]]
        total += int((u[a[part]] * (vb - vc) + u[b[part]] * (vc - va) + u[c[part]] * (va - vb)).sum(dtype=np.uint64))
    return total % 2**64 == 0


def _random_words(count: int, stream: int) -> NDArray[np.uint64]:
    """`count` well mixed 64-bit words (finaliser of SplitMix64, Steele et al. 2014)."""
    words = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(stream << 32)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        words = (words ^ (words >> np.uint64(shift))) * np.uint64(factor)
    return words ^ (words >> np.uint64(31))


def wind_outwards(vertices: Array, faces: Faces) -> Winding:
    """Flip the faces that certainly point the wrong way.

    Faces of a shell are wound consistently. A closed shell looks outwards by the sign of its volume; one that lies in
    an odd number of others is a cavity and looks inwards if those had to be turned over. An open shell keeps the sense
    that most of its surface has.

    Parameters
    ----------
    vertices
        (n, 3) welded: no two at the same position.
    faces
        (m, 3) vertex numbers.
    """
    if is_closed(faces):
        shell = _connected_by_vertices(faces, len(vertices))
        turn = _inverted_shells(vertices, faces, shell, np.ones(shell.max() + 1, bool))[shell]
        return Winding(_turned_over(faces, turn), "outward", int(turn.sum()))
    edges = _Edges.of(faces)
    shell, turn, contradictory = _wound_consistently(edges, len(faces))
    count = int(shell.max()) + 1
    area = doubled_areas(vertices, faces)
    against = np.bincount(shell, weights=np.where(turn, area, 0.0), minlength=count)
    mostly = against > np.bincount(shell, weights=area, minlength=count) / 2
    turn = (turn ^ mostly[shell]) & ~contradictory
    consistent = _turned_over(faces, turn)
    closed = _closed_shells(edges, shell, turn)
    turn ^= _inverted_shells(vertices, consistent, shell, closed)[shell]
    repaired = _turned_over(faces, turn)
    state: Orientation = "outward" if is_closed(repaired) else "inconsistent" if contradictory.any() else "open"
    return Winding(repaired, state, int(turn.sum()), edges.rim, int(contradictory.sum()))


def orientation_of(vertices: Array, faces: Faces) -> Orientation:
    """Orientation of a mesh as it is; `vertices` (n, 3) are welded."""
    winding = wind_outwards(vertices, faces)
    if winding.turned == 0:
        return winding.orientation
    return "inward" if winding.orientation == "outward" and winding.turned == len(faces) else "inconsistent"


def _turned_over(faces: Faces, turn: Mask) -> Faces:
    if not turn.any():
        return faces
    result = faces.copy()
    result[turn] = faces[turn][:, ::-1]
    return result


@dataclass(frozen=True)
class _Edges:
    """Directed edges of all faces, sorted so that those between the same two vertices follow each other.

    `face` and `forward` (k,) belong to the directed edges, `start` and `count` to the groups of equal vertices.
    """

    face: NDArray[np.int64]
    forward: Mask
    start: NDArray[np.int64]
    count: NDArray[np.int64]

    @classmethod
    def of(cls, faces: Faces) -> _Edges:
        tail, head = faces.ravel(), faces[:, [1, 2, 0]].ravel()
        face = np.repeat(np.arange(len(faces)), 3)
        collapsed = (faces == faces[:, [1, 2, 0]]).any(1)
        real = ~collapsed[face]  # a face without three vertices connects nothing
        tail, head, face = tail[real], head[real], face[real]
        key = np.minimum(tail, head) * (faces.max() + 1) + np.maximum(tail, head)
        order = np.argsort(key, kind="stable")
        key = key[order]
        start = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])[: len(key)])
        return cls(face[order], (tail < head)[order], start, np.diff(np.append(start, len(key))))

    @property
    def rim(self) -> int:
        return int((self.count == 1).sum())


def _connected_by_vertices(faces: Faces, vertices: int) -> NDArray[np.int64]:
    """Number (m,) of the connected piece that each face belongs to."""
    a, b, c = faces.T
    label = connected_components(vertices, np.concatenate([a, a]), np.concatenate([b, c]))[a]
    renumbered = np.cumsum(np.bincount(label) > 0) - 1
    return np.asarray(renumbered[label])


def connected_components(count: int, one: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.int64]:
    """Component (count,) of each node of a graph with edges `one` to `other` (k,), numbered by their lowest nodes."""
    from scipy.sparse import coo_matrix, csgraph  # noqa: PLC0415  (half a second)

    graph = coo_matrix((np.ones(len(one), bool), (one, other)), shape=(count, count))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1])


def _wound_consistently(edges: _Edges, faces: int) -> tuple[NDArray[np.int64], Mask, Mask]:
    """Shell (m,) of each face, whether it is to be flipped to agree with its shell, and whether no flip can do so.

    Each face has two nodes, one for either sense; an edge between two faces joins the senses that agree. A shell
    whose senses end up connected with each other is one-sided.
    """
    pair = edges.start[edges.count == 2]
    one, other = edges.face[pair], edges.face[pair + 1]
    crossed = np.where(edges.forward[pair] == edges.forward[pair + 1], faces, 0)
    rows = np.concatenate([one, one + faces])
    columns = np.concatenate([other + crossed, other + faces - crossed])
    sense = connected_components(2 * faces, rows, columns)
    as_is, turned = sense[:faces], sense[faces:]
    shell = np.unique(np.minimum(as_is, turned), return_inverse=True)[1]
    return shell.astype(np.int64), turned < as_is, as_is == turned


def _closed_shells(edges: _Edges, shell: NDArray[np.int64], turn: Mask) -> Mask:
    """Whether each shell by itself runs through all its edges equally often in both directions."""
    group = np.repeat(np.arange(len(edges.start)), edges.count)
    of_shell = shell[edges.face]
    sign = np.where(edges.forward ^ turn[edges.face], 1, -1)
    key, place = np.unique(group * (shell.max() + 1) + of_shell, return_inverse=True)
    net = np.bincount(place, weights=sign, minlength=len(key))
    closed = np.ones(int(shell.max()) + 1, bool)
    closed[key[net != 0] % (shell.max() + 1)] = False
    closed[np.setdiff1d(shell, of_shell)] = False  # faces without three vertices
    return closed


def _inverted_shells(vertices: Array, faces: Faces, shell: NDArray[np.int64], closed: Mask) -> Mask:
    """Flags (s,) of the shells that are to be flipped so that all closed ones bound their material."""
    volume = np.bincount(shell, weights=_volumes(vertices, faces), minlength=len(closed))
    negative = closed & (volume < 0)
    if len(closed) == 1 or not negative.any():
        return negative
    shells = _ClosedShells(vertices, faces, shell, closed)
    invert = np.zeros(len(closed), bool)
    if negative.sum() > _MOST_SHELLS:
        return invert
    outermost = [s for s in np.flatnonzero(negative) if not len(shells.around(s))]
    invert[outermost] = True
    for candidate in np.flatnonzero(closed & ~invert & shells.in_boxes_of(outermost)):
        around = shells.around(candidate)
        if invert[around].any():
            invert[candidate] = (volume[candidate] < 0) != (len(around) % 2 == 1)
    return invert


class _ClosedShells:
    """Closed shells, and which of them lie in which others."""

    def __init__(self, vertices: Array, faces: Faces, shell: NDArray[np.int64], closed: Mask) -> None:
        self._vertices, self._closed = vertices, closed
        order = np.argsort(shell, kind="stable")
        self._faces, start = faces[order], np.searchsorted(shell[order], np.arange(len(closed)))
        self._start = np.append(start, len(faces))
        corners = vertices[self._faces]
        self._low = np.minimum.reduceat(corners.min(1), start)
        self._high = np.maximum.reduceat(corners.max(1), start)

    def in_boxes_of(self, others: list[np.intp]) -> Mask:
        """Whether each shell (s,) lies in the bounding box of one of the others."""
        inside = np.zeros(len(self._closed), bool)
        for other in others:
            inside |= ((self._low >= self._low[other]) & (self._high <= self._high[other])).all(1)
        return inside

    def around(self, inner: np.intp) -> NDArray[np.intp]:
        """Numbers of the closed shells that hold shell `inner`."""
        boxes = ((self._low <= self._low[inner]) & (self._high >= self._high[inner])).all(1) & self._closed
        boxes[inner] = False
        point = self._vertices[self._faces[self._start[inner], 0]]
        candidates = np.flatnonzero(boxes)
        turns = [self._turns_around(other, point) for other in candidates]
        return candidates[np.abs(turns) > _SHARE_INSIDE] if len(candidates) else candidates

    def _turns_around(self, shell: np.intp, point: Array) -> float:
        """Winding number of a shell around a point: solid angle / 4π (Van Oosterom and Strackee 1983)."""
        corners = self._vertices[self._faces[self._start[shell] : self._start[shell + 1]]] - point
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        la, lb, lc = np.sqrt((corners**2).sum(2)).T
        above = np.einsum("mi,mi->m", a, np.cross(b, c))
        dots = (np.einsum("mi,mi->m", p, q) for p, q in ((a, b), (b, c), (c, a)))
        ab, bc, ca = dots
        return float(np.arctan2(above, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2 * np.pi))


def _volumes(vertices: Array, faces: Faces) -> Array:
    """Six times the signed volume (m,) between each face and the middle of the vertices."""
    local = vertices - (vertices.min(0) + vertices.max(0)) / 2
    volumes = np.empty(len(faces))
    for start in range(0, len(faces), 1 << 14):  # blocks that stay in the cache
        part = slice(start, start + (1 << 14))
        a, b, c = local[faces[part].T].transpose(0, 2, 1)
        volumes[part] = (
            a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
    return volumes


def doubled_areas(vertices: Array, faces: Faces) -> Array:
    """Twice the area (m,) of each face (m, 3)."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1))


@dataclass(frozen=True)
class Convention:
    """How numbers state an orientation.

    Attributes
    ----------
    count
        How many numbers.
    text
        The convention as text for messages.
    rotations
        Rotations (n,) of numbers (n, count), angles in rad.
    is_angle
        Whether the numbers are angles.
    """

    count: int
    text: str
    rotations: Callable[[Array], Rotation]
    is_angle: bool = False


def _rotation() -> Any:
    """The class of rotations."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415  (half a second, which no scan needs)

    return Rotation


CONVENTIONS = {
    "matrix": Convention(9, "rotation matrix, row by row", lambda v: _rotation().from_matrix(v.reshape(-1, 3, 3))),
    "wxyz": Convention(4, "quaternion w, x, y, z", lambda v: _rotation().from_quat(v[:, [1, 2, 3, 0]])),
    "xyzw": Convention(4, "quaternion x, y, z, w", lambda v: _rotation().from_quat(v)),
    "xyz": Convention(3, "Euler angles XYZ': Rx(1) Ry(2) Rz(3)", lambda v: _rotation().from_euler("XYZ", v), True),
    "zyz": Convention(3, "Euler angles ZYZ': Rz(1) Ry(2) Rz(3)", lambda v: _rotation().from_euler("ZYZ", v), True),
    "xyzwpr": Convention(
        3, "W, P, R of XYZWPR: Rz(3) Ry(2) Rx(1)", lambda v: _rotation().from_euler("ZYX", v[:, ::-1]), True
    ),
    "zyx": Convention(3, "A, B, C of KUKA, ZYX': Rz(1) Ry(2) Rx(3)", lambda v: _rotation().from_euler("ZYX", v), True),
    "rotvec": Convention(3, "rotation vector", lambda v: _rotation().from_rotvec(v), True),
}


def _of_order(order: str) -> Convention:
    rotations = " ".join(f"R{axis}({i})" for i, axis in enumerate(order, 1))
    text = f"Euler angles {order.upper()}': {rotations}"
    return Convention(3, text, lambda v: _rotation().from_euler(order.upper(), v), True)


CONVENTIONS |= {order: _of_order(order) for order in ("xyx", "xzx", "xzy", "yxy", "yxz", "yzx", "yzy", "zxy", "zxz")}


@dataclass(frozen=True)
class PoseReading:
    """A reading of the numbers of poses; `axes` are the columns of the position that are x, y and z."""

    convention: str
    length: str = "mm"
    angle: str = "deg"
    is_inverse: bool = False
    axes: tuple[int, ...] = (0, 1, 2)

    def text(self) -> str:
        """The reading as text for messages."""
        convention = CONVENTIONS[self.convention]
        words = [f"{self.convention} ({convention.text})", f"position in {self.length}"]
        if convention.is_angle:
            words.insert(1, f"angles in {self.angle}")
        if self.axes != (0, 1, 2):
            words.append("position in the order " + ", ".join("xyz"[axis] for axis in self.axes))
        return ", ".join(words) + (", of the base in the flange (inverted)" if self.is_inverse else "")


@dataclass(frozen=True)
class StatedPoses:
    """Poses as a controller states them: numbers of position (n, 3) and orientation (n, k), and their reading."""

    position: Array
    orientation: Array
    reading: PoseReading

    def matrices(self, reading: PoseReading | None = None) -> Array:
        """Poses (n, 4, 4) of the flange in the robot's base, m, by their reading or by another one."""
        reading = reading or self.reading
        convention, values = CONVENTIONS[reading.convention], self.orientation
        scale = _ANGLES[reading.angle] if convention.is_angle else 1.0
        rotation = convention.rotations(scale * values).as_matrix()
        found = pose.from_rotation(rotation, _LENGTHS[reading.length] * self.position[:, list(reading.axes)])
        return pose.inverse(found) if reading.is_inverse else found

    def wrong_row(self) -> tuple[int, str] | None:
        """The first row whose orientation is no rotation, and what was expected."""
        values, name = self.orientation, self.reading.convention
        if CONVENTIONS[name].is_angle:
            return None
        if name == "matrix":
            matrices = values.reshape(-1, 3, 3)
            error = np.abs(np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)).max((1, 2))
            error = np.maximum(error, 1.0 - np.linalg.det(matrices))
            expected = "a right-handed orthonormal matrix"
        else:
            error, expected = np.abs(np.linalg.norm(values, axis=1) - 1.0), "a quaternion of length 1"
        wrong = np.flatnonzero(error > _UNIT_TOLERANCE)
        return (int(wrong[0]), expected) if len(wrong) else None

    def rows(self, chosen: NDArray[np.intp]) -> StatedPoses:
        """Poses of some rows."""
        return replace(self, position=self.position[chosen], orientation=self.orientation[chosen])

    def alternatives(self) -> Iterator[PoseReading]:
        """Other readings of the same numbers: another convention, unit, or direction; or position axes swapped.

        Units in which the numbers are implausible are left out.
        """
        own, count = self.reading, self.orientation.shape[1]
        far, turned = np.linalg.norm(self.position, axis=1).max(), np.abs(self.orientation).max()
        lengths = [name for name, scale in _LENGTHS.items() if _REACH[0] < scale * far < _REACH[1]]
        angles = [name for name, scale in _ANGLES.items() if scale * turned < _LARGEST_ANGLE]
        for name, length, inverse in product(CONVENTIONS, lengths, (False, True)):
            if CONVENTIONS[name].count == count:
                for angle in angles if CONVENTIONS[name].is_angle else (own.angle,):
                    yield PoseReading(name, length, angle, inverse)
        for axes in permutations(range(3)):
            yield replace(own, axes=axes)


def better_reading(stated: StatedPoses, misfit: Callable[[Array], float]) -> tuple[PoseReading, float, float] | None:
    """The reading that fits best, its misfit and that of the stated one; None if none is much better, or fits.

    Parameters
    ----------
    misfit
        Misfit of poses (n, 4, 4) of the flange, m; infinite where they cannot be evaluated.
    """
    own = misfit(stated.matrices())
    others = [reading for reading in stated.alternatives() if reading != stated.reading]
    misfits = [misfit(stated.matrices(reading)) for reading in others]
    best, reading = min(zip(misfits, others, strict=True), key=lambda pair: pair[0])
    return (reading, best, own) if best < min(_MUCH_BETTER * own, _FITS) else None
