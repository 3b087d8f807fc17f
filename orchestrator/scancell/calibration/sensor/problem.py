"""Measurements for the calibration of a sensor: stripe peaks and corners on targets of known shape."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.config.files import plain_data, split_path
from scancell.config.sensor import SensorDescription, sensor_json
from scancell.errors import CalibrationError, DescriptionError
from scancell.geometry import pose
from scancell.geometry.least_squares import NormalEquations
from scancell.geometry.shapes import Plane, ShapeGroup, Sphere

PEAK_SPACING = 8
"""Columns between stripe peaks: nearer ones share errors, add no accuracy, and would understate the covariance."""

RADIUS_OFFSET = "target.radius_offset_mm"
"""Free parameter beside those of the sensor: what all spheres of the target exceed their stated radius by, mm."""

_BENDS = 6  # coefficients of the sheet's out-of-plane angle

# What a parameter may deviate by from the data sheet, in its unit: directions are compared in these units.
_TOLERANCES = {
    "baseline_mm": 1.0,
    "height_mm": 1.0,
    "offset_y_mm": 1.0,
    "tilt_deg": 1.0,
    "pan_deg": 1.0,
    "roll_deg": 1.0,
    "half_angle_deg": 0.2,
    "cx_px": 30.0,
    "cy_px": 30.0,
    "distortion[1]": 0.3,
    "distortion[2]": 1.0,
    "distortion[3]": 0.01,
    "distortion[4]": 0.01,
    "distortion[5]": 10.0,
    "scheimpflug_x_deg": 1.0,
    "scheimpflug_y_deg": 1.0,
    "offset_x_mm": 1.0,
    "turn_y_deg": 1.0,
    "turn_z_deg": 1.0,
    "straightness_mrad": 5.0,
    "radius_offset_mm": 0.1,
}
_POSE = ("baseline_mm", "height_mm", "offset_y_mm", "tilt_deg", "pan_deg", "roll_deg")
_SHEET = ("offset_x_mm", "turn_y_deg", "turn_z_deg")
FRAME = (
    *(f"sensor.laser.{key}" for key in _SHEET),
    *(f"sensor.camera[1].{key}" for key in ("offset_y_mm", "height_mm", "pan_deg")),
)
"""They place the sensor frame: its plane X = 0 on the sheet, its Y, Z and rotation about X by the first camera."""

Rows = NDArray[np.bool_]

_STEP = 1e-3  # of a parameter's tolerance: half the interval of difference quotients
_ROW_STEP = 0.01  # px
_POINT_STEP = 1e-6  # m
# Where the line of sight grazes the surface, row noise moves the point along it, and its distance would seem exact.
_LEAST_INCIDENCE = 0.2


@dataclass(frozen=True)
class StripePeaks:
    """Stripe peaks of an exposure: camera (n,), column (n,), row (n,) and standard deviation of the row (n,), px."""

    camera: NDArray[np.int32]
    column: Array
    row: Array
    sigma: Array

    @classmethod
    def of(cls, peaks: sensor_rt.Peaks, frame: int = 0) -> StripePeaks:
        """Accepted peaks of one frame of `scancell.sensor.extract`, one of `PEAK_SPACING` neighbours."""
        accepted = (np.asarray(peaks.frame) == frame) & ((np.asarray(peaks.flags) & sensor_rt.PEAK_REJECTED) == 0)
        own = np.flatnonzero(accepted)[::PEAK_SPACING]
        column, row, sigma = (np.asarray(getattr(peaks, key), float)[own] for key in ("column", "row", "row_sigma"))
        return cls(np.asarray(peaks.camera)[own], column, row, sigma)


@dataclass(frozen=True)
class Corners:
    """Corners of a checkered target: camera (n,), pixels (n, 2), points_in_target (n, 3), m; deviation sigma, px."""

    camera: NDArray[np.int32]
    pixels: Array
    points_in_target: Array
    sigma: float


@dataclass(frozen=True)
class TargetExposure:
    """A target of known shape at rest.

    Attributes
    ----------
    target
        Its surfaces; those with the role `measured` count.
    sensor_from_target
        Pose (4, 4); a start where it is unknown.
    stripe, corners
        Measurements in the images.
    mounting
        Exposures of the same number share an unknown rigid displacement of their poses in the sensor frame, as those
        of a target on a stage that was mounted somewhere. None: the pose is known.
    """

    target: ShapeGroup
    sensor_from_target: Array
    stripe: StripePeaks | None = None
    corners: Corners | None = None
    mounting: int | None = None


@dataclass(frozen=True)
class SensorProblem:
    """Start description, exposures, and the names of the free parameters (see `SensorParameters`)."""

    sensor: SensorDescription
    exposures: tuple[TargetExposure, ...]
    free: tuple[str, ...]


def free_parameters(sensor: SensorDescription, poses_known: bool, checkered: bool) -> tuple[str, ...]:
    """Parameters that a complete set of measurements determines.

    Of every camera the pose, the field of view and the first radial distortion; of the sheet its plane and curvature.
    Points on the sheet alone do not distinguish the principal point from the camera's direction: it is free with a
    checkered target.

    Parameters
    ----------
    poses_known
        Whether the targets' poses in the sensor frame are known. Otherwise the pose of the sensor frame itself is
        undetermined, and the six parameters that place it are held: the sheet's plane is X = 0, and the first camera
        gives Y, Z and the rotation about X. The calibration of the tool transform absorbs their values.
    checkered
        Whether the cameras see a checkered target.
    """
    of_camera = (*_POSE, "half_angle_deg", "distortion[1]", *(("cx_px", "cy_px") if checkered else ()))
    names = [f"sensor.camera[{k + 1}].{key}" for k in range(len(sensor.camera)) for key in of_camera]
    # The first two coefficients of the curvature are turns of the sheet.
    names += [f"sensor.laser.{key}" for key in (*_SHEET, "straightness_mrad[3]", "straightness_mrad[4]")]
    return tuple(name for name in names if poses_known or name not in FRAME)


class SensorParameters:
    """Chosen keys of a sensor description as a vector, in the units of the keys.

    Raises `CalibrationError` if a name is unknown or given twice.

    Parameters
    ----------
    start
        The description whose other values are kept.
    names
        Keys such as ``sensor.camera[1].tilt_deg``, and `RADIUS_OFFSET`.
    """

    def __init__(self, start: SensorDescription, names: Sequence[str]) -> None:
        if len(set(names)) < len(names):
            raise CalibrationError("a name is given twice", key="also", value=tuple(names))
        self.names = tuple(names)
        self.start = _complete(start)
        self.scales = np.array([_tolerance(name) for name in names])

    @cached_property
    def start_values(self) -> Array:
        """Values (k,) of the start."""
        return np.array([0.0 if name == RADIUS_OFFSET else self._value(name) for name in self.names])

    def description(self, values: Array) -> SensorDescription:
        """The description with other values (k,), by which points are triangulated on the described sheet.

        Raises `CalibrationError` if a value is outside the bounds of its key.
        """
        pairs = zip(self.names, values.tolist(), strict=True)
        try:
            return self.start.replace({n.removeprefix("sensor."): v for n, v in pairs if n != RADIUS_OFFSET})
        except DescriptionError as error:
            raise CalibrationError(
                f"the calibration left the bounds of the sensor's description; check target, poses and start\n{error}"
            ) from error

    def sensor(self, values: Array) -> sensor_rt.Sensor:
        """Native model with these values (k,). `CalibrationError` as in `description`."""
        return sensor_rt.Sensor(json.dumps(sensor_json(self.description(values), 0)))

    def radius_offset(self, values: Array) -> float:
        """Radius offset of the spheres, m."""
        return 1e-3 * float(values[self.names.index(RADIUS_OFFSET)]) if RADIUS_OFFSET in self.names else 0.0

    def _value(self, name: str) -> float:
        node = {"sensor": plain_data(self.start)}
        for part in split_path(name):
            try:
                node = node[part]  # type: ignore[index]
            except (KeyError, IndexError, TypeError):
                raise CalibrationError("the sensor has no such key", key="also", value=name) from None
        return float(node)  # type: ignore[arg-type]


def _tolerance(name: str) -> float:
    key = name.rsplit(".", 1)[-1]
    found = _TOLERANCES.get(key) or _TOLERANCES.get(re.sub(r"\[\d+\]$", "", key))
    if found is None:
        raise CalibrationError(key="also", value=name, expected=f"one of the keys {', '.join(_TOLERANCES)}")
    return found


def _complete(sensor: SensorDescription) -> SensorDescription:
    """The same sensor with all values that may be free written out, and triangulation on its sheet."""
    bends = sensor.laser.straightness_mrad
    changes: dict[str, object] = {
        "extraction.triangulation": "sheet",
        "laser.straightness_mrad": [*bends, *[0.0] * (_BENDS - len(bends))],
    }
    for k, camera in enumerate(sensor.camera):
        for key, size in (("cx_px", camera.width_px), ("cy_px", camera.height_px)):
            if getattr(camera, key) is None:
                changes[f"camera[{k + 1}].{key}"] = (size - 1) / 2
    return sensor.replace(changes)


@dataclass(frozen=True)
class State:
    """Values (k,) of the free parameters, and the displacement (4, 4) of each mounting in the sensor frame."""

    values: Array
    displacement: Mapping[int | None, Array]


@dataclass(frozen=True)
class Block:
    """Residuals of one exposure, or of the exposures of a mounting, in standard deviations.

    Attributes
    ----------
    residual, deviation
        (n,) residuals, and their standard deviations in m or px.
    by_parameter
        (n, k) derivative by the free parameters, per tolerance.
    by_pose
        (n, 6) derivative by the displacement: rotation vector (rad) about `Equations.centre`, then translation (m);
        (n, 0) where the pose is known.
    distance
        (n,) signed distance of the point from the target, m; NaN for corners.
    normal
        (n, 3) of the target at the point, in the sensor frame; NaN for corners.
    point
        (n, 3) triangulated point, m; NaN for corners.
    exposure
        (n,) index of the exposure.
    """

    residual: Array
    deviation: Array
    by_parameter: Array
    by_pose: Array
    distance: Array
    normal: Array
    point: Array
    exposure: NDArray[np.intp]

    @classmethod
    def joined(cls, blocks: list[Block]) -> Block:
        """One block of several of the same mounting."""
        return cls(*(np.concatenate([getattr(block, one.name) for block in blocks]) for one in fields(cls)))

    def chosen(self, rows: Rows) -> Block:
        """Some of the residuals."""
        return Block(*(getattr(self, one.name)[rows] for one in fields(Block)))

    def with_deviations_of(self, other: Block) -> Block:
        """The residuals in the standard deviations of another block of the same measurements."""
        ratio = self.deviation / other.deviation
        return replace(
            self,
            residual=self.residual * ratio,
            deviation=other.deviation,
            by_parameter=self.by_parameter * ratio[:, None],
            by_pose=self.by_pose * ratio[:, None],
        )


class Equations:
    """Residuals of a problem as a function of its unknowns."""

    def __init__(self, problem: SensorProblem, parameters: SensorParameters) -> None:
        self._parameters = parameters
        self._exposures = problem.exposures
        self._targets = [ShapeGroup(one.target.measured) for one in problem.exposures]
        self.mountings = list(dict.fromkeys(one.mounting for one in problem.exposures))
        limits = problem.sensor.range
        self.centre = np.array([0.0, 0.0, 1e-3 * (limits.near_mm + limits.far_mm) / 2])
        peaks = [one.stripe for one in problem.exposures if one.stripe is not None]
        counts = [0 if one.stripe is None else len(one.stripe.row) for one in problem.exposures]
        self._first = np.cumsum([0, *counts])
        self._camera = np.concatenate([np.zeros(0, np.int32), *(one.camera for one in peaks)])
        self._sigma = np.concatenate([np.zeros(0), *(one.sigma for one in peaks)])
        self._pixels = np.concatenate([np.zeros((0, 2)), *(np.column_stack([one.column, one.row]) for one in peaks)])
        if not (self._sigma > 0.0).all():
            raise CalibrationError("stripe peaks: every row needs a positive standard deviation, px")

    def blocks(self, state: State) -> list[Block]:
        """Linearised residuals of every mounting, in the order of `mountings`."""
        sensor, steps = self._parameters.sensor, _STEP * np.diag(self._parameters.scales)
        base = sensor(state.values)
        pairs = [(sensor(state.values + step), sensor(state.values - step)) for step in steps]
        points = self._points(base)
        per_row = (self._points(base, np.array([0.0, _ROW_STEP])) - points) / _ROW_STEP
        derivative = np.zeros((len(points), len(pairs), 3))
        for k, (up, down) in enumerate(pairs):
            derivative[:, k] = (self._points(up) - self._points(down)) / (2 * _STEP)
        found: dict[int | None, list[Block]] = {mounting: [] for mounting in self.mountings}
        for e, exposure in enumerate(self._exposures):
            rows = slice(int(self._first[e]), int(self._first[e + 1]))
            if exposure.stripe is not None:
                block = self._stripe(e, state, points[rows], per_row[rows], derivative[rows], self._sigma[rows])
                found[exposure.mounting].append(block)
            if exposure.corners is not None:
                found[exposure.mounting].append(self._corners(e, exposure.corners, state, base, pairs))
        return [Block.joined(blocks) for blocks in found.values()]

    def _stripe(self, e: int, state: State, points: Array, per_row: Array, derivative: Array, sigma: Array) -> Block:
        exposure = self._exposures[e]
        sensor_from_target = state.displacement[exposure.mounting] @ exposure.sensor_from_target
        target = self._targets[e]
        distance, in_target, index = _nearest(target, pose.transform_points(pose.inverse(sensor_from_target), points))
        normal = in_target @ sensor_from_target[:3, :3].T
        is_sphere = np.array([isinstance(one.shape, Sphere) for one in target.shapes])[index]
        distance = distance - is_sphere * self._parameters.radius_offset(state.values)
        by_parameter = np.einsum("ni,nki->nk", normal, derivative)
        if RADIUS_OFFSET in self._parameters.names:
            k = self._parameters.names.index(RADIUS_OFFSET)
            by_parameter[:, k] = -1e-3 * self._parameters.scales[k] * is_sphere
        by_pose = -np.hstack([np.cross(points - self.centre, normal), normal])
        least = _LEAST_INCIDENCE * np.linalg.norm(per_row, axis=1)
        deviation = sigma * np.maximum(np.abs(np.sum(normal * per_row, 1)), least)
        return Block(
            distance / deviation,
            deviation,
            by_parameter / deviation[:, None],
            _unless_known(by_pose / deviation[:, None], exposure),
            distance,
            normal,
            points,
            np.full(len(points), e),
        )

    def _corners(
        self,
        e: int,
        corners: Corners,
        state: State,
        base: sensor_rt.Sensor,
        pairs: list[tuple[sensor_rt.Sensor, sensor_rt.Sensor]],
    ) -> Block:
        exposure = self._exposures[e]
        sensor_from_target = state.displacement[exposure.mounting] @ exposure.sensor_from_target
        points = pose.transform_points(sensor_from_target, corners.points_in_target)

        def seen(sensor: sensor_rt.Sensor, points: Array) -> Array:
            cameras = sensor.cameras
            return _by_camera(corners.camera, points, 2, lambda camera, rows: cameras[camera].project(rows))

        residual = seen(base, points) - corners.pixels
        by_parameter = np.zeros((*residual.shape, len(pairs)))
        for k, (up, down) in enumerate(pairs):
            by_parameter[:, :, k] = (seen(up, points) - seen(down, points)) / (2 * _STEP)
        steps = _POINT_STEP * np.eye(3)
        by_point = np.stack([seen(base, points + one) - seen(base, points - one) for one in steps], 2)
        by_point /= 2 * _POINT_STEP
        by_pose = np.concatenate([np.cross((points - self.centre)[:, None], by_point), by_point], 2)
        count = residual.size
        return Block(
            residual.reshape(count) / corners.sigma,
            np.full(count, corners.sigma),
            by_parameter.reshape(count, -1) / corners.sigma,
            _unless_known(by_pose.reshape(count, 6) / corners.sigma, exposure),
            np.full(count, np.nan),
            np.full((count, 3), np.nan),
            np.full((count, 3), np.nan),
            np.full(count, e),
        )

    def _points(self, sensor: sensor_rt.Sensor, shift: Array | float = 0.0) -> Array:
        def locate(camera: int, pixels: Array) -> Array:
            return sensor_rt.triangulate_pixels(pixels, sensor, camera, "sheet")

        return _by_camera(self._camera, self._pixels + shift, 3, locate)


def _nearest(target: ShapeGroup, points: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Nearest points of a group of shapes, see `ShapeGroup.nearest`, but rectangles continue beyond their edges.

    The stripe ends at an edge. A point beyond it is displaced along the surface, which says nothing of its distance.
    """
    distance, normal, index = target.nearest(points)
    for number, placed in enumerate(target.shapes):
        if isinstance(placed.shape, Plane):
            own = index == number
            normal[own] = placed.frame_from_shape[:3, 2]
            distance[own] = (points[own] - placed.frame_from_shape[:3, 3]) @ placed.frame_from_shape[:3, 2]
    return distance, normal, index


def _unless_known(by_pose: Array, exposure: TargetExposure) -> Array:
    return by_pose[:, :0] if exposure.mounting is None else by_pose


def _by_camera(camera: NDArray[np.int32], rows: Array, width: int, call: Callable[[int, Array], Array]) -> Array:
    """Results (n, width) of a call for the rows of each camera."""
    result = np.zeros((len(rows), width))
    for one in np.unique(camera):
        own = camera == one
        result[own] = call(int(one), rows[own])
    return result


def normal_equations(blocks: Sequence[Block]) -> NormalEquations:
    """Normal equations of the parameters, in tolerances, then of the displacement (rad, m) of each mounting."""
    parameters = blocks[0].by_parameter.shape[1]
    ends = np.cumsum([parameters, *(block.by_pose.shape[1] for block in blocks)])
    information, gradient, squares = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1]), 0.0
    for block, first, end in zip(blocks, ends, ends[1:], strict=False):
        own = np.r_[0:parameters, first:end]
        rows = np.hstack([block.by_parameter, block.by_pose])
        information[np.ix_(own, own)] += rows.T @ rows
        gradient[own] -= rows.T @ block.residual
        squares += float(block.residual @ block.residual)
    return NormalEquations(information, gradient, squares, squares)
