"""Ground truth of a scan: true centre line of the stripe in the images, and true surface point of every cloud point.

Laser rays, four per image column, are cast from the true sensor at mid-exposure, and the points that a camera sees are
projected into its image: this gives the centre line of the stripe to a small fraction of a pixel. The camera ray
through such a pixel is intersected with meshes and exact shapes in double precision, for the surface point, face and
normal. Reconstruction does not use any of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.cell.recording import Recording
from scancell.config.sensor import (
    ExtractionDescription,
    GeometricDescription,
    RenderDescription,
    SensorDescription,
    read_out,
)
from scancell.errors import SensorError
from scancell.geometry import pose
from scancell.geometry.shapes import ShapeMesh
from scancell.nominal.cell import Lamp
from scancell.nominal.parts import Body
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.sense import SensedProfiles, expose
from scancell.scanning.world import build_scene, exposures_from_truth, make_sensor, true_poses

Integers = NDArray[np.int64]

_BATCH = 64  # exposures at a time
_RAYS_PER_COLUMN = 4
_MAX_RAYS = 65_536
# Larger steps in the image between neighbouring rays are depth discontinuities.
_MAX_STEP_PX = 1.0
_NONE = -1


@dataclass(frozen=True)
class Surface:
    """Surface points and unit normals (n, 3) in the true part frame, m, body and face index (n,); NaN and -1: none.

    The face of a body of exact shapes is the number of the shape.
    """

    points_in_part: Array
    normals: Array
    body: Integers
    face: Integers


@dataclass(frozen=True)
class Stripe:
    """True centre line of the laser stripe in the images: one entry per exposure, camera and column crossing.

    `exposure` (n,) is the row of the recording, `row` (n,) is in px. A column may be crossed more than once.
    """

    exposure: Integers
    camera: Integers
    column: Integers
    row: Array
    surface: Surface


@dataclass(frozen=True)
class CloudTruth:
    """True surface point of each cloud point, and true and measured rows (n,), px, of the stripe in its column."""

    row: Array
    row_measured: Array
    surface: Surface


class TrueWorld:
    """Bodies and sensor with their true poses at the middle of every exposure.

    Raises `SensorError` if the sensor has a rolling shutter, as one pose per exposure does not describe its rows, or
    chooses its exposure times.

    Parameters
    ----------
    bodies
        Bodies of the scene; lamps are ignored.
    sensor
        Description of the sensor as built.
    threads
        Number of threads; 0 uses all cores.
    """

    def __init__(
        self, recording: Recording, bodies: Sequence[Body | Lamp], sensor: SensorDescription, seed: int, threads: int
    ) -> None:
        if sensor.detector.shutter == "rolling":
            raise SensorError(
                "ground truth needs a global shutter", file=sensor.name, key="detector.shutter", value="rolling"
            )
        if sensor.exposure.mode != "fixed":
            raise SensorError(
                "ground truth needs fixed exposures", file=sensor.name, key="exposure.mode", value=sensor.exposure.mode
            )
        rays = min(_MAX_RAYS, _RAYS_PER_COLUMN * max(camera.width_px for camera in read_out(sensor).camera))
        exact = {
            "render": RenderDescription(noise=False),
            "extraction": ExtractionDescription(),
            "geometric": GeometricDescription(rays=rays),
        }
        dense = sensor.model_copy(update=exact)
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
        """True ``part_from_sensor`` (n, 4, 4) at mid-exposure."""
        return np.asarray(pose.inverse(self.world_from_part) @ self.world_from_sensor)

    def stripe(self) -> Stripe:
        """True centre line of the stripe in all images, sorted by exposure and camera."""
        found = SensedProfiles.joined(map(self._dense, range(0, len(self._recording), _BATCH))).points
        frame, camera = found.frame.astype(np.int64), found.camera.astype(np.int64)
        frame, camera, column, row = _crossings(frame, camera, self._project(found.points_in_sensor, camera))
        return Stripe(frame, camera, column, row, self.surface_at(frame, camera, np.stack([column, row], -1)))

    def _dense(self, start: int) -> SensedProfiles:
        """Profiles of a batch of exposures by many rays."""
        index, rows = np.arange(len(self._recording)), slice(start, start + _BATCH)
        exposures = exposures_from_truth(self._recording.truth, index, self._bodies, rows)
        sensors = self._sensor, self._sensor
        return expose(self._scene, *sensors, exposures, index[rows], "geometric", threads=self._threads)

    def of_cloud(
        self,
        cloud: Cloud,
        sensor_from_part_nominal: Array,
        sensor_nominal: sensor_rt.Sensor,
        stripe: Stripe | None,
        between_columns: bool = False,
    ) -> CloudTruth:
        """True surface point of every point of a cloud.

        Parameters
        ----------
        sensor_from_part_nominal
            Poses (n, 4, 4) with which the cloud was reconstructed.
        sensor_nominal
            Sensor model with which the cloud was reconstructed; projects its points back into the images.
        stripe
            Where the stripe truly was. None: where it was found, as the geometric engine finds it without noise.
        between_columns
            Whether points lie between the centres of columns, as those of the geometric engine do.
        """
        exposure = np.searchsorted(self._recording.measured.index, cloud.profile)
        in_sensor = pose.transform_each(sensor_from_part_nominal[exposure], cloud.points_in_part)
        camera = cloud.camera.astype(np.int64)
        pixels = np.zeros((len(cloud), 2))
        for k, model in enumerate(sensor_nominal.cameras):
            pixels[camera == k] = model.project(in_sensor[camera == k])
        measured = pixels[:, 1].copy()
        if stripe is not None:
            column = cloud.column.astype(float)
            pixels[:, 0] = np.clip(pixels[:, 0], column - 0.5, column + 0.5) if between_columns else column
            pixels[:, 1] = _true_row(stripe, exposure, camera, pixels[:, 0], measured)
        return CloudTruth(pixels[:, 1], measured, self.surface_at(exposure, camera, pixels))

    def surface_at(self, exposure: Integers, camera: Integers, pixels: Array) -> Surface:
        """Surface points seen by pixels (n, 2) = (column, row) of the true cameras; none for NaN pixels."""
        n = len(pixels)
        surface = Surface(np.full((n, 3), np.nan), np.full((n, 3), np.nan), np.full(n, _NONE), np.full(n, _NONE))
        for group in _groups(exposure, camera, np.asarray(np.isfinite(pixels).all(1))):
            at, k = int(exposure[group[0]]), int(camera[group[0]])
            self._intersect(surface, group, at, self._sensor.cameras[k], pixels[group])
        return surface

    def _intersect(self, surface: Surface, group: Integers, at: int, camera: sensor_rt.Camera, pixels: Array) -> None:
        """Fill the rows `group` of `surface` with the first hits of the pixels' rays in exposure `at`."""
        world_from_sensor, world_from_body = self.world_from_sensor[at], self._world_from_body[at]
        direction = np.asarray(camera.view_rays(pixels)) @ world_from_sensor[:3, :3].T
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        origin = np.tile((world_from_sensor @ camera.sensor_from_camera)[:3, 3], (len(direction), 1))
        distance, body, face = sensor_rt.cast_rays(self._scene, world_from_body, origin, direction, self._threads)
        points = origin + np.where(body >= 0, distance, 0.0)[:, None] * direction
        surface.body[group], surface.face[group] = body, face
        for number in np.unique(body[body >= 0]):
            seen = np.flatnonzero(body == number)
            mesh = self._bodies[number].mesh
            part_from_body = pose.inverse(self.world_from_part[at]) @ world_from_body[number]
            in_body = pose.transform_points(pose.inverse(world_from_body[number]), points[seen])
            if isinstance(mesh, ShapeMesh):
                on_surface = in_body
                _, normals, surface.face[group[seen]] = mesh.shapes.nearest(in_body)
            else:
                on_surface = clamp_to_triangles(in_body, mesh.vertices[mesh.faces[face[seen]]])
                normals = mesh.normals[face[seen]]
            surface.points_in_part[group[seen]] = pose.transform_points(part_from_body, on_surface)
            surface.normals[group[seen]] = normals @ part_from_body[:3, :3].T

    def _project(self, points_in_sensor: Array, camera: Integers) -> Array:
        pixels = np.zeros((len(points_in_sensor), 2))
        for k, model in enumerate(self._sensor.cameras):
            pixels[camera == k] = model.project(points_in_sensor[camera == k])
        return pixels


def clamp_to_triangles(points: Array, corners: Array) -> Array:
    """Points (n, 3) in the planes of triangles (n, 3, 3), those outside moved to the nearest point of the boundary.

    The ray tracer determines faces in single precision: near an edge it may report the neighbouring face.
    """
    edges = np.roll(corners, -1, 1) - corners
    from_corner = points[:, None] - corners
    normal = np.cross(edges[:, 0], edges[:, 1])
    outside = (np.einsum("nej,nj->ne", np.cross(edges, from_corner), normal) < 0).any(1)
    moved = points.copy()
    edges, from_corner, corners = edges[outside], from_corner[outside], corners[outside]
    length2 = np.maximum(np.einsum("nej,nej->ne", edges, edges), 1e-300)
    fraction = np.clip(np.einsum("nej,nej->ne", from_corner, edges) / length2, 0.0, 1.0)
    nearest = corners + fraction[..., None] * edges
    best = np.linalg.norm(points[outside][:, None] - nearest, axis=-1).argmin(1)
    moved[outside] = nearest[np.arange(len(best)), best]
    return moved


def _crossings(frame: Integers, camera: Integers, pixels: Array) -> tuple[Integers, Integers, Integers, Array]:
    """Frame, camera, column and row (px) where a polyline of pixels (n, 2) crosses integer columns."""
    a, b = pixels[:-1], pixels[1:]
    connected = (frame[:-1] == frame[1:]) & (camera[:-1] == camera[1:])
    connected &= (np.abs(b - a) <= _MAX_STEP_PX).all(1)
    low, high = np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 0], b[:, 0])
    column = np.ceil(low)  # steps are at most one column: at most one crossing
    pairs = np.flatnonzero(connected & (column < high))
    fraction = (column[pairs] - a[pairs, 0]) / (b[pairs, 0] - a[pairs, 0])
    row = a[pairs, 1] + fraction * (b[pairs, 1] - a[pairs, 1])
    return frame[pairs].astype(np.int64), camera[pairs], column[pairs].astype(np.int64), row


def _true_row(stripe: Stripe, exposure: Integers, camera: Integers, column: Array, found: Array) -> Array:
    """(n,) the stripe's row at a column that need not be a whole number; NaN where there is no stripe."""
    below = np.floor(column).astype(np.int64)
    share = column - below
    row = _nearest_row(stripe, exposure, camera, below, found)
    between = np.flatnonzero(share > 0.0)
    if len(between) == 0:
        return row
    above = _nearest_row(stripe, exposure[between], camera[between], below[between] + 1, found[between])
    low, share = row[between], share[between]
    smooth = np.abs(above - low) <= _MAX_STEP_PX
    nearer = np.where(np.isnan(low) | ((share > 0.5) & ~np.isnan(above)), above, low)
    row[between] = np.where(smooth, low + share * (above - low), nearer)
    return row


def _nearest_row(stripe: Stripe, exposure: Integers, camera: Integers, column: Integers, measured: Array) -> Array:
    """Row (n,), px, of the true stripe in the same column that is nearest to the measured row; NaN without any."""
    cameras = 1 + max(int(stripe.camera.max(initial=0)), int(camera.max(initial=0)))
    columns = 1 + max(int(stripe.column.max(initial=0)), int(column.max(initial=0)))

    def key(frame: Integers, k: Integers, c: Integers) -> Integers:
        return (frame * cameras + k) * columns + c

    keys = key(stripe.exposure, stripe.camera, stripe.column)
    order = np.argsort(keys, kind="stable")
    keys, rows = keys[order], stripe.row[order]
    queries = key(exposure, camera, column)
    first, last = np.searchsorted(keys, queries, "left"), np.searchsorted(keys, queries, "right")
    best = np.full(len(queries), np.nan)
    for nth in range(int((last - first).max(initial=0))):
        found = np.flatnonzero(first + nth < last)
        row = rows[first[found] + nth]
        nearer = ~(np.abs(best[found] - measured[found]) <= np.abs(row - measured[found]))
        best[found[nearer]] = row[nearer]
    return best


def _groups(exposure: Integers, camera: Integers, kept: NDArray[np.bool_]) -> list[Integers]:
    """Indices of the kept entries, grouped by exposure and camera."""
    chosen = np.flatnonzero(kept)
    order = chosen[np.lexsort((camera[chosen], exposure[chosen]))]
    change = (np.diff(exposure[order]) != 0) | (np.diff(camera[order]) != 0)
    return [group for group in np.split(order, np.flatnonzero(change) + 1) if len(group)]
