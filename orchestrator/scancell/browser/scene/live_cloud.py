"""The cloud of a scan while it grows, coloured by one of its values."""

from __future__ import annotations

from threading import RLock
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.scene import CellScene
from scancell.live.scan import LiveChunk
from scancell.output.deviation_picture import colour_limit_um
from scancell.views.coloured_cloud import colour_scale

LiveColour = Literal["deviation", "intensity", "quality", "camera"]
LIVE_COLOURS: tuple[LiveColour, ...] = get_args(LiveColour)

Colours = NDArray[np.uint8]

_CAMERAS = np.array([(220, 120, 40), (40, 120, 210), (60, 160, 80), (160, 70, 170)], np.uint8)
_SIZE = 1.2  # of a point, in mean distances between points


class LiveCloud:
    """Adds chunks of a scan to a scene, where each is sent once; another colour sends them again.

    The limits of the colours are those of the first chunk. Any thread may call.
    """

    def __init__(self, scene: CellScene) -> None:
        self._scene, self._lock = scene, RLock()
        self._chunks: list[LiveChunk] = []
        self._colour: LiveColour = "deviation"
        self._limits: dict[LiveColour, tuple[float, float]] = {}
        self._size = 1e-3

    @property
    def colour(self) -> LiveColour:
        """What the colours show."""
        return self._colour

    @property
    def count(self) -> int:
        """Number of points."""
        return sum(len(chunk.time) for chunk in self._chunks)

    def clear(self) -> None:
        """Remove what is shown."""
        with self._lock:
            self._scene.clear_points()
            self._chunks, self._limits = [], {}

    def add(self, chunk: LiveChunk, spacing: float) -> None:
        """Show more points; `spacing` is the mean distance between neighbours in the complete cloud, m."""
        with self._lock:
            if not self._chunks:
                self._limits, self._size = _limits(chunk), _SIZE * spacing
            self._chunks.append(chunk)
            self._show(chunk)

    def colour_by(self, colour: LiveColour) -> None:
        """Show other colours."""
        with self._lock:
            self._colour = colour
            self._scene.clear_points()
            for chunk in self._chunks:
                self._show(chunk)

    @property
    def legend(self) -> str:
        """What the colours mean."""
        if self._colour == "camera" or self._colour not in self._limits:
            return self._colour
        low, high = self._limits[self._colour]
        unit = {"deviation": " µm", "intensity": " DN"}.get(self._colour, "")
        return f"{self._colour}, {low:.3g} to {high:.3g}{unit}"

    def _show(self, chunk: LiveChunk) -> None:
        self._scene.add_points(chunk.points_in_part, self._colours(chunk), self._size)

    def _colours(self, chunk: LiveChunk) -> Colours:
        if self._colour == "camera":
            return _CAMERAS[np.asarray(chunk.camera) % len(_CAMERAS)]
        scale = colour_scale("deviation" if self._colour == "deviation" else "intensity")
        low, high = self._limits[self._colour]
        share = np.clip((_values(chunk, self._colour) - low) / (high - low), 0.0, 1.0)
        place = np.nan_to_num(share * (len(scale) - 1)).astype(np.int64)
        return np.asarray(scale[place], np.uint8)


def _values(chunk: LiveChunk, colour: LiveColour) -> NDArray[np.float64]:
    values = {"deviation": 1e6 * chunk.deviation, "intensity": chunk.intensity, "quality": chunk.quality}
    return np.asarray(values[colour], float)


def _limits(chunk: LiveChunk) -> dict[LiveColour, tuple[float, float]]:
    deviation = colour_limit_um(float(np.quantile(np.abs(chunk.deviation), 0.95)))
    intensity = max(float(np.quantile(chunk.intensity, 0.99)), 1e-9)
    return {"deviation": (-deviation, deviation), "intensity": (0.0, intensity), "quality": (0.0, 1.0)}
