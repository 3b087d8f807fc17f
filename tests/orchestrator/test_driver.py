"""Driver: programs that the controller executes give the planned exposures, with FMI 2 and FMI 3."""

from __future__ import annotations

import numpy as np
import pytest
from fmu_cells import CYCLE_US, EXPOSURE, build, default_cell, moves_with_stops, turn_of_table

from scancell.cell.driver import DriveOptions, Driver
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program
from scancell.cell.recording import Recording

HOME = default_cell().home
OPTIONS = DriveOptions(CYCLE_US, EXPOSURE)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    return {version: build(folder, version) for version in (2, 3)}


def run(fmu, program: Program, progress=None) -> Recording:
    with CellInstance(fmu) as cell:
        return Driver(cell, OPTIONS).run(program, progress)


PROGRAMS = {
    "table angle": turn_of_table(HOME, "table_angle", np.radians(1.0)),
    "time": turn_of_table(HOME, "time", 0.025),
    "stops": moves_with_stops(HOME),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_fmi2_and_fmi3_recordings_are_equal(fmus, name) -> None:
    first, second = run(fmus[2], PROGRAMS[name]), run(fmus[3], PROGRAMS[name])
    assert len(first) > 2
    assert set(first.columns) == set(second.columns)
    for column, values in first.columns.items():
        assert np.array_equal(values, second.columns[column]), column


class FineSteps(CellInstance):
    """Takes eight communication steps for each that is asked for."""

    def step_to(self, time_us: int) -> None:
        start = self.time_us
        for k in range(1, 9):
            super().step_to(start + (time_us - start) * k // 8)


@pytest.mark.parametrize("name", ["table angle", "time"])
def test_exposures_are_independent_of_communication_step(fmus, name) -> None:
    coarse = run(fmus[2], PROGRAMS[name])
    with FineSteps(fmus[2]) as cell:
        fine = Driver(cell, OPTIONS).run(PROGRAMS[name])
    assert len(coarse) == len(fine) >= 20
    for column, values in coarse.columns.items():
        assert np.abs(values - fine.columns[column]).max() < 1e-12, column


def test_one_communication_step_per_controller_cycle(fmus) -> None:
    program = turn_of_table(HOME, "table_angle", np.radians(1.0))  # less than one exposure per cycle
    with CellInstance(fmus[2]) as cell:
        steps = count_steps(cell)
        Driver(cell, OPTIONS).run(program)
        cycles = cell.time_us // CYCLE_US
    assert len(steps) == cycles == len(program.segments[0].times) - 1


@pytest.mark.parametrize("kind", ["time", "table_angle"])
def test_records_faster_than_controller_cycle_are_read(fmus, kind) -> None:
    """20 exposures per cycle: as many communication steps, and the last records are read after the motion."""
    period = CYCLE_US * 1e-6 / 20
    rule = turn_of_table(HOME, kind, period if kind == "time" else np.radians(40.0) * period)
    with CellInstance(fmus[2]) as cell:
        steps = count_steps(cell)
        measured = Driver(cell, OPTIONS).run(rule).measured
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


def test_angle_triggered_exposures_are_equidistant(fmus) -> None:
    measured = run(fmus[2], PROGRAMS["table angle"]).measured
    assert np.array_equal(measured.index, np.arange(1, len(measured.index) + 1))
    assert np.array_equal(measured.segment, np.ones(len(measured.index)))
    # Latched at mid-exposure, which is at the planned angle.
    assert np.diff(measured.table) == pytest.approx(np.radians(1.0), abs=2e-6)
    assert measured.table_rate == pytest.approx(np.radians(40.0), rel=1e-3)
    assert measured.exposure == pytest.approx(EXPOSURE)


def test_first_exposure_is_at_planned_angle(fmus) -> None:
    program = PROGRAMS["table angle"]
    measured = run(fmus[2], program).measured
    only = program.segments[0]
    planned = np.interp(only.trigger_from, only.times, only.table)
    assert measured.table[0] == pytest.approx(planned, abs=1e-6)
    assert len(measured.index) == 20


def test_time_triggered_exposures_are_equidistant(fmus) -> None:
    measured = run(fmus[2], PROGRAMS["time"]).measured
    assert np.diff(measured.time) == pytest.approx(0.025, abs=2e-6)


def test_requested_exposures_are_at_rest_at_planned_points(fmus) -> None:
    program = PROGRAMS["stops"]
    recording = run(fmus[2], program)
    measured = recording.measured
    assert measured.segment.tolist() == [segment.id for segment in program.segments]
    goals = np.array([segment.q[-1] for segment in program.segments])
    assert measured.q == pytest.approx(goals, abs=1e-9)
    assert measured.table == pytest.approx([segment.table[-1] for segment in program.segments], abs=1e-9)
    assert np.abs(measured.qd).max() < 1e-9
    assert np.abs(measured.table_rate).max() < 1e-9


def test_progress_reports_every_second(fmus) -> None:
    reported: list[float] = []
    run(fmus[2], PROGRAMS["stops"], progress=reported.append)
    assert sum(reported) == pytest.approx(PROGRAMS["stops"].duration)
    assert len(reported) == 3


def test_recorded_poses_match_kinematics(fmus) -> None:
    """True sensor poses of an unperturbed cell are nominal at the measured joints."""
    cell, recording = default_cell(), run(fmus[3], PROGRAMS["stops"])
    middle = recording.truth.world_from_frame["sensor"].mean(1)
    nominal = cell.world_from_sensor(recording.measured.q)
    assert np.abs(middle[:, :3, 3] - nominal[:, :3, 3]).max() < 1e-9
    assert np.abs(middle[:, :3, :3] - nominal[:, :3, :3]).max() < 1e-9
