"""Generated pages: commands, Python, keys of the descriptions, variables of the FMU, columns of clouds."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import typer

import scancell
from scancell.cell.fmu_info import FmuVariable, describe_fmu, group_of
from scancell.cli.common import GROUPS, app
from scancell.nominal.cell import nominal_cell

_FOLDER = "docs/reference"


def reference_pages(root: Path) -> dict[str, str]:
    """Texts of the generated pages by the name of their files, in the order of the site."""
    pages = {"commands.md": commands()}
    for name, text in python_pages(root / "orchestrator" / "scancell" / "__init__.pyi").items():
        pages[f"python_{name}.rst"] = text
    for path in sorted((root / "docs" / "schemas").glob("*.schema.json")):
        kind = path.name.split(".")[0]
        pages[f"keys_{kind}.md"] = keys(kind, json.loads(path.read_text(encoding="utf-8")))
    pages["fmu_variables.md"] = fmu_variables()
    return {f"{_FOLDER}/{name}": text for name, text in pages.items()}


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [
        head,
        ["---"] * len(head),
        *([cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows),
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _code(text: str) -> str:
    return f"`{text}`" if text else ""


# Commands


def all_commands() -> dict[str, Any]:
    """Commands by their words, such as ``fmu build``, in the order of the help."""
    root: Any = typer.main.get_command(app)
    found = {}
    for name in (name for names in GROUPS.values() for name in names):
        command = root.commands[name]
        inner = getattr(command, "commands", None)
        found.update({name: command} if inner is None else {f"{name} {last}": one for last, one in inner.items()})
        if inner is not None and getattr(command, "invoke_without_command", False):
            found[name] = command
    return found


def commands() -> str:
    """Page of all commands with their arguments and options, from the parsers."""
    sections = [
        "# Commands\n",
        "`scancell COMMAND --help` prints the same. `--json` prints one JSON object as the last line.\n",
    ]
    for name, command in all_commands().items():
        context = command.context_class(command, info_name=f"scancell {name}")
        usage = " ".join(command.collect_usage_pieces(context))
        sections.append(f"## scancell {name}\n\n{command.help}\n\n```console\nscancell {name} {usage}\n```\n")
        records = [item.get_help_record(context) for item in command.get_params(context)]
        rows = [(_code(record[0]), record[1]) for record in records if record is not None]
        sections.append(_table(["argument or option", "meaning"], rows))
    return "\n".join(sections)


# Python


def subjects(stub: Path) -> dict[str, list[str]]:
    """Public names by the comments of the file that lists them."""
    found: dict[str, list[str]] = {}
    for line in stub.read_text(encoding="utf-8").splitlines():
        if line.startswith("# "):
            found[line[2:]] = []
        elif match := re.match(r"from \S+ import \w+ as (\w+)", line):
            found[next(reversed(found))].append(match[1])
    return found


def python_pages(stub: Path) -> dict[str, str]:
    """Pages of the public names, one for each subject, from the docstrings."""
    pages = {}
    for subject, names in subjects(stub).items():
        title = f"Python: {subject[0].lower()}{subject[1:]}"
        parts = [f"{title}\n{'=' * len(title)}\n", ".. currentmodule:: scancell\n", *map(_documented, names)]
        pages[re.sub(r"\W+", "_", subject.lower()).strip("_")] = "\n".join(parts)
    return pages


def _documented(name: str) -> str:
    """Directive of autodoc for a public name."""
    item = getattr(scancell, name)
    members = "   :members:\n"
    if isinstance(item, type):
        return f".. autoclass:: scancell.{name}\n{members}   :exclude-members: model_config, model_post_init\n"
    if isinstance(item, ModuleType):
        return f".. automodule:: {item.__name__}\n{members}"
    return f".. auto{'function' if callable(item) else 'data'}:: scancell.{name}\n"


# Keys of the descriptions


def keys(kind: str, schema: Mapping[str, Any]) -> str:
    """Page of the keys of one kind of description, from its JSON Schema."""
    parts = [
        f"# Keys of a {kind} file\n",
        f"JSON Schema: `docs/schemas/{kind}.schema.json`.\n",
        f"{schema['description']}\n",
    ]
    parts.append(_keys(kind, schema))
    for name, definition in sorted(schema["$defs"].items()):
        parts.append(f"## {name}\n\n{definition.get('description', '')}\n")
        parts.append(_keys(kind, definition) if "properties" in definition else _code(_type(kind, definition)) + "\n")
    return "\n".join(parts)


def _keys(kind: str, definition: Mapping[str, Any]) -> str:
    required = definition.get("required", [])
    rows = [
        (_code(key), _type(kind, item), "required" if key in required else _default(item), item.get("description", ""))
        for key, item in definition.get("properties", {}).items()
    ]
    return _table(["key", "type and bounds", "default", "meaning"], rows)


_BOUNDS = {"minimum": "≥", "maximum": "≤", "exclusiveMinimum": ">", "exclusiveMaximum": "<", "minLength": "length ≥"}


def _type(kind: str, item: Mapping[str, Any]) -> str:
    """Type of a key, with links to the tables of other types, and its bounds."""
    if "$ref" in item:
        name = item["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    choices = item.get("anyOf") or item.get("oneOf")
    if choices:
        return " or ".join(_type(kind, one) for one in choices if one.get("type") != "null")
    if "const" in item:
        return _code(json.dumps(item["const"]))
    if "enum" in item:
        return ", ".join(_code(json.dumps(value)) for value in item["enum"])
    bounds = [f"{sign} {item[key]:g}" for key, sign in _BOUNDS.items() if key in item]
    if "pattern" in item:
        bounds.append(_code(item["pattern"]))
    return " ".join([*_container(kind, item), *bounds])


def _container(kind: str, item: Mapping[str, Any]) -> Iterator[str]:
    if item.get("type") == "array":
        inside = item.get("items") or {"type": "value"}
        size = item.get("minItems"), item.get("maxItems")
        number = f" of {size[0]}" if size[0] is not None and size[0] == size[1] else ""
        yield f"list{number}: {_type(kind, inside)}"
    elif isinstance(item.get("additionalProperties"), Mapping):
        yield f"table: {_type(kind, item['additionalProperties'])}"
    else:
        yield str(item.get("type", "any"))


def _default(item: Mapping[str, Any]) -> str:
    if "default" not in item or item["default"] is None:
        return ""
    text = json.dumps(item["default"], ensure_ascii=False)
    return _code(text) if len(text) <= 40 else "see its table"


# Variables of the FMU


def fmu_variables() -> str:
    """Page of the variables of the FMU of a cell with every device, from its model description."""
    assets = scancell.assets_dir()
    cell = scancell.load_setup(assets / "cells" / "pick_and_place.toml").cell.replace(
        {
            "distance_sensor": [{"name": "height", "pose": {"z_mm": 400.0}, "farthest_mm": 500.0}],
            "light_curtain": [
                {"name": "gate", "pose": {}, "width_mm": 600.0, "height_mm": 800.0, "beam_spacing_mm": 30.0}
            ],
            "further_part": [
                {"name": "box", "mesh": str(assets / "parts" / "step_block.stl"), "stands_on": "conveyor[1]"}
            ],
        }
    )
    part = scancell.load_part(assets / "parts" / "step_block.stl")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "RobotCell3.fmu")
        scancell.build_fmu(scancell.cell_json(cell, nominal_cell(cell, part), 0), path, 3)
        variables = describe_fmu(path).variables
    parts = ["# Variables of the FMU\n", _ABOUT_VARIABLES]
    for causality in ("parameter", "input", "output"):
        own = [variable for variable in variables if variable.causality == causality]
        for group in dict.fromkeys(group_of(variable.name) for variable in own):
            parts.append(f"## {causality.capitalize()}s `{group}`\n")
            parts.append(_variables(variable for variable in own if group_of(variable.name) == group))
    return "\n".join(parts)


_ABOUT_VARIABLES = """A cell has the variables of its devices. This page lists those of a cell with six joints and at
least one device of each kind; a row with two names contains one variable for each index. `scancell fmu info FILE` lists
the variables of your FMU. [The arm](../fmu/arm.md), [contact](../fmu/contact.md) and
[sensors](../fmu/sensing.md) describe what they do.
"""


def _variables(variables: Iterable[FmuVariable]) -> str:
    """Table of variables; those that differ in one index only share a row."""
    rows: dict[tuple[str, ...], list[FmuVariable]] = {}
    for variable in variables:
        pattern = re.sub(r"\[\d+\]", "[]", variable.name)
        meaning = re.sub(r"\d+", "", variable.description)
        rows.setdefault((pattern, variable.unit, meaning), []).append(variable)
    cells = []
    for same in rows.values():
        first, last = same[0], same[-1]
        name = _code(first.name) if first is last else f"{_code(first.name)} … {_code(last.name)}"
        starts = dict.fromkeys(variable.start for variable in same)
        start = _short(first.start) if len(starts) == 1 else "each its own"
        cells.append((name, first.type, first.unit, start, first.description))
    return _table(["variable", "type", "unit", "start", "meaning"], cells)


def _short(start: str) -> str:
    """A start value with at most six digits."""
    try:
        return f"{float(start):g}"
    except ValueError:
        return start
