"""An operator of a simulated cell: motions one after the other, and resets after emergency stops."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scancell.cell.fmu_file import ReusableCell, cell_json
from scancell.config.loading import load_setup
from scancell.nominal.cell import nominal_cell
from scancell.studies.guard.scenario import (
    Event,
    Kind,
    Motion,
    Operator,
    Scenario,
    program_duration,
    set_points,
    short_program_length,
)

SETUP = load_setup()
NOMINAL = nominal_cell(SETUP.cell, None)
CYCLE_US = SETUP.cell.world.controller_cycle_us
CYCLE = 1e-6 * CYCLE_US
START = np.append(NOMINAL.home, 0.0)
BY = np.array([1.5, 0.1, -0.1, 0.2, 0.1, 0.4, 0.3])
MAXIMA = NOMINAL.axis_max_speed, NOMINAL.axis_max_acceleration


@pytest.fixture(scope="module")
def cells() -> Iterator[ReusableCell]:
    with ReusableCell() as made:
        yield made


def driven(
    cells: ReusableCell, motions: Collection[Motion], folder: Path, duration: float = 3.0, stopped: Collection[int] = ()
) -> tuple[np.ndarray, Operator]:
    """True axes (cycles, joints + 1) of motions, and their operator; the emergency stop is pressed in some cycles."""
    cell = cells.start(cell_json(SETUP.cell, NOMINAL, 0, collision_outputs=False))
    operator = Operator(cell, NOMINAL, Scenario(START, tuple(motions), duration), CYCLE, folder)
    truth = cell.real_group(cell.axis_names("truth."))
    axes = []
    for cycle in range(round(duration / CYCLE)):
        cell.set_boolean("command.emergency_stop", cycle in stopped)
        operator.act(cell.get_integer("controller.state"))
        cell.step_to((cycle + 1) * CYCLE_US)
        axes.append(cell.get(truth).copy())
    return np.array(axes), operator


def move(by: np.ndarray, speed: float = 1.0) -> Motion:
    return Motion(Kind.JOINT_MOVE, by, speed)


def test_a_move_begins_where_the_one_before_ends(cells: ReusableCell, tmp_path: Path) -> None:
    axes, operator = driven(cells, [move(BY), move(-0.5 * BY)], tmp_path)
    assert np.abs(axes - START - BY).max(1).min() < 1e-3
    np.testing.assert_allclose(axes[-1], START + 0.5 * BY, atol=1e-6)
    assert operator.done
    assert operator.resets == 0


@pytest.mark.parametrize("kind", [Kind.LINE_MOVE, Kind.PROGRAM, Kind.SHORT_PROGRAM, Kind.SERVO, Kind.TABLE_MOVE])
def test_motion_of_each_kind_ends_where_it_is_to(cells: ReusableCell, tmp_path: Path, kind: Kind) -> None:
    by = 1e-4 * BY / 1.5
    duration = {
        Kind.PROGRAM: program_duration(by, 0.5, *MAXIMA, CYCLE),
        Kind.SHORT_PROGRAM: 2 * CYCLE,
        Kind.SERVO: 0.16,
    }
    axes, operator = driven(cells, [Motion(kind, by, 0.5, duration.get(kind, 0.0), pause=0.05)], tmp_path, 1.5)
    assert operator.done
    np.testing.assert_allclose(axes[-1], START + by, atol=1e-7)


def test_motion_shorter_than_a_cycle_takes_one(cells: ReusableCell, tmp_path: Path) -> None:
    _, operator = driven(cells, [move(1e-5 * BY), move(0.01 * BY)], tmp_path, 1.0)
    assert [begun.cycles <= 1 for begun in operator.begun] == [True, False]


def test_jog_moves_for_its_time_and_after_a_change_of_operation(cells: ReusableCell, tmp_path: Path) -> None:
    jog = Motion(Kind.JOINT_JOG, np.eye(7)[0], 1.0, 0.5)
    axes, operator = driven(cells, [move(0.1 * BY), jog, replace(jog, by=-jog.by, event=Event.OPERATION)], tmp_path)
    assert operator.done
    speed = SETUP.cell.robot.motion.jog_joint_share * NOMINAL.axis_max_speed[0]
    gone = axes[:, 0].max() - START[0] - 0.1 * BY[0]
    assert 0.3 * speed * jog.duration < gone < speed * (jog.duration + 0.2)
    assert axes[-1, 0] < axes[:, 0].max() - 0.5 * gone


def test_operator_resets_after_a_stop_and_goes_on_with_the_next_motion(cells: ReusableCell, tmp_path: Path) -> None:
    axes, operator = driven(cells, [move(BY), move(np.eye(7)[6])], tmp_path, 4.0, stopped=range(10, 40))
    assert operator.resets >= 1
    assert operator.done
    assert np.abs(axes[-1] - START - BY)[0] > 0.1
    assert axes[-1, 6] > 0.9


@pytest.mark.parametrize("speed", [0.01, 1.0])
def test_programs_keep_the_limits(speed: float) -> None:
    duration = program_duration(0.1 * BY, speed, *MAXIMA, CYCLE)
    points = set_points(Motion(Kind.PROGRAM, 0.1 * BY, speed, duration), CYCLE)
    rates = np.diff(points, axis=0) / CYCLE
    np.testing.assert_allclose(points[[0, -1]], [0.0 * BY, 0.1 * BY], atol=1e-12)
    assert (np.abs(rates) <= speed * MAXIMA[0]).all()
    assert (np.abs(np.diff(rates, axis=0) / CYCLE) <= MAXIMA[1]).all()


@pytest.mark.parametrize("points", [2, 3])
def test_longest_short_program_is_accepted(cells: ReusableCell, tmp_path: Path, points: int) -> None:
    by = BY * short_program_length(points, BY, MAXIMA[1], CYCLE)
    axes, operator = driven(cells, [Motion(Kind.SHORT_PROGRAM, by, 1.0, (points - 1) * CYCLE)], tmp_path, 0.3)
    np.testing.assert_allclose(axes[-1], START + by, atol=1e-9)
    assert operator.done
