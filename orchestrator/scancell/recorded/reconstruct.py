"""Reconstruction of real measurements: the same as that of a scan, from joints or from poses of the flange."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.calibration.cell.kinematics import LATENCY, AxisReadings
from scancell.calibration.cell.points import belt_axes, described_cell
from scancell.calibration.cell.problem import Artefact, CalibrationProblem, Observations, surface_of
from scancell.calibration.cell.report import start_of
from scancell.calibration.cell.scan import kinematics_of, on_artefact
from scancell.calibration.cell.solve import solve
from scancell.calibration.pose_files import refuse_misread, refuse_wrong
from scancell.calibration.sensor.problem import RADIUS_OFFSET, SensorParameters
from scancell.cell.recording import TriggerRecords
from scancell.config.cell import CellDescription, EstimatedDescription, EstimatedToolDescription, sensor_frame
from scancell.config.choices import LatencyWord
from scancell.config.loading import Setup
from scancell.config.robot import MAX_JOINTS
from scancell.config.sensor import SensorDescription
from scancell.errors import CalibrationError, DescriptionError, EmptyScanError
from scancell.evaluation.alignment import PartPlacement, place_part, pose_values
from scancell.files import read_json
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.geometry.shapes import PartSurface
from scancell.nominal.cell import NominalCell, estimated_cell
from scancell.nominal.parts import lay_down
from scancell.reconstruction.foreign import neighbours_of
from scancell.reconstruction.reconstruct import (
    Envelope,
    PosesAfter,
    ProfilePoints,
    Reconstructed,
    points_in_part,
    reconstruct_sensors,
    table_warnings,
    why_empty,
)
from scancell.recorded.measurements import Measurements
from scancell.scanning.pipeline import envelope_of

_STEP = 1e-5  # m, rad, s: half the interval of difference quotients by deviations of the cell
_SENSOR_STEP = 1e-3  # of a parameter's tolerance: the same by keys of the sensor
_BLOCK = 1 << 16  # points at a time, which bounds the memory

Derivatives = Callable[[slice], Iterator[Array]]
"""Derivatives (m, 3) of some points by each value, m per unit of the value."""

_DIGITS = 12  # of mm and deg

AGREED = 2e-3  # m: median distance of points from the part up to which readings are taken to be right
_WRONG = 3e-3  # m: and ten times the median, from which an exposure disagrees with the others
_SAMPLE = 4000  # points that are compared
_MUCH_BETTER = 1 / 3
_LEAST_POINTS = 20  # on the part, of an exposure that is compared
_MOST_NAMED = 5

# What turns points (n, 3) of the sensor frame into those of another reading of the columns.
_POINT_READINGS: dict[str, Array] = {
    "with y_mm mirrored": np.diag([1.0, -1.0, 1.0]),
    "with y_mm and z_mm swapped": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "with z_mm of the opposite sign": np.diag([1.0, 1.0, -1.0]),
    "with x_mm and y_mm swapped": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "with lengths in m in place of mm": 1e3 * np.eye(3),
}

PointsInPart = Callable[[AxisReadings, Array, NDArray[np.intp]], Array]

_NO_PART = box_mesh((1e-9, 1e-9, 1e-9), "no part").transformed(pose.translation((0.0, 0.0, 1e3)))
_EVERYWHERE = Envelope(-np.inf, np.inf, np.inf)


@dataclass(frozen=True)
class ValueCovariance:
    """Covariance (k, k) of calibrated values by name.

    They are deviations of the cell, such as ``tool.x``, in SI, or, with `of_sensor`, keys of the sensor in the units of
    the keys.
    """

    names: tuple[str, ...]
    covariance: Array
    of_sensor: bool


def propagated(covariance: Array, derivatives: Derivatives, count: int) -> Array:
    """Covariances (count, 3, 3) of points, m², by the covariance (k, k) of values."""
    found = np.empty((count, 3, 3))
    for start in range(0, count, _BLOCK):
        rows = slice(start, min(start + _BLOCK, count))
        jacobian = np.stack([*derivatives(rows)], -1)
        found[rows] = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    return found


def by_poses(
    names: tuple[str, ...],
    poses: Callable[[str, float], Array],
    points_in_sensor: Array,
    frame: NDArray[np.intp],
) -> Derivatives:
    """Derivatives of points (m, 3), m, of exposures (m,) by deviations of the cell.

    `poses` gives the poses (n, 4, 4) of the sensor of all exposures with a deviation changed by an amount, SI.
    """
    slopes = [(poses(name, _STEP) - poses(name, -_STEP)) / (2 * _STEP) for name in names]

    def derivatives(rows: slice) -> Iterator[Array]:
        for slope in slopes:
            turn, shift = slope[frame[rows], :3, :3], slope[frame[rows], :3, 3]
            yield np.einsum("nij,nj->ni", turn, points_in_sensor[rows]) + shift

    return derivatives


def by_sensor(
    names: tuple[str, ...],
    sensor: SensorDescription,
    points_in_sensor: Array,
    camera: NDArray[np.integer],
    turn: Callable[[slice], Array],
) -> Derivatives:
    """Derivatives of points (m, 3), m, by keys of the sensor.

    The pixel of a point is that at which its camera (m,) sees it; points merged from several cameras (-1) move by the
    mean of all cameras. `turn` gives rotations (m, 3, 3) from the sensor to the frame of the cloud.

    Raises `DescriptionError` if the sensor has no such camera.
    """
    parameters = SensorParameters(sensor, names)
    values, steps = parameters.start_values, _SENSOR_STEP * parameters.scales
    base = parameters.sensor(values)
    moved = [[parameters.sensor(values + sign * step) for sign in (1, -1)] for step in np.diag(steps)]
    cameras = range(len(base.cameras))
    if len(camera) and camera.max() >= len(cameras):
        raise DescriptionError(
            "of a point is none of the sensor's", key="camera", value=int(camera.max()), expected=f"0 to {cameras[-1]}"
        )

    def moves(pair: list[sensor_rt.Sensor], step: float, pixels: Array, number: int) -> Array:
        up, down = (sensor_rt.triangulate_pixels(pixels, one, number, "sheet") for one in pair)
        return np.asarray((up - down) / (2 * step))

    def derivatives(rows: slice) -> Iterator[Array]:
        points, own, rotation = points_in_sensor[rows], camera[rows], turn(rows)
        # Of each camera: rows of points, and their pixels.
        seen = [np.flatnonzero((own == number) | (own < 0)) for number in cameras]
        pixels = [base.cameras[number].project(points[chosen]) for number, chosen in zip(cameras, seen, strict=True)]
        weight = np.where(own < 0, 1.0 / len(cameras), 1.0)
        for pair, step in zip(moved, steps, strict=True):
            found = np.zeros_like(points)
            for number in cameras:
                chosen = seen[number]
                found[chosen] += weight[chosen, None] * moves(pair, float(step), pixels[number], number)
            yield np.einsum("nij,nj->ni", rotation, found)

    return derivatives


@dataclass(frozen=True)
class FoundByCalibration:
    """Files with the calibrated cell and sensor, pose (4, 4) of the sensor on the flange, quarter turns of images.

    None where the calibration did not find it. The pose is that of a calibration by images of a board; that of a cell
    is in its `cell`. `uncertainty` holds those of a cell's deviations and of a sensor's keys, where they are stated.
    """

    cell: Path | None
    sensor: Path | None
    flange_from_sensor: NDArray[np.float64] | None
    quarter_turns: int = 0
    uncertainty: tuple[ValueCovariance, ...] = ()


def read_calibration(folder: Path) -> FoundByCalibration:
    """Values and uncertainties in a folder of results of `scancell calibrate`, or in its ``calibration.json``.

    Raises `DescriptionError` naming the file, key and what was expected.
    """
    file = folder / "calibration.json" if folder.is_dir() else folder
    if not file.exists():
        raise DescriptionError("no such file", file=file, expected="results of `scancell calibrate`")
    found = read_json(file)
    if not isinstance(found, dict):
        raise DescriptionError("is not a JSON object", file=file, expected="the JSON of a calibration")
    cell, sensor = (file.parent / name for name in ("calibrated.toml", "calibrated_sensor.toml"))
    by_images = "quarter_turns" in found
    turns = found.get("quarter_turns", 0)
    if turns not in (0, 1, 2, 3):
        raise DescriptionError(file=file, key="quarter_turns", value=turns, expected="0, 1, 2 or 3")
    return FoundByCalibration(
        cell if cell.is_file() else None,
        sensor if sensor.is_file() else None,
        _pose(found.get("flange_from_sensor_m"), file) if by_images else None,
        int(turns),
        _uncertainty(found, file),
    )


def _uncertainty(found: dict[str, Any], file: Path) -> tuple[ValueCovariance, ...]:
    """Covariances of deviations of the cell and of keys of the sensor; that of a board's calibration is neither."""
    stated = []
    for rows, key, of_sensor in (("deviations", "covariance_si", False), ("parameters", "covariance", True)):
        if rows not in found or key not in found:
            continue
        try:
            names = tuple(str(row["name"]) for row in found[rows])
            matrix = np.asarray(found[key], float)
        except (KeyError, TypeError, ValueError):
            raise DescriptionError(file=file, key=key, value=found[key], expected="numbers, and names") from None
        is_covariance = (
            matrix.shape == (len(names), len(names))
            and np.isfinite(matrix).all()
            and np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0)
            and bool((np.diag(matrix) >= 0.0).all())
        )
        if not is_covariance:
            expected = f"a covariance, {len(names)} x {len(names)}, one row for each of {rows}"
            raise DescriptionError(file=file, key=key, value=f"an array {matrix.shape}", expected=expected)
        if not of_sensor:
            _require_deviations(names, file)
        kept = [row for row, name in enumerate(names) if name != RADIUS_OFFSET]  # belongs to the target
        stated.append(ValueCovariance(tuple(names[row] for row in kept), matrix[np.ix_(kept, kept)], of_sensor))
    return tuple(stated)


def _require_deviations(names: tuple[str, ...], file: Path) -> None:
    try:
        EstimatedDescription.of(dict.fromkeys(names, 0.0), MAX_JOINTS)
    except DescriptionError as error:
        raise DescriptionError(str(error), file=file, key="deviations") from None


def _pose(values: Any, file: Path) -> NDArray[np.float64]:
    try:
        matrix = np.asarray(values, float)
        is_pose = matrix.shape == (4, 4) and bool(
            np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max() < 1e-6
            and np.linalg.det(matrix[:3, :3]) > 0
            and (matrix[3] == [0, 0, 0, 1]).all()
        )
    except (TypeError, ValueError):
        is_pose = False
    if not is_pose:
        raise DescriptionError(file=file, key="flange_from_sensor_m", value=values, expected="a pose, 4 x 4")
    return matrix


def with_sensor_at(cell: CellDescription, flange_from_sensor: NDArray[np.float64]) -> CellDescription:
    """The cell with the sensor at a pose (4, 4) on the flange, which includes what was estimated of it before."""
    turn = np.degrees(pose.euler_xyz_from_rotation(flange_from_sensor[:3, :3]))
    place = 1e3 * flange_from_sensor[:3, 3]
    values = [round(float(value), _DIGITS) for value in (*place, *turn)]
    names = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    tool = cell.tool.replace({"fixture": None, "flange_from_sensor": dict(zip(names, values, strict=True))})
    estimated = cell.estimated
    if estimated is not None:
        estimated = estimated.model_copy(update={"tool": EstimatedToolDescription()})
    return cell.model_copy(update={"tool": tool, "estimated": estimated})


def with_part_at(setup: Setup, part: Mesh, support_from_part: NDArray[np.float64]) -> Setup:
    """The descriptions with the part at a pose (4, 4) on what carries it in the scan."""
    values, described = pose_values(support_from_part), setup.cell.part
    if setup.scan.belt is not None and described.arrival is not None:
        described = described.replace({"arrival": described.arrival.replace({"pose": values})})
    else:
        turned = described.replace({**values, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 0.0, "fixture": "clamped"})
        offset = 1e3 * (support_from_part - lay_down(part, turned))[:3, 3]
        described = turned.replace({f"{axis}_mm": float(value) for axis, value in zip("xyz", offset, strict=True)})
    return replace(setup, cell=setup.cell.model_copy(update={"part": described}))


@dataclass(frozen=True)
class Latency:
    """A delay, s; `half_width` is that of its 95 % interval where it was estimated, else None."""

    value: float
    half_width: float | None = None


def estimate_latency(found: Measurements, nominal: NominalCell, start: Mapping[str, float], has_part: bool) -> Latency:
    """The delay at which the points of the part agree best, as `scancell calibrate latency` estimates it.

    The pose of the part is found as well: what determines the delay is that points of motions in different directions
    agree with one shape.

    Raises `CalibrationError` if rates or the part are not given, or the measurements do not determine the delay.

    Parameters
    ----------
    nominal
        The cell with its part.
    start
        Deviations of the cell by name, SI, with the delay to start from.
    """
    if found.stated is not None:
        raise CalibrationError(
            "flange poses state no rates, without which a delay cannot be estimated",
            file=found.poses_file,
            expected="joints with rates (q1_deg, qd1_deg_s, …), or `latency_ms` as a number",
        )
    if not found.moves:
        raise CalibrationError(
            "all rates are 0: exposures at rest do not depend on a delay",
            file=found.poses_file,
            key="columns 'qd1_deg_s' …, 'table_rate_deg_s'",
            expected="the rates at which joints and table moved",
        )
    if not has_part:
        raise CalibrationError(
            "is estimated from the agreement of points with a part", key="latency_ms", expected="`part`, or a number"
        )
    if nominal.support_kind == "belt":
        raise CalibrationError(
            "is not estimated from a part on a belt: a delay shifts it along the belt", key="latency_ms",
            value="estimate", expected="a number",
        )  # fmt: skip
    profiles = found.profiles
    good = np.asarray(profiles.flags) == 0
    points = np.asarray(profiles.points_in_sensor, float)[good]
    observations = Observations(
        readings=found.readings,
        points_in_sensor=points,
        sigma=np.asarray(profiles.sigma, float)[good],
        direction=found.directions[good],
        frame=np.asarray(profiles.frame, np.intp)[good],
        time_offset=np.asarray(profiles.time_offset, float)[good],
    )
    problem = CalibrationProblem(
        kinematics=kinematics_of(nominal),
        observations=observations,
        artefact=Artefact(surface_of(nominal.part), nominal.table_from_part, False),
        free=(LATENCY,),
        start=start,
    )
    result = solve(replace(problem, observations=observations.chosen(on_artefact(problem))))
    return Latency(float(result.values[0]), float(result.half_widths(0.95)[0]))


def check_readings(found: Measurements, surface: PartSurface, in_part: PointsInPart) -> None:
    """Raise `CalibrationError` if the points lie far from the part, and near it by another reading of the file.

    `in_part` gives points (k, 3) in the part frame of readings, points in the sensor frame and their exposures.
    """
    points = np.asarray(found.profiles.points_in_sensor, float)
    rows = np.unique(np.linspace(0, len(points) - 1, min(_SAMPLE, len(points))).astype(np.intp))
    points, frame = points[rows], np.asarray(found.profiles.frame, np.intp)[rows]

    def misfit(readings: AxisReadings, moved: Array = points) -> float:
        return float(np.median(np.abs(surface.distances(in_part(readings, moved, frame))[0])))

    own = misfit(found.readings)
    if own <= AGREED:
        return
    others = [(text, misfit(readings, points @ turn.T)) for text, readings, turn in _alternatives(found)]
    text, best = min(others, key=lambda one: one[1])
    if best < _MUCH_BETTER * own and best <= AGREED:
        raise CalibrationError(
            f"the points are {1e3 * own:.3g} mm from the part (median); they are {1e3 * best:.3g} mm from it {text}",
            file=found.poses_file if text.startswith("with angles") else found.files[0],
        )
    if found.stated is not None:
        refuse_misread(
            found.stated,
            lambda flange: misfit(replace(found.readings, flange=flange)),
            "the part",
            "points from it",
            found.poses_file,
        )


def _alternatives(found: Measurements) -> Iterator[tuple[str, AxisReadings, Array]]:
    """Other readings of the columns of points and of joints."""
    for text, turn in _POINT_READINGS.items():
        yield text, found.readings, turn
    if found.stated is None:
        axes, joints = found.readings.axes.copy(), found.readings.joints
        axes[:, :joints] = np.degrees(axes[:, :joints])
        radians = replace(found.readings, axes=axes)
        yield "with angles of the joints in rad in place of deg", radians, np.eye(3)


def check_exposures(found: Measurements, frame: NDArray[np.intp], distance: Array) -> None:
    """Raise `CalibrationError` naming exposures whose points are much farther from the part than those of the others.

    `frame` (k,) and `distance` (k,), m, are of the points of the cloud.
    """
    order = np.argsort(frame, kind="stable")
    numbers, first = np.unique(frame[order], return_index=True)
    parts = np.split(np.abs(distance)[order], first[1:])
    seen = [i for i, part in enumerate(parts) if len(part) >= _LEAST_POINTS]
    if not seen:
        return
    away = np.array([float(np.median(parts[i])) for i in seen])
    limit = max(_WRONG, 10.0 * float(np.median(away)))
    refuse_wrong(
        away,
        limit,
        lambda i: found.names[numbers[seen[i]]],
        ("exposures", "distances from the part"),
        found.poses_file,
        _MOST_NAMED,
    )


@dataclass(frozen=True)
class MeasuredCell:
    """The described or calibrated cell of measurements.

    Attributes
    ----------
    cell
        With the part; without one, the part frame is the frame of the robot's base.
    has_part
        Whether there is a part.
    """

    cell: NominalCell
    has_part: bool

    @classmethod
    def of(cls, setup: Setup, part: Mesh | None) -> MeasuredCell:
        """The cell of a setup.

        Raises `ScancellError` if the part or another body cannot be used.
        """
        return cls.with_deviations(described_cell(setup, part), _deviations(setup), part is not None)

    @classmethod
    def with_deviations(cls, nominal: NominalCell, deviations: Mapping[str, float], has_part: bool) -> MeasuredCell:
        """The described cell with deviations by name, SI."""
        cell = estimated_cell(nominal, deviations) if deviations else nominal
        if not has_part and cell.holds_part:
            raise DescriptionError("a cloud on the flange needs the part that the arm holds", key="part")
        if not has_part:
            placed = cell.tree.place(cell.start, [cell.support, "base"])
            cell = cell.with_part_at(pose.inverse(placed[cell.support]) @ placed["base"])
        return cls(cell, has_part)

    @property
    def frame(self) -> str:
        """Name of the cloud's frame; that of the base is meant with the table at 0 and further axes at their start."""
        return "part" if self.has_part else "base"

    @property
    def moving(self) -> str:
        """Addition to the name of the cloud's frame that names the belt with which it moves; else empty."""
        return f" (moves with {self.cell.support})" if self.cell.support_kind == "belt" else ""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that measurements state: those of the cell, and the belts up to that of the part."""
        return (*self.cell.axes, *belt_axes(self.cell))

    def part_from_sensor(self, readings: AxisReadings, number: int = 1) -> Array:
        """Poses (n, 4, 4) of a sensor, by its number, in the frame of the cloud."""
        world_from_sensor = self.world_from(sensor_frame(number), readings)
        return np.asarray(pose.inverse(self.world_from("part", readings)) @ world_from_sensor)

    def poses_after(self, readings: AxisReadings, number: int) -> PosesAfter:
        """`part_from_sensor` of a sensor by seconds after the readings."""
        return lambda time: self.part_from_sensor(readings.moved(time), number)

    def world_from(self, frame: str, readings: AxisReadings) -> Array:
        """Poses (n, 4, 4) of ``table``, ``part``, a sensor or the frame of a further axis in the world.

        Raises `DescriptionError` if poses of the flange do not place the sensor, which another link carries.
        """
        if readings.flange is not None:
            carrier, carrier_from_frame = self.cell.tree.carrier_of(frame, self.cell.axes)
            if carrier == self.cell.arm.flange:
                world_from_base = self.cell.world_from("base", self.all_axes(readings.axes))
                return np.asarray(world_from_base @ readings.flange @ carrier_from_frame)
            if carrier.startswith("link["):
                raise DescriptionError(
                    "poses of the flange do not place a sensor that another link carries",
                    key=f"cell.further_sensor[{int(frame[7:-1]) - 1}].moves_with",
                    value=carrier,
                    expected="joints, or a sensor on the flange, the table or in the world",
                )
        return self.cell.world_from(frame, self.all_axes(readings.axes))

    def all_axes(self, axes: Array) -> Array:
        """Positions or rates (n, axes) of all axes; 0 of joints that poses of the flange leave open."""
        return np.hstack([np.zeros((len(axes), len(self.axes) - axes.shape[1])), axes])


@dataclass(frozen=True)
class ReconstructedData:
    """A cloud with its inputs.

    Attributes
    ----------
    found, measured_cell
        Measurements, and the cell in which they were made.
    readings
        Those of the measurements, later by the latency.
    latency
        Delay of the exposures.
    made
        Cloud, rows of its points, poses.
    covariance
        (k, 3, 3) of the points of the cloud in its frame, m², by the noise of the sensor.
    systematic
        (k, 3, 3) the same by the uncertainty of calibrated values; None without.
    warnings
        What is doubtful.
    placement
        Pose of the part, where it was found from the points.
    """

    found: Measurements
    measured_cell: MeasuredCell
    readings: AxisReadings
    latency: Latency
    made: Reconstructed
    covariance: Array
    systematic: Array | None
    warnings: tuple[str, ...]
    placement: PartPlacement | None = None


def records_of(cell: MeasuredCell, found: Measurements, readings: AxisReadings) -> TriggerRecords:
    """Records of a controller; the joints are 0 where poses of the flange are given."""
    axes, rates = cell.all_axes(readings.axes), cell.all_axes(readings.rates)
    return TriggerRecords(
        index=found.index,
        segment=np.ones(len(readings), np.int64),
        time=found.time,
        exposure=np.zeros(len(readings)),
        names=cell.axes,
        axes=axes,
        rates=rates,
    )


def reconstruct_measurements(
    found: Measurements,
    setup: Setup,
    part: Mesh | None,
    latency: float | LatencyWord | None,
    keep_all: bool,
    threads: int,
    uncertainty: Sequence[ValueCovariance] = (),
    locate: bool = False,
) -> ReconstructedData:
    """The cloud of measurements; with a part, points on the table and on its neighbours are removed as in a scan.

    Raises `CalibrationError` if the latency cannot be applied or estimated, or the measurements disagree with the part;
    `EmptyScanError` if no point is left.

    Parameters
    ----------
    latency
        Delay of the exposures, s, ``estimate``, or None for that of the cell's description.
    keep_all
        Whether points that are not the part's stay.
    uncertainty
        Uncertainty of calibrated values; those of different calibrations are independent.
    locate
        Whether the pose of the part on what carries it is found from the points, not that of the description.
    """
    measured_cell = MeasuredCell.of(setup, part)
    cell = measured_cell.cell
    delay = _latency(found, setup, measured_cell, latency)
    readings = found.readings.after(delay.value)
    surface = None if part is None else PartSurface(part)
    sensors = range(1, len(cell.further_sensors) + 2)
    if len(found.profiles.frame) and int(found.profiles.sensor.max()) not in sensors:
        raise DescriptionError(
            "the cell has no such sensor",
            file=found.files[0],
            key="column 'sensor'",
            value=int(found.profiles.sensor.max()),
            expected=f"1 to {len(sensors)}",
        )
    poses = [measured_cell.poses_after(readings, number) for number in sensors]
    placement = None
    if locate:
        if part is None or surface is None:
            raise DescriptionError("is found from the points of a part", key="locate", value=True, expected="`part`")
        placement = _located(found, measured_cell, readings, poses, setup, surface, threads)
        measured_cell = replace(measured_cell, cell=cell.with_part_at(placement.support_from_part))
        cell = measured_cell.cell
        poses = [measured_cell.poses_after(readings, number) for number in sensors]
    main = found.of_main_sensor()
    if surface is not None and len(main.profiles.frame):
        check_readings(
            replace(main, readings=readings),
            surface,
            lambda other, points, frame: points_in_part(points, frame, measured_cell.part_from_sensor(other)),
        )
    whole = keep_all or part is None
    neighbours, notes = None if whole else neighbours_of(cell), list[str]()
    if neighbours is not None and neighbours.carried is not None and readings.flange is not None:
        neighbours = replace(neighbours, carried=None)
        notes = ["points on the arm stay in the cloud: poses of the flange do not state where its links are"]
    envelope = _EVERYWHERE if whole else envelope_of(cell, setup)
    made = reconstruct_sensors(
        found.profiles,
        records_of(measured_cell, found, readings),
        poses,
        cell.support_from_part,
        envelope,
        neighbours=neighbours,
        threads=threads,
    )
    if not len(made.cloud):
        why = why_empty(made.dropped, envelope) if len(found.profiles.frame) else ["no stripe was found in any image"]
        why = [*why, *found.notes]
        raise EmptyScanError(f"the measurements give no point: {'; '.join(why)}", file=found.files[0])
    frame = np.asarray(found.profiles.frame, np.intp)[made.rows]
    if surface is not None:
        distance = surface.distances(made.cloud.points_in_part, threads)[0]
        check_exposures(found, frame, distance)
        away = float(np.median(np.abs(distance)))
        if away > AGREED and not locate:
            notes.append(
                f"the points are {1e3 * away:.3g} mm from the part (median): does it lie where the description "
                "places it? `locate` finds its pose"
            )
    turn = made.poses_of(found.profiles[made.rows])[:, :3, :3]
    covariance = turn @ found.covariance[made.rows] @ np.swapaxes(turn, 1, 2)
    warnings = [*found.notes, *notes, *([] if whole else table_warnings(made.dropped, setup.scan.table_margin_mm))]
    empty = len(found.index) - len(np.unique(found.profiles.frame))
    if empty:
        warnings.append(f"{empty} of {len(found.index)} exposures give no point")
    parts = [_systematic(one, found, setup, measured_cell, readings, made) for one in uncertainty]
    systematic = np.sum(parts, axis=0) if parts else None
    warnings += [] if placement is None else placement.warnings
    return ReconstructedData(
        found, measured_cell, readings, delay, made, covariance, systematic, tuple(warnings), placement
    )


def _located(
    found: Measurements,
    measured: MeasuredCell,
    readings: AxisReadings,
    poses: Sequence[PosesAfter],
    setup: Setup,
    surface: PartSurface,
    threads: int,
) -> PartPlacement:
    """The pose of the part by all points above its support that are on no other body."""
    cell = measured.cell
    # Neighbours do not touch the part, and the envelope has no outline: where the part is is not known.
    neighbours = replace(neighbours_of(cell), part=_NO_PART)
    if readings.flange is not None:
        neighbours = replace(neighbours, carried=None)
    envelope = replace(envelope_of(cell, setup), footprint=None, outline=None)
    made = reconstruct_sensors(
        found.profiles,
        records_of(measured, found, readings),
        poses,
        cell.support_from_part,
        envelope,
        normals=False,
        neighbours=neighbours,
        threads=threads,
    )
    if not len(made.cloud):
        raise EmptyScanError(
            f"no point to find the part by: {'; '.join(why_empty(made.dropped, envelope))}", file=found.files[0]
        )
    return place_part(
        pose.transform_points(cell.support_from_part, made.cloud.points_in_part),
        lambda at: surface.nearest(at, threads),
        cell.part.bounds,
        cell.support,
        cell.support_from_part,
    )


def _systematic(
    uncertainty: ValueCovariance,
    found: Measurements,
    setup: Setup,
    measured: MeasuredCell,
    readings: AxisReadings,
    made: Reconstructed,
) -> Array:
    """Covariances (k, 3, 3) of the points of the cloud, m², by that of calibrated values."""
    profiles = found.profiles[made.rows]
    result = np.zeros((len(profiles.frame), 3, 3))
    for number in np.unique(profiles.sensor).tolist():
        own = np.flatnonzero(profiles.sensor == number)
        if uncertainty.of_sensor and number != 1:  # the keys are those of the main sensor
            continue
        of_sensor = (profiles[own], setup, measured, readings, made, number)
        result[own] = propagated(uncertainty.covariance, derivatives_of(uncertainty, *of_sensor), len(own))
    return result


def derivatives_of(
    uncertainty: ValueCovariance,
    profiles: ProfilePoints,
    setup: Setup,
    measured: MeasuredCell,
    readings: AxisReadings,
    made: Reconstructed,
    number: int,
) -> Derivatives:
    """Derivatives of the points of one sensor, by its number, by calibrated values."""
    frame, points = np.asarray(profiles.frame, np.intp), np.asarray(profiles.points_in_sensor, float)
    if uncertainty.of_sensor:
        camera = np.asarray(profiles.camera)
        return by_sensor(
            uncertainty.names, setup.sensor, points, camera, lambda rows: made.part_from_sensor[frame[rows], :3, :3]
        )
    nominal, deviations = nominal_cell_of(measured, setup), _deviations(setup)

    def poses(name: str, change: float) -> Array:
        if name == LATENCY:
            return measured.part_from_sensor(readings.after(change), number)
        moved = {**deviations, name: deviations.get(name, 0.0) + change}
        return MeasuredCell.with_deviations(nominal, moved, measured.has_part).part_from_sensor(readings, number)

    return by_poses(uncertainty.names, poses, points, frame)


def _deviations(setup: Setup) -> dict[str, float]:
    """Estimated deviations of the described cell by name, SI."""
    return {} if setup.cell.estimated is None else setup.cell.estimated.deviations()


def _latency(found: Measurements, setup: Setup, measured: MeasuredCell, wanted: float | LatencyWord | None) -> Latency:
    if isinstance(wanted, str):
        return estimate_latency(
            found.of_main_sensor(), nominal_cell_of(measured, setup), start_of(setup), measured.has_part
        )
    value = measured.cell.trigger_latency if wanted is None else wanted
    if wanted and not found.moves:
        missing = "flange poses state no rates" if found.stated is not None else "all rates are 0"
        raise CalibrationError(
            f"{missing}: a delay has no effect",
            file=found.poses_file,
            key="latency_ms",
            value=1e3 * wanted,
            expected="joints with rates (q1_deg, qd1_deg_s, …)",
        )
    return Latency(value)


def nominal_cell_of(measured: MeasuredCell, setup: Setup) -> NominalCell:
    """The described cell, without what was estimated, with the part of a measured one."""
    return described_cell(setup, measured.cell.part if measured.has_part else None)
