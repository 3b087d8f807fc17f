"""Measurements that disagree with the part: all by a wrong reading of poses or columns, or single exposures.

Only a part whose shape and place are described can show this: without one, no point is measured twice for certain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import AxisReadings
from scancell.calibration.flange_poses import refuse_misread, refuse_wrong
from scancell.errors import CalibrationError
from scancell.geometry.shapes import PartSurface
from scancell.recorded.measurements import Measurements

Array = NDArray[np.float64]

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
        radians = replace(found.readings, axes=np.column_stack([np.degrees(found.readings.q), found.readings.table]))
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
