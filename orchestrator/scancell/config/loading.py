"""From TOML files, descriptions and ``key=value`` words to the checked descriptions of a scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scancell.arguments import checked_arguments, checked_fields
from scancell.config.cell import CellDescription
from scancell.config.description import FileDescription, checked, validate
from scancell.config.files import (
    FILE_KEYS,
    Assignments,
    Origin,
    assets_dir,
    assignments,
    override,
    parse_assignment,
    plain_data,
    read_description,
    read_toml,
    split_path,
)
from scancell.config.scan import PathDescription, ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError
from scancell.files import MANIFEST_VERSION, read_json, require_format_version

__all__ = [
    "FILE_KEYS",
    "Setup",
    "as_built_sensor",
    "assets_dir",
    "load_resolved",
    "load_setup",
    "override",
    "parse_assignment",
    "read_toml",
    "require_sensor_words",
    "sensor_words",
    "split_path",
    "with_path",
    "with_standoffs",
]

_MODELS: tuple[type[FileDescription], ...] = (CellDescription, SensorDescription, ScanDescription)
_SECTIONS = tuple(model.kind for model in _MODELS)
_BUILT = ("laser", "camera", "detector", "ambient")  # properties of the sensor's hardware


@checked_fields
@dataclass(frozen=True)
class Setup:
    """The nominal descriptions of a scan: everything that planning and reconstruction know beside the part's mesh.

    Attributes
    ----------
    cell
        Arm, tool, rotary table, position of the part, further devices.
    sensor
        Laser, cameras, detector, extraction.
    scan
        Views, spacing and speed.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> setup.cell.name, setup.sensor.name
    ('scan_cell', 'two_camera_probe')
    """

    cell: CellDescription
    sensor: SensorDescription
    scan: ScanDescription


@checked_arguments
def load_setup(
    cell: CellDescription | str | Path | None = None,
    sensor: SensorDescription | str | Path | None = None,
    scan: ScanDescription | str | Path | None = None,
    settings: Assignments = (),
    ideal: bool = False,
) -> Setup:
    """Read, override and check the descriptions.

    Parameters
    ----------
    cell, sensor, scan
        A description, or the path of a file of that kind or of a run's ``resolved.toml``; None: the shipped default.
    settings
        Changes, ``{"cell.part.x_mm": 20}`` or ``["sensor.camera[1].tilt_deg=29.4"]``. Paths are relative to the
        current folder.
    ideal
        Switch off all noise of sensor and encoders.

    Raises
    ------
    DescriptionError
        Naming the file or the setting, key, value and what was expected.

    Examples
    --------
    >>> setup = scancell.load_setup(settings={"scan.max_profiles": 40})
    >>> setup.scan.max_profiles
    40
    """
    read = [_raw(model, item) for model, item in zip(_MODELS, (cell, sensor, scan), strict=True)]
    raw = {section: data for section, (data, _, _) in zip(_SECTIONS, read, strict=True)}
    words = [_apply_override(raw, word, "settings") for word in assignments(settings)]
    if ideal:
        _switch_off_noise(raw)
    sections = {}
    for model, (data, source, origins) in zip(_MODELS, read, strict=True):
        own = [Origin(word.path[1:], word.source) for word in words if word.path[0] == model.kind]
        sections[model.kind] = checked(model, data, source, [*origins, *own])
    setup = Setup(**sections)  # type: ignore[arg-type]
    return Setup(setup.cell, setup.sensor, with_standoffs(setup.scan, setup.sensor))


def with_standoffs(scan: ScanDescription, sensor: SensorDescription) -> ScanDescription:
    """The description with the stand-offs of its sensor in numbers, as runs and studies keep them."""
    of = sensor.range.standoff_mm
    paths = tuple(path.model_copy(update={"standoff_mm": of(path.standoff_mm)}) for path in scan.path)
    sweep = scan.sweep.model_copy(update={"standoff_mm": of(scan.sweep.standoff_mm)})
    return scan.model_copy(update={"sweep": sweep, "path": paths})


def with_path(setup: Setup, path: PathDescription | str | Path | None) -> Setup:
    """The setup with a sensor path, or the file of one, as the only view of its scan; unchanged where it is None.

    Raises `DescriptionError` naming the file, key, value and what was expected.
    """
    if path is None:
        return setup
    described = path if isinstance(path, PathDescription) else PathDescription.from_toml(path)
    only = {"sweep.enabled": False, "raster.enabled": False, "pose": (), "path": (described,)}
    return Setup(setup.cell, setup.sensor, with_standoffs(setup.scan.replace(only), setup.sensor))


def load_resolved(path: str | Path) -> tuple[Setup, dict[str, Any]]:
    """Read the ``resolved.toml`` of a run folder; its ``manifest.json``, if it has one, states the version.

    Raises `DescriptionError` naming file, key, value and what was expected.

    Returns
    -------
    setup
        The nominal descriptions that the run used.
    run
        Its other inputs: part, unit, engine, as_built, seed, command line.
    """
    manifest = Path(path).parent / "manifest.json"
    if manifest.is_file():
        stated = read_json(manifest)
        version = stated.get("format_version") if isinstance(stated, dict) else None
        require_format_version(version, MANIFEST_VERSION, manifest)
    run = read_toml(Path(path)).get("run")
    if not isinstance(run, dict):
        raise DescriptionError(file=path, expected="a section [run], as in the resolved.toml of a run folder")
    return load_setup(path, path, path), run


def _raw(
    model: type[FileDescription], item: FileDescription | str | Path | None
) -> tuple[dict[str, Any], str, list[Origin]]:
    """Plain data that may be changed, its name for messages, and other sources."""
    if isinstance(item, FileDescription):
        return plain_data(item), f"{type(item).__name__} '{getattr(item, 'name', '')}'", []
    return read_description(model.kind, assets_dir() / model.shipped if item is None else Path(item))


def as_built_sensor(nominal: SensorDescription, words: Sequence[str]) -> SensorDescription:
    """Sensor as built: the nominal one changed by those of `words` that begin with ``sensor.``.

    Raises `DescriptionError` if a key is unknown, is no property of the hardware, or its value is out of bounds.
    """
    words = sensor_words(words)
    if not words:
        return nominal
    raw = {"sensor": plain_data(nominal)}
    origins = []
    for word in words:
        section = str(split_path(parse_assignment(word)[0])[1])
        if section not in _BUILT:
            raise DescriptionError(key="as_built", value=word, expected=f"a key of sensor.{', sensor.'.join(_BUILT)}")
        changed = _apply_override(raw, word, "as_built")
        origins.append(Origin(changed.path[1:], changed.source))
    return validate(SensorDescription, raw["sensor"], "`as_built`: sensor", origins)


def sensor_words(as_built: Sequence[str]) -> list[str]:
    """Words of ``as_built`` that change the sensor; the others change the cell."""
    return [word for word in as_built if word.startswith("sensor.")]


def require_sensor_words(as_built: Sequence[str], why: str) -> None:
    """Refuse ``as_built`` words of the cell where only those of the sensor apply; `why` explains it.

    Raises `DescriptionError` naming the word.
    """
    for word in as_built:
        if word not in sensor_words([word]):
            raise DescriptionError(why, key="as_built", value=word, expected="a key of the sensor (sensor.…)")


def _apply_override(raw: dict[str, Any], word: str, argument: str) -> Origin:
    parts = split_path(parse_assignment(word)[0])
    if parts[0] not in _SECTIONS or len(parts) < 2:
        raise DescriptionError(
            f"the key must begin with one of {', '.join(_SECTIONS)}",
            key=argument,
            value=word,
            expected=f"one of {', '.join(_SECTIONS)}",
        )
    return override(raw, word, argument)


def _switch_off_noise(raw: dict[str, Any]) -> None:
    raw["sensor"].setdefault("render", {})["noise"] = False
    owners: list[Mapping[str, Any]] = [raw["cell"].get("table", {}), *raw["cell"].get("robot", {}).get("joint", [])]
    for owner in owners:
        if isinstance(owner, dict):
            owner["encoder_resolution_deg"] = 0.0
            owner["encoder_noise_deg"] = 0.0
