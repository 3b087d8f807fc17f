"""The cloud of a scan while it grows, coloured by one of its values."""

from __future__ import annotations

from dataclasses import dataclass
from threading import RLock
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.scene import CellScene
from scancell.errors import DescriptionError
from scancell.live.scan import LiveChunk
from scancell.output.deviation_picture import colour_limit_um
from scancell.views.coloured_cloud import colour_scale

LiveColour = Literal["deviation", "intensity", "quality", "camera"]
LIVE_COLOURS: tuple[LiveColour, ...] = get_args(LiveColour)

Colours = NDArray[np.uint8]

_CAMERAS = np.array([(220, 120, 40), (40, 120, 210), (60, 160, 80), (160, 70, 170)], np.uint8)
_INTERVALS = 48  # of the histogram
_SIZE = 1.2  # of a point, in mean distances between points
MOST_SHOWN = 500_000  # points


@dataclass(frozen=True, eq=False)
class ColourBar:
    """Meaning of the colours of a cloud.

    Attributes
    ----------
    title
        Value that the colours show, and its unit.
    limits
        Values of the first and the last colour.
    colours
        (n, 3) from the first to the last, 0 to 255.
    counts
        (intervals,) number of points in equal intervals between the limits; values beyond are in the outer ones.
    """

    title: str
    limits: tuple[float, float]
    colours: NDArray[np.float64]
    counts: NDArray[np.int64]


class LiveCloud:
    """Adds chunks of a scan to a scene, where each is sent once; other colours or limits send them again.

    The limits of the colours are those of the first chunk until `limit` changes them. Where there are too many points,
    every second one is shown, then every fourth, and so on. Any thread may call.

    Parameters
    ----------
    most
        Points that are kept and shown at most.

    Attributes
    ----------
    step
        Every how many points one is shown.
    """

    def __init__(self, scene: CellScene, most: int = MOST_SHOWN) -> None:
        self._scene, self._most, self._lock = scene, most, RLock()
        self._until, self.step = np.inf, 1
        self._chunks: list[LiveChunk] = []
        self._colour: LiveColour = "deviation"
        self._limits: dict[LiveColour, tuple[float, float]] = {}
        self._counts = np.zeros(_INTERVALS, np.int64)
        self._size = 1e-3

    @property
    def colour(self) -> LiveColour:
        """What the colours show."""
        return self._colour

    @property
    def count(self) -> int:
        """Number of points that are shown."""
        return sum(len(chunk.time) for chunk in self._chunks)

    def clear(self) -> None:
        """Remove what is shown."""
        with self._lock:
            self._scene.clear_points()
            self._chunks, self._limits, self.step = [], {}, 1
            self._counts[:] = 0

    def add(self, chunk: LiveChunk, spacing: float) -> None:
        """Show more points; `spacing` is the mean distance between neighbours in the complete cloud, m."""
        with self._lock:
            if not self._chunks:
                self._limits, self._size = _limits(chunk), _SIZE * spacing
            self._chunks.append(chunk[:: self.step])
            self._show(self._chunks[-1])
            while self.count > self._most:
                self.step *= 2
                self._chunks = [one[::2] for one in self._chunks]
                self._show_again()

    def show_until(self, time: float) -> None:
        """Show only chunks that were complete at a time of the scan, s."""
        with self._lock:
            self._until = time
            self._show_complete()

    def colour_by(self, colour: LiveColour) -> None:
        """Show other colours."""
        with self._lock:
            self._colour = colour
            self._show_again()

    def limit(self, low: float | None = None, high: float | None = None) -> None:
        """Change the limits of the present colours; None: those of the first chunk.

        Raises
        ------
        DescriptionError
            If `low` is not less than `high`.
        """
        with self._lock:
            if not self._chunks or self._colour == "camera":
                return
            first = _limits(self._chunks[0])[self._colour]
            limits = first if low is None or high is None else (low, high)
            if not limits[0] < limits[1]:
                raise DescriptionError(key="limits", value=f"{limits[0]:g} to {limits[1]:g}", expected="first < second")
            self._limits[self._colour] = limits
            self._show_again()

    @property
    def bar(self) -> ColourBar | None:
        """Meaning of the colours; None without points, and where colours distinguish cameras."""
        # Without the lock: another thread holds it while it sends all points again.
        colour, limits = self._colour, self._limits.get(self._colour)
        if limits is None:
            return None
        unit = {"deviation": ", µm", "intensity": ", DN"}.get(colour, "")
        return ColourBar(f"{colour}{unit}", limits, self._scale(), self._counts.copy())

    def _show_again(self) -> None:
        self._scene.clear_points()
        self._counts[:] = 0
        for chunk in self._chunks:
            self._show(chunk)
        self._show_complete()

    def _show_complete(self) -> None:
        self._scene.show_chunks(sum(bool(chunk.time[-1] <= self._until) for chunk in self._chunks))

    def _show(self, chunk: LiveChunk) -> None:
        self._scene.add_points(chunk.points_in_part, self._colours(chunk), self._size)

    def _scale(self) -> NDArray[np.float64]:
        return colour_scale("deviation" if self._colour == "deviation" else "intensity")

    def _colours(self, chunk: LiveChunk) -> Colours:
        """Colours (n, 3) of a chunk, whose values are counted."""
        if self._colour == "camera":
            return _CAMERAS[np.asarray(chunk.camera) % len(_CAMERAS)]
        scale = self._scale()
        low, high = self._limits[self._colour]
        share = np.nan_to_num(np.clip((_values(chunk, self._colour) - low) / (high - low), 0.0, 1.0))
        interval = np.minimum((share * _INTERVALS).astype(np.int64), _INTERVALS - 1)
        self._counts += np.bincount(interval, minlength=_INTERVALS)
        return np.asarray(scale[(share * (len(scale) - 1)).astype(np.int64)], np.uint8)


def _values(chunk: LiveChunk, colour: LiveColour) -> NDArray[np.float64]:
    values = {"deviation": 1e6 * chunk.deviation, "intensity": chunk.intensity, "quality": chunk.quality}
    return np.asarray(values[colour], float)


def _limits(chunk: LiveChunk) -> dict[LiveColour, tuple[float, float]]:
    deviation = colour_limit_um(float(np.quantile(np.abs(chunk.deviation), 0.95)))
    intensity = max(float(np.quantile(chunk.intensity, 0.99)), 1e-9)
    return {"deviation": (-deviation, deviation), "intensity": (0.0, intensity), "quality": (0.0, 1.0)}
