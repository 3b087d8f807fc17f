"""Calibration problem: measured profiles of an artefact, what is known about it, and what is to be found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import LATENCY, AxisReadings, CellKinematics, SensorPoses
from scancell.geometry import pose

Array = NDArray[np.float64]
RobotNoise = Literal["none", "joints", "flange"]

MOST_OBLIQUE = 0.15  # smallest cosine between the normal of a surface and the direction of a point's error


class Surface(Protocol):
    """Surface of an artefact in its own frame, m."""

    def assign(self, points: Array) -> NDArray[np.intp]:
        """Number (n,) of the shape to which each of points (n, 3) belongs; -1 for none, for example on a support."""

    def distance(self, points: Array, shape: NDArray[np.intp]) -> tuple[Array, Array]:
        """Signed distances (n,) of points (n, 3) from the shapes that they belong to, and outward unit normals (n, 3).

        Arbitrary for points that belong to none.
        """


@dataclass(frozen=True)
class Observations:
    """Points of n exposures of an artefact on the platter.

    Attributes
    ----------
    points_in_sensor
        (m, 3), m.
    sigma
        (m,) standard deviation of a point's error along `direction` (m, 3), unit vectors in the sensor frame, m.
    frame
        (m,) row of the exposure in `readings`.
    time_offset
        (m,) exposure of the point minus the latched instant, s: not 0 with a rolling shutter.
    shape
        (m,) shape of the artefact to which the point belongs, -1 for none; None if `Surface.assign` is to tell.
    """

    readings: AxisReadings
    points_in_sensor: Array
    sigma: Array
    direction: Array
    frame: NDArray[np.intp]
    time_offset: Array
    shape: NDArray[np.intp] | None = None

    @classmethod
    def along_z(
        cls, readings: AxisReadings, points_in_sensor: Array, sigma: Array, frame: NDArray[np.integer]
    ) -> Observations:
        """Of points whose error is along the sensor's z, exposed at the latched instant."""
        direction = np.broadcast_to([0.0, 0.0, 1.0], points_in_sensor.shape)
        return cls(readings, points_in_sensor, sigma, direction, np.asarray(frame, np.intp), np.zeros(len(sigma)))

    def chosen(self, rows: NDArray[np.bool_]) -> Observations:
        """Those of some points; all exposures are kept."""
        return Observations(
            self.readings,
            self.points_in_sensor[rows],
            self.sigma[rows],
            self.direction[rows],
            self.frame[rows],
            self.time_offset[rows],
            None if self.shape is None else self.shape[rows],
        )


@dataclass(frozen=True)
class Artefact:
    """An artefact on the platter.

    Attributes
    ----------
    surface
        Its exact geometry.
    platter_from_artefact
        (4, 4) nominal pose.
    is_pose_known
        Whether this pose is exact; else it is found with the calibration, and cannot be distinguished from the
        eccentricity of the platter.
    unknown_sizes
        Numbers of shapes of which a common offset of the surface (an error of the radius) is found, too.
    """

    surface: Surface
    platter_from_artefact: Array
    is_pose_known: bool = False
    unknown_sizes: tuple[int, ...] = ()


@dataclass(frozen=True)
class CalibrationProblem:
    """What `solve` needs.

    Attributes
    ----------
    kinematics
        Nominal cell.
    observations, artefact
        What was measured of what.
    free
        Names of the deviations to find, see `kinematics`.
    start
        Deviations to start from, SI; 0 unless given. Those that are not free stay.
    robot_noise
        Random pose errors from exposure to exposure: of all joint and table angles, or of position and orientation of
        the flange. Their size is estimated.
    """

    kinematics: CellKinematics
    observations: Observations
    artefact: Artefact
    free: tuple[str, ...]
    start: Mapping[str, float] = field(default_factory=dict)
    robot_noise: RobotNoise = "flange"


def points_on_platter(observations: Observations, poses: SensorPoses) -> Array:
    """Points (m, 3) at poses of the sensor, each moved on to the time at which it was exposed."""
    points = pose.transform_each(poses.platter_from_sensor[observations.frame], observations.points_in_sensor)
    if observations.time_offset.any():
        motion = poses.deviations[LATENCY][observations.frame]
        points = points + observations.time_offset[:, None] * (motion[:, :3] + np.cross(motion[:, 3:], points))
    return points
