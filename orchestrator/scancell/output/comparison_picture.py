"""Picture of real against simulated measurements: quantiles, noise by angle, shape along the profile."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.output.surface_view import INK, SOFT, Sheet, ticks

_PANEL, _HEIGHT, _TOP, _BOTTOM, _LEFT = 470, 470, 70, 400, 76
_REAL, _SIMULATED = "#b5532a", "#2a6db5"

Series = tuple[Sequence[float], Sequence[tuple[float | None, float | None]]]


def comparison_picture(path: Path, quantiles: NDArray[np.float64], noise: Series, shape: Series) -> None:
    """Write a PNG of quantiles (k, 2), and of values at angles (deg) and at positions along the profile (mm), µm.

    Each value is that of the real and that of the simulated measurements, None where there is none.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    sheet = Sheet(3 * _PANEL, _HEIGHT)
    limits = _padded([*quantiles.ravel().tolist()])
    to_pixel = _panel(sheet, 0, "Quantiles of the distances", "real (um)", "simulated (um)", limits, limits)
    sheet.line([to_pixel(limits[0], limits[0]), to_pixel(limits[1], limits[1])], SOFT)
    for real, simulated in quantiles.tolist():
        sheet.dot(*to_pixel(real, simulated), 4, _SIMULATED)
    for number, (title, label, (places, values), zero) in enumerate(
        [
            ("Noise from point to point", "angle of incidence (deg)", noise, True),
            ("Mean distance along the profile", "y (mm)", shape, False),
        ],
        1,
    ):
        known = [value for pair in values for value in pair if value is not None]
        low, high = _padded([*known, *([0.0] if zero or not known else [])])
        to_pixel = _panel(sheet, number, title, label, "um", _padded(list(places)), (low, high))
        for kind, colour in ((0, _REAL), (1, _SIMULATED)):
            shown = [(x, pair[kind]) for x, pair in zip(places, values, strict=True)]
            line = [to_pixel(x, y) for x, y in shown if y is not None]
            if len(line) > 1:
                sheet.line(line, colour, 2)
            for point in line:
                sheet.dot(*point, 3, colour)
        sheet.text(_PANEL * (number + 1) - 150, 56, "real", 13, _REAL)
        sheet.text(_PANEL * (number + 1) - 100, 56, "simulated", 13, _SIMULATED)
    sheet.write(path)


def _padded(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    room = 0.06 * (high - low) + 1e-6
    return low - room, high + room


class _ToPixel:
    """From values of a panel to pixels of the sheet."""

    def __init__(self, left: float, right: float, x: tuple[float, float], y: tuple[float, float]) -> None:
        self._left, self._right, self._x, self._y = left, right, x, y

    def __call__(self, x: float, y: float) -> tuple[float, float]:
        along = (x - self._x[0]) / (self._x[1] - self._x[0])
        up = (y - self._y[0]) / (self._y[1] - self._y[0])
        return self._left + along * (self._right - self._left), _BOTTOM - up * (_BOTTOM - _TOP)


def _panel(
    sheet: Sheet, number: int, title: str, below: str, beside: str, x: tuple[float, float], y: tuple[float, float]
) -> _ToPixel:
    left, right = number * _PANEL + _LEFT, (number + 1) * _PANEL - 20
    to_pixel = _ToPixel(left, right, x, y)
    sheet.text(left, 34, title, 16, bold=True)
    sheet.rectangle(left, _TOP, right, _BOTTOM, outline=SOFT)
    for value, label in ticks(*x, 5):
        at = to_pixel(value, y[0])[0]
        sheet.line([(at, _BOTTOM), (at, _BOTTOM + 5)], INK)
        sheet.text(at, _BOTTOM + 20, label, 12, anchor="ms")
    for value, label in ticks(*y, 5):
        at = to_pixel(x[0], value)[1]
        sheet.line([(left - 5, at), (left, at)], INK)
        sheet.text(left - 8, at + 4, label, 12, anchor="rs")
    sheet.text((left + right) / 2, _BOTTOM + 44, below, 13, anchor="ms")
    sheet.text_upwards(left - 58, (_TOP + _BOTTOM) / 2, beside, 13)
    return to_pixel
