"""Speed of the cell's FMU through FMPy, against real time and against its engine by itself."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import dartpy
import numpy as np

from orchestrator.cell.fmu_file import FmiVersion, build_fmu, cell_json
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.nominal import NominalCell, nominal_cell
from orchestrator.config import load_setup
from orchestrator.config.loading import assets_dir
from orchestrator.geometry.mesh import load_mesh

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
