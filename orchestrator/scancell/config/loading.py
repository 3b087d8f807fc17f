"""From TOML files, descriptions and ``key=value`` words to the checked descriptions of a scan."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scancell.arguments import checked_arguments, checked_fields
from scancell.config.cell import CellDescription, FurtherSensorDescription, sensor_frame
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
from scancell.config.sensor import SensorDescription, camera_label, profile_time
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
_DELAY = "delay_ms"
_FURTHER = re.compile(r"sensor\[\d+\]\.(?!r?[xyz](_\w+)?\s*=)")  # of further sensors, but not their poses


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

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of all sensors, by which clouds and files tell them apart: the main one, then the further ones."""
        return (self.sensor.name, *(one.name for one in self.cell.further_sensor))

    @property
    def camera_names(self) -> dict[int, str]:
        """Names of the cameras of all sensors by `camera_label`: with that of the sensor where there are several."""
        several = len(self.sensor_names) > 1
        return {
            camera_label(number, index): f"{name} {camera.name}" if several else camera.name
            for number, name in enumerate(self.sensor_names, 1)
            for index, camera in enumerate(self.seen_by(number).sensor.camera)
        }

    @property
    def profile_time(self) -> float:
        """Shortest time from a trigger to the next one, s, at which all sensors follow."""
        own = profile_time(self.sensor)
        return max(own, *(profile_time(one.sensor or self.sensor) / one.every for one in self.cell.further_sensor), 0.0)

    def seen_by(self, number: int) -> Setup:
        """The setup whose sensor is that of a number, from 1."""
        if number == 1:
            return self
        return Setup(self.cell, self.cell.further_sensor[number - 2].sensor or self.sensor, self.scan)


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
        Switch off all noise of images and encoders; speckle is light, and stays.

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
    for number, further in enumerate(setup.cell.further_sensor, 1):
        if further.name == setup.sensor.name:
            raise DescriptionError(
                "is the name of the main sensor, too",
                key=f"cell.further_sensor[{number}].name",
                value=further.name,
                expected="a name of its own",
            )
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


def as_built_sensor(nominal: SensorDescription, words: Sequence[str], number: int = 1) -> SensorDescription:
    """Sensor as built: the nominal one changed by those of `words` that begin with ``sensor.``.

    With a `number` of a further sensor, by those that begin with ``sensor[2].`` and so on, and are no pose.

    Raises `DescriptionError` if a key is unknown, is no property of the hardware, or its value is out of bounds.
    """
    name = sensor_frame(number)
    own = [word for word in sensor_words(words) if word.startswith(f"{name}.") and not _is_delay(word)]
    if not own:
        return nominal
    raw = {"sensor": plain_data(nominal)}
    origins = []
    for word in own:
        plain = f"sensor.{word.removeprefix(f'{name}.')}"
        section = str(split_path(parse_assignment(plain)[0])[1])
        if section not in _BUILT:
            more = "" if number == 1 else f", {name}.{_DELAY}, or of its pose ({name}.x_mm … {name}.rz_deg)"
            expected = f"a key of {name}.{f', {name}.'.join(_BUILT)}{more}"
            raise DescriptionError(key="as_built", value=word, expected=expected)
        changed = _apply_override(raw, plain, "as_built")
        origins.append(Origin(changed.path[1:], f"`as_built` {word}"))
    return validate(SensorDescription, raw["sensor"], "`as_built`: sensor", origins)


def as_built_sensors(setup: Setup, words: Sequence[str]) -> tuple[SensorDescription, ...]:
    """All sensors as built, in the order of their numbers; see `as_built_sensor`.

    Raises `DescriptionError` also if a word is of no sensor of the cell, or states a wrong delay.
    """
    require_sensors(words, len(setup.cell.further_sensor))
    for number, further in enumerate(setup.cell.further_sensor, 2):
        as_built_delay(further, words, number)
    numbers = range(1, len(setup.sensor_names) + 1)
    return tuple(as_built_sensor(setup.seen_by(number).sensor, words, number) for number in numbers)


def as_built_delay(nominal: FurtherSensorDescription, words: Sequence[str], number: int) -> float:
    """Delay, s, of the exposures of a further sensor as built; a word ``sensor[2].delay_ms`` states it.

    Raises `DescriptionError` if it is no number, or out of bounds.
    """
    delay = nominal.delay_ms
    for word in sensor_words(words):
        if word.startswith(f"{sensor_frame(number)}.") and _is_delay(word):
            origin = Origin((_DELAY,), f"`as_built` {word}")
            raw = {**plain_data(nominal), _DELAY: parse_assignment(word)[1]}
            delay = validate(FurtherSensorDescription, raw, "`as_built`", [origin]).delay_ms
    return 1e-3 * delay


def _is_delay(word: str) -> bool:
    key = parse_assignment(word)[0]
    return key.startswith("sensor[") and key.endswith(f"].{_DELAY}")


def sensor_words(as_built: Sequence[str]) -> list[str]:
    """Words of ``as_built`` that change a sensor; the others, such as those of its pose, change the cell."""
    return [word for word in as_built if word.startswith("sensor.") or _FURTHER.match(word)]


def require_sensors(as_built: Sequence[str], further: int) -> None:
    """Refuse words of ``as_built`` that change a sensor which a cell with so many `further` ones lacks.

    Raises `DescriptionError` naming the word.
    """
    names = [sensor_frame(number) for number in range(1, further + 2)]
    for word in sensor_words(as_built):
        if word.partition(".")[0] not in names:
            expected = ", ".join(f"{name}.…" for name in names)
            raise DescriptionError("there is no such sensor", key="as_built", value=word, expected=expected)


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
    cell = raw["cell"]
    further = [one["sensor"] for one in _tables(cell, "further_sensor") if isinstance(one.get("sensor"), dict)]
    for sensor in (raw["sensor"], *further):
        sensor.setdefault("render", {})["noise"] = False
    for owner in (cell.get("table", {}), *cell.get("robot", {}).get("joint", []), *_tables(cell, "axis")):
        if isinstance(owner, dict):
            unit = "_mm" if owner.get("kind") == "prismatic" else "_deg"
            owner[f"encoder_resolution{unit}"] = 0.0
            owner[f"encoder_noise{unit}"] = 0.0


def _tables(data: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    """The tables of a list in data that is not checked yet."""
    found = data.get(key)
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []
