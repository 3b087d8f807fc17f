"""Key paths such as ``camera[1].tilt_deg``, and ``key=value`` words that change plain data."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scancell.errors import DescriptionError

KeyPath = tuple[str | int, ...]
Assignments = Mapping[str, bool | int | float | str | Sequence[Any] | Mapping[str, Any]] | Sequence[str]


@dataclass(frozen=True)
class Origin:
    """Source of the value at `path`, where it is not the file of the whole description.

    Attributes
    ----------
    path
        Table, list item or value; everything below it has the same source.
    source
        Name for messages: another file, or an argument in backticks and its ``key=value`` word.
    hidden
        Number of leading parts of `path` that messages leave out, because `source` implies them.
    """

    path: KeyPath
    source: str
    hidden: int = 0


def assignments(given: Assignments) -> list[str]:
    """``key=value`` words of a mapping, or the words themselves.

    Raises `DescriptionError` if a single word is given in place of a list.
    """
    if isinstance(given, str):
        raise DescriptionError(repr(given), expected="a mapping or a list of key=value words")
    if isinstance(given, Mapping):
        return [f"{key}={_toml_value(value)}" for key, value in given.items()]
    return list(given)


def _toml_value(value: Any) -> str:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {_toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def parse_assignment(word: str) -> tuple[str, Any]:
    """Split ``key=value``; the value is read as TOML, and as plain text where it is not TOML.

    Raises `DescriptionError` if there is no ``=`` or no key.
    """
    key, equals, text = word.partition("=")
    if not equals or not key.strip():
        raise DescriptionError(f"'{word}'", expected="key=value, for example cell.part.x_mm=20")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):  # a number of too many digits, or lists nested too deeply, are no TOML, too
        value = text
    return key.strip(), value


def split_path(key: str) -> list[str | int]:
    """``camera[1].tilt_deg`` becomes ``["camera", 0, "tilt_deg"]`` (indices in keys count from 1).

    Raises `DescriptionError` if an index is not a positive integer.
    """
    parts: list[str | int] = []
    for piece in key.split("."):
        name, bracket, rest = piece.partition("[")
        parts.append(name)
        if bracket:
            digits = rest.removesuffix("]")
            if not rest.endswith("]") or not digits.isdecimal() or int(digits) < 1:
                raise DescriptionError(key=key, expected=f"an index like [1], counting from 1, in '{piece}'")
            parts.append(int(digits) - 1)
    return parts


def join_path(path: Sequence[str | int]) -> str:
    """Key of a path, the inverse of `split_path`."""
    text = "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


def override(raw: dict[str, Any], word: str, argument: str) -> Origin:
    """Change plain data by a ``key=value`` word of an argument; the key is not checked against a schema.

    Raises `DescriptionError` if the key leads through something that is neither a table nor an item of a list.

    Returns
    -------
    Origin
        The value or table that the word has set or created; for the messages of `validate`.
    """
    key, value = parse_assignment(word)
    source = f"`{argument}` {word}"
    return Origin(set_value(raw, split_path(key), value, source), source)


def set_value(raw: dict[str, Any], path: Sequence[str | int], value: Any, source: str) -> KeyPath:
    """Set the value at a path, creating missing tables on the way; return the shortest path that was set or created.

    Raises `DescriptionError` if the path leads through something that is neither a table nor an item of a list; names
    `source`.
    """
    node: Any = raw
    changed = len(path)
    for position, part in enumerate(path):
        if isinstance(part, int):
            count = len(node) if isinstance(node, list) else 0
            if part >= count:
                raise DescriptionError(f"index [{part + 1}] does not exist, there are {count}", file=source)
        elif not isinstance(node, dict):
            raise DescriptionError(f"'{part}' is not inside a table", file=source)
        elif part not in node and position + 1 < len(path):
            node[part] = [] if isinstance(path[position + 1], int) else {}
            changed = min(changed, position + 1)
        if position + 1 == len(path):
            node[part] = value
        else:
            node = node[part]
    return tuple(path[:changed])
