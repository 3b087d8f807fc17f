"""Plots of a study as SVG text."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

Array = NDArray[np.float64]

INK, GREY, BLUE, ORANGE = "#222222", "#9aa3ad", "#2f6db5", "#d9822b"
_STYLE = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "text.color": INK,
    "svg.fonttype": "none",  # text stays text: smaller, and searchable
    "svg.hashsalt": "scancell",  # the same study gives the same bytes
    "font.family": "sans-serif",
}
_MAX_POINTS = 1500


def svg(width: float, height: float, columns: int, draw: Any) -> str:
    """SVG text of a row of axes, of a size in inches, on which `draw` draws."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        draw(*np.atleast_1d(figure.subplots(1, columns)))
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None}, transparent=True)
    text = stream.getvalue()
    return text[text.index("<svg") :]


def distribution(sample: Array, said: dict[str, Any], label: str) -> str:
    """Histogram of a figure with its mean and both coverage intervals."""

    def draw(axes: Axes) -> None:
        axes.hist(sample, bins="auto" if len(sample) > 30 else 10, color=BLUE, alpha=0.75)
        axes.axvline(said["mean"], color=INK, linewidth=1.5, label="mean")
        for name, colour, style in (("symmetric", ORANGE, "-"), ("shortest", INK, ":")):
            ends = said[f"interval_{name}"]
            for k, end in enumerate(ends or ()):
                axes.axvline(end, color=colour, linestyle=style, label=f"{name} interval" if k == 0 else None)
        axes.set(xlabel=label, ylabel="trials")
        axes.legend(frameon=False, fontsize=8)

    return svg(5.2, 2.8, 1, draw)


def convergence(rows: Sequence[dict[str, float]], label: str) -> str:
    """Mean with twice its standard error, and standard deviation, against the number of trials."""

    def draw(axes: Axes) -> None:
        count = np.array([row["trials"] for row in rows])
        mean, error, std = (
            np.array([row[k] for row in rows]) for k in ("mean", "standard_error", "standard_deviation")
        )
        axes.fill_between(count, mean - 2 * error, mean + 2 * error, color=BLUE, alpha=0.25, linewidth=0)
        axes.plot(count, mean, color=BLUE, label="mean ± 2 standard errors")
        axes.plot(count, std, color=ORANGE, label="standard deviation")
        axes.set(xscale="log", xlabel="trials", ylabel=label)
        axes.set_xticks(np.unique(count[[0, len(count) // 2, -1]]))  # a range below a decade has no automatic ticks
        axes.set_xticks([], minor=True)
        axes.xaxis.set_major_formatter("{x:.0f}")
        axes.legend(frameon=False, fontsize=8)

    return svg(5.2, 2.8, 1, draw)


def bars(names: Sequence[str], series: Mapping[str, tuple[Array, Array | None]], label: str) -> str:
    """Horizontal bars per factor; each series has values (n,) and, where known, interval ends (n, 2)."""

    def draw(axes: Axes) -> None:
        place, height = np.arange(len(names)), 0.8 / len(series)
        for k, (title, (values, ends)) in enumerate(series.items()):
            spread = None if ends is None else np.clip(np.stack([values - ends[:, 0], ends[:, 1] - values]), 0, None)
            shift = (k - (len(series) - 1) / 2) * height
            axes.barh(
                place + shift,
                values,
                height * 0.9,
                xerr=spread,
                label=title,
                color=(BLUE, ORANGE)[k % 2],
                error_kw={"ecolor": INK, "elinewidth": 1, "capsize": 2},
            )
        axes.set(yticks=place, yticklabels=list(names), xlabel=label)
        axes.invert_yaxis()
        axes.axvline(0, color=GREY, linewidth=0.8)
        if len(series) > 1:
            axes.legend(frameon=False, fontsize=8)

    return svg(6.4, 0.9 + 0.32 * len(names) * max(1, len(series) * 0.7), 1, draw)


def effects(rows: Sequence[dict[str, Any]], label: str) -> str:
    """Morris plot: spread of the elementary effects against their mean magnitude."""

    def draw(axes: Axes) -> None:
        size = [row["mean_magnitude"] for row in rows]
        spread = [row["spread"] for row in rows]
        axes.scatter(size, spread, color=BLUE)
        for row in rows:
            axes.annotate(
                row["factor"],
                (row["mean_magnitude"], row["spread"]),
                fontsize=8,
                xytext=(4, 4),
                textcoords="offset points",
            )
        axes.set(xlabel=f"mean magnitude of the effect on {label}", ylabel="spread of the effect")
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)

    return svg(6.4, 3.4, 1, draw)


def scatters(names: Sequence[str], values: Sequence[Sequence[Any]], outputs: Array, label: str) -> str:
    """A figure against each of up to four factors."""

    def draw(*all_axes: Axes) -> None:
        step = max(1, len(outputs) // _MAX_POINTS)
        for k, (axes, name, column) in enumerate(zip(all_axes, names, values, strict=True)):
            axes.scatter(
                list(column)[::step],
                outputs[::step],
                s=16 if len(outputs) < 200 else 6,
                color=BLUE,
                alpha=0.6,
                linewidth=0,
            )
            axes.set_xlabel(name, fontsize=8)
            axes.tick_params(labelsize=8)
            if any(isinstance(value, str) for value in column):
                axes.tick_params(axis="x", rotation=30)
            if k == 0:
                axes.set_ylabel(label)

    return svg(2.4 * len(names) + 0.6, 2.5, len(names), draw)
