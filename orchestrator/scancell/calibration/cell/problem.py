"""Calibration problem and its result: measured profiles of an artefact, what is known, unknown and found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.calibration.cell.kinematics import LATENCY, UNIT, AxisReadings, CellKinematics, SensorPoses, written_unit
from scancell.calibration.variance_components import (
    LeftOut,
    half_widths,
)
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeGroup, ShapeMesh

RobotNoise = Literal["none", "joints", "flange"]

MOST_OBLIQUE = 0.15  # smallest cosine between the normal of a surface and the direction of a point's error

REACH = 5e-3  # m: points farther from the nominal surface are not the artefact's
_EDGE = 0.7e-3  # m: points nearer to two shapes than this belong to neither
_COARSE = 1e-4  # m: chord error of surfaces from which targets are sampled

_EFFECT = {"mm": 1.0, "deg": 0.1, "ms": 0.05, "ppm": 0.1}  # mm, of 1 mm, 1 mrad or 0.001 at 100 mm, 1 ms at 50 mm/s
_MAIN = 0.3  # share of the largest effect in a direction from which an unknown is named


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
        (m,) standard deviation of a point's error, m, along `direction`.
    direction
        (m, 3) unit vectors in the sensor frame; None: the same in all directions.
    frame
        (m,) row of the exposure in `readings`.
    time_offset
        (m,) exposure of the point minus the latched instant, s: not 0 with a rolling shutter.
    shape
        (m,) shape of the artefact to which the point belongs, -1 for none; None: `Surface.assign` determines it.
    off_sheet
        (m, 3) from the point to where the laser sheet is by its description, m, where triangulation assumes a plane;
        None: they agree, or this is unknown.
    """

    readings: AxisReadings
    points_in_sensor: Array
    sigma: Array
    direction: Array | None
    frame: NDArray[np.intp]
    time_offset: Array
    shape: NDArray[np.intp] | None = None
    off_sheet: Array | None = None

    def chosen(self, rows: NDArray[np.bool_]) -> Observations:
        """Observations of some of the points; all exposures are kept."""
        return Observations(
            self.readings,
            self.points_in_sensor[rows],
            self.sigma[rows],
            None if self.direction is None else self.direction[rows],
            self.frame[rows],
            self.time_offset[rows],
            None if self.shape is None else self.shape[rows],
            None if self.off_sheet is None else self.off_sheet[rows],
        )


@dataclass(frozen=True)
class Artefact:
    """An artefact on the platter.

    Attributes
    ----------
    surface
        Its exact geometry.
    platter_from_artefact
        (4, 4) nominal pose, on the flange or on the belt where these carry it.
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
    """Problem that `solve` solves.

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


def surface_of(part: Mesh) -> Surface:
    """The measured surfaces of a part."""
    return MeasuredShapes(part.shapes) if isinstance(part, ShapeMesh) else MeasuredMesh(part)


def measured_meshes(part: Mesh) -> list[Mesh]:
    """A coarse mesh of each measured surface, in the part frame."""
    if not isinstance(part, ShapeMesh):
        return [part]
    return [one.shape.mesh(_COARSE).transformed(one.frame_from_shape) for one in part.shapes.measured]


def distances_to(part: Mesh, points: Array) -> Array:
    """Distances (n,) of points (n, 3) in the part frame from its nearest surface, supports included, m."""
    if isinstance(part, ShapeMesh):
        return np.abs(part.shapes.nearest(points)[0])
    return np.abs(sensor_rt.MeshSurface(part.vertices, part.faces).signed_distances(points)[0])


@dataclass(frozen=True)
class MeasuredShapes:
    """Shapes, see `Surface`: supports, edges and points beyond `REACH` are not used."""

    group: ShapeGroup

    def assign(self, points: Array) -> NDArray[np.intp]:
        """See `Surface.assign`."""
        signed, _, number = self.group.nearest(points)
        usable = np.array([one.role == "measured" for one in self.group.shapes])[number] & (np.abs(signed) < REACH)
        for other, placed in enumerate(self.group.shapes):
            from_centre = np.linalg.norm(points - placed.frame_from_shape[:3, 3], axis=1)
            rows = np.flatnonzero(usable & (number != other) & (from_centre < placed.shape.reach + _EDGE))
            usable[rows] = np.abs(placed.nearest(points[rows])[0]) > _EDGE
        return np.where(usable, number, -1)

    def distance(self, points: Array, shape: NDArray[np.intp]) -> tuple[Array, Array]:
        """See `Surface.distance`."""
        signed, normal = np.zeros(len(points)), np.zeros((len(points), 3))
        for number, placed in enumerate(self.group.shapes):
            rows = np.flatnonzero(shape == number)
            signed[rows], normal[rows] = placed.nearest(points[rows])
        return signed, normal


class MeasuredMesh:
    """A mesh, see `Surface`: points beyond `REACH` are not used."""

    def __init__(self, mesh: Mesh) -> None:
        self._surface = sensor_rt.MeshSurface(mesh.vertices, mesh.faces)
        self._normals = mesh.normals

    def assign(self, points: Array) -> NDArray[np.intp]:
        """See `Surface.assign`."""
        return np.where(np.abs(self._surface.signed_distances(points)[0]) < REACH, 0, -1)

    def distance(self, points: Array, shape: NDArray[np.intp]) -> tuple[Array, Array]:
        """See `Surface.distance`; the normal is that of the closest face."""
        signed, face = self._surface.signed_distances(points)
        return signed, self._normals[face]


@dataclass(frozen=True)
class Direction:
    """A direction in the space of the deviations, in mm, mrad and ms: unit vector (p,), and its standard deviation."""

    vector: Array
    standard_deviation: float

    def text(self, names: Sequence[str]) -> str:
        """The deviations that it consists of, such as ``tool.z - table.x``."""
        effect = self.vector * np.array([_EFFECT[written_unit(name)[0]] for name in names])
        order = np.argsort(-np.abs(effect))
        main = [i for i in order if abs(effect[i]) >= _MAIN * abs(effect[order[0]])]
        sign = np.sign(effect[main[0]])
        words = [("+ " if sign * effect[i] > 0 else "- ") + names[i] for i in main]
        return " ".join(words).removeprefix("+ ")


@dataclass(frozen=True)
class CalibrationResult:
    """Calibrated deviations.

    Attributes
    ----------
    names, values
        The p deviations that were found, SI.
    joint_covariance
        (u, u) of all unknowns: `values`, the twist (6,) of the artefact about the platter's origin where its pose is
        unknown, and `sizes`. What the artefact's surface does not determine, such as rotations of a sphere, is kept.
    degrees_of_freedom
        (p,) of each variance; small where the noise of few exposures was estimated.
    neglected
        (p,) changes of `values` by a laser sheet that triangulation neglects, which the covariance contains.
    held
        Deviations that were given and kept.
    platter_from_artefact
        (4, 4) pose of the artefact.
    sizes
        Offsets (s,) of the surfaces with unknown size, m.
    residuals, frame
        Distance of each used point to the artefact (k,), m, and its exposure (k,).
    points
        Number of points, those that were not used included.
    noise_of_points
        Standard deviation of points relative to the stated one.
    noise_of_robot
        Standard deviations of pose errors: joints (rad), or position (m) and orientation (rad) of the flange.
    noise_of_surface
        Standard deviation of an offset that all points of an exposure share and no motion explains, m.
    left_out
        Leave-one-out residuals.
    """

    names: tuple[str, ...]
    values: Array
    joint_covariance: Array
    degrees_of_freedom: Array
    neglected: Array
    held: Mapping[str, float]
    platter_from_artefact: Array
    sizes: Array
    residuals: Array
    frame: NDArray[np.intp]
    points: int
    noise_of_points: float
    noise_of_robot: tuple[float, ...]
    noise_of_surface: float
    left_out: LeftOut

    @property
    def covariance(self) -> Array:
        """(p, p) of `values`."""
        return self.joint_covariance[: len(self.names), : len(self.names)]

    @property
    def size_standard_deviations(self) -> Array:
        """(s,) of `sizes`."""
        return np.sqrt(np.diag(self.joint_covariance)[len(self.joint_covariance) - len(self.sizes) :])

    @property
    def deviations(self) -> dict[str, float]:
        """All deviations by name, SI: found and held ones."""
        return {**self.held, **dict(zip(self.names, self.values.tolist(), strict=True))}

    @property
    def standard_deviations(self) -> Array:
        """(p,) of `values`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def directions(self) -> list[Direction]:
        """Principal directions of the covariance, the least certain one first: what the exposures determine least."""
        values, vectors = np.linalg.eigh(self.covariance / UNIT**2)
        return [Direction(vectors[:, i], float(np.sqrt(values[i]))) for i in reversed(range(len(values)))]

    @property
    def rms(self) -> float:
        """Root mean square distance of the used points to the artefact, m."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def half_widths(self, probability: float = 0.95) -> Array:
        """Half widths (p,) of the intervals about `values` that contain the true ones with `probability` each."""
        return half_widths(self.standard_deviations, self.degrees_of_freedom, probability)

    def contains(self, expected: Array, probability: float = 0.95) -> bool:
        """Whether the joint confidence region (an ellipsoid) contains the `expected` values (p,)."""
        from scipy.special import fdtri  # noqa: PLC0415  (slow to import)

        away, count = expected - self.values, len(self.values)
        square = float(away @ np.linalg.solve(self.covariance, away)) / count
        return bool(square <= fdtri(count, float(self.degrees_of_freedom.min()), probability))
