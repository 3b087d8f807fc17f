"""The measurable surface: what of a part the sensor could measure from poses that the arm can reach, whatever the plan.

Definition. A surface sample is measurable when the pose grid below holds a pose from which

- the sample lies in the laser sheet, within the range, the fan of the laser and the image of a camera;
- the laser ray and the ray to that camera meet the surface within the incidence limit, and no surface of the part, of
  a body on the table or of a body fixed in the world lies in between;
- the arm has a solution of its inverse kinematics within the joint limits, at one of 24 table angles 15° apart;
- the whole housing of the sensor is above the plane of the table top.

Pose grid. Orientations in steps of 15°: elevation of the viewing direction from -90° to 90°, azimuth (turned by the
table), heading of the laser sheet about the viewing direction. For each of them the sample is placed at all points of
the sheet, 5 mm apart along the laser line and in range, that the sensor sees; across the sheet the position follows
from the sample, as a scan sweeps the sheet over the part. Reach is evaluated at the nearest point of a grid of 5 mm
that is fixed in the frame of the table; where three poses tried in a cube of 40 mm are all out of reach, the cube is.
Bodies fixed in the world are looked at from the first table angle found; where one occludes a pose, directions nearby
(10°) are not tried any more.

Not part of it: collisions of arm or housing with the part or with anything but the table, occlusion by arm, gripper
and the sensor itself, and deviations of the sensor as built. The sensor is that of the geometric engine with its laser
in the plane X = 0. Numerically, rays are looked up in a grid of directions of 2.5° before they are cast exactly: a
sample that is only visible through a gap narrower than that may be missed, one that is found is certain.
"""

from __future__ import annotations

import hashlib
import os
import zipfile
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.sensor import SensorDescription
from scancell.errors import OutputError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.sampling import sample_surface
from scancell.nominal.cell import Body, NominalCell
from scancell.progress import NullProgress, Progress
from scancell.visibility.sensor_field import POSITION_STEP, SensorField
from scancell.visibility.tracer import Tracer

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

COVERAGE_SAMPLES = 20_000
ANGLE_STEP = np.radians(15.0)
INCIDENCE_LIMIT = np.radians(75.0)
"""Largest angle between the surface normal and the laser ray or the ray to the camera."""

_METHOD = 1  # raised when the method changes, so that older cache files are not used any more
_SEED = 0
_AZIMUTHS = round(2 * np.pi / ANGLE_STEP)
_CHUNK = 1000  # samples between two reports of progress


@dataclass(frozen=True)
class MeasurableSurface:
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
    search = _Search(nominal, SensorField.of(sensor), samples, threads)
    digest = search.digest()
    file = None if cache is None else cache / f"{digest}.npz"
    measurable = None if file is None else _read(file, samples)
    if measurable is None:
        measurable = search.run(progress or NullProgress())
        if file is not None:
            _write(file, measurable)
    normals = search.normals if nominal.part.is_closed else np.full_like(search.normals, np.nan)
    return MeasurableSurface(search.samples, normals, measurable, float(nominal.part.areas.sum()), digest)


class _Search:
    """One evaluation; `samples` and `normals` (n, 3) are in the part frame."""

    def __init__(self, nominal: NominalCell, field: SensorField, samples: int, threads: int) -> None:
        self._nominal = nominal
        self._field = field
        self._threads = threads
        self.samples, face = sample_surface(nominal.part, samples, _SEED)
        self.normals = nominal.part.normals[face]
        self._orientations = _orientations()
        frames = nominal.frame_poses(nominal.home, 0.0)
        table_from_world = pose.inverse(frames["table"])
        on_table = {"table", *(f"part[{i}]" for i, p in enumerate(nominal.further_parts, 2) if p.carrier == "table")}
        fixed = {"world", *(f"part[{i}]" for i, p in enumerate(nominal.further_parts, 2) if p.carrier == "world")}
        self._obstacles = [nominal.part.transformed(nominal.table_from_part)] + [
            body.mesh.transformed(table_from_world @ frames[body.moves_with]) for body in _bodies(nominal, on_table)
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
        for mesh in (*self._obstacles, *self._fixed):
            _feed(sha, mesh.vertices, mesh.faces)
        _feed(sha, self._housing, field.points, field.seen, field.cameras, np.array([field.source_z]))
        _feed(sha, arm.world_from_base, self._nominal.world_from_table, self._nominal.flange_from_sensor)
        _feed(sha, self._nominal.table_from_part, np.array([len(self.samples)]))
        return sha.hexdigest()

    def run(self, progress: Progress) -> Flags:
        """(n,) whether each sample is measurable."""
        count = len(self.samples)
        progress.stage("measurable surface", count, "samples")
        mesh = _joined(self._obstacles)
        fixed = Tracer(self._fixed, self._threads) if self._fixed else None
        sides = (1.0,) if self._nominal.part.is_closed else (1.0, -1.0)
        searches = [self._pose_search(mesh, side) for side in sides]
        measurable = np.zeros(count, bool)
        for rows in np.split(np.arange(count), np.arange(_CHUNK, count, _CHUNK)):
            for search in searches:
                measurable[self._found(search, rows[~measurable[rows]], fixed)] = True
            progress.advance(len(rows))
        return measurable

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

    def _found(self, search: sensor_rt.PoseSearch, rows: NDArray[np.int64], fixed: Tracer | None) -> NDArray[np.int64]:
        """Those of the samples `rows` for which a pose of the grid is found that the arm reaches."""
        found: list[NDArray[np.int64]] = []
        while len(rows):
            rows, keys, positions = search.next(rows, self._threads)
            distinct, key = np.unique(keys, axis=0, return_inverse=True)
            table = self._table_angles(distinct)
            search.record_reachability(distinct, np.isfinite(table))
            angle = table[key.ravel()]
            good = np.isfinite(angle)
            if fixed is not None and good.any():
                world = self._nominal.world_from_table @ pose.from_rotation(pose.rotation_about(2, angle[good]))
                sample, source, camera = np.swapaxes(pose.transform_points(world, positions[good]), 0, 1)
                blocked = fixed.blocked(sample, source) | fixed.blocked(sample, camera)
                search.skip_directions(rows[good][blocked])
                good[good] = ~blocked
            found.append(rows[good])
            rows = rows[~good]
        return np.concatenate(found) if found else np.zeros(0, np.int64)

    def _table_angles(self, keys: NDArray[np.int32]) -> Array:
        """(k,) table angle at which the arm reaches each pose of the grid (k, 4); NaN where it never does."""
        arm, nominal = self._nominal.arm, self._nominal
        table_from_sensor = pose.from_rotation(self._orientations[keys[:, 0]], POSITION_STEP * keys[:, 1:])
        table_from_flange = table_from_sensor @ pose.inverse(nominal.flange_from_sensor)
        found = np.full(len(keys), np.nan)
        # The first angle serves most poses; the others are tested for reach in one call.
        for angles in np.split(self._angles, [1]):
            rest = np.flatnonzero(np.isnan(found))
            turned = nominal.world_from_table @ pose.from_rotation(pose.rotation_about(2, angles))
            world_from_flange = turned[:, None] @ table_from_flange[rest]
            outside = arm.distance_outside_reach(world_from_flange).reshape(len(angles), len(rest))
            for angle, targets, near in zip(angles, world_from_flange, ~(outside > 0), strict=True):  # NaN: unknown
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


def _orientations() -> Array:
    """(k, 3, 3) ``table_from_sensor`` at azimuth 0, the sensor on the side of x > 0, for all elevations and headings.

    Straight down and up the heading is the azimuth, and only one is listed.
    """
    result = []
    for elevation in np.arange(-np.pi / 2, np.pi / 2 + ANGLE_STEP / 2, ANGLE_STEP):
        c, s = np.cos(elevation), np.sin(elevation)
        upright = np.array([[0.0, -s, -c], [-1.0, 0.0, 0.0], [0.0, c, -s]])
        headings = np.arange(_AZIMUTHS if c > 1e-9 else 1) * ANGLE_STEP
        result.append(upright @ pose.rotation_about(2, headings))
    return np.concatenate(result)


def _bodies(nominal: NominalCell, frames: set[str]) -> list[Body]:
    return [body for body in nominal.bodies if body.moves_with in frames]


def _joined(meshes: list[Mesh]) -> Mesh:
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), "part and table")


def _feed(sha: hashlib._Hash, *arrays: NDArray[np.generic]) -> None:
    for array in arrays:
        sha.update(f"{array.dtype.str}{array.shape}".encode())
        sha.update(np.ascontiguousarray(array).data)


def _read(file: Path, samples: int) -> Flags | None:
    """Which samples are measurable (n,), from a cache file; None when it is missing, damaged or of another size."""
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
