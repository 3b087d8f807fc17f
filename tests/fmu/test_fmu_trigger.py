"""Trigger device: instants, records, order, latency."""

from __future__ import annotations

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START, Array, Build, CellFmu, cell_description

SPEED = 10.0  # rad/s, the table's limit
FAR = 1e4


def rotate_table_at_constant_speed(cell: CellFmu) -> None:
    """Table at its speed limit, after an acceleration of 0.5 s."""
    cell.command(table=FAR)
    cell.step(33 * CYCLE_US)


def times(records: dict[int, Array]) -> Array:
    """Middles of the exposures in microseconds; asserts that records are complete and in order."""
    assert list(records) == list(range(1, len(records) + 1))
    return np.array([record[0] for record in records.values()]) * 1e6


@pytest.mark.parametrize("step_us", [40, 700, CYCLE_US])
def test_time_mode_fires_on_exact_multiples(build: Build, step_us: int) -> None:
    cell = build()
    cell.step(720)
    period = 0.01 / 3
    cell.trigger(1, period, exposure=0.002)
    records = cell.records(step_us, 200_000)
    expected = 720 + np.round(np.arange(len(records)) * period * 1e6) + 1000
    np.testing.assert_allclose(times(records), expected, atol=1e-6)
    assert len(records) >= 59


@pytest.mark.parametrize("step_us", [40, 700, CYCLE_US])
def test_angle_mode_fires_at_interval_crossings(build: Build, step_us: int) -> None:
    cell = build()
    rotate_table_at_constant_speed(cell)
    cell.step(330)
    entered_us = cell.time_us
    angle = np.radians(0.7)
    cell.trigger(2, angle, exposure=0.0005)
    records = cell.records(step_us, entered_us + 200_000)
    crossings = entered_us + np.arange(len(records)) * angle / SPEED * 1e6
    late = times(records) - 250 - crossings
    assert (late > -1e-3).all()  # the first whole microsecond after the crossing
    assert (late < 1 + 1e-3).all()
    assert len(records) > 150


@pytest.mark.parametrize("step_us", [40, 700, CYCLE_US])
def test_distance_mode_measures_path_over_table(build: Build, step_us: int) -> None:
    cell = build()
    rotate_table_at_constant_speed(cell)
    entered_us = cell.time_us
    distance = 0.001
    cell.trigger(3, distance)
    records = cell.records(step_us, entered_us + 140_000)
    # The robot is at rest: the sensor origin moves on a circle in the table frame.
    sensor = cell.body("sensor")[:3, 3]
    radius = np.hypot(sensor[0] - 0.45, sensor[1])
    crossings = entered_us + np.arange(len(records)) * distance / (radius * SPEED) * 1e6
    # The path is a chord per millisecond: shorter than the arc by (10 mrad)^2 / 24 of it.
    np.testing.assert_allclose(times(records), crossings + 0.5, atol=0.5 + 1e-5 * 140_000)
    assert len(records) > 100


def test_reversal_over_a_crossing_fires_once(build: Build) -> None:
    cell = build()
    cell.trigger(2, 0.05)
    for target in (0.06, 0.0, 0.06, 0.11):
        cell.command(table=target)
        cell.step(20 * CYCLE_US)
    assert cell.get_int("trigger.count") == 3


def test_each_request_fires_once(build: Build) -> None:
    cell = build()
    cell.set("command.trigger.request", 1)
    cell.step(1000)
    assert cell.get_int("trigger.count") == 0  # off: requests are ignored, too
    cell.trigger(4, exposure=0.0, segment=7)
    cell.step(1000)
    assert cell.get_int("trigger.count") == 0  # the earlier request has expired
    cell.set("command.trigger.request", 2)
    cell.step(1000)
    cell.step(1000)
    assert cell.get_int("trigger.count") == 1
    assert cell.get_int("trigger.segment") == 7
    assert cell.get("trigger.time")[0] == pytest.approx(0.002, abs=1e-12)
    cell.trigger(1, 0.5)
    cell.set("command.trigger.request", 3)
    cell.step(1000)
    assert cell.get_int("trigger.count") == 3  # the first of the mode and the requested one


def test_two_exposures_in_one_step_are_both_delivered(build: Build) -> None:
    cell = build()
    cell.trigger(1, 0.007)
    cell.step(10_000)
    assert (cell.get_int("trigger.count"), cell.get_int("trigger.index"), cell.get_int("trigger.queued")) == (2, 1, 1)
    cell.trigger(0)
    cell.step(10)
    assert (cell.get_int("trigger.index"), cell.get_int("trigger.queued")) == (2, 0)
    assert cell.get("trigger.time")[0] == pytest.approx(0.007, abs=1e-12)
    cell.step(10)
    assert cell.get_int("trigger.index") == 2  # stays the current record


def test_record_is_complete_after_its_light(build: Build) -> None:
    cell = build(parameters={"as_built.trigger.latency": 0.002})
    cell.trigger(1, 1.0, exposure=0.004)
    cell.step(1000, 3)
    assert cell.get_int("trigger.index") == 0
    cell.step(1000)
    assert cell.get_int("trigger.index") == 1
    cell.trigger(0)


def test_trigger_latency_separates_truth_from_measurement(build: Build) -> None:
    latency = 0.001
    cell = build(parameters={"as_built.trigger.latency": latency})
    rotate_table_at_constant_speed(cell)
    cell.trigger(1, 0.003, exposure=0.002)
    begin = cell.time_us
    cell.step(40_000)
    measured = cell.get("trigger.measured.table")[0]
    offset = cell.get("truth.table")[0] - SPEED * cell.time_us * 1e-6
    assert measured == pytest.approx(offset + SPEED * (begin + 1000) * 1e-6, abs=1e-9)
    platter = cell.body("table", prefix="trigger.truth.")
    true = np.arctan2(platter[1, 0], platter[0, 0])
    assert np.angle(np.exp(1j * (true - measured))) == pytest.approx(SPEED * latency, abs=1e-9)


def test_records_are_independent_of_communication_step(build: Build) -> None:
    """The same inputs at 40 us, 1 ms, 16 ms and 100 ms: records of all modes are bit-identical."""
    description = cell_description()
    for joint in [*description["robot"]["joints"], description["table"]]:
        joint["encoder_noise"], joint["encoder_resolution"] = 1e-5, 1e-6
    for mode, interval in ((1, 0.0037), (2, 0.015), (3, 0.004)):
        runs = []
        for step_us in (40, 1000, 16_000, 100_000):
            cell = build(3, description, {"seed": 5, "as_built.trigger.latency": 0.0003})
            cell.command(START + 1.0, FAR)
            cell.trigger(mode, interval, exposure=0.0011)
            runs.append(cell.records(step_us, 400_000))
        assert len(runs[0]) > 80
        for other in runs[1:]:
            assert list(other) == list(runs[0])
            for index, record in other.items():
                np.testing.assert_array_equal(record, runs[0][index])


def test_both_fmi_versions_run_same_trajectory(build: Build) -> None:
    cells = [build(2), build(3)]
    for cell in cells:
        cell.command(START + 1.0, FAR)
        cell.trigger(3, 0.002, exposure=0.001)
    first, second = (cell.records(700, 200_000) for cell in cells)
    assert list(first) == list(second)
    for index, record in first.items():
        np.testing.assert_array_equal(record, second[index])
    names = [n for n, v in cells[0].variables.items() if v.type == "Real"]
    np.testing.assert_array_equal(cells[0].get(*names), cells[1].get(*names))


def test_encoder_noise_standard_deviation_and_seed(build: Build) -> None:
    description = cell_description()
    for joint in description["robot"]["joints"]:
        joint["encoder_noise"] = 1e-4
    description["table"]["encoder_resolution"] = 0.01
    errors = {}
    for seed in (1, 2):
        cell = build(3, description, {"seed": seed})
        cell.command(table=0.5)
        samples = []
        for _ in range(1500):
            cell.step(130)
            samples.append(cell.vector("measured.q", 6) - cell.vector("truth.q", 6))
        errors[seed] = np.array(samples)
        steps = cell.get("measured.table")[0] / 0.01
        assert steps == pytest.approx(round(steps), abs=1e-9)
    for seed in (1, 2):
        # Chi-square of 9000 normal numbers: 1 +- 1.5 % at one standard deviation.
        assert np.mean((errors[seed] / 1e-4) ** 2) == pytest.approx(1, abs=0.06)
        assert abs(np.mean(errors[seed])) < 5e-4 / np.sqrt(9000)
        correlation = np.corrcoef(errors[seed].T)[np.triu_indices(6, 1)]
        assert np.abs(correlation).max() < 0.15
    assert abs(np.corrcoef(errors[1].ravel(), errors[2].ravel())[0, 1]) < 0.05
