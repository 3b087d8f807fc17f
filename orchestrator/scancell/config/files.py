"""Description files on disk: TOML in and out, and the paths of meshes that they name."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import BaseModel

from scancell.config.keys import KeyPath, Origin, join_path
from scancell.errors import DescriptionError
from scancell.files import read_file

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


def assets_dir() -> Path:
    """Folder of the shipped descriptions and meshes: beside the package in a checkout, inside it in a wheel.

    Examples
    --------
    >>> sorted(file.name for file in (scancell.assets_dir() / "cells").glob("*.toml"))
    ['default.toml', 'offset_wrist.toml', 'pick_and_place.toml', 'seven_axis.toml']
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
    A robot that a cell names by path is read in. Paths become absolute: relative to the file that names them, else
    to the folder of the shipped descriptions of that kind, so that a copy of a shipped file works anywhere.

    Raises `DescriptionError` if a file is missing or not TOML, or has sections but not the one of its kind.
    """
    data, source = read_toml(path), str(path)
    found = [section for section in _SECTIONS if isinstance(data.get(section), dict)]
    if found:
        if kind not in found:
            raise DescriptionError(f"holds [{'], ['.join(found)}]", file=path, expected=f"a section [{kind}]")
        data, source = data[kind], f"{path} [{kind}]"
    origins = []
    if kind == "cell" and isinstance(data.get("robot"), str):
        robot = _existing(data["robot"], _folders(kind, path), source, "robot")
        data["robot"] = read_toml(robot)
        resolve_files(data["robot"], lambda _: str(robot), _folders("robot", robot))
        origins.append(Origin(("robot",), str(robot), hidden=1))
    resolve_files(data, lambda _: source, _folders(kind, path))
    return data, source, origins


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
        if place.exists():
            if not place.is_file():
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
