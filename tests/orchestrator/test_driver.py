"""The driver: programs streamed to the FMU come out as they were planned, in FMI 2 and FMI 3 alike."""

from __future__ import annotations

import numpy as np
import pytest
from fmu_cells import CYCLE_US, EXPOSURE, build, default_cell, moves_with_stops, turn_of_table

from orchestrator.cell.driver import DriveOptions, Driver
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.program import Program
from orchestrator.cell.recording import Recording

HOME = default_cell().home


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    return {version: build(folder, version) for version in (2, 3)}


def run(fmu, program: Program, steps_per_cycle: int = 4, progress=None) -> Recording:
    with CellInstance(fmu) as cell:
        return Driver(cell, DriveOptions(CYCLE_US, EXPOSURE, steps_per_cycle)).run(program, progress)


PROGRAMS = {
    "table angle": turn_of_table(HOME, "table_angle", np.radians(1.0)),
    "time": turn_of_table(HOME, "time", 0.025),
    "stops": moves_with_stops(HOME),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_fmi_2_and_fmi_3_give_the_same_recording(fmus, name) -> None:
    first, second = run(fmus[2], PROGRAMS[name]), run(fmus[3], PROGRAMS[name])
    assert len(first) > 2
    assert set(first.columns) == set(second.columns)
    for column, values in first.columns.items():
        assert np.array_equal(values, second.columns[column]), column


@pytest.mark.parametrize("name", ["table angle", "time"])
def test_communication_step_does_not_change_the_exposures(fmus, name) -> None:
    coarse, fine = run(fmus[2], PROGRAMS[name], 1), run(fmus[2], PROGRAMS[name], 8)
    assert len(coarse) == len(fine) >= 20
    assert np.abs(coarse.measured.time - fine.measured.time).max() < 2e-6
    assert np.abs(coarse.measured.table - fine.measured.table).max() < 2e-6


def test_exposures_by_angle_come_a_step_apart(fmus) -> None:
    measured = run(fmus[2], PROGRAMS["table angle"]).measured
    assert np.array_equal(measured.index, np.arange(1, len(measured.index) + 1))
    assert np.array_equal(measured.segment, np.ones(len(measured.index)))
    # Latched at mid-exposure, half an exposure's turn after each whole degree.
    assert np.diff(measured.table) == pytest.approx(np.radians(1.0), abs=2e-6)
    assert measured.table_rate == pytest.approx(np.radians(40.0), rel=1e-3)
    assert measured.exposure == pytest.approx(EXPOSURE)


def test_first_exposure_falls_where_it_was_planned(fmus) -> None:
    program = PROGRAMS["table angle"]
    measured = run(fmus[2], program).measured
    only = program.segments[0]
    planned = np.interp(only.trigger_from, only.times, only.table)
    assert measured.table[0] == pytest.approx(planned + measured.table_rate[0] * EXPOSURE / 2, abs=1e-5)
    assert len(measured.index) == 20


def test_exposures_by_time_come_a_period_apart(fmus) -> None:
    measured = run(fmus[2], PROGRAMS["time"]).measured
    assert np.diff(measured.time) == pytest.approx(0.025, abs=2e-6)


def test_requested_exposures_are_taken_at_rest_at_the_planned_points(fmus) -> None:
    program = PROGRAMS["stops"]
    recording = run(fmus[2], program)
    measured = recording.measured
    assert measured.segment.tolist() == [segment.id for segment in program.segments]
    goals = np.array([segment.q[-1] for segment in program.segments])
    assert measured.q == pytest.approx(goals, abs=1e-9)
    assert measured.table == pytest.approx([segment.table[-1] for segment in program.segments], abs=1e-9)
    assert np.abs(measured.qd).max() < 1e-9
    assert np.abs(measured.table_rate).max() < 1e-9


def test_progress_hears_of_every_second(fmus) -> None:
    told: list[float] = []
    run(fmus[2], PROGRAMS["stops"], progress=told.append)
    assert sum(told) == pytest.approx(PROGRAMS["stops"].duration)
    assert len(told) == 3


def test_records_are_those_of_kinematics(fmus) -> None:
    """True sensor poses of an unperturbed cell are the nominal ones at the measured joints."""
    cell, recording = default_cell(), run(fmus[3], PROGRAMS["stops"])
    middle = recording.truth.world_from_frame["sensor"].mean(1)
    nominal = cell.world_from_sensor(recording.measured.q)
    assert np.abs(middle[:, :3, 3] - nominal[:, :3, 3]).max() < 1e-9
    assert np.abs(middle[:, :3, :3] - nominal[:, :3, :3]).max() < 1e-9
