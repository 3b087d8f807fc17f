"""Driver: programs that the controller executes give the planned exposures, with FMI 2 and FMI 3."""

from __future__ import annotations

import numpy as np
import pytest
from fmu_cells import CYCLE_US, EXPOSURE, build, default_cell, moves_with_stops, turn_of_table

from scancell.cell.driver import Driver
from scancell.cell.instance import CellInstance
from scancell.cell.recording import Recording

HOME = default_cell().home


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    return {version: build(folder, version) for version in (2, 3)}


@pytest.fixture(scope="module")
def recordings(fmus) -> dict[str, Recording]:
    """Of each program."""
    found = {}
    for name, program in PROGRAMS.items():
        with CellInstance(fmus[3 if name == "stops" else 2]) as cell:
            found[name] = Driver(cell, CYCLE_US, EXPOSURE).run(program)
    return found


PROGRAMS = {
    "table angle": turn_of_table(HOME, "table_angle", np.radians(1.0)),
    "time": turn_of_table(HOME, "time", 0.025),
    "stops": moves_with_stops(HOME),
}


def test_one_communication_step_per_controller_cycle(fmus) -> None:
    program = turn_of_table(HOME, "table_angle", np.radians(1.0))  # less than one exposure per cycle
    with CellInstance(fmus[2]) as cell:
        steps = count_steps(cell)
        Driver(cell, CYCLE_US, EXPOSURE).run(program)
        cycles = cell.time_us // CYCLE_US
    assert len(steps) == cycles == len(program.segments[0].times) - 1


@pytest.mark.parametrize("kind", ["time", "table_angle"])
def test_records_faster_than_controller_cycle_are_read(fmus, kind) -> None:
    """20 exposures per cycle: as many communication steps, and the last records are read after the motion."""
    period = CYCLE_US * 1e-6 / 20
    rule = turn_of_table(HOME, kind, period if kind == "time" else np.radians(40.0) * period)
    with CellInstance(fmus[2]) as cell:
        steps = count_steps(cell)
        measured = Driver(cell, CYCLE_US, EXPOSURE).run(rule).measured
        fired = cell.get_integer("trigger.count")
    assert len(measured.index) == fired > 500
    assert np.array_equal(measured.index, np.arange(1, fired + 1))
    assert np.diff(measured.time) == pytest.approx(period, abs=2e-6)
    assert len(steps) < 1.5 * fired


def count_steps(cell: CellInstance) -> list[int]:
    """Grows by the time of every communication step."""
    steps: list[int] = []
    cell.on_step(lambda: steps.append(cell.time_us))
    return steps


def test_triggered_exposures_are_equidistant(recordings) -> None:
    """In angle, latched at mid-exposure, from the planned angle on; or in time."""
    measured = recordings["table angle"].measured
    (only,) = PROGRAMS["table angle"].segments
    assert np.array_equal(measured.index, np.arange(1, 21))
    assert np.array_equal(measured.segment, np.ones(20))
    assert measured.table[0] == pytest.approx(np.interp(only.trigger_from, only.times, only.axes[:, -1]), abs=1e-6)
    assert np.diff(measured.table) == pytest.approx(np.radians(1.0), abs=2e-6)
    assert measured.rates[:, -1] == pytest.approx(np.radians(40.0), rel=1e-3)
    assert measured.exposure == pytest.approx(EXPOSURE)
    assert np.diff(recordings["time"].measured.time) == pytest.approx(0.025, abs=2e-6)


def test_requested_exposures_are_at_rest_at_planned_points(recordings) -> None:
    program, measured = PROGRAMS["stops"], recordings["stops"].measured
    assert measured.segment.tolist() == [segment.id for segment in program.segments]
    goals = np.array([segment.axes[-1, :-1] for segment in program.segments])
    assert measured.q == pytest.approx(goals, abs=1e-9)
    assert measured.table == pytest.approx([segment.axes[-1, -1] for segment in program.segments], abs=1e-9)
    assert np.abs(measured.rates).max() < 1e-9


def test_progress_reports_every_second(fmus) -> None:
    reported: list[float] = []
    with CellInstance(fmus[2]) as cell:
        Driver(cell, CYCLE_US, EXPOSURE).run(PROGRAMS["stops"], reported.append)
    assert sum(reported) == pytest.approx(PROGRAMS["stops"].duration)
    assert len(reported) == 3


def test_recorded_poses_match_kinematics(recordings) -> None:
    """True sensor poses of an unperturbed cell are nominal at the measured joints."""
    cell, recording = default_cell(), recordings["stops"]
    middle = recording.truth.world_from_frame["sensor"].mean(1)
    nominal = cell.world_from_sensor(recording.measured.q)
    assert np.abs(middle[:, :3, 3] - nominal[:, :3, 3]).max() < 1e-9
    assert np.abs(middle[:, :3, :3] - nominal[:, :3, :3]).max() < 1e-9
