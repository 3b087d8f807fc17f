"""The picture of a deviation: the coloured cloud from two sides, and the histogram with its figures."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from orchestrator.evaluation.deviation import Deviation, DeviationFigures
from orchestrator.evaluation.surface_view import COLOURS, INK, SOFT, SurfaceView, view_axes
from orchestrator.files import atomic_write
from orchestrator.geometry.mesh import Mesh
from orchestrator.reconstruction.cloud import Cloud

Array = NDArray[np.float64]

_VIEWS = ((-55.0, 35.0), (125.0, 35.0))  # azimuth, elevation in degrees
_BINS = 161


def deviation_picture(
    path: str | Path,
    cloud: Cloud,
    deviation: Deviation,
    mesh: Mesh,
    *,
    name: str,
    coverage_fraction: float | None = None,
) -> None:
    """Draw the deviation of `cloud` from `mesh` (both in the part frame) and write it as PNG.

    Each view draws at most 150 000 points, evenly chosen; the histogram and the figures hold all of them.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    figure = Figure(figsize=(13.0, 9.8), dpi=120, facecolor="white")
    grid = figure.add_gridspec(2, 3, width_ratios=(1, 1, 0.035), height_ratios=(1.6, 1), wspace=0.03, hspace=0.1)
    grid.update(left=0.06, right=0.925, top=0.885, bottom=0.07)
    limit = colour_limit_um(deviation.signed)
    colours = Normalize(-limit, limit)
    view = SurfaceView(mesh, cloud.points_in_part, 1e6 * deviation.signed, deviation.face)
    for column, (azimuth, elevation) in enumerate(_VIEWS):
        axes = figure.add_subplot(grid[0, column])
        view.draw(axes, view_axes(azimuth, elevation), colours)
        caption = f"from azimuth {azimuth:.0f}°, elevation {elevation:.0f}°"
        axes.set_title(caption, fontsize=9, color=SOFT)
    bar = figure.colorbar(ScalarMappable(colours, COLOURS), cax=figure.add_subplot(grid[0, 2]), extend="both")
    bar.set_label("deviation, µm   (+ outside the material)", color=INK)
    _draw_histogram(figure.add_subplot(grid[1, :2]), deviation, limit)
    _write_title(figure, name, deviation.figures, coverage_fraction)
    with atomic_write(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def colour_limit_um(signed: Array) -> float:
    """Half width of the colour scale: the 95 % quantile of the magnitude, rounded up to a round number.

    A few wild points thus do not bleach the rest; they show in the scale's end colours.
    """
    typical = float(np.quantile(np.abs(signed), 0.95)) * 1e6 if len(signed) else 1.0
    typical = max(typical, 1e-3)
    decade = 10.0 ** np.floor(np.log10(typical))
    return float(next(step * decade for step in (1, 1.5, 2, 3, 5, 7, 10) if typical <= step * decade * (1 + 1e-9)))


def _draw_histogram(axes: Axes, deviation: Deviation, limit: float) -> None:
    signed_um, width = 1e6 * deviation.signed, 2.0 * limit
    counts, edges = np.histogram(np.clip(signed_um, -width, width), bins=_BINS, range=(-width, width))
    share = 100.0 * counts / max(len(signed_um), 1)
    centres = (edges[:-1] + edges[1:]) / 2
    paint = matplotlib.colormaps[COLOURS](Normalize(-limit, limit, clip=True)(centres))
    axes.bar(centres, share, width=edges[1] - edges[0], color=paint, edgecolor="none")
    axes.stairs(share, edges, color=INK, linewidth=0.7)
    if deviation.figures.count:
        _draw_lines(axes, deviation.figures, width)
        axes.legend(loc="upper left", frameon=False, fontsize=10)
    beyond = int(np.sum(np.abs(signed_um) > width))
    note = f"   ({beyond:,} points beyond ±{width:g} µm count in the end bars)" if beyond else ""
    axes.set(xlim=(-width, width), ylabel="share of points, %", xlabel=f"deviation, µm{note}")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#e4e6ea", linewidth=0.8)
    axes.set_axisbelow(True)
    _write_table(axes, deviation.figures)


def _draw_lines(axes: Axes, figures: DeviationFigures, width: float) -> None:
    mean, rms, d95 = (1e6 * value for value in (figures.mean, figures.rms, figures.d95))
    for places, label, colour, style in (
        ((mean,), f"mean {_um(figures.mean)}", "#111111", "-"),
        ((-rms, rms), f"± RMS {_um(figures.rms)}", "#1f5fa8", "--"),
        ((-d95, d95), f"± D95 % {_um(figures.d95)}", "#b3261e", ":"),
    ):
        for i, place in enumerate(places):
            if abs(place) <= width:
                axes.axvline(place, color=colour, linestyle=style, linewidth=1.6, label=None if i else label)


def _write_table(axes: Axes, figures: DeviationFigures) -> None:
    named = {
        "mean": figures.mean,
        "standard deviation": figures.standard_deviation,
        "RMS": figures.rms,
        "D95 %": figures.d95,
        "D99.9 %": figures.d99_9,
        "maximum": figures.maximum,
        "minimum": figures.minimum,
    }
    rows = [("points", f"{figures.count:,}"), *((label, _um(value)) for label, value in named.items())]
    background = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
    for i, (label, value) in enumerate(rows):
        for place, text, colour in ((0.885, label, SOFT), (0.998, value, INK)):
            axes.text(
                place, 0.985 - 0.085 * i, text, transform=axes.transAxes, ha="right", va="top", color=colour,
                fontsize=10, bbox=background,
            )  # fmt: skip


def _um(value: float) -> str:
    """A length for people: three figures that matter, no powers of ten."""
    if not np.isfinite(value):
        return "none"
    size = abs(1e6 * value)
    if 0 < size < 5e-5:
        return "< 0.0001 µm"
    decimals = 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 0.1 else 4
    return f"{1e6 * value:,.{decimals}f} µm"


def _write_title(figure: Figure, name: str, figures: DeviationFigures, coverage_fraction: float | None) -> None:
    facts = [f"{figures.count:,} points"]
    if coverage_fraction is not None and np.isfinite(coverage_fraction):
        facts.append(f"{100 * coverage_fraction:.1f} % of the visible surface covered")
    if figures.count:
        facts.append(f"RMS {_um(figures.rms)}")
        facts.append(f"D95 % {_um(figures.d95)}")
    figure.text(0.06, 0.955, f"{name}: deviation from CAD", fontsize=17, color=INK, weight="bold")
    figure.text(0.06, 0.925, "  ·  ".join(facts), fontsize=11.5, color=SOFT)
