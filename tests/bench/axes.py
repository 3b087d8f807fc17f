"""Coverage and time of plans whose axes beside joints and table rest at chosen positions, against those at the start.

``PYTHONPATH=tests python -m bench.axes`` plans sweeps and passes over sample parts; ``--coverage`` views chosen by
coverage, which takes minutes each. ``--two 6`` compares the search over two axes that move along a sensor path
with the optimum over both on a coarse lattice.
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path

import numpy as np

from scancell import PlanningError, Scanner, assets_dir, load_part, load_setup, nominal_cell
from scancell.config.scan import PathDescription, WaypointDescription
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.geometry.pose import translation
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.path_map import path_planner, table_motion
from scancell.planning.path_map.table_motion import Lattice
from scancell.planning.views.sensor_paths import SensorPath, sensor_paths
from scancell.scanning.world import make_sensor

_ROWS = 72  # of the maps of both axes in the comparison with the optimum
PARTS = ("sphere_on_foot", "free_form", "machined", "step_block")
TILT = 'scan.axis=[{ name = "tilt", step_deg = 30 }]'
TRACK = 'scan.axis=[{ name = "track", step_mm = 200 }]'
EDGE = ('cell.axis[1].along="y"', "cell.axis[1].pose.x_mm=800")  # of the reach; the tilt leads towards the arm
CELLS = (
    ("table", "default", (), ""),
    ("held part", "held_part", (), ""),
    ("tilt-turn", "tilt_turn", (), TILT),
    ("tilt-turn at the edge of the reach", "tilt_turn", EDGE, TILT),
    ("track, table 750 mm beside the arm", "track", ("cell.table.pose.y_mm=750",), TRACK),
)


def long_bar() -> Mesh:
    """A bar longer than the reach of the arm, 560 x 60 x 20 mm."""
    return box_mesh((0.56, 0.06, 0.02), "bar of 560 mm").transformed(translation((0, 0, 0.01)))


def row(name: str, cell: str, words: tuple[str, ...], part: Path | Mesh) -> None:
    """Print a row of the table: coverage and time of the motion, and how many positions of the axis are used."""
    setup = load_setup(assets_dir() / f"cells/{cell}.toml", settings=["scan.max_lost_share=1", *words])
    with Scanner(setup=setup) as scanner:
        try:
            plan = scanner.plan(part)
        except PlanningError as error:
            print(f"| {name} | - | - | - | {str(error)[:80]}", flush=True)
            return
    positions = {tuple(at) for at in plan.axes[:, len(plan.program.start) :].round(6)}
    seen = plan.coverage or 0.0
    if plan.report is not None:
        seen = plan.report.share * plan.report.measurable_area / scanner_area(part)
    omitted = sum(text.startswith("omitted") for text in plan.warnings)
    print(f"| {name} | {100 * seen:.1f} % | {plan.program.duration:.1f} s | {len(positions)} | {omitted} |", flush=True)


def scanner_area(part: Path | Mesh) -> float:
    """Area of the surface of a part, m²."""
    return float((part if isinstance(part, Mesh) else load_part(part)).areas.sum())


def table(coverage: bool) -> None:
    """Print the table of all cells and parts."""
    more = ("scan.coverage.enabled=true",) if coverage else ()
    print("| cell, part | surface seen | time | positions | views omitted |\n| --- | --- | --- | --- | --- |")
    for name, cell, words, axis in CELLS:
        for part, chosen in product(PARTS, ((), (axis,)) if axis else ((),)):
            how = ", chosen" if chosen else ", at the start" if axis else ""
            row(f"{name}, {part}{how}", cell, (*words, *chosen, *more), assets_dir() / f"parts/{part}.stl")
    wide = ("cell.table.radius_mm=300", "cell.table.pose.y_mm=300", "scan.sweep.enabled=false")
    for chosen in ((), (TRACK,)):
        how = "chosen" if chosen else "at the start"
        row(f"track, bar of 560 mm, {how}", "track", (*wide, *chosen, *more), long_bar())


def two_axes(cases: int) -> None:
    """Print the cost that the search over table and tilt finds, and the optimum of both, on one coarse lattice."""
    table_motion._LEVELS, table_motion._LEAST_SPEEDS, path_planner._ROWS = 1, 2, _ROWS
    setup = load_setup(assets_dir() / "cells/tilt_turn.toml")
    sensor_range = SensorRange.of(make_sensor(setup.sensor, 0))
    rng = np.random.default_rng(5)
    print("| case | table alone | search over both | optimum of both | gap |\n| --- | --- | --- | --- | --- |")
    for number in range(1, cases + 1):
        part = box_mesh((0.05, 0.04, 0.03)).transformed(translation((0, 0, 0.015)))
        cell = PlanningCell(nominal_cell(setup.cell, part), sensor_range, 0.016)
        points = [
            WaypointDescription(
                x_mm=x,
                y_mm=y,
                z_mm=30,
                azimuth_deg=azimuth,
                elevation_deg=rng.uniform(35, 80),
                roll_deg=rng.uniform(0, 90),
            )
            for x, y, azimuth in ((-20, -10, rng.uniform(-180, 180)), (20, 10, rng.uniform(-180, 180)))
        ]
        points[1] = points[1].model_copy(update={"azimuth_deg": points[0].azimuth_deg + rng.uniform(-60, 60)})
        described = PathDescription(waypoint=points, speed_mm_s=25.0, axis=("table", "tilt"))
        (path,) = sensor_paths(described, part, cell.nominal.table_from_part)
        planner, nominal = path_planner.PathPlanner(cell, 0.005), cell.nominal
        (tilt,) = nominal.further_axes
        grid = np.unique([*np.linspace(tilt.min, tilt.max, 7), 0.0])
        found = planner.place_by_two(path, "tilt", [np.array([0.0, at]) for at in grid])
        alone = planner.place_by_two(path, "tilt", [np.array([0.0, 0.0])]) if isinstance(found, str) else None
        if isinstance(found, str):
            print(f"| {number} | {found} | {alone} |", flush=True)
            continue
        timing = planner._timing(path, path.speed)
        held = planner._placed_at(path, timing, planner._drive("table", path_planner._resting(np.zeros(2)), timing))
        best = _joint_optimum(planner, path, timing, found)
        first = "-" if isinstance(held, str) else f"{held.cost:.3f}"
        print(
            f"| {number} | {first} | {found.cost:.3f} | {best:.3f} | {100 * (found.cost / best - 1):.1f} % |",
            flush=True,
        )


def _joint_optimum(
    planner: path_planner.PathPlanner, path: SensorPath, timing: path_planner._Timing, found: path_planner.PlacedPath
) -> float:
    """Least cost (dynamic programming) of motions of both axes in the branch found; no limit of joint speeds."""
    drive = planner._drive("tilt", path_planner._resting(np.zeros(2)), timing)
    tilts = drive.low + drive.span / _ROWS * np.arange(_ROWS)
    quality = np.zeros((len(timing.columns), _ROWS, _ROWS), np.float32)
    for row, at in enumerate(tilts):
        if at <= drive.high:
            one = planner._drive("table", path_planner._resting(np.array([0.0, at])), timing)
            (lattice,) = planner._lattices(path, timing, one, [found.lattice.map.branch])
            lattice.map.require_all()
            quality[:, :, row] = lattice.map.quality
    with np.errstate(divide="ignore"):
        cost_of = 1.0 / quality - 1.0
    (other,) = planner._lattices(path, timing, drive, [found.lattice.map.branch])
    both = lattice, other
    moves = [
        [
            (rate, by)
            for rate, by in product(range(-one.rates, one.rates + 1), range(-one.accelerations, one.accelerations + 1))
            if abs(rate + by) <= one.rates
        ]
        for one in both
    ]
    shape = (2 * lattice.rates + 1, 2 * other.rates + 1, lattice.angles, other.angles)
    reached = np.full(shape, np.inf)
    rows = [one.row(np.arange(one.angles)) for one in both]
    start = np.where(np.isfinite(cost_of[0][rows[0]][:, rows[1]]), 0.0, np.inf)
    reached[lattice.rates, other.rates] = start
    for step in range(lattice.steps):
        after = np.full(shape, np.inf)
        for (rate, by), (rate_2, by_2) in product(*moves):
            before = reached[rate + lattice.rates, rate_2 + other.rates]
            if not np.isfinite(before).any():
                continue
            column, row, speed = lattice.cells(step, np.arange(lattice.angles), rate, by)
            _, row_2, speed_2 = other.cells(step, np.arange(other.angles), rate_2, by_2)
            of_cells = np.mean(
                [cost_of[column[0, s]][row[:, s]][:, row_2[:, s]] for s in range(lattice.samples)], axis=0
            )
            effort = _effort(lattice, speed[0], by) + _effort(other, speed_2[0], by_2)
            total = np.roll(before + of_cells + effort, (2 * rate + by, 2 * rate_2 + by_2), (0, 1))
            target = after[rate + by + lattice.rates, rate_2 + by_2 + other.rates]
            np.minimum(target, total, out=target)
        reached = after
    return float(reached[lattice.rates, other.rates].min() / lattice.steps)


def _effort(lattice: Lattice, speed: np.ndarray, acceleration: int) -> float:
    share = acceleration * lattice._quantum / lattice._max_acceleration
    of_speed = lattice.weights.table_speed * float(((speed / lattice._max_rate) ** 2).mean())
    return of_speed + lattice.weights.table_acceleration * share**2


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--coverage", action="store_true")
    parser.add_argument("--two", type=int, metavar="CASES")
    given = parser.parse_args()
    if given.two:
        two_axes(given.two)
    else:
        table(given.coverage)
