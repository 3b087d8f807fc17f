"""Slowing motions down until all axes keep their limits of speed, acceleration, jerk and torque.

Limits are checked on a grid ten times as fine as the controller's. A motion that exceeds one lasts longer by a uniform
factor: its path and with it all clearances stay the same, the speed during exposures stays constant, and no larger
constant speed along the same joint and table angles keeps the limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scancell.arrays import Array
from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory

FINER = 10  # points of the grid on which limits are checked in a cycle of the controller
_MARGIN = 5e-3  # relative: at another phase of the grid, peaks of jerk measure up to 1 % more
_LIMITED = ("speed", "acceleration", "jerk")


@dataclass(frozen=True)
class Slowdown:
    """Factor, at least 1, by which a motion lasts longer, and the limit that requires it."""

    factor: float
    limit: str

    def __str__(self) -> str:
        return f"slowed to {100 / self.factor:.0f} % by the {self.limit}"


def slowdown(cell: PlanningCell, positions: Callable[[Array], Array], duration: float) -> Slowdown | str:
    """The slowdown that a motion from rest to rest needs; or why it is not possible at any speed.

    Parameters
    ----------
    positions
        Joints and table angle (n, axes), rad, at times (n,), s; constant before 0 and after `duration`; NaN
        where there are none.
    """
    period = cell.cycle / FINER
    trajectory.require_sample_count(duration, period)
    fine = positions(np.asarray(period * np.arange(-3, int(np.ceil(duration / period)) + 4), np.float64))
    if not np.isfinite(fine).all():
        return "the path leaves the reach or the joint limits"
    needed = trajectory.needed_slowdown(trajectory.limit_fractions(fine, cell.axis_limits, period))
    order, axis = (int(i) for i in np.unravel_index(np.argmax(needed), needed.shape))
    factor, limit = float(needed[order, axis]), f"{_LIMITED[order]} limit of {axis_name(cell, axis)}"
    if cell.torques is not None:
        by_torque, joint = cell.torques.needed_slowdown(fine[:, : len(cell.nominal.home)], period)
        if not np.isfinite(by_torque):
            return weak_motor(joint)
        if by_torque > factor:
            factor, limit = by_torque, f"torque limit of {axis_name(cell, joint)}"
    return Slowdown(factor * (1 + _MARGIN), limit) if factor > 1 else Slowdown(1.0, "")


def weak_motor(joint: int) -> str:
    """Why an arm cannot be held: the motor of a joint, counted from 0, and its key."""
    key = f"robot.joint[{joint + 1}].drive.max_torque_n_m"
    return f"the torque limit of joint {joint + 1} is too low to hold the arm ({key})"


def axis_name(cell: PlanningCell, axis: int) -> str:
    """Name of an axis in messages: the table follows the joints, and further axes follow it."""
    joints = len(cell.nominal.arm.joints)
    if axis > joints:
        return f"the axis {cell.nominal.axes[axis]}"
    return "the table" if axis == joints else f"joint {axis + 1}"
