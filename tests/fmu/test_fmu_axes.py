"""Axes beside joints and table: motions, true poses in closed form, states, and a part that a lift carries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cell_fixture import AXES, CYCLE_US, START, Array, Build, CellFmu, all_reals, rejection
from continue_from_state import assert_continues_exactly

NAMES = ("track", "column", "lift")
CYCLE = CYCLE_US * 1e-6


def motion(cell: CellFmu, cycles: int = 60) -> None:
    """All axes move by streamed set-points, from where the last ones ended."""
    first = cell.time_us // CYCLE_US
    for k in range(first, first + cycles):
        cell.command(START + 0.1 * np.sin(0.1 * k), 0.02 * k)
        for name, start, size in (("track", 0.1, 0.05), ("column", 0.0, 0.1), ("lift", 0.0, 0.01)):
            cell.set(f"command.axis.{name}", start + size * np.sin(0.07 * k))
        cell.step(CYCLE_US)


def carried(track: float, column: float) -> Array:
    """Pose (4, 4) in the world of the frame that the column carries."""
    c, s = np.cos(column), np.sin(column)
    return np.array([[c, -s, 0, 0.02], [s, c, 0, track - 0.1], [0, 0, 1, 0.05], [0, 0, 0, 1]])


@pytest.mark.parametrize("version", [2, 3])
def test_arm_and_table_follow_the_axes_that_carry_them(build: Build, version: int) -> None:
    cell, fixed = (
        build(version, AXES),
        build(version, {**AXES, "axes": [{**axis, "start": 0.0} for axis in AXES["axes"]]}),
    )
    base_from_link = np.linalg.inv(carried(0.0, 0.0)) @ fixed.body("link[6]")
    assert cell.get(*(f"measured.axis.{name}" for name in NAMES)) == pytest.approx([0.1, 0.0, 0.0], abs=1e-5)
    cell.set("command.mode", 2)
    for name, target in zip(NAMES, (-0.2, 0.4, 0.05), strict=True):
        cell.set(f"command.axis.{name}", target)
    cell.set("command.start", 1)
    cell.step(CYCLE_US, 200)
    assert cell.get_int("controller.error") == 0
    track, column, lift = cell.get(*(f"truth.axis.{name}" for name in NAMES))
    assert (track, column, lift) == pytest.approx((-0.2, 0.4, 0.05), abs=1e-12)
    assert cell.body("axis_frame.column") == pytest.approx(carried(track, column), abs=1e-12)
    assert cell.body("link[6]") == pytest.approx(carried(track, column) @ base_from_link, abs=1e-12)
    assert cell.body("table")[:3, 3] == pytest.approx([0.45, 0.0, 0.1 + lift], abs=1e-12)


def test_free_part_is_carried_by_the_lift_of_the_table(build: Build) -> None:
    cell = build(3, AXES)
    before = np.linalg.inv(cell.body("table")) @ cell.body("part[1]")
    heights = []
    for k in range(150):
        cell.command()
        cell.set("command.axis.track", 0.1)
        cell.set("command.axis.lift", 0.05 * (1 - np.cos(min(k * CYCLE, 1.5) * np.pi / 1.5)))
        cell.step(CYCLE_US)
        heights.append(cell.body("part[1]")[2, 3])
    assert heights[-1] - heights[0] == pytest.approx(0.1, abs=2e-5)
    after = np.linalg.inv(cell.body("table")) @ cell.body("part[1]")
    assert np.abs(after - before)[:3, 3].max() < 20e-6


@pytest.mark.parametrize("version", [2, 3])
def test_states_hold_the_axes(build: Build, version: int, tmp_path: Path) -> None:
    cell = build(version, AXES, {"seed": 3, "as_built.axis.track.x": 1e-4, "as_built.axis.lift.ry": 1e-3})
    motion(cell)
    cell.trigger(2, 0.02, exposure=0.003)
    cell.step(20_250)
    time_us, state = cell.time_us, cell.save()
    futures = []
    for _ in range(2):
        motion(cell, 20)
        futures.append(all_reals(cell))
        cell.restore(state, time_us)
    np.testing.assert_array_equal(*futures)
    cell.free_state(state)
    assert_continues_exactly(cell, motion, tmp_path)


def test_records_state_the_axes_at_the_exposure(build: Build) -> None:
    cell = build(3, AXES)
    motion(cell, 10)
    cell.trigger(1, 0.008, exposure=0.001)
    motion(cell, 20)
    track, lift = cell.get("trigger.measured.axis.track", "trigger.measured.axis.lift")
    assert cell.vector("trigger.truth.axis_frame.lift.position", 3)[2] == pytest.approx(lift, abs=1e-9)
    # The track's encoder is 2 ms late.
    late = cell.vector("trigger.truth.axis_frame.track.position", 3)[1] + 0.1 - track
    assert 1e-5 < abs(late) < 0.5e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"moves_with": "axis[2]"}, 'axes[0].moves_with: expected "world", or "axis[i]" of an axis that comes before'),
        ({"min": 0.7, "max": 0.6}, "axes[0].max"),
        ({"start": 0.61}, "axes[0].start"),
        ({"max_jerk": 0.0}, "axes[0].max_jerk"),
    ],
)
def test_wrong_axes_are_refused_by_their_key(change: dict[str, float], message: str) -> None:
    first, *others = AXES["axes"]
    assert message in rejection({**AXES, "axes": [{**first, **change}, *others]})
    assert "axes: expected" in rejection({**AXES, "axes": [*AXES["axes"], first]})
