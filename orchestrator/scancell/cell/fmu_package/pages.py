"""`documentation/index.html` (template: index.html): what the FMU is, how to use it, and every variable."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from scancell.cell.fmu_info import group_of, unit_of
from scancell.cell.fmu_package.bundle import Bundle
from scancell.cell.fmu_package.reference import FOLDER, INPUTS, OUTPUTS, Reference

_TEMPLATE = Path(__file__).with_name("index.html")
# Descriptions of the groups of variables, by the first part of their names; other groups have none.
_GROUPS = {
    "command": "Inputs: commands to the cell. All of them are discrete.",
    "measured": "Measurements of encoders and drives, with their resolution, noise and latency.",
    "truth": "True values of the simulated world, which a real cell does not know.",
    "trigger": "The record of one exposure of the sensor: what was measured in its middle, and what was true.",
    "controller": "State of the robot controller.",
    "gripper": "The gripper.",
    "conveyor": "The conveyor belts.",
    "presence": "Presence sensors: whether something is in a sensitive volume.",
    "distance": "Distance sensors: the length of a light ray.",
    "collision": "Unintended contacts, and the smallest distance between bodies.",
    "as_built": "Parameters: how the cell as built differs from its description. All zero: as described.",
    "cell": "Parameters of the cell.",
}
_EVENTS = """<li>With event mode and early return, a step ends where the record of an exposure is ready; the clock
<code>trigger.clock</code>, where this FMU describes it, ticks. With an intermediate update the outputs can be read at
every cycle of the controller inside a step.</li>"""


def index_page(description: Any, bundle: Bundle, reference: Reference) -> str:
    """The page; it needs no network.

    Parameters
    ----------
    description
        Model description as FMPy reads it.
    """
    groups: dict[str, list[Any]] = {}
    for variable in description.modelVariables:
        groups.setdefault(group_of(variable.name), []).append(variable)
    units = [
        (escape(unit.name), escape(display.name), f"{display.factor:.10g}")
        for unit in description.unitDefinitions
        for display in unit.displayUnits
    ]
    messages = [(_code(category.name), escape(category.description)) for category in description.logCategories]
    licenses = [
        (_code(part.file), escape(part.source), escape(part.license), f'<a href="licenses/{text}">{text}</a>')
        for part in bundle.components
        for text in [escape(part.text)]
    ]
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        name=escape(description.modelName),
        description=escape(description.description),
        facts=_facts(description, bundle),
        events="" if description.fmiVersion.startswith("2") else _EVENTS,
        dependencies="; ".join(map(escape, bundle.dependencies())),
        inputs=f"{FOLDER}/{INPUTS}",
        outputs=f"{FOLDER}/{OUTPUTS}",
        step_ms=f"{reference.step_s * 1e3:g}",
        rows=len(reference.outputs),
        columns=len(reference.output_names),
        links=" ".join(f'<a href="#{escape(name)}">{escape(name)}</a>' for name in groups),
        variables="\n".join(_group(name, variables, description) for name, variables in groups.items()),
        units=_table(["unit", "shown in", "factor"], units),
        messages=_table(["category", "meaning"], messages),
        licenses=_table(["file", "from", "licence", "text"], licenses),
    )


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """`rows` hold HTML."""
    cells = "".join(f"<th>{escape(text)}</th>" for text in heads)
    head = f"<thead><tr>{cells}</tr></thead>" if cells else ""
    lines = "\n".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<table class="{kind}">{head}<tbody>\n{lines}\n</tbody></table>'


def _code(text: str) -> str:
    return f"<code>{escape(text)}</code>"


def _facts(description: Any, bundle: Bundle) -> str:
    step = float(description.defaultExperiment.stepSize)
    rows = [
        ("FMI version", f"{description.fmiVersion}, Co-Simulation"),
        ("made by", description.generationTool),
        ("token", description.guid),
        ("licence", f"{description.license}; of bundled components: see the end"),
        ("machine", bundle.machine),
        ("variables", str(len(description.modelVariables))),
        ("communication step", f"any; {step * 1e3:g} ms by default, the cycle of the controller"),
    ]
    return _table([], ((escape(a), escape(b)) for a, b in rows))


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
                _code(variable.name),
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
    title = f'<h3 id="{escape(name)}">{escape(name)}</h3><p>{escape(_GROUPS.get(name, ""))}</p>'
    return title + _table(heads, rows, "variables")


def _short(names: list[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
