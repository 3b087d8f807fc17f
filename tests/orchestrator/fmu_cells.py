"""FMUs of the default cell, and programs for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cells import ball

from scancell.cell.driver import Driver
from scancell.cell.fmu_file import cell_json, make_temporary_fmu
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program, Segment, TriggerKind, TriggerRule
from scancell.cell.recording import Recording
from scancell.config.cell import CellDescription
from scancell.config.loading import load_setup
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.planning.motion import trajectory

CYCLE_US = 16_000
CYCLE = CYCLE_US * 1e-6
EXPOSURE = 2e-3


def default_cell() -> NominalCell:
    return nominal_cell(load_setup(ideal=True).cell, ball())


def build(folder: Path, version: int, ideal: bool = True) -> Path:
    """Folder of an unpacked FMU."""
    setup = load_setup(ideal=ideal)
    description = cell_json(setup.cell, nominal_cell(setup.cell, ball()), 0)
    return make_temporary_fmu(description, folder / f"RobotCell{version}", 2 if version == 2 else 3)


def segment(number: int, q: np.ndarray, table: np.ndarray, rule: TriggerRule, start=0.0, end=0.0) -> Segment:
    return Segment(number, np.arange(len(q)) * CYCLE, np.column_stack([q, table]), rule, start, end)


def turn_of_table(home: np.ndarray, kind: TriggerKind, interval: float, count: int = 20) -> Program:
    """Arm at rest at `home`, table at 40 deg/s over `count` degrees of exposures."""
    run = trajectory.run(count, np.radians(1.0), np.radians(40.0), 2.0, CYCLE)
    start = run.at(trajectory.cycle_times(run.duration, CYCLE)) - run.at(0.0)
    arm = np.tile(home, (len(start), 1))
    rule = TriggerRule(kind, interval)
    return Program((segment(1, arm, start, rule, run.trigger_from, run.trigger_to),))


def moves_with_stops(home: np.ndarray, stops: int = 3) -> Program:
    """Moves of all joints, each followed by a requested exposure."""
    segments, q, table = [], home, 0.0
    for number in range(1, stops + 1):
        goal, further = q + np.radians([5.0, -4.0, 3.0, 6.0, -5.0, 8.0]), table + np.radians(20.0)
        limits = trajectory.Limits(np.full(7, 1.0), np.full(7, 3.0), np.full(7, 60.0))
        points = trajectory.move(np.append(q, table), np.append(goal, further), limits, CYCLE)
        segments.append(segment(number, points[:, :6], points[:, 6], TriggerRule("request")))
        q, table = goal, further
    return Program(tuple(segments), settle=0.2)


def drive(
    folder: Path,
    cell: CellDescription,
    nominal: NominalCell,
    table: np.ndarray,
    rule: TriggerRule,
    belt_speed: float | None = None,
) -> Recording:
    """Recording of the arm at rest at home while the table moves along `table` (n,), rad, and the first belt runs."""
    arm = np.tile(nominal.home, (len(table), 1))
    program = Program((segment(1, arm, table, rule, 2 * CYCLE, (len(table) - 2) * CYCLE),))
    with CellInstance(make_temporary_fmu(cell_json(cell, nominal, 0), folder / "fmu")) as instance:
        if belt_speed is not None:
            instance.set(instance.real_group(["command.conveyor[1].speed"]), np.array([belt_speed]))
        return Driver(instance, CYCLE_US, 1e-3).run(program)
