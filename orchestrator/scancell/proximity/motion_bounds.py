"""Bounds on the relative motion of the bodies of a cell while its axes move by bounded angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.tree import WORLD, Tree
from scancell.nominal.cell import Body, NominalCell
from scancell.proximity._native import CellMotion

Array = NDArray[np.float64]

_KINDS = {"fixed": 0, "revolute": 1, "prismatic": 2}
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
        nominal.require_simulated()
        number = {body.name: i for i, body in enumerate(nominal.bodies)}
        index = np.array([(number[a], number[b]) for a, b in pairs], np.int64).reshape(-1, 2)
        joints = _joints(nominal.tree, nominal.axes)
        bodies = np.array([_row(nominal, body) for body in nominal.bodies])
        self.native = CellMotion(joints, len(joints), bodies, index)

    def pairs(self, at: Array, half_travel: Array) -> Array:
        """Bounds (..., n, pairs), m, on the motion of a body relative to the other while no axis moves by more.

        `at` is (n, axes) and `half_travel` (..., n, axes), rad.
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
    joints = _joints(nominal.arm.tree, nominal.axes)
    return CellMotion(joints, len(joints), np.zeros((0, 22)), np.zeros((0, 2), np.int64))


def _moved_frames(tree: Tree, axes: Sequence[str]) -> list[str]:
    return [joint.frame for joint in tree.joints if joint.axis in axes]


def _joints(tree: Tree, axes: Sequence[str]) -> Array:
    """Joints (n, 35) that the axes move: kind, parent, axis, and the constant poses before and behind each."""
    frames = _moved_frames(tree, axes)
    rows = []
    for frame in frames:
        joint = tree[frame]
        carrier, carrier_from_parent = tree.carrier_of(joint.parent, axes)
        parent = _WORLD if carrier == WORLD else frames.index(carrier)
        numbers = [_KINDS[joint.kind], parent, axes.index(joint.axis)]
        before = carrier_from_parent @ joint.parent_from_joint
        rows.append(np.concatenate([numbers, before.ravel(), joint.frame_at_zero.ravel()]))
    return np.array(rows).reshape(-1, 35)


def _row(nominal: NominalCell, body: Body) -> Array:
    """Parameters (22,) of a body for the native kinematics.

    Frame that carries it, bounding sphere (centre and radius) in it, largest distance of the body from the axis of the
    last joint that moves it, and its pose in the frame.
    """
    tree, axes = nominal.tree, nominal.axes
    carrier, carrier_from_body = tree.carrier_of(body.moves_with, axes)
    points = pose.transform_points(carrier_from_body, body.mesh.vertices)
    centre = (points.min(0) + points.max(0)) / 2
    radius = np.linalg.norm(points - centre, axis=1).max()
    number, from_axis = _WORLD, 0.0
    if carrier != WORLD:
        number = _moved_frames(tree, axes).index(carrier)
        in_joint = pose.transform_points(tree[carrier].frame_at_zero, points)
        from_axis = np.linalg.norm(in_joint[:, :2], axis=1).max()
    return np.concatenate([[number], centre, [radius, from_axis], carrier_from_body.ravel()])
