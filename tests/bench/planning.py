"""Benchmark of path planning: ``python -m bench.planning run`` and ``make`` (PYTHONPATH=tests).

``assets/benchmarks/planning/cases.toml`` holds the cases, see `planning_cases`. ``run`` compares Ray Shooting with the
optimum by dynamic programming, plans every case from home to home, and checks the plans by other means: python-fcl at
every 0.05 degrees of every axis, on the meshes as they are; speed, acceleration, jerk and torque on a grid ten times as
fine as the controller's. ``make`` draws the cases anew from their seeds.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.planning_cases import (
    CLEARANCE,
    PARTS,
    WANTED,
    dense_poses,
    first_contact,
    judge_of,
    make,
    path_of,
    planning_cell,
    read_cases,
)
from scancell.config.cell import CellDescription
from scancell.config.choices import ScanMode
from scancell.config.loading import load_setup
from scancell.config.scan import PathDescription, RasterDescription, ScanDescription, SweepDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import PlanningError
from scancell.planning.model import PlanningCell
from scancell.planning.motion.trajectory import FINER, arm_skeleton, joint_torques, limit_fractions, move
from scancell.planning.options import scan_options
from scancell.planning.path_map.path_planner import PathPlanner
from scancell.planning.path_map.ray_shooting import best_motion, shoot
from scancell.planning.plan import Plan
from scancell.planning.planner import plan
from scancell.planning.views.placement import LIMIT_FRACTION

from .table import cpu_model, replace_paragraphs

Array = NDArray[np.float64]

_BRUTE_STEP = np.radians(0.05)


@dataclass(frozen=True)
class Row:
    """Outcome of one case.

    Costs and shares are those of the branch in which Ray Shooting finds a motion; times are processor times. `planned`:
    whether there is a plan from home to home, or else `cause`. `segments` between its set-points were checked at
    `poses`; `contact` names bodies that python-fcl finds to hit each other. `used` is the largest fraction of a limit.
    """

    name: str
    kind: str
    optimum_solves: bool
    rays_solve: bool
    gap: float
    evaluated: float
    seconds_rays: float
    seconds_optimum: float
    planned: bool
    cause: str
    seconds_plan: float
    segments: int
    poses: int
    contact: str
    used: float
    used_torque: float


def run_case(case: dict[str, Any]) -> Row:
    """Ray Shooting in the branches that may follow the path, the optimum where it finds a motion, the plan, checks."""
    cell = planning_cell(case)
    path, planner = path_of(case, cell), PathPlanner(cell, CLEARANCE)
    start = time.process_time()
    rays = next(((lattice, found) for lattice in planner.lattices(path) if (found := shoot(lattice)) is not None), None)
    middle = time.process_time()
    gap = evaluated = np.nan
    if rays is not None:
        # What Ray Shooting finds is on the lattice of the optimum, which has a motion, too.
        lattice, found = rays
        evaluated = lattice.map.evaluated / lattice.map.quality.size
        middle = time.process_time()
        best = best_motion(lattice)
        gap = np.inf if best is None else found.cost / best.cost - 1
    else:
        best = next((best for lattice in planner.lattices(path) if (best := best_motion(lattice)) is not None), None)
    spent = (middle - start, time.process_time() - middle)
    start = time.process_time()
    description = ScanDescription(
        path=(PathDescription(name=case["name"], **case["path"]),),
        sweep=SweepDescription(enabled=False),
        raster=RasterDescription(enabled=False),
        clearance_mm=1e3 * CLEARANCE,
        max_profiles=100_000,
    )
    cause, checks = "", (0, 0, "", np.nan, np.nan)
    made = None
    try:
        made = plan(cell, scan_options(description, SensorDescription.default()))
    except PlanningError as error:
        cause = str(error)
    seconds = time.process_time() - start
    if made is not None:
        checks = _checked(cell, made)
    return Row(
        case["name"],
        case["kind"],
        best is not None,
        rays is not None,
        gap,
        evaluated,
        spent[0],
        spent[1],
        made is not None,
        cause,
        seconds,
        *checks,
    )


def run_scan(part: str, mode: ScanMode) -> Row:
    """The plan of the default scan of a part, and its checks."""
    cell = planning_cell({"part": part})
    start = time.process_time()
    setup = load_setup()
    made = plan(cell, scan_options(setup.scan.replace(mode=mode), setup.sensor))
    seconds = time.process_time() - start
    checks = _checked(cell, made)
    return Row(f"{part}, {mode}", "scan", False, False, np.nan, np.nan, 0.0, 0.0, True, "", seconds, *checks)


def _checked(cell: PlanningCell, made: Plan) -> tuple[int, int, str, float, float]:
    """Segments, poses, contact, used limits and torques of a plan, see `Row`."""
    motions = [(s.name, s.axes) for s in made.program.segments]
    dense = np.concatenate([dense_poses(points, _BRUTE_STEP) for _, points in motions])
    contact = first_contact(cell, judge_of(cell), dense)
    period = cell.cycle / FINER
    fine = [_resampled(cell, made, name, points) for name, points in motions]
    used = max(float(limit_fractions(points, cell.axis_limits, period).max()) for points in fine)
    segments = sum(len(points) - 1 for _, points in motions)
    torque = motor_torques(load_setup().cell, [points[:, :-1] for points in fine], period).max()
    return segments, len(dense), contact, used, float(torque)


def _resampled(cell: PlanningCell, made: Plan, name: str, points: Array) -> Array:
    """A motion on a grid ten times as fine as the controller's, at rest before and after."""
    period = cell.cycle / FINER
    placed = next((item for item in made.paths if item.view.name == name), None)
    if placed is not None:
        return placed.at(np.arange(-3 * period, placed.run.duration + 4 * period, period))
    line = move(points[0], points[-1], cell.axis_limits.scaled(LIMIT_FRACTION), period)
    return np.concatenate([*3 * [line[:1]], line, *3 * [line[-1:]]])


def motor_torques(cell: CellDescription, motions: list[Array], period: float) -> Array:
    """Largest torque of each motor (joints,) on motions (n, joints), rad, every `period` s, as a share of its limit."""
    drives = [joint.drive for joint in cell.robot.joint if joint.drive is not None]
    rates = [np.gradient(q, period, axis=0) for q in motions]
    acceleration = np.concatenate([np.gradient(rate, period, axis=0) for rate in rates])
    rate = np.concatenate(rates)
    torque = joint_torques(arm_skeleton(cell), np.concatenate(motions), rate, acceleration)
    torque += acceleration * [drive.motor_inertia_kg_m2 for drive in drives]
    torque += np.sign(rate) * [drive.coulomb_friction_n_m for drive in drives]
    torque += rate * [drive.viscous_friction_n_m_s_rad for drive in drives]
    return np.asarray((np.abs(torque) / [drive.max_torque_n_m for drive in drives]).max(0))


def table_of(rows: list[Row], cases: list[dict[str, Any]]) -> Iterator[str]:
    """Markdown table by class."""
    causes = {case["name"]: case.get("cause", "") for case in cases}
    yield (
        "| class | cases | optimum solves | Ray Shooting solves | planned | gap median | gap 95 % | evaluated median |"
        " most | Ray Shooting | optimum |"
    )
    yield "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    for kind in WANTED:
        own = [row for row in rows if row.kind == kind]
        if not own:
            continue
        both = [row for row in own if np.isfinite(row.gap)]
        gap, share = [100 * row.gap for row in both], [100 * row.evaluated for row in both]
        measured = "- | - | - | -"
        if both:
            measured = f"{np.median(gap):.1f} % | {np.percentile(gap, 95):.1f} % | {np.median(share):.1f} %"
            measured += f" | {max(share):.1f} %"
        yield (
            f"| {kind} | {len(own)} | {sum(row.optimum_solves for row in own)} | {sum(row.rays_solve for row in own)} |"
            f" {sum(row.planned for row in own)} | {measured} | {np.median([row.seconds_rays for row in own]):.1f} s |"
            f" {np.median([row.seconds_optimum for row in own]):.1f} s |"
        )
    blocked = [row for row in rows if row.kind == "blocked"]
    right = sum(not row.planned and causes[row.name] in row.cause for row in blocked)
    planned = [row for row in rows if row.planned]
    contacts = [f"{row.name}: {row.contact}" for row in planned if row.contact]
    yield ""
    refused = [f"{row.name}: {row.cause}" for row in rows if row.kind != "blocked" and not row.planned]
    seconds = [row.seconds_plan for row in rows if row.kind in WANTED]
    yield f"- Cases with a motion that are refused: {'; '.join(refused) or 'none'}."
    yield f"- Processor time of a whole plan: {np.median(seconds):.1f} s in the median, at most {max(seconds):.0f} s."
    yield f"- Blocked cases refused with the constraint by which they are blocked: {right} of {len(blocked)}."
    yield (
        f"- {sum(row.segments for row in planned):,} motion segments of {len(planned)} plans, re-checked by python-fcl"
        f" at {sum(row.poses for row in planned):,} poses, 0.05 degrees apart: {len(contacts)} contacts {contacts}."
    )
    yield (
        f"- Largest use of a limit of speed, acceleration or jerk at a tenth of the cycle: "
        f"{max(row.used for row in planned):.3f}; of a motor's torque: {max(row.used_torque for row in planned):.3f}."
    )


def run(workers: int, out: Path, only: int, page: Path | None) -> None:
    """Run the cases, plan scans of the sample parts, and write rows, table and page."""
    cases = read_cases()
    if only:
        cases = cases[:: max(1, len(cases) // only)]
    with ProcessPoolExecutor(workers) as pool:
        rows = [*pool.map(run_case, cases), *pool.map(run_scan, PARTS, len(PARTS) * ["dynamic"])]
        rows += pool.map(run_scan, PARTS, len(PARTS) * ["stop-and-look"])
    out.mkdir(parents=True, exist_ok=True)
    with (out / "rows.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    text = "\n".join(table_of(rows, cases))
    (out / "table.md").write_text(text + "\n")
    print(text)
    if page is not None:
        written = f"Written by `PYTHONPATH=tests python -m bench.planning run --page {page}` on {cpu_model()}."
        table, figures = text.split("\n\n")
        replace_paragraphs(page, {"Written by": [written], "| class |": [table], "- Cases with": [figures]})


def main() -> None:
    """Run or make the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["run", "make"])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", type=int, default=0, help="about this many of the cases")
    parser.add_argument("--out", type=Path, default=Path("out/planning"))
    parser.add_argument("--page", type=Path, help="Markdown page of the documentation")
    options = parser.parse_args()
    if options.what == "make":
        make(options.workers)
    else:
        run(options.workers, options.out, options.only, options.page)


if __name__ == "__main__":
    main()
