"""Bounds on the relative motion of the bodies of a cell while its axes move by bounded angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.chain import Chain
from scancell.nominal.cell import Body, NominalCell
from scancell.proximity._native import CellMotion

Array = NDArray[np.float64]

_REVOLUTE = 1  # kind of a joint
_WORLD = -1  # as the parent of a joint, or the frame of a body


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
        joints = _joints(nominal)
        bodies = np.array([_row(nominal, body) for body in nominal.bodies])
        self.native = CellMotion(joints, len(joints), bodies, index)

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
    """Kinematics of the arm alone; its last frame is the flange."""
    joints = _joints(nominal)[:-1]
    return CellMotion(joints, len(joints), np.zeros((0, 22)), np.zeros((0, 2), np.int64))


def _joints(nominal: NominalCell) -> Array:
    """Joints (joints + 1, 35) of arm and table: kind, parent, axis, and the constant poses before and behind each."""
    arm = nominal.arm
    rows = []
    for i, joint in enumerate(arm.joints):
        before = arm.world_from_base if i == 0 else np.eye(4)
        rows.append(_joint(i - 1, i, before, Chain([joint]).fk([0.0])))
    return np.array([*rows, _joint(_WORLD, len(rows), nominal.world_from_table, np.eye(4))])


def _joint(parent: int, axis: int, parent_from_joint: Array, joint_from_frame: Array) -> Array:
    return np.concatenate([[_REVOLUTE, parent, axis], parent_from_joint.ravel(), joint_from_frame.ravel()])


def _row(nominal: NominalCell, body: Body) -> Array:
    """Parameters (22,) of a body for the native kinematics.

    Frame that carries it, bounding sphere (centre and radius) in it, largest distance of the body from the axis of the
    last joint that moves it, and its pose in the frame.
    """
    frame, _, number = body.moves_with.partition("[")
    here, turned = (nominal.frame_poses(nominal.home, np.array(angle)) for angle in (0.0, 1.0))
    joints, links = len(nominal.arm.joints), nominal.arm.link_poses(nominal.home)
    carrier, world_from_joint, carried = np.eye(4), np.eye(4), _WORLD
    if not np.allclose(here[body.moves_with], turned[body.moves_with]):
        carrier, world_from_joint, carried = nominal.world_from_table, nominal.world_from_table, joints
    elif frame in ("link", "sensor", "finger"):
        last = int(number.rstrip("]")) if frame == "link" else joints
        carrier, world_from_joint, carried = links[last], links[last - 1], last - 1
    carrier_from_body = pose.inverse(carrier) @ here[body.moves_with]
    points = pose.transform_points(carrier_from_body, body.mesh.vertices)
    centre = (points.min(0) + points.max(0)) / 2
    radius = np.linalg.norm(points - centre, axis=1).max()
    in_joint = pose.transform_points(pose.inverse(world_from_joint) @ carrier, points)
    from_axis = np.linalg.norm(in_joint[:, :2], axis=1).max()
    return np.concatenate([[carried], centre, [radius, from_axis], carrier_from_body.ravel()])
