"""Plots of an acceptance test as SVG text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from scancell.studies.plots import BLUE, GREY, INK, ORANGE, svg

_COLOURS = (BLUE, ORANGE)
_SHIFT = 0.12  # between the marks of the two modes
_MOST_FACES = 6  # with a line of their own
_LABELS = {"um": "µm", "deg": "deg", "%": "%"}


def over_positions(rows: Sequence[dict[str, Any]], name: str) -> str:
    """Mean errors with their 95 % intervals, or twice their standard uncertainty, by position; a colour per mode."""
    positions = list(dict.fromkeys(row["position"] for row in rows))
    modes = list(dict.fromkeys(row["mode"] for row in rows))
    faces = list(dict.fromkeys(row["of"] for row in rows))

    def draw(axes: Axes) -> None:
        for m, mode in enumerate(modes):
            for f, face in enumerate(faces[:_MOST_FACES]):
                own = [row for row in rows if (row["mode"], row["of"]) == (mode, face)]
                x = np.array([positions.index(row["position"]) for row in own]) + (m - (len(modes) - 1) / 2) * _SHIFT
                x = x + 0.3 * _SHIFT * (f - (min(len(faces), _MOST_FACES) - 1) / 2)
                mean, ends = np.array([row["mean"] for row in own]), np.array([_ends(row) for row in own])
                spread = np.clip(np.stack([mean - ends[:, 0], ends[:, 1] - mean]), 0.0, None)
                label = mode if f == 0 else None
                axes.errorbar(x, mean, spread, fmt="o", ms=4, capsize=3, color=_COLOURS[m % 2], label=label)
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set(xticks=range(len(positions)), xticklabels=positions, ylabel=_LABELS[rows[0]["unit"]])
        axes.set_xlim(-0.5, len(positions) - 0.5)
        axes.set_title(name, fontsize=10, loc="left")
        axes.legend(frameon=False, fontsize=8)

    return svg(5.0, 2.8, 1, draw)


def _ends(row: dict[str, Any]) -> tuple[float, float]:
    if row["interval_symmetric"]:
        low, high = row["interval_symmetric"]
        return low, high
    half = 2.0 * (row["standard_uncertainty"] or 0.0)
    return row["mean"] - half, row["mean"] + half


def sweep(found: dict[str, Any]) -> str:
    """Bias with the standard deviation of points as a band, and shares of outliers and missing points."""
    value, bias, std, outliers, missing = (
        np.array([np.nan if row[key] is None else row[key] for row in found["rows"]], float)
        for key in ("value", "bias_um", "std_um", "outlier_rate", "missing_rate")
    )
    scale = "log" if found["name"] == "reflectance" else "linear"
    label = found["name"] if found["unit"] == "1" else f"{found['name']} ({found['unit']})"

    def draw(left: Axes, right: Axes) -> None:
        left.fill_between(value, bias - std, bias + std, color=BLUE, alpha=0.25, linewidth=0, label="± std of points")
        left.plot(value, bias, "o-", ms=3, color=BLUE, label="bias")
        left.axhline(0.0, color=GREY, linewidth=0.8)
        left.set(xlabel=label, ylabel="µm", xscale=scale)
        left.legend(frameon=False, fontsize=8)
        right.plot(value, 100 * missing, "o-", ms=3, color=ORANGE, label="missing points")
        right.plot(value, 100 * outliers, "s--", ms=3, color=INK, label="outliers")
        right.set(xlabel=label, ylabel="%", xscale=scale)
        right.set_ylim(bottom=0.0, top=max(1.0, 110 * float(np.nanmax(np.append(missing, outliers)))))
        right.legend(frameon=False, fontsize=8)

    return svg(8.4, 2.7, 2, draw)
