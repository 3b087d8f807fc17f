"""Joint torques of a motion, by the inverse dynamics of DART."""

from __future__ import annotations

from typing import Any

import numpy as np

from scancell.arrays import Array
from scancell.cell.fmu_file import dynamics_json
from scancell.config.cell import CellDescription
from scancell.errors import CellError
from scancell.geometry import pose
from scancell.nominal.cell import arm_of

_SHARE = 0.8  # of the torque that gravity and friction leave: gears are elastic and oscillate


class TorqueLimits:
    """Torque limits of an arm with dynamic drives, for planning.

    Raises errors as `arm_skeleton`.

    Parameters
    ----------
    cell
        Description; every joint must have a drive.
    """

    def __init__(self, cell: CellDescription) -> None:
        drives = [joint.drive for joint in cell.robot.joint if joint.drive is not None]
        self._skeleton = arm_skeleton(cell)
        self._limit = np.array([drive.max_torque_n_m for drive in drives])
        self._rotor = np.array([drive.motor_inertia_kg_m2 for drive in drives])
        self._coulomb = np.array([drive.coulomb_friction_n_m for drive in drives])
        self._viscous = np.array([drive.viscous_friction_n_m_s_rad for drive in drives])

    def needed_slowdown(self, q: Array, period: float) -> tuple[float, int]:
        """Factor by which a motion must last longer so that all motors keep their torque limits, and the joint.

        With a factor k, the torque is ``static + viscous / k + dynamic / k²``: gravity and Coulomb friction stay. The
        factor is infinite where these alone exceed the limit, and 0 for a motion without the other two.

        Parameters
        ----------
        q
            (n, joints) joints, rad, every `period` s.
        """
        rate = np.gradient(q, period, axis=0)
        acceleration = np.gradient(rate, period, axis=0)
        rest = np.zeros_like(q)
        static = joint_torques(self._skeleton, q, rest, rest)
        dynamic = joint_torques(self._skeleton, q, rate, acceleration) - static + self._rotor * acceleration
        viscous = self._viscous * rate
        left = self._limit - np.abs(static) - self._coulomb
        if (left < 0).any():
            return np.inf, int(np.argmin(left.min(0)))
        left *= _SHARE
        # left k² - |viscous| k - |dynamic| = 0; magnitudes add, which is on the safe side.
        size, speed = np.abs(dynamic), np.abs(viscous)
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = (speed + np.sqrt(speed**2 + 4 * left * size)) / (2 * left)
        factor = np.where((size == 0) & (speed == 0), 0.0, factor)
        worst = factor.max(0)
        return float(worst.max()), int(np.argmax(worst))


def joint_torques(skeleton: Any, q: Array, qd: Array, qdd: Array) -> Array:
    """Joint torques (n, joints), N m, that move the links, sensor and gripper housing of an arm.

    Friction and the inertia of motors are not included.

    Parameters
    ----------
    skeleton
        The arm, from `arm_skeleton`.
    q, qd, qdd
        (n, joints) joints of a path, rad, their rates, rad/s, and accelerations, rad/s².
    """
    torques = np.empty_like(q)
    for row, position, rate, acceleration in zip(torques, q, qd, qdd, strict=True):
        skeleton.setPositions(position)
        skeleton.setVelocities(rate)
        skeleton.setAccelerations(acceleration)
        skeleton.computeInverseDynamics()
        row[:] = skeleton.getForces()
    return torques


def arm_skeleton(cell: CellDescription) -> Any:
    """The arm of a cell in DART, with a body per link in its Denavit-Hartenberg frame.

    Raises `CellError` if a link has neither an inertia nor a mesh to compute it from; `MeshError` if a mesh that
    defines masses cannot be used.
    """
    import dartpy  # noqa: PLC0415  (it loads libGL, which few machines without a screen have)

    for number, joint in enumerate(cell.robot.joint, start=1):
        if joint.inertia is None and joint.mesh is None:
            raise CellError("torques need an inertia, or a mesh to compute it from", key=f"robot.joint[{number}]")
    arm = arm_of(cell.robot)
    frames = arm.link_poses(np.zeros(len(arm.joints)))
    skeleton = dartpy.dynamics.Skeleton(cell.robot.name)
    skeleton.setGravity(np.array([0.0, 0.0, -cell.world.gravity_m_s2]))
    body = None
    for number, link in enumerate(dynamics_json(cell)["links"], start=1):
        joint = dartpy.dynamics.RevoluteJointProperties()
        joint.mAxis = np.array([0.0, 0.0, 1.0])
        joint.mName = f"joint{number}"
        if number == 1:
            joint.mT_ParentBodyToJoint = dartpy.math.Isometry3(arm.world_from_base)
        joint_from_link = pose.inverse(frames[number - 1]) @ frames[number]
        joint.mT_ChildBodyToJoint = dartpy.math.Isometry3(pose.inverse(joint_from_link))
        _, body = skeleton.createRevoluteJointAndBodyNodePair(body, joint)
        inertia = (link["mass"], np.array(link["centre_of_mass"]), np.array(link["inertia"]))
        body.setInertia(dartpy.dynamics.Inertia(*inertia))
    return skeleton
