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
import trimesh

from scancell.cell.fmu_file import FmiVersion, build_fmu, cell_json
from scancell.cell.instance import CellInstance
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry.mesh import box_mesh, load_mesh
from scancell.geometry.pose import translation
from scancell.nominal.cell import NominalCell, nominal_cell

from .table import Row, Wanted
from .timing import Timing, measure, scaled

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
            peer = "bare dartpy world, 1 ms step"
            yield Row(name, timing.best, "us/step", peer, engine.best, timing.spread, other=timing.processor)
            factor, by_processor = STEP_US / timing.best, STEP_US / timing.processor
            name = f"FMU, FMI {version}, real-time factor"
            yield Row(name, factor, "x", "real time", 1.0, timing.spread, "at least", other=by_processor)
        yield from _three_part_rows(Path(folder))


_THREE_PARTS = """
[[conveyor]]
name = "belt"
pose = { y_mm = -1000.0, z_mm = 200.0 }
length_mm = 1200.0
width_mm = 300.0

[[further_part]]
name = "right"
mesh = "right.stl"
pose = { x_mm = -50.0, y_mm = 20.0 }

[[further_part]]
name = "rider"
mesh = "rider.stl"
stands_on = "conveyor[1]"
pose = { x_mm = -400.0 }
"""


def _three_parts(folder: Path, *words: str) -> dict[str, Any]:
    """The shipped cell with a belt and three free boxes, two on the table and one on the belt."""
    boxes = {"left": (0.06, 0.04, 0.05), "right": (0.04, 0.04, 0.03), "rider": (0.05, 0.04, 0.03)}
    meshes = {name: box_mesh(size).transformed(translation((0.0, 0.0, size[2] / 2))) for name, size in boxes.items()}
    for name, mesh in meshes.items():
        trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces).export(folder / f"{name}.stl")
    file = folder / "cell.toml"
    shipped = (assets_dir() / "cells" / "default.toml").read_text()
    file.write_text(shipped.replace("../", f"{assets_dir()}/") + _THREE_PARTS)
    setup = load_setup(file, settings=["cell.part.fixture=free", "cell.part.x_mm=50", *words])
    return cell_json(setup.cell, nominal_cell(setup.cell, meshes["left"]), seed=0)


def _three_part_rows(folder: Path) -> Iterator[Row]:
    """Three free parts and a belt, by processor time, against the bare engine in C++ with the same bodies."""
    data = _three_parts(folder, "cell.collision.outputs=false", "cell.contact.cell_bodies=false")
    touchable = _three_parts(folder, "cell.collision.outputs=false")
    costs, touchable_costs = _dynamics_us(data, folder), _dynamics_us(touchable, folder)
    if costs is None or touchable_costs is None:
        return
    bare, held = costs
    yield _row("stick anchors and imposed drives, in C++", held - bare, "us/step", "bare DART", bare)
    name = "contact shapes of arm, sensor, table base and floor"
    yield _row(name, touchable_costs[1] - held, "us/step", "the world without", held)
    fmu = folder / "three.fmu"
    build_fmu(data, fmu, 2)
    with CellInstance(fmu) as cell:
        whole = _step_us(cell).processor
    with CellInstance(fmu) as cell:
        alone = _do_step_us(cell)
    name = "FMU, doStep of 1 ms without the anchors"
    yield _row(name, alone - (held - bare), "us/step", "bare DART", bare, "at most", 1.1)
    yield _row("FMPy's set 7, doStep, get 50", whole - alone, "us/step", "allowed", 7.0, "at most")
    yield _row("real-time factor", STEP_US / whole, "x", "real time", 1.0, "at least", 12.0)
    watched = {range_mm: _watched_us(folder, range_mm) for range_mm in (20, 50)}
    sampled = _watched_us(folder, 20, "cell.collision.swept=false")
    name = "collision outputs, distances up to"
    yield _row(f"{name} 20 mm: real-time factor", STEP_US / watched[20], "x", "real time", 1.0, "at least", 10.0)
    yield _row(f"{name} 50 mm: real-time factor", STEP_US / watched[50], "x", "real time", 1.0)
    name = "collision outputs: following the bodies between two cycles"
    yield _row(name, watched[20] - sampled, "us/step", "sampled outputs", sampled)


def _row(
    name: str, value: float, unit: str, peer: str, peer_value: float, wanted: Wanted = "", limit: float = 1.0
) -> Row:
    """A row of the cell with three parts, by processor time."""
    return Row(f"three parts: {name}", value, unit, peer, peer_value, None, wanted, limit, clock="processor")


def _watched_us(folder: Path, range_mm: int, *words: str) -> float:
    fmu = folder / f"watched_{range_mm}_{len(words)}.fmu"
    build_fmu(_three_parts(folder, f"cell.collision.range_mm={range_mm}", *words), fmu, 2)
    with CellInstance(fmu) as cell:
        return _step_us(cell).processor


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
    """Table and arm move, the trigger fires by angle, inputs and poses pass at every step."""
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
            # A turn that the table follows at 0.5 rad/s, while every joint swings by 0.1 rad.
            time = 1e-6 * cell.time_us
            cell.set(setpoints, np.append(start + 0.1 * np.sin(time), 0.5 * time))
            cell.step_to(cell.time_us + STEP_US)
            cell.get(outputs)

    return _per_step(measure(run))


def _per_step(timing: Timing) -> Timing:
    return scaled(timing, 1e6 / STEPS)


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
