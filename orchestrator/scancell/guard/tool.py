"""Pose of the tool, which is jogged, and its Jacobian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.nominal.cell import NominalCell

Array = NDArray[np.float64]

_SINGULAR = 0.01  # smallest singular value of the Jacobian from which on the controller moves the tool straight


class Tool:
    """Kinematics of the sensor of a cell.

    Attributes
    ----------
    active
        Numbers from 0 of the joints that Cartesian motion moves: all but the held ones.
    """

    def __init__(self, nominal: NominalCell) -> None:
        self._nominal = nominal
        held = {joint.index for joint in nominal.arm.held}
        self.active = np.array([i for i in range(len(nominal.arm.joints)) if i not in held], np.int64)

    def poses(self, joints: Array) -> tuple[Array, Array]:
        """``world_from_tool`` (n, 4, 4) at joints (n, joints), and the geometric Jacobian (n, 6, joints) of its origin.

        The Jacobian is in world axes: linear velocity, then angular velocity.
        """
        frames = self._nominal.arm.link_poses(joints)
        tool = frames[:, -1] @ self._nominal.flange_from_sensor
        u, v, w = frames[:, :-1, 0, 2], frames[:, :-1, 1, 2], frames[:, :-1, 2, 2]
        x, y, z = np.moveaxis(tool[:, None, :3, 3] - frames[:, :-1, :3, 3], -1, 0)
        return tool, np.stack([v * z - w * y, w * x - u * z, u * y - v * x, u, v, w], 1)

    def moves_straight(self, jacobian: Array) -> bool:
        """Whether Cartesian motion is possible with a Jacobian (6, joints): six active joints, no singular position."""
        if len(self.active) != 6:
            return False
        return bool(np.linalg.svd(jacobian[:, self.active], compute_uv=False)[-1] >= _SINGULAR)

    def rates(self, jacobian: Array, twist: Array) -> Array:
        """Rates (n, joints), rad/s, of twists (n, 6) of the tool, world axes; held joints stand still."""
        rates = np.zeros((len(twist), jacobian.shape[-1]))
        rates[:, self.active] = np.linalg.solve(jacobian[..., self.active], twist[..., None])[..., 0]
        return rates

    def length(self, joints: Array) -> float:
        """Length (m) of the way of the tool's origin through joints (n, joints)."""
        position = self.poses(joints)[0][:, :3, 3]
        return float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
