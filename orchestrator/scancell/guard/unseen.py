"""Bound on the approach of bodies by changes of a jog between two polls.

A jog changes within limits: each axis accelerates by at most a share of what it can, and the tool by at most the jog's
accelerations.  Bodies fixed to the tool approach what stands still by no more than the tool's accelerations allow, all
pairs by no more than those of the axes between them do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.config.robot import RobotDescription
from scancell.config.units import si_value
from scancell.geometry import pose
from scancell.nominal.cell import Body, NominalCell
from scancell.proximity.motion_bounds import MotionBounds
from scancell.proximity.scene import arm_chain

Array = NDArray[np.float64]

_LONGER = 1.1  # levers may grow by as much on the way of a stop


@dataclass(frozen=True)
class JogLimits:
    """Largest accelerations in manual operation: of all axes (axes,), rad/s², of the tool, m/s² and rad/s²."""

    axes: Array
    line: float
    turn: float


def jog_limits(robot: RobotDescription, nominal: NominalCell) -> JogLimits:
    """The limits that the controller of a described robot keeps."""
    motion = robot.motion
    return JogLimits(
        motion.jog_joint_share * nominal.axis_max_acceleration,
        si_value(motion, "jog_acceleration_mm_s2"),
        si_value(motion, "jog_turn_acceleration_deg_s2"),
    )


class UnseenApproach:
    """Bounds the approach of pairs of bodies by changes of a jog.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    pairs
        Names of the bodies of each pair.
    limits
        Of the changes.
    """

    def __init__(self, nominal: NominalCell, pairs: Sequence[tuple[str, str]], limits: JogLimits) -> None:
        self._bounds, self._limits = MotionBounds(nominal, pairs), limits
        lever = {body.name: _lever(nominal, body) for body in nominal.bodies if _is_on_tool(nominal, body)}
        moving = {name for name in arm_chain(nominal) if name != "base"}
        by_tool = {}
        for i, (a, b) in enumerate(pairs):
            on_tool = a if a in lever else b if b in lever else None
            if on_tool is not None and (b if on_tool == a else a) not in moving:
                by_tool[i] = limits.line + limits.turn * lever[on_tool]
        self._on_tool, self._by_tool = np.array(list(by_tool), np.int64), np.array(list(by_tool.values()))  # m/s²

    def bound(self, axes: Array, time_squared: float) -> Array:
        """Bound (pairs,), m, at `axes` (axes,), rad, on what accelerations add in half of `time_squared`, s²."""
        half = time_squared / 2
        joints, table = self._limits.axes.copy(), np.zeros_like(self._limits.axes)
        table[-1], joints[-1] = joints[-1], 0.0
        by_joints, by_table = self._bounds.pairs(axes[None], half * np.stack([joints, table])[:, None])[:, 0]
        by_joints[self._on_tool] = np.minimum(by_joints[self._on_tool], half * self._by_tool)
        return np.asarray(_LONGER * (by_joints + by_table))


def _is_on_tool(nominal: NominalCell, body: Body) -> bool:
    return body.moves_with in ("sensor", "finger[1]", "finger[2]", f"link[{len(nominal.arm.joints)}]")


def _lever(nominal: NominalCell, body: Body) -> float:
    """Largest distance of a body's points from the tool's origin, m."""
    frames = nominal.frame_poses(nominal.home)
    tool_from_body = pose.inverse(frames["sensor"]) @ frames[body.moves_with]
    return float(np.linalg.norm(pose.transform_points(tool_from_body, body.mesh.vertices), axis=1).max())
