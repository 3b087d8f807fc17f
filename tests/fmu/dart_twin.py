"""Reference model of the rigid cell with dartpy, an independent check of the FMU's dynamics.

It is built from the same JSON (`cell_json`) and follows the same set-points, but shares no code with the FMU: joints
are velocity actuators integrated by the engine, and parts are held by the engine's friction alone. Encoders, triggers,
limits, compliance and stick constraints are not modelled. Parts must be boxes, because dartpy creates no mesh shapes
from arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import dartpy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mesh_json import read_mesh_json
from scancell.geometry import pose

Array = NDArray[np.float64]

_JOINTS = 6
_TICKS_PER_SECOND = 1_000_000


class DartTwin:
    """Reference model of a cell description (`cell_json`) in its initial state; times are integer microseconds.

    Raises
    ------
    ValueError
        If a free part is not a box.
    """

    def __init__(self, cell: Mapping[str, Any]) -> None:
        self._cell = cell
        self._world = dartpy.simulation.World()
        self._world.setTimeStep(cell["time_step_us"] / _TICKS_PER_SECOND)
        self._world.setGravity(np.array(cell["gravity"], float))
        self._world.getConstraintSolver().setCollisionDetector(dartpy.collision.OdeCollisionDetector())
        self._arm = self._make_arm()
        self._table = self._make_table()
        for skeleton in (self._arm, self._table):
            self._world.addSkeleton(skeleton)
        self._parts = {
            i: self._make_part(i, part) for i, part in enumerate(cell["parts"], 1) if part["fixture"] == "free"
        }
        self._time_us = 0
        start = self.positions
        self._before, self._knot, self._rate = start, start, np.zeros(_JOINTS + 1)

    def _make_arm(self) -> Any:
        arm = dartpy.dynamics.Skeleton("arm")
        parent = None
        robot = self._cell["robot"]
        for i, row in enumerate(robot["joints"]):
            joint = _driven_joint(f"joint{i + 1}")
            if i == 0:
                joint.mT_ParentBodyToJoint = _isometry(_matrix_of_pose(robot["world_from_base"]))
            joint.mT_ChildBodyToJoint = _isometry(pose.inverse(_joint_from_link(row)))
            _, parent = arm.createRevoluteJointAndBodyNodePair(parent, joint)
        arm.setPositions(np.array([row["start"] for row in robot["joints"]]))
        return arm

    def _make_table(self) -> Any:
        described = self._cell["table"]
        table = dartpy.dynamics.Skeleton("table")
        joint = _driven_joint("axis")
        joint.mT_ParentBodyToJoint = _isometry(_matrix_of_pose(described["world_from_table"]))
        _, platter = table.createRevoluteJointAndBodyNodePair(None, joint)
        shape = dartpy.dynamics.CylinderShape(described["radius"], described["thickness"])
        _add_shape(platter, shape, described["friction"], pose.translation((0.0, 0.0, -described["thickness"] / 2)))
        table.setPositions(np.array([described["start"]]))
        return table

    def _make_part(self, number: int, part: Mapping[str, Any]) -> Any:
        vertices, _ = read_mesh_json(part["hull"])
        low, high = vertices.min(0), vertices.max(0)
        if len(vertices) != 8 or not np.isclose(vertices[:, :, None], np.stack([low, high], -1)).any(-1).all():
            raise ValueError(f"parts[{number - 1}].hull: expected a box aligned with the axes of its frame")
        skeleton = dartpy.dynamics.Skeleton(f"part {number}")
        joint, body = skeleton.createFreeJointAndBodyNodePair(None)
        mass, centre, inertia = (part["inertial"][key] for key in ("mass", "centre_of_mass", "inertia"))
        body.setInertia(dartpy.dynamics.Inertia(mass, np.array(centre, float), np.array(inertia, float)))
        _add_shape(body, dartpy.dynamics.BoxShape(high - low), part["friction"], pose.translation((low + high) / 2))
        world_from_support = {"table": self.table_pose, "world": np.eye(4)}[part["stands_on"]]
        joint.setTransform(_isometry(world_from_support @ _matrix_of_pose(part["support_from_part"])))
        self._world.addSkeleton(skeleton)
        return skeleton

    @property
    def time_us(self) -> int:
        """Simulated time, µs."""
        return self._time_us

    @property
    def positions(self) -> Array:
        """Angles (7,) of joints and table, rad."""
        return np.append(self._arm.getPositions(), self._table.getPositions())

    @property
    def table_pose(self) -> Array:
        """``world_from_table`` (4, 4) of the rotating platter."""
        return np.asarray(self._table.getBodyNode(0).getWorldTransform().matrix())

    def link_pose(self, number: int) -> Array:
        """``world_from_link`` (4, 4) of link 1 to 6."""
        return np.asarray(self._arm.getBodyNode(number - 1).getWorldTransform().matrix())

    def part_pose(self, number: int) -> Array:
        """``world_from_part`` (4, 4) of a free part by its one-based index."""
        return np.asarray(self._parts[number].getBodyNode(0).getWorldTransform().matrix())

    def cycle(self, set_points: ArrayLike) -> Array:
        """Positions (n, 7), rad, at each dynamics step of one controller cycle that ends at the set-points (7,).

        Axes follow a cubic whose end speeds are those of the parabola through the last three set-points.
        """
        target = np.asarray(set_points, float)
        duration = self._cell["controller_cycle_us"] / _TICKS_PER_SECOND
        rate = (3.0 * (target - self._knot) - (self._knot - self._before)) / (2.0 * duration)
        steps = self._cell["controller_cycle_us"] // self._cell["time_step_us"]
        track = _cubic(self._knot, target, self._rate * duration, rate * duration, np.arange(1, steps + 1) / steps)
        reached = []
        for step in np.diff(track, axis=0, prepend=self._knot[None]):
            speed = step / self._world.getTimeStep()
            self._arm.setCommands(speed[:_JOINTS])
            self._table.setCommands(speed[_JOINTS:])
            self._world.step()
            reached.append(self.positions)
        self._time_us += self._cell["controller_cycle_us"]
        self._before, self._knot, self._rate = self._knot, target, rate
        return np.array(reached)


def _cubic(start: Array, end: Array, start_travel: Array, end_travel: Array, s: Array) -> Array:
    """Cubic Hermite interpolation (n, axes) at fractions s (n,) of a cycle; `*_travel` is rate times duration."""
    t = s[:, None]
    return np.asarray(
        (1 + 2 * t) * (1 - t) ** 2 * start
        + t * (1 - t) ** 2 * start_travel
        + t**2 * (3 - 2 * t) * end
        + t**2 * (t - 1) * end_travel
    )


def _driven_joint(name: str) -> Any:
    joint = dartpy.dynamics.RevoluteJointProperties()
    joint.mName = name
    joint.mAxis = np.array([0.0, 0.0, 1.0])
    joint.mActuatorType = dartpy.dynamics.ActuatorType.VELOCITY
    return joint


def _add_shape(body: Any, shape: Any, friction: float, body_from_shape: Array) -> None:
    node = body.createShapeNode(shape)
    node.createCollisionAspect()
    node.createDynamicsAspect().setFrictionCoeff(friction)
    node.setRelativeTransform(_isometry(body_from_shape))


def _joint_from_link(row: Mapping[str, float]) -> Array:
    """``joint_from_link``: Rz(theta) T(a, 0, d) Rx(alpha) Ry(beta)."""
    turn = pose.from_rotation(pose.rotation_about(2, row["theta"]))
    twist = pose.from_rotation(pose.rotation_about(0, row["alpha"]) @ pose.rotation_about(1, row.get("beta", 0.0)))
    return np.asarray(turn @ pose.translation((row["a"], 0.0, row["d"])) @ twist)


def _matrix_of_pose(described: Mapping[str, Any]) -> Array:
    return pose.from_rotation(
        pose.rotation_from_quaternion(np.array(described["quaternion"], float)), described["position"]
    )


def _isometry(matrix: Array) -> Any:
    return dartpy.math.Isometry3(matrix)
