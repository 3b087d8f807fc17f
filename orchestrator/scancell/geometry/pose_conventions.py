"""Conventions in which robot controllers state poses, and which of them agrees with a set of measurements.

A reading of a table of poses is a convention of the orientation, the units of its angles and lengths, and whether the
poses are those of the flange in the base, or their inverses. A wrong reading gives poses that no rigid arrangement of
robot, sensor and target explains, while the right one does: `better_reading` compares them by a misfit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_LENGTHS = {"mm": 1e-3, "m": 1.0}
_ANGLES = {"deg": np.pi / 180, "rad": 1.0}
_UNIT_TOLERANCE = 1e-3  # of the length of a quaternion, and of the elements of RᵀR
_MUCH_BETTER = 1 / 3  # of the misfit of the stated reading
_FITS = 5e-3  # m: a reading with a larger misfit is wrong, too
_REACH = (0.01, 50.0)  # m: of the flange from the base
_LARGEST_ANGLE = 4 * np.pi  # rad


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
        """Those of some rows."""
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
        Of poses (n, 4, 4) of the flange, m; infinite where they cannot be evaluated.
    """
    own = misfit(stated.matrices())
    others = [reading for reading in stated.alternatives() if reading != stated.reading]
    misfits = [misfit(stated.matrices(reading)) for reading in others]
    best, reading = min(zip(misfits, others, strict=True), key=lambda pair: pair[0])
    return (reading, best, own) if best < min(_MUCH_BETTER * own, _FITS) else None
