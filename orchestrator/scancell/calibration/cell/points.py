"""Measured points for calibration as a table, so that profiles of a real cell can be used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.calibration.cell.kinematics import AxisReadings, axis_column, column_unit, written_unit
from scancell.calibration.cell.problem import (
    REACH,
    CalibrationProblem,
    CalibrationResult,
    Observations,
    distances_to,
    points_on_platter,
)
from scancell.calibration.cell.solve import Circles, SphereStart, circles_of, solve, sphere_start
from scancell.calibration.measured_table import MeasuredTable, write_measured_table
from scancell.calibration.pose_files import (
    flange_columns,
    has_flange,
    read_flange,
    read_pose_file,
    refuse_misread,
    refuse_wrong,
)
from scancell.config.cell import PartDescription, sensor_frame
from scancell.config.loading import Setup
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.orientation import StatedPoses
from scancell.geometry.shapes import ShapeMesh, Sphere
from scancell.geometry.tree import Joint
from scancell.nominal.cell import NominalCell, nominal_cell

_DEFAULT_SIGMA_UM = 10.0
_SAME = 1e-9  # deg: readings of one exposure must agree
_MOST_NAMED = 3

Missing = Callable[[Array], Mapping[str, Array]]
"""Columns (n,) by name, of exposures by their numbers (n,), that replace those which a table lacks."""

AGREED = 1e-3  # m: rms distance of a sphere's centres up to which they agree
_MOST_NAMED_POSES = 5
_MUCH_BETTER = 1 / 3  # of the distance of the centres, with which a mistake explains it
_UNITS = {"m": 1e3, "um": 1e-3}
_MOST_RADII = 2.5  # radius of circles of a sphere of another size, at most
_LEAST_CIRCLES = 6
_SHARES = (1.0, 1.01, 1.03, 1.1)  # radius of the sphere in terms of that of the largest circle but one
_ABOUT = 0.05  # share
_TINY = 0.05  # of the radius: smaller circles are chance
_WRONG = 2e-3  # m: and ten times the median distance, from which a pose is wrong

ABOVE_TABLE = 3e-3  # m: lower points may be the table's
_SIGNIFICANT = 5.0  # standard deviations of a size
_LEAST_SIZE_ERROR = 1e-6  # m
_SHIFTED = 0.05e-3  # m: more than the chord error of the artefact's mesh
_MIRRORED = np.radians(30.0)  # of half a turn about the sensor's z
# Deviations from which a warning is given: several times the errors of an assembly.
_IMPLAUSIBLE = {"mm": 10.0, "deg": 5.0, "ms": 50.0, "ppm": 1e5}


def write_points(data: Observations, path: Path) -> None:
    """Write CSV or Parquet (by suffix), a row per point; see docs/calibration.md for the columns.

    Raises `OutputError` if the file cannot be written.
    """
    readings, frame = data.readings, data.frame
    columns: dict[str, NDArray[np.generic]] = {"exposure": frame + 1}
    if readings.flange is not None:
        columns |= {name: values[frame] for name, values in flange_columns(readings.flange).items()}
    columns |= {name: values[frame] for name, values in readings.columns().items()}
    for axis, values in zip("xyz", data.points_in_sensor.T, strict=True):
        columns[f"{axis}_mm"] = 1e3 * values
    if data.direction is not None:
        columns |= {f"error_{axis}": values for axis, values in zip("xyz", data.direction.T, strict=True)}
    columns["sigma_um"] = 1e6 * data.sigma
    columns["time_offset_ms"] = 1e3 * data.time_offset
    write_measured_table(path, columns)


@dataclass(frozen=True)
class MeasuredPoints:
    """Observations from files.

    Attributes
    ----------
    path, flange_path
        The tables of points and of flange poses, which may be the same.
    exposures
        (n,) number of each exposure in the table.
    flange
        Flange poses (n) as stated; None where joints are given.
    poses_kind
        What the file of flange poses was taken for; empty for a table with names of columns.
    """

    path: Path
    observations: Observations
    exposures: Array
    flange: StatedPoses | None = None
    flange_path: Path | None = None
    poses_kind: str = ""


def read_points(
    path: Path,
    joints: int,
    flange_path: Path | None = None,
    convention: str | None = None,
    table: MeasuredTable | None = None,
    further: Sequence[Joint] = (),
    missing: Missing | None = None,
) -> MeasuredPoints:
    """Observations from CSV, Parquet or YAML; rows without ``z_mm`` are left out.

    Raises `DescriptionError` if a file is missing, lacks a column or a pose, holds values that are not finite numbers,
    or the readings of an exposure differ.

    Parameters
    ----------
    joints
        Number of joints of the arm.
    flange_path
        Table of flange poses by exposure; by default they, or joints, are in the table of points.
    convention
        Convention of flange poses, see `read_flange`.
    table
        That of the points, where it has been read.
    further
        Axes of the cell beside joints and table.
    missing
        What replaces columns that the table lacks, see `stated_axes`.
    """
    if table is None:
        table = MeasuredTable(path)
        table.leave_out_missing("z_mm")
    numbers, first, frame = np.unique(table.numbers("exposure"), return_index=True, return_inverse=True)
    frame = np.asarray(frame, np.intp).reshape(-1)
    stated, kind, with_poses = None, "", dict[str, Array]({} if missing is None else missing(numbers))
    if flange_path is not None:
        poses, kind = read_pose_file(flange_path)
        row = _rows_of(poses, numbers, path)
        stated = read_flange(poses, convention).rows(row)
        with_poses |= {name: poses.numbers(name)[row] for axis in further if (name := axis_column(axis)) in poses.names}
    elif has_flange(table):
        every = read_flange(table, convention)
        stated = every.rows(first)
        per_point = {"flange position": every.position, "flange orientation": every.orientation}
        _require_equal(per_point, first, frame, numbers, table)
    elif convention is not None:
        raise DescriptionError("has no flange poses", file=path, key="convention", value=convention)
    readings = read_axes(table, joints if stated is None else 0, first, frame, numbers, further, with_poses)
    if stated is not None:
        readings = AxisReadings.of_flange(stated.matrices(), readings.axes, further)
    direction = None
    if any(f"error_{axis}" in table.names for axis in "xyz"):
        stated_direction = np.column_stack([table.numbers(f"error_{axis}", 0.0) for axis in "xyz"])
        length = np.linalg.norm(stated_direction, axis=1, keepdims=True)
        direction = stated_direction / np.where(length > 0, length, np.nan)
    sigma = table.numbers("sigma_um", _DEFAULT_SIGMA_UM)
    if (sigma <= 0).any() or (direction is not None and np.isnan(direction).any()):
        raise DescriptionError("sigma_um and the length of error_x, error_y, error_z must be above 0", file=path)
    time_offset = table.numbers("time_offset_ms", 0.0)
    if stated is not None:
        table.require(time_offset == 0.0, "time_offset_ms", "0 with flange poses, which state no rates")
    observations = Observations(
        readings,
        1e-3 * _coordinates(table, stated is not None or "q1_deg" not in table.names),
        1e-6 * sigma,
        direction,
        frame,
        1e-3 * time_offset,
    )
    return MeasuredPoints(path, observations, numbers, stated, flange_path or path, kind)


def described_cell(setup: Setup, part: Mesh | None) -> NominalCell:
    """The described cell, in which the belt carries the part where the scan is one on a belt."""
    nominal = nominal_cell(setup.cell, part)
    return nominal if setup.scan.belt is None else nominal.on_belt()


def belt_axes(cell: NominalCell) -> tuple[str, ...]:
    """Names of the axes of the belts up to that which carries the part, ``conveyor[1]`` …; none without one."""
    count = cell.required_belt().conveyor if cell.support_kind == "belt" else 0
    return tuple(f"conveyor[{number}]" for number in range(1, count + 1))


def stated_axes(setup: Setup) -> tuple[list[Joint], Missing]:
    """Axes beside joints and table that measurements state, and what replaces those that they lack.

    On a belt, exposures without its travel are a pitch of the scan apart, so that exposure n is at n pitches, at its
    speed. Joints and table are at their start where no sensor moves with them.
    """
    cell = described_cell(setup, None)
    belts, fixed = [cell.tree[name] for name in belt_axes(cell)], dict[str, float]()
    arm = {"table", *cell.arm.tree.axes}
    sensors = [sensor_frame(number) for number in range(1, len(cell.further_sensors) + 2)]
    if not any(arm.intersection(cell.tree.axes_of(frame)) for frame in (*sensors, "part")):
        fixed = {f"q{i}_deg": angle for i, angle in enumerate(setup.cell.robot.home_deg, 1)} | {"table_deg": 0.0}
    fixed |= {axis_column(belt): 0.0 for belt in belts[:-1]}

    def missing(numbers: Array) -> dict[str, Array]:
        columns = {name: np.full(len(numbers), value) for name, value in fixed.items()}
        if belts and (belt := setup.scan.belt) is not None:
            columns[axis_column(belts[-1])] = np.copysign(belt.pitch_mm, belt.speed_mm_s) * numbers
            columns[axis_column(belts[-1], "_rate", "_s")] = np.full(len(numbers), belt.speed_mm_s)
        return columns

    return [*(axis.joint for axis in cell.further_axes), *belts], missing


def _coordinates(table: MeasuredTable, without_joints: bool) -> Array:
    """Points (m, 3), mm; in a table without joints and y_mm, x_mm is along the line of the sensor."""
    if without_joints and "x_mm" in table.names and "y_mm" not in table.names:
        return np.column_stack([np.zeros(len(table)), table.numbers("x_mm"), table.numbers("z_mm")])
    return np.column_stack([table.numbers("x_mm", 0.0), table.numbers("y_mm"), table.numbers("z_mm")])


def _rows_of(table: MeasuredTable, numbers: Array, points: Path) -> NDArray[np.intp]:
    """Rows (n,) of a table of flange poses for the exposures `numbers` (n,)."""
    own = table.numbers("exposure")
    unique, row, count = np.unique(own, return_index=True, return_counts=True)
    if (count > 1).any():
        twice = float(unique[count > 1][0])
        table.refuse(int(np.flatnonzero(own == twice)[1]), "exposure", "one pose of each exposure")
    missing = np.setdiff1d(numbers, unique)
    if len(missing):
        raise DescriptionError(
            f"holds no flange pose of {len(missing)} of the {len(numbers)} exposures of {points.name}",
            file=table.path,
            key="column 'exposure'",
            expected="a row with exposure " + ", ".join(f"{number:g}" for number in missing[:_MOST_NAMED]),
        )
    return np.asarray(row[np.searchsorted(unique, numbers)], np.intp)


def read_axes(
    table: MeasuredTable,
    joints: int,
    first: NDArray[np.intp],
    frame: NDArray[np.intp],
    numbers: Array,
    further: Sequence[Joint] = (),
    with_poses: Mapping[str, Array] | None = None,
) -> AxisReadings:
    """Readings of joints, table and `further` axes, by the rows `first` (n,) of exposures.

    With no joints the table may be missing. Columns `with_poses` (n,), such as those of a table of poses, replace
    positions that the table lacks. `frame` (m,) is the exposure of each row, `numbers` (n,) those of the exposures for
    messages.

    Raises `DescriptionError` if a column is missing, or the readings of an exposure differ.
    """
    kinds = ("q", "", ""), ("qd", "_rate", "_s"), ("qdd", "_acceleration", "_s2")
    per_point: dict[str, Array] = {}
    scales = [np.pi / 180] * (joints + 1) + [column_unit(axis)[1] for axis in further]
    for name, suffix, end in kinds:
        default = None if name == "q" else 0.0

        def column_of(column: str, default: float | None) -> Array:
            if column not in table.names and column in (with_poses or {}):
                return (with_poses or {})[column][frame]
            return table.numbers(column, default)

        columns = [column_of(f"{name}{joint}_deg{end}", default) for joint in range(1, 1 + joints)]
        columns.append(column_of(f"table{suffix}_deg{end}", default if joints else 0.0))
        for axis in further:
            column = axis_column(axis, suffix, end)
            if column in (with_poses or {}):
                columns.append(column_of(column, default))
                continue
            if default is None and column not in table.names:
                raise DescriptionError(
                    "is missing",
                    file=table.path,
                    key=f"column '{column}'",
                    expected=f"the measured position of the axis {axis.axis} of the cell; a constant where it rests",
                )
            columns.append(table.numbers(column, default))
        per_point[name] = np.column_stack(columns)
    _require_equal(per_point, first, frame, numbers, table)
    positions, rates, accelerations = (values[first] * scales for values in per_point.values())
    return AxisReadings(positions, rates, accelerations, further=tuple(further))


def _require_equal(
    per_point: dict[str, Array], first: NDArray[np.intp], frame: NDArray[np.intp], numbers: Array, table: MeasuredTable
) -> None:
    for name, values in per_point.items():
        away = np.abs(values - values[first][frame]).reshape(len(values), -1).max(1, initial=0.0)
        if away.max() > _SAME:
            row = int(away.argmax())
            raise DescriptionError(
                f"{name} differs from that in the first row of exposure {numbers[frame[row]]:g}",
                file=table.path,
                key=f"row {table.row_number(row)}",
                expected="equal readings in all rows of an exposure",
            )


def _distance(found: SphereStart | None) -> float:
    """Median distance, m, of the centres of a sphere from the common one; infinite without one."""
    return float("inf") if found is None else float(np.median(found.away))


def wrong_sphere(problem: CalibrationProblem, radius: float, centre: Array) -> str:
    """Size or unit of profiles of a sphere that makes the centres of its circles agree, as a sentence; else empty.

    Parameters
    ----------
    radius, centre
        Radius and centre of the described sphere, the latter (3,) about where it is on the platter, m.
    """
    data, readings = problem.observations, problem.observations.readings

    def misfit(circles: Circles) -> float:
        return _distance(sphere_start(problem.kinematics, readings, circles, centre))

    own = circles_of(data, radius)
    # A few circles agree by chance.
    limit = min(AGREED, _MUCH_BETTER * misfit(own)) if len(own) >= _LEAST_CIRCLES else AGREED
    if not len(own) or own.radius.max() < _TINY * radius:
        for unit, scale in _UNITS.items():
            scaled = replace(data, points_in_sensor=scale * data.points_in_sensor)
            if misfit(circles_of(scaled, radius)) < limit:
                return f"in {unit} the points of the profiles fit the sphere: check their unit"
    # The first set has all circles of a larger sphere, of which the second has the small ones only.
    for circles in (circles_of(data, radius, _MOST_RADII), own):
        if len(circles) < _LEAST_CIRCLES:
            continue
        top = float(np.sort(circles.radius)[-2])
        least, size = min((misfit(circles.of_sphere(share * top)), share * top) for share in _SHARES)
        if least < limit:
            is_radius = abs(size / (2 * radius) - 1.0) < _ABOUT
            return (
                f"the profiles show circles up to {2e3 * top:.2f} mm across, whose centres agree for a diameter of"
                f" about {2e3 * size:.1f} mm; the description says {2e3 * radius:.6g} mm: correct diameter_mm"
                + (", which seems to hold the radius" if is_radius else "")
            )
    return ""


def check_flange(measured: MeasuredPoints, problem: CalibrationProblem, radius: float, centre: Array) -> None:
    """Raise `CalibrationError` if poses of the flange disagree with the circles in profiles of a sphere.

    The message names what fits (the poses of other rows, another size of the sphere, another convention), or the
    exposures that do not. `radius` and `centre` as in `wrong_sphere`.
    """
    readings, stated = measured.observations.readings, measured.flange
    kinematics, circles = problem.kinematics, circles_of(problem.observations, radius)
    start = sphere_start(kinematics, readings, circles, centre)
    if start is None or stated is None:
        return
    own = _distance(start)

    def misfit(flange: Array) -> float:
        return _distance(sphere_start(kinematics, replace(readings, flange=flange), circles, centre))

    if own > AGREED:
        for rows in (1, -1):
            fits = misfit(np.roll(stated.matrices(), rows, axis=0))
            if fits < min(AGREED, _MUCH_BETTER * own):
                raise CalibrationError(
                    f"the flange poses do not belong to the profiles: the median distance of the sphere's centres is"
                    f" {1e3 * own:.3g} mm; it is {1e3 * fits:.3g} mm with the poses shifted by"
                    f" one exposure, so that each profile has the pose of the exposure"
                    f" {'before' if rows > 0 else 'after'} it",
                    file=measured.flange_path,
                )
        if wrong := wrong_sphere(problem, radius, centre):
            raise CalibrationError(wrong, file=measured.flange_path)
        refuse_misread(stated, misfit, "the profiles of the sphere", "its centres", measured.flange_path)
        return
    limit = max(_WRONG, 10.0 * own)
    name = lambda i: f"exposure {measured.exposures[circles.frame[i]]:g}"  # noqa: E731
    refuse_wrong(
        start.away, limit, name, ("exposures", "centres of the sphere"), measured.flange_path, _MOST_NAMED_POSES
    )


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
    sign = np.where(np.arange(own.axes.shape[1]) == own.joints, -1.0, 1.0)
    turned = replace(own, axes=own.axes * sign, rates=own.rates * sign, accelerations=own.accelerations * sign)
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
