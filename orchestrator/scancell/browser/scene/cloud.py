"""A cloud that grows in a scene, in chunks that are sent once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MOST_POINTS = 5_000_000


class GrowingCloud:
    """Points in the part frame.

    Parameters
    ----------
    scene
        Of viser.
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
