"""Bounds on the relative motion of the bodies of a cell while its axes move by bounded angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.nominal.cell import Body, NominalCell
from scancell.proximity._native import CellMotion

Array = NDArray[np.float64]

_COLUMNS = 23  # of a body
_ON_FLANGE = ("sensor", "finger")


class MotionBounds:
    """Motion bounds of pairs of bodies, by their bounding spheres.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    pairs
        Names of the bodies of each pair.

    Attributes
    ----------
    native
        Kinematics and bounds of the compiled module.
    """

    def __init__(self, nominal: NominalCell, pairs: Sequence[tuple[str, str]]) -> None:
        number = {body.name: i for i, body in enumerate(nominal.bodies)}
        index = np.array([(number[a], number[b]) for a, b in pairs], np.int64).reshape(-1, 2)
        bodies = np.array([_row(nominal, body) for body in nominal.bodies])
        self.native = CellMotion(_joints(nominal), nominal.arm.world_from_base, nominal.world_from_table, bodies, index)

    def pairs(self, at: Array, half_travel: Array) -> Array:
        """Bounds (..., n, pairs), m, on the motion of a body relative to the other while no axis moves by more.

        `at` is (n, joints + 1) and `half_travel` (..., n, joints + 1), rad.
        """
        return self.straight(at, np.zeros_like(half_travel), half_travel)

    def straight(self, at: Array, half: Array, slack: Array) -> Array:
        """The same while axes follow a straight line from `at`, by `half` times -1 to 1, and leave it by `slack`."""
        half, slack = np.broadcast_arrays(np.asarray(half, float), np.asarray(slack, float))
        axes = half.shape[-1]
        here = np.broadcast_to(at, half.shape).reshape(-1, axes)
        found = self.native.bounds(here, half.reshape(-1, axes), slack.reshape(-1, axes))
        return found.reshape(*half.shape[:-1], found.shape[-1])


def arm_motion(nominal: NominalCell) -> CellMotion:
    """Kinematics of the arm and the table alone."""
    none = np.zeros((0, _COLUMNS)), np.zeros((0, 2), np.int64)
    return CellMotion(_joints(nominal), nominal.arm.world_from_base, nominal.world_from_table, *none)


def _joints(nominal: NominalCell) -> Array:
    """Denavit-Hartenberg parameters a, d, theta and the rotation by alpha and beta of each joint, (joints, 12)."""
    arm = nominal.arm
    twist = pose.rotation_about(0, arm.column("alpha")) @ pose.rotation_about(1, arm.column("beta"))
    plain = np.stack([arm.column(name) for name in ("a", "d", "theta")], 1)
    return np.hstack([plain, twist.reshape(-1, 9)])


def _row(nominal: NominalCell, body: Body) -> Array:
    """Parameters of a body for the native kinematics, (_COLUMNS,).

    Number of joints that carry it, whether the table turns it, bounding sphere (centre and radius) in the frame of the
    carrier (last link, table or world), largest distance from the table's axis, and pose in that frame.
    """
    frame, _, number = body.moves_with.partition("[")
    here, turned = (nominal.frame_poses(nominal.home, np.array(angle)) for angle in (0.0, 1.0))
    on_table = not np.allclose(here[body.moves_with], turned[body.moves_with])
    joints = int(number.rstrip("]")) if frame == "link" else len(nominal.arm.joints) if frame in _ON_FLANGE else 0
    carrier = nominal.world_from_table if on_table else here[f"link[{joints}]"] if joints else np.eye(4)
    carrier_from_body = pose.inverse(carrier) @ here[body.moves_with]
    points = pose.transform_points(carrier_from_body, body.mesh.vertices)
    centre = (points.min(0) + points.max(0)) / 2
    radius = np.linalg.norm(points - centre, axis=1).max()
    from_axis = np.linalg.norm(points[:, :2], axis=1).max() if on_table else 0.0
    return np.concatenate([[joints, on_table], centre, [radius, from_axis], carrier_from_body.ravel()])
