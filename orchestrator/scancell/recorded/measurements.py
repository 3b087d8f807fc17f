"""Measurements of a real sensor on a robot, from a table of profile points or a folder of images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.calibration.board.views import pose_table
from scancell.calibration.cell.kinematics import AxisReadings, axis_column
from scancell.calibration.cell.points import Missing, read_axes, read_points
from scancell.calibration.measured_table import MeasuredTable, read_profiles, write_measured_table
from scancell.calibration.pose_files import flange_columns, has_flange, read_flange
from scancell.config.cell import MAX_FURTHER_SENSORS
from scancell.config.sensor import SensorDescription
from scancell.config.table_format import FormatDescription
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.orientation import StatedPoses
from scancell.geometry.tree import Joint
from scancell.nominal.cell import NominalCell
from scancell.output.extract_images import extract_profiles, rejection_text
from scancell.output.image_files import ImageSet
from scancell.progress import Progress
from scancell.reconstruction.cloud_files.read import cloud_of_profiles, missing_value, read_cloud_file
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.sense import row_time_offset
from scancell.scanning.world import make_sensor
from scancell.values import Value

_MOST_RAD = 2.0 * np.pi + 1e-6  # of an angle; degrees exceed it
_MOST_NUMBER = 2**31 - 1

_LEAST_GAP = 0.2  # of the range of all heights, between them and the value of missing points


@dataclass(frozen=True, eq=False, repr=False)
class Measurements(Value):
    """Profiles of n exposures with the readings of the robot, in the order of the exposures.

    Attributes
    ----------
    names, index, time
        Names, index and time of the exposures (n,): for messages, as numbers of profiles, and s.
    readings
        Joints, or poses of the flange, and table angles.
    profiles
        Points (m) in the sensor frame; `frame` is the row of the exposure.
    covariance
        (m, 3, 3) of the points, sensor frame, m²: the noise of the sensor alone.
    stated, poses_file
        Poses of the flange as stated, None where joints are given; and the table of poses or joints.
    files
        All files that were read.
    notes
        What was left out of them, and why.
    """

    names: tuple[str, ...]
    index: NDArray[np.int64]
    time: Array
    readings: AxisReadings
    profiles: ProfilePoints
    covariance: Array
    stated: StatedPoses | None
    poses_file: Path
    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether rates of joints or table are stated that are not 0."""
        return bool(self.readings.rates.any())

    @property
    def directions(self) -> Array:
        """Unit vectors (m, 3) of the largest standard deviation, towards larger z; z where there is none."""
        vectors = np.linalg.eigh(self.covariance)[1][:, :, -1]
        vectors = vectors * np.where(vectors[:, 2:] < 0, -1.0, 1.0)
        is_known = np.any(self.covariance != 0.0, axis=(1, 2))
        return np.where(is_known[:, None], vectors, [0.0, 0.0, 1.0])

    def of_main_sensor(self) -> Measurements:
        """Those of the main sensor alone."""
        own = self.profiles.sensor == 1
        return self if own.all() else replace(self, profiles=self.profiles[own], covariance=self.covariance[own])

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Columns (m,) of the table of points that `read_table_of` reads again."""
        readings, profiles = self.readings, self.profiles
        frame = np.asarray(profiles.frame, np.intp)
        by_exposure: dict[str, NDArray[np.generic]] = {"exposure": self.index, "time_s": self.time}
        if readings.flange is not None:
            by_exposure |= flange_columns(readings.flange)
        by_exposure |= readings.columns()
        direction = self.directions
        points = 1e3 * np.asarray(profiles.points_in_sensor, float)
        columns: dict[str, NDArray[np.generic]] = {
            **{name: values[frame] for name, values in by_exposure.items()},
            **{f"{axis}_mm": points[:, i] for i, axis in enumerate("xyz")},
            **{f"error_{axis}": direction[:, i] for i, axis in enumerate("xyz")},
            "sigma_um": 1e6 * np.asarray(profiles.sigma, float),
            "time_offset_ms": 1e3 * np.asarray(profiles.time_offset, float),
            "camera": np.asarray(profiles.camera, np.int64),
            "column_px": np.asarray(profiles.column, np.int64),
            "intensity_dn": np.asarray(profiles.intensity, float),
            "flags": np.asarray(profiles.flags, np.int64),
        }
        if (profiles.sensor != 1).any():
            columns["sensor"] = profiles.sensor.astype(np.int64)
        if readings.flange is not None:
            del columns["time_offset_ms"]  # poses state no rates
        return columns

    def write(self, path: Path) -> None:
        """Write the table of points: CSV or Parquet, by the suffix.

        Raises `OutputError` if the file cannot be written.
        """
        write_measured_table(path, self.columns())


def read_measurements(
    data: Path,
    sensor: SensorDescription,
    joints: int,
    further: Sequence[Joint] = (),
    *,
    flange: Path | None,
    convention: str | None,
    laser_off: Path | None,
    quarter_turns: int,
    threads: int,
    progress: Progress,
    form: FormatDescription | None = None,
    missing: Missing | None = None,
) -> Measurements:
    """Measurements of a table of points, of profiles in a format of a sensor, or of a folder of images.

    Raises `ScancellError` naming file, key, value and what was expected.

    Parameters
    ----------
    joints, further
        Number of joints of the arm, and axes of the cell beside joints and table.
    flange, convention
        Table of flange poses of the exposures of a table of points, and convention of orientations whose columns do
        not state it.
    laser_off, quarter_turns
        Of images: folder of background images, and turns to the images of the described camera.
    form
        Format of the profiles, which needs `flange`, or `missing` joints.
    missing
        What replaces positions of axes that the table lacks.
    """
    if data.is_dir() and form is None:
        if flange is not None:
            raise DescriptionError("applies to a table of points; a folder of images holds its poses", key="flange")
        return read_images_of(
            data, sensor, joints, convention, laser_off, quarter_turns, threads, progress, further, missing
        )
    for key, given in (("laser_off", laser_off is not None), ("quarter_turns", quarter_turns != 0)):
        if given:
            raise DescriptionError("applies to a folder of images", key=key, value=str(data))
    return read_table_of(data, joints, flange, convention, form, further, missing)


def read_table_of(
    path: Path,
    joints: int,
    flange: Path | None = None,
    convention: str | None = None,
    form: FormatDescription | None = None,
    further: Sequence[Joint] = (),
    missing: Missing | None = None,
) -> Measurements:
    """Measurements of a table of points (docs/measurements.md); y of profiles in a format is the travel of a belt.

    Raises `DescriptionError` naming file, column, row, value and what was expected.
    """
    if form is None:
        profiles_file = None
        table = MeasuredTable(path)
        empty = table.leave_out_missing("z_mm")
        notes = (f"{path}: {empty} rows are left out, which have no z_mm",) if empty else ()
    else:
        profiles_file = read_profiles(path, form)
        belts = [axis_column(axis) for axis in further if axis.axis.startswith("conveyor[")]
        table = MeasuredTable(path, profiles_file.columns(*belts[-1:]))
        ignored = ("; y is not used where poses are given",) if form.y is not None and not belts else ()
        notes = (f"{path}: {profiles_file.text}{''.join(ignored)}",)
    _require_one_kind(table, flange, missing)
    found = read_points(path, joints, flange, convention, table, further, missing)
    if found.poses_kind:
        notes = (*notes, f"{flange}: taken for {found.poses_kind}")
    kept, marked = _with_a_height(path, found.observations.points_in_sensor)
    if found.flange is not None:
        _require_radians(found.flange, found.flange_path or path)
    observed = found.observations
    first = np.unique(observed.frame, return_index=True)[1]
    numbers = found.exposures
    whole = bool((numbers == np.round(numbers)).all() and (np.abs(numbers) <= _MOST_NUMBER).all())
    per_point = {name: _whole(table, name) for name in ("camera", "column_px", "flags")}
    sensor = _whole(table, "sensor", 1)
    wrong = np.flatnonzero((sensor < 1) | (sensor > MAX_FURTHER_SENSORS + 1))
    if len(wrong):
        table.refuse(int(wrong[0]), "sensor", f"the number of a sensor, 1 to {MAX_FURTHER_SENSORS + 1}")
    if "column_px" not in table.names:
        per_point["column_px"] = _order_within(observed.frame)
    profiles = ProfilePoints(
        points_in_sensor=observed.points_in_sensor[kept],
        sigma=observed.sigma[kept],
        intensity=table.numbers("intensity_dn", 0.0)[kept],
        camera=per_point["camera"].astype(np.int32)[kept],
        column=per_point["column_px"].astype(np.int32)[kept],
        frame=observed.frame.astype(np.int32)[kept],
        flags=per_point["flags"].astype(np.uint32)[kept],
        time_offset=observed.time_offset[kept],
        sensor=sensor.astype(np.uint8)[kept],
    )
    direction = observed.direction
    if direction is None:
        direction = np.broadcast_to([0.0, 0.0, 1.0], observed.points_in_sensor.shape)
    outer = (direction[:, :, None] * direction[:, None, :])[kept]
    return Measurements(
        names=tuple(f"exposure {number:g}" for number in numbers),
        index=numbers.astype(np.int64) if whole else np.arange(1, len(numbers) + 1),
        time=_times(table, first, len(numbers)),
        readings=observed.readings,
        profiles=profiles,
        covariance=observed.sigma[kept, None, None] ** 2 * outer,
        stated=found.flange,
        poses_file=found.flange_path or path,
        files=(*((path,) if profiles_file is None else profiles_file.files), *([] if flange is None else [flange])),
        notes=(*notes, *marked),
    )


def _with_a_height(path: Path, points: Array) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Whether points (m, 3) have a measured z, and a note on those with the value that marks missing ones."""
    marked, value = missing_value(points[:, 2], gap=_LEAST_GAP)
    if not marked.any():
        return ~marked, ()
    note = (
        f"{path}: {int(marked.sum())} of {len(points)} points are left out: their z_mm = {1e3 * value:.10g} is the same"
        " number and far from all others, which marks missing points"
    )
    return ~marked, (note,)


def read_cloud_of(
    path: Path, unit: str | None, cell: NominalCell, form: FormatDescription | None = None
) -> Measurements:
    """Measurements of a cloud, a surface or profiles without poses; their frame is taken as that of the robot's base.

    Raises `DescriptionError` if the file cannot be read, or holds profiles and no travel from one to the next.
    """
    files: tuple[Path, ...] = (path,)
    if form is None:
        found = read_cloud_file(path, unit)
    else:
        profiles = read_profiles(path, form)
        if not profiles.has_travel:
            raise DescriptionError(
                f"{profiles.text}; it states no travel from one profile to the next", file=path, key="flange",
                expected="a file of the flange's poses, or y.pitch_mm or y.column in the format",
            )  # fmt: skip
        found = cloud_of_profiles(path, profiles.points, profiles.text)
        files = profiles.files
    count = len(found.points)
    zeros = np.zeros(count, np.int32)
    note = f"{path}: {found.kind}, which states no poses: its frame is taken as that of the robot's base"
    return Measurements(
        names=("cloud",),
        index=np.ones(1, np.int64),
        time=np.zeros(1),
        readings=AxisReadings.of_flange(
            pose.inverse(cell.flange_from_sensor)[None],
            cell.start[len(cell.home) :],
            [axis.joint for axis in cell.further_axes],
        ),
        profiles=ProfilePoints(
            points_in_sensor=found.points,
            sigma=np.zeros(count),
            intensity=np.zeros(count),
            camera=zeros,
            column=np.arange(count, dtype=np.int32),
            frame=zeros,
            flags=zeros.astype(np.uint32),
            time_offset=np.zeros(count),
        ),
        covariance=np.zeros((count, 3, 3)),
        stated=None,
        poses_file=path,
        files=files,
        notes=(note, *found.warnings),
    )


def read_images_of(
    folder: Path,
    sensor: SensorDescription,
    joints: int,
    convention: str | None,
    laser_off: Path | None,
    quarter_turns: int,
    threads: int,
    progress: Progress,
    further: Sequence[Joint] = (),
    missing: Missing | None = None,
) -> Measurements:
    """Measurements of a folder of images with a table of joints or flange poses.

    Raises `ScancellError` naming file, key, value and what was expected.
    """
    table = pose_table(folder)
    _require_one_kind(table, None, missing)
    native = make_sensor(sensor, 0)
    cameras = [camera.name for camera in native.cameras]
    sets = ImageSet.from_files([folder], cameras)
    background = None
    if laser_off is not None:
        background = sets.matching(ImageSet.from_files([laser_off], cameras, "off"))
    rows = _rows_of_images(table, sets, folder)
    stated = None
    if has_flange(table):
        stated = read_flange(table, convention)
        _require_radians(stated, table.path)
    elif convention is not None:
        raise DescriptionError("has no flange poses", file=table.path, key="convention", value=convention)
    every = np.arange(len(table))
    order = np.argsort(rows)  # exposures count in the order of the images
    lacking = {} if missing is None else missing(np.asarray(order + 1.0))
    axes = read_axes(table, joints if stated is None else 0, every, every, every.astype(float), further, lacking)
    if stated is not None:
        stated = stated.rows(rows)
        axes = AxisReadings.of_flange(stated.matrices(), axes.axes[rows], further)
    else:
        axes = axes.rows(rows)
    progress.stage("extracting", 1, "profiles")
    extracted = extract_profiles(sets, background, sensor, threads, ("covariance",), quarter_turns)
    found, rejected = extracted.profiles, rejection_text(extracted.peaks, sensor)
    progress.advance(1)
    profiles = ProfilePoints(
        points_in_sensor=found["points_in_sensor"],
        sigma=found["sigma"],
        intensity=found["intensity"],
        camera=found["camera"],
        column=found["column"],
        frame=found["frame"].astype(np.int32),
        flags=found["flags"],
        time_offset=row_time_offset(native, found["row"], found["camera"]),
    )
    return Measurements(
        names=sets.names,
        index=np.arange(1, len(sets) + 1),
        time=_times(table, rows, len(sets)),
        readings=axes,
        profiles=profiles,
        covariance=np.asarray(found["covariance"], float),
        stated=stated,
        poses_file=table.path,
        files=(table.path, *(file for files in sets.files for file in files)),
        notes=(rejected,) if rejected else (),
    )


def _rows_of_images(table: MeasuredTable, sets: ImageSet, folder: Path) -> NDArray[np.intp]:
    """Rows (n,) of the table for the exposures of the images: each names an exposure, or an image of one."""
    exposure: Mapping[str, int] = {
        **{file.name: row for row, files in enumerate(sets.files) for file in files},
        **{name: row for row, name in enumerate(sets.names)},
    }
    rows = np.full(len(sets), -1, np.intp)
    for row, name in enumerate(table.words("image")):
        if name not in exposure:
            table.refuse(row, "image", f"an image in {folder}")
        if rows[exposure[name]] >= 0:
            table.refuse(row, "image", "one row for each exposure")
        rows[exposure[name]] = row
    missing = np.flatnonzero(rows < 0)
    if len(missing):
        raise DescriptionError(
            f"holds no pose of {len(missing)} of the {len(sets)} exposures of its folder",
            file=table.path,
            key="column 'image'",
            expected=f"a row with {sets.files[missing[0]][0].name}, or no such image",
        )
    return rows


def _require_one_kind(table: MeasuredTable, flange: Path | None, missing: Missing | None) -> None:
    """Refuse a table of joints and flange poses, and one of neither where `missing` does not replace them."""
    has_joints = "q1_deg" in table.names
    if has_joints and (flange is not None or has_flange(table)):
        raise DescriptionError(
            "states joints and flange poses",
            file=table.path,
            key="columns 'q1_deg', 'flange_…'",
            expected="one of them",
        )
    needs_arm = missing is None or "q1_deg" not in missing(np.zeros(0))
    if needs_arm and not has_joints and flange is None and not has_flange(table):
        raise DescriptionError(
            "states neither joints nor flange poses", file=table.path, expected="columns q1_deg … or flange_x_mm …"
        )


def _require_radians(stated: StatedPoses, file: Path) -> None:
    """Refuse angles that are labelled as radians and exceed a turn."""
    if stated.reading.angle != "rad":
        return
    largest = np.abs(stated.orientation).max(1)
    row = int(largest.argmax())
    if largest[row] > _MOST_RAD:
        raise DescriptionError(
            "is more than a full turn: is it in degrees?",
            file=file,
            key=f"angles of the flange in rad, row {row + 1}",
            value=float(largest[row]),
            expected="at most 6.2832",
        )


def _whole(table: MeasuredTable, name: str, default: int = 0) -> Array:
    """A column of integers from 0, which the table may lack."""
    values = table.numbers(name, float(default))
    wrong = np.flatnonzero((values < 0) | (values != np.round(values)) | (values > _MOST_NUMBER))
    if len(wrong):
        table.refuse(int(wrong[0]), name, "an integer, 0 or more")
    return values


def _order_within(frame: NDArray[np.intp]) -> Array:
    """Numbers (m,) from 0 of points in the order in which those of their exposure came."""
    order = np.argsort(frame, kind="stable")
    number = np.empty(len(frame))
    number[order] = np.arange(len(frame)) - np.searchsorted(frame[order], frame[order])
    return number


def _times(table: MeasuredTable, rows: NDArray[np.intp], count: int) -> Array:
    """Times (n,) of exposures, s; 1 s apart where the table has none."""
    if "time_s" not in table.names:
        return np.arange(count, dtype=float)
    time = table.numbers("time_s")[rows]
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        table.refuse(int(rows[back[0] + 1]), "time_s", "more than that of the exposure before")
    return time
