"""The report of a study as one HTML file that needs nothing from the network (template: templates/study.html.j2)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scancell.extras import require
from scancell.studies.analysis import Rows, independent_rows

require("matplotlib", "studies")
from scancell.studies import plots  # noqa: E402

_TEMPLATES = Path(__file__).parent / "templates"
_MAX_LISTED = 50
_MAX_SCATTERED = 4
_RANDOM = {"monte_carlo", "latin_hypercube", "sobol"}
_UNEXPLAINED = {
    True: "unexplained (noise, higher-order effects)",
    False: "unexplained (noise, interactions)",
}


def study_page(analysis: dict[str, Any], rows: Sequence[dict[str, Any]], about: dict[str, str]) -> str:
    """HTML of the whole report; `about` has versions and sources."""
    failed = [[row["trial"], row["seed"], row["message"]] for row in analysis["failed"]]
    text: str = (
        environment()
        .get_template("study.html.j2")
        .render(
            name=analysis["name"],
            subtitle=_subtitle(analysis),
            notes=analysis["notes"],
            engines=[_engine(name, found, rows, analysis) for name, found in analysis["engines"].items()],
            failed=failed[:_MAX_LISTED],
            failed_count=len(failed),
            about=list(about.items()),
        )
    )
    return text


def environment() -> Any:
    """Jinja2 with the templates of reports and the filter ``figure``."""
    jinja2 = require("jinja2", "studies")
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    made.filters["figure"] = format_figure
    return made


def format_figure(value: Any) -> str:
    """A number with four digits, a list of numbers as an interval, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, list | tuple):
        return " … ".join(map(format_figure, value))
    if isinstance(value, int) or abs(value) >= 1e4:
        return f"{value:.0f}"
    return f"{value:.4g}"


def _subtitle(analysis: dict[str, Any]) -> str:
    kind, count = analysis["design"]["kind"].replace("_", " "), len(analysis["factors"])
    failed = f", {len(analysis['failed'])} of them failed" if analysis["failed"] else ""
    return f"{kind} design, {count} factors, {analysis['trials']} trials{failed}"


def _engine(
    name: str, found: dict[str, Any], rows: Sequence[dict[str, Any]], analysis: dict[str, Any]
) -> dict[str, Any]:
    own = Rows.of([row for row in rows if row["engine"] == name])
    columns = _columns(analysis)
    sensitivity = [
        _sensitivity(figure, part, found["figures"][figure], own, analysis)
        for figure, part in found["sensitivity"].items()
        if np.isfinite(own.figures[figure]).sum() > 1
    ]
    return {
        "name": name,
        "trials": len(own.plain),
        "head": ["figure", *columns],
        "figures": [[figure, *(said[key] for key in columns.values())] for figure, said in found["figures"].items()],
        "sensitivity": sensitivity,
    }


def _columns(analysis: dict[str, Any]) -> dict[str, str]:
    """Statistics by title; only random designs sample the distribution of a figure."""
    columns = {"mean": "mean"}
    if analysis["design"]["kind"] in _RANDOM:
        columns |= {
            "± standard error": "standard_error",
            "standard deviation": "standard_deviation",
            f"{analysis['probability']:.0%} interval (symmetric)": "interval_symmetric",
            "shortest interval": "interval_shortest",
        }
    return columns | {"minimum": "minimum", "maximum": "maximum"}


def _sensitivity(
    name: str, found: dict[str, Any], statistics: dict[str, Any], own: Rows, analysis: dict[str, Any]
) -> dict[str, Any]:
    values = own.figures[name]
    good = np.isfinite(values)
    drawings = []
    if analysis["design"]["kind"] in _RANDOM:
        drawn = good & independent_rows(analysis["design"]["kind"], len(analysis["factors"]), len(values))
        drawings.append(plots.distribution(values[drawn], statistics, name))
        drawings.append(plots.convergence(found["convergence"], name))
    drawings.extend(_contributions(name, found, analysis["probability"]))
    table = found.get("budget") or found.get("morris") or []
    chosen = [row["factor"] for row in table][:_MAX_SCATTERED] or analysis["factors"][:_MAX_SCATTERED]
    positions = [analysis["factors"].index(label) for label in chosen]
    columns = [[row["values"][j] for row, ok in zip(own.plain, good, strict=True) if ok] for j in positions]
    drawings.append(plots.scatters(chosen, columns, values[good], name))
    markup = require("markupsafe", "studies").Markup
    head, rows = _budget_table(table, found)
    return {
        "name": name,
        "explained": found.get("explained"),
        "predicted": found.get("predicted"),
        "regression": found.get("regression"),
        "drawings": [markup(drawing) for drawing in drawings],
        "head": head,
        "rows": rows,
    }


def _contributions(name: str, found: dict[str, Any], probability: float) -> Iterable[str]:
    if found.get("sobol"):
        rows = found["sobol"]
        series = {
            title: (np.array([r[key] for r in rows]), np.array([r[f"{key}_interval"] for r in rows]))
            for title, key in (("first order", "first"), ("total", "total"))
        }
        yield plots.bars([r["factor"] for r in rows], series, f"Sobol' index of {name}, {probability:.0%} confidence")
    if found.get("morris"):
        yield plots.effects(found["morris"], name)
    if found.get("budget"):
        rows = found["budget"]
        ends = np.array([r["share_interval"] for r in rows]) if rows[0]["share_interval"] else None
        shares = {"share": (np.array([r["share"] for r in rows]), ends)}
        yield plots.bars([r["factor"] for r in rows], shares, f"share of the variance of {name}")


def _budget_table(table: Sequence[dict[str, Any]], found: dict[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Head and rows: the factors by rank and, last, the unexplained share."""
    if not table:
        return [], []
    keys = [key for key in table[0] if key != "factor"]
    rows = [[rank, row["factor"], *(row[key] for key in keys)] for rank, row in enumerate(table, 1)]
    if "unexplained" in found:
        label = _UNEXPLAINED["interactions" in found["regression"]]
        rows.append([None, label, *(found["residual"][key] for key in keys)])
    return ["rank", "factor", *(key.replace("_", " ") for key in keys)], rows
