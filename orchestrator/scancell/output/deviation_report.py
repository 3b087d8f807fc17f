"""The report of a deviation as one HTML file: a verdict, the cloud in 3D, outliers and unseen surface, the figures."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.evaluation.deviation import Deviation
from scancell.evaluation.outliers import Outliers, find_outliers
from scancell.evaluation.unseen import UnseenSurface
from scancell.geometry.mesh import Mesh
from scancell.output.deviation_picture import colour_limit_um, deviation_colours, hex_colour, um_text
from scancell.output.web_page import packed, packed_mesh, quantised, script_data, table, write_filled

Array = NDArray[np.float64]

_TEMPLATE = Path(__file__).with_name("deviation_report.html")
_MOST_POINTS = 120_000  # drawn, beside the outliers
_MOST_MARKED = 20_000  # outliers that are drawn
_MOST_LISTED = 500  # places of outliers in the table
_BINS = 81
_SHADES = 33  # of the colour scale
_REASON_COLOURS = ("#9aa0a6", "#5f6670", "#8e44ad", "#c2185b", "#e08a00", "#7a5230", "#00897b")


@dataclass(frozen=True)
class DeviationReport:
    """Content of a report.

    Attributes
    ----------
    name
        Of the part.
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
        unseen = self.unseen
        rows = [
            ["", reason, f"{100 * share:.2f} %", f"{1e6 * share * unseen.area:,.0f}"]
            for reason, share in unseen.shares.items()
        ]
        attributes = [f'style="--c: {self._reason_colour(reason)}"' for reason in unseen.shares]
        return table(("", "surface without points", "share of the part", "mm²"), rows, attributes)

    def _reason_colour(self, reason: str) -> str:
        return _REASON_COLOURS[self.unseen.reasons.index(reason) % len(_REASON_COLOURS)]

    def _figures(self) -> str:
        figures = self.deviation.figures
        rows = [
            ("points", f"{figures.count:,}"),
            ("mean", _signed(figures.mean)),
            ("standard deviation", um_text(figures.standard_deviation)),
            ("RMS", um_text(figures.rms)),
            ("95 % within", um_text(figures.d95)),
            ("99.9 % within", um_text(figures.d99_9)),
            ("maximum", _signed(figures.maximum)),
            ("minimum", _signed(figures.minimum)),
        ]
        parts = [table(("deviation of all points", ""), rows)]
        for title, own in self.tables.items():
            if own:
                head = list(own[0])
                cells = [[_cell(row[key]) for key in head] for row in own]
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
                "colours": [_rgb(_REASON_COLOURS[k % len(_REASON_COLOURS)]) for k in range(len(self.unseen.reasons))],
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
    """SVG of the distribution within twice the colour scale; what lies beyond is counted in the end bars."""
    limit = colour_limit_um(deviation.figures.d95)
    distance = 1e6 * deviation.distance
    counts, edges = np.histogram(np.clip(distance, -2 * limit, 2 * limit), _BINS, (-2 * limit, 2 * limit))
    beyond = int((np.abs(distance) > 2 * limit).sum())
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
    note = f" ({beyond:,} points beyond are counted in the end bars)" if beyond else ""
    return (
        '<svg viewBox="0 0 648 200" role="img" aria-label="histogram of the deviations">'
        f'{bars}<path d="M0 160H648M324 160V166" stroke="#222"/>{labels}'
        '<text x="324" y="178" text-anchor="middle">0</text>'
        f'<text x="324" y="196" text-anchor="middle">deviation, µm{note}</text></svg>'
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


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
