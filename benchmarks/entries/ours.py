"""scancell: the algorithms of this package with their defaults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.board_views import read_views
from benchmarks.planning_cases import path_of, path_poses, planning_cell
from benchmarks.sphere_cell import observations_along_z
from benchmarks.tracks.acceptance import NAMES as ACCEPTANCE_NAMES
from benchmarks.tracks.hand_eye import NAMES
from benchmarks.tracks.table import NAMES as TABLE_NAMES
from scancell.calibration.board.solve import COUNT, BoardCalibration, BoardView, Rig, solve, start_rig
from scancell.calibration.cell.kinematics import TABLE, TOOL, AxisReadings, CellKinematics, written_unit
from scancell.calibration.cell.problem import Artefact, CalibrationProblem, MeasuredShapes
from scancell.calibration.cell.solve import solve as solve_cell
from scancell.config.sensor import SensorDescription
from scancell.evaluation.artefact import evaluate_against_artefact
from scancell.geometry import pose
from scancell.geometry.arm import Chain
from scancell.geometry.shapes import Box, Cylinder, PlacedShape, ShapeGroup, Sphere
from scancell.planning.path_map.path_planner import PathPlanner
from scancell.scanning.world import make_sensor
from scancell.sensor import PEAK_REJECTED, extract

_STEP = 1e-4  # of an unknown in the units of the solution


def stripe(case: dict[str, Any]) -> dict[str, Any]:
    """Default detector; peaks that the limits of shape reject are left out."""
    return stripe_rows(case, {})


def stripe_rows(case: dict[str, Any], extraction: dict[str, float]) -> dict[str, Any]:
    """Rows by the default detector, with other values of keys of ``[extraction]``."""
    images, camera = case["images"], case["camera"]
    default = SensorDescription.default()
    one = default.model_copy(update={"camera": default.camera[:1]})
    described = one.replace(
        {
            "camera[1].height_px": images.shape[1],
            "camera[1].width_px": images.shape[2],
            **{f"detector.{key}": value for key, value in camera.items()},
            **{f"extraction.{key}": value for key, value in extraction.items()},
            "detector.laser_off_frame": False,
        }
    )
    peaks = extract(np.asarray(images, np.uint16)[:, None], make_sensor(described, 0))
    kept = (peaks.flags & PEAK_REJECTED) == 0
    return {"frame": peaks.frame[kept], "column": peaks.column[kept], "row": peaks.row[kept]}


def _board(case: dict[str, Any]) -> BoardCalibration:
    """Adjustment of camera, sheet, hand-eye and board by all views."""
    views = []
    for number, view in enumerate(read_views(case)):
        along = np.linalg.svd(view.stripe - view.stripe.mean(0), full_matrices=False)[2][0]
        across = np.broadcast_to([-along[1], along[0]], view.stripe.shape)
        views.append(BoardView(str(number), view.flange, view.points, view.pixels, view.stripe, across))
    return solve(views, start_rig(views, (case["width_px"], case["height_px"])))


def _half_widths(found: BoardCalibration, function: Callable[[Rig], Any]) -> Any:
    """Of the 95 % intervals of values of the rig, by propagation of the covariance."""
    steps = _STEP * np.eye(COUNT)
    jacobian = np.stack([function(found.rig.moved(step)) - function(found.rig.moved(-step)) for step in steps], 1)
    jacobian /= 2 * _STEP
    return found.estimate.half_widths(jacobian)


def hand_eye(case: dict[str, Any]) -> dict[str, Any]:
    """Calibration by a board, with intervals."""
    found, chosen = _board(case), slice(7, 7 + len(NAMES))
    half = _half_widths(found, lambda rig: rig.values[chosen])
    return {"name": NAMES, "value": found.rig.values[chosen], "half_width": half}


def sensor(case: dict[str, Any]) -> dict[str, Any]:
    """The same calibration; points where the rays meet the sheet."""
    found, query = _board(case), case["query"]
    pixels = np.column_stack([query["column_px"], query["row_px"]])
    points = 1e3 * found.rig.on_sheet(pixels)
    half = _half_widths(found, lambda rig: 1e3 * rig.on_sheet(pixels)[:, 2])
    return {"x_mm": points[:, 0], "y_mm": points[:, 1], "z_mm": points[:, 2], "half_width_z_mm": half}


def planning(case: dict[str, Any]) -> dict[str, Any]:
    """Ray Shooting on configuration maps."""
    cell = planning_cell(case["case"])
    path = path_of(case["case"], cell)
    placed = PathPlanner(cell, 1e-3 * case["clearance_mm"]).place(path)
    axes = np.zeros((0, 7))
    if not isinstance(placed, str):
        distance = path.speed * case["path"]["time_s"]
        axes = np.degrees(placed.at(placed.run.trigger_from + distance / placed.run.speed))
    return {**{f"q{joint + 1}_deg": axes[:, joint] for joint in range(6)}, "table_deg": axes[:, 6]}


def table(case: dict[str, Any]) -> dict[str, Any]:
    """Calibration of the cell from poses of the flange, with pose errors of the robot of unknown size."""
    exposures, points = case["exposures"], case["points"]
    cell = CellKinematics(Chain((), np.eye(4)), np.array(case["flange_from_sensor"]), np.array(case["base_from_table"]))
    readings = AxisReadings.of_flange(path_poses(exposures), np.radians(exposures["table_deg"]))
    in_sensor = 1e-3 * np.column_stack([np.zeros_like(points["y_mm"]), points["y_mm"], points["z_mm"]])
    sigma = np.full(len(in_sensor), 1e-3 * case["noise_mm"])
    observed = observations_along_z(readings, in_sensor, sigma, points["exposure"].astype(int))
    sphere = ShapeGroup((PlacedShape("sphere", Sphere(1e-3 * case["radius_mm"]), np.eye(4)),))
    artefact = Artefact(MeasuredShapes(sphere), pose.translation(1e-3 * np.array(case["sphere_on_table_mm"])))
    found = solve_cell(CalibrationProblem(cell, observed, artefact, (*TOOL, *TABLE)))
    factor = np.array([written_unit(name)[1] for name in (*TOOL, *TABLE)])
    return {"name": TABLE_NAMES, "value": found.values / factor, "half_width": found.half_widths() / factor}


def acceptance(case: dict[str, Any]) -> dict[str, Any]:
    """Evaluation against the artefact after a best fit; form of 95 % of the points."""
    points = 1e-3 * np.column_stack([case["points"][axis] for axis in ("x_mm", "y_mm", "z_mm")])
    centres, thickness = 1e-3 * np.array(case["centres_mm"]), 0.01
    stem = Cylinder(1e-3 * case["stem_radius_mm"], centres[0, 2])
    plate = Box(*(1e-3 * np.array(case["plate_mm"])), thickness)
    shapes = [PlacedShape("plate", plate, pose.translation((0, 0, -thickness / 2)))]
    for number, centre in enumerate(centres, 1):
        shapes.append(PlacedShape(f"ball{number}", Sphere(1e-3 * case["radius_mm"]), pose.translation(centre)))
        shapes.append(PlacedShape("stem", stem, pose.translation(centre * [1, 1, 0.5]), "support"))
    found = evaluate_against_artefact(points, ShapeGroup(tuple(shapes)), "best-fit").characteristics
    figures = {f"{one.of} {one.name}": one for one in found}
    form = "{} probing form, 95 % of the points"
    names = ("ball1 probing size", "ball2 probing size", "ball1 - ball2 sphere spacing")
    chosen = [*names, form.format("ball1"), form.format("ball2"), "plate:+z flatness, 95 % of the points"]
    rows = [figures[name] for name in chosen]
    half = 1.96e6 * np.nan_to_num([one.uncertainty for one in rows])  # forms have none
    return {"name": ACCEPTANCE_NAMES, "value": [1e6 * one.error for one in rows], "half_width": half}
