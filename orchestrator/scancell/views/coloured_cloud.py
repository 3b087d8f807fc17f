"""The measured cloud in pictures: coloured points that appear at the time of their measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.output.deviation_picture import colour_limit_um, deviation_colours
from scancell.output.drawing import interpolated_colours
from scancell.reconstruction.cloud import Cloud
from scancell.views.camera import PinholeCamera
from scancell.views.renderer import Rendered
from scancell.views.shading import SUN

Array = NDArray[np.float64]
ColourBy = Literal["deviation", "intensity"]

_RAMP = np.array([(48, 18, 99), (32, 84, 151), (22, 140, 140), (110, 196, 84), (250, 230, 60)], float)
_BEHIND = 1.5e-3  # m by which a point may lie behind the surface that its pixel shows
_SHADED = 0.62  # brightness of points that face away from the sun, of 1
_LARGEST_PX = 3  # half width of the mark of a point at most


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
