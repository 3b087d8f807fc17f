"""Draws and tabulates what contact and grasp do: ``PYTHONPATH=.:tests:tests/fmu python -m bench.contact_figures``.

Replaces the measured tables of ``docs/fmu/contact.md``, prints the creep of a soft part and draws
``docs/pictures/grasp.png``. Needs the native tests built (``make native-tests``).
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from cell_fixture import CYCLE_US, Array, CellFmu, FmuFolders
from grasp_fixture import (
    CYCLE,
    GRAVITY,
    MASS,
    OVER_BOX,
    PAD_FRICTION,
    PLACE,
    TABLE,
    grasp_cell,
    grip,
    joints_at,
    part_in_gripper,
    smooth,
)

from .table import replace_paragraphs

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LOST = 50.0  # mm: the part has left the pads
SOFT = {"stiffness": 800.0, "damping_ratio": 1.0, "longest_edge": 0.02}
NEEDED = MASS * GRAVITY / (2 * PAD_FRICTION)  # N of each finger that hold the weight
LIFTED = joints_at(np.array([*PLACE, TABLE[2] + 0.12]))
NAMES = {"cone": "Dantzig with cone (default)", "stock": "stock DART (Dantzig, pyramid)", "pgs": "PGS"}
HEADS = (
    "| angle (deg) | floor | floor, stock DART | grasp | grasp, stock DART | grasp, PGS | FMU |",
    "| move | largest displacement (mm) | afterwards (mm) |",
    "| solver | slip of the cube (mm) | rotation of the bar (deg), 4 points per pad | the same, 1 point per pad"
    " | fall of the stack (mm) |",
    "| cell | processor time of a 1 ms step (µs) |",
)
LINES = {"cone": "-", "stock": "--", "pgs": ":"}


def native_cases() -> dict[str, Any]:
    """What the native program finds: the same worlds with one solver or another."""
    built = sorted(ROOT.glob("build/*/tests/fmu/robotcell-contact-cases"))
    if not built:
        raise SystemExit("robotcell-contact-cases is not built: make native-tests")
    found: dict[str, Any] = json.loads(subprocess.run([built[-1]], check=True, capture_output=True).stdout)
    return found


def path(start: Array, end: Array, duration: float) -> Array:
    """Set-points (n, 6) of a smooth move."""
    cycles = round(duration / CYCLE)
    return np.asarray(start + smooth(np.arange(1, cycles + 1) / cycles)[:, None] * (end - start))


def follow(cell: CellFmu, setpoints: Array) -> Array:
    """Positions (n, 3) of the part in the gripper, mm, after every cycle."""
    places = []
    for q in setpoints:
        cell.command(q)
        cell.step(CYCLE_US)
        places.append(part_in_gripper(cell)[:3, 3] * 1e3)
    return np.array(places)


def onset(folders: FmuFolders, tilt: float) -> float:
    """Load at which the part in the FMU begins to slip over Coulomb's limit, its weight at an angle (rad)."""
    start, lifted = (joints_at(np.array([*PLACE, TABLE[2] + z]), np.pi / 2) for z in (0.005, 0.12))
    cell = CellFmu(folders.unpacked(3, grasp_cell(start)))
    grip(cell, 50.0, start)
    tilted = lifted + np.array([0, 0, 0, 0, tilt, 0])
    follow(cell, np.concatenate([path(start, lifted, 0.8), path(lifted, tilted, 0.8)]))
    before, state, time_us = part_in_gripper(cell), cell.save(), cell.time_us
    low, high = 0.9, 1.6
    while high - low > 0.002:
        share = (low + high) / 2
        cell.restore(state, time_us)
        grip(cell, NEEDED / share, tilted)
        slips = np.linalg.norm((part_in_gripper(cell) - before)[:3, 3]) > 1e-3
        low, high = (low, share) if slips else (share, high)
    cell.free_state(state)
    cell.close()
    return (low + high) / 2


def swing(folders: FmuFolders, duration: float) -> tuple[Array, Array]:
    """Times (n,) and slip (n,) in mm of a part while the arm turns a quarter within a duration."""
    turned = LIFTED + np.array([np.pi / 2, 0, 0, 0, 0, 0])
    description = grasp_cell()
    description["robot"]["joints"][0]["max_acceleration"] = 50.0
    cell = CellFmu(folders.unpacked(3, description))
    grip(cell, 8.0)
    follow(cell, path(OVER_BOX, LIFTED, 0.8))
    before = part_in_gripper(cell)[:3, 3] * 1e3
    move = path(LIFTED, turned, duration)
    places = follow(cell, np.concatenate([move, np.tile(turned, (round(1.2 / CYCLE) - len(move), 1))]))
    cell.close()
    return np.arange(1, len(places) + 1) * CYCLE, np.linalg.norm(places - before, axis=1)


def step_cost(cell: CellFmu) -> float:
    """Processor time (µs) of a dynamics step, best of five."""
    best = np.inf
    for _ in range(5):
        start = time.process_time()
        cell.step(CYCLE_US * 10, 5)
        best = min(best, (time.process_time() - start) / 800)
    return best * 1e6


def lifted_soft_part(folders: FmuFolders) -> tuple[float, float]:
    """Creep (µm/s) of a soft part in the gripper, and processor time (µs) of a step."""
    cell = CellFmu(folders.unpacked(3, grasp_cell(soft=SOFT)))
    grip(cell, 10.0)
    places = follow(cell, np.concatenate([path(OVER_BOX, LIFTED, 0.8), np.tile(LIFTED, (200, 1))]))
    creep = np.linalg.norm(places[-1] - places[-63]) * 1e3 / (62 * CYCLE)
    cost = step_cost(cell)
    cell.close()
    return float(creep), cost


def costs(folders: FmuFolders) -> dict[str, float]:
    """Processor time (µs) of a step of several cells."""
    free = grasp_cell()
    found = {}
    for name, description, force in (
        ("one free part", {**free, "gripper": None}, 0.0),
        ("one free part and an open gripper", free, 0.0),
        ("a part in the gripper, touching the table", free, 30.0),
        ("the same part, soft", grasp_cell(soft=SOFT), 10.0),
    ):
        cell = CellFmu(folders.unpacked(3, description))
        if force:
            grip(cell, force)
        found[name] = step_cost(cell)
        cell.close()
    return found


def main() -> None:
    """Measure, draw and write."""
    plt.style.use("scancell.plots")
    cases = native_cases()
    with tempfile.TemporaryDirectory() as scratch:
        folders = FmuFolders(Path(scratch))
        in_fmu = [onset(folders, np.radians(angle)) for angle in range(0, 76, 15)]
        swings = {"smooth move, 0.9 s": swing(folders, 0.9), "jump of the set-points": swing(folders, CYCLE)}
        creep, lifted_cost = lifted_soft_part(folders)
        cost = {**costs(folders), "the soft part, lifted": lifted_cost}
    draw(cases, swings)
    rows = (
        onset_rows(cases, in_fmu),
        [swing_row(name, slip) for name, (_, slip) in swings.items()],
        [solver_row(cases, name) for name in NAMES],
        [f"| {name} | {value:.0f} |" for name, value in cost.items()],
    )
    tables = {
        head: [head, "| --- " * (head.count("|") - 1) + "|", *lines] for head, lines in zip(HEADS, rows, strict=True)
    }
    replace_paragraphs(DOCS / "fmu/contact.md", tables)
    print(f"creep of a soft part in the gripper: {creep:.1f} µm/s")


def onset_rows(cases: dict[str, Any], in_fmu: list[float]) -> list[str]:
    """One row for each direction."""
    floor, grasp = cases["floor"], cases["grasp"]
    rows = []
    for i, angle in enumerate(range(0, 91, 15)):
        native = [floor["cone"][i], floor["stock"][i], grasp["cone"][i], grasp["stock"][i], grasp["pgs"][i]]
        fmu = f"{in_fmu[i]:.3f}" if i < len(in_fmu) else "–"
        rows.append(f"| {angle} | " + " | ".join(f"{value:.3f}" for value in native) + f" | {fmu} |")
    return rows


def swing_row(name: str, slip: Array) -> str:
    """Greatest displacement, and what is left of it."""
    return f"| {name} | {slip.max():.2g} | {slip[-1]:.2g} |" if slip[-1] < LOST else f"| {name} | lost | lost |"


def solver_row(cases: dict[str, Any], solver: str) -> str:
    """Slip, turn of the bar with four points and with one for each pad, fall of the stack."""
    bar, stack = cases["bar"][solver], cases["stack"][solver]
    turns = " | ".join(f"{np.degrees(bar[points][-1]):.2g}" for points in ("4", "1"))
    slip, fall = cases["slip"][solver][-1] * 1e3, abs(stack[0] - stack[-1]) * 1e3
    return f"| {NAMES[solver]} | {slip:.2g} | {turns} | {fall:.2f} |"


def draw(cases: dict[str, Any], swings: dict[str, tuple[Array, Array]]) -> None:
    """The picture of the page."""
    figure, ((onsets, moves), (bars, stacks)) = plt.subplots(2, 2, figsize=(11, 7.4))
    angles = np.linspace(0, 90, len(cases["grasp"]["cone"]))
    for solver, label in NAMES.items():
        onsets.plot(angles, cases["grasp"][solver], "o" + LINES[solver], label=label)
    onsets.set(xlabel="direction in the plane of the pads (deg)", ylabel="onset of slip / Coulomb's limit")
    onsets.set(title="a part between the pads", ylim=(0, 1.6), xticks=angles)
    for name, (times, slip) in swings.items():
        moves.semilogy(times, np.maximum(slip, 1e-5), label=name)
    moves.set(xlabel="time (s)", ylabel="displacement in the grasp (mm)", title="a quarter turn, 8 N of each finger")
    moves.axhline(LOST, color="0.6", lw=1)
    moves.text(1.2, LOST / 2, "it has left the pads above", ha="right", va="center", size="small", color="0.4")
    for solver, points in (("cone", "4"), ("pgs", "4"), ("cone", "1")):
        turns = np.maximum(np.degrees(cases["bar"][solver][points]), 1e-6)
        times = np.arange(1, len(turns) + 1) * cases["time_step"]
        bars.semilogy(times, turns, LINES[solver], label=f"{NAMES[solver]}, {points} point{'s' * (points > '1')} a pad")
    bars.set(xlabel="time (s)", ylabel="turn in the grasp (deg)", title="a bar held 50 mm from its centre of mass")
    bars.set(ylim=(1e-6, 1e5))
    for solver, label in NAMES.items():
        times = np.arange(1, len(cases["stack"][solver]) + 1) * cases["time_step"]
        stacks.plot(times, np.array(cases["stack"][solver]) * 1e3, LINES[solver], label=label)
    stacks.set(xlabel="time (s)", ylabel="height of the topmost (mm)", title="six boxes, the upper the heavier", ylim=0)
    for axes in (onsets, moves, bars, stacks):
        axes.legend()
        axes.grid()
    figure.savefig(DOCS / "pictures/grasp.png")


if __name__ == "__main__":
    main()
