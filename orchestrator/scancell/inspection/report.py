"""The report of an inspection as one HTML file: verdicts at a glance, and a picture of each characteristic."""

from __future__ import annotations

import html
from base64 import b64encode
from pathlib import Path

import numpy as np

from scancell.arrays import Array
from scancell.geometry.mesh import sample_surface
from scancell.inspection.inspection import Decision, Inspection, Verdict, limits_text, value_text
from scancell.output.pictures import SurfaceView, view_axes
from scancell.output.sheet import INK, Pixels, Sheet
from scancell.output.web_page import script_data, table, write_filled

VERDICT_COLOURS: dict[Verdict, str] = {
    "conforms": "#2e8b57",
    "does not conform": "#c0392b",
    "cannot be decided": "#e08a00",
    "not evaluated": "#8a9099",
}
SEVERITY: tuple[Verdict, ...] = ("not evaluated", "conforms", "cannot be decided", "does not conform")
_PLAIN, _DATUM = "#e6e9ed", "#4575b4"
_SAMPLES = 300_000
_WIDTH, _HEIGHT = 1120, 560  # px of the picture of the part
_SMALL = (420, 300)  # px of the picture of a characteristic
_VIEWS = [(azimuth, elevation) for elevation in (35.0, 80.0, -35.0) for azimuth in range(-145, 215, 45)]
_TEMPLATE = Path(__file__).with_name("report.html")


class _Faces:
    """Pictures of a part whose faces have colours of their own."""

    def __init__(self, inspection: Inspection) -> None:
        self._part = inspection.part
        points, triangle = sample_surface(self._part, _SAMPLES, 0)
        self._colours = np.zeros((len(self._part.cad_faces), 3))
        face = self._part.cad_face[triangle]
        self._view = SurfaceView(self._part, points, face.astype(float), triangle, self._colour)

    def _colour(self, faces: Array) -> Array:
        return np.asarray(self._colours[faces.astype(int)])

    def draw(self, colours: dict[int, str], view: tuple[float, float], size: tuple[int, int]) -> Pixels:
        """Picture with the colours of some faces, by their numbers, from azimuth and elevation, deg."""
        self._colours[:] = _rgb(_PLAIN)
        for number, colour in colours.items():
            self._colours[number] = _rgb(colour)
        return self._view.draw(view_axes(*view), *size)[0]

    def best_view(self, faces: list[int]) -> tuple[float, float]:
        """The view that shows most of some faces, by their normals."""
        own = np.isin(self._part.cad_face, faces)
        towards = np.array([view_axes(*view)[2] for view in _VIEWS])
        seen = np.clip(self._part.normals[own] @ towards.T, 0.0, None)
        return _VIEWS[int((self._part.areas[own] @ seen).argmax())]


def _rgb(colour: str) -> list[int]:
    return list(bytes.fromhex(colour[1:]))


def part_picture(inspection: Inspection, faces: _Faces | None = None) -> Sheet:
    """The part from two sides, each face in the colour of the worst verdict on it; `faces` draws it."""
    colours: dict[int, str] = {}
    ordered = sorted(inspection.decisions, key=lambda one: SEVERITY.index(one.verdict))
    for one in ordered:
        colours |= dict.fromkeys(inspection.faces(one)[0], VERDICT_COLOURS[one.verdict])
    faces, sheet = faces or _Faces(inspection), Sheet(_WIDTH, _HEIGHT)
    for number, view in enumerate(((-55.0, 35.0), (125.0, 35.0))):
        drawn = faces.draw(colours, view, (_WIDTH // 2 - 20, _HEIGHT - 60))
        sheet.image(drawn, 10 + number * (_WIDTH // 2), 10)
    sheet.legend(14, _HEIGHT - 22, list(VERDICT_COLOURS.items()), INK)
    return sheet


def write_report(inspection: Inspection, path: Path) -> None:
    """Write the page.

    Raises `OutputError` if the file cannot be written.
    """
    faces, sections = _Faces(inspection), []
    for number, one in enumerate(inspection.decisions):
        own, datums = inspection.faces(one)
        colours = dict.fromkeys(datums, _DATUM) | dict.fromkeys(own, VERDICT_COLOURS[one.verdict])
        drawn = faces.draw(colours, faces.best_view(own), _SMALL)
        sections.append(_section(number, one, Sheet.of(drawn).png(), has_datums=bool(datums)))
    rule = inspection.description
    counts = ", ".join(f"{count} {verdict}" for verdict, count in inspection.counts.items())
    name = Path(inspection.part.source).name
    write_filled(
        _TEMPLATE,
        path,
        TITLE=html.escape(f"{name}: inspection"),
        VERDICT=html.escape(f"{counts} of {len(inspection.decisions)} characteristics"),
        NOTES="".join(f'<p class="bad">{html.escape(note)}</p>' for note in inspection.warnings),
        PICTURE=_image(part_picture(inspection, faces).png(), "faces in the colours of their verdicts"),
        TABLE=_overview(inspection),
        SECTIONS="".join(sections),
        RULE=html.escape(_rule_text(inspection)),
        ABOUT=table(
            ("", ""),
            [
                ("part", inspection.part.source),
                ("cloud", str(inspection.source.get("file", inspection.source.get("format", "")))),
                ("filter", f"Gaussian, {rule.filter_mm:g} mm" if rule.filter_mm else "none"),
                ("points used", f"within {rule.reach_mm:g} mm of their face, {rule.edge_mm:g} mm from other faces"),
                ("temperature of the part", f"{rule.temperature.part_c:g} °C; values are those at 20 °C"),
            ],
        ),
        DATA=script_data(inspection.figures),
    )


def _rule_text(inspection: Inspection) -> str:
    rule = inspection.description
    if rule.decision == "simple":
        return "Simple acceptance: the measured value decides, whatever its uncertainty."
    return (
        f"ISO 14253-1: a characteristic conforms, or does not, if the probability is at least "
        f"{100 * rule.probability:g} %; otherwise it cannot be decided with this uncertainty."
    )


def _image(png: bytes, text: str) -> str:
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{b64encode(png).decode()}">'


def _overview(inspection: Inspection) -> str:
    rows = []
    for number, one in enumerate(inspection.decisions):
        colour = VERDICT_COLOURS[one.verdict]
        cells = [
            f'<a href="#c{number}">{html.escape(one.description.name)}</a>',
            html.escape(one.description.kind.replace("_", " ")),
            f'<b style="color:{colour}">{one.verdict}</b>',
            html.escape(limits_text(one)),
            html.escape(value_text(one).replace(" um", " µm")),
            _bar(one),
        ]
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = "".join(f"<th>{title}</th>" for title in ("name", "kind", "verdict", "limits", "value", "in the zone"))
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _section(number: int, one: Decision, picture: bytes, *, has_datums: bool) -> str:
    row = one.row()
    shown = [
        (_title(key), f"{value:.5f}" if key.endswith(("_mm", "_deg")) else value)
        for key, value in row.items()
        if value is not None and value != "" and key not in ("name", "verdict")
    ]
    name, colour = one.description.name, VERDICT_COLOURS[one.verdict]
    note = '<p class="note">Datums are blue.</p>' if has_datums else ""
    return (
        f'<section id="c{number}"><h2>{html.escape(name)}: <span style="color:{colour}">{one.verdict}</span></h2>'
        f'<div class="pair"><div>{_image(picture, name)}{note}</div>{table(("", ""), shown)}</div></section>'
    )


def _title(key: str) -> str:
    for suffix, unit in (("_um", "µm"), ("_mm", "mm"), ("_deg", "°")):
        if key.endswith(suffix):
            return f"{key.removesuffix(suffix).replace('_', ' ')}, {unit}"
    return key.replace("_", " ")


def _bar(one: Decision) -> str:
    """SVG of the 95 % interval within the limits."""
    if one.measured is None:
        return ""
    low = one.low if np.isfinite(one.low) else 0.0 if not one.description.is_size else 2 * one.nominal - one.high
    high = one.high if np.isfinite(one.high) else 2 * one.nominal - one.low
    span = (high - low) or 1.0
    places = [float(np.clip(30 + 120 * (at - low) / span, 2, 178)) for at in (*one.interval, one.value)]
    colour = VERDICT_COLOURS[one.verdict]
    return (
        '<svg width="180" height="18" role="img" aria-label="value and 95 % interval within the limits">'
        '<rect x="30" y="4" width="120" height="10" fill="#e3e7eb"/>'
        f'<path d="M{places[0]:.1f} 9H{places[1]:.1f}" stroke="{colour}" stroke-width="3"/>'
        f'<circle cx="{places[2]:.1f}" cy="9" r="4" fill="{colour}"/></svg>'
    )
