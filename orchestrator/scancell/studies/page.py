"""The report of a study as one self-contained HTML file (template: templates/study.html.j2), and its plots as SVG."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scancell.arrays import Array
from scancell.errors import require
from scancell.output.sheet import COLOURS, EDGE, INK
from scancell.output.web_page import STYLE, format_figure, table
from scancell.studies.analysis import Rows, independent_rows

require("matplotlib", "studies")
from matplotlib import style  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

_TEMPLATES = Path(__file__).parent / "templates"
_MAX_LISTED = 50
_MAX_SCATTERED = 4
_MAX_NAMED = 3  # factors in an answer
_RANDOM = {"monte_carlo", "latin_hypercube", "sobol"}
_UNEXPLAINED = {
    True: "unexplained (noise, higher-order effects)",
    False: "unexplained (noise, interactions)",
}
BLUE, ORANGE = COLOURS[:2]
_MAX_POINTS = 1500


def study_page(analysis: dict[str, Any], rows: Sequence[dict[str, Any]], about: dict[str, str]) -> str:
    """HTML of the whole report; `about` has versions and sources."""
    kind, count = analysis["design"]["kind"].replace("_", " "), len(analysis["factors"])
    subtitle = f"{kind} design, {count} factors, {analysis['trials']} trials"
    failed = [[row["trial"], str(row["seed"]), row["message"]] for row in analysis["failed"]]
    return rendered(
        "study.html.j2",
        title=analysis["name"],
        subtitle=subtitle + (f", {len(failed)} of them failed" if failed else ""),
        notes=analysis["notes"],
        answers=study_answers(analysis),
        engines=[_engine(name, found, rows, analysis) for name, found in analysis["engines"].items()],
        failed=failed[:_MAX_LISTED],
        failed_count=len(failed),
        about=list(about.items()),
    )


def study_answers(analysis: dict[str, Any]) -> list[list[str]]:
    """Rows of the first table: engine, figure, its mean and spread, and which factors matter and how much."""
    several = len(analysis["engines"]) > 1
    return [
        [
            f"{name} ({engine})" if several else name,
            _spread(found["figures"][name]),
            _most_important(part, analysis["probability"]),
        ]
        for engine, found in analysis["engines"].items()
        for name, part in found["sensitivity"].items()
    ]


def _spread(statistics: dict[str, Any]) -> str:
    mean, std = statistics["mean"], statistics.get("standard_deviation")
    if mean is None:
        return "not measured"
    return format_figure(mean) + (f" ± {format_figure(std)}" if std is not None else "")


def _most_important(found: dict[str, Any], probability: float) -> str:
    """The factors of the largest effects with their sizes, or why there are none."""
    words = []
    if found.get("budget"):
        for row in found["budget"][:_MAX_NAMED]:
            ends = row["share_interval"]
            if row["share"] <= 0 or (ends and ends[0] <= 0):
                break
            interval = f", {probability:.0%} interval {100 * ends[0]:.0f} … {100 * ends[1]:.0f} %" if ends else ""
            size = format_figure(row["uncertainty"])
            words.append(f"{row['factor']}: {100 * row['share']:.0f} % of the variance{interval}, ± {size}")
        nothing = "no factor has a detectable share of the variance"
    elif found.get("sobol"):
        for row in sorted(found["sobol"], key=lambda row: -row["total"])[:_MAX_NAMED]:
            if row["total_interval"][0] > 0:
                words.append(f"{row['factor']}: total index {row['total']:.2f}, first order {row['first']:.2f}")
        nothing = "no factor has a detectable index"
    else:
        for row in found.get("morris", [])[:_MAX_NAMED]:
            size, error = row["mean_magnitude"], row["mean_magnitude_confidence"]
            if size > error:
                words.append(f"{row['factor']}: mean effect {format_figure(size)} ± {format_figure(error)}")
        nothing = "no factor has a detectable effect" if found.get("morris") else "this design ranks no factors"
    return "; ".join(words) or nothing


def rendered(template: str, **values: Any) -> str:
    """HTML of a template of this folder, which may use the function ``table`` and the filter ``figure``."""
    jinja2, markup = require("jinja2", "studies"), require("markupsafe", "studies").Markup
    loader = jinja2.FileSystemLoader(_TEMPLATES)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined)
    environment.filters["figure"] = format_figure
    environment.globals["table"] = lambda *given: markup(table(*given))
    return str(environment.get_template(template).render(style=STYLE.read_text(encoding="utf-8"), **values))


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
        "figures": [
            [figure, *(statistics[key] for key in columns.values())] for figure, statistics in found["figures"].items()
        ],
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
        drawings.append(_distribution_plot(values[drawn], statistics, name))
        drawings.append(_convergence_plot(found["convergence"], name))
    drawings.extend(_contributions(name, found, analysis["probability"]))
    ranked = found.get("budget") or found.get("morris") or []
    chosen = [row["factor"] for row in ranked][:_MAX_SCATTERED] or analysis["factors"][:_MAX_SCATTERED]
    positions = [analysis["factors"].index(label) for label in chosen]
    columns = [[row["values"][j] for row, ok in zip(own.plain, good, strict=True) if ok] for j in positions]
    drawings.append(_scatter_plots(chosen, columns, values[good], name))
    head, rows = _budget_table(ranked, found)
    return {
        "name": name,
        "explained": found.get("explained"),
        "predicted": found.get("predicted"),
        "regression": found.get("regression"),
        "drawings": drawings,
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
        yield _bar_plot([r["factor"] for r in rows], series, f"Sobol' index of {name}, {probability:.0%} confidence")
    if found.get("morris"):
        yield _effects_plot(found["morris"], name)
    if found.get("budget"):
        rows = found["budget"]
        ends = np.array([r["share_interval"] for r in rows]) if rows[0]["share_interval"] else None
        shares = {"share": (np.array([r["share"] for r in rows]), ends)}
        yield _bar_plot([r["factor"] for r in rows], shares, f"share of the variance of {name}")


def _budget_table(ranked: Sequence[dict[str, Any]], found: dict[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Head and rows: the factors by rank and, last, the unexplained share."""
    if not ranked:
        return [], []
    keys = [key for key in ranked[0] if key != "factor"]
    rows = [[rank, row["factor"], *(row[key] for key in keys)] for rank, row in enumerate(ranked, 1)]
    if "unexplained" in found:
        label = _UNEXPLAINED["interactions" in found["regression"]]
        rows.append([None, label, *(found["residual"][key] for key in keys)])
    return ["rank", "factor", *(key.replace("_", " ") for key in keys)], rows


def svg(width: float, height: float, columns: int, draw: Any) -> str:
    """SVG text of a row of axes, of a size in inches, on which `draw` draws."""
    with style.context("scancell.plots"):
        figure = Figure(figsize=(width, height))
        draw(*np.atleast_1d(figure.subplots(1, columns)))
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None}, transparent=True)
    text = stream.getvalue()
    return text[text.index("<svg") :]


def _distribution_plot(sample: Array, statistics: dict[str, Any], label: str) -> str:
    """Histogram of a figure with its mean and both coverage intervals."""

    def draw(axes: Axes) -> None:
        axes.hist(sample, bins="auto" if len(sample) > 30 else 10, color=BLUE, alpha=0.75)
        axes.axvline(statistics["mean"], color=INK, linewidth=1.5, label="mean")
        for name, colour, line in (("symmetric", ORANGE, "-"), ("shortest", INK, ":")):
            ends = statistics[f"interval_{name}"]
            for k, end in enumerate(ends or ()):
                axes.axvline(end, color=colour, linestyle=line, label=f"{name} interval" if k == 0 else None)
        axes.set(xlabel=label, ylabel="trials")
        axes.legend()

    return svg(5.2, 2.8, 1, draw)


def _convergence_plot(rows: Sequence[dict[str, float]], label: str) -> str:
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
        axes.legend()

    return svg(5.2, 2.8, 1, draw)


def _bar_plot(names: Sequence[str], series: Mapping[str, tuple[Array, Array | None]], label: str) -> str:
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
        axes.axvline(0, color=EDGE, linewidth=0.8)
        if len(series) > 1:
            axes.legend()

    return svg(6.4, 0.9 + 0.32 * len(names) * max(1, len(series) * 0.7), 1, draw)


def _effects_plot(rows: Sequence[dict[str, Any]], label: str) -> str:
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


def _scatter_plots(names: Sequence[str], values: Sequence[Sequence[Any]], outputs: Array, label: str) -> str:
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
