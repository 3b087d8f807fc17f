"""Trigger by the travel of a belt: places of the exposures, direction, encoder of the belt."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Array, Build, CellFmu, cell_description, conveyor

MAX_SPEED, ACCELERATION = 1.0, 2.0  # m/s, m/s²
TRAVEL, SPEED = "trigger.measured.conveyor[1].travel", "trigger.measured.conveyor[1].speed"
EXPOSURE = 0.001
TRIGGER_INTERVAL = 13  # of controller.error


def belt_cell(count: int = 1, **changes: Any) -> dict[str, Any]:
    cell = cell_description()
    cell["conveyors"] = [conveyor(name=f"belt {i}", **changes) for i in range(1, count + 1)]
    return cell


def run(cell: CellFmu, speed: float, belt: int = 1) -> None:
    cell.set(f"command.conveyor[{belt}].speed", speed)


def collect(cell: CellFmu, step_us: int, until_us: int) -> Array:
    """Time, travel and speed (n, 3) of the records that come until then and after the trigger is off."""
    found: dict[int, Array] = {}
    while cell.time_us < until_us or cell.get_int("trigger.queued"):
        if cell.time_us >= until_us:
            cell.set("command.trigger.mode", 0)
        cell.step(step_us)
        found[cell.get_int("trigger.index")] = cell.get("trigger.time", TRAVEL, SPEED)
    found.pop(0, None)
    return np.array([found[index] for index in sorted(found)])


def tolerance(exposure: float) -> float:
    """Travel of the belt in a microsecond, and what its speed changes in half an exposure."""
    return MAX_SPEED * 1e-6 + ACCELERATION * (exposure / 2) ** 2 / 2


@pytest.mark.parametrize("share", [0.001, 0.1, 1.0])
def test_profiles_are_one_interval_apart_at_any_speed(build: Build, share: float) -> None:
    """From rest: the belt accelerates during the first exposures."""
    cell = build(3, belt_cell())
    step = 0.01 * share
    run(cell, share * MAX_SPEED)
    cell.trigger(5, step, EXPOSURE)
    travel = collect(cell, 4000, 800_000)[:, 1]
    assert len(travel) > 50
    np.testing.assert_allclose(travel, travel[0] + step * np.arange(len(travel)), atol=tolerance(EXPOSURE))


def test_changes_of_speed_do_not_change_the_spacing(build: Build) -> None:
    """Faster, slower, nearly to a stop, and faster again."""
    cell = build(3, belt_cell())
    cell.trigger(5, 0.005, EXPOSURE)
    parts = []
    for speed in (0.3, 0.05, 0.9, 0.0005, 0.4):
        run(cell, speed)
        until = cell.time_us + 320_000
        while cell.time_us < until:
            cell.step(4000)
            parts.append([cell.get_int("trigger.index"), *cell.get("trigger.time", TRAVEL)])
    rows = np.unique([part for part in parts if part[0]], axis=0)
    times, travel = rows[:, 1], rows[:, 2]
    np.testing.assert_allclose(travel, 0.005 * np.arange(len(travel)), atol=tolerance(EXPOSURE))
    assert np.diff(times).max() > 10 * np.diff(times).min()  # the speed did change
    assert len(travel) > 60


def test_belt_that_runs_back_triggers_only_beyond_the_farthest_place(build: Build) -> None:
    cell = build(3, belt_cell())
    cell.trigger(5, 0.01)
    rows = []
    for speed, cycles in ((0.2, 50), (-0.2, 40), (0.2, 60)):
        run(cell, speed)
        for _ in range(cycles):
            cell.step(CYCLE_US)
            rows.append([cell.get_int("trigger.index"), *cell.get("trigger.time", TRAVEL)])
    rows = np.unique([row for row in rows if row[0]], axis=0)
    np.testing.assert_allclose(rows[:, 2], 0.01 * np.arange(len(rows)), atol=1e-6)
    assert np.diff(rows[:, 1]).max() > 0.9  # s: back and forth
    assert rows[-1, 2] > 0.15


def test_negative_interval_counts_travel_backwards(build: Build) -> None:
    cell = build(3, belt_cell())
    cell.trigger(5, -0.01)
    run(cell, 0.1)
    cell.step(CYCLE_US, 20)
    assert cell.get_int("trigger.count") == 1  # the one on entry
    run(cell, -0.5)
    travel = collect(cell, CYCLE_US, 1_000_000)[:, 1]
    np.testing.assert_allclose(travel[1:], -0.01 * np.arange(1, len(travel)), atol=1e-6)
    assert len(travel) > 20


@pytest.mark.parametrize("step_us", [700, 1000, 100_000])
def test_places_are_independent_of_the_communication_step(build: Build, step_us: int) -> None:
    def records(step_us: int) -> Array:
        cell = build(3, belt_cell())
        run(cell, 0.2)
        cell.trigger(5, 0.013, EXPOSURE)
        return collect(cell, step_us, 700_000)[:9]

    np.testing.assert_array_equal(records(step_us), records(CYCLE_US))


def test_profiles_follow_the_counts_of_the_encoder(build: Build) -> None:
    resolution = 0.0005
    cell = build(3, belt_cell(encoder_resolution=resolution))
    run(cell, 0.1)
    cell.trigger(5, 4 * resolution)
    times, travel, _ = collect(cell, CYCLE_US, 1_000_000).T
    np.testing.assert_allclose(travel, 4 * resolution * np.arange(len(travel)), atol=1e-12)
    assert len(travel) > 40
    true = 0.1 * (times - 0.1 / ACCELERATION / 2)
    np.testing.assert_allclose(travel[5:] - true[5:], resolution / 2, atol=0.2e-6)  # where the count begins


def test_encoder_scale_changes_readings_and_places(build: Build) -> None:
    """The encoder reads 1 % more than the belt travels, so that exposures are 1 % nearer to each other."""
    cell = build(3, belt_cell(), {"as_built.belt.encoder_scale": 0.01})
    run(cell, 0.1)
    cell.trigger(5, 0.0101)
    times = collect(cell, CYCLE_US, 1_500_000)[:, 0]
    read, true = cell.get("measured.conveyor[1].travel", "conveyor[1].travel")
    assert read == pytest.approx(1.01 * true, rel=1e-12)
    assert cell.get("measured.conveyor[1].speed")[0] == pytest.approx(0.101, rel=1e-12)
    np.testing.assert_allclose(np.diff(times[4:]), 0.1, atol=2e-6)  # s: 10 mm at 100 mm/s


def test_second_belt_triggers(build: Build) -> None:
    cell = build(3, belt_cell(2))
    cell.set("command.trigger.conveyor", 2)
    cell.trigger(5, 0.01)
    run(cell, 0.5, belt=1)
    cell.step(CYCLE_US, 20)
    assert cell.get_int("trigger.count") == 1
    run(cell, 0.5, belt=2)
    cell.step(CYCLE_US, 20)
    assert cell.get_int("trigger.count") > 5


@pytest.mark.parametrize(
    ("count", "belt", "interval"), [(1, 1, 0.0), (1, 2, 0.01), (1, 0, 0.01), (1, -(2**31), 0.01), (0, 1, 0.01)]
)
def test_missing_interval_or_belt_is_reported(build: Build, count: int, belt: int, interval: float) -> None:
    cell = build(3, belt_cell(count))
    cell.set("command.trigger.conveyor", belt)
    cell.trigger(5, interval)
    cell.step(CYCLE_US, 3)
    assert cell.get_int("trigger.count") == 0
    assert cell.get_int("controller.error") == TRIGGER_INTERVAL
