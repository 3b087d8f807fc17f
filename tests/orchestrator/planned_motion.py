"""Set-points of plans, and their limits."""

from __future__ import annotations

import numpy as np

from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory
from scancell.planning.plan import Plan


def setpoints(plan: Plan) -> np.ndarray:
    """Joints and table angle (n, axes) of all segments."""
    return np.concatenate([s.axes for s in plan.program.segments])


def assert_axis_limits(cell: PlanningCell, plan: Plan) -> None:
    """Every segment keeps the limits of position, speed, acceleration and jerk, at rest before and after."""
    assert cell.nominal.arm.within_limits(setpoints(plan)[:, :-1]).all()
    for segment in plan.program.segments:
        path = segment.axes
        at_rest = np.concatenate([*3 * [path[:1]], path, *3 * [path[-1:]]])
        assert trajectory.limit_fractions(at_rest, cell.axis_limits, cell.cycle).max() <= 1.0 + 1e-9, segment.name
