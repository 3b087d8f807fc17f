"""The report of a deviation as one HTML file: a verdict, the cloud in 3D, outliers and unseen surface, the figures."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.evaluation.deviation import Deviation, DeviationFigures, Outliers, UnseenSurface, find_outliers
from scancell.geometry.mesh import Mesh
from scancell.output.pictures import SurfaceView, view_axes
from scancell.output.sheet import (
    COLOURS,
    INK,
    SOFT,
    TEXT_SIZE,
    Axes,
    Pixels,
    Sheet,
    interpolated_colours,
    text_width,
    ticks,
)
from scancell.output.web_page import packed, packed_mesh, quantised, script_data, table, write_filled

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

_TEMPLATE = Path(__file__).with_name("deviation_report.html")
_MOST_POINTS = 120_000  # drawn, beside the outliers
_MOST_MARKED = 20_000  # outliers that are drawn
_MOST_LISTED = 500  # places of outliers in the table
_BINS = 81
_SHADES = 33  # of the colour scale
_REASON_COLOURS = ("#9aa0a6", "#5f6670", "#8e44ad", "#c2185b", "#e08a00", "#7a5230", "#00897b")


def deviation_picture(
    points_in_part: Array, deviation: Deviation, mesh: Mesh, *, name: str, coverage_fraction: float | None = None
) -> Sheet:
    """Picture of the deviation of points (n, 3), m, from `mesh` in the same frame, with a histogram and its figures.

    Each view draws at most 150 000 points, evenly chosen; the histogram and the figures hold all of them.
    """
    sheet, figures = Sheet(_WIDTH, _HEIGHT), deviation.figures
    limit = colour_limit_um(figures.d95)
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
    _draw_histogram(sheet, deviation)
    facts = [f"{figures.count:,} points"]
    if coverage_fraction is not None and np.isfinite(coverage_fraction):
        facts.append(f"{100 * coverage_fraction:.1f} % of the measurable surface covered")
    if figures.count:
        facts += [f"RMS {um_text(figures.rms)}", f"D95 % {um_text(figures.d95)}"]
    sheet.text(_LEFT, 52, f"{name}: deviation from CAD", 28, bold=True)
    sheet.text(_LEFT, 88, "  ·  ".join(facts), 19, SOFT)
    return sheet


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
    sheet.text(
        middle, _VIEW_TOP - 16, f"from azimuth {azimuth:.0f}°, elevation {elevation:.0f}°", colour=SOFT, anchor="ms"
    )
    longest_mm = (width - 40) / 4 / px_per_m * 1e3
    decade = 10.0 ** np.floor(np.log10(longest_mm))
    length_mm = float(max(step * decade for step in (1, 2, 5) if step * decade <= longest_mm))
    end, y = left + 22 + length_mm * 1e-3 * px_per_m, _VIEW_BOTTOM + 36
    sheet.rectangle(left + 22, y - 1, end, y + 1, INK)
    sheet.text(end + 9, y, f"{length_mm:g} mm", anchor="lm")


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
        sheet.text(right + 10, y, label, anchor="lm")
        widest = max(widest, text_width(label))
    sheet.text_upwards(right + 26 + widest, (top + bottom) / 2, f"deviation, µm   ({sign})")


def colour_limit_um(d95: float) -> float:
    """Half width of the colour scale, µm: the 95 % quantile `d95` (m) of the magnitude, rounded up to a round number.

    Outliers do not stretch the scale; they get its end colours.
    """
    typical = max(1e6 * d95, 1e-3) if np.isfinite(d95) else 1.0
    decade = 10.0 ** np.floor(np.log10(typical))
    return float(next(step * decade for step in (1, 1.5, 2, 3, 5, 7, 10) if typical <= step * decade * (1 + 1e-9)))


def _distribution(deviation: Deviation, bins: int) -> tuple[NDArray[np.int64], Array, str]:
    """Number of points (k,) by deviation within twice the colour scale, edges (k + 1,) in µm, and what lies beyond.

    The end bins count the points beyond.
    """
    limit = 2.0 * colour_limit_um(deviation.figures.d95)
    distance = 1e6 * deviation.distance
    counts, edges = np.histogram(np.clip(distance, -limit, limit), bins, (-limit, limit))
    beyond = int((np.abs(distance) > limit).sum())
    return counts, edges, f"   ({beyond:,} points beyond ±{limit:g} µm count in the end bars)" if beyond else ""


def _draw_histogram(sheet: Sheet, deviation: Deviation) -> None:
    counts, edges, beyond = _distribution(deviation, _PICTURE_BINS)
    figures, width = deviation.figures, edges[-1]
    share = 100.0 * counts / max(figures.count, 1)
    top = 1.05 * float(share.max()) or 1.0
    lines = {
        f"mean {um_text(figures.mean)}": ([figures.mean], INK),
        f"± RMS {um_text(figures.rms)}": ([-figures.rms, figures.rms], COLOURS[0]),
        f"± D95 % {um_text(figures.d95)}": ([-figures.d95, figures.d95], COLOURS[3]),
    }
    legend = [(label, colour) for label, (_, colour) in lines.items()] if figures.count else []
    box, labels = (_LEFT, _PLOT_TOP, _RIGHT, _PLOT_BOTTOM), (f"deviation, µm{beyond}", "share of points, %")
    axes = Axes(sheet, box, (-width, width), (0.0, top), labels, "", legend)
    paint = deviation_colours((edges[:-1] + edges[1:]) / 2, width / 2)
    for left, right, height, colour in zip(edges[:-1], edges[1:], share, paint, strict=True):
        if height:
            axes.bar(left, right, 0.0, height, hex_colour(colour))
    steps = zip(np.repeat(edges, 2), [0.0, *np.repeat(share, 2), 0.0], strict=True)
    axes.line(steps, INK, 1)
    for places, colour in lines.values():
        for place in 1e6 * np.array(places):
            if abs(place) <= width:
                axes.line([(place, 0.0), (place, top)], colour)
    for number, (title, text) in enumerate(figure_texts(figures)):
        y = _PLOT_TOP + 12 + 30 * number
        sheet.text(_RIGHT - 150, y, title, TEXT_SIZE, SOFT, "rm", halo="#ffffff")
        sheet.text(_RIGHT - 2, y, text, TEXT_SIZE, INK, "rm", halo="#ffffff")


def figure_texts(figures: DeviationFigures) -> list[tuple[str, str]]:
    """Names and values of the figures."""
    return [
        ("points", f"{figures.count:,}"),
        ("mean", _signed(figures.mean)),
        ("standard deviation", um_text(figures.standard_deviation)),
        ("RMS", um_text(figures.rms)),
        ("95 % within", um_text(figures.d95)),
        ("99.9 % within", um_text(figures.d99_9)),
        ("maximum", _signed(figures.maximum)),
        ("minimum", _signed(figures.minimum)),
    ]


def um_text(value: float) -> str:
    """A length with three significant digits and no power of ten."""
    if not np.isfinite(value):
        return "none"
    size = abs(1e6 * value)
    if 0 < size < 5e-5:
        return "< 0.0001 µm"
    decimals = 0 if size >= 100 else 1 if size >= 10 else 2 if size >= 0.1 else 4
    return f"{1e6 * value:,.{decimals}f} µm"


@dataclass(frozen=True)
class DeviationReport:
    """Content of a report.

    Attributes
    ----------
    name
        Name of the part.
    points_in_part
        (n, 3) points of the deviation, m.
    unseen
        Surface without points.
    coverage
        Covered share of the surface, and what it is a share of; None where it is unknown.
    tables
        Rows of further figures by title; lengths in µm.
    origin
        Camera and view that measured a point, by its row.
    notes
        Warnings.
    about
        Versions and inputs: name and text.
    """

    name: str
    points_in_part: Array
    deviation: Deviation
    mesh: Mesh
    unseen: UnseenSurface
    coverage: tuple[float, str] | None = None
    tables: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    origin: Callable[[int], str] | None = None
    notes: Sequence[str] = ()
    about: Mapping[str, str] = field(default_factory=dict)

    def write(self, path: str | Path) -> int:
        """Write the page, and return its size in bytes.

        At most 120 000 points of the cloud, evenly chosen, and 20 000 outliers are drawn; the figures count all.

        Raises `OutputError` if the file cannot be written.
        """
        outliers = find_outliers(self.points_in_part, self.deviation.distance, self.mesh)
        drawn = np.unique(np.linspace(0, len(self.points_in_part) - 1, _MOST_POINTS).round().astype(np.int64))
        drawn = drawn if len(self.points_in_part) > _MOST_POINTS else np.arange(len(self.points_in_part))
        return write_filled(
            _TEMPLATE,
            path,
            TITLE=html.escape(f"{self.name}: deviation from CAD"),
            VERDICT=html.escape(self.verdict(outliers)),
            NOTES="".join(f'<p class="bad">{html.escape(note)}</p>' for note in self.notes),
            DRAWN=_drawn_text(len(drawn), len(self.points_in_part), min(len(outliers.rows), _MOST_MARKED), outliers),
            OUTLIERS=self._outlier_table(outliers),
            UNSEEN=self._unseen_table(),
            HISTOGRAM=_histogram(self.deviation),
            FIGURES=self._figures(),
            ABOUT=table(("", ""), list(self.about.items())),
            DATA=script_data(self._data(outliers, drawn)),
        )

    def verdict(self, outliers: Outliers) -> str:
        """One sentence: spread of the deviations, outliers, unseen surface."""
        figures = self.deviation.figures
        if not figures.count:
            return "The cloud holds no point of the part."
        seen = ""
        if self.coverage is not None:
            share, of_what = self.coverage
            seen = f", and {100 * (1 - share):.1f} % of the {of_what} has no points"
        if outliers.places:
            worst = max((place.largest for place in outliers.places), key=abs)
            wild = (
                f"{len(outliers.rows):,} {_plural('outlier', len(outliers.rows))} at {len(outliers.places):,} "
                f"{_plural('place', len(outliers.places))} ({'the largest ' if len(outliers.rows) > 1 else ''}"
                f"{_signed(worst)})"
            )
        else:
            wild = "no outliers"
        return (
            f"95 % of {figures.count:,} points lie within {um_text(figures.d95)} of the nominal surface "
            f"(mean {_signed(figures.mean)}), with {wild}{seen}."
        ).replace("< ", "less than ")

    def _outlier_table(self, outliers: Outliers) -> str:
        rule = (
            f'<p class="note">Outliers deviate by more than {um_text(outliers.threshold)} from the median '
            f"({_signed(outliers.median)}): 5 robust standard deviations. A place holds the outliers "
            f"within {1e3 * outliers.reach:.3g} mm of its largest one, whose position is listed.</p>"
        )
        if not outliers.places:
            return f"{rule}<p>none</p>"
        head = ["place", "x, mm", "y, mm", "z, mm", "largest", "points"]
        head += ["measured by"] if self.origin else []
        rows, attributes = [], []
        for number, place in enumerate(outliers.places[:_MOST_LISTED], 1):
            at = 1e3 * self.points_in_part[place.row]
            rows.append([str(number), *(f"{value:.3f}" for value in at), _signed(place.largest), f"{place.count:,}"])
            if self.origin:
                rows[-1].append(self.origin(place.row))
            attributes.append(f'data-at="{",".join(f"{value:.6g}" for value in self.points_in_part[place.row])}"')
        rest = outliers.places[_MOST_LISTED:]
        more = sum(place.count for place in rest)
        text = f"<p>{more:,} more outliers at {len(rest):,} places with smaller deviations</p>" if rest else ""
        return f"{rule}{table(head, rows, attributes)}{text}"

    def _unseen_table(self) -> str:
        unseen, colours = self.unseen, dict(zip(self.unseen.reasons, _REASON_COLOURS, strict=False))
        rows = [
            ["", reason, f"{100 * share:.2f} %", f"{1e6 * share * unseen.area:,.0f}"]
            for reason, share in unseen.shares.items()
        ]
        attributes = [f'style="--c: {colours[reason]}"' for reason in unseen.shares]
        return table(("", "surface without points", "share of the part", "mm²"), rows, attributes)

    def _figures(self) -> str:
        parts = [table(("deviation of all points", ""), figure_texts(self.deviation.figures))]
        for title, own in self.tables.items():
            if own:
                head = list(own[0])
                cells = [[row[key] for key in head] for row in own]
                parts.append(
                    f"<h2>{html.escape(title)}</h2>"
                    f'<div class="wide">{table([_column_title(key) for key in head], cells)}</div>'
                )
        return "".join(parts)

    def _data(self, outliers: Outliers, drawn: NDArray[np.int64]) -> dict[str, Any]:
        limit = colour_limit_um(self.deviation.figures.d95)
        scale = deviation_colours(np.linspace(-limit, limit, _SHADES), limit)
        low, high = self.mesh.bounds
        return {
            "mesh": packed_mesh(self.mesh),
            "middle": ((low + high) / 2).tolist(),
            "radius": float(np.linalg.norm(high - low)) / 2,
            "limit": limit,
            "signed": self.deviation.is_signed,
            "scale": np.rint(scale).astype(int).tolist(),
            "cloud": self._packed_points(drawn),
            "spacing": float(np.sqrt(self.mesh.areas.sum() / max(len(drawn), 1))),
            "outliers": self._packed_points(outliers.rows[:_MOST_MARKED]),
            "unseen": {
                **quantised(self.unseen.samples_in_part, "points"),
                "colours": [list(bytes.fromhex(colour[1:])) for colour in _REASON_COLOURS],
                "reason": packed(self.unseen.reason, "u1"),
                "spacing": float(np.sqrt(self.unseen.area / max(self.unseen.total, 1))),
            },
        }

    def _packed_points(self, rows: NDArray[np.int64]) -> dict[str, Any]:
        values = packed(1e6 * self.deviation.distance[rows], "<f4")
        return {**quantised(self.points_in_part[rows], "points"), "values": values}


def _drawn_text(drawn: int, total: int, marked: int, outliers: Outliers) -> str:
    text = f"all {total:,} points" if drawn == total else f"{drawn:,} of {total:,} points, evenly chosen"
    if not len(outliers.rows):
        return f"{text} are drawn"
    which = "all outliers" if marked == len(outliers.rows) else f"the {marked:,} largest outliers"
    return f"{text}, and {which} are drawn"


def _histogram(deviation: Deviation) -> str:
    """SVG of the distribution within twice the colour scale."""
    counts, edges, beyond = _distribution(deviation, _BINS)
    limit = edges[-1] / 2
    height = 150 * counts / max(int(counts.max()), 1)
    colours = deviation_colours((edges[:-1] + edges[1:]) / 2, limit)
    width = 648 / _BINS
    bars = "".join(
        f'<rect x="{width * k:.1f}" y="{160 - h:.1f}" width="{width:.1f}" height="{h:.1f}" fill="{hex_colour(c)}"/>'
        for k, (h, c) in enumerate(zip(height, colours, strict=True))
    )
    labels = "".join(
        f'<text x="{324 + 324 * share:.0f}" y="178" text-anchor="{anchor}">{value:+g}</text>'
        for share, anchor in ((-1, "start"), (-0.5, "middle"), (0.5, "middle"), (1, "end"))
        for value in (2 * limit * share,)
    )
    return (
        '<svg viewBox="0 0 648 200" role="img" aria-label="histogram of the deviations">'
        f'{bars}<path d="M0 160H648M324 160V166" stroke="#222"/>{labels}'
        '<text x="324" y="178" text-anchor="middle">0</text>'
        f'<text x="324" y="196" text-anchor="middle">deviation, µm{beyond}</text></svg>'
    )


def _signed(value: float) -> str:
    text = um_text(value)
    return f"{'+' if value > 0 and text[0].isdigit() else ''}{text}".replace("-", "\N{MINUS SIGN}")


def _plural(word: str, count: int) -> str:
    return word if count == 1 else f"{word}s"


def _column_title(key: str) -> str:
    for suffix in ("um", "mm", "deg", "percent"):
        if key.endswith(f"_{suffix}"):
            unit = {"um": "µm", "deg": "°", "percent": "%"}.get(suffix, suffix)
            return f"{key.removesuffix(f'_{suffix}').replace('_', ' ')}, {unit}"
    return key.replace("_", " ")
