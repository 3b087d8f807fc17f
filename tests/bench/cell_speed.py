"""Speed of the cell's FMU through FMPy, against real time and against its engine by itself."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import dartpy
import numpy as np

from orchestrator.cell.fmu_file import FmiVersion, build_fmu, cell_json
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.nominal import NominalCell, nominal_cell
from orchestrator.config import load_setup
from orchestrator.config.loading import assets_dir
from orchestrator.geometry.mesh import box_mesh, load_mesh, mass_properties
from orchestrator.geometry.pose import translation

from .table import Row
from .timing import Timing, measure

STEPS = 4000
STEP_US = 1000
_SERVO = 1
_TABLE_ANGLE = 2


def cell_rows() -> Iterator[Row]:
    """Microseconds per communication step of 1 ms, and how much faster than real time that is."""
    setup = load_setup()
    nominal = nominal_cell(setup.cell, load_mesh(assets_dir() / "parts" / "free_form.stl"))
    description = cell_json(setup.cell, nominal, seed=0)
    engine = _bare_engine_us(nominal)
    versions: tuple[FmiVersion, ...] = (2, 3)
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as folder:
        for version in versions:
            fmu = Path(folder) / f"RobotCell{version}.fmu"
            build_fmu(description, fmu, version)
            with CellInstance(fmu) as cell:
                timing = _step_us(cell)
            name = f"FMU, FMI {version}, 1 ms steps, poses in and out"
            yield Row(name, timing.best, "us/step", "bare dartpy world, 1 ms step", engine.best, timing.spread)
            factor = STEP_US / timing.best
            yield Row(f"FMU, FMI {version}, real-time factor", factor, "x", "real time", 1.0, timing.spread, "at least")
        yield from _three_part_rows(description, Path(folder))


def _three_parts(description: Mapping[str, Any]) -> dict[str, Any]:
    """The cell with a belt and three free boxes, two on the table and one on the belt."""
    boxes = [
        ("left", "table", (0.06, 0.04, 0.05), (0.05, 0.0)),
        ("right", "table", (0.04, 0.04, 0.03), (-0.05, 0.02)),
        ("rider", "conveyor[1]", (0.05, 0.04, 0.03), (-0.4, 0.0)),
    ]
    belt = {"position": [0.0, -1.0, 0.2], "quaternion": [1, 0, 0, 0]}
    conveyor = {"name": "belt", "world_from_belt": belt, "length": 1.2, "width": 0.3, "thickness": 0.05}
    limits = {"max_speed": 1.0, "max_acceleration": 2.0, "friction": 0.5}
    parts = [_box(name, support, size, place) for name, support, size, place in boxes]
    return {**description, "conveyors": [{**conveyor, **limits}], "parts": parts}


def _box(name: str, support: str, size: tuple[float, float, float], place: tuple[float, float]) -> dict[str, Any]:
    mesh = box_mesh(size).transformed(translation((0.0, 0.0, size[2] / 2)))
    properties = mass_properties(mesh, 2700.0)
    return {
        "name": name, "fixture": "free", "stands_on": support, "mass": properties.mass, "friction": 0.5,
        "soft": None, "support_from_part": {"position": [*place, 0.0], "quaternion": [1, 0, 0, 0]},
        "hull": {"vertices": mesh.vertices.tolist(), "faces": mesh.faces.tolist()},
        "centre_of_mass": properties.centre_of_mass.tolist(), "inertia": properties.inertia.tolist(),
    }  # fmt: skip


def _three_part_rows(description: Mapping[str, Any], folder: Path) -> Iterator[Row]:
    """Three free parts and a belt, by processor time, against the bare engine in C++ with the same bodies."""
    data = _three_parts(description)
    costs = _dynamics_us(data, folder)
    if costs is None:
        return
    bare, held = costs
    yield Row("three parts: stick anchors and imposed drives, in C++", held - bare, "us/step", "bare DART", bare)
    fmu = folder / "three.fmu"
    build_fmu(data, fmu, 2)
    with CellInstance(fmu) as cell:
        whole = _step_us(cell).processor
    with CellInstance(fmu) as cell:
        alone = _do_step_us(cell)
    name = "three parts: FMU, doStep of 1 ms without the anchors"
    yield Row(name, alone - (held - bare), "us/step", "bare DART", bare, None, "at most", 1.1)
    yield Row("three parts: FMPy's set 7, doStep, get 50", whole - alone, "us/step", "allowed", 7.0, None, "at most")
    yield Row("three parts: real-time factor", STEP_US / whole, "x", "real time", 1.0, None, "at least", 12.0)


def _do_step_us(cell: CellInstance) -> float:
    cell.set(cell.real_group(["command.conveyor[1].speed"]), np.array([0.01]))

    def run() -> None:
        for _ in range(STEPS):
            cell.step_to(cell.time_us + STEP_US)

    return _per_step(measure(run)).processor


def _dynamics_us(data: Mapping[str, Any], folder: Path) -> tuple[float, float] | None:
    """Microseconds per step of the bare engine and of the cell's world; None where the program is not built."""
    built = sorted(Path(__file__).parents[2].glob("build/*/tests/fmu/robotcell-step-cost"))
    if not built:
        return None
    file = folder / "three.json"
    file.write_text(json.dumps(data))
    command = [str(built[-1]), str(file), str(STEPS)]
    figures = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return figures["bare_us"], figures["held_us"]


def _step_us(cell: CellInstance) -> Timing:
    """Scanning motion: the table turns, the trigger fires by angle, inputs and poses pass at every step."""
    names = [*(f"command.q[{i}]" for i in range(1, 7)), "command.table"]
    setpoints = cell.real_group(names)
    start = cell.get(cell.real_group([f"measured.q[{i}]" for i in range(1, 7)])).copy()
    bodies = [*(f"link[{i}]" for i in range(1, 7)), "sensor", "table", "part[1]"]
    shown = [f"truth.{body}.position[{i}]" for body in bodies for i in range(1, 4)]
    shown += [f"truth.{body}.velocity[{i}]" for body in bodies for i in range(1, 4)]
    shown += [f"measured.q[{i}]" for i in range(1, 7)] + [f"measured.qd[{i}]" for i in range(1, 7)]
    shown += [f"trigger.measured.q[{i}]" for i in range(1, 7)]
    shown += [f"trigger.truth.sensor.position[{i}]" for i in range(1, 4)]
    shown += [f"trigger.truth.sensor.orientation[{i}]" for i in range(1, 5)] + ["measured.table", "measured.table_rate"]
    outputs = cell.real_group(shown)
    cell.set(cell.real_group(["command.trigger.angle", "command.exposure"]), np.array([np.radians(1.0), 5e-4]))
    cell.set_integer("command.mode", _SERVO)
    cell.set_integer("command.trigger.mode", _TABLE_ANGLE)

    def run() -> None:
        for _ in range(STEPS):
            # A turn that the table follows at 0.5 rad/s.
            cell.set(setpoints, np.append(start, 0.5e-6 * cell.time_us))
            cell.step_to(cell.time_us + STEP_US)
            cell.get(outputs)

    return _per_step(measure(run))


def _per_step(timing: Timing) -> Timing:
    scale = 1e6 / STEPS
    return Timing(scale * timing.best, timing.spread, scale * timing.processor)


def _bare_engine_us(nominal: NominalCell) -> Timing:
    """The same arm and table in dartpy's own world, with nothing around it."""
    world = dartpy.simulation.World()
    world.setTimeStep(STEP_US * 1e-6)
    arm = dartpy.dynamics.Skeleton("arm")
    parent = None
    for joint in nominal.arm.joints:
        properties = dartpy.dynamics.RevoluteJointProperties()
        properties.mAxis = np.array([0.0, 0.0, 1.0])
        properties.mT_ChildBodyToJoint = _isometry(_joint_from_link(joint.a, joint.d, joint.alpha)).inverse()
        _, parent = arm.createRevoluteJointAndBodyNodePair(parent, properties)
    table = dartpy.dynamics.Skeleton("table")
    table.createRevoluteJointAndBodyNodePair(None, dartpy.dynamics.RevoluteJointProperties())
    for skeleton in (arm, table):
        skeleton.setMobile(False)
        world.addSkeleton(skeleton)

    def run() -> None:
        for k in range(STEPS):
            arm.setPositions(np.full(6, 1e-4 * k))
            table.setPositions(np.array([5e-4 * k]))
            world.step()

    return _per_step(measure(run))


def _joint_from_link(a: float, d: float, alpha: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    cosine, sine = np.cos(alpha), np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, cosine, -sine, 0], [0, sine, cosine, d], [0, 0, 0, 1.0]])


def _isometry(matrix: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> dartpy.math.Isometry3:
    return dartpy.math.Isometry3(matrix)
