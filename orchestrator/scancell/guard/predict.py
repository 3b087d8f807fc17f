"""Prediction of motion in manual operation: axes along each path, for many times and hypotheses at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.guard.motion import Hypothesis, Path
from scancell.guard.tool import Tool
from scancell.nominal.cell import NominalCell

Array = NDArray[np.float64]

_STEPS = 8  # of Newton's method
_FOUND = 1e-6  # m and rad: poses that are met; one step further the error is that squared
_NO_TURN = 1e-9  # rad/s


class Predictor:
    """Predicts axes along hypotheses.

    Joint limits are not taken into account: a prediction goes further than the robot can.
    """

    def __init__(self, nominal: NominalCell) -> None:
        self._tool = Tool(nominal)

    def axes(self, hypotheses: Sequence[Hypothesis], times: Array) -> Array:
        """Positions (h, n, axes), rad, of h hypotheses at increasing `times` (h, n) after their states, s.

        Cartesian paths solve the inverse kinematics by Newton's method from joint-interpolated motion. Behind a place
        that it does not reach, such as a singular position, the joints keep the rates that they had there.
        """
        start = np.array([hypothesis.state.axes for hypothesis in hypotheses])
        rates = np.array([hypothesis.rates for hypothesis in hypotheses])
        found = np.asarray(start[:, None] + times[..., None] * rates[:, None])
        bent = [i for i, hypothesis in enumerate(hypotheses) if hypothesis.path is not Path.JOINT]
        if bent:
            in_tool = np.array([hypotheses[i].path is Path.TOOL for i in bent])
            found[bent, :, :-1] = self._cartesian(start[bent, :-1], rates[bent, :-1], in_tool, times[bent])
        return found

    def _cartesian(self, start: Array, rates: Array, in_tool: NDArray[np.bool_], times: Array) -> Array:
        here, jacobian = self._tool.poses(start)
        twist = (jacobian @ rates[..., None])[..., 0]
        wanted = _poses(here, twist, in_tool, times)
        guess = start[:, None] + times[..., None] * rates[:, None]
        joints, met = self._solved(guess.reshape(-1, start.shape[1]), wanted.reshape(-1, 4, 4))
        return _continued(joints.reshape(guess.shape), met.reshape(times.shape), guess, times)

    def _solved(self, joints: Array, wanted: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Joints (n, joints) at which the tool has the poses (n, 4, 4), and for which of them that is the case."""
        for _ in range(_STEPS):
            here, jacobian = self._tool.poses(joints)
            miss = np.concatenate(
                [wanted[:, :3, 3] - here[:, :3, 3], _rotation_between(here[:, :3, :3], wanted[:, :3, :3])], 1
            )
            met = np.abs(miss).max(1) <= _FOUND
            try:
                step = self._tool.rates(jacobian, miss)
            except np.linalg.LinAlgError:
                break
            joints = joints + np.clip(step, -0.5, 0.5)
            if met.all():
                break
        return joints, met


def _poses(start: Array, twist: Array, in_tool: NDArray[np.bool_], times: Array) -> Array:
    """Poses (h, n, 4, 4) at `times` (h, n), s, of motion from `start` (h, 4, 4) with twists (h, 6) there, world axes.

    The velocity keeps its direction in the world, or turns with the tool.
    """
    velocity, turn = twist[:, None, :3], twist[:, None, 3:]
    t = times[..., None]
    rotation = pose.exp_rotation(turn * t) @ start[:, None, :3, :3]
    straight = velocity * t
    speed = np.linalg.norm(turn, axis=-1, keepdims=True)
    turning = np.maximum(speed, _NO_TURN)
    axis = turn / turning
    along = (velocity * axis).sum(-1, keepdims=True) * axis
    across = velocity - along
    angle = turning * t
    bow = np.sin(angle) / turning * across + 2 * np.sin(angle / 2) ** 2 / turning * np.cross(axis, across)
    helix = np.where(speed > _NO_TURN, along * t + bow, straight)
    moved = np.where(in_tool[:, None, None], helix, straight)
    return pose.from_rotation(rotation, start[:, None, :3, 3] + moved)


def _rotation_between(here: Array, wanted: Array) -> Array:
    """Rotation vectors (n, 3), world axes, from rotations (n, 3, 3) to others, as long as the sines of the angles."""
    turn = wanted @ np.swapaxes(here, -1, -2)
    return np.asarray((turn - np.swapaxes(turn, -1, -2))[:, (2, 0, 1), (1, 2, 0)] / 2)


def _continued(joints: Array, met: NDArray[np.bool_], guess: Array, times: Array) -> Array:
    """Joints (h, n, joints) with those behind the first place that is not `met` (h, n) at the rates before it.

    There are such rates from the third place on; before, all are those of `guess`.
    """
    for row in np.flatnonzero(~met.all(1)):
        first = int(np.argmin(met[row]))
        if first < 2:
            joints[row] = guess[row]
            continue
        last = (joints[row, first - 1] - joints[row, first - 2]) / (times[row, first - 1] - times[row, first - 2])
        joints[row, first:] = joints[row, first - 1] + (times[row, first:] - times[row, first - 1])[:, None] * last
    return joints
