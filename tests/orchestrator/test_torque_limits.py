"""Torque limits in planning: motions last as long as the motors need, and not much longer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import CYCLE, RANGE, block

from bench.planning import motor_torques
from scancell.config.cell import CellDescription
from scancell.config.loading import load_setup
from scancell.errors import PlanningError
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell
from scancell.planning.motion import trajectory
from scancell.planning.motion.connection import Connector
from scancell.planning.motion.trajectory import TorqueLimits, axis_name

START = np.radians([0.0, 45.0, -30.0, 0.0, 30.0, 0.0])
END = np.radians([60.0, 90.0, -60.0, 40.0, -30.0, 90.0])


def weakened(share: float) -> CellDescription:
    """The shipped cell, the motors of its wrist with a share of their torque."""
    cell = load_setup(settings=['cell.robot.drive="dynamic"']).cell
    joints = []
    for number, joint in enumerate(cell.robot.joint, start=1):
        assert joint.drive is not None
        torque = (share if number > 3 else 1.0) * joint.drive.max_torque_n_m
        drive = joint.drive.model_copy(update={"max_torque_n_m": torque})
        joints.append(joint.model_copy(update={"drive": drive}))
    return cell.model_copy(update={"robot": cell.robot.model_copy(update={"joint": tuple(joints)})})


@pytest.mark.parametrize("share", [0.09, 0.11])
def test_a_move_with_weak_motors_keeps_their_torque_limits(share: float) -> None:
    cell = weakened(share)
    planning = PlanningCell(nominal_cell(cell, block(0.05, 0.04, 0.03)), RANGE, CYCLE)
    start, end = np.append(START, 0.0), np.append(END, 0.0)
    fast = Connector(planning, 0.005).move(start, end)
    slow = Connector(replace(planning, torques=TorqueLimits(cell)), 0.005).move(start, end)
    assert motor_torques(cell, [fast[:, :6]], CYCLE).max() > 1.0
    used = motor_torques(cell, [slow[:, :6]], CYCLE).max()
    assert 0.6 < used < 1.0
    # The same line, only slower.
    line = (slow - start) @ (end - start) / ((end - start) @ (end - start))
    assert np.abs(slow - start - line[:, None] * (end - start)).max() < 1e-12
    assert len(slow) > len(fast)


def test_slowdown_uses_four_fifths_of_the_torque_beyond_gravity() -> None:
    """A pure rotation about the vertical axis: no gravity, torque as the inverse square of the duration."""
    cell = weakened(1.0)
    end = START + np.radians([60.0, 0, 0, 0, 0, 0])
    limits = trajectory.Limits(np.full(6, 50.0), np.full(6, 500.0), np.full(6, 1e5))
    fast = trajectory.move(START, end, limits, CYCLE / 8)
    factor, joint = TorqueLimits(cell).needed_slowdown(fast, CYCLE / 8)
    assert factor > 1
    slow = trajectory.move(START, end, limits, CYCLE / 8, factor)
    again, same = TorqueLimits(cell).needed_slowdown(slow, CYCLE / 8)
    assert same == joint
    assert again == pytest.approx(1.0, abs=0.05)


def test_motors_that_cannot_hold_the_arm_are_refused() -> None:
    cell = weakened(0.01)
    planning = PlanningCell(nominal_cell(cell, block(0.05, 0.04, 0.03)), RANGE, CYCLE, torques=TorqueLimits(cell))
    names = [axis_name(planning, axis) for axis in range(7)]
    assert names == [*(f"joint {number}" for number in range(1, 7)), "the table"]
    with pytest.raises(PlanningError, match=r"torque limit of joint ([1-6]) is too low .*joint\[\1\]\.drive"):
        Connector(planning, 0.005).move(np.append(START, 0.0), np.append(END, 0.0))
