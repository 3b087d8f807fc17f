"""The report of an acceptance test as one HTML file without links (template: ../templates/acceptance.html.j2)."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

from scancell.extras import require

require("matplotlib", "studies")
from scancell.studies.acceptance import plots  # noqa: E402
from scancell.studies.acceptance.statistics import REPEATABILITY  # noqa: E402
from scancell.studies.page import environment  # noqa: E402

_TITLES = {
    "sphere": ("Sphere: probing", ("probing form, 95 % of the points", "probing size", "D95 %")),
    "ball_bar": ("Ball bar: sphere spacing", ("sphere spacing", "probing form, 95 % of the points")),
    "plane": ("Plane: flatness", ("flatness, 95 % of the points", "flatness", "bias")),
    "step": ("Step artefact: length", ("step height",)),
    "cylinder": ("Cylinder: form and size", ("form, 95 % of the points", "diameter")),
    "cone": ("Cone: form and angle", ("form, 95 % of the points", "cone angle")),
}
_RATES = ("outlier rate", "missing-point rate")
_UNITS = {"um": "µm"}
_STATISTICS = {
    "mean": "mean",
    "standard_uncertainty": "std. uncertainty",
    "interval_symmetric": "95 % interval",
}
_DETAILS = {**_STATISTICS, "interval_shortest": "shortest interval"}


def acceptance_page(figures: Mapping[str, Any], pictures: Mapping[str, bytes], failures: Sequence[str]) -> str:
    """HTML of the whole report.

    Parameters
    ----------
    figures
        Content of ``acceptance.json``.
    pictures
        PNG of the deviation of each artefact.
    """
    markup = require("markupsafe", "studies").Markup
    budgets_head, budgets = _budgets([found for found in figures["contributions"] if _is_shown(found)])
    text: str = (
        environment()
        .get_template("acceptance.html.j2")
        .render(
            title=f"Acceptance test of {figures['sensor']}",
            facts=_facts(figures),
            what=figures["what"],
            few=figures["programme"]["repeats"] < 11,
            failures=failures,
            largest_head=["artefact", "characteristic", "of", "position", "mode", "unit", *_STATISTICS.values()],
            largest=[_largest(row) for row in figures["largest"] if _is_shown(row)],
            rates=_rates(figures["figures"]),
            artefacts=[_artefact(name, figures, pictures, markup) for name in _measured(figures)],
            sweeps=[(found["name"], markup(plots.sweep(found))) for found in figures["sweeps"]],
            linearity=figures["linearity_percent"],
            budgets_head=budgets_head,
            budgets=budgets,
            about=[["engine", figures["engine"]], ["seed", figures["seed"]], *_words(figures)],
        )
    )
    return text


def _facts(figures: Mapping[str, Any]) -> str:
    near, far = figures["range_mm"]
    programme = figures["programme"]
    size = "" if figures["artefact_scale"] == 1.0 else f", artefacts {figures['artefact_scale']:.3g} times their size"
    return (
        f"measuring range {near:g} to {far:g} mm, cell {figures['cell']}, {figures['engine']} engine, "
        f"{programme['repeats']} repeats{size}"
    )


def _words(figures: Mapping[str, Any]) -> list[list[str]]:
    listed = {"as built": figures["as_built"], "factors drawn for each repeat": figures["factors"]}
    return [[name, ", ".join(words)] for name, words in listed.items() if words]


def _measured(figures: Mapping[str, Any]) -> list[str]:
    return list(dict.fromkeys(row["artefact"] for row in figures["figures"]))


def _largest(row: Mapping[str, Any]) -> list[Any]:
    names = [row["artefact"].replace("_", " "), row["name"], row["of"], row["position"], row["mode"]]
    return [*names, _UNITS.get(row["unit"], row["unit"]), *(row[key] for key in _STATISTICS)]


def _rates(rows: Sequence[Mapping[str, Any]]) -> list[list[Any]]:
    """Artefact, position, mode, outlier and missing-point rate in %."""
    places: dict[tuple[str, str, str], dict[str, float]] = {}
    for row in rows:
        if row["name"] in _RATES:
            place = (row["artefact"].replace("_", " "), row["position"], row["mode"])
            places.setdefault(place, {})[row["name"]] = row["mean"]
    return [[*place, *(rates[name] for name in _RATES)] for place, rates in places.items()]


def _artefact(name: str, figures: Mapping[str, Any], pictures: Mapping[str, bytes], markup: Any) -> dict[str, Any]:
    rows = [row for row in figures["figures"] if row["artefact"] == name and row["name"] not in _RATES]
    title, shown = _TITLES.get(name, (name, ()))
    drawings = []
    for characteristic in shown:
        own = [row for row in rows if row["name"] == characteristic]
        if own:
            drawings.append(markup(plots.over_positions(own, characteristic)))
    table = [
        [
            *(row["of"], row["name"], row["position"], round(row["standoff_mm"], 1), row["mode"]),
            *(_UNITS.get(row["unit"], row["unit"]), row["repeats"], *(row[key] for key in _DETAILS)),
            *(row["minimum"], row["maximum"], row["fit_uncertainty"]),
        ]
        for row in rows
    ]
    picture = pictures.get(name)
    return {
        "title": title,
        "drawings": drawings,
        "head": [
            *("of", "characteristic", "position", "standoff, mm", "mode", "unit", "repeats", *_DETAILS.values()),
            *("minimum", "maximum", "uncertainty by the fit"),
        ],
        "rows": table,
        "picture": None if picture is None else base64.b64encode(picture).decode(),
    }


def _is_shown(found: Mapping[str, Any]) -> bool:
    return found["name"] in _TITLES.get(found["artefact"], ("", ()))[1]


def _budgets(found: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[Any]]]:
    """Head and rows: share of each factor in %."""
    factors = list(dict.fromkeys(row["factor"] for one in found for row in one["budget"]))
    ordered = [*(name for name in factors if name != REPEATABILITY), REPEATABILITY]
    rows = []
    for one in found:
        shares = {row["factor"]: 100.0 * row["share"] for row in one["budget"]}
        size = sum(row["uncertainty"] ** 2 for row in one["budget"]) ** 0.5
        names = [one["artefact"].replace("_", " "), one["name"], _UNITS.get(one["unit"], one["unit"])]
        rows.append([*names, size, *(shares.get(factor) for factor in ordered)])
    return ["artefact", "characteristic", "unit", "std. deviation", *(f"{name}, %" for name in ordered)], rows
