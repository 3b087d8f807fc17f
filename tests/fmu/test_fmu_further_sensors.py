"""Sensors beside that of the tool: true poses in closed form, deviations as built, records, states, clean variables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from cell_fixture import AXES, CYCLE_US, START, Build, pose, rejection
from continue_from_state import assert_continues_exactly, assert_restores_exactly
from fmpy.validation import validate_fmu
from scipy.spatial.transform import Rotation

from scancell.cell.fmu_file import build_fmu

CARRIERS = ("link[6]", "link[3]", "table", "world", "axis[2]")
TURN = Rotation.from_euler("XYZ", [20, -30, 50], degrees=True)


def pose_of(shift: Any, turn: Rotation) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn.as_matrix(), shift
    return made


def mounted(carriers: tuple[str, ...] = CARRIERS) -> dict[str, Any]:
    """Changes of a description: a sensor on each carrier."""
    placed = pose([0.01, 0.02, 0.03], np.roll(TURN.as_quat(), 1).tolist())
    return {**AXES, "further_sensors": [{"moves_with": name, "parent_from_sensor": placed} for name in carriers]}


def motion(cell: Any, cycles: int = 20) -> None:
    first = cell.time_us // CYCLE_US
    for k in range(first, first + cycles):
        cell.command(START + 0.1 * np.sin(0.1 * k), 0.02 * k)
        for name, start, size in (("track", 0.1, 0.05), ("column", 0.0, 0.1), ("lift", 0.0, 0.01)):
            cell.set(f"command.axis.{name}", start + size * np.sin(0.07 * k))
        cell.step(CYCLE_US)


def moved(build: Build, version: int = 3, parameters: dict[str, Any] | None = None) -> Any:
    cell = build(version, mounted(), parameters or {})
    motion(cell, 30)
    return cell


@pytest.mark.parametrize("version", [2, 3])
def test_poses_follow_the_carriers_and_the_deviations_as_built(build: Build, version: int) -> None:
    deviation = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (1e-3, -2e-3, 3e-3, 0.01, 0.02, -0.03), strict=True))
    parameters = {f"as_built.sensor[3].{key}": value for key, value in deviation.items()}
    cell = moved(build, version, parameters)
    shift, turn = list(deviation.values())[:3], Rotation.from_euler("XYZ", list(deviation.values())[3:])
    nominal, frames = pose_of([0.01, 0.02, 0.03], TURN), ("link[6]", "link[3]", "table", None, "axis_frame.column")
    for number, frame in enumerate(frames, 2):
        world_from_carrier = np.eye(4) if frame is None else cell.body(frame)
        expected = world_from_carrier @ nominal
        if number == 3:
            expected = expected @ pose_of(shift, turn)
        assert cell.body(f"sensor[{number}]") == pytest.approx(expected, abs=1e-12), number


def test_records_hold_their_poses_and_twists(build: Build) -> None:
    cell = moved(build)
    cell.trigger(1, 0.008, exposure=0.001)
    motion(cell)
    position = cell.vector("trigger.truth.table.position", 3)
    spin = cell.vector("trigger.truth.table.angular_velocity", 3)
    lever = cell.vector("trigger.truth.sensor[4].position", 3) - position
    table, own = (cell.vector(f"trigger.truth.{frame}.velocity", 3) for frame in ("table", "sensor[4]"))
    assert np.linalg.norm(spin) > 0.1
    assert own == pytest.approx(table + np.cross(spin, lever), abs=1e-9)
    assert cell.vector("trigger.truth.sensor[5].velocity", 3) == pytest.approx([0, 0, 0], abs=0)


@pytest.mark.parametrize("version", [2, 3])
def test_states_restore_exactly(build: Build, version: int, tmp_path: Path) -> None:
    cell = moved(build, version, {"as_built.sensor[2].rz": 0.01})

    cell.step(20_250)
    assert_restores_exactly(cell, motion)
    assert_continues_exactly(cell, motion, tmp_path)


@pytest.mark.parametrize("version", [2, 3])
def test_description_of_the_variables_is_clean(tmp_path: Path, version: int) -> None:
    file = tmp_path / "RobotCell.fmu"
    build_fmu(mounted(), file, version)
    assert validate_fmu(str(file)) == []
    names = {variable.name for variable in fmpy.read_model_description(str(file)).modelVariables}
    for number in range(2, len(CARRIERS) + 2):
        assert {f"as_built.sensor[{number}].{key}" for key in ("x", "y", "z", "rx", "ry", "rz")} <= names
        assert {f"{group}truth.sensor[{number}].position[1]" for group in ("", "trigger.")} <= names
    assert not any("sensor[1]" in name or f"sensor[{len(CARRIERS) + 2}]" in name for name in names)


@pytest.mark.parametrize("wrong", ["axis[4]", "link[9]", "conveyor[1]", "sensor[2]", "part[1]", "flange"])
def test_carriers_that_there_are_not_are_refused_by_their_key(wrong: str) -> None:
    assert "further_sensors[0].moves_with: expected" in rejection(mounted((wrong,)))


def test_more_sensors_than_there_may_be_are_refused() -> None:
    assert "further_sensors: expected" in rejection(mounted(("world",) * 8))
