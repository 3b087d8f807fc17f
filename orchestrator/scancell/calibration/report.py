"""Common parts of the reports of all calibrations: files, the picture, and the comparison with truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.loading import Setup
from scancell.output.run_folder import RunFolder, SavedResult, manifest, write_json
from scancell.output.sheet import INK, SOFT, Axes, Sheet, ticks

_SHARES = (0.025, 0.25, 0.5, 0.75, 0.975)
_WIDE, _NARROW = "#c9d8ea", "#6f94bd"


class SavedCalibration(SavedResult):
    """A calibration from a setup; `inputs` and `run` are the files and settings for the manifest."""

    setup: Setup
    inputs: Sequence[Path]
    run: Mapping[str, Any]
    _picture_name = "residuals.png"

    @property
    def _distances(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Distances (n,) of the points from the measured surface, m, and the exposure of each."""
        raise NotImplementedError

    def picture(self) -> bytes:
        """Distances of the points from the measured surface by exposure, as PNG."""
        return residual_picture(*self._distances).png()

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        write_json(folder.path("calibration.json"), self.figures)
        residual_picture(*self._distances).write(folder.path(self._picture_name))
        entries = {**self.run, "command_line": command_line}
        write_json(folder.path("manifest.json"), manifest(self.setup, self.inputs, entries))


def residual_picture(residuals: NDArray[np.float64], frame: NDArray[np.integer]) -> Sheet:
    """Picture of residuals (k,), m, by exposure (k,): median, and the ranges of the central 50 % and 95 %."""
    numbers = np.unique(frame)
    order = np.argsort(frame, kind="stable")
    parts = np.split(1e6 * residuals[order], np.searchsorted(frame[order], numbers[1:]))
    quantiles = np.array([np.quantile(part, _SHARES) for part in parts])
    low, high = min(float(quantiles.min()), 0.0), max(float(quantiles.max()), 0.0)
    margin = 0.08 * (high - low) + 1e-3
    sheet, limits = Sheet(1120, 460), (0.5, len(numbers) + 0.5)
    axes = Axes(
        sheet, (84, 84, 1090, 390), limits, (low - margin, high + margin), ("exposure", "distance (um)"),
        "Distance of the points from the measured surface after calibration",
        [("central 95 %", _WIDE), ("central 50 %", _NARROW), ("median", INK)],
        [(value, f"{value:.0f}") for value, _ in ticks(1, len(numbers), 10) if value == round(value)],
    )  # fmt: skip
    for number, (lowest, lower, median, upper, highest) in enumerate(quantiles.tolist(), 1):
        axes.bar(number - 0.35, number + 0.35, lowest, highest, _WIDE)
        axes.bar(number - 0.35, number + 0.35, lower, upper, _NARROW)
        axes.line([(number - 0.35, median), (number + 0.35, median)], INK)
    axes.line([(limits[0], 0.0), (limits[1], 0.0)], SOFT, 1)
    return sheet


def comparison_text(true: float | None, value: float, half_width: float) -> str:
    """Columns of a true value and the error of an estimate, and whether its interval misses it; empty if unknown."""
    if true is None:
        return ""
    inside = "" if abs(value - true) <= half_width else "  outside"
    return f" {true:10.5f} {value - true:10.5f}{inside}"
