"""Description files on disk: TOML in and out, and the paths of meshes that they name."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import BaseModel

from scancell.errors import DescriptionError
from scancell.files import read_file, split_solids

KeyPath = tuple[str | int, ...]
Assignments = Mapping[str, bool | int | float | str | Sequence[Any] | Mapping[str, Any]] | Sequence[str]

# Keys whose values are paths of files: meshes, the material numbers of a part's faces, recorded poses, points.
FILE_KEYS = (
    "mesh",
    "base_mesh",
    "platter_mesh",
    "sensor_mesh",
    "finger_mesh",
    "housing_mesh",
    "face_materials",
    "recorded",
    "file",
)
# Sections of a file that holds several descriptions, and the folder of the shipped descriptions of that kind.
_SECTIONS = ("cell", "sensor", "scan")
_FOLDERS = {kind: f"{kind}s" for kind in ("cell", "robot", "sensor", "scan", "path", "artefact")}


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


def assets_dir() -> Path:
    """Folder of the shipped descriptions and meshes: beside the package in a checkout, inside it in a wheel.

    Examples
    --------
    >>> (scancell.assets_dir() / "cells/track.toml").is_file()
    True
    """
    package = Path(__file__).resolve().parents[1]
    inside = package / "assets"
    return inside if inside.is_dir() else package.parents[1] / "assets"


def read_toml(path: Path) -> dict[str, Any]:
    """Parse one TOML file.

    Raises `DescriptionError` if the file is missing, unreadable, too large, not UTF-8 or not TOML (with line and
    column).
    """
    content = read_file(path)
    try:
        return tomllib.loads(content.decode("utf-8"))
    except ValueError as error:  # not only of TOML: a number may have too many digits
        raise DescriptionError(f"not valid TOML: {error}", file=path) from None
    except (RecursionError, MemoryError):
        raise DescriptionError("not valid TOML: it is nested too deeply, or too large", file=path) from None


def read_description(kind: str, path: Path) -> tuple[dict[str, Any], str, list[Origin]]:
    """Plain data of a file of some kind, its name for messages, and sources other than that file.

    A file with sections ``[cell]``, ``[sensor]``, ``[scan]`` (the resolved.toml of a run) gives the one of its kind.
    A robot and sensors that a cell names by path are read in. Paths become absolute: relative to the file that names
    them, else to the folder of the shipped descriptions of that kind, so that a copy of a shipped file works anywhere.

    Raises `DescriptionError` if a file is missing or not TOML, or has sections but not the one of its kind.
    """
    data, source = read_toml(path), str(path)
    found = [section for section in _SECTIONS if isinstance(data.get(section), dict)]
    if found:
        if kind not in found:
            raise DescriptionError(f"holds [{'], ['.join(found)}]", file=path, expected=f"a section [{kind}]")
        data, source = data[kind], f"{path} [{kind}]"
    origins = []
    for owner, place in _named_by_path(data) if kind == "cell" else ():
        key = str(place[-1])
        file = _existing(owner[key], _folders(kind, path), source, join_path(place))
        if key == "robot":
            owner[key] = _read_robot(file)
        else:
            owner[key] = read_description(key, file)[0]
        origins.append(Origin(place, str(file), hidden=len(place)))
    resolve_files(data, lambda _: source, _folders(kind, path))
    return data, source, origins


def _read_robot(file: Path) -> dict[str, Any]:
    robot = read_toml(file)
    resolve_files(robot, lambda _: str(file), _folders("robot", file))
    return robot


def _named_by_path(cell: dict[str, Any]) -> Iterator[tuple[dict[str, Any], KeyPath]]:
    """Tables of a cell that name a robot or a sensor by the path of its file, and the paths of the keys that do."""
    if isinstance(cell.get("robot"), str):
        yield cell, ("robot",)
    sensors = cell.get("further_sensor")
    for number, sensor in enumerate(sensors if isinstance(sensors, list) else ()):
        if isinstance(sensor, dict) and isinstance(sensor.get("sensor"), str):
            yield sensor, ("further_sensor", number, "sensor")


def resolve_files(data: Any, source: Callable[[KeyPath], str], folders: Sequence[Path]) -> None:
    """Make the paths of files in plain data absolute, in place; `folders` are searched in turn.

    Raises `DescriptionError` naming the `source` of the path's key, the key, the value and every place where the file
    was expected.
    """
    for owner, key, path in file_entries(data):
        owner[key] = str(_existing(owner[key], folders, source(path), join_path(path)))


def toml_text(data: Mapping[str, Any], folder: Path | None = None) -> str:
    """TOML that reads back as the same data, without keys whose value is None.

    Paths of files become absolute, or relative to the `folder` of the file to be written if they lie below it.
    """
    plain = plain_data(data)
    near = None if folder is None else folder.resolve()
    for owner, key, _ in file_entries(plain):
        file = Path(owner[key]).resolve()
        owner[key] = str(file.relative_to(near) if near is not None and file.is_relative_to(near) else file)
    return tomli_w.dumps(plain)


def plain_data(value: Any) -> Any:
    """Descriptions, tables, sequences and arrays as new dicts and lists, without keys whose value is None."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, BaseModel):
        value = value.model_dump(exclude_none=True)
    if isinstance(value, Mapping):
        return {key: plain_data(item) for key, item in value.items() if item is not None}
    return [plain_data(item) for item in value] if isinstance(value, list | tuple) else value


def _folders(kind: str, path: Path) -> list[Path]:
    return [path.parent, assets_dir() / _FOLDERS[kind]]


def _existing(name: str, folders: Sequence[Path], source: str, key: str) -> Path:
    places = list(dict.fromkeys((folder / name).resolve() for folder in folders))
    for place in places:
        file = split_solids(place)[0]
        if file.exists():
            if not file.is_file():
                raise DescriptionError(file=source, key=key, value=name, expected="a regular file")
            return place
    raise DescriptionError(f"no such file; tried {' and '.join(map(str, places))}", file=source, key=key, value=name)


def file_entries(node: Any, path: KeyPath = ()) -> Iterator[tuple[dict[str, Any], str, KeyPath]]:
    """Every table of plain data that names a file, the key that does, and the path of that key."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key in FILE_KEYS and isinstance(value, str):
                yield node, key, (*path, key)
            else:
                yield from file_entries(value, (*path, key))
    elif isinstance(node, list):
        for position, item in enumerate(node):
            yield from file_entries(item, (*path, position))
