"""Measures and draws what drives do to the arm: ``PYTHONPATH=.:tests:tests/fmu python -m bench.arm_figures``.

Replaces the measured tables of ``docs/fmu/arm.md`` and draws ``docs/pictures/arm.png``.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from cell_fixture import CYCLE_US, Array, CellFmu, FmuFolders
from test_fmu_dynamic_arm import (
    START,
    STIFFNESS,
    dynamic_cell,
    gravity_torques,
    inertia_about_joint_1,
    ringing_cell,
    ringing_frequency,
)

from scancell.cell.fmu_file import cell_json
from scancell.config.loading import load_setup
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import nominal_cell

from .table import replace_paragraphs

DOCS = Path(__file__).parents[2] / "docs"


def default_cell(*overrides: str) -> dict[str, Any]:
    """The shipped cell with a block on the table and ideal encoders, as the FMU reads it."""
    setup = load_setup(settings=["cell.collision.outputs=false", *overrides], ideal=True)
    return cell_json(setup.cell, nominal_cell(setup.cell, box_mesh((0.04, 0.03, 0.02))), 0)


def move(cell: CellFmu, target: Array, duration_us: int) -> tuple[Array, Array, Array, Array]:
    """Times (n,), motors, links and torques (n, 6) each millisecond of a joint move at full speed."""
    cell.command(target, mode=2)
    cell.set("command.start", cell.get_int("command.start") + 1)
    rows = []
    for _ in range(duration_us // 1000):
        cell.step(1000)
        rows.append([cell.vector(name, 6) for name in ("measured.q", "truth.q", "measured.torque")])
    motors, links, torques = np.moveaxis(np.array(rows), 1, 0)
    return np.arange(1, len(rows) + 1) * 1e-3, motors, links, torques


def play(folders: FmuFolders, backlash: float) -> float:
    """Deflection (rad) of joint 2 as the load turns round, without what the gear's spring gives way."""
    cell = CellFmu(folders.unpacked(3, dynamic_cell(backlash=backlash, gear_damping=100.0)))
    free = []
    for angle in (-0.5, -2.6):
        target = START.copy()
        target[[1, 2]] = angle, np.pi / 2
        _, motors, links, torques = move(cell, target, 4_800_000)
        free.append(float((links - motors + torques / STIFFNESS)[-1, 1]))
    cell.close()
    return free[0] - free[1]


def sag(folders: FmuFolders) -> tuple[float, float]:
    """Closed form and measured sag (rad) of joint 2 at rest."""
    cell = CellFmu(folders.unpacked(3, dynamic_cell()))
    cell.step(CYCLE_US, 60)
    measured = float((cell.vector("truth.q", 6) - START)[1])
    expected = float((-gravity_torques(cell) / STIFFNESS)[1])
    cell.close()
    return expected, measured


def resonance(folders: FmuFolders, stiffness: float) -> tuple[float, float]:
    """Closed form and measured frequency (Hz) of joint 1 on a soft gear."""
    cell = CellFmu(folders.unpacked(3, ringing_cell(stiffness)))
    expected = float(np.sqrt(stiffness / inertia_about_joint_1(cell)) / (2 * np.pi))
    measured = ringing_frequency(cell)
    cell.close()
    return expected, measured


def weak(folders: FmuFolders) -> tuple[Array, Array, Array, Array]:
    """Times, lag (rad) and torque of joint 2 whose motor has 60 N m, and the greatest torque."""
    cell = CellFmu(folders.unpacked(3, dynamic_cell(max_torque=60.0)))
    strong = CellFmu(folders.unpacked(3, dynamic_cell()))
    target = START.copy()
    target[1] -= 0.6
    times, motors, _, torques = move(cell, target, 1_200_000)
    _, wanted, _, _ = move(strong, target, 1_200_000)
    cell.close()
    strong.close()
    return times, (wanted - motors)[:, 1], torques[:, 1], np.abs(torques).max(0)[1]


def step_cost(folders: FmuFolders, description: dict[str, Any]) -> float:
    """Processor time (µs) of a dynamics step in motion, best of five."""
    cell = CellFmu(folders.unpacked(3, description))
    start = np.array([joint["start"] for joint in description["robot"]["joints"]])
    best = np.inf
    for k in range(5):
        cell.command(start + 0.3 * (-1) ** k, mode=2)
        cell.set("command.start", k + 1)
        before = time.process_time()
        cell.step(CYCLE_US * 10, 5)
        best = min(best, (time.process_time() - before) / 800)
    cell.close()
    return best * 1e6


def main() -> None:
    """Measure, draw and write."""
    plt.style.use("scancell.plots")
    with tempfile.TemporaryDirectory() as scratch:
        folders = FmuFolders(Path(scratch))
        description = default_cell('cell.robot.drive="dynamic"')
        cell = CellFmu(folders.unpacked(3, description))
        start = np.array([joint["start"] for joint in description["robot"]["joints"]])
        moved = move(cell, start + np.radians([40, 20, -20, 30, -30, 60]), 1_000_000)
        cell.close()
        limited = weak(folders)
        plays = {width: play(folders, width) for width in (0.0, 5e-4, 1e-3, 2e-3)}
        sagged = sag(folders)
        rings = resonance(folders, 2e3)
        costs = {"kinematic": step_cost(folders, default_cell()), "dynamic": step_cost(folders, description)}
    closed = [
        "| quantity | closed form | measured |",
        "| --- | --- | --- |",
        f"| sag of joint 2 (µrad): gravity's torque over stiffness | {sagged[0] * 1e6:.3f} | {sagged[1] * 1e6:.3f} |",
        f"| resonance of a gear of 2000 N m/rad (Hz): sqrt(k / J) / 2π | {rings[0]:.4f} | {rings[1]:.4f} |",
        f"| lost motion of 2 mrad of play (mrad) | 2.0000 | {plays[2e-3] * 1e3:.4f} |",
        f"| greatest torque of a motor of 60 N m | 60 | {limited[3]:.6g} |",
    ]
    draw(moved, limited, plays)
    cost_rows = [
        "| drives of the default cell | processor time of a 1 ms step (µs) |",
        "| --- | --- |",
        *(f"| {name} | {cost:.0f} |" for name, cost in costs.items()),
    ]
    replace_paragraphs(DOCS / "fmu/arm.md", {"| quantity |": closed, "| drives of": cost_rows})


def draw(
    moved: tuple[Array, Array, Array, Array], limited: tuple[Array, Array, Array, Array], plays: dict[float, float]
) -> None:
    """The picture of the page."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 3.8))
    times, motors, links, _ = moved
    left.plot(times, (links - motors) * 1e6, label=[f"joint {i}" for i in range(1, 7)])
    left.set(xlabel="time (s)", ylabel="link - motor (µrad)", title="a move with the default drives")
    left.legend(ncols=2)
    middle.plot(limited[0], limited[2], label="torque (N m)")
    middle.plot(limited[0], np.degrees(limited[1]) * 10, label="lag (0.1 deg)")
    middle.set(xlabel="time (s)", title="joint 2, motor of 60 N m")
    middle.legend()
    widths = np.array(list(plays))
    right.plot(widths * 1e3, widths * 1e3, color="0.6", label="as described")
    right.plot(widths * 1e3, np.array(list(plays.values())) * 1e3, "o", label="measured")
    right.set(xlabel="backlash (mrad)", ylabel="lost motion (mrad)", title="the load turns round")
    right.legend()
    for axes in (left, middle, right):
        axes.grid()
    figure.savefig(DOCS / "pictures/arm.png")


if __name__ == "__main__":
    main()
