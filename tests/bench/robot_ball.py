"""Profiles of a ball by a sensor on a robot, with poses of the flange (docs/reality.md): tool, left-out profiles."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import scancell
from bench.ball_profiles import write_ball_artefact
from scancell.calibration.cell.report import CalibrationReport
from scancell.calibration.cell.solve import circle_in
from scancell.calibration.measured_table import write_measured_table
from scancell.calibration.pose_files import flange_columns
from scancell.geometry import pose

Array = NDArray[np.float64]

RADIUS = 40e-3
_SENSOR_Z = 0.4  # m: z of the recordings is towards the sensor, with an origin of its own
_EVERY = 8  # points are 30 µm apart
_NOISE = 10e-6  # m, of points
_LARGEST = 1.01


@dataclass(frozen=True)
class Recording:
    """Poses (n, 4, 4) of the flange, and profiles (k, 3) in a frame of the sensor, m."""

    flange: Array
    profiles: tuple[Array, ...]

    def rows(self, chosen: Sequence[int]) -> Recording:
        """Some exposures."""
        return Recording(self.flange[list(chosen)], tuple(self.profiles[i] for i in chosen))

    def in_frame(self, scale: float, offset: float) -> Recording:
        """With another z."""
        change = np.array([1.0, 1.0, scale]), np.array([0.0, 0.0, offset])
        return Recording(self.flange, tuple(one * change[0] + change[1] for one in self.profiles))


@dataclass(frozen=True)
class BallProfiles(Recording):
    """Recording in the sensor frame, and the stored result of the authors.

    `centres` (n, 3) are those of the ball in the sensor frame by the circles, on the side x > 0 of the laser's plane;
    `stated` is flange_from_sensor (4, 4).
    """

    centres: Array
    stated: Array

    def rows(self, chosen: Sequence[int]) -> BallProfiles:
        """Those of some profiles."""
        some = super().rows(chosen)
        return BallProfiles(some.flange, some.profiles, self.centres[list(chosen)], self.stated)


def _centre(profile: Array) -> Array:
    circle = circle_in(profile[:, 1:], _NOISE, _LARGEST * RADIUS, np.random.default_rng(0))
    if circle is None:
        raise ValueError("a profile shows no circle")
    return np.array([np.sqrt(max(RADIUS**2 - circle[1] ** 2, 0.0)), *circle[0]])


def read_recording(folder: Path, every: int) -> Recording:
    """``RobPoses.rob``, and one in `every` points of ``p1.yml`` …, in mm and deg (WPR)."""
    stated = np.array(json.loads((folder / "RobPoses.rob").read_text())["RobPoses"])
    turn = Rotation.from_euler("xyz", stated[:, 3:], degrees=True).as_matrix()
    profiles = []
    for number in range(1, len(stated) + 1):
        file = cv2.FileStorage(str(folder / f"p{number}.yml"), cv2.FILE_STORAGE_READ)
        line = file.getNode("scan_line")
        x, _, z = 1e-3 * np.array([line.at(i).real() for i in range(line.size())]).reshape(-1, 3).T
        file.release()
        points = np.column_stack([np.zeros(len(x)), x, z])
        profiles.append(points[np.isfinite(points).all(1)][::every])
    return Recording(pose.from_rotation(turn, 1e-3 * stated[:, :3]), tuple(profiles))


def read_robot_ball(data: Path) -> BallProfiles:
    """The set, with the result in ``calibration.sec``."""
    found = read_recording(data, _EVERY).in_frame(-1.0, _SENSOR_Z)
    matrix = np.array(json.loads((data / "calibration.sec").read_text())["Solution"]["HTM"])
    theirs = pose.from_rotation(matrix[:3, :3], 1e-3 * matrix[:3, 3])
    # Their sensor frame: x along the line, z towards the sensor, y across.
    own = pose.from_rotation(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), [0.0, 0.0, _SENSOR_Z])
    return BallProfiles(found.flange, found.profiles, np.array([_centre(one) for one in found.profiles]), theirs @ own)


def calibrated(data: Recording) -> CalibrationReport:
    """``scancell calibrate tool`` by the profiles, without a described tool or place of the ball."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        ball = write_ball_artefact(folder, RADIUS)
        row = np.repeat(np.arange(len(data.flange)), [len(one) for one in data.profiles])
        points = 1e3 * np.concatenate(data.profiles)
        columns = {
            "exposure": row + 1.0,
            **{name: values[row] for name, values in flange_columns(data.flange).items()},
            **{f"{axis}_mm": points[:, i] for i, axis in enumerate("xyz")},
        }
        write_measured_table(folder / "points.csv", columns)
        return scancell.calibrate("tool", ball, from_points=folder / "points.csv")


def plain_chain(data: BallProfiles) -> Array:
    """Plain NumPy: circles, then tool (4, 4) and centre by linear equations, the rotation made orthogonal at the end.

    All centres lie on one side of the plane of the laser.
    """
    rotation, offset = data.flange[:, :3, :3], data.flange[:, :3, 3]
    columns = [rotation * data.centres[:, i, None, None] for i in range(3)]
    design = np.concatenate([*columns, rotation, np.broadcast_to(-np.eye(3), rotation.shape)], -1).reshape(-1, 15)
    found = np.linalg.lstsq(design, -offset.ravel(), rcond=None)[0].reshape(5, 3)
    axes = found[:3].T * [np.sign(np.linalg.det(found[:3])), 1.0, 1.0]
    u, _, vt = np.linalg.svd(axes)
    return pose.from_rotation(u @ vt, found[3])


def distances(tool: Array, fitted: BallProfiles, data: BallProfiles) -> Array:
    """Distances (n,) of the ball's centres in profiles from the mean of those in the fitted ones, m."""
    both = [_in_base(tool, side * fitted.centres[:, 0], fitted) for side in (1, -1)]
    side = (1, -1)[int(np.ptp(both[1], axis=0).sum() < np.ptp(both[0], axis=0).sum())]
    centre = _in_base(tool, side * fitted.centres[:, 0], fitted).mean(0)
    return np.asarray(np.linalg.norm(_in_base(tool, side * data.centres[:, 0], data) - centre, axis=1))


def _in_base(tool: Array, across: Array, data: BallProfiles) -> Array:
    in_sensor = np.column_stack([across, data.centres[:, 1:]])
    return pose.transform_each(data.flange @ tool, in_sensor)


def robot_ball_lines(data: Path) -> Iterator[str]:
    """Tables of the tool, and of the distance of a left-out profile's centre from that by the others."""
    found = read_robot_ball(data)
    whole = calibrated(found)
    own = 1e3 * whole.flange_from_sensor[:3, 3]
    half = [row.half_width for row in whole.rows[:3]]
    plain = 1e3 * plain_chain(found)[:3, 3]
    theirs = 1e3 * found.stated[:3, 3]
    yield "| tool | x, mm | y, mm | z, mm |"
    yield "|---|---|---|---|"
    yield f"| this calibration | {' | '.join(f'{v:.1f} ± {h:.1f}' for v, h in zip(own, half, strict=True))} |"
    for name, value in (("linear equations", plain), ("the authors, stored", theirs)):
        yield f"| {name} | {' | '.join(f'{v:.1f}' for v in value)} |"
    count = len(found.flange)
    away: dict[str, list[float]] = {
        "this calibration": [],
        "linear equations": [],
        "the authors, stored: nothing left out": [],
    }
    for i in range(count):
        rest, one = found.rows([k for k in range(count) if k != i]), found.rows([i])
        tools = (calibrated(rest).flange_from_sensor, plain_chain(rest), found.stated)
        for name, tool in zip(away, tools, strict=True):
            away[name].append(1e3 * float(distances(tool, rest, one)[0]))
        print("profile", i + 1, "left out", flush=True)
    yield ""
    yield "| ball's centre in a left-out profile, from that by the others | RMS, mm | median, mm | largest, mm |"
    yield "|---|---|---|---|"
    for name, values in away.items():
        yield f"| {name} | {np.sqrt(np.mean(np.square(values))):.2f} | {np.median(values):.2f} | {max(values):.2f} |"
