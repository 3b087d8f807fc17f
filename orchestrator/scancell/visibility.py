"""Search for sensor poses that measure samples of a part's surface, and occlusion tests."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array, Flags, Indices
from scancell.config.sensor import SensorDescription, sensor_json
from scancell.errors import DescriptionError, OutputError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, joined, sample_surface
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.progress import NullProgress, Progress
from scancell.values import Value

POSITION_STEP = 5e-3
"""Distance between neighbouring points of a field, m."""

ANGLE_STEP = np.radians(15.0)
INCIDENCE_LIMIT = np.radians(75.0)
"""Largest angle between the surface normal and the laser ray or the ray to the camera."""

_METHOD = 1  # raised when the method changes, so that older cache files are not used any more
_SEED = 0
_AZIMUTHS = round(2 * np.pi / ANGLE_STEP)
_CHUNK = 1000  # samples between two reports of progress
_MOST_TRIES = 100  # poses tried for a sample

COVERAGE_SAMPLES = 20_000


@dataclass(frozen=True)
class SensorOptics:
    """Region in which a sensor measures: its range, the fan of its laser, and the image of a camera; sensor frame, m.

    Attributes
    ----------
    sensor
        Its range and cameras.
    source_z
        The laser's source is at (0, 0, source_z).
    fan
        Tangent of the half angle of the laser's fan.
    """

    sensor: sensor_rt.Sensor
    source_z: float
    fan: float

    @classmethod
    def of(cls, description: SensorDescription) -> SensorOptics:
        """The optics of a described sensor."""
        resolved = sensor_json(description, seed=0)
        sensor = sensor_rt.Sensor(json.dumps(resolved))
        laser = resolved["laser"]
        return cls(sensor, float(laser["source_z"]), float(np.tan(laser["fan_half_angle"])))

    @property
    def cameras(self) -> Array:
        """(cameras, 3) centres of projection."""
        return np.array([camera.sensor_from_camera[:3, 3] for camera in self.sensor.cameras])

    def contains(self, points_in_sheet: Array) -> Flags:
        """(n, cameras) whether points (n, 3) of the laser sheet are in range, in the fan and in a camera's image."""
        y, z = points_in_sheet[:, 1], points_in_sheet[:, 2]
        near, far = self.sensor.range
        # Rounding must not exclude points of a grid that ends at the limits.
        within = (z > near - 1e-12) & (z < far + 1e-12) & (np.abs(y) <= (z - self.source_z) * self.fan)
        return within[:, None] & np.stack([_in_image(camera, points_in_sheet) for camera in self.sensor.cameras], -1)


@dataclass(frozen=True)
class SensorField:
    """Region in which the sensor measures, sensor frame, metres.

    Attributes
    ----------
    points
        (m, 2) y and z in the laser sheet X = 0, in steps of `POSITION_STEP`.
    seen
        (m, cameras) whether the point lies in the camera's image.
    cameras
        (cameras, 3) centres of projection.
    source_z
        The laser's source is at (0, 0, source_z).
    """

    points: Array
    seen: Flags
    cameras: Array
    source_z: float

    @classmethod
    def of(cls, description: SensorDescription) -> SensorField:
        """The field of a sensor: within the range, the fan of the laser and the image of at least one camera."""
        optics = SensorOptics.of(description)
        near, far = optics.sensor.range
        z = np.arange(np.ceil(near / POSITION_STEP), np.floor(far / POSITION_STEP) + 1) * POSITION_STEP
        if len(z) == 0:
            z = np.array([(near + far) / 2])
        side = np.arange(np.ceil((far - optics.source_z) * optics.fan / POSITION_STEP) + 1) * POSITION_STEP
        y, z = (v.ravel() for v in np.meshgrid(np.concatenate([-side[:0:-1], side]), z))
        points = np.stack([0 * y, y, z], -1)
        seen = optics.contains(points)
        kept = seen.any(-1)
        return cls(points[kept, 1:], seen[kept], optics.cameras, optics.source_z)


def _in_image(camera: sensor_rt.Camera, points_in_sensor: Array) -> Flags:
    """(n,) whether points (n, 3) in front of the camera fall into its image."""
    size = np.array([camera.width_px, camera.height_px])
    return np.asarray((np.abs(camera.project(points_in_sensor) - (size - 1) / 2) < size / 2).all(-1))


class Tracer:
    """Occlusion queries against static meshes in one frame, m.

    Parameters
    ----------
    threads
        Number of threads of each query; 0 uses all cores.
    """

    def __init__(self, meshes: Sequence[Mesh], threads: int = 0) -> None:
        self._scene = sensor_rt.Scene()
        for number, mesh in enumerate(meshes):
            self._scene.add_mesh(str(number), mesh.vertices, mesh.faces, 0.5)
        self._poses = np.tile(np.eye(4), (len(meshes), 1, 1))
        self._threads = threads

    def blocked(self, start: Array, end: Array) -> NDArray[np.bool_]:
        """Whether a surface crosses the segments from `start` (n, 3) to `end` (n, 3), (n,).

        Raises `ValueError` if a segment has zero length or is not finite.
        """
        return sensor_rt.occluded(self._scene, self._poses, start, end, self._threads)


class SurfaceSearch:
    """Search for poses that measure samples of a part's surface, on the grid of `scancell.visibility`.

    `samples` and `normals` (n, 3) are in the part frame. `obstacles` are the meshes of the part and of all that rests
    on the table, in the frame of the table at angle 0. Where the arm holds the part before a sensor on a post, the
    flange takes the place of the table, and a turn about its axis that of the table.
    """

    def __init__(self, nominal: NominalCell, field: SensorField, samples: int, threads: int) -> None:
        nominal = nominal.with_axes_held()
        self._nominal = nominal
        self._field = field
        self._threads = threads
        self.samples, face = sample_surface(nominal.part, samples, _SEED)
        self.normals = nominal.part.normals[face]
        self._orientations = orientations()
        self._sides = (1.0,) if nominal.part.is_closed else (1.0, -1.0)
        frames = nominal.frame_poses(nominal.home)
        support_from_world = pose.inverse(frames[nominal.support if nominal.holds_part else "table"])
        further = {f"part[{i}]": nominal.tree.axes_of(f"part[{i}]") for i in range(2, 2 + len(nominal.further_parts))}
        on_table = {"table", *(frame for frame, axes in further.items() if "table" in axes)}
        fixed = {"world"} | further.keys() - on_table
        if nominal.holds_part:
            on_table, fixed = {nominal.support, "finger[1]", "finger[2]"}, fixed | on_table
        self.obstacles = [nominal.part.transformed(nominal.table_from_part)] + [
            body.mesh.transformed(support_from_world @ frames[body.moves_with]) for body in _bodies(nominal, on_table)
        ]
        self._fixed = [body.mesh.transformed(frames[body.moves_with]) for body in _bodies(nominal, fixed)]
        housing = [body.mesh.vertices for body in _bodies(nominal, {"sensor"})]
        self._angles = self._preferred_angles()
        optics = np.concatenate([field.cameras, [[0.0, 0.0, field.source_z]]])
        self._housing = np.concatenate([optics, *housing])

    def digest(self) -> str:
        """SHA-256 of all that decides the result."""
        arm, field = self._nominal.arm, self._field
        joints = [*((j.a, j.d, j.alpha, j.theta, j.beta, j.min, j.max) for j in arm.joints), *arm.held]
        sha = hashlib.sha256(f"{_METHOD} {_SEED} {ANGLE_STEP} {POSITION_STEP} {INCIDENCE_LIMIT} {joints}".encode())
        for mesh in (*self.obstacles, *self._fixed):
            _feed(sha, mesh.vertices, mesh.faces)
        _feed(sha, self._housing, field.points, field.seen, field.cameras, np.array([field.source_z]))
        _feed(sha, arm.world_from_base, self._nominal.world_from_table, self._nominal.sensor.parent_from_joint)
        if self._nominal.holds_part:
            sha.update(b"held")
        _feed(sha, self._nominal.table_from_part, np.array([len(self.samples)]))
        return sha.hexdigest()

    def run(self, progress: Progress) -> Flags:
        """(n,) whether each sample is measurable.

        Raises `DescriptionError` where nothing turns the part: the search takes poses for one that differ by a turn.
        """
        if not (self._nominal.table_turns or self._nominal.holds_part):
            raise DescriptionError(
                "measurable surface is known only of a part that is turned",
                key="cell.table.turns",
                value=False,
                expected="true",
            )
        near = np.flatnonzero(self._within_reach())
        progress.stage("measurable surface", len(near), "samples")
        mesh = joined(self.obstacles, "part and table")
        fixed = Tracer(self._fixed, self._threads) if self._fixed else None
        searches = [self._pose_search(mesh, side) for side in self._sides]
        measurable = np.zeros(len(self.samples), bool)
        for rows in np.split(near, np.arange(_CHUNK, len(near), _CHUNK)):
            for search in searches:
                measurable[self._found(search, rows[~measurable[rows]], fixed)] = True
            progress.advance(len(rows))
        return measurable

    def poses(self, rows: Indices, each: int) -> tuple[Indices, Array]:
        """Poses of the grid that measure the samples `rows`, at most `each` of them, in different directions.

        Returns
        -------
        rows, table_from_sensor
            (k,) samples, and (k, 4, 4) the poses in the frame of the table at angle 0, m. Bodies fixed in the world are
            not considered.
        """
        on_table = pose.transform_points(self._nominal.table_from_part, self.samples)
        mesh, found, poses = joined(self.obstacles, "part and table"), [np.zeros(0, np.int64)], [np.zeros((0, 4, 4))]
        for side in self._sides:
            search, left = self._pose_search(mesh, side), rows
            for _ in range(_MOST_TRIES):
                left, keys, positions = search.next(left, self._threads)
                reached = np.isfinite(self._table_angles(keys))
                search.record_reachability(keys, reached)
                azimuth = np.arctan2(*on_table[left, 1::-1].T) - np.arctan2(*positions[:, 0, 1::-1].T)
                rotation = self._orientations[keys[:, 0]]
                at = pose.from_rotation(rotation, positions[:, 1] - self._field.source_z * rotation[:, :, 2])
                found.append(left[reached])
                poses.append((pose.from_rotation(pose.rotation_about(2, azimuth)) @ at)[reached])
                search.skip_directions(left[reached])
                left = left[np.bincount(np.concatenate(found), minlength=len(on_table))[left] < each]
                if not len(left):
                    break
        return np.concatenate(found), np.concatenate(poses)

    def _pose_search(self, mesh: Mesh, side: float) -> sensor_rt.PoseSearch:
        table_from_part = self._nominal.table_from_part
        return sensor_rt.PoseSearch(
            mesh.vertices,
            mesh.faces,
            pose.transform_points(table_from_part, self.samples),
            side * self.normals @ table_from_part[:3, :3].T,
            self._orientations,
            (self._orientations @ self._housing.T)[:, 2].min(-1),
            _AZIMUTHS,
            self._field.points,
            self._field.seen,
            self._field.cameras,
            self._field.source_z,
            INCIDENCE_LIMIT,
            POSITION_STEP,
        )

    def _within_reach(self) -> Flags:
        """(n,) whether a sample is as near to the arm's base, at some table angle, as all lengths together allow.

        A held sample: to the sensor.
        """
        arm, nominal = self._nominal.arm, self._nominal
        lengths = sum(abs(joint.a) + abs(joint.d) for joint in arm.joints)
        seen = float(np.linalg.norm(self._field.points, axis=-1).max())
        if nominal.holds_part:
            away = np.linalg.norm((pose.inverse(arm.world_from_base) @ nominal.world_from_sensor(()))[:3, 3])
            held = np.linalg.norm(pose.transform_points(nominal.table_from_part, self.samples), axis=1)
            return np.asarray(away <= lengths + held + seen)
        tool = float(np.linalg.norm(nominal.flange_from_sensor[:3, 3]))
        base = (pose.inverse(nominal.world_from_table) @ arm.world_from_base)[:3, 3]
        on_table = pose.transform_points(nominal.table_from_part, self.samples)
        beside = np.hypot(on_table[:, 0], on_table[:, 1]) - np.hypot(*base[:2])
        return np.asarray(np.hypot(beside, on_table[:, 2] - base[2]) <= lengths + tool + seen)

    def _found(self, search: sensor_rt.PoseSearch, rows: Indices, fixed: Tracer | None) -> Indices:
        """Samples among `rows` for which a pose of the grid is found that the arm reaches."""
        found: list[Indices] = []
        while len(rows):
            rows, keys, positions = search.next(rows, self._threads)
            distinct, key = np.unique(keys, axis=0, return_inverse=True)
            table = self._table_angles(distinct)
            search.record_reachability(distinct, np.isfinite(table))
            angle = table[key.ravel()]
            good = np.isfinite(angle)
            if fixed is not None and good.any():
                world = self._world_from_support(keys[good], angle[good])
                sample, source, camera = np.swapaxes(pose.transform_points(world, positions[good]), 0, 1)
                blocked = fixed.blocked(sample, source) | fixed.blocked(sample, camera)
                search.skip_directions(rows[good][blocked])
                good[good] = ~blocked
            found.append(rows[good])
            rows = rows[~good]
        return np.concatenate(found) if found else np.zeros(0, np.int64)

    def _world_from_support(self, keys: NDArray[np.int32], angle: Array) -> Array:
        """Poses (k, 4, 4) of the table at its angles (k,), rad, or of the flange in a turn about its axis.

        The latter so that the sensor on its post is at each pose of the grid (k, 4).
        """
        if not self._nominal.holds_part:
            return np.asarray(self._nominal.world_from_table @ pose.from_rotation(pose.rotation_about(2, angle)))
        return np.asarray(self._nominal.world_from_sensor(()) @ pose.inverse(self._support_from_sensor(keys)))

    def _support_from_sensor(self, keys: NDArray[np.int32]) -> Array:
        return pose.from_rotation(self._orientations[keys[:, 0]], POSITION_STEP * keys[:, 1:])

    def _table_angles(self, keys: NDArray[np.int32]) -> Array:
        """(k,) table angle at which the arm reaches each pose of the grid (k, 4); NaN where it never does."""
        arm, nominal = self._nominal.arm, self._nominal
        table_from_sensor = self._support_from_sensor(keys)
        if nominal.holds_part:
            # Turned about the axis of the flange, the part shows the sensor the same at every angle.
            held = nominal.world_from_flange(table_from_sensor, frame=nominal.support)
            turns = pose.from_rotation(pose.rotation_about(2, -self._angles))

            def world_from_flange(numbers: Indices, rest: Indices) -> Array:
                return np.asarray(held[rest] @ turns[numbers][:, None])

        else:
            table_from_flange = table_from_sensor @ pose.inverse(nominal.flange_from_sensor)

            def world_from_flange(numbers: Indices, rest: Indices) -> Array:
                turns = pose.from_rotation(pose.rotation_about(2, self._angles[numbers]))
                return np.asarray((nominal.world_from_table @ turns)[:, None] @ table_from_flange[rest])

        found = np.full(len(keys), np.nan)
        # The first angle serves most poses; the others are tested for reach in one call.
        for numbers in np.split(np.arange(len(self._angles)), [1]):
            rest = np.flatnonzero(np.isnan(found))
            poses = world_from_flange(numbers, rest)
            outside = arm.distance_outside_reach(poses).reshape(len(numbers), len(rest))
            near_by = zip(self._angles[numbers], poses, ~(outside > 0), strict=True)  # NaN: unknown
            for angle, targets, near in near_by:
                todo = np.flatnonzero(near & np.isnan(found[rest]))
                if len(todo):
                    q = arm.ik(targets[todo])
                    found[rest[todo[np.isfinite(q[..., 0]).any(1)]]] = angle
        return found

    def _preferred_angles(self) -> Array:
        """(24,) table angles, those first that put the sensor beside the line from the arm's base to the table."""
        base_from_table = pose.inverse(self._nominal.arm.world_from_base) @ self._nominal.world_from_table
        towards_base = np.arctan2(*-(base_from_table[:3, :3].T @ base_from_table[:3, 3])[1::-1])
        angle = np.arange(_AZIMUTHS) * ANGLE_STEP
        order = np.argsort(np.abs(np.cos(angle - towards_base)).round(9), kind="stable")
        return np.asarray(angle[order])


def orientations() -> Array:
    """(k, 3, 3) ``table_from_sensor`` at azimuth 0, the sensor on the side of x > 0, for all elevations and headings.

    Straight down and up the heading is the azimuth, and only one is listed.
    """
    result = []
    for elevation in np.arange(-np.pi / 2, np.pi / 2 + ANGLE_STEP / 2, ANGLE_STEP):
        headings = np.arange(_AZIMUTHS if np.cos(elevation) > 1e-9 else 1) * ANGLE_STEP
        result.append(pose.looking_from(0.0, elevation) @ pose.rotation_about(2, headings))
    return np.concatenate(result)


def _bodies(nominal: NominalCell, frames: set[str]) -> list[Body]:
    return [body for body in nominal.bodies if nominal.carrier(body.moves_with) in frames]


def _feed(sha: hashlib._Hash, *arrays: NDArray[np.generic]) -> None:
    for array in arrays:
        sha.update(f"{array.dtype.str}{array.shape}".encode())
        sha.update(np.ascontiguousarray(array).data)


@dataclass(frozen=True, eq=False, repr=False)
class MeasurableSurface(Value):
    """Surface samples of a part and which of them the sensor could measure (see the module).

    Attributes
    ----------
    samples, normals
        (n, 3) in the part frame, m; each sample represents the same share of the surface. The unit normals look
        outwards; they are NaN for a mesh that is not closed: what is measured from either side counts there.
    measurable
        (n,)
    area
        Area of the whole surface, m².
    digest
        SHA-256 of everything that decides the result.
    """

    samples: Array
    normals: Array
    measurable: Flags
    area: float
    digest: str

    @property
    def measurable_fraction(self) -> float:
        """Measurable share of the whole surface, 0 … 1."""
        return float(self.measurable.mean())

    def together(self, others: Sequence[MeasurableSurface]) -> MeasurableSurface:
        """The same surface with what is measurable in any of several, whose samples are the same."""
        measurable = np.any([self.measurable, *(one.measurable for one in others)], axis=0)
        digest = hashlib.sha256("".join([self.digest, *(one.digest for one in others)]).encode()).hexdigest()
        return MeasurableSurface(self.samples, self.normals, measurable, self.area, digest)

    def only(self, wanted: Flags) -> MeasurableSurface:
        """The same surface, of whose samples only those that are `wanted` (n,) count as measurable."""
        digest = hashlib.sha256(self.digest.encode() + np.packbits(wanted).tobytes()).hexdigest()
        return MeasurableSurface(self.samples, self.normals, self.measurable & wanted, self.area, digest)

    def thinned(self, count: int) -> MeasurableSurface:
        """The same surface with at most `count` of the samples, evenly chosen."""
        if count >= len(self.samples):
            return self
        rows = (np.arange(count) + 0.5) * len(self.samples) / count
        chosen = rows.astype(np.int64)
        return MeasurableSurface(
            self.samples[chosen], self.normals[chosen], self.measurable[chosen], self.area, self.digest
        )


def cache_folder() -> Path:
    """Folder of the cached results: ``$SCANCELL_CACHE``, or ``scancell/measurable`` in the user's cache folder."""
    chosen = os.environ.get("SCANCELL_CACHE")
    if chosen:
        return Path(chosen)
    user = os.environ.get("XDG_CACHE_HOME")
    return (Path(user) if user else Path.home() / ".cache") / "scancell" / "measurable"


def measurable_surface(
    nominal: NominalCell,
    sensor: SensorDescription,
    samples: int = COVERAGE_SAMPLES,
    progress: Progress | None = None,
    cache: Path | None = None,
    threads: int = 0,
) -> MeasurableSurface:
    """Find the measurable surface of the part in a cell, or read it from the cache.

    Parameters
    ----------
    samples
        Number of surface samples.
    progress
        Gets the stage ``measurable surface``, unless the result is cached.
    cache
        Folder of the cache, see `cache_folder`; None: nothing is read or kept.
    threads
        0: all cores. The result does not depend on it.
    """
    search = SurfaceSearch(nominal, SensorField.of(sensor), samples, threads)
    digest = search.digest()
    file = None if cache is None else cache / f"{digest}.npz"
    measurable = None if file is None else _read(file, samples)
    if measurable is None:
        measurable = search.run(progress or NullProgress())
        if file is not None:
            _write(file, measurable)
    normals = search.normals if nominal.part.is_closed else np.full_like(search.normals, np.nan)
    return MeasurableSurface(search.samples, normals, measurable, float(nominal.part.areas.sum()), digest)


def unknown_surface(
    nominal: NominalCell, sensor: SensorDescription, samples: int = COVERAGE_SAMPLES, threads: int = 0
) -> MeasurableSurface:
    """The samples of `measurable_surface` where it is unknown which are measurable: none counts as such."""
    search = SurfaceSearch(nominal, SensorField.of(sensor), samples, threads)
    normals = search.normals if nominal.part.is_closed else np.full_like(search.normals, np.nan)
    return MeasurableSurface(search.samples, normals, np.zeros(samples, bool), float(nominal.part.areas.sum()), "")


def _read(file: Path, samples: int) -> Flags | None:
    """Flags (n,) of the measurable samples from a cache file; None when it is missing, damaged or of another size."""
    try:
        with np.load(file, allow_pickle=False) as data:
            measurable = data["measurable"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    return measurable if measurable.shape == (samples,) and measurable.dtype == np.bool_ else None


def _write(file: Path, measurable: Flags) -> None:
    """Keep the result. Where the folder cannot be written, the next scan computes it again."""
    with suppress(OutputError), atomic_write(file) as temporary:
        np.savez_compressed(temporary, measurable=measurable)
