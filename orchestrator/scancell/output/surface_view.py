"""Orthographic image of a part: grey surface, its edges, and values as coloured points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.geometry.mesh import Mesh, clustered
from scancell.geometry.mesh_files import weld
from scancell.output.sheet import Pixels, resized

Index = NDArray[np.int64]

_INK = (34, 40, 49)
_FINE = 2  # pixels of the drawing along each side of a pixel of the image, which smooths outlines
_ROWS = 32  # of pixels that are cast at a time
_MOST_POINTS = 150_000
_MANY_FACES = 150_000  # from which on the surface is drawn from a coarser mesh
_CELLS = 250  # of that mesh along the largest extent
_SHARP = np.cos(np.radians(25.0))  # angle between two faces from which their edge is drawn
_MOST_EDGES = 50_000  # a scanned or noisy mesh has no meaningful edges
_LIFT = 30e-6  # m off the surface where lines of sight start; clouds lie that close to it
_RIM_PX = 4  # of the image, around the part
_REACH = 2 * _FINE  # px by which marks reach beyond their middle at most
_FACING = 0.05  # least cosine between line of sight and normal at which points are drawn


def view_axes(azimuth_deg: float, elevation_deg: float) -> Array:
    """Rows (3, 3): right, up and towards the viewer, who stands at `azimuth_deg` from x and `elevation_deg` up."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


class SurfaceView:
    """Draws points (n, 3) with a value each and the mesh face (n,) they lie on, from any side.

    `colours` turns values (k,) into colours (k, 3), 0 to 255.
    """

    def __init__(
        self,
        mesh: Mesh,
        points: Array,
        values: Array,
        face: NDArray[np.integer[Any]],
        colours: Callable[[Array], Array],
    ) -> None:
        self._mesh, self._colours = mesh, colours
        self._points, self._values, self._face = points, values, face
        extent = np.ptp(mesh.bounds, axis=0)
        self._far = 2.0 * float(np.linalg.norm(extent))
        coarse = clustered(mesh, float(extent.max()) / _CELLS) if len(mesh.faces) > _MANY_FACES else mesh
        self._surface = coarse
        self._lift = _LIFT if coarse is mesh else 2.0 * float(extent.max()) / _CELLS
        self._scene = sensor_rt.Scene()
        self._scene.add_mesh("part", coarse.vertices, coarse.faces.astype(np.uint32), sensor_rt.Material(0.5))
        # A mesh made coarser has edges of its own.
        none = np.zeros((0, 2, 3)), np.zeros((0, 3))
        self._edges, self._edge_normals = sharp_edges(mesh) if coarse is mesh else none

    def draw(self, axes_in_part: Array, width_px: int, height_px: int) -> tuple[Pixels, float]:
        """Orthographic view along the rows of `axes_in_part`, as large as fits: image (h, w, 3) and px per metre."""
        canvas = _Canvas(self._surface, axes_in_part, width_px, height_px)
        self._draw_surface(canvas)
        self._draw_points(canvas)
        self._draw_edges(canvas)
        return canvas.image(), canvas.scale / _FINE

    def _draw_surface(self, canvas: _Canvas) -> None:
        light = np.abs(self._surface.normals @ canvas.axes[2])
        grey = np.append(255 * (0.5 + 0.3 * light), 255).astype(np.uint8)  # the last one is the background, face -1
        for first in range(0, len(canvas.colour), _ROWS):
            pixels = canvas.colour[first : first + _ROWS]
            start = canvas.pixel_positions(first, len(pixels)) + self._far * canvas.axes[2]
            face = self._cast(start.reshape(-1, 3), -canvas.axes[2])
            pixels[:] = grey[face].reshape(pixels.shape[:2])[..., None]

    def _draw_points(self, canvas: _Canvas) -> None:
        light_of_face = self._mesh.normals @ canvas.axes[2]
        # Most points may be hidden: more are looked at than drawn.
        rows = _thinned(np.arange(len(self._points)), 6 * _MOST_POINTS)
        rows = _thinned(rows[light_of_face[self._face[rows]] > _FACING], 2 * _MOST_POINTS)
        rows = rows[self._in_view(self._points[rows], self._mesh.normals[self._face[rows]], canvas.axes)]
        rows = _thinned(rows, _MOST_POINTS)
        if not len(rows):
            return
        # Shading enough to show the shape, too little to shift a reading.
        shade = 0.8 + 0.2 * light_of_face[self._face[rows]]
        paint = (self._colours(self._values[rows]) * shade[:, None]).astype(np.uint8)
        radius = np.sqrt(canvas.area / len(rows) / np.pi)  # so that neighbouring marks touch
        canvas.mark(self._points[rows], paint, float(np.clip(radius, 1.0 * _FINE, 1.6 * _FINE)))

    def _draw_edges(self, canvas: _Canvas) -> None:
        along = self._edges[:, 1] - self._edges[:, 0]
        count = np.ceil(np.linalg.norm(along, axis=1) * canvas.scale).astype(int) + 1
        edge = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / count[edge]
        places = self._edges[edge, 0] + share[:, None] * along[edge]
        seen = self._in_view(places, self._edge_normals[edge], canvas.axes)
        canvas.darken(places[seen], np.array(_INK), 0.75)

    def _in_view(self, points: Array, normals: Array, axes_in_part: Array) -> NDArray[np.bool_]:
        return self._cast(points + self._lift * normals, axes_in_part[2]) < 0

    def _cast(self, start: Array, direction: Array) -> Index:
        """Face (n,) that rays from `start` (n, 3) meet first, -1 for none."""
        if not len(start):
            return np.zeros(0, np.int64)
        directions = np.tile(direction, (len(start), 1))
        return np.asarray(sensor_rt.cast_rays(self._scene, np.eye(4)[None], start, directions)[2])


class _Canvas:
    """An image finer by `_FINE` than wanted, and where points of the part lie in it; `scale` is its pixels per metre.

    Rows grow downwards, as in the image.
    """

    def __init__(self, mesh: Mesh, axes: Array, width_px: int, height_px: int) -> None:
        self.axes = axes
        seen = mesh.vertices @ axes.T
        low, high = seen.min(0)[:2], seen.max(0)[:2]
        room = np.array([width_px, height_px]) - 2 * _RIM_PX
        self.scale = float((room / (high - low)).min()) * _FINE
        self.area = float(np.prod((high - low) * self.scale))
        width, height = np.ceil((high - low) * self.scale / _FINE).astype(int) + 2 * _RIM_PX
        self.colour = np.empty((height * _FINE, width * _FINE, 3), np.uint8)
        self._corner = np.array([low[0], high[1], seen[:, 2].mean()])  # upper left corner of the part
        self._rim = _RIM_PX * _FINE

    def pixel_positions(self, first: int, rows: int) -> Array:
        """(rows, width, 3) middles of the pixels of rows, counted from the top, on a plane through the part."""
        x = self._corner[0] + (np.arange(self.colour.shape[1]) + 0.5 - self._rim) / self.scale
        y = self._corner[1] - (np.arange(first, first + rows) + 0.5 - self._rim) / self.scale
        middle = self._corner[2] * self.axes[2]
        return np.asarray(y[:, None, None] * self.axes[1] + middle + x[:, None] * self.axes[0])

    def mark(self, points: Array, paint: Pixels, radius: float) -> None:
        """Draw discs of `radius` px at points (n, 3) in colours (n, 3), the nearest to the viewer last."""
        order = np.argsort(points @ self.axes[2])
        reach = int(np.ceil(radius))
        steps = range(-reach, reach + 1)
        disc = [i * self.colour.shape[1] + j for i in steps for j in steps if i * i + j * j <= radius * radius]
        place = self._pixels(points[order])[:, None] + np.array(disc)
        self.colour.reshape(-1, 3)[place] = paint[order][:, None]

    def darken(self, points: Array, colour: Array, opacity: float) -> None:
        """Blend `_FINE` × `_FINE` pixels at each of the points (n, 3), all of them once, with a colour (3,)."""
        block = [i * self.colour.shape[1] + j for i in range(_FINE) for j in range(_FINE)]
        place = np.unique(self._pixels(points)[:, None] + np.array(block))
        flat = self.colour.reshape(-1, 3)
        flat[place] = (1 - opacity) * flat[place] + opacity * colour

    def _pixels(self, points: Array) -> Index:
        """Number (n,) of the pixel that each point lies in."""
        height, width = self.colour.shape[:2]
        x = ((points @ self.axes[0] - self._corner[0]) * self.scale).astype(np.int64) + self._rim
        y = ((self._corner[1] - points @ self.axes[1]) * self.scale).astype(np.int64) + self._rim
        # Marks reach a few pixels beyond their middle, wild points anywhere.
        y, x = np.clip(y, _REACH, height - 1 - _REACH), np.clip(x, _REACH, width - 1 - _REACH)
        return np.asarray(y * width + x)

    def image(self) -> Pixels:
        """(height, width, 3) at the resolution that was wanted."""
        height, width = self.colour.shape[:2]
        return resized(self.colour, width // _FINE, height // _FINE)


def _thinned(rows: Index, most: int) -> Index:
    """At most `most` rows, evenly chosen."""
    return rows[:: max(1, -(-len(rows) // most))]


def sharp_edges(mesh: Mesh) -> tuple[Array, Array]:
    """Edges (k, 2, 3) where two faces meet at more than 25°, and the sum (k, 3) of the normals there.

    None for a mesh with too many of them.
    """
    first, number = weld(mesh.vertices)
    faces = number[mesh.faces]
    tail, head = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    key = np.minimum(tail, head) * len(first) + np.maximum(tail, head)
    order = np.argsort(key)
    same = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    one, other = order[same] // 3, order[same + 1] // 3
    sharp = np.einsum("ki,ki->k", mesh.normals[one], mesh.normals[other]) < _SHARP
    if sharp.sum() > _MOST_EDGES:
        return np.zeros((0, 2, 3)), np.zeros((0, 3))
    corner = order[same[sharp]]
    ends = mesh.vertices[first[np.stack([tail[corner], head[corner]], 1)]]
    return ends, mesh.normals[one[sharp]] + mesh.normals[other[sharp]]
