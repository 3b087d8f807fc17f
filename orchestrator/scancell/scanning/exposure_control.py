"""Choice of the exposure times of successive profiles: always the same, or from the images before."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription
from scancell.config.units import si_value

Array = NDArray[np.float64]

_LARGEST_STEP = 4.0  # of the exposure time, from one image to the profile that it sets
_IN_THE_DARK = 2.0  # factor without any light of the stripe
_NEAR_ENOUGH = 0.05  # relative change that is not worth it


class ExposureControl(Protocol):
    """Exposure times of the profiles of one recording, in their order.

    `next` chooses them for at most `most` profiles: their windows (n, k, 2), n from 1 to `most`, see
    `Recording.truth_for_rows`, or None for all of them as recorded. Then `learn` is called with the brightest digital
    number (m,) of every column of each of these profiles, if the control `looks` at images. `first` is the exposure
    time of the next profile, s; None for one that never changes.
    """

    @property
    def looks(self) -> bool: ...
    @property
    def first(self) -> float | None: ...
    def next(self, most: int) -> Array | None: ...
    def learn(self, signals: Sequence[Array]) -> None: ...


class SameExposures:
    """The same windows (k, 2) for every profile; None: as recorded."""

    looks = False
    first = None

    def __init__(self, windows: Array | None) -> None:
        self._windows = windows

    def next(self, most: int) -> Array | None:
        """Of all of them, see `ExposureControl`."""
        return None if self._windows is None else np.broadcast_to(self._windows, (most, *self._windows.shape))

    def learn(self, signals: Sequence[Array]) -> None:
        """Nothing: there is no choice."""


class AutomaticExposure:
    """Scales the exposure time of a profile by the light in the image `delay` profiles before.

    The new time is the old one times the wanted signal over the measured one: a percentile, over the columns with
    light, of the brightest pixel of each. As a saturated image does not tell by how much, several profiles may pass
    until none is. Times change by at least 5 % and at most a factor of 4. The exposures of `delay` profiles do not
    depend on each other's images, so that they are computed at the same time.
    """

    looks = True

    def __init__(self, description: SensorDescription) -> None:
        detector, options = description.detector, description.exposure
        if options.shortest_ms is None or options.longest_ms is None:
            raise ValueError("the description has no automatic exposure")
        self._black = detector.black_level_dn
        highest = min(2.0**detector.bit_depth - 1, self._black + detector.full_well_e * detector.gain_dn_per_e)
        self._range = highest - self._black
        self._least = description.extraction.min_amplitude_dn
        self._target, self._percentile = options.target, options.percentile
        self._limits = si_value(options, "shortest_ms"), si_value(options, "longest_ms")
        self._next = deque([si_value(detector, "exposure_ms")] * options.delay)
        self._taken: deque[float] = deque()

    @property
    def first(self) -> float:
        """Exposure time of the next profile, s."""
        return self._next[0]

    def next(self, most: int) -> Array:
        """Windows of as many profiles as are known, see `ExposureControl`."""
        durations = [self._next.popleft() for _ in range(min(most, len(self._next)))]
        self._taken.extend(durations)
        return np.array([[[0.0, duration]] for duration in durations])

    def learn(self, signals: Sequence[Array]) -> None:
        """Choose the times of as many later profiles, see `ExposureControl`."""
        for signal in signals:
            duration = self._taken.popleft() * self._factor(signal - self._black)
            self._next.append(float(np.clip(duration, *self._limits)))

    def _factor(self, light: Array) -> float:
        lit = light[light >= self._least]
        if not len(lit):
            return _IN_THE_DARK
        wanted = float(self._target * self._range / np.percentile(lit, self._percentile))
        return 1.0 if abs(wanted - 1) < _NEAR_ENOUGH else float(np.clip(wanted, 1 / _LARGEST_STEP, _LARGEST_STEP))
