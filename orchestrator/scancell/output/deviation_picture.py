"""The picture of a deviation: the coloured cloud from two sides, and the histogram with its figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.evaluation.deviation import Deviation, DeviationFigures
from scancell.geometry.mesh import Mesh
from scancell.output.drawing import INK, SOFT, Pixels, Sheet, interpolated_colours, text_width, ticks
from scancell.output.surface_view import SurfaceView, view_axes

Array = NDArray[np.float64]

_VIEWS = ((-55.0, 35.0), (125.0, 35.0))  # azimuth, elevation in degrees
_PICTURE_BINS = 161

# Blue inside, pale at nominal, red outside: distinct for colour-blind readers, too. ColorBrewer's RdYlBu (C. Brewer).
_RGB = np.array(
    [
        (49, 54, 149), (69, 117, 180), (116, 173, 209), (171, 217, 233), (224, 243, 248), (255, 255, 191),
        (254, 224, 144), (253, 174, 97), (244, 109, 67), (215, 48, 39), (165, 0, 38),
    ],
    float,
)  # fmt: skip

# Positions on the sheet, px.
_WIDTH, _HEIGHT = 1560, 1176
_LEFT, _RIGHT = 94, 1406  # of the histogram; the views share this width
_VIEW_TOP, _VIEW_BOTTOM = 140, 640
_BAR = (1420, 150, 1442, 680)
_PLOT_TOP, _PLOT_BOTTOM = 744, 1094


def deviation_picture(
    path: str | Path,
    points_in_part: Array,
    deviation: Deviation,
    mesh: Mesh,
    *,
    name: str,
    coverage_fraction: float | None = None,
) -> None:
    """Draw the deviation of points (n, 3), m, from `mesh` in the same frame, and write it as PNG.

    Each view draws at most 150 000 points, evenly chosen; the histogram and the figures hold all of them.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    sheet = Sheet(_WIDTH, _HEIGHT)
    limit = colour_limit_um(deviation.figures.d95)
    view = SurfaceView(
        mesh,
        points_in_part,
        deviation.distance,
        deviation.face,
        lambda distance: deviation_colours(1e6 * distance, limit),
    )
    width = (_RIGHT - _LEFT) // len(_VIEWS)
    for number, (azimuth, elevation) in enumerate(_VIEWS):
        _draw_view(sheet, view, azimuth, elevation, _LEFT + number * width, width)
    _draw_colour_bar(sheet, limit, "+ outside the material" if deviation.is_signed else "the mesh is open: no inside")
    _draw_histogram(sheet, deviation, limit)
    _write_title(sheet, name, deviation.figures, coverage_fraction)
    sheet.write(path)


def deviation_colours(values_um: Array, limit: float) -> Array:
    """Colours (n, 3), 0 to 255, of deviations (n,)."""
    place = np.clip((values_um / limit + 1) / 2, 0, 1) * 255
    return interpolated_colours(_RGB)[place.astype(np.int64)]


def hex_colour(colour: Array) -> str:
    """Colour (3,), 0 to 255, as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*(int(channel) for channel in colour))


def _draw_view(sheet: Sheet, view: SurfaceView, azimuth: float, elevation: float, left: int, width: int) -> None:
    image, px_per_m = view.draw(view_axes(azimuth, elevation), width - 40, _VIEW_BOTTOM - _VIEW_TOP)
    middle = left + width // 2
    height = (_VIEW_TOP + _VIEW_BOTTOM - image.shape[0]) // 2
    sheet.image(image, middle - image.shape[1] // 2, height)
    sheet.text(middle, _VIEW_TOP - 16, f"from azimuth {azimuth:.0f}°, elevation {elevation:.0f}°", 15, SOFT, "ms")
    length_mm = _round_below((width - 40) / 4 / px_per_m * 1e3)
    end, y = left + 22 + length_mm * 1e-3 * px_per_m, _VIEW_BOTTOM + 36
    sheet.rectangle(left + 22, y - 1, end, y + 1, INK)
    sheet.text(end + 9, y, f"{length_mm:g} mm", 16.5, INK, "lm")


def _round_below(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20, … that is not above."""
    decade = 10.0 ** np.floor(np.log10(length))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= length))


def _draw_colour_bar(sheet: Sheet, limit: float, sign: str) -> None:
    left, top, right, bottom = _BAR
    level = 1 - 2 * (np.arange(bottom - top) + 0.5) / (bottom - top)
    column = deviation_colours(level * limit, limit).astype(np.uint8)
    bar: Pixels = np.ascontiguousarray(np.broadcast_to(column[:, None], (bottom - top, right - left, 3)))
    middle, tip = (left + right - 1) / 2, 26
    sheet.polygon([(left, top), (right - 1, top), (middle, top - tip)], hex_colour(column[0]))
    sheet.polygon([(left, bottom), (right - 1, bottom), (middle, bottom + tip)], hex_colour(column[-1]))
    sheet.image(bar, left, top)
    corners = [(left, top), (middle, top - tip), (right, top), (right, bottom), (middle, bottom + tip), (left, bottom)]
    sheet.line([*corners, corners[0]], INK)
    widest = 0.0
    for value, label in ticks(-limit, limit, 8):
        y = (top + bottom) / 2 - value / limit * (bottom - top) / 2
        sheet.line([(right, y), (right + 5, y)], INK)
        sheet.text(right + 10, y, label, 16.5, INK, "lm")
        widest = max(widest, text_width(label, 16.5))
    sheet.text_upwards(right + 26 + widest, (top + bottom) / 2, f"deviation, µm   ({sign})", 16.5)


def colour_limit_um(d95: float) -> float:
    """Half width of the colour scale, µm: the 95 % quantile `d95` (m) of the magnitude, rounded up to a round number.

    Outliers do not stretch the scale; they get its end colours.
    """
    typical = max(1e6 * d95, 1e-3) if np.isfinite(d95) else 1.0
    decade = 10.0 ** np.floor(np.log10(typical))
    return float(next(step * decade for step in (1, 1.5, 2, 3, 5, 7, 10) if typical <= step * decade * (1 + 1e-9)))


def _draw_histogram(sheet: Sheet, deviation: Deviation, limit: float) -> None:
    distance, width = deviation.distance, 2.0 * limit
    counts, edges = np.histogram(distance, bins=_PICTURE_BINS, range=(-1e-6 * width, 1e-6 * width))
    edges *= 1e6
    below, above = int(np.sum(distance < -1e-6 * width)), int(np.sum(distance > 1e-6 * width))
    counts[0] += below
    counts[-1] += above
    share = 100.0 * counts / max(len(distance), 1)
    top = 1.05 * max(float(share.max()), 1e-9)
    x = _LEFT + (edges + width) / (2 * width) * (_RIGHT - _LEFT)
    y = _PLOT_BOTTOM - share / top * (_PLOT_BOTTOM - _PLOT_TOP)
    for value, label in ticks(0.0, top, 6) if len(distance) else ():
        at = _PLOT_BOTTOM - value / top * (_PLOT_BOTTOM - _PLOT_TOP)
        sheet.line([(_LEFT, at), (_RIGHT, at)], "#e4e6ea")
        sheet.line([(_LEFT - 6, at), (_LEFT, at)], INK)
        sheet.text(_LEFT - 11, at, label, 16.5, INK, "rm")
    paint = deviation_colours((edges[:-1] + edges[1:]) / 2, limit)
    for left, right, height, colour in zip(x[:-1].round(), x[1:].round(), y.round(), paint, strict=True):
        if height < _PLOT_BOTTOM:
            sheet.rectangle(left, height, right, _PLOT_BOTTOM, hex_colour(colour))
    outline = np.stack([np.repeat(x, 2)[1:-1].round(), np.repeat(y, 2).round()], 1)
    sheet.line([(_LEFT, _PLOT_BOTTOM), *map(tuple, outline.tolist()), (_RIGHT, _PLOT_BOTTOM)], INK)
    sheet.line([(_LEFT, _PLOT_TOP - 4), (_LEFT, _PLOT_BOTTOM), (_RIGHT, _PLOT_BOTTOM)], INK)
    for value, label in ticks(-width, width, 8):
        at = _LEFT + (value + width) / (2 * width) * (_RIGHT - _LEFT)
        sheet.line([(at, _PLOT_BOTTOM), (at, _PLOT_BOTTOM + 6)], INK)
        sheet.text(at, _PLOT_BOTTOM + 25, label, 16.5, INK, "ms")
    beyond = below + above
    note = f"   ({beyond:,} points beyond ±{width:g} µm count in the end bars)" if beyond else ""
    sheet.text((_LEFT + _RIGHT) / 2, _PLOT_BOTTOM + 50, f"deviation, µm{note}", 16.5, INK, "ms")
    sheet.text_upwards(_LEFT - 62, (_PLOT_TOP + _PLOT_BOTTOM) / 2, "share of points, %", 16.5)
    if deviation.figures.count:
        _draw_lines(sheet, deviation.figures, width)
    _write_table(sheet, deviation.figures)


def _draw_lines(sheet: Sheet, figures: DeviationFigures, width: float) -> None:
    mean, rms, d95 = (1e6 * value for value in (figures.mean, figures.rms, figures.d95))
    y = _PLOT_TOP + 16
    for places, label, colour, dash, gap in (
        ((mean,), f"mean {um_text(figures.mean)}", "#111111", 0, 0),
        ((-rms, rms), f"± RMS {um_text(figures.rms)}", "#1f5fa8", 10, 5),
        ((-d95, d95), f"± D95 % {um_text(figures.d95)}", "#b3261e", 3, 3),
    ):
        for place in places:
            if abs(place) <= width:
                at = _LEFT + (place + width) / (2 * width) * (_RIGHT - _LEFT)
                sheet.dashes((at, _PLOT_TOP - 4), (at, _PLOT_BOTTOM), colour, dash, gap)
        sheet.rectangle(_LEFT + 12, y - 11, _LEFT + 62 + text_width(label, 16.5), y + 11, "#ffffff")
        sheet.dashes((_LEFT + 16, y), (_LEFT + 51, y), colour, dash, gap)
        sheet.text(_LEFT + 60, y, label, 16.5, INK, "lm")
        y += 26


def _write_table(sheet: Sheet, figures: DeviationFigures) -> None:
    named = {
        "mean": figures.mean,
        "standard deviation": figures.standard_deviation,
        "RMS": figures.rms,
        "D95 %": figures.d95,
        "D99.9 %": figures.d99_9,
        "maximum": figures.maximum,
        "minimum": figures.minimum,
    }
    rows = [("points", f"{figures.count:,}"), *((label, um_text(value)) for label, value in named.items())]
    for i, (label, value) in enumerate(rows):
        y = _PLOT_TOP + 12 + 30 * i
        for right, text, colour in ((_RIGHT - 150, label, SOFT), (_RIGHT - 2, value, INK)):
            sheet.rectangle(right - text_width(text, 16.5) - 3, y - 11, right + 2, y + 11, "#ffffff")
            sheet.text(right, y, text, 16.5, colour, "rm")


def um_text(value: float) -> str:
    """A length with three significant digits and no power of ten."""
    if not np.isfinite(value):
        return "none"
    size = abs(1e6 * value)
    if 0 < size < 5e-5:
        return "< 0.0001 µm"
    decimals = 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 0.1 else 4
    return f"{1e6 * value:,.{decimals}f} µm"


def _write_title(sheet: Sheet, name: str, figures: DeviationFigures, coverage_fraction: float | None) -> None:
    facts = [f"{figures.count:,} points"]
    if coverage_fraction is not None and np.isfinite(coverage_fraction):
        facts.append(f"{100 * coverage_fraction:.1f} % of the measurable surface covered")
    if figures.count:
        facts.append(f"RMS {um_text(figures.rms)}")
        facts.append(f"D95 % {um_text(figures.d95)}")
    sheet.text(_LEFT, 52, f"{name}: deviation from CAD", 28, INK, bold=True)
    sheet.text(_LEFT, 88, "  ·  ".join(facts), 19, SOFT)
