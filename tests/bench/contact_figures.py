"""Draws and tabulates what contact and grasp do: ``PYTHONPATH=.:tests:tests/fmu python -m bench.contact_figures``.

Writes ``docs/fmu/contact.md`` and ``docs/pictures/grasp.png``.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from cell_fixture import CYCLE_US, Array, CellFmu, FmuFolders, box_part, cell_description, pose
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

DOCS = Path(__file__).parents[2] / "docs"
LOST = 50.0  # mm: the part has left the pads
PGS = {"solver": "pgs", "points": 4, "pairs": []}
NEEDED = MASS * GRAVITY / (2 * PAD_FRICTION)  # N of each finger that hold the weight


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


def onset(folders: FmuFolders, contact: dict[str, Any] | None, tilt: float) -> float:
    """Load at which the part begins to slip over Coulomb's limit, its weight at an angle (rad) to the fingers."""
    start, lifted = (joints_at(np.array([*PLACE, TABLE[2] + z]), np.pi / 2) for z in (0.005, 0.12))
    cell = CellFmu(folders.packed(3, grasp_cell(start, contact))[1])
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
    lifted = joints_at(np.array([*PLACE, TABLE[2] + 0.12]))
    turned = lifted + np.array([np.pi / 2, 0, 0, 0, 0, 0])
    cell = CellFmu(folders.packed(3, grasp_cell())[1])
    grip(cell, 8.0)
    follow(cell, path(OVER_BOX, lifted, 0.8))
    before = part_in_gripper(cell)[:3, 3] * 1e3
    move = path(lifted, turned, duration)
    places = follow(cell, np.concatenate([move, np.tile(turned, (round(1.2 / CYCLE) - len(move), 1))]))
    cell.close()
    return np.arange(1, len(places) + 1) * CYCLE, np.linalg.norm(places - before, axis=1)


def bar(folders: FmuFolders, contact: dict[str, Any]) -> float:
    """Turn (deg) in the grasp, within 0.6 s, of a bar held 50 mm from its centre of mass."""
    cell = grasp_cell(joints_at(np.array([*PLACE, TABLE[2] + 0.09])), contact)
    upright = box_part(0.03, 0.03, 0.15, MASS, fixture="free", friction=1.0)
    cell["parts"] = [{**upright, "support_from_part": pose([*(PLACE - TABLE[:2]), 0])}]
    start = np.array([joint["start"] for joint in cell["robot"]["joints"]])
    fmu = CellFmu(folders.packed(3, cell)[1])
    grip(fmu, 40.0, start)
    lifted = joints_at(np.array([*PLACE, TABLE[2] + 0.19]))
    flat = lifted + np.array([0, 0, 0, 0, 0, 0])
    follow(fmu, path(start, flat, 0.8))
    before = part_in_gripper(fmu)[:3, :3]
    level = flat + np.array([0, 0, 0, 0, np.pi / 3, 0])
    follow(fmu, np.concatenate([path(flat, level, 0.8), np.tile(level, (round(0.6 / CYCLE), 1))]))
    turn = before.T @ part_in_gripper(fmu)[:3, :3]
    fmu.close()
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def step_cost(folders: FmuFolders, description: dict[str, Any], force: float) -> float:
    """Processor time (µs) of a dynamics step, best of five."""
    cell = CellFmu(folders.packed(3, description)[1])
    if force:
        grip(cell, force)
    best = np.inf
    for _ in range(5):
        start = time.process_time()
        cell.step(CYCLE_US * 10, 5)
        best = min(best, (time.process_time() - start) / 800)
    cell.close()
    return best * 1e6


def main() -> None:
    """Measure, draw and write."""
    mpl.use("Agg")
    with tempfile.TemporaryDirectory() as scratch:
        folders = FmuFolders(Path(scratch))
        angles = np.arange(0, 76, 15)
        onsets = {
            name: [onset(folders, c, np.radians(a)) for a in angles] for name, c in (("cone", None), ("PGS", PGS))
        }
        swings = {"smooth move, 0.9 s": swing(folders, 0.9), "jump of the set-points": swing(folders, CYCLE)}
        dantzig = cell_description()["contact"]
        bars = {
            name: bar(folders, contact)
            for name, contact in (("dantzig, 4", dantzig), ("pgs, 4", PGS), ("dantzig, 1", {**dantzig, "points": 1}))
        }
        free = grasp_cell()
        costs = {
            "one free part": step_cost(folders, {**free, "gripper": None}, 0.0),
            "one free part and an open gripper": step_cost(folders, free, 0.0),
            "a part in the gripper, touching the table": step_cost(folders, free, 30.0),
        }
    draw(angles, onsets, swings)
    write(angles, onsets, swings, bars, costs)


def draw(angles: Array, onsets: dict[str, list[float]], swings: dict[str, tuple[Array, Array]]) -> None:
    """The picture of the page."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    left.plot(angles, onsets["cone"], "o-", label="Dantzig with friction cone (default)")
    left.plot(angles, onsets["PGS"], "s--", label="PGS")
    left.axhline(1, color="0.6", lw=1)
    left.set(xlabel="angle between weight and fingers (deg)", ylabel="load at onset of slip / Coulomb limit")
    for name, (times, slip) in swings.items():
        right.semilogy(times, np.where(slip < LOST, np.maximum(slip, 1e-6), np.nan), label=name)
    right.set(xlabel="time (s)", ylabel="displacement in the grasp (mm)", title="a quarter turn, 8 N of each finger")
    for axes in (left, right):
        axes.legend()
        axes.grid(alpha=0.3)
    figure.savefig(DOCS / "pictures/grasp.png", dpi=110)


def write(
    angles: Array,
    onsets: dict[str, list[float]],
    swings: dict[str, tuple[Array, Array]],
    bars: dict[str, float],
    costs: dict[str, float],
) -> None:
    """The page, from its template and the figures."""
    rows = [f"| {a} | {c:.3f} | {p:.3f} |" for a, c, p in zip(angles, onsets["cone"], onsets["PGS"], strict=True)]
    slips = [
        f"| {name} | {slip.max():.2g} | {slip[-1]:.2g} |" if slip[-1] < LOST else f"| {name} | lost | lost |"
        for name, (_, slip) in swings.items()
    ]
    text = (Path(__file__).parent / "contact_page.md").read_text()
    tables = {
        "ONSETS": rows,
        "SWINGS": slips,
        "BARS": [f"| {name} | {turn:.2g} |" for name, turn in bars.items()],
        "COSTS": [f"| {name} | {cost:.0f} |" for name, cost in costs.items()],
    }
    for name, lines in tables.items():
        text = text.replace(f"<{name}>", "\n".join(lines))
    (DOCS / "fmu/contact.md").write_text(text)


if __name__ == "__main__":
    main()
