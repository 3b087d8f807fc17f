"""An operator of a simulated cell: moves one after the other, and resets after emergency stops."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
import pytest

from scancell.cell.controller import JogFrame, Mode, Operation
from scancell.cell.fmu_file import cell_json
from scancell.cell.reusable import ReusableCell
from scancell.config.loading import load_setup
from scancell.nominal.cell import nominal_cell
from scancell.studies.guard.scenario import Command, Operator, Scenario, pressed

SETUP = load_setup()
NOMINAL = nominal_cell(SETUP.cell, None)
CYCLE_US = SETUP.cell.world.controller_cycle_us
START = np.append(NOMINAL.home, 0.0)
FIRST, SECOND = START + np.array([1.5, 0.1, -0.1, 0.2, 0.1, 0.4, 0.3]), START - 0.2


@pytest.fixture(scope="module")
def cells() -> Iterator[ReusableCell]:
    with ReusableCell() as made:
        yield made


def driven(
    cells: ReusableCell, scenario: Scenario, folder: Path, stops: Collection[float] = (), held: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """True axes (cycles, joints + 1) of a scenario, and the number of resets (cycles,) so far.

    The emergency stop is pressed at times, s, and `held` for a number of cycles.
    """
    cell = cells.start(cell_json(SETUP.cell, NOMINAL, 0))
    operator = Operator(cell, scenario, 1e-6 * CYCLE_US, folder)
    truth = cell.real_group(cell.axis_names("truth."))
    stopped = {round(1e6 * time / CYCLE_US) + cycle for time in stops for cycle in range(held)}
    axes, resets = [], []
    for cycle in range(round(1e6 * scenario.duration / CYCLE_US)):
        cell.set_boolean("command.emergency_stop", cycle in stopped)
        operator.act(cell.get_integer("controller.state"))
        cell.step_to((cycle + 1) * CYCLE_US)
        axes.append(cell.get(truth).copy())
        resets.append(cell.get_integer("command.reset"))
    return np.array(axes), np.array(resets)


def moves(*targets: np.ndarray, resets: int = 0) -> Scenario:
    commands = tuple(Command(0.0, Mode.JOINT_MOVE, target) for target in targets)
    return Scenario(Operation.AUTOMATIC, START, commands, 3.0, resets=resets)


def test_a_move_begins_where_the_one_before_ends(cells: ReusableCell, tmp_path: Path) -> None:
    axes, _ = driven(cells, moves(FIRST, SECOND), tmp_path)
    assert np.abs(axes - FIRST).max(1).min() < 1e-3
    np.testing.assert_allclose(axes[-1], SECOND, atol=1e-3)


@pytest.mark.parametrize("resets", [0, 1, 2, 3])
def test_each_reset_ends_one_emergency_stop(cells: ReusableCell, tmp_path: Path, resets: int) -> None:
    """Two stops of a fast move, which brakes for many cycles: it arrives where none is left."""
    axes, given = driven(cells, moves(FIRST, resets=resets), tmp_path, stops=(0.3, 0.8))
    assert given[-1] == min(resets, 2)
    arrives = np.abs(axes[-1] - FIRST).max() < 1e-3
    assert arrives == (resets >= 2)
    assert np.abs(axes[-1] - axes[-2]).max() < 1e-6  # at rest in any case


def test_resets_while_the_stop_is_pressed_are_three_cycles_apart(cells: ReusableCell, tmp_path: Path) -> None:
    """The operator waits that long for each to take effect."""
    axes, given = driven(cells, moves(FIRST, resets=4), tmp_path, stops=(0.3,), held=100)
    assert given[-1] == 4
    assert np.diff(np.flatnonzero(np.diff(given))).tolist() == [3, 3, 3]
    assert np.abs(axes[-1] - FIRST).max() > 0.1


def test_jog_goes_on_after_a_reset(cells: ReusableCell, tmp_path: Path) -> None:
    deflections = np.zeros(7)
    deflections[0] = 1.0
    travelled = []
    for resets in (0, 1):
        scenario = pressed(START, Mode.JOINT_JOG, deflections, JogFrame.WORLD, 2.0, resets=resets)
        axes, given = driven(cells, scenario, tmp_path, stops=(0.6,))
        assert given[-1] == resets
        travelled.append(axes[-1, 0] - START[0])
    assert 0 < 2 * travelled[0] < travelled[1]
