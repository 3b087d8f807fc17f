"""Picture of residuals by exposure: median, and the ranges of the central 50 % and 95 %."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.output.surface_view import INK, SOFT, Sheet, ticks

_WIDTH, _HEIGHT = 1120, 460
_LEFT, _TOP, _RIGHT, _BOTTOM = 84, 64, 1090, 390
_WIDE, _NARROW = "#c9d8ea", "#6f94bd"


def residual_picture(path: Path, residuals: NDArray[np.float64], frame: NDArray[np.integer]) -> None:
    """Write a PNG of residuals (k,), m, of exposures (k,).

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    numbers = np.unique(frame)
    order = np.argsort(frame, kind="stable")
    parts = np.split(1e6 * residuals[order], np.searchsorted(frame[order], numbers[1:]))
    quantiles = np.array([np.quantile(part, (0.025, 0.25, 0.5, 0.75, 0.975)) for part in parts])
    low, high = min(float(quantiles.min()), 0.0), max(float(quantiles.max()), 0.0)
    margin = 0.08 * (high - low) + 1e-3
    low, high = low - margin, high + margin
    step = (_RIGHT - _LEFT) / len(numbers)

    def y(value: float) -> float:
        return _BOTTOM - (value - low) / (high - low) * (_BOTTOM - _TOP)

    sheet = Sheet(_WIDTH, _HEIGHT)
    sheet.text(_LEFT, 28, "Distance of the points from the measured surface after calibration", 18, bold=True)
    sheet.text(_LEFT, 50, "by exposure: central 95 %, central 50 %, median", 14, SOFT)
    for k, (lowest, lower, median, upper, highest) in enumerate(quantiles.tolist()):
        left, right = _LEFT + (k + 0.15) * step, _LEFT + (k + 0.85) * step
        sheet.rectangle(left, y(highest), right, y(lowest), _WIDE)
        sheet.rectangle(left, y(upper), right, y(lower), _NARROW)
        sheet.line([(left, y(median)), (right, y(median))], INK, 2)
    for value, label in ticks(low, high, 6):
        sheet.line([(_LEFT - 6, y(value)), (_LEFT, y(value))], INK)
        sheet.text(_LEFT - 10, y(value) + 5, label, 13, anchor="rs")
    sheet.line([(_LEFT, y(0.0)), (_RIGHT, y(0.0))], SOFT)
    sheet.rectangle(_LEFT, _TOP, _RIGHT, _BOTTOM, outline=SOFT)
    for value, label in ticks(1, len(numbers), 10):
        if value == round(value) and value >= 1:
            sheet.text(_LEFT + (value - 0.5) * step, _BOTTOM + 20, label.split(".")[0], 13, anchor="ms")
    sheet.text((_LEFT + _RIGHT) / 2, _BOTTOM + 46, "exposure", 14, anchor="ms")
    sheet.text_upwards(24, (_TOP + _BOTTOM) / 2, "distance (um)", 14)
    sheet.write(path)
