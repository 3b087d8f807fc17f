"""Jogs of the sensor towards the part in front of the guard: ``PYTHONPATH=tests python -m bench.guard_jogs PART``.

Prints the distance at which the sensor rests if a jog straight down is held, and the time that an operator needs from
home to 10 mm above the part, with and without a guard; for all shipped arms, with python-fcl as judge of contacts.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from guard_motions import CELLS
from scancell.cell.driver import Mode, Operation
from scancell.cell.fmu_file import ReusableCell, cell_json
from scancell.config.cell import CellDescription
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.guard.guard import GuardedCell
from scancell.guard.transport import InProcess, Link
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import load_part
from scancell.proximity.motion_check import MotionBounds
from scancell.scanning.session import guard_of
from scancell.studies.guard.scenario import Kind, Motion, Scenario
from scancell.studies.guard.simulation import Network, Simulation
from scancell.studies.guard.worlds import World

Array = NDArray[np.float64]

SHARES = (1.0, 0.5, 0.25, 0.1, 0.05, 0.01, 0.001)
_PAIR = ("sensor", "part")
_COMPUTE = 0.004  # s that an answer takes
_CLEAR = 0.15  # m: height above the part at which fast jogs begin; slow ones begin lower
_LOW = 0.008
_SLOW = 0.05  # share of the jog speed up to which jogs begin low
_GOAL, _REACHED = 0.010, 0.0005  # m above the part
_EASE = 0.6  # s: an operator's deflection is the way that is left in this time
_LEAST = 0.01  # share of the jog speed
_MOST = 60.0  # s


@dataclass(frozen=True)
class JogOutcome:
    """Distance (m) at which a held jog rests, whether by an emergency stop, the pair in contact, and duration, s."""

    distance: float
    stopped: bool
    contact: str
    rests_after: float


class JogBench:
    """A cell of an arm with a part."""

    def __init__(self, arm: str, part: Mesh) -> None:
        self.description: CellDescription = load_setup(assets_dir() / "cells" / f"{CELLS[arm]}.toml").cell
        self.nominal: NominalCell = nominal_cell(self.description, part)
        self.guard = guard_of(self.description, part)
        world = World(self.description, self.nominal, self.guard.settings)
        self.simulation = Simulation(world)
        self._pair = np.array([pair == _PAIR for pair in world.pairs])

    def distance(self, axes: Array) -> float:
        """Of sensor and part at axes (joints + 1,), m."""
        return float(self.simulation.distances(self._pair, axes[None])[0])

    def above(self, height: float) -> Array:
        """Axes (joints + 1,), rad, with the sensor `height` (m) above the part."""
        sensor = self.nominal.world_from_sensor(self.nominal.home).copy()
        sensor[:2, 3] = self.nominal.world_from_table[:2, 3]
        axes = np.append(self.nominal.home, 0.0)
        for _ in range(3):  # the distance is that along the jog only above a flat part
            flange = sensor @ pose.inverse(self.nominal.flange_from_sensor)
            branches = self.nominal.arm.ik(flange[None], axes[None, :-1])[0]
            axes[:-1] = branches[np.nanargmin(np.abs(branches - axes[:-1]).max(1))]
            sensor[2, 3] += height - self.distance(axes)
        return axes

    def terms(self) -> str:
        """What remains in front of the part by the guard's assumptions, mm."""
        free_path, settings = self.guard._free_path, self.guard.settings
        number = free_path._pairs.index(_PAIR)
        axes = self.above(_LOW)
        errors = np.diag(free_path.angle_error)[:, None]
        angles = float(MotionBounds(self.nominal, [_PAIR]).pairs(axes[None], errors).sum())
        meshes = float(free_path._clearance[number]) - 2 * settings.position_error
        named = {"positions": 2 * settings.position_error, "meshes": meshes, "angles": angles}
        return ", ".join(f"{name} {1e3 * value:.1f}" for name, value in named.items())

    def held(self, share: float) -> JogOutcome:
        """A jog straight down at a share of the full speed."""
        low = share <= _SLOW
        start = self.above(_LOW if low else _CLEAR)
        values = np.zeros(len(start))
        values[2] = -share
        duration = 3.0 + 2 * (_LOW if low else _CLEAR) / (0.25 * share)
        jog = Motion(Kind.BASE_JOG, values, share, duration)
        record = self.simulation.run(Scenario(start, (jog,), duration), Network())
        moving = np.flatnonzero(np.abs(record.axes - record.axes[-1]).max(1) > 1e-5)
        contact = self.simulation.contact(record, np.zeros((len(self.nominal.bodies), 3)))
        return JogOutcome(
            self.distance(record.axes[-1]),
            record.stopped_at is not None,
            "" if contact is None else " - ".join(contact[1]),
            float(record.times[moving[-1]]),
        )

    def time_to_part(self, guarded: bool) -> float:
        """Time (s) from home to 10 mm above the part, over its centre first; infinite: not within a minute."""
        self.guard.reset()
        age = self.guard.settings.max_age
        cycle_us = self.description.world.controller_cycle_us
        with ReusableCell() as cells:
            cell = cells.start(cell_json(self.description, self.nominal, 0, collision_outputs=False))
            link = Link(InProcess(self.guard, _COMPUTE), age) if guarded else None
            run = GuardedCell(cell, cycle_us, link, age)
            cell.set_integer("command.operation", Operation.MANUAL)
            cell.set_integer("command.mode", Mode.CARTESIAN_JOG)
            truth = cell.real_group(cell.axis_names("truth."))
            jog = cell.real_group([f"command.jog[{i}]" for i in (1, 2, 3)])
            down = False
            while cell.time_us < _MOST * 1e6:
                axes = cell.get(truth)
                aside = self.nominal.world_from_table[:2, 3] - self.nominal.world_from_sensor(axes[:-1])[:2, 3]
                down = down or bool(np.linalg.norm(aside) < _REACHED)
                way = np.array([0.0, 0.0, _GOAL - self.distance(axes)]) if down else np.append(aside, 0.0)
                left = float(np.linalg.norm(way))
                if down and left < _REACHED:
                    return 1e-6 * cell.time_us
                cell.set(jog, way / left * np.clip(left / _EASE / 0.25, _LEAST, 1.0))
                run.poll()
                cell.step_to(cell.time_us + cycle_us)
        return np.inf


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", help="mesh of the part on the table, mm")
    part = load_part(parser.parse_args().part, "mm")
    print("| distance at rest, mm | " + " | ".join(f"{share:.3g} %" for share in 100 * np.array(SHARES)) + " |")
    print("| --- |" + " --- |" * len(SHARES))
    times = []
    for arm in CELLS:
        bench = JogBench(arm, part)
        found = [bench.held(share) for share in SHARES]
        cells = [f"{1e3 * one.distance:.1f}{' (stop)' * one.stopped}{one.contact}" for one in found]
        print(f"| {arm} | " + " | ".join(cells) + " |", flush=True)
        times.append(f"{arm}: errors assumed, mm: {bench.terms()}")
        took = " s, ".join(f"{one.rests_after:.1f}" for one in found)
        times.append(f"{arm}: rests after {took} s")
        without, guarded = bench.time_to_part(False), bench.time_to_part(True)
        times.append(f"{arm}: home to 10 mm above the part {without:.2f} s without a guard, {guarded:.2f} s with it")
        bench.simulation.close()
    print("\n".join(times))


if __name__ == "__main__":
    main()
