"""A part on the flange before a sensor on a post or on an axis: true poses, triggers, states and packages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cell_fixture import (
    AXES,
    CYCLE_US,
    START,
    Array,
    Build,
    CellFmu,
    FmuFolders,
    cell_description,
    further_axis,
    pose,
    rejection,
)
from continue_from_state import assert_continues_exactly, assert_restores_exactly
from fmpy.validation import validate_fmu

HALF = np.sqrt(0.5)
ON_FLANGE = pose([0.01, -0.02, 0.05], [0.5, 0.5, -0.5, 0.5])
# A sensor before the arm that looks along -x, and a box on the flange.
HELD = {
    **cell_description(stands_on="link[6]", support_from_part=ON_FLANGE),
    "tool": {"moves_with": "world", "carrier_from_sensor": pose([0.6, 0.05, 0.4], [HALF, 0.0, -HALF, 0.0])},
}
# The same sensor on a lift.
LIFTED = {
    **HELD,
    "axes": [further_axis("lift", True, 0.2, parent_from_joint=pose([0.1, 0.0, 0.05]))],
    "tool": {**HELD["tool"], "moves_with": "axis[1]"},
}
GRASP = {"x": 3e-4, "y": -2e-4, "z": 5e-4, "rx": 2e-3, "ry": -1e-3, "rz": 4e-3}


def matrix(described: dict[str, list[float]]) -> Array:
    w, x, y, z = described["quaternion"]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    at = np.eye(4)
    at[:3, :3], at[:3, 3] = turn, described["position"]
    return at


def moved(by: dict[str, float]) -> Array:
    """A translation, then a rotation XYZ', as products of elementary rotations."""
    at = np.eye(4)
    for (i, j), angle in zip(((1, 2), (2, 0), (0, 1)), (by["rx"], by["ry"], by["rz"]), strict=True):
        turn = np.eye(4)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
        at = at @ turn
    at[:3, 3] = [by["x"], by["y"], by["z"]]
    return at


def motion(cell: CellFmu, cycles: int = 40) -> None:
    """All joints move by streamed set-points, from where the last ones ended."""
    first = cell.time_us // CYCLE_US
    for k in range(first, first + cycles):
        cell.command(START + 0.1 * np.sin(0.1 * k), 0.02 * k)
        cell.step(CYCLE_US)


@pytest.mark.parametrize("version", [2, 3])
def test_part_follows_the_flange_and_the_sensor_stays(build: Build, version: int) -> None:
    deviations = {f"as_built.grasp.{key}": value for key, value in GRASP.items()}
    cell = build(version, HELD, {**deviations, "as_built.tool.y": 7e-4, "as_built.tool.rz": 3e-3})
    tool = moved({"x": 0.0, "y": 7e-4, "z": 0.0, "rx": 0.0, "ry": 0.0, "rz": 3e-3})
    on_flange, on_post = matrix(ON_FLANGE) @ moved(GRASP), matrix(HELD["tool"]["carrier_from_sensor"]) @ tool
    places = []
    for _ in range(3):
        assert cell.body("part[1]") == pytest.approx(cell.body("link[6]") @ on_flange, abs=1e-12)
        assert cell.body("sensor") == pytest.approx(on_post, abs=1e-12)
        assert cell.vector("truth.sensor.velocity", 3) == pytest.approx(np.zeros(3), abs=0)
        places.append(cell.body("part[1]")[:3, 3])
        motion(cell, 7)
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).min() > 1e-3


def test_part_vibrates_with_the_flange(build: Build) -> None:
    sine = {"as_built.vibration.flange.x": 1e-4, "as_built.vibration.flange.frequency": 20.0}
    cell, still = build(3, HELD, sine), build(3, HELD)
    away = []
    for _ in range(20):
        for one in (cell, still):
            one.command()
            one.step(3_000)
        away.append(np.linalg.norm(cell.body("part[1]")[:3, 3] - still.body("part[1]")[:3, 3]))
        assert cell.body("part[1]") == pytest.approx(cell.body("link[6]") @ matrix(ON_FLANGE), abs=1e-12)
    assert 0.5e-4 < max(away) < 1.01e-4


def test_sensor_rides_on_an_axis(build: Build) -> None:
    cell = build(3, LIFTED)
    before = cell.body("sensor")
    for k in range(60):
        cell.command()
        cell.set("command.axis.lift", 0.1 * (1 - np.cos(min(k / 50, 1.0) * np.pi)) / 2)
        cell.step(CYCLE_US)
    assert cell.body("sensor")[:3, 3] - before[:3, 3] == pytest.approx([0.0, 0.0, 0.1], abs=1e-9)
    assert cell.body("sensor")[:3, :3] == pytest.approx(before[:3, :3], abs=1e-15)


def test_default_tool_is_the_flange(build: Build) -> None:
    cell = build(3, HELD)
    assert cell.vector("command.tool.position", 3) == pytest.approx(np.zeros(3), abs=0)
    assert cell.vector("command.target.position", 3) == pytest.approx(cell.body("link[6]")[:3, 3], abs=1e-12)


def test_path_distance_counts_the_travel_of_the_sensor_in_the_frame_of_the_part(build: Build) -> None:
    """Joint 6 alone turns the part: the sensor draws a circle about the axis of the flange, which does not move."""
    cell = build(3, HELD)
    flange_from_sensor = np.linalg.inv(cell.body("link[6]")) @ cell.body("sensor")
    radius = np.hypot(*flange_from_sensor[:2, 3])
    pitch = 0.01 * radius
    cell.command()
    cell.step(CYCLE_US)
    cell.trigger(3, pitch, exposure=0.001)
    for k in range(1, 101):
        turned = START.copy()
        turned[5] += 0.25 * (1 - np.cos(np.pi * k / 100))
        cell.command(turned)
        cell.step(CYCLE_US)
    # The first exposure fires at once, one at each hundredth of a radian after it.
    assert cell.get_int("trigger.count") == pytest.approx(1 + 0.5 / 0.01, abs=1)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("description", [HELD, LIFTED], ids=["post", "lift"])
def test_package_is_valid_and_states_continue(
    build: Build, folders: FmuFolders, version: int, description: dict[str, object], tmp_path: Path
) -> None:
    assert validate_fmu(str(folders.packed(version, description))) == []
    cell = build(version, description, {"seed": 3, "as_built.grasp.rz": 1e-3, "as_built.tool.x": 1e-4})
    motion(cell)
    cell.trigger(3, 0.002, exposure=0.003)
    cell.step(20_250)
    assert_restores_exactly(cell, motion)
    assert_continues_exactly(cell, motion, tmp_path)


def test_deviation_of_the_grasp_exists_where_the_arm_holds_the_part(build: Build) -> None:
    assert ["as_built.grasp.x" in build(3, one).variables for one in (HELD, AXES)] == [True, False]


@pytest.mark.parametrize(
    ("tool", "message"),
    [
        ({"moves_with": "link[2]"}, "tool.moves_with"),
        ({"moves_with": "axis[1]"}, "tool.moves_with"),
        ({"flange_from_sensor": pose([0, 0, 0])}, "tool"),
    ],
)
def test_wrong_carriers_of_the_sensor_are_refused(tool: dict[str, object], message: str) -> None:
    assert message in rejection({**HELD, "tool": {**HELD["tool"], **tool}})
