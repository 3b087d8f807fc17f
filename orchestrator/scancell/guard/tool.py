"""Pose of the tool, which is jogged, and its Jacobian."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_bounds import arm_motion

Array = NDArray[np.float64]

_SINGULAR = 0.01  # smallest singular value of the Jacobian from which on the controller moves the tool straight


class Tool:
    """Kinematics of the sensor of a cell.

    Attributes
    ----------
    active
        Numbers from 0 of the joints that Cartesian motion moves.
    held
        Those that it does not.
    """

    def __init__(self, nominal: NominalCell) -> None:
        self._motion, self._flange_from_tool = arm_motion(nominal), nominal.flange_from_sensor
        held = {joint.index for joint in nominal.arm.held}
        self.held = np.array(sorted(held), np.int64)
        self.active = np.array([i for i in range(len(nominal.arm.joints)) if i not in held], np.int64)

    def poses(self, joints: Array) -> tuple[Array, Array]:
        """``world_from_tool`` (n, 4, 4) at joints (n, joints), and the geometric Jacobian (n, 6, joints) of its origin.

        The Jacobian is in world axes: linear velocity, then angular velocity.
        """
        return self._motion.tool_poses(joints, joints.shape[1] - 1, self._flange_from_tool)

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
        """Length (m) of the path of the tool's origin through joints (n, joints)."""
        position = self.poses(joints)[0][:, :3, 3]
        return float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
