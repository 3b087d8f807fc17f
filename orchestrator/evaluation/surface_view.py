"""A part seen from one side: grey surface, its edges, and values as coloured points on it."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from orchestrator.evaluation.tracer import Tracer
from orchestrator.geometry.mesh import Mesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

COLOURS = "RdYlBu_r"  # blue inside, pale at nominal, red outside: told apart by colour-blind readers too
INK = "#222831"
SOFT = "#7d8590"

_MOST_POINTS = 150_000
_MOST_FACES = 150_000
_SHARP = np.radians(25.0)  # faces that meet at more than this make an edge worth a line
_EDGE_PIECE = 1.5e-3  # m: edges are hidden or shown in pieces of this length
_LIFT = 30e-6  # m off the surface where sight lines start; clouds lie that close to it


def view_axes(azimuth_deg: float, elevation_deg: float) -> Array:
    """Rows (3, 3): right, up and towards the viewer, who stands at `azimuth_deg` from x and `elevation_deg` up."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


class SurfaceView:
    """Draws points (n, 3) with a value each and the mesh face (n,) they lie on, from any side."""

    def __init__(self, mesh: Mesh, points: Array, values: Array, face: Index) -> None:
        self._mesh = mesh
        self._points, self._values, self._face = points, values, face
        self._tracer = Tracer([mesh])
        self._far = 2.0 * float(np.linalg.norm(np.ptp(mesh.bounds, axis=0)))
        self._edges, self._edge_normals = _sharp_edges(mesh)

    def draw(self, axes: Axes, axes_in_part: Array, colours: Normalize) -> None:
        """Orthographic view in millimetres along the rows of `axes_in_part`, with a scale bar."""
        corners = 1e3 * self._mesh.vertices @ axes_in_part.T
        low, high = corners[:, :2].min(0), corners[:, :2].max(0)
        self._draw_faces(axes, corners, axes_in_part)
        self._draw_points(axes, axes_in_part, colours, float(np.prod(high - low)))
        self._draw_edges(axes, axes_in_part)
        margin = 0.04 * float((high - low).max())
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - 2.5 * margin, high[1] + margin))
        axes.set_aspect("equal")
        axes.axis("off")
        _draw_scale_bar(axes, float(low[0]), float(low[1]) - 1.5 * margin, float(high[0] - low[0]) / 4)

    def _draw_faces(self, axes: Axes, corners: Array, axes_in_part: Array) -> None:
        light = self._mesh.normals @ axes_in_part[2]
        facing = np.flatnonzero(light > 0)
        if len(facing) > _MOST_FACES:  # beyond this the points alone show the shape
            return
        triangles = corners[self._mesh.faces[facing]]
        order = np.argsort(triangles[:, :, 2].mean(1))
        grey = np.repeat((0.5 + 0.3 * light[facing][order])[:, None], 3, axis=1)
        outlines = list(triangles[order][:, :, :2])
        axes.add_collection(PolyCollection(outlines, facecolors=grey, edgecolors=grey, linewidths=0.3, zorder=1))

    def _draw_points(self, axes: Axes, axes_in_part: Array, colours: Normalize, area_mm2: float) -> None:
        light = self._mesh.normals[self._face] @ axes_in_part[2]
        facing = np.flatnonzero(light > 0.05)
        facing = _thinned(facing, 4 * _MOST_POINTS)  # most are hidden at worst; casting rays for all takes seconds
        in_view = self._in_view(self._points[facing], self._mesh.normals[self._face[facing]], axes_in_part)
        chosen = _thinned(facing[in_view], _MOST_POINTS)
        if not len(chosen):
            return
        seen = 1e3 * self._points[chosen] @ axes_in_part.T
        paint = matplotlib.colormaps[COLOURS](colours(self._values[chosen]))
        paint[:, :3] *= (0.8 + 0.2 * light[chosen])[:, None]  # enough to show the shape, too little to shift a reading
        order = np.argsort(seen[:, 2])
        size = _mark_size(axes, seen, area_mm2)
        axes.scatter(seen[order, 0], seen[order, 1], c=paint[order], s=size, linewidths=0, rasterized=True, zorder=2)

    def _draw_edges(self, axes: Axes, axes_in_part: Array) -> None:
        if not len(self._edges):
            return
        shown = self._in_view(self._edges.mean(1), self._edge_normals, axes_in_part)
        lines = 1e3 * self._edges[shown] @ axes_in_part[:2].T
        axes.add_collection(LineCollection(list(lines), colors=INK, linewidths=0.7, alpha=0.75, zorder=3))

    def _in_view(self, points: Array, normals: Array, axes_in_part: Array) -> NDArray[np.bool_]:
        if not len(points):
            return np.zeros(0, bool)
        start = points + _LIFT * normals
        return ~self._tracer.blocked(start, start + self._far * axes_in_part[2])


def _thinned(rows: Index, most: int) -> Index:
    """Every so many-th row, so that at most `most` are left."""
    return rows[:: max(1, -(-len(rows) // most))]


def _sharp_edges(mesh: Mesh) -> tuple[Array, Array]:
    """Pieces (k, 2, 3) of the edges where faces meet sharply, and the mean normal (k, 3) there."""
    solid = trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=True)  # mm: its tolerances are absolute
    sharp = np.flatnonzero(solid.face_adjacency_angles > _SHARP)
    ends = solid.vertices[solid.face_adjacency_edges[sharp]] * 1e-3
    normals = solid.face_normals[solid.face_adjacency[sharp]].sum(1)
    if not len(sharp) or len(sharp) > _MOST_FACES // 3:  # a scanned or noisy mesh has no edges to speak of
        return np.zeros((0, 2, 3)), np.zeros((0, 3))
    count = np.maximum(1, np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / _EDGE_PIECE)).astype(int)
    number = np.concatenate([np.arange(n) for n in count]) / np.repeat(count, count)
    start, way = np.repeat(ends[:, 0], count, axis=0), np.repeat(ends[:, 1] - ends[:, 0], count, axis=0)
    step = way / np.repeat(count, count)[:, None]
    begin = start + number[:, None] * way
    return np.stack([begin, begin + step], 1), np.repeat(normals, count, axis=0)


def _mark_size(axes: Axes, seen: Array, area_mm2: float) -> float:
    """Area of a mark in points², so that neighbouring marks touch."""
    width, height = axes.get_window_extent().width, axes.get_window_extent().height
    extent = np.maximum(np.ptp(seen[:, :2], axis=0), 1e-3)
    points_per_mm = 72.0 / axes.figure.dpi * min(width / extent[0], height / extent[1])
    return float(np.clip(3.5 * area_mm2 / len(seen) * points_per_mm**2, 0.35, 9.0))


def _draw_scale_bar(axes: Axes, left: float, height: float, wanted: float) -> Any:
    decade = 10.0 ** np.floor(np.log10(wanted))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= wanted)
    axes.plot([left, left + length], [height, height], color=INK, linewidth=2, solid_capstyle="butt")
    axes.annotate(f"{length:g} mm", (left + length, height), (5, 0), textcoords="offset points", va="center", color=INK)
