"""From TOML files and ``key=value`` words to checked descriptions."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.config.cell import CellDescription
from orchestrator.config.description import Description, validate
from orchestrator.config.scan import ScanDescription
from orchestrator.config.sensor import SensorDescription
from orchestrator.errors import DescriptionError

# Keys whose values are paths of files: meshes, and which face of a part has which material.
FILE_KEYS = ("mesh", "base_mesh", "platter_mesh", "sensor_mesh", "finger_mesh", "housing_mesh", "face_materials")
_SECTIONS: dict[str, type[Description]] = {
    "cell": CellDescription,
    "sensor": SensorDescription,
    "scan": ScanDescription,
}

_BUILT = ("laser", "camera", "detector", "ambient")  # of the sensor: what may come out of the workshop other than drawn


@dataclass(frozen=True)
class Setup:
    """The three nominal descriptions of a run."""

    cell: CellDescription
    sensor: SensorDescription
    scan: ScanDescription


def assets_dir() -> Path:
    """Folder of the shipped descriptions and meshes: beside the package in a checkout, inside it in a wheel."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "assets"
    return inside if inside.is_dir() else package.parent / "assets"


def load_setup(
    cell: Path | None = None,
    sensor: Path | None = None,
    scan: Path | None = None,
    overrides: Sequence[str] = (),
    ideal: bool = False,
) -> Setup:
    """Read, override and check the descriptions; what is not given comes from the assets.

    Parameters
    ----------
    overrides
        Words like ``cell.part.x_mm=20`` or ``sensor.camera[1].tilt_deg=29.4``; the value is read as TOML.
    ideal
        Switch off every noise of sensor and encoders.

    Raises
    ------
    DescriptionError
        Naming file, key, value and what was expected.
    """
    assets = assets_dir()
    paths = {
        "cell": cell or assets / "cells" / "default.toml",
        "sensor": sensor or assets / "sensors" / "two_camera_probe.toml",
        "scan": scan or assets / "scans" / "default.toml",
    }
    raw = {section: _read_section(section, path) for section, path in paths.items()}
    for word in overrides:
        _apply_override(raw, word)
    if ideal:
        _switch_off_noise(raw)
    return Setup(
        cell=validate(CellDescription, raw["cell"], f"{paths['cell']}: cell"),
        sensor=validate(SensorDescription, raw["sensor"], f"{paths['sensor']}: sensor"),
        scan=validate(ScanDescription, raw["scan"], f"{paths['scan']}: scan"),
    )


def as_built_sensor(nominal: SensorDescription, words: Sequence[str]) -> SensorDescription:
    """The sensor as it truly is: the nominal one changed by those of `words` that begin with ``sensor.``.

    Raises
    ------
    DescriptionError
        If a key is unknown, is no property of the hardware, or its value is out of bounds.
    """
    words = sensor_words(words)
    if not words:
        return nominal
    raw = {"sensor": nominal.model_dump(mode="json")}
    for word in words:
        section = str(split_path(parse_assignment(word)[0])[1])
        if section not in _BUILT:
            raise DescriptionError(f"--as-built {word}: expected a key of sensor.{', sensor.'.join(_BUILT)}")
        _apply_override(raw, word, "--as-built")
    return validate(SensorDescription, raw["sensor"], "--as-built: sensor")


def sensor_words(as_built: Sequence[str]) -> list[str]:
    """Those of the ``--as-built`` words that change the sensor; the others change the cell."""
    return [word for word in as_built if word.startswith("sensor.")]


def require_sensor_words(as_built: Sequence[str], why: str) -> None:
    """Refuse ``--as-built`` words about the cell where it is too late for them, or too early: `why`.

    Raises
    ------
    DescriptionError
        Naming the word.
    """
    for word in as_built:
        if word not in sensor_words([word]):
            raise DescriptionError(f"--as-built {word}: {why}; expected a key of the sensor (sensor.…)")


def read_toml(path: Path) -> dict[str, Any]:
    """Parse one TOML file.

    Raises
    ------
    DescriptionError
        If the file is missing, unreadable, not UTF-8 or not TOML (with line and column).
    """
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except FileNotFoundError:
        raise DescriptionError(f"{path}: no such file") from None
    except OSError as error:
        raise DescriptionError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DescriptionError(f"{path}: not valid TOML: {error}") from None


def parse_assignment(word: str) -> tuple[str, Any]:
    """Split ``key=value``; the value is read as TOML, and as plain text where it is not TOML.

    Raises
    ------
    DescriptionError
        If there is no ``=`` or no key.
    """
    key, equals, text = word.partition("=")
    if not equals or not key.strip():
        raise DescriptionError(f"'{word}': expected key=value, for example cell.part.x_mm=20")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    return key.strip(), value


def split_path(key: str) -> list[str | int]:
    """``camera[1].tilt_deg`` becomes ``["camera", 0, "tilt_deg"]`` (numbers in keys count from 1).

    Raises
    ------
    DescriptionError
        If an index is not a positive whole number.
    """
    parts: list[str | int] = []
    for piece in key.split("."):
        name, bracket, rest = piece.partition("[")
        parts.append(name)
        if bracket:
            digits = rest.removesuffix("]")
            if not rest.endswith("]") or not digits.isdigit() or int(digits) < 1:
                raise DescriptionError(f"'{key}': expected an index like [1], counting from 1, in '{piece}'")
            parts.append(int(digits) - 1)
    return parts


def _read_section(section: str, path: Path) -> dict[str, Any]:
    data = read_toml(path)
    if section == "cell" and isinstance(data.get("robot"), str):
        robot_path = path.parent / data["robot"]
        data["robot"] = read_toml(robot_path)
        _resolve_mesh_paths(data["robot"], robot_path.parent)
    _resolve_mesh_paths({key: value for key, value in data.items() if key != "robot"}, path.parent, data)
    return data


def _resolve_mesh_paths(node: Any, folder: Path, target: dict[str, Any] | None = None) -> None:
    """Make mesh paths absolute, relative to the file that names them."""
    if isinstance(node, dict):
        owner = node if target is None else target
        for key, value in node.items():
            if key in FILE_KEYS and isinstance(value, str):
                owner[key] = str((folder / value).resolve())
            else:
                _resolve_mesh_paths(value, folder)
    elif isinstance(node, list):
        for item in node:
            _resolve_mesh_paths(item, folder)


def _apply_override(raw: dict[str, Any], word: str, option: str = "--set") -> None:
    parts = split_path(parse_assignment(word)[0])
    if parts[0] not in _SECTIONS or len(parts) < 2:
        raise DescriptionError(f"{option} {word}: the key must begin with one of {', '.join(_SECTIONS)}")
    override(raw, word, option)


def override(raw: dict[str, Any], word: str, option: str) -> None:
    """Change plain data by a ``key=value`` word, which came by `option`; whether the key is known is not asked here.

    Raises
    ------
    DescriptionError
        If the key leads through something that is no table or no item of a list.
    """
    key, value = parse_assignment(word)
    parts = split_path(key)
    node: Any = raw
    for position, part in enumerate(parts[:-1]):
        following = parts[position + 1]
        if isinstance(part, int):
            _require_item(node, part, f"{option} {word}")
            node = node[part]
        elif isinstance(node, dict):
            node = node.setdefault(part, [] if isinstance(following, int) else {})
        else:
            raise DescriptionError(f"{option} {word}: '{part}' is not inside a table")
    _assign(node, parts[-1], value, f"{option} {word}")


def _assign(node: Any, part: str | int, value: Any, option: str) -> None:
    if isinstance(part, int):
        _require_item(node, part, option)
    elif not isinstance(node, dict):
        raise DescriptionError(f"{option}: '{part}' is not inside a table")
    node[part] = value


def _require_item(node: Any, index: int, option: str) -> None:
    if not isinstance(node, list) or index >= len(node):
        count = len(node) if isinstance(node, list) else 0
        raise DescriptionError(f"{option}: index [{index + 1}] does not exist, there are {count}")


def _switch_off_noise(raw: dict[str, Any]) -> None:
    raw["sensor"].setdefault("render", {})["noise"] = False
    owners: list[Mapping[str, Any]] = [raw["cell"].get("table", {}), *raw["cell"].get("robot", {}).get("joint", [])]
    for owner in owners:
        if isinstance(owner, dict):
            owner["encoder_resolution_deg"] = 0.0
            owner["encoder_noise_deg"] = 0.0
