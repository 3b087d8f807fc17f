"""Pictures of rigid bodies by ray tracing: one ray and one shadow ray a pixel, more where colours change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array, Image
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.output.deviation_report import colour_limit_um, deviation_colours
from scancell.output.sheet import interpolated_colours
from scancell.reconstruction.cloud import Cloud
from scancell.views.camera import LaserSheet, PinholeCamera

SUN = np.array([-0.30, -0.52, 0.80]) / np.linalg.norm([-0.30, -0.52, 0.80])  # towards it, in the world
GRID = 0.1  # m between the lines on the floor

_SKY, _BOUNCE = 0.46, 0.26  # of a white surface that looks up, and down
_SUNLIGHT = 0.62
_HIGHLIGHT, _SHARPNESS = 0.10, 5  # strength, and the exponent of the highlight as a power of two
_FLOOR = np.array([0.76, 0.775, 0.79])
_BACKDROP = np.array([0.89, 0.905, 0.925])
_LINE, _LINE_WIDTH = 0.80, 1.2e-3  # darkness of grid lines, and their width, m
FLOOR_END = 3.2  # m from the middle of the cell, where the floor has become the backdrop
_FADE_FROM = 1.0  # m from there, where that begins
_GAMMA = 2.0

Index = NDArray[np.int64]

FLOOR, NOTHING = -2, -1  # in place of the number of a body

_BLOCK_PX = 1 << 15  # pixels worked on at a time, which stay in the cache
_LIFT = 2e-4  # m off the surface where shadow rays start
_FAR = 50.0  # m: where a body is put to be out of the way, and beyond any shadow
_EDGE = 0.05  # step of displayed brightness between neighbours from which on a pixel is traced again
_SUBPIXELS = np.array([(-0.375, -0.125), (0.125, -0.375), (0.375, 0.125), (-0.125, 0.375)])  # rotated grid
_STRIPE = np.array([1.0, 0.02, 0.02])
_VEIL = 0.16  # opacity of the sheet of light near its source

ColourBy = Literal["deviation", "intensity"]

_RAMP = np.array([(48, 18, 99), (32, 84, 151), (22, 140, 140), (110, 196, 84), (250, 230, 60)], float)
_BEHIND = 1.5e-3  # m by which a point may lie behind the surface that its pixel shows
_SHADED = 0.62  # brightness of points that face away from the sun, of 1
_LARGEST_PX = 3  # half width of the mark of a point at most


def linear(colour: tuple[float, float, float]) -> Array:
    """Linear light (3,) of a displayed colour, 0 to 1."""
    return np.asarray(colour, float) ** _GAMMA


def displayed(light: Array) -> Image:
    """Pixels (..., 3) of linear light (..., 3)."""
    return np.asarray(255 * np.sqrt(np.clip(light, 0.0, 1.0)) + 0.5, np.uint8)


def shade(colour: Array, normals: Array, towards_viewer: Array, sunlit: Array) -> Array:
    """Light (n, 3) of surfaces with linear colours (n, 3) and unit normals (n, 3) on the viewer's side.

    `towards_viewer` (n, 3) is of unit length; `sunlit` (n,) is 0 in shadow, else 1. Sky and floor light by the
    direction of the normal alone; the highlight is Blinn's.
    """
    sky = 0.5 * (1 + normals[:, 2])
    cosine = np.maximum(normals @ SUN, 0.0) * sunlit
    facing = np.einsum("ni,ni->n", normals, towards_viewer)
    diffuse = (_BOUNCE + (_SKY - _BOUNCE) * sky) * (0.75 + 0.25 * facing) + _SUNLIGHT * cosine
    half = towards_viewer + SUN
    gloss = np.einsum("ni,ni->n", normals, half) / np.sqrt(np.einsum("ni,ni->n", half, half))
    gloss = np.maximum(gloss, 0.0) * (cosine > 0)
    for _ in range(_SHARPNESS):
        gloss = gloss * gloss
    return np.asarray(colour * diffuse[:, None] + _HIGHLIGHT * gloss[:, None])


def floor_light(points: Array, middle: Array, pixel_sizes: tuple[Array, Array], sunlit: Array) -> Array:
    """Light (n, 3) of points (n, 3) on the floor, which fades into the backdrop away from `middle` (3,).

    `pixel_sizes` (n,) are the widths of a pixel on the floor along world x and y, m; the grid is averaged over them.
    """
    lines = np.zeros(len(points))
    for axis, size in enumerate(pixel_sizes):
        off = np.abs(points[:, axis] - GRID * np.rint(points[:, axis] / GRID))
        cover = np.clip((_LINE_WIDTH / 2 + size / 2 - off) / size, 0.0, np.minimum(_LINE_WIDTH / size, 1.0))
        lines = np.maximum(lines, cover)
    brightness = (1 - (1 - _LINE) * lines) * (0.70 + 0.30 * sunlit)
    light = _FLOOR**_GAMMA * brightness[:, None]
    away = np.hypot(points[:, 0] - middle[0], points[:, 1] - middle[1])
    fade = np.clip((away - _FADE_FROM) / (FLOOR_END - _FADE_FROM), 0.0, 1.0)
    fade = fade * fade * (3 - 2 * fade)
    return np.asarray(light + fade[:, None] * (_BACKDROP**_GAMMA - light))


def backdrop(count: int) -> Array:
    """Light (count, 3) where nothing is seen."""
    return np.tile(_BACKDROP**_GAMMA, (count, 1))


@dataclass(frozen=True)
class PaintedBody:
    """A rigid body: mesh in its own frame, m, and displayed colour (3,), 0 to 1; `lets_laser_pass` for its housing."""

    name: str
    mesh: Mesh
    colour: tuple[float, float, float]
    lets_laser_pass: bool = False


@dataclass(frozen=True)
class Rendered:
    """Linear light (h, w, 3), number of the body (h, w) or FLOOR or NOTHING, and depth (h, w) along the axis, m.

    `stripe` (h, w), 0 to 1, is the share of the laser's stripe in the light.
    """

    light: Array
    stripe: Array
    body: Index
    depth: Array


class Renderer:
    """Renders bodies on a floor. Works in the thread that calls, and any number of threads may.

    Parameters
    ----------
    floor_z
        Height of the floor in the world, m.
    middle
        World point (3,) around which the floor is visible.
    """

    def __init__(self, bodies: Sequence[PaintedBody], floor_z: float, middle: Array) -> None:
        self._bodies, self._floor_z, self._middle = tuple(bodies), floor_z, np.asarray(middle, float)
        self._scene = sensor_rt.Scene()
        for body in bodies:
            self._scene.add_mesh(body.name, body.mesh.vertices, body.mesh.faces.astype(np.uint32), 0.5)
        self._first_face = np.cumsum([0, *(len(body.mesh.faces) for body in bodies)])
        self._normals = np.concatenate([body.mesh.normals for body in bodies])
        self._colours = np.stack([linear(body.colour) for body in bodies])

    def render(self, camera: PinholeCamera, world_from_body: Array, *lasers: LaserSheet) -> Rendered:
        """A picture with the bodies at poses (bodies, 4, 4), and the lasers that are on."""
        view = _View(self, camera, np.asarray(world_from_body, float), lasers)
        width, height = camera.width_px, camera.height_px
        column, row = np.meshgrid(np.arange(width), np.arange(height))
        pixels = np.stack([column.ravel(), row.ravel()], -1).astype(float)
        light, stripe, body, depth = view.trace(pixels)
        edges = np.flatnonzero(_edges(light.reshape(height, width, 3), body.reshape(height, width)))
        if len(edges):
            fine = (pixels[edges][:, None] + _SUBPIXELS).reshape(-1, 2)
            fine_light, fine_stripe, *_ = view.trace(fine)
            light[edges] = fine_light.reshape(len(edges), len(_SUBPIXELS), 3).mean(1)
            stripe[edges] = fine_stripe.reshape(len(edges), len(_SUBPIXELS)).mean(1)
        shape = (height, width)
        return Rendered(light.reshape(*shape, 3), stripe.reshape(shape), body.reshape(shape), depth.reshape(shape))


class _View:
    """One picture: camera, poses, lasers."""

    def __init__(self, renderer: Renderer, camera: PinholeCamera, poses: Array, lasers: Sequence[LaserSheet]) -> None:
        self._camera, self._poses, self._lasers = camera, poses, lasers
        self._scene, self._floor_z, self._middle = renderer._scene, renderer._floor_z, renderer._middle
        self._first_face, self._normals, self._colours = renderer._first_face, renderer._normals, renderer._colours
        self._laser_poses = poses.copy()
        passed = [body.lets_laser_pass for body in renderer._bodies]
        self._laser_poses[passed] = np.eye(4)
        self._laser_poses[passed, 2, 3] = -_FAR
        self._shadow_box = _shadow_box(renderer._bodies, poses, self._floor_z)

    def trace(self, pixels: Array) -> tuple[Array, Array, Index, Array]:
        """Light (n, 3), stripe (n,), body (n,) and depth (n,) of pixels (n, 2); see `Rendered`."""
        blocks = [self._trace(pixels[start : start + _BLOCK_PX]) for start in range(0, len(pixels), _BLOCK_PX)]
        light, stripe, body, depth = map(np.concatenate, zip(*blocks, strict=True))
        return light, stripe, body, depth

    def _trace(self, pixels: Array) -> tuple[Array, Array, Index, Array]:
        eye, directions = self._camera.centre, self._camera.directions(pixels)
        length = np.sqrt(np.einsum("ni,ni->n", directions, directions))
        origins = np.broadcast_to(eye, directions.shape)
        distance, number, face = sensor_rt.cast_rays(self._scene, self._poses, origins, directions, 1)
        body, depth = number.astype(np.int64), np.asarray(distance / length)
        with np.errstate(divide="ignore"):
            down = np.where(directions[:, 2] < 0, (self._floor_z - eye[2]) / directions[:, 2], np.inf)
        floor = (down > 0) & (down < depth)
        body[floor], depth[floor] = FLOOR, down[floor]
        light = backdrop(len(pixels))
        rows = np.flatnonzero(body >= 0)
        light[rows] = self._bodies_light(body[rows], face[rows], depth[rows], directions[rows], length[rows])
        x, y = (eye[i] + np.where(floor, depth, 0.0) * directions[:, i] - self._middle[i] for i in (0, 1))
        rows = np.flatnonzero(floor & (x * x + y * y < FLOOR_END**2))
        light[rows] = self._floor_light(depth[rows], directions[rows])
        stripe = np.zeros(len(pixels))
        for laser in self._lasers:
            self._add_laser(laser, light, stripe, depth, directions)
        return light, stripe, body, depth

    def _bodies_light(self, body: Index, face: Index, depth: Array, directions: Array, length: Array) -> Array:
        points = self._camera.centre + depth[:, None] * directions
        back = -directions / length[:, None]
        normals = np.einsum("nij,nj->ni", self._poses[body, :3, :3], self._normals[self._first_face[body] + face])
        normals[np.einsum("ni,ni->n", normals, back) < 0] *= -1
        sunlit = np.zeros(len(points))
        lit = np.flatnonzero(normals @ SUN > 0)
        sunlit[lit] = ~self._blocked(points[lit] + _LIFT * normals[lit], points[lit] + _FAR * SUN, self._poses)
        return shade(self._colours[body], normals, back, sunlit)

    def _floor_light(self, depth: Array, directions: Array) -> Array:
        points = self._camera.centre + depth[:, None] * directions
        (left, front), (right, rear) = self._shadow_box
        x, y = points[:, 0], points[:, 1]
        near = np.flatnonzero((x >= left) & (x <= right) & (y >= front) & (y <= rear))
        sunlit = np.ones(len(points))
        start = points[near] + np.array([0.0, 0.0, _LIFT])
        sunlit[near] = ~self._blocked(start, points[near] + _FAR * SUN, self._poses)
        return floor_light(points, self._middle, self._floor_pixels(depth, directions), sunlit)

    def _floor_pixels(self, depth: Array, directions: Array) -> tuple[Array, Array]:
        """Widths (n,) of pixels on the floor along world x and y: how far a step of one pixel moves the point there."""
        scale, tilt = depth / self._camera.focal_px, directions / directions[:, 2:]
        right, down, _ = self._camera.world_from_camera[:3, :3].T
        x, y = (
            scale * (np.abs(right[i] - right[2] * tilt[:, i]) + np.abs(down[i] - down[2] * tilt[:, i])) for i in (0, 1)
        )
        return x, y

    def _add_laser(self, laser: LaserSheet, light: Array, stripe: Array, depth: Array, directions: Array) -> None:
        eye, source = self._camera.centre, laser.source
        rows, bright = laser.stripe(eye, directions, depth, self._camera.focal_px)
        points = eye + depth[rows, None] * directions[rows]
        # The ray ends before the surface by more than rounding, by less than anyone sees.
        towards = source - points
        end = points + 4 * _LIFT * towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        bright *= ~self._blocked(np.broadcast_to(source, end.shape), end, self._laser_poses)
        stripe[rows] = np.maximum(stripe[rows], bright)
        light[rows] += bright[:, None] * (_STRIPE - light[rows])
        rows, points, left = laser.veil(eye, directions, depth)
        left *= ~self._blocked(np.broadcast_to(source, points.shape), points, self._laser_poses)
        light[rows] += (_VEIL * left)[:, None] * (_STRIPE - light[rows])

    def _blocked(self, start: Array, end: Array, poses: Array) -> NDArray[np.bool_]:
        if not len(start):
            return np.zeros(0, bool)
        return np.asarray(sensor_rt.occluded(self._scene, poses, start, end, 1))


def _shadow_box(bodies: Sequence[PaintedBody], poses: Array, floor_z: float) -> tuple[Array, Array]:
    """Lower and upper corner (2,) of a box on the floor, along world x and y, that holds all shadows."""
    corners = []
    for body, placed in zip(bodies, poses, strict=True):
        low, high = body.mesh.bounds
        box = np.array([[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i, j, k in np.ndindex(2, 2, 2)])
        world = pose.transform_points(placed, box)
        corners.append(world[:, :2] - (world[:, 2:] - floor_z) / SUN[2] * SUN[:2])
    every = np.concatenate(corners)
    return every.min(0), every.max(0)


def _edges(light: Array, body: Index) -> NDArray[np.bool_]:
    """Pixels (h, w) that differ from a neighbour by body or by displayed brightness."""
    red, green = (
        np.sqrt(np.clip(light[..., i], 0.0, 1.0)).astype(np.float32) for i in (0, 1)
    )  # enough to find all edges
    found = np.zeros(body.shape, bool)
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        step = body[one] != body[other]
        for shown in (red, green):
            step |= np.abs(shown[one] - shown[other]) > _EDGE
        found[one] |= step
        found[other] |= step
    return found


@dataclass(frozen=True)
class ColouredCloud:
    """Points (n, 3) in the part frame, m, in the order of their time (n,), s, with linear colours (n, 3), 0 to 1.

    `normals` (n, 3) are those of the cloud, NaN where there are none.
    `total` counts the points of the whole cloud, of which these are evenly chosen. `spacing` is the typical distance
    between neighbours in the complete cloud, m. `scale` (k, 3) holds the displayed colours, 0 to 255, from one of the
    values `limits` to the other; `title` is their name.
    """

    points_in_part: Array
    normals: Array
    time: Array
    colours: Array
    total: int
    spacing: float
    scale: Array
    limits: tuple[float, float]
    title: str

    def measured_until(self, time: float) -> int:
        """Number of points that were measured at `time` (s) or before."""
        return int(np.searchsorted(self.time, time, side="right"))

    def draw(self, rendered: Rendered, camera: PinholeCamera, world_from_part: Array, time: float) -> None:
        """Blend the points measured until `time` into the light of a picture, where its depth does not hide them.

        A point covers as many pixels as leave no gap to its neighbours; its mark fades out over one pixel. The laser's
        stripe stays on top.
        """
        count = self.measured_until(time)
        pixels, ahead = camera.project(pose.transform_points(world_from_part, self.points_in_part[:count]))
        height, width = rendered.depth.shape
        column, row = pixels.T  # NaN, behind the camera, compares as outside
        inside = (column > -0.5) & (column < width - 0.5) & (row > -0.5) & (row < height - 0.5)
        rows = np.flatnonzero(inside)
        column, row = np.rint(pixels[rows]).astype(np.int64).T
        size = ahead[rows] / camera.focal_px
        shown = ahead[rows] < rendered.depth[row, column] + _BEHIND + 2 * size
        rows, column, row = rows[shown], column[shown], row[shown]
        if not len(rows):
            return
        radius = float(np.clip(0.8 * self.spacing / size[shown].mean(), 0.5, _LARGEST_PX))
        rim = int(np.ceil(radius))
        left, top = max(int(column.min()) - rim, 0), max(int(row.min()) - rim, 0)
        area = np.s_[top : int(row.max()) + rim + 1, left : int(column.max()) + rim + 1]
        part = rendered.light[area]
        weight, colour = _marks(pixels[rows] - (left, top), self.shaded(rows, world_from_part), radius, part.shape[:2])
        part += (np.minimum(weight, 1.0) * (1 - rendered.stripe[area]))[..., None] * (colour - part)

    def shaded(self, rows: NDArray[np.int64], world_from_part: Array) -> Array:
        """Linear colours (k, 3) of points, shaded to show the shape, but too little to change a reading."""
        cosine = np.clip(self.normals[rows] @ (world_from_part[:3, :3].T @ SUN), 0.0, 1.0)
        shade = _SHADED + (1 - _SHADED) * np.nan_to_num(cosine, nan=1.0)
        return np.asarray(self.colours[rows] * shade[:, None])


def coloured_by(cloud: Cloud, total: int, mesh: Mesh | None, what: ColourBy, threads: int = 0) -> ColouredCloud:
    """Colour a cloud, of `total` points before thinning, by its distance from the mesh or by its intensity.

    Without a mesh, by its intensity.
    """
    if mesh is None:
        what = "intensity"
    if mesh is not None and what == "deviation":
        deviation = deviation_from_mesh(cloud, mesh, threads)
        limit = colour_limit_um(deviation.figures.d95)
        values, limits, title = 1e6 * deviation.distance, (-limit, limit), "deviation, µm"
    else:
        values, title = np.asarray(cloud.intensity, float), "intensity, DN"
        limits = (0.0, max(float(np.quantile(values, 0.99)) if len(values) else 0.0, 1e-9))
    scale = colour_scale(what)
    place = np.clip((values - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0) * (len(scale) - 1)
    colours = (scale[place.astype(np.int64)] / 255) ** 2
    spacing = float(np.sqrt(_area(cloud, mesh) / max(len(cloud), 1)))
    return ColouredCloud(cloud.points_in_part, cloud.normals, cloud.time, colours, total, spacing, scale, limits, title)


def _area(cloud: Cloud, mesh: Mesh | None) -> float:
    """Area of the surface, m²; without a mesh that of the two longer sides of the cloud's bounding box."""
    if mesh is not None:
        return float(mesh.areas.sum())
    sides = np.sort(np.ptp(cloud.points_in_part, axis=0)) if len(cloud) else np.zeros(3)
    return float(sides[1] * sides[2])


def colour_scale(what: ColourBy) -> Array:
    """Displayed colours (256, 3), 0 to 255, from the least value to the largest."""
    if what == "deviation":
        return deviation_colours(np.linspace(-1, 1, 256), 1.0)
    return interpolated_colours(_RAMP)


def _marks(pixels: Array, colours: Array, radius: float, size: tuple[int, int]) -> tuple[Array, Array]:
    """Sum of weights (h, w) and mean colour (h, w, 3) of the marks of points (n, 2) in an image of `size` (h, w)."""
    height, width = size
    total, mixed = np.zeros(height * width), np.zeros((3, height * width))
    column, row = np.rint(pixels).astype(np.int64).T
    reach = int(np.ceil(radius))
    for down, right in np.ndindex(2 * reach + 1, 2 * reach + 1):
        x, y = column + right - reach, row + down - reach
        weight = np.clip(radius + 0.5 - np.hypot(x - pixels[:, 0], y - pixels[:, 1]), 0.0, 1.0)
        kept = np.flatnonzero((weight > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height))
        place = y[kept] * width + x[kept]
        total += np.bincount(place, weight[kept], len(total))
        for channel in range(3):
            mixed[channel] += np.bincount(place, weight[kept] * colours[kept, channel], len(total))
    mean = mixed / np.where(total > 0, total, 1.0)
    return total.reshape(size), mean.T.reshape(height, width, 3)
