"""`documentation/index.html`: what the FMU is, how to use it, and every variable, from its model description."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from typing import Any

from scancell.cell.fmu_info import group_of, unit_of
from scancell.cell.fmu_package.bundle import Bundle
from scancell.cell.fmu_package.reference import FOLDER, INPUTS, OUTPUTS, Reference

# What the groups of variables are, by the first part of their names; a group that is not here has no sentence.
_GROUPS = {
    "command": "Inputs: what the cell is told to do. All of them are discrete.",
    "measured": "What the encoders and drives say, with their resolution, noise and latency.",
    "truth": "What is really the case in the simulated world. A real cell would not know it.",
    "trigger": "The record of one exposure of the sensor: what was measured in its middle, and what was true.",
    "controller": "What the robot controller says about itself.",
    "gripper": "The gripper.",
    "conveyor": "The conveyor belts.",
    "presence": "Presence sensors: whether something is in a sensitive volume.",
    "distance": "Distance sensors: the length of a light ray.",
    "collision": "Contacts that should not be, and the smallest distance between bodies.",
    "as_built": "Parameters: how the cell as built differs from its description. All zero: as described.",
    "cell": "Parameters of the cell.",
}
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;color:#1c2733}
h1,h2{line-height:1.2} h2{margin-top:2.2rem;border-bottom:1px solid #cfd8e3;padding-bottom:.2rem}
table{border-collapse:collapse;width:100%;font-size:.87rem}
td,th{text-align:left;vertical-align:top;padding:.2rem .5rem}
th{background:#eef2f7;position:sticky;top:0} tr:nth-child(even) td{background:#f7f9fc}
code{font:.95em ui-monospace,monospace}
input{width:100%;padding:.4rem;font:inherit;margin:.5rem 0} nav a{margin-right:.8rem}
"""
_FILTER = """
document.getElementById("filter").addEventListener("input", event => {
  const words = event.target.value.toLowerCase().split(/\\s+/);
  for (const row of document.querySelectorAll("table.variables tbody tr"))
    row.hidden = !words.every(word => row.textContent.toLowerCase().includes(word));
});
"""


def index_page(description: Any, bundle: Bundle, reference: Reference) -> str:
    """The page; it needs no network.

    Parameters
    ----------
    description
        Model description as FMPy reads it.
    """
    groups = _by_group(description.modelVariables)
    links = " ".join(f'<a href="#{escape(name)}">{escape(name)}</a>' for name in groups)
    sections = [
        f"<h1>{escape(description.modelName)}</h1><p>{escape(description.description)}</p>",
        _facts(description, bundle),
        _usage(description),
        _limits(bundle),
        _reference(reference),
        f"<h2>Variables</h2><nav>{links}</nav>"
        '<input id="filter" type="search" placeholder="show variables with these words" aria-label="filter">',
        *(_group(name, variables, description) for name, variables in groups.items()),
        _units(description),
        _categories(description),
        _licenses(bundle),
    ]
    head = f'<meta charset="utf-8"><title>{escape(description.modelName)}</title><style>{_STYLE}</style>'
    body = "\n".join(sections)
    page = f'<html lang="en"><head>{head}</head>\n<body>{body}\n<script>{_FILTER}</script></body></html>'
    return f"<!DOCTYPE html>\n{page}\n"


def _by_group(variables: Iterable[Any]) -> dict[str, list[Any]]:
    groups: dict[str, list[Any]] = {}
    for variable in variables:
        groups.setdefault(group_of(variable.name), []).append(variable)
    return groups


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """`rows` hold HTML."""
    cells = "".join(f"<th>{escape(text)}</th>" for text in heads)
    head = f"<thead><tr>{cells}</tr></thead>" if cells else ""
    lines = "\n".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<table class="{kind}">{head}<tbody>\n{lines}\n</tbody></table>'


def _list(items: Iterable[str]) -> str:
    """`items` hold HTML."""
    return "<ul>" + "".join(f"<li>{item}</li>" for item in items) + "</ul>"


def _facts(description: Any, bundle: Bundle) -> str:
    step = float(description.defaultExperiment.stepSize)
    rows = [
        ("FMI version", f"{description.fmiVersion}, Co-Simulation"),
        ("made by", description.generationTool),
        ("token", description.guid),
        ("licence", f"{description.license}; of what is bundled: see the end"),
        ("machine", f"64-bit x86 Linux with glibc {bundle.glibc} or later"),
        ("variables", str(len(description.modelVariables))),
        ("communication step", f"any; {step * 1e3:g} ms by default, the cycle of the controller"),
    ]
    return _table([], ((escape(a), escape(b)) for a, b in rows))


def _usage(description: Any) -> str:
    items = [
        "Set parameters before the end of initialization. <code>cell.file</code> may name another description of "
        "a cell of the same make-up, so that another part needs no other FMU.",
        "Set inputs at communication points. The controller takes them at its next cycle; no output depends on an "
        "input at the same instant.",
        "Take any communication step, also one that changes: the dynamics and the controller run on their own clocks "
        "inside, and parts of a step are carried.",
        "Read exposures from <code>trigger.*</code>: a communication step displays the next finished record, and those "
        "that wait are counted by <code>trigger.queued</code>. None is lost.",
        "Save and restore the state at any time, also as bytes and in another process.",
        "Run several instances at once, also in parallel threads.",
        "A call that breaks the rules returns Error and logs why; the instance can then be reset, or a state restored.",
    ]
    if not description.fmiVersion.startswith("2"):
        items.append(
            "With event mode and early return, a step ends where the record of an exposure is ready; the clock "
            "<code>trigger.clock</code>, where this FMU describes it, ticks. With an intermediate update the outputs "
            "can be read at every cycle of the controller inside a step."
        )
    return "<h2>Use</h2>" + _list(items)


def _limits(bundle: Bundle) -> str:
    items = [
        "Co-Simulation alone: no Model Exchange, no Scheduled Execution, no directional derivatives, no derivatives "
        "of inputs or outputs.",
        "Times are whole microseconds inside; the parts below are carried from step to step. Times stay under "
        "10<sup>9</sup> s.",
        "Values that are not finite are rejected. A Real input out of its range is clamped, with a warning.",
        "A state belongs to one cell description and one layout of states; an FMU with another layout rejects it.",
        "Needed from the machine: " + "; ".join(escape(line) for line in bundle.dependencies()) + ".",
    ]
    return "<h2>Limits</h2>" + _list(items)


def _reference(reference: Reference) -> str:
    return (
        "<h2>Reference trajectory</h2><p>This FMU itself made it when it was packed. Set the inputs of each row of "
        f"<code>{FOLDER}/{INPUTS}</code> at its time (all joints, the table and the trigger), step "
        f"{reference.step_s * 1e3:g} ms, and compare with the next row of <code>{FOLDER}/{OUTPUTS}</code>; "
        f"the first row is the state after initialization. {len(reference.outputs)} rows, "
        f"{len(reference.output_names)} outputs. The files are listed as the layered standard "
        "<code>org.fmi-standard.fmi-ls-ref</code> describes it.</p>"
    )


def _group(name: str, variables: list[Any], description: Any) -> str:
    depends = {u.variable.name: [d.name for d in u.dependencies or ()] for u in description.initialUnknowns or ()}
    rows = []
    for variable in variables:
        unit, display = unit_of(variable)
        bounds = f"{variable.min} … {variable.max}" if variable.min is not None else ""
        size = "".join(f"[{dimension.start}]" for dimension in variable.dimensions)
        on = depends.get(variable.name, [])
        rows.append(
            [
                f"<code>{escape(variable.name)}</code>",
                escape(f"{variable.type}{size}"),
                escape(f"{variable.variability or ''} {variable.causality}"),
                escape(unit) + (f" ({escape(display)})" if display else ""),
                escape(variable.start or ""),
                escape(bounds),
                escape(variable.description or "")
                + (f"<br><small>at first depends on {escape(_short(on))}</small>" if on else ""),
            ]
        )
    heads = ["name", "type", "kind", "unit (shown in)", "start", "range", "meaning"]
    return f'<h3 id="{escape(name)}">{escape(name)}</h3><p>{escape(_GROUPS.get(name, ""))}</p>' + _table(
        heads, rows, "variables"
    )


def _short(names: list[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _units(description: Any) -> str:
    rows = [
        (escape(unit.name), escape(display.name), f"{display.factor:.10g}")
        for unit in description.unitDefinitions
        for display in unit.displayUnits
    ]
    return "<h2>Units</h2>" + _table(["unit", "shown in", "factor"], rows)


def _categories(description: Any) -> str:
    rows = [(f"<code>{escape(c.name)}</code>", escape(c.description)) for c in description.logCategories]
    return "<h2>Messages</h2>" + _table(["category", "meaning"], rows)


def _licenses(bundle: Bundle) -> str:
    rows = [
        (
            f"<code>{escape(part.file)}</code>",
            escape(part.source),
            escape(part.license),
            f'<a href="licenses/{escape(part.text)}">{escape(part.text)}</a>',
        )
        for part in bundle.components
    ]
    return "<h2>Licences</h2>" + _table(["file", "from", "licence", "text"], rows)
