"""A cloud and the trace of the sensor, which grow in a scene in pieces that are sent once."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array, Image

if TYPE_CHECKING:
    import viser


MOST_POINTS = 5_000_000

_COLOUR = (20, 150, 90)
_STEP = 3e-3  # m between points of the line
_JUMP = 0.1  # m between two updates, above which the line is broken
_PIECE, _PIECES = 50, 40  # points of a piece, which alone is sent again while it grows, and number of pieces


class GrowingCloud:
    """Points in the part frame.

    Parameters
    ----------
    scene
        Scene of viser.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._chunks: list[Any] = []
        self.count = 0  # of points

    def add(self, points_in_part: Array, colours: Image, size: float) -> int:
        """Add a chunk of points (n, 3), m, of colours (n, 3) and a size, m, and return the number that fitted."""
        kept = min(len(points_in_part), MOST_POINTS - self.count)
        if kept == 0:
            return 0
        self._chunks.append(
            self._scene.add_point_cloud(
                f"/frames/part/cloud/{len(self._chunks)}",
                np.asarray(points_in_part[:kept], np.float32),
                np.asarray(colours[:kept], np.uint8),
                point_size=size,
                point_shape="circle",
                point_shading="flat",
                precision="float32",
            )
        )
        self.count += kept
        return kept

    def show(self, chunks: int) -> None:
        """Show the first chunks."""
        for number, chunk in enumerate(self._chunks):
            chunk.visible = number < chunks

    def clear(self) -> None:
        """Remove all points."""
        for chunk in self._chunks:
            chunk.remove()
        self._chunks, self.count = [], 0


class Trace:
    """Pieces of a line; the oldest piece is removed when there are too many.

    Parameters
    ----------
    scene
        Scene of viser.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene, self._begun, self._visible = scene, 0, True
        self._pieces: deque[Any] = deque()
        self._points: list[Array] = []  # of the piece that grows

    @property
    def segments(self) -> Array:
        """Ends of all segments (n, 2, 3) that are shown, world, m."""
        return np.concatenate([np.zeros((0, 2, 3)), *(piece.points for piece in self._pieces)])

    def add(self, point: ArrayLike) -> None:
        """Append a point (3,), world, m."""
        point = np.array(point, float)
        step = np.linalg.norm(point - self._points[-1]) if self._points else 0.0
        if self._points and step < _STEP:
            return
        if step > _JUMP:
            self._points = []
        self._points.append(point)
        if len(self._points) == 1:
            return
        segments = np.stack([self._points[:-1], self._points[1:]], 1)
        if len(self._points) == 2:
            self._begin(segments)
        else:
            self._pieces[-1].points = segments
        if len(self._points) > _PIECE:
            self._points = [point]

    def show(self, shown: bool) -> None:
        """Show or hide the line; points are appended in both cases."""
        self._visible = shown
        for piece in self._pieces:
            piece.visible = shown

    def clear(self) -> None:
        """Remove all points."""
        while self._pieces:
            self._pieces.popleft().remove()
        self._points = []

    def _begin(self, segments: Array) -> None:
        self._begun += 1
        name = f"/trace/{self._begun}"
        self._pieces.append(
            self._scene.add_line_segments(
                name, segments, _COLOUR, thickness=2.0, thickness_units="screen", visible=self._visible
            )
        )
        if len(self._pieces) > _PIECES:
            self._pieces.popleft().remove()
