"""Synthetic calibration data: exact profiles of an artefact in a cell with known deviations, and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import LATENCY, AxisReadings, CellKinematics
from scancell.calibration.cell.problem import Artefact, CalibrationProblem, Observations, RobotNoise
from scancell.calibration.cell.scan import kinematics_of
from scancell.cell.recording import slopes
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.shapes import Shape, Sphere
from scancell.nominal.cell import NominalCell, nominal_cell

Array = NDArray[np.float64]

RADIUS = 0.0125
CENTRE = (0.03, 0.02, 0.06)
COLUMNS = 600
HALF_LINE = 0.03
PROFILE_NOISE = 10e-6
MOST_JOINT_RATE = 2.0  # rad/s


@cache
def default_cell() -> NominalCell:
    return nominal_cell(load_setup().cell, None)


@cache
def default_kinematics() -> CellKinematics:
    return kinematics_of(default_cell())


class OneSurface:
    """A shape whose points are all used."""

    def __init__(self, shape: Shape, frame_from_shape: Array | None = None) -> None:
        self._shape = shape
        self._pose = np.eye(4) if frame_from_shape is None else frame_from_shape

    def assign(self, points: Array) -> NDArray[np.intp]:
        return np.zeros(len(points), np.intp)

    def distance(self, points: Array, shape: NDArray[np.intp]) -> tuple[Array, Array]:
        signed, normal = self._shape.nearest(pose.transform_points(pose.inverse(self._pose), points))
        return signed, normal @ self._pose[:3, :3].T


@dataclass(frozen=True)
class RobotErrors:
    """Random errors of every exposure: position (m) and orientation (rad) of the flange, and joint readings (rad)."""

    position: float = 0.0
    orientation: float = 0.0
    joints: float = 0.0


REALISTIC = RobotErrors(position=20e-6, orientation=float(np.radians(0.003)))


def sphere_views(
    rng: np.random.Generator,
    count: int,
    centre: Sequence[float] = CENTRE,
    turn_table: bool = True,
    cell: NominalCell | None = None,
) -> Array:
    """Positions (n, axes) of joints and table, rad, at which the sensor sees a sphere about `centre`.

    By default in the shipped cell, else in a `cell` without further axes.
    """
    cell = default_cell() if cell is None else cell
    axes: list[Array] = []
    while len(axes) < count:
        rotation = pose.looking_from(rng.uniform(-np.pi, np.pi), rng.uniform(0.5, 1.4))
        rotation = rotation @ pose.rotation_about(2, rng.uniform(-np.pi, np.pi))
        offset = np.array([rng.uniform(-0.6, 0.6) * RADIUS, rng.uniform(-0.015, 0.015), rng.uniform(0.09, 0.15)])
        angle = rng.uniform(-np.pi, np.pi) if turn_table else 0.0
        platter = cell.world_from_table @ pose.from_rotation(pose.rotation_about(2, angle))
        world_from_sensor = pose.from_rotation(
            rotation, platter[:3, :3] @ np.asarray(centre) + platter[:3, 3] - rotation @ offset
        )
        found = cell.arm.ik((world_from_sensor @ pose.inverse(cell.flange_from_sensor))[None])[0]
        found = found[~np.isnan(found).any(1)]
        if len(found):
            axes.append(np.append(found[rng.integers(len(found))], angle))
    return np.array(axes)


def passing_sphere(
    rng: np.random.Generator, count: int, per_pass: int, speed: float, centre: Sequence[float] = CENTRE
) -> AxisReadings:
    """Exposures while the sensor passes the sphere along its x, there and back in turn, at `speed`, m/s."""
    cell = default_kinematics()
    middle, angles = np.split(sphere_views(rng, count, centre), [-1], 1)
    direction = (cell.arm.fk(middle) @ cell.carrier_from_sensor)[:, :3, 0] * (1 - 2 * (np.arange(count) % 2))[:, None]
    # The flange moves like the sensor, for neither turns.
    velocity = np.repeat(speed * direction, per_pass, axis=0)
    time = np.tile(np.linspace(-0.6, 0.6, per_pass) * RADIUS / speed, count)
    q = after_straight_motion(np.repeat(middle, per_pass, axis=0), velocity, time)
    qd = joint_rates(q, velocity)
    if np.abs(qd).max() > MOST_JOINT_RATE:  # a robot does not pass so near to a singular position
        return passing_sphere(rng, count, per_pass, speed, centre)
    table, segment = np.repeat(angles[:, 0], per_pass), np.repeat(np.arange(count), per_pass)
    qdd = slopes(qd, time + 60.0 * segment, segment)
    still = np.zeros_like(table)
    return AxisReadings(*(np.column_stack(columns) for columns in ((q, table), (qd, still), (qdd, still))))


def joined(*parts: AxisReadings) -> AxisReadings:
    """Readings one after the other."""
    axes, rates, accelerations = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("axes", "rates", "accelerations")
    )
    return AxisReadings(axes, rates, accelerations, further=parts[0].further)


def joint_rates(q: Array, velocity: Array) -> Array:
    """Joint rates (n, joints) at which the flange moves at velocities (n, 3), m/s, and does not turn."""
    twist = np.hstack([velocity, np.zeros_like(velocity)])
    return np.asarray(np.linalg.solve(default_kinematics().arm.jacobian(q), twist[..., None])[..., 0])


def after_straight_motion(q: Array, velocity: Array, time: Array) -> Array:
    """Joints (n, joints) after the flange has moved along straight lines at velocities (n, 3), m/s, for times (n,)."""
    arm = default_kinematics().arm
    target = arm.fk(q)
    target[:, :3, 3] += time[:, None] * velocity
    for _ in range(5):
        reached = arm.fk(q)
        turn = pose.log_rotation(target[:, :3, :3] @ np.swapaxes(reached[:, :3, :3], 1, 2))
        missing = np.hstack([target[:, :3, 3] - reached[:, :3, 3], turn])
        q = q + np.linalg.solve(arm.jacobian(q), missing[..., None])[..., 0]
    return q


def observations_along_z(
    readings: AxisReadings, points_in_sensor: Array, sigma: Array, exposure: NDArray[np.integer]
) -> Observations:
    """Points (m, 3) with errors `sigma` (m,), m, along the sensor's z, taken when the axes were read."""
    direction = np.broadcast_to([0.0, 0.0, 1.0], points_in_sensor.shape)
    return Observations(
        readings, points_in_sensor, sigma, direction, np.asarray(exposure, np.intp), np.zeros(len(sigma))
    )


@dataclass(frozen=True)
class SphereCase:
    """A sphere that is measured in a cell with deviations."""

    deviations: Mapping[str, float] = field(default_factory=dict)
    robot: RobotErrors = RobotErrors()
    noise: float = PROFILE_NOISE
    radius: float = RADIUS
    centre: Sequence[float] = CENTRE
    kinematics: CellKinematics = field(default_factory=default_kinematics)

    def observe(self, readings: AxisReadings, rng: np.random.Generator) -> Observations:
        """Profiles of the upper part of the sphere, with noise along the sensor's z."""
        true = self._true_poses(self.kinematics, readings, rng)
        sensor_from_platter = pose.inverse(true)
        points, frames = [], []
        for number, local in enumerate(sensor_from_platter):
            centre = local[:3, :3] @ np.asarray(self.centre) + local[:3, 3]
            y = np.linspace(-HALF_LINE, HALF_LINE, COLUMNS)
            square = self.radius**2 - centre[0] ** 2 - (y - centre[1]) ** 2
            seen = square > (0.3 * self.radius) ** 2
            z = centre[2] - np.sqrt(square[seen]) + self.noise * rng.normal(size=int(seen.sum()))
            points.append(np.column_stack([np.zeros_like(z), y[seen], z]))
            frames.append(np.full(len(z), number))
        every = np.concatenate(points)
        sigma = np.full(len(every), self.noise or PROFILE_NOISE)
        return observations_along_z(readings, every, sigma, np.concatenate(frames))

    def _true_poses(self, cell: CellKinematics, readings: AxisReadings, rng: np.random.Generator) -> Array:
        n, robot = len(readings), self.robot
        deviations = dict(self.deviations)
        # The true motion goes on along its straight line; it is not extrapolated from the readings.
        later = np.full(n, deviations.pop(LATENCY, 0.0))
        q, joints = readings.q, readings.joints
        if readings.rates.any():
            velocity = np.einsum("nij,nj->ni", default_kinematics().arm.jacobian(q)[:, :3], readings.rates[:, :joints])
            q = after_straight_motion(q, velocity, later)
        q = q + robot.joints * rng.normal(size=q.shape)
        others = readings.axes[:, joints:] + later[:, None] * readings.rates[:, joints:]
        true = AxisReadings.at_rest(np.hstack([q, others]), readings.further)
        tool = [self.deviations.get(f"tool.{key}", 0.0) for key in ("x", "y", "z", "rx", "ry", "rz")]
        flange_from_sensor = cell.carrier_from_sensor @ pose.from_euler_xyz(tool[:3], tool[3:])
        error = pose.from_rotation(
            pose.exp_rotation(robot.orientation * rng.normal(size=(n, 3))), robot.position * rng.normal(size=(n, 3))
        )
        platter_from_flange = cell.poses(true, deviations).platter_from_sensor @ pose.inverse(flange_from_sensor)
        return np.asarray(platter_from_flange @ error @ flange_from_sensor)

    def problem(
        self,
        observed: Observations,
        free: tuple[str, ...],
        *,
        is_pose_known: bool = False,
        unknown_sizes: tuple[int, ...] = (),
        robot_noise: RobotNoise = "flange",
        placed_off: Sequence[float] = (0.5e-3, -0.5e-3, 0.3e-3),
    ) -> CalibrationProblem:
        """The problem; an unknown pose of the sphere starts `placed_off` from the true one, m."""
        at = np.asarray(self.centre) + (0.0 if is_pose_known else np.asarray(placed_off))
        artefact = Artefact(OneSurface(Sphere(RADIUS)), pose.translation(at), is_pose_known, unknown_sizes)
        return CalibrationProblem(self.kinematics, observed, artefact, free, robot_noise=robot_noise)


# Largest deviations: of lengths (m) and angles (deg) by group, and the latency (s).
Sizes = Mapping[str, tuple[float, float]]
SMALL: Sizes = {
    "tool": (1e-3, 0.5),
    "table": (0.5e-3, 0.2),
    "platter": (0.5e-3, 0.0),
    "dh": (0.3e-3, 0.1),
    "axis": (0.5e-3, 0.2),
    "trigger": (2e-3, 0.0),
}
LARGE: Sizes = {"tool": (2.5e-3, 1.5), "table": (1.2e-3, 0.8), "platter": (1.2e-3, 0.0), "trigger": (12e-3, 0.0)}


def misaligned(rng: np.random.Generator, *names: str, sizes: Sizes = SMALL) -> dict[str, float]:
    """Random deviations up to `sizes`, SI."""

    def size(name: str) -> float:
        length, angle = sizes[name.split(".", maxsplit=1)[0].split("[", maxsplit=1)[0]]
        if "wobble" in name:
            return float(np.radians(0.02))
        is_angle = name.rsplit(".", 1)[1] in {"rx", "ry", "rz", "theta", "alpha", "beta"}
        return float(np.radians(angle)) if is_angle else length

    return {name: size(name) * float(rng.uniform(-1.0, 1.0)) for name in names}
