"""The report of an acceptance test as one self-contained HTML file (template: templates/acceptance.html.j2)."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from scancell.output.sheet import EDGE, INK
from scancell.output.web_page import format_figure
from scancell.studies.acceptance.measure import RATES, REPEATABILITY, unit_text
from scancell.studies.page import BLUE, ORANGE, rendered, svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TITLES = {
    "sphere": ("Sphere: probing", ("probing form, 95 % of the points", "probing size", "D95 %")),
    "ball_bar": ("Ball bar: sphere spacing", ("sphere spacing", "probing form, 95 % of the points")),
    "plane": ("Plane: flatness", ("flatness, 95 % of the points", "flatness", "bias")),
    "step": ("Step artefact: length", ("step height",)),
    "cylinder": ("Cylinder: form and size", ("form, 95 % of the points", "diameter")),
    "cone": ("Cone: form and angle", ("form, 95 % of the points", "cone angle")),
}
_ANSWERED = ("probing form, 95 % of the points", "probing size", "sphere spacing", "flatness", "step height")
_STATISTICS = {
    "mean": "mean",
    "standard_uncertainty": "std. uncertainty",
    "interval_symmetric": "95 % interval",
}
_DETAILS = {**_STATISTICS, "interval_shortest": "shortest interval"}
_COLOURS = (BLUE, ORANGE)
_SHIFT = 0.12  # between the marks of the two modes
_MOST_FACES = 6  # with a line of their own


def acceptance_page(figures: Mapping[str, Any], pictures: Mapping[str, bytes], failures: Sequence[str]) -> str:
    """HTML of the whole report.

    Parameters
    ----------
    figures
        Content of ``acceptance.json``.
    pictures
        PNG of the deviation of each artefact.
    """
    budgets_head, budgets = _budgets([found for found in figures["contributions"] if _is_shown(found)])
    drawn = {"as built": figures["as_built"], "factors drawn for each repeat": figures["factors"]}
    return rendered(
        "acceptance.html.j2",
        title=f"Acceptance test of {figures['sensor']}",
        facts=_facts(figures),
        what=figures["what"],
        answer=_answer(figures, failures),
        limits=[_limit(found) for found in figures["limits"]],
        few=figures["programme"]["repeats"] < 11,
        failures=failures,
        largest_head=["artefact", "characteristic", "of", "position", "mode", "unit", *_STATISTICS.values()],
        largest=[
            [row["artefact"].replace("_", " "), row["name"], row["of"], row["position"], row["mode"], unit_text(row)]
            + [row[key] for key in _STATISTICS]
            for row in figures["largest"]
            if _is_shown(row)
        ],
        rates=_rates(figures["figures"]),
        artefacts=[
            _artefact(name, figures, pictures) for name in dict.fromkeys(row["artefact"] for row in figures["figures"])
        ],
        sweeps=[(found["name"], _sweep_plot(found)) for found in figures["sweeps"]],
        linearity=figures["linearity_percent"],
        budgets_head=budgets_head,
        budgets=budgets,
        about=[
            ["engine", figures["engine"]],
            ["seed", str(figures["seed"])],
            *([name, ", ".join(words)] for name, words in drawn.items() if words),
        ],
    )


def _answer(figures: Mapping[str, Any], failures: Sequence[str]) -> str:
    """One sentence: how many limits are met, and what was not measured; without limits the largest errors."""
    limits = figures["limits"]
    items = f"{len(failures)} item was" if len(failures) == 1 else f"{len(failures)} items were"
    missing = f"; {items} not measured" if failures else "; everything was measured"
    if not limits:
        shown = [row for row in figures["largest"] if row["name"] in _ANSWERED]
        worst = {row["name"]: row for row in sorted(shown, key=lambda row: abs(row["mean"]))}
        errors = [f"{name} {format_figure(abs(row['mean']))} {unit_text(row)}" for name, row in worst.items()]
        return f"No limits are stated; largest errors: {', '.join(errors) or 'none'}{missing}."
    states = [found["met"] for found in limits]
    failed = [found["name"] for found in limits if found["met"] is False]
    unknown = [found["name"] for found in limits if found["met"] is None]
    words = [f"{states.count(True)} of {len(states)} limits are met"]
    words += [f"not met: {', '.join(failed)}"] if failed else []
    words += [f"not measured: {', '.join(unknown)}"] if unknown else []
    return f"{'; '.join(words)}{missing}."


def _limit(found: Mapping[str, Any]) -> list[Any]:
    """State, figure, limit, largest error with its interval, and where."""
    if found["met"] is None:
        return ["not measured", found["name"], found["limit"], "", "", "no artefact gave this figure: see the reasons"]
    state = ("met" if found["met"] else "not met") + ("" if found["clear"] else " (interval contains the limit)")
    where = f"{found['artefact'].replace('_', ' ')}, {found['of']}, {found['position']}, {found['mode']}"
    return [state, f"{found['name']}, {unit_text(found)}", found["limit"], found["largest"], found["interval"], where]


def _facts(figures: Mapping[str, Any]) -> str:
    near, far = figures["range_mm"]
    programme = figures["programme"]
    size = "" if figures["artefact_scale"] == 1.0 else f", artefacts {figures['artefact_scale']:.3g} times their size"
    return (
        f"measuring range {near:g} to {far:g} mm, cell {figures['cell']}, {figures['engine']} engine, "
        f"{programme['repeats']} repeats{size}"
    )


def _rates(rows: Sequence[Mapping[str, Any]]) -> list[list[Any]]:
    """Artefact, position, mode, outlier and missing-point rate in %."""
    places: dict[tuple[str, str, str], dict[str, float]] = {}
    for row in rows:
        if row["name"] in RATES:
            place = (row["artefact"].replace("_", " "), row["position"], row["mode"])
            places.setdefault(place, {})[row["name"]] = row["mean"]
    return [[*place, *(rates[name] for name in RATES)] for place, rates in places.items()]


def _artefact(name: str, figures: Mapping[str, Any], pictures: Mapping[str, bytes]) -> dict[str, Any]:
    rows = [row for row in figures["figures"] if row["artefact"] == name and row["name"] not in RATES]
    title, shown = _TITLES.get(name, (name, ()))
    drawings = []
    for characteristic in shown:
        own = [row for row in rows if row["name"] == characteristic]
        if own:
            drawings.append(_plot_over_positions(own, characteristic))
    table = [
        [
            *(row["of"], row["name"], row["position"], round(row["standoff_mm"], 1), row["mode"]),
            *(unit_text(row), row["repeats"], *(row[key] for key in _DETAILS)),
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
        names = [one["artefact"].replace("_", " "), one["name"], unit_text(one)]
        rows.append([*names, size, *(shares.get(factor) for factor in ordered)])
    return ["artefact", "characteristic", "unit", "std. deviation", *(f"{name}, %" for name in ordered)], rows


def _plot_over_positions(rows: Sequence[dict[str, Any]], name: str) -> str:
    """Mean errors with their 95 % intervals, or twice their standard uncertainty, by position; a colour per mode."""
    positions = list(dict.fromkeys(row["position"] for row in rows))
    modes = list(dict.fromkeys(row["mode"] for row in rows))
    faces = list(dict.fromkeys(row["of"] for row in rows))

    def draw(axes: Axes) -> None:
        for m, mode in enumerate(modes):
            for f, face in enumerate(faces[:_MOST_FACES]):
                own = [row for row in rows if (row["mode"], row["of"]) == (mode, face)]
                x = np.array([positions.index(row["position"]) for row in own]) + (m - (len(modes) - 1) / 2) * _SHIFT
                x = x + 0.3 * _SHIFT * (f - (min(len(faces), _MOST_FACES) - 1) / 2)
                mean, ends = np.array([row["mean"] for row in own]), np.array([_ends(row) for row in own])
                spread = np.clip(np.stack([mean - ends[:, 0], ends[:, 1] - mean]), 0.0, None)
                label = mode if f == 0 else None
                axes.errorbar(x, mean, spread, fmt="o", ms=4, capsize=3, color=_COLOURS[m % 2], label=label)
        axes.axhline(0.0, color=EDGE, linewidth=0.8)
        axes.set(xticks=range(len(positions)), xticklabels=positions, ylabel=unit_text(rows[0]))
        axes.set_xlim(-0.5, len(positions) - 0.5)
        axes.set_title(name, fontsize=10, loc="left")
        axes.legend()

    return svg(5.0, 2.8, 1, draw)


def _ends(row: dict[str, Any]) -> tuple[float, float]:
    if row["interval_symmetric"]:
        low, high = row["interval_symmetric"]
        return low, high
    half = 2.0 * (row["standard_uncertainty"] or 0.0)
    return row["mean"] - half, row["mean"] + half


def _sweep_plot(found: dict[str, Any]) -> str:
    """Bias with the standard deviation of points as a band, and shares of outliers and missing points."""
    value, bias, std, outliers, missing = (
        np.array([np.nan if row[key] is None else row[key] for row in found["rows"]], float)
        for key in ("value", "bias_um", "std_um", "outlier_rate", "missing_rate")
    )
    scale = "log" if found["name"] == "reflectance" else "linear"
    label = found["name"] if found["unit"] == "1" else f"{found['name']} ({found['unit']})"

    def draw(left: Axes, right: Axes) -> None:
        left.fill_between(value, bias - std, bias + std, color=BLUE, alpha=0.25, linewidth=0, label="± std of points")
        left.plot(value, bias, "o-", ms=3, color=BLUE, label="bias")
        left.axhline(0.0, color=EDGE, linewidth=0.8)
        left.set(xlabel=label, ylabel="µm", xscale=scale)
        left.legend()
        right.plot(value, 100 * missing, "o-", ms=3, color=ORANGE, label="missing points")
        right.plot(value, 100 * outliers, "s--", ms=3, color=INK, label="outliers")
        right.set(xlabel=label, ylabel="%", xscale=scale)
        right.set_ylim(bottom=0.0, top=max(1.0, 110 * float(np.nanmax(np.append(missing, outliers)))))
        right.legend()

    return svg(8.4, 2.7, 2, draw)
