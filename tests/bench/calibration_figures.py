"""Accuracy of calibration from synthetic profiles: ``PYTHONPATH=tests python -m bench.calibration_figures``.

Prints the tables of ``docs/calibration.md`` and draws ``docs/pictures/calibration_poses.png``.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from belt_profiles import BELT, calibrated
from benchmarks.sphere_cell import (
    LARGE,
    REALISTIC,
    SMALL,
    RobotErrors,
    Sizes,
    SphereCase,
    joined,
    misaligned,
    passing_sphere,
    sphere_views,
)
from scancell import CalibrationRequest
from scancell.calibration.cell.kinematics import (
    LATENCY,
    PLATTER,
    TABLE,
    TOOL,
    AxisReadings,
    axis_deviations,
    written_unit,
)
from scancell.calibration.cell.report import ExchangedSensor
from scancell.calibration.cell.scan import CalibrationScan, kinematics_of, observations_of
from scancell.calibration.cell.solve import solve
from scancell.calibration.cell.views import design_poses
from scancell.config.choices import CalibrationTarget
from scancell.config.loading import assets_dir, load_setup
from scancell.nominal.cell import NominalCell, estimated_cell, nominal_cell
from scancell.nominal.parts import load_part
from scancell.scanning.pipeline import ScanPipeline

Array = NDArray[np.float64]

PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "calibration_poses.png"
ALL = (*TOOL, *TABLE, *PLATTER, LATENCY)
POSES, PASSES, PER_PASS, SPEED = 24, 6, 15, 0.05
CANDIDATES = 600
ROBOTS = {"perfect": RobotErrors(), "realistic": REALISTIC}


@dataclass(frozen=True)
class Trial:
    """Errors (p,), SI, of a calibration, 95 % half widths (p,), and whether the joint region contains the truth."""

    errors: Array
    half_widths: Array
    is_inside: bool


def calibrate(
    readings: AxisReadings, robot: RobotErrors, free: tuple[str, ...], known: bool, seed: int, sizes: Sizes = SMALL
) -> Trial:
    """A calibration with random deviations up to `sizes`; `known` is whether the pose of the sphere is."""
    rng = np.random.default_rng([seed, 1])
    case = SphereCase(misaligned(rng, *free, sizes=sizes), robot)
    result = solve(case.problem(case.observe(readings, rng), free, is_pose_known=known))
    true = np.array([case.deviations[name] for name in free])
    return Trial(result.values - true, result.half_widths(), result.contains(true))


def everything(robot: RobotErrors, seed: int, sizes: Sizes = SMALL) -> Trial:
    """Tool, table, eccentricity and latency, from poses at rest and passes in motion."""
    rng = np.random.default_rng([seed, 2])
    still = AxisReadings.at_rest(sphere_views(rng, POSES))
    return calibrate(joined(still, passing_sphere(rng, PASSES, PER_PASS, SPEED)), robot, ALL, True, seed, sizes)


def at_rest(robot: RobotErrors, seed: int) -> Trial:
    """Tool and table from poses at rest; where the sphere is is not known."""
    rng = np.random.default_rng([seed, 3])
    return calibrate(AxisReadings.at_rest(sphere_views(rng, POSES)), robot, TOOL + TABLE, False, seed)


def with_poses(designed: bool, counts: Sequence[int], seed: int) -> Array:
    """Errors (counts, p) of tool and table by a realistic robot, from random poses or designed ones."""
    rng = np.random.default_rng([seed, 4])
    readings = AxisReadings.at_rest(sphere_views(rng, CANDIDATES))
    rows = np.arange(CANDIDATES)
    if designed:
        exact = SphereCase(noise=0.0)
        candidates = exact.problem(exact.observe(readings, rng), TOOL + TABLE, placed_off=(0.0, 0.0, 0.0))
        noise = np.log([1.0, REALISTIC.position**2, REALISTIC.orientation**2])
        rows = design_poses(candidates, noise, max(counts)).rows
    trials = [calibrate(readings.rows(rows[:n]), REALISTIC, TOOL + TABLE, False, seed) for n in counts]
    return np.array([trial.errors for trial in trials])


# Positions of the axes of sample cells, m and rad, at which the sphere is measured.
AXES = {"track": (-0.25, -0.1, 0.05, 0.2), "tilt_turn": (-0.6, -0.2, 0.2, 0.6)}


@cache
def cell_with_axis(name: str) -> NominalCell:
    return nominal_cell(load_setup(assets_dir() / "cells" / f"{name}.toml").cell, None)


def of_axis(name: str, seed: int) -> Trial:
    """Tool, and deviations of the axis of a cell, from poses at rest at four of its positions; the sphere is known."""
    rng, cell = np.random.default_rng([seed, 5]), cell_with_axis(name)
    kinematics, (axis,) = kinematics_of(cell), cell.further_axes
    each = POSES // len(AXES[name])
    views = [sphere_views(rng, each, cell=cell.with_axes_held([at])) for at in AXES[name]]
    axes = np.hstack([np.concatenate(views), np.repeat(AXES[name], each)[:, None]])
    free = (*TOOL, *axis_deviations(axis.name))
    case = SphereCase(misaligned(rng, *free), REALISTIC, kinematics=kinematics)
    observed = case.observe(AxisReadings.at_rest(axes, kinematics.further), rng)
    result = solve(case.problem(observed, free, is_pose_known=True))
    true = np.array([case.deviations[key] for key in free])
    return Trial(result.values - true, result.half_widths(), result.contains(true))


def axis_rows(seeds: int, workers: int) -> Iterator[str]:
    """Medians and coverage of deviations of axes, as lines of a table."""
    yield "| cell | tool | axis | values | in their 95 % intervals | regions that contain the truth |"
    yield "|---|---|---|---|---|---|"
    inside, count = 0, 0
    for name in AXES:
        trials = run_all(partial(of_axis, name), seeds, workers)
        errors, half = (np.array([getattr(one, key) for one in trials]) for key in ("errors", "half_widths"))
        free = (*TOOL, *axis_deviations(cell_with_axis(name).further_axes[0].name))
        cells = [
            f"{1e3 * np.median(length(errors, free, group, 'mm')):.2f} um / "
            f"{np.median(length(errors, free, group, 'deg')):.5f} deg"
            for group in ("tool.", "axis.")
        ]
        covered = np.abs(errors) <= half
        inside, count = inside + int(covered.sum()), count + covered.size
        regions = np.mean([one.is_inside for one in trials])
        yield f"| `{name}` | {' | '.join(cells)} | {covered.size} | {covered.mean():.1%} | {regions:.1%} |"
    yield f"| all | | | {count} | {inside / count:.1%} | |"


# Cells, calibrations and further sensors whose unknowns are found from profiles by ideal rays, with noise.
HELD = {"tool": ("held_part", "tool", None), "grasp": ("held_part", "grasp", None)}
CASES = HELD | {"post": ("two_sensors", "tool", "post")}
# The sheet of the sensor on the post is as described: that of the preset is curved by what a calibration leaves.
STRAIGHT = {"cell.further_sensor[1].sensor.laser.straightness_mrad": []}
DESIGNS = 4  # of poses
THINNED = 12  # of so many points one is used
FINE = 0.2e-6  # m, and m per 100 mm of angles and scales: narrower intervals are reported apart


@cache
def still_case(cell: str, what: CalibrationTarget, further: str | None, design: int) -> tuple[CalibrationScan, Array]:
    """A calibration in a described cell, and positions (n, axes) of its exposures."""
    setup = load_setup(assets_dir() / "cells" / f"{cell}.toml", settings=STRAIGHT if further else {})
    setup = setup if further is None else ExchangedSensor.of(setup, further).exchanged
    request, pipeline = CalibrationRequest(what), ScanPipeline(threads=1)
    world = pipeline.load(setup, load_part(assets_dir() / request.artefact_in(setup.cell)))
    scan = CalibrationScan(pipeline, world, request, {})
    return scan, scan.still_poses(np.random.default_rng([design, 6]))


def of_case(case: tuple[str, CalibrationTarget, str | None], seed: int) -> Trial:
    """Deviations up to 0.4 mm and 0.2 deg, with a realistic robot, or errors of the table's angle where it rests."""
    rng = np.random.default_rng([seed, 8])
    scan, axes = still_case(*case, seed % DESIGNS)
    world, nominal, count = replace(scan.world, seed=seed), scan.world.nominal, len(axes)
    free, joints = scan.request.free(), len(nominal.home)
    true = rng.uniform(-1, 1, 6) * np.repeat([4e-4, np.radians(0.2)], 3)
    moved = nominal.with_further_axes(axes)
    if nominal.arm_rests:
        moved[:, joints] += REALISTIC.orientation * rng.normal(size=count)
    else:
        twist = rng.normal(size=(count, 6)) * np.repeat([REALISTIC.position, REALISTIC.orientation], 3)
        moved[:, :joints] += np.linalg.solve(nominal.arm.jacobian(axes[:, :joints]), twist[..., None])[..., 0]
    built = estimated_cell(nominal, dict(zip(free, true.tolist(), strict=True)))
    number, once = np.arange(count, dtype=np.int64), np.array([[0.0, world.sensor.exposure]])
    sensed = world.expose_at_rest(built.frame_poses(moved), number, once, "geometric", threads=1)
    kinematics = kinematics_of(nominal)
    readings = AxisReadings.at_rest(nominal.with_further_axes(axes), kinematics.further)
    observed = observations_of(sensed.points, readings, world.sensor)
    result = solve(scan.problem(observed.chosen(np.arange(len(observed.sigma)) % THINNED == 0)))
    return Trial(result.values - true, result.half_widths(), result.contains(true))


def of_belt(seed: int) -> Trial:
    """Direction and encoder scale of a belt, which are off by up to 1 deg and 1 %, by a part that it carries."""
    rng = np.random.default_rng([seed, 7])
    sizes = rng.uniform(0.1, 1.0, 3) * rng.choice([-1.0, 1.0], 3) * [np.radians(1.0), np.radians(1.0), 0.01]
    result = calibrated(dict(zip(BELT, sizes.tolist(), strict=True)), seed)
    return Trial(result.values - sizes, result.half_widths(), result.contains(sizes))


def unknown_rows(work: partial[Trial], free: Sequence[str], seeds: int, workers: int) -> Iterator[str]:
    """Medians and coverage of deviations, as lines of a table."""
    trials = run_all(work, seeds, workers)
    errors, half = (np.array([getattr(one, key) for one in trials]) for key in ("errors", "half_widths"))
    units = [written_unit(name) for name in free]
    fine = half < np.array([FINE if unit == "mm" else 10 * FINE for unit, _ in units])
    inside = np.abs(errors) <= half
    yield "| deviation | median error | in its 95 % interval |"
    yield "|---|---|---|"
    for number, (name, (unit, scale)) in enumerate(zip(free, units, strict=True)):
        yield f"| {name} | {np.median(np.abs(errors[:, number])) / scale:.5f} {unit} | {inside[:, number].mean():.1%} |"
    regions = np.mean([one.is_inside for one in trials])
    counted = ", ".join(
        f"{inside[rows].sum()} of {rows.sum()} {which}" for rows, which in ((~fine, "values"), (fine, "below 0.2 um"))
    )
    yield f"| all: {counted} | regions: {regions:.1%} | {inside.mean():.1%} |"


def run_all(work: partial[Trial], seeds: int, workers: int) -> list[Trial]:
    """Trials of all seeds."""
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(work, range(seeds), chunksize=5))


def length(errors: Array, names: Sequence[str], group: str, unit: str) -> Array:
    """Length (n,) of the part of errors (n, p) that belongs to a group, in a unit."""
    chosen = [i for i, name in enumerate(names) if name.startswith(group) and written_unit(name)[0] == unit]
    return np.asarray(np.linalg.norm(errors[:, chosen], axis=1) / written_unit(names[chosen[0]])[1])


def accuracy_rows(seeds: int, workers: int) -> Iterator[str]:
    """Medians, as lines of a table."""
    yield "| robot | unknowns | tool | table axis | eccentricity | latency |"
    yield "|---|---|---|---|---|---|"
    for name, robot in ROBOTS.items():
        for work, free in ((everything, ALL), (at_rest, TOOL + TABLE)):
            errors = np.array([trial.errors for trial in run_all(partial(work, robot), seeds, workers)])
            cells = [
                f"{1e3 * np.median(length(errors, free, group, 'mm')):.2f} um / "
                f"{np.median(length(errors, free, group, 'deg')):.5f} deg"
                for group in ("tool.", "table.")
            ]
            cells.append(
                f"{1e3 * np.median(length(errors, free, 'platter.', 'mm')):.2f} um" if work is everything else ""
            )
            cells.append(f"{np.median(length(errors, free, LATENCY, 'ms')):.4f} ms" if work is everything else "")
            yield f"| {name} | {len(free)} | {' | '.join(cells)} |"


def coverage_rows(seeds: int, workers: int, sizes: Sizes) -> Iterator[str]:
    """How often intervals and regions of 95 % contain the truth, as lines of a table."""
    trials = {name: run_all(partial(everything, robot, sizes=sizes), seeds, workers) for name, robot in ROBOTS.items()}
    yield "| unknown | " + " | ".join(f"{name} robot" for name in trials) + " |"
    yield "|---|" + "---|" * len(trials)
    inside = {
        name: np.mean([np.abs(trial.errors) <= trial.half_widths for trial in found], 0)
        for name, found in trials.items()
    }
    for number, unknown in enumerate(ALL):
        yield f"| {unknown} | " + " | ".join(f"{100 * shares[number]:.1f} %" for shares in inside.values()) + " |"
    every = [f"{100 * shares.mean():.1f} %" for shares in inside.values()]
    yield f"| mean | {' | '.join(every)} |"
    joint = [f"{100 * np.mean([trial.is_inside for trial in found]):.1f} %" for found in trials.values()]
    yield f"| all together | {' | '.join(joint)} |"


def poses_rows(seeds: int, workers: int) -> Iterator[str]:
    """Errors against the number of poses, as lines of a table; draws the picture."""
    counts = (6, 8, 12, 24, 50, 100, 200, 400)
    found = {}
    for designed in (True, False):
        with ProcessPoolExecutor(workers) as pool:
            found[designed] = np.array(list(pool.map(partial(with_poses, designed, counts), range(seeds))))
    medians = {
        (designed, group, unit): np.array(
            [np.median(length(errors[:, i], TOOL + TABLE, group, unit)) for i in range(len(counts))]
        )
        for designed, errors in found.items()
        for group in ("tool.", "table.")
        for unit in ("mm", "deg")
    }
    yield "| poses | tool, designed | tool, random | table, designed | table, random |"
    yield "|---|---|---|---|---|"
    for i, count in enumerate(counts):
        cells = [
            f"{1e3 * medians[designed, group, 'mm'][i]:.1f} um / {medians[designed, group, 'deg'][i]:.4f} deg"
            for group in ("tool.", "table.")
            for designed in (True, False)
        ]
        yield f"| {count} | {' | '.join(cells)} |"
    draw(counts, medians)


def draw(counts: Sequence[int], medians: dict[tuple[bool, str, str], Array]) -> None:
    """Draw the errors against the number of poses."""
    plt.style.use("scancell.plots")
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2))
    for axis, unit, scale, label in zip(axes, ("mm", "deg"), (1e3, 1.0), ("position (um)", "angle (deg)"), strict=True):
        for (designed, group, its_unit), values in medians.items():
            if its_unit != unit:
                continue
            colour = "C0" if group == "tool." else "C1"
            style = "-o" if designed else "--s"
            what = f"{'tool' if group == 'tool.' else 'table axis'}, {'designed' if designed else 'random'} poses"
            axis.loglog(counts, scale * values, style, color=colour, label=what, markersize=4)
        axis.set(xlabel="number of poses", ylabel=f"median error of the {label}")
        axis.set_xticks(counts, [str(count) for count in counts])
        axis.minorticks_off()
        axis.grid()
    axes[0].legend()
    figure.savefig(PICTURE)
    plt.close(figure)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000, help="of the coverage; the medians use 50 at most")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--only", choices=("accuracy", "coverage", "large", "poses", "axes", *CASES, "belt"))
    chosen = parser.parse_args()
    few = min(chosen.seeds, 50)
    tables: dict[str, Callable[[], Iterator[str]]] = {
        "accuracy": lambda: accuracy_rows(few, chosen.workers),
        "coverage": lambda: coverage_rows(chosen.seeds, chosen.workers, SMALL),
        "large": lambda: coverage_rows(chosen.seeds, chosen.workers, LARGE),
        "poses": lambda: poses_rows(min(few, 20), chosen.workers),
        "axes": lambda: axis_rows(-(-chosen.seeds // 4), chosen.workers),
        "belt": lambda: unknown_rows(partial(of_belt), BELT, chosen.seeds, chosen.workers),
    }
    for name, case in CASES.items():
        free = CalibrationRequest(case[1]).free()
        tables[name] = partial(unknown_rows, partial(of_case, case), free, chosen.seeds, chosen.workers)
    for name, rows in tables.items():
        if chosen.only in (None, name):
            print(f"\n{name}\n")
            for row in rows():
                print(row, flush=True)


if __name__ == "__main__":
    main()
