"""Likely causes of doubtful calibrations: wrong size or position of the artefact, mirrored profiles, large results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import AxisReadings, written_unit
from scancell.calibration.cell.problem import (
    REACH,
    CalibrationProblem,
    CalibrationResult,
    Observations,
    distances_to,
    points_on_platter,
)
from scancell.calibration.cell.solve import solve
from scancell.config.cell import PartDescription
from scancell.errors import CalibrationError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeMesh, Sphere
from scancell.nominal.cell import NominalCell

Array = NDArray[np.float64]

ABOVE_TABLE = 3e-3  # m: lower points may be the table's
_SIGNIFICANT = 5.0  # standard deviations of a size
_LEAST_SIZE_ERROR = 1e-6  # m
_MOST_NAMED = 3
_SHIFTED = 0.05e-3  # m: more than the chord error of the artefact's mesh
_MIRRORED = np.radians(30.0)  # of half a turn about the sensor's z
# Deviations from which a warning is given: several times the errors of an assembly.
_IMPLAUSIBLE = {"mm": 10.0, "deg": 5.0, "ms": 50.0}


def shift_of(nominal: NominalCell, described: PartDescription) -> Array:
    """Shift (3,) of a part's own coordinates on the table beyond the described one, m; 0 for parts without shapes.

    A part stands with its lowest point on the table and the middle of its bounding box on the axis.
    """
    if not isinstance(nominal.part, ShapeMesh):
        return np.zeros(3)
    return np.asarray(
        nominal.table_from_part[:3, 3] - 1e-3 * np.array([described.x_mm, described.y_mm, described.z_mm])
    )


def shift_text(shift: Array) -> str:
    """A sentence about a shift (3,), m; empty without one."""
    if np.abs(shift).max() < _SHIFTED:
        return ""
    return (
        "the artefact stands with its lowest shape on the table and the middle of its bounding box on the axis: its"
        f" coordinates are shifted by ({_mm(shift)}) mm; describe what carries it, too, or move it by cell.part"
    )


def where_points_lie(problem: CalibrationProblem, part: Mesh) -> str:
    """Sentence that states the distance of the points of a problem from the artefact at its nominal pose."""
    data, artefact = problem.observations, problem.artefact
    points = points_on_platter(data, problem.kinematics.poses(data.readings, problem.start))
    high = points[:, 2] > ABOVE_TABLE
    if not high.any():
        return f"all {len(points)} points lie lower than {1e3 * ABOVE_TABLE:g} mm above the table"
    away = distances_to(part, pose.transform_points(pose.inverse(artefact.platter_from_artefact), points[high]))
    middle = np.median(points[high], axis=0)
    return (
        f"of {len(points)} points {(~high).sum()} lie lower than {1e3 * ABOVE_TABLE:g} mm above the table, and"
        f" {int((away < REACH).sum())} of the others within {1e3 * REACH:g} mm of the artefact; the median distance of"
        f" these others is {1e3 * float(np.median(away)):.1f} mm, their middle ({_mm(middle)}) mm on the table"
    )


def _mm(vector: Array) -> str:
    return ", ".join(f"{1e3 * value + 0.0:.1f}" for value in vector)


def wrong_sizes(problem: CalibrationProblem, part: Mesh) -> str:
    """Spheres whose diameter is significantly not the described one, as a sentence; empty without any."""
    if not isinstance(part, ShapeMesh) or problem.artefact.unknown_sizes:
        return ""
    spheres = [
        i for i, one in enumerate(part.shapes.shapes) if one.role == "measured" and isinstance(one.shape, Sphere)
    ]
    if not spheres:
        return ""
    try:
        found = solve(replace(problem, artefact=replace(problem.artefact, unknown_sizes=tuple(spheres))))
    except CalibrationError:
        return ""
    limit = np.maximum(_SIGNIFICANT * found.size_standard_deviations, _LEAST_SIZE_ERROR)
    wrong = [(i, size) for i, size, most in zip(spheres, found.sizes, limit, strict=True) if abs(size) > most]
    if not wrong:
        return ""
    named = [f"'{part.shapes.shapes[i].name}' by {2e3 * size:+.3f} mm" for i, size in wrong]
    more = [f"and {len(named) - _MOST_NAMED} more"] if len(named) > _MOST_NAMED else []
    return (
        f"the measured diameter differs from the described one, of {', '.join(named[:_MOST_NAMED] + more)}: correct"
        " diameter_mm, give the sizes as unknown (`is_size_known`), or calibrate the sensor first"
    )


def mirrored(problem_of: Callable[[Observations], CalibrationProblem], measured: Observations) -> str:
    """A question if the points determine the unknowns once their y has the other sign; else empty."""
    flip = np.array([1.0, -1.0, 1.0])
    direction = None if measured.direction is None else measured.direction * flip
    turned = replace(measured, points_in_sensor=measured.points_in_sensor * flip, direction=direction)
    agrees = "with the sign of y_mm changed the points agree with the artefact: is y mirrored?"
    return agrees if _is_solved(problem_of, turned) else ""


def opposite_table(problem_of: Callable[[Observations], CalibrationProblem], measured: Observations) -> str:
    """A question if the points determine the unknowns once the table turns in the opposite direction; else empty."""
    own = measured.readings
    if not own.table.any():
        return ""
    sign = np.append(np.ones(own.q.shape[1]), -1.0)
    turned = AxisReadings(own.axes * sign, own.rates * sign, own.accelerations * sign, own.flange)
    agrees = (
        "with the sign of table_deg changed the points agree with the artefact: is the angle of the table counted in"
        " the opposite direction?"
    )
    return agrees if _is_solved(problem_of, replace(measured, readings=turned)) else ""


def _is_solved(problem_of: Callable[[Observations], CalibrationProblem], measured: Observations) -> bool:
    try:
        solve(problem_of(measured))
    except CalibrationError:
        return False
    return True


def implausible(result: CalibrationResult) -> list[str]:
    """Warnings of deviations that are larger than those of a cell that its description fits."""
    found = []
    for name, value in zip(result.names, result.values.tolist(), strict=True):
        unit, scale = written_unit(name)
        if abs(value / scale) < _IMPLAUSIBLE[unit]:
            continue
        is_mirrored = name == "tool.rz" and abs(abs(np.remainder(value, 2 * np.pi)) - np.pi) < _MIRRORED
        question = (
            "is y mirrored (the sign of y_mm), or the sensor mounted the other way round?"
            if is_mirrored
            else "does the description fit the cell, and are units, signs and order of the columns right?"
        )
        found.append(f"{name} = {value / scale:.4g} {unit} is implausibly large: {question}")
    return found
