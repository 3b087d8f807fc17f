"""Conveyors: motion of the belt, parts on it, and transfers to another support."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Build, CellFmu, box_part, cell_description, conveyor, pose, rejection
from continue_from_state import assert_continues_exactly
from scipy.spatial.transform import Rotation

from json_changes import changed

GRAVITY = 9.80665
MAX_ACCELERATION = 2.0


def quaternion_about_z(angle: float) -> list[float]:
    x, y, z, w = Rotation.from_euler("z", angle).as_quat()
    return [w, x, y, z]


def belt_cell(yaw: float = 0.0, **changes: Any) -> dict[str, Any]:
    """A belt beside the table with a free box, 300 mm before the middle of the belt."""
    cell = cell_description()
    cell["conveyors"] = [conveyor(world_from_belt=pose([0, -1, 0.2], quaternion_about_z(yaw)), **changes)]
    place = pose([-0.3, 0, 0], quaternion_about_z(0.2))
    cell["parts"] = [box_part(0.06, 0.04, 0.05, fixture="free", stands_on="conveyor[1]", support_from_part=place)]
    return cell


def transfer_cell(onto: str) -> dict[str, Any]:
    """A belt that ends 2 mm before the table, or before a fixed plate, at the same height."""
    cell = cell_description()
    edge = 0.45 - 0.12 if onto == "table" else 0.0
    cell["conveyors"] = [conveyor(world_from_belt=pose([edge - 0.302, 0, 0.1]), length=0.6)]
    place = pose([0.1, 0, 0])
    free = box_part(0.06, 0.04, 0.05, fixture="free", friction=0.4, stands_on="conveyor[1]", support_from_part=place)
    plate = box_part(0.5, 0.3, 0.02, name="plate", stands_on="world", support_from_part=pose([0.25, 0, 0.08]))
    cell["parts"] = [free] if onto == "table" else [free, plate]
    return cell


@pytest.mark.parametrize("step_us", [370, 1000, CYCLE_US, 64_000])
def test_belt_motion_matches_closed_form(build: Build, step_us: int) -> None:
    """0.31 m/s, then -0.7 m/s, with constant acceleration, at several communication steps."""
    cell = build(3, belt_cell())
    switch = 64_000 * 10
    times, found = [], []
    cell.set("command.conveyor[1].speed", 0.31)
    while cell.time_us < 1_920_000:
        if cell.time_us < switch <= cell.time_us + step_us:
            cell.step(switch - cell.time_us)
            cell.set("command.conveyor[1].speed", -0.7)
        cell.step(step_us)
        times.append(cell.time_us * 1e-6)
        found.append(cell.get("conveyor[1].travel", "conveyor[1].speed", "conveyor[1].texture_offset"))
    t = np.array(times)
    s = 0.640
    up, back = 0.31 / MAX_ACCELERATION, (0.31 + 0.7) / MAX_ACCELERATION
    first = np.where(t < up, MAX_ACCELERATION * t**2 / 2, 0.31 * t - 0.31**2 / 2 / MAX_ACCELERATION)
    there = 0.31 * s - 0.31**2 / 2 / MAX_ACCELERATION
    d = t - s
    ramp = there + 0.31 * d - MAX_ACCELERATION * d**2 / 2
    after = there + 0.31 * back - MAX_ACCELERATION * back**2 / 2 - 0.7 * (d - back)
    travel = np.where(t <= s, first, np.where(d < back, ramp, after))
    values = np.array(found)
    np.testing.assert_allclose(values[:, 0], travel, atol=1e-9)
    np.testing.assert_allclose(np.mod(values[:, 0] - values[:, 2] + 0.6, 1.2), 0.6, atol=1e-9)
    assert ((values[:, 2] >= 0) & (values[:, 2] < 1.2)).all()
    assert values[-1, 1] == -0.7


def test_belt_speed_is_clamped(build: Build) -> None:
    cell = build(2, belt_cell(max_speed=0.25))
    cell.set("command.conveyor[1].speed", 3.0)
    cell.step(CYCLE_US, 30)
    assert cell.get("conveyor[1].speed")[0] == 0.25


@pytest.mark.parametrize("yaw", [0.0, 0.4, np.pi / 4])
@pytest.mark.parametrize("friction", [0.2, 0.4])
def test_friction_accelerates_part_to_belt_speed(build: Build, yaw: float, friction: float) -> None:
    """With a belt at speed immediately: duration v / (mu g) and slip v^2 / (2 mu g), straight along the belt."""
    speed = 0.8
    cell = build(3, belt_cell(yaw, max_acceleration=1e4, friction=friction))
    along = np.array([np.cos(yaw), np.sin(yaw), 0])
    start = cell.vector("truth.part[1].position", 3)
    cell.set("command.conveyor[1].speed", speed)
    reached = None
    while cell.time_us < 500_000:
        cell.step(1000)
        moving = cell.vector("truth.part[1].velocity", 3)
        if reached is None and moving @ along > speed * (1 - 1e-6):
            reached = cell.time_us * 1e-6
    shift = cell.vector("truth.part[1].position", 3) - start
    slip = cell.get("conveyor[1].travel")[0] - shift @ along
    assert reached == pytest.approx(speed / (friction * GRAVITY), rel=0.02)
    assert slip == pytest.approx(speed**2 / (2 * friction * GRAVITY), rel=0.02)
    assert np.linalg.norm(shift - (shift @ along) * along) < 1e-6


@pytest.mark.parametrize(("acceleration", "holds"), [(0.97, True), (1.03, False)])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_part_sticks_to_belt_up_to_friction_limit(build: Build, yaw: float, acceleration: float, holds: bool) -> None:
    cell = build(3, belt_cell(yaw, max_acceleration=acceleration * 0.5 * GRAVITY, max_speed=2.0))
    along = np.array([np.cos(yaw), np.sin(yaw), 0])
    start = cell.vector("truth.part[1].position", 3)
    cell.set("command.conveyor[1].speed", 1.5)
    cell.step(1000, 250)
    shift = cell.vector("truth.part[1].position", 3) - start
    slip = abs(cell.get("conveyor[1].travel")[0] - shift @ along)
    assert slip < 1e-6 if holds else slip > 1e-4


@pytest.mark.parametrize("onto", ["table", "plate"])
def test_part_transfers_from_belt_and_comes_to_rest(build: Build, onto: str) -> None:
    """The part leaves the belt at belt speed and stops within the braking distance after the edge."""
    cell = build(3, transfer_cell(onto))
    speed = 0.4
    cell.set("command.conveyor[1].speed", speed)
    cell.step(CYCLE_US, 90)
    position = cell.vector("truth.part[1].position", 3)
    edge = 0.33 if onto == "table" else 0.0
    assert edge + 0.03 < position[0] < edge + 0.03 + speed**2 / (2 * 0.4 * GRAVITY)
    assert abs(position[2] - 0.1) < 1e-6
    assert np.abs(cell.vector("truth.part[1].velocity", 3)).max() < 1e-6
    before = np.linalg.inv(cell.body("table")) @ cell.body("part[1]")
    for k in range(60):
        cell.command(table=0.3 - 0.3 * np.cos(np.pi * k / 59))
        cell.step(CYCLE_US)
    after = np.linalg.inv(cell.body("table")) @ cell.body("part[1]")
    stays_on_table = np.abs(after - before)[:3, 3].max() < 1e-6
    assert stays_on_table == (onto == "table")


def run_transfer(cell: CellFmu) -> None:
    for k in range(60):
        cell.set("command.conveyor[1].speed", 0.4 + 0.1 * np.sin(0.2 * k))
        cell.command(table=0.002 * k)
        cell.step(CYCLE_US // 2)
    cell.step(330)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("time_us", [100_250, 560_250, 610_250])
def test_state_during_transfer_restores_bit_exactly(build: Build, version: int, time_us: int, tmp_path: Path) -> None:
    """While the belt accelerates the part, at the edge, and on both supports; in the same and in a new process."""
    cell = build(version, transfer_cell("table"))
    cell.set("command.conveyor[1].speed", 0.4)
    cell.step(10_250)
    cell.step(1000, (time_us - 10_250) // 1000)
    assert_continues_exactly(cell, run_transfer, tmp_path, build(version, transfer_cell("table")))


def test_part_clamped_to_belt_is_rejected() -> None:
    message = rejection(changed(belt_cell(), "parts.0.fixture", "clamped"))
    assert "parts[0].stands_on: expected" in message
    assert "a part cannot be clamped to a belt" in message
