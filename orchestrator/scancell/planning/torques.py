"""Torques that a motion asks of the joints, by the inverse dynamics of DART."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.cell.arm_dynamics import dynamics_json
from scancell.config.cell import CellDescription
from scancell.errors import CellError
from scancell.geometry import pose
from scancell.nominal.cell import arm_of

Array = NDArray[np.float64]


def joint_torques(cell: CellDescription, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """Torques (n, joints), N m, that links, sensor and gripper housing of a cell's arm ask of its joints.

    Friction and the inertia of motors are not included.

    Parameters
    ----------
    q, qd, qdd
        (n, joints) joints of a path, rad, their rates, rad/s, and accelerations, rad/s².

    Raises
    ------
    CellError
        If a link has neither an inertia nor a mesh to compute it from.
    MeshError
        If a mesh that tells of masses cannot be used.
    """
    for number, joint in enumerate(cell.robot.joint, start=1):
        if joint.inertia is None and joint.mesh is None:
            raise CellError(f"robot.joint[{number}]: torques need an inertia, or a mesh to compute it from")
    skeleton = _skeleton(cell)
    torques = []
    for position, rate, acceleration in zip(*(np.atleast_2d(np.asarray(x, float)) for x in (q, qd, qdd)), strict=True):
        skeleton.setPositions(position)
        skeleton.setVelocities(rate)
        skeleton.setAccelerations(acceleration)
        skeleton.computeInverseDynamics()
        torques.append(skeleton.getForces())
    return np.array(torques).reshape(-1, len(cell.robot.joint))


def _skeleton(cell: CellDescription) -> Any:
    """The arm with a body per link in its Denavit-Hartenberg frame."""
    import dartpy  # noqa: PLC0415  (it loads libGL, which few machines without a screen have)

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
