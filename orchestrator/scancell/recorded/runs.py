"""Measurements of run folders, and run folders as ROS 2 bags."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scancell.calibration.cell.points import stated_axes
from scancell.calibration.cell.scan import readings_of
from scancell.calibration.ros_bag import write_bag
from scancell.cell.recording import integers, numbers, read_any_recording, read_table, refuse_value
from scancell.config.loading import Setup, load_resolved
from scancell.errors import DescriptionError
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.recorded.measurements import Measurements, read_table_of

_LARGEST_MM, _LARGEST_DN, _LARGEST_S = 1e9, 1e9, 1e6  # values of a table of profiles


def export_bag(folder: str | Path, out: str | Path) -> tuple[int, int]:
    """Write the profiles of a run folder of `scan` or `reconstruct` with their readings as a ROS 2 bag (MCAP).

    Returns the numbers of messages and points.

    Raises
    ------
    DescriptionError
        If the folder is no such run.
    OutputError
        If the file cannot be written.
    MissingExtraError
        If the packages of the extra `formats` are not installed.
    """
    folder = Path(folder)
    if not (folder / "resolved.toml").is_file():
        raise DescriptionError(file=folder, expected="a run folder")
    setup, made = load_resolved(folder / "resolved.toml")
    columns = read_run(folder, setup, "measured" not in made).columns()
    return write_bag(Path(out), columns), len(columns["exposure"])


def read_run(folder: Path, setup: Setup, is_simulated: bool) -> Measurements:
    """Measurements of a run folder of `reconstruct`, or of a simulated scan.

    Raises `DescriptionError` naming file, column, row, value and what was expected.
    """
    if not is_simulated:
        return read_table_of(folder / "points.parquet", len(setup.cell.robot.joint), further=stated_axes(setup)[0])
    for name in ("recording.parquet", "profiles.parquet"):
        if not (folder / name).is_file():
            raise DescriptionError("no such file", file=folder / name, expected="the file of a run")
    measured = read_any_recording(folder / "recording.parquet").measured
    measured.require_joints(len(setup.cell.robot.joint))
    file = folder / "profiles.parquet"
    table = read_table(file)
    whole = {name: integers(table, name, file) for name in ("profile", "camera", "column", "flags")}
    points = 1e-3 * np.column_stack([numbers(table, f"{axis}_mm", file, _LARGEST_MM) for axis in "xyz"])
    sigma = 1e-3 * numbers(table, "sigma_mm", file, _LARGEST_MM)
    unknown = np.flatnonzero(~np.isin(whole["profile"], measured.index))
    if len(unknown):
        row = int(unknown[0])
        refuse_value(file, "profile", row, int(whole["profile"][row]), "a trigger.index of recording.parquet")
    sensor = integers(table, "sensor", file) if "sensor" in table.column_names else np.ones(len(points), np.int64)
    beyond = np.flatnonzero((sensor < 1) | (sensor > len(setup.sensor_names)))
    if len(beyond):
        row = int(beyond[0])
        refuse_value(file, "sensor", row, int(sensor[row]), f"1 to {len(setup.sensor_names)}, as the cell has")
    cameras = len(setup.sensor.camera)
    strange = np.flatnonzero((sensor == 1) & (whole["camera"] >= cameras))
    if len(strange):
        row = int(strange[0])
        refuse_value(file, "camera", row, int(whole["camera"][row]), f"0 to {cameras - 1}, as the sensor has")
    profiles = ProfilePoints(
        points_in_sensor=points,
        sigma=sigma,
        intensity=numbers(table, "intensity_dn", file, _LARGEST_DN),
        camera=whole["camera"].astype(np.int32),
        column=whole["column"].astype(np.int32),
        frame=np.searchsorted(measured.index, whole["profile"]).astype(np.int32),
        flags=whole["flags"].astype(np.uint32),
        time_offset=numbers(table, "time_offset_s", file, _LARGEST_S),
        sensor=sensor.astype(np.uint8),
    )
    axes, _ = stated_axes(setup)
    measured.require_axes([joint.axis for joint in axes])
    readings = readings_of(measured, axes)
    return Measurements(
        names=tuple(f"exposure {number}" for number in measured.index),
        index=measured.index,
        time=measured.time,
        readings=readings,
        profiles=profiles,
        covariance=sigma[:, None, None] ** 2 * np.diag([0.0, 0.0, 1.0]),
        stated=None,
        poses_file=folder / "recording.parquet",
        files=(folder / "profiles.parquet",),
    )
