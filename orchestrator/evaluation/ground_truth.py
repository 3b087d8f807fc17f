"""What a scan truly looked at: where the laser met surfaces, in images and on the part, for every exposure and point.

The laser's rays are cast from the true sensor at mid-exposure, four to a pixel column, and each landing point that a
camera sees is projected into its image: so the middle of the stripe is known to a small fraction of a pixel. The
camera's ray through that place is then met with the mesh in double precision, which gives the point, the face and its
normal. Reconstruction knows nothing of all this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.cell.nominal import Body, Lamp
from orchestrator.cell.recording import Recording
from orchestrator.config.sensor import SensorDescription
from orchestrator.errors import SensorError
from orchestrator.geometry import pose
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.scanning.exposures import build_scene, exposures_from_truth, true_poses
from orchestrator.scanning.sense import make_sensor

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_RAYS_PER_COLUMN = 4
_MOST_RAYS = 65_536
# Neighbouring rays whose stripe moves further than this lie on different surfaces.
_LARGEST_STEP_PX = 1.0
_NONE = -1


@dataclass(frozen=True)
class Surface:
    """Places on bodies: points and unit normals (n, 3) in the true part frame, body and face (n,); -1, NaN: none."""

    points_in_part: Array
    normals: Array
    body: Integers
    face: Integers


@dataclass(frozen=True)
class Stripe:
    """Middle of the laser's stripe in the images, a row per exposure, camera and column that it crosses.

    `exposure` (n,) counts the rows of the recording from 0, `row` (n,) is in px. A column may be crossed twice.
    """

    exposure: Integers
    camera: Integers
    column: Integers
    row: Array
    surface: Surface


@dataclass(frozen=True)
class CloudTruth:
    """For every point of a cloud the place that it should be, and the row (px) where the stripe truly was."""

    row: Array
    row_measured: Array
    surface: Surface


class TrueWorld:
    """The bodies, the sensor and their true poses in the middle of every exposure.

    Raises
    ------
    SensorError
        If the shutter rolls: one pose per exposure does not tell where its rows saw things.
    """

    def __init__(
        self, recording: Recording, bodies: Sequence[Body | Lamp], sensor: SensorDescription, seed: int, threads: int
    ) -> None:
        if sensor.detector.shutter == "rolling":
            raise SensorError(f'sensor "{sensor.name}": shutter = "rolling": ground truth needs a global shutter')
        rays = min(_MOST_RAYS, _RAYS_PER_COLUMN * max(camera.width_px for camera in sensor.camera))
        dense = sensor.model_copy(update={"geometric": sensor.geometric.model_copy(update={"rays": rays})})
        # One shape per body, so that faces count as in its mesh.
        self._bodies = [replace(body, patches=()) for body in bodies if isinstance(body, Body)]
        self._scene = build_scene(self._bodies)
        self._sensor = make_sensor(dense, seed)
        self._recording = recording
        self._threads = threads
        self.body_names = [body.name for body in self._bodies]
        poses = true_poses(recording, ["sensor", "part", *(body.moves_with for body in self._bodies)])
        self.world_from_sensor: Array = poses[0]
        self.world_from_part: Array = poses[1]
        self._world_from_body = np.stack(poses[2:], 1)

    @property
    def part_from_sensor(self) -> Array:
        """(n, 4, 4) true poses at mid-exposure."""
        return np.asarray(pose.inverse(self.world_from_part) @ self.world_from_sensor)

    def stripe(self) -> Stripe:
        """Where every column of every image is crossed by the stripe, in the order exposure, camera, column."""
        recording = self._recording
        batches = []
        for start in range(0, len(recording), 64):
            rows = slice(start, min(start + 64, len(recording)))
            exposures = exposures_from_truth(recording.truth, np.arange(len(recording)), self._bodies, rows)
            batches.append(sensor_rt.scan(self._scene, self._sensor, exposures, "geometric", self._threads).profiles)
        frame = np.concatenate([np.asarray(batch.frame) for batch in batches])
        camera = np.concatenate([np.asarray(batch.camera) for batch in batches]).astype(np.int64)
        pixels = self._project(np.concatenate([np.asarray(batch.points_in_sensor) for batch in batches]), camera)
        frame, camera, column, row = _crossings(frame, camera, pixels)
        return Stripe(frame, camera, column, row, self.seen_at(frame, camera, np.stack([column, row], -1)))

    def of_cloud(
        self, cloud: Cloud, believed_from_part: Array, believed: sensor_rt.Sensor, stripe: Stripe | None
    ) -> CloudTruth:
        """Truth of every point of a cloud.

        Parameters
        ----------
        believed_from_part
            Poses (n, 4, 4) sensor_from_part with which the cloud was reconstructed; with the `believed` sensor they
            lead back to the pixels in which the points were found.
        stripe
            Where the stripe truly was. None: where it was found, as the geometric mode finds it without error.
        """
        exposure = np.searchsorted(self._recording.measured.index, cloud.profile)
        in_sensor = pose.transform_each(believed_from_part[exposure], cloud.points_in_part)
        camera = cloud.camera.astype(np.int64)
        pixels = np.zeros((len(cloud), 2))
        for k, seen_by in enumerate(believed.cameras):
            pixels[camera == k] = seen_by.project(in_sensor[camera == k])
        found = pixels[:, 1].copy()
        if stripe is not None:
            pixels[:, 0] = cloud.column
            pixels[:, 1] = _nearest_row(stripe, exposure, camera, cloud.column.astype(np.int64), found)
        return CloudTruth(pixels[:, 1], found, self.seen_at(exposure, camera, pixels))

    def seen_at(self, exposure: Integers, camera: Integers, pixels: Array) -> Surface:
        """What lies behind pixels (n, 2) = (column, row) of true images; NaN pixels see nothing."""
        n = len(pixels)
        surface = Surface(np.full((n, 3), np.nan), np.full((n, 3), np.nan), np.full(n, _NONE), np.full(n, _NONE))
        for group in _groups(exposure, camera, np.asarray(np.isfinite(pixels).all(1))):
            at, k = int(exposure[group[0]]), int(camera[group[0]])
            self._look(surface, group, at, self._sensor.cameras[k], pixels[group])
        return surface

    def _look(self, surface: Surface, group: Integers, at: int, camera: sensor_rt.Camera, pixels: Array) -> None:
        to_world = self.world_from_sensor[at]
        ways = np.asarray(camera.view_rays(pixels)) @ to_world[:3, :3].T
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        eyes = np.tile((to_world @ camera.sensor_from_camera)[:3, 3], (len(ways), 1))
        distance, body, face = sensor_rt.cast_rays(self._scene, self._world_from_body[at], eyes, ways, self._threads)
        points = eyes + np.where(body >= 0, distance, 0.0)[:, None] * ways
        surface.body[group], surface.face[group] = body, face
        for number in np.unique(body[body >= 0]):
            seen = np.flatnonzero(body == number)
            mesh, world_from_body = self._bodies[number].mesh, self._world_from_body[at, number]
            part_from_body = pose.inverse(self.world_from_part[at]) @ world_from_body
            in_body = pose.transform_points(pose.inverse(world_from_body), points[seen])
            on_face = onto_triangles(in_body, mesh.vertices[mesh.faces[face[seen]]])
            surface.points_in_part[group[seen]] = pose.transform_points(part_from_body, on_face)
            surface.normals[group[seen]] = mesh.normals[face[seen]] @ part_from_body[:3, :3].T

    def _project(self, points_in_sensor: Array, camera: Integers) -> Array:
        pixels = np.zeros((len(points_in_sensor), 2))
        for k, seen_by in enumerate(self._sensor.cameras):
            pixels[camera == k] = seen_by.project(points_in_sensor[camera == k])
        return pixels


def onto_triangles(points: Array, corners: Array) -> Array:
    """Points (n, 3) in the planes of their triangles (n, 3, 3); those outside move to the nearest place of the edge.

    The ray tracer names the face in single precision, so that next to an edge it may be the neighbour's.
    """
    edges = np.roll(corners, -1, 1) - corners
    from_corner = points[:, None] - corners
    normal = np.cross(edges[:, 0], edges[:, 1])
    outside = (np.einsum("nej,nj->ne", np.cross(edges, from_corner), normal) < 0).any(1)
    moved = points.copy()
    edges, from_corner, corners = edges[outside], from_corner[outside], corners[outside]
    length2 = np.maximum(np.einsum("nej,nej->ne", edges, edges), 1e-300)
    share = np.clip(np.einsum("nej,nej->ne", from_corner, edges) / length2, 0.0, 1.0)
    nearest = corners + share[..., None] * edges
    best = np.linalg.norm(points[outside][:, None] - nearest, axis=-1).argmin(1)
    moved[outside] = nearest[np.arange(len(best)), best]
    return moved


def _crossings(frame: Integers, camera: Integers, pixels: Array) -> tuple[Integers, Integers, Integers, Array]:
    """Columns that lie between the pixels of neighbouring rays, and the row there; rays come in ascending columns."""
    a, b = pixels[:-1], pixels[1:]
    together = (frame[:-1] == frame[1:]) & (camera[:-1] == camera[1:])
    together &= (np.abs(b - a) <= _LARGEST_STEP_PX).all(1)
    low, high = np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 0], b[:, 0])
    column = np.ceil(low)  # steps are no longer than a column: one at most lies between
    pairs = np.flatnonzero(together & (column < high))
    share = (column[pairs] - a[pairs, 0]) / (b[pairs, 0] - a[pairs, 0])
    row = a[pairs, 1] + share * (b[pairs, 1] - a[pairs, 1])
    return frame[pairs].astype(np.int64), camera[pairs], column[pairs].astype(np.int64), row


def _nearest_row(stripe: Stripe, exposure: Integers, camera: Integers, column: Integers, found: Array) -> Array:
    """(n,) the stripe's row in the same column that is nearest to where it was found; NaN where it was not."""
    cameras = 1 + max(int(stripe.camera.max(initial=0)), int(camera.max(initial=0)))
    columns = 1 + max(int(stripe.column.max(initial=0)), int(column.max(initial=0)))

    def key(frame: Integers, k: Integers, c: Integers) -> Integers:
        return (frame * cameras + k) * columns + c

    keys = key(stripe.exposure, stripe.camera, stripe.column)
    order = np.argsort(keys, kind="stable")
    keys, rows = keys[order], stripe.row[order]
    wanted = key(exposure, camera, column)
    first, last = np.searchsorted(keys, wanted, "left"), np.searchsorted(keys, wanted, "right")
    best = np.full(len(wanted), np.nan)
    for nth in range(int((last - first).max(initial=0))):
        there = np.flatnonzero(first + nth < last)
        row = rows[first[there] + nth]
        nearer = ~(np.abs(best[there] - found[there]) <= np.abs(row - found[there]))
        best[there[nearer]] = row[nearer]
    return best


def _groups(exposure: Integers, camera: Integers, kept: NDArray[np.bool_]) -> list[Integers]:
    """Positions that share exposure and camera."""
    chosen = np.flatnonzero(kept)
    order = chosen[np.lexsort((camera[chosen], exposure[chosen]))]
    change = (np.diff(exposure[order]) != 0) | (np.diff(camera[order]) != 0)
    return [group for group in np.split(order, np.flatnonzero(change) + 1) if len(group)]
