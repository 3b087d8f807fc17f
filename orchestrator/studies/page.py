"""The report of a study as one HTML file that needs nothing from the network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from orchestrator.studies import plots
from orchestrator.studies.analysis import Rows, independent_rows

_MOST_FAILURES = 50
_SCATTERED = 4
_RANDOM = {"monte_carlo", "latin_hypercube", "sobol"}
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1080px; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { border-bottom: 1px solid #ccc; margin-top: 2.5rem; } h3 { margin-top: 2rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; font-size: 14px; }
th { text-align: left; font-weight: 600; } th, td { padding: .2rem .8rem .2rem 0; border-bottom: 1px solid #e4e4e4; }
td.n { text-align: right; } .plots { display: flex; flex-wrap: wrap; gap: 1rem; align-items: flex-start; }
.plots svg { max-width: 100%; height: auto; } .note { color: #666; } .bad { color: #a33; }
"""


def study_page(analysis: dict[str, Any], rows: Sequence[dict[str, Any]], about: dict[str, str]) -> str:
    """HTML of the whole report; `about` are lines for its foot: versions, sources."""
    parts = [
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{escape(analysis['name'])}</title>",
        f"<style>{_STYLE}</style><h1>{escape(analysis['name'])}</h1>",
        f"<p class='note'>{escape(_subtitle(analysis))}</p>",
    ]
    for engine, said in analysis["engines"].items():
        own = Rows.of([row for row in rows if row["engine"] == engine])
        parts.append(f"<h2>{escape(engine)}: {len(own.plain)} trials</h2>")
        parts.append(_figure_table(said["figures"], analysis))
        parts.extend(
            _closer(name, closer, said["figures"][name], own, analysis) for name, closer in said["closer"].items()
        )
    parts.append(_failures(analysis["failed"]))
    parts.append("<h2>About</h2>" + _table(["", ""], [[key, value] for key, value in about.items()]))
    return "\n".join(parts) + "\n"


def _subtitle(analysis: dict[str, Any]) -> str:
    kind, count = analysis["design"]["kind"].replace("_", " "), len(analysis["factors"])
    bad = f", {len(analysis['failed'])} of them failed" if analysis["failed"] else ""
    return f"{kind} design, {count} factors, {analysis['trials']} trials{bad}"


def _figure_table(figures: dict[str, Any], analysis: dict[str, Any]) -> str:
    """Only draws at random say how figures are distributed; the points of other designs just have a range."""
    columns = {"mean": "mean"}
    if analysis["design"]["kind"] in _RANDOM:
        columns |= {
            "± standard error": "standard_error",
            "standard deviation": "standard_deviation",
            f"{analysis['probability']:.0%} interval (symmetric)": "interval_symmetric",
            "shortest interval": "interval_shortest",
        }
    columns |= {"least": "minimum", "largest": "maximum"}
    rows = [[name, *(said[key] for key in columns.values())] for name, said in figures.items()]
    return _table(["figure", *columns], rows)


def _closer(name: str, closer: dict[str, Any], said: dict[str, Any], own: Rows, analysis: dict[str, Any]) -> str:
    values = own.figures[name]
    good = np.isfinite(values)
    if good.sum() < 2:
        return ""
    drawings = []
    if analysis["design"]["kind"] in _RANDOM:
        drawn = good & independent_rows(analysis["design"]["kind"], len(analysis["factors"]), len(values))
        drawings.append(plots.distribution(values[drawn], said, name))
        drawings.append(plots.settling(closer["convergence"], name))
    drawings.extend(_contributors(name, closer, analysis["probability"]))
    ranking = [row["factor"] for row in closer.get("budget", closer.get("morris", []))] or analysis["factors"]
    chosen = ranking[:_SCATTERED]
    places = [analysis["factors"].index(label) for label in chosen]
    columns = [[row["values"][j] for row, ok in zip(own.plain, good, strict=True) if ok] for j in places]
    drawings.append(plots.scatters(chosen, columns, values[good], name))
    figures = "".join(f"<div>{drawing}</div>" for drawing in drawings)
    return f"<h3>{escape(name)}</h3>{_words(closer)}<div class='plots'>{figures}</div>{_budget_table(closer)}"


def _words(closer: dict[str, Any]) -> str:
    if "explained" not in closer:
        return ""
    model = "value and square of each factor" if closer["quadratic"] else "the value of each factor"
    return (
        f"<p class='note'>Shares by an additive model ({model}), which explains {closer['explained']:.1%} of the "
        "variance; the rest is interaction, stronger nonlinearity and noise.</p>"
    )


def _contributors(name: str, closer: dict[str, Any], probability: float) -> Iterable[str]:
    if closer.get("sobol"):
        rows = closer["sobol"]
        series = {
            title: (np.array([r[key] for r in rows]), np.array([r[f"{key}_interval"] for r in rows]))
            for title, key in (("first order", "first"), ("total", "total"))
        }
        yield plots.bars([r["factor"] for r in rows], series, f"Sobol' index of {name}, {probability:.0%} confidence")
    elif closer.get("morris"):
        yield plots.effects(closer["morris"], name)
    elif closer.get("budget"):
        rows = closer["budget"]
        ends = np.array([r["share_interval"] for r in rows]) if "share_interval" in rows[0] else None
        shares = {"share": (np.array([r["share"] for r in rows]), ends)}
        yield plots.bars([r["factor"] for r in rows], shares, f"share of the variance of {name}")


def _budget_table(closer: dict[str, Any]) -> str:
    rows = closer.get("budget") or closer.get("morris") or []
    if not rows:
        return ""
    keys = [key for key in rows[0] if key != "factor"]
    head = ["rank", "factor", *(key.replace("_", " ") for key in keys)]
    return _table(head, [[rank, row["factor"], *(row[key] for key in keys)] for rank, row in enumerate(rows, 1)])


def _failures(failed: Sequence[dict[str, Any]]) -> str:
    if not failed:
        return ""
    rows = [[row["trial"], row["seed"], row["message"]] for row in failed[:_MOST_FAILURES]]
    more = f"<p class='note'>and {len(failed) - len(rows)} more</p>" if len(failed) > len(rows) else ""
    return f"<h2 class='bad'>{len(failed)} trials failed</h2>{_table(['trial', 'seed', 'message'], rows)}{more}"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    top = "".join(f"<th>{escape(title)}</th>" for title in head)
    body = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    return f"<td class='n'>{_number(value)}</td>"


def _number(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, list | tuple):
        return " … ".join(map(_number, value))
    if isinstance(value, int) or abs(value) >= 1e4:
        return f"{value:.0f}"
    return f"{value:.4g}"
