"""Profiles of a part that a belt of known deviations carries past the sensor of ``belt_post.toml``, by ideal rays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from scancell.calibration.cell.kinematics import AxisReadings, axis_deviations
from scancell.calibration.cell.problem import Artefact, CalibrationProblem, CalibrationResult, surface_of
from scancell.calibration.cell.scan import kinematics_of, observations_of, on_artefact
from scancell.calibration.cell.solve import solve
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.nominal.cell import estimated_cell
from scancell.nominal.parts import load_part
from scancell.scanning.pipeline import ScanPipeline
from scancell.scanning.world import World

BELT = axis_deviations("conveyor[1]")
ENCODER = 20e-6  # m, standard deviation of the readings of the belt's travel
THINNED = 24  # of so many points one is used
CENTRE, REACH, PROFILES = 0.21, 0.06, 48  # m: travel at which the part is under the sensor, and on either side


@cache
def part_on_belt(part: str = "parts/free_form.stl") -> World:
    """The part in the described cell, on its belt."""
    cells = assets_dir() / "cells/belt_post.toml"
    setup = load_setup(cells, scan=assets_dir() / "scans/belt_post.toml")
    return ScanPipeline(threads=1).load(setup, load_part(assets_dir() / part))


def problem_of(
    planted: Mapping[str, float], seed: int, encoder: float = ENCODER, part: str = "parts/free_form.stl"
) -> CalibrationProblem:
    """Calibration of the belt by profiles with noise, where the belt has the `planted` deviations, SI.

    The part lies up to 0.3 mm and 0.2 deg from where it is described.
    """
    rng, world = np.random.default_rng(seed), replace(part_on_belt(part), seed=seed)
    nominal = world.nominal
    shift, turn = rng.uniform(-3e-4, 3e-4, 3), np.radians(rng.uniform(-0.2, 0.2, 3))
    displaced = nominal.with_part_at(nominal.support_from_part @ pose.from_euler_xyz(shift, turn))
    travel = CENTRE + np.linspace(-REACH, REACH, PROFILES)
    axes = np.hstack([np.tile([*nominal.home, 0.0], (PROFILES, 1)), travel[:, None]])
    number, once = np.arange(PROFILES, dtype=np.int64), np.array([[0.0, world.sensor.exposure]])
    true = estimated_cell(displaced, planted).frame_poses(axes)
    sensed = world.expose_at_rest(true, number, once, "geometric", threads=1)
    kinematics = kinematics_of(nominal)
    axes[:, -1] += encoder * rng.normal(size=PROFILES)
    readings = AxisReadings.at_rest(axes, kinematics.further)
    artefact = Artefact(surface_of(nominal.part), nominal.support_from_part)
    observed = observations_of(sensed.points, readings, world.sensor)
    observed = observed.chosen(np.arange(len(observed.sigma)) % THINNED == 0)
    problem = CalibrationProblem(kinematics, observed, artefact, BELT, robot_noise="joints")
    return replace(problem, observations=observed.chosen(on_artefact(problem)))


def calibrated(planted: Mapping[str, float], seed: int, encoder: float = ENCODER) -> CalibrationResult:
    """Solution of `problem_of`."""
    return solve(problem_of(planted, seed, encoder))
