"""What decides the results in a folder, kept beside them, so that nobody goes on with another question there.

A newer version may know keys that the folder was begun without. Its results go on counting where every key that both
know has the same value and every new one is at its default; finished tasks are told by the words in the folder.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from orchestrator.config.description import Description
from orchestrator.errors import DescriptionError
from orchestrator.evaluation.manifest import versions
from orchestrator.files import atomic_write

DESCRIPTION = "description.json"
_VERSIONS = "versions"
_TOLD = 5


@dataclass
class Comparison:
    """How what is asked for now compares with what the results in a folder were made for.

    `differences` forbid going on, for people; `new_keys` are at their defaults; `versions` says of each package that is
    another one now which it was and is.
    """

    record: Path
    differences: list[str] = field(default_factory=list)
    new_keys: list[str] = field(default_factory=list)
    versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    def __str__(self) -> str:
        more = len(self.differences) - _TOLD
        return "; ".join(self.differences[:_TOLD]) + (f"; and {more} more" if more > 0 else "")

    @property
    def warnings(self) -> list[str]:
        """What a person should know who goes on."""
        said = []
        if self.new_keys:
            said.append(f"{self.record} does not know {', '.join(self.new_keys)}: taken at their defaults")
        if self.versions:
            changed = ", ".join(f"{name} {before} (now {now})" for name, (before, now) in self.versions.items())
            said.append(f"begun with {changed}: {self.record.parent} may hold results of both")
        return said


def plain_terms(asked: Mapping[str, Any], apart: Set[str]) -> dict[str, Any]:
    """Descriptions and other data by name as plain data, without the keys of `apart` (``study.set``)."""
    plain: dict[str, Any] = to_jsonable_python(asked)
    for path in apart:
        *tables, key = path.split(".")
        node = plain
        for name in tables:
            node = node[name]
        node.pop(key)
    return plain


def write_record(terms: Mapping[str, Any], out: Path) -> None:
    """Keep `terms`, and the versions of what will answer them, in the folder `out`.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    with atomic_write(out / DESCRIPTION) as temporary:
        temporary.write_text(json.dumps({_VERSIONS: versions(), **terms}, indent=1) + "\n")


def recorded_terms(out: Path) -> dict[str, Any]:
    """What `write_record` kept, without the versions.

    Raises
    ------
    FileNotFoundError
        If nothing was begun in `out`.
    DescriptionError
        If the record there cannot be read.
    """
    return {key: value for key, value in _read(out / DESCRIPTION).items() if key != _VERSIONS}


def compare_with_record(asked: Mapping[str, Any], apart: Set[str], out: Path) -> Comparison:
    """Hold `asked` (see `plain_terms`) against the record in `out`.

    Raises
    ------
    FileNotFoundError, DescriptionError
        As `recorded_terms`.
    """
    found, record = Comparison(out / DESCRIPTION), _read(out / DESCRIPTION)
    before = record.pop(_VERSIONS, {})
    _compare(record, asked, "", apart, found)
    for name, now in versions().items():
        if name in before and before[name] != now:
            found.versions[name] = (before[name], now)
    return found


def _read(record: Path) -> dict[str, Any]:
    try:
        content = json.loads(record.read_text())
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise DescriptionError(f"{record}: cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise DescriptionError(f"{record}: cannot be read: expected a table")
    return content


def _compare(before: Any, now: Any, path: str, apart: Set[str], found: Comparison) -> None:
    if isinstance(now, Description | Mapping) and isinstance(before, dict):
        keys = type(now).model_fields if isinstance(now, Description) else now
        for key in keys:
            inside = f"{path}.{key}".lstrip(".")
            value = getattr(now, key) if isinstance(now, Description) else now[key]
            if inside in apart:
                continue
            if key in before:
                _compare(before[key], value, inside, apart, found)
            elif _at_default(now, key, value):
                found.new_keys.append(inside)
            else:
                found.differences.append(f"{inside} was not known then and is {_short(value)}, not its default")
        gone = [key for key in before if key not in keys and f"{path}.{key}" not in apart]
        found.differences.extend(
            f"{path}.{key}".lstrip(".") + f" was {_short(before[key])}, is not known any more" for key in gone
        )
    elif isinstance(now, list | tuple) and isinstance(before, list) and len(before) == len(now):
        for number, (old, new) in enumerate(zip(before, now, strict=True), 1):
            _compare(old, new, f"{path}[{number}]", apart, found)
    elif before != to_jsonable_python(now):
        found.differences.append(f"{path} was {_short(before)}, is {_short(now)}")


def _at_default(table: Any, key: str, value: Any) -> bool:
    if not isinstance(table, Description):
        return False
    field_info = type(table).model_fields[key]
    if field_info.is_required():
        return False
    return bool(to_jsonable_python(value) == to_jsonable_python(field_info.get_default(call_default_factory=True)))


def _short(value: Any, limit: int = 80) -> str:
    text = repr(to_jsonable_python(value))
    return text if len(text) <= limit else f"{text[: limit - 2]} …"
