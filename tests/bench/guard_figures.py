"""Stops of the robot without a guard against their closed forms: ``PYTHONPATH=tests python -m bench.guard_figures``.

Draws ``docs/pictures/guard_age.png`` and prints the table of ``docs/guard.md``, both from runs of the FMU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scancell.cell.driver import Mode, Operation
from scancell.cell.fmu_file import ReusableCell, cell_json
from scancell.cell.instance import CellInstance
from scancell.config.cell import CellDescription
from scancell.geometry.mesh import box_mesh
from scancell.guard.guard import GuardSettings
from scancell.nominal.cell import NominalCell, nominal_cell

Array = NDArray[np.float64]

PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "guard_age.png"
AGE = GuardSettings().max_age
SAMPLE_US = 1000
MOST = 8.0  # s


@dataclass(frozen=True)
class Stop:
    """What joint 1 did from the state on that the last message answers.

    Attributes
    ----------
    age, rate
        (n,), s, and the rate of the path clock there.
    speed
        Before, rad/s.
    travel
        Until the standstill, rad.
    """

    age: Array
    rate: Array
    speed: float
    travel: float


class Bench:
    """The default cell, whose guard falls silent at full speed of joint 1."""

    def __init__(self, cells: ReusableCell, max_age: float = AGE) -> None:
        self.description = CellDescription.default()
        self.nominal: NominalCell = nominal_cell(self.description, box_mesh((0.01, 0.01, 0.01)))
        self._cells, self._max_age = cells, max_age
        self.cycle = 1e-6 * self.description.world.controller_cycle_us
        self.acceleration = float(self.nominal.arm.joints[0].max_acceleration)

    def stop(self, operation: Operation, share: float, silent_from: float) -> Stop:
        """Joint 1 at a share of its full speed, by a move or by hand, silent from an angle (rad) beyond home on."""
        cell = self._cells.start(cell_json(self.description, self.nominal, 0, collision_outputs=False))
        reals = cell.real_group(["truth.q[1]", "controller.rate"])
        time = cell.real_group(["command.guard.time"])
        cell.set(cell.real_group(["command.guard.max_age"]), np.array([self._max_age]))
        begin = self._begin(cell, operation, share)
        answered, rows, before = 0.0, [], 0.0
        for _ in range(round(MOST / self.cycle)):
            if rows[-1:] == [] or rows[-1][1] - begin < silent_from:
                answered = 1e-6 * cell.time_us
                cell.set(time, np.array([answered]))
                before = (rows[-1][1] - rows[-2][1]) / (1e-6 * SAMPLE_US) if len(rows) > 1 else 0.0
            elif not cell.get_boolean("controller.moving"):
                break
            for _ in range(round(1e6 * self.cycle) // SAMPLE_US):
                cell.step_to(cell.time_us + SAMPLE_US)
                rows.append((1e-6 * cell.time_us, *cell.get(reals)))
        times, angles, rates = np.array(rows).T
        since = times >= answered - 1e-9
        return Stop(
            times[since] - answered, rates[since], before, float(angles[-1] - np.interp(answered, times, angles))
        )

    def _begin(self, cell: CellInstance, operation: Operation, share: float) -> float:
        cell.set_integer("command.operation", operation)
        home = np.append(self.nominal.home, 0.0)
        if operation is Operation.MANUAL:
            cell.set_integer("command.mode", Mode.JOINT_JOG)
            cell.set(cell.real_group(["command.jog[1]"]), np.array([share]))
        else:
            cell.set_integer("command.mode", Mode.JOINT_MOVE)
            cell.set(cell.real_group(cell.axis_names("command.")), home + 2.2 * np.eye(len(home))[0])
            cell.set(cell.real_group(["command.speed"]), np.array([share]))
            cell.set_integer("command.start", 1)
        return float(home[0])


def by_hand(bench: Bench, speed: float) -> float:
    """Travel (rad) by hand: on for the age and two cycles, then v²/2a; half a cycle for braking in cycles."""
    return speed * (AGE + 2.5 * bench.cycle) + speed**2 / (2 * bench.acceleration)


def in_program(bench: Bench, speed: float, max_age: float = AGE) -> float:
    """Travel (rad) of a move: docs/fmu/arm.md."""
    if 2 * speed / max_age <= bench.acceleration:
        return speed * (0.75 * max_age + bench.cycle**2 / (4 * max_age))
    return speed * (max_age / 2 + 2 * bench.cycle) + speed**2 / (2 * bench.acceleration)


def table(bench: Bench) -> Iterator[str]:
    yield "| operation | speed (rad/s) | travel (mrad) | closed form, at most | share |"
    yield "| --- | --- | --- | --- | --- |"
    cases: list[tuple[Operation, tuple[float, ...], Callable[[Bench, float], float], float]] = [
        (Operation.MANUAL, (0.25, 0.5, 1.0), by_hand, 0.4),
        (Operation.AUTOMATIC, (0.05, 0.1, 0.2, 0.3), in_program, 0.6),
    ]
    for operation, shares, most, silent_from in cases:
        for share in shares:
            stop = bench.stop(operation, share, silent_from)
            bound = most(bench, stop.speed)
            travel = f"{1e3 * stop.travel:.1f} | {1e3 * bound:.1f} | {stop.travel / bound:.0%}"
            yield f"| {operation.name.lower()} | {stop.speed:.2f} | {travel} |"


def draw(cells: ReusableCell) -> None:
    """Rate against age for two largest ages, with the stated law."""
    plt.style.use("scancell.plots")
    figure, panels = plt.subplots(1, 2, figsize=(10, 3.6), sharey=True)
    for panel, max_age in zip(panels, (0.5, AGE), strict=True):
        bench = Bench(cells, max_age)
        age = np.linspace(0, 1.4 * max_age, 300)
        law = np.clip(2 * (1 - age / max_age), 0, 1)
        panel.plot(1e3 * age, law, "k--", lw=1.2, label="allowed: 2 (1 - age / max_age)")
        for share, colour in ((0.05, "C0"), (0.15, "C1"), (0.3, "C3")):
            stop = bench.stop(Operation.AUTOMATIC, share, 0.6)
            at_most = in_program(bench, stop.speed, max_age)
            text = f"{stop.speed:.2f} rad/s: {1e3 * stop.travel:.0f} mrad, at most {1e3 * at_most:.0f}"
            panel.plot(1e3 * stop.age, stop.rate, color=colour, label=text)
        panel.axvline(1e3 * max_age, color="grey", lw=0.8)
        panel.set(xlabel="age of the answered state (ms)", title=f"max_age {1e3 * max_age:.0f} ms", ylim=(-0.03, 1.08))
        panel.grid()
        panel.legend(loc="lower left")
    panels[0].set_ylabel("rate of the path clock")
    figure.savefig(PICTURE)


def main() -> None:
    with ReusableCell() as cells:
        draw(cells)
        for line in table(Bench(cells)):
            print(line)


if __name__ == "__main__":
    main()
