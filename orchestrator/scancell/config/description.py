"""Base classes of all descriptions: immutable, unknown keys refused, errors that name file, key and value."""

from __future__ import annotations

import difflib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from scancell.arguments import checked_arguments
from scancell.config.files import (
    KeyPath,
    Origin,
    assets_dir,
    join_path,
    plain_data,
    read_description,
    resolve_files,
    set_value,
    split_path,
    toml_text,
)
from scancell.errors import DescriptionError
from scancell.files import atomic_write

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]

# Physical quantities in the units of their keys. Their bounds are beyond every real cell, sensor and part, and within
# what the engines for rays, collisions and dynamics calculate: on larger numbers these end the process.
Coordinate = Annotated[float, Field(ge=-100_000.0, le=100_000.0)]  # mm
Length = Annotated[float, Field(ge=0.0, le=100_000.0)]  # mm
Size = Annotated[float, Field(ge=0.001, le=100_000.0)]  # mm
Speed = Annotated[float, Field(ge=0.001, le=100_000.0)]  # mm/s
Acceleration = Annotated[float, Field(ge=0.1, le=1e7)]  # mm/s²
Angle = Annotated[float, Field(ge=-36_000.0, le=36_000.0)]  # deg
AngularSpeed = Annotated[float, Field(ge=0.001, le=100_000.0)]  # deg/s
AngularAcceleration = Annotated[float, Field(ge=0.1, le=1e7)]  # deg/s²
AngularJerk = Annotated[float, Field(ge=1.0, le=1e9)]  # deg/s³
LinearJerk = Annotated[float, Field(ge=1.0, le=1e9)]  # mm/s³
Mass = Annotated[float, Field(ge=1e-6, le=100_000.0)]  # kg
Density = Annotated[float, Field(ge=0.1, le=100_000.0)]  # kg/m³
Stiffness = Annotated[float, Field(ge=1e-6, le=1e6)]  # N/mm
Friction = Annotated[float, Field(ge=0.0, le=100.0)]  # coefficient of Coulomb friction
Bandwidth = Annotated[float, Field(ge=0.01, le=10_000.0)]  # nm
Point = Annotated[tuple[Coordinate, ...], Field(min_length=3, max_length=3)]  # mm
Number = Annotated[float, Field(ge=-1e15, le=1e15)]  # in any unit

_SCALE_OF_SUFFIX: dict[str, float] = {
    "_deg_s3": math.pi / 180.0,
    "_deg_s2": math.pi / 180.0,
    "_deg_s": math.pi / 180.0,
    "_deg": math.pi / 180.0,
    "_mrad": 1e-3,
    "_mm_s3": 1e-3,
    "_mm_s2": 1e-3,
    "_mm_s": 1e-3,
    "_n_mm": 1e3,
    "_mm": 1e-3,
    "_um": 1e-6,
    "_nm": 1e-9,
    "_mw": 1e-3,
    "_ms": 1e-3,
    "_m_s2": 1.0,
    "_w_m2": 1.0,
    "_kg_m3": 1.0,
    "_kg_m2": 1.0,
    "_kg": 1.0,
    "_n_m_s_rad": 1.0,
    "_n_m_rad": 1.0,
    "_n_m": 1.0,
    "_hz": 1.0,
    "_n": 1.0,
}


class Description(BaseModel):
    """A typed table of a TOML file, in the units that its keys name."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False, validate_default=True, allow_inf_nan=False)

    if not TYPE_CHECKING:  # type checkers know the keys

        def __init__(self, **values: Any) -> None:
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise DescriptionError.of_all(_problems(type(self), values, error, type(self).__name__, ())) from None

        # Tables inside a description are made as by BaseModel's own, which joins their errors to those of the whole.
        __init__.__pydantic_base_init__ = True

    @checked_arguments
    def replace(self, changes: Mapping[str, Any] | None = None, /, **values: Any) -> Self:
        """Return a copy with some values changed, checked like a file.

        Raises `DescriptionError` naming each wrong key, its value and what was expected.

        Parameters
        ----------
        changes
            Values by key; ``table.key`` and ``list[2].key`` (indices from 1) lead into the description:
            ``cell.replace({"part.x_mm": 20, "robot.joint[2].max_deg": 40})``. Tables that the description lacks are
            created. Relative paths of files are relative to the current folder.
        values
            The same for keys without a dot: ``camera.replace(tilt_deg=30)``.
        """
        source = f"{type(self).__name__}.replace"
        raw = plain_data(self)
        for key, value in {**(changes or {}), **values}.items():
            set_value(raw, split_path(key), plain_data(value), source)
        return checked(type(self), raw, source)


Model = TypeVar("Model", bound=Description)


class FileDescription(Description):
    """A description with a TOML file of its own."""

    kind: ClassVar[str]
    shipped: ClassVar[str]

    @classmethod
    def default(cls) -> Self:
        """Read the shipped description that commands use when none is given."""
        return cls.from_toml(assets_dir() / cls.shipped)

    @classmethod
    @checked_arguments
    def from_toml(cls, path: str | Path) -> Self:
        """Read and check a file, or the section of its kind of a run's ``resolved.toml``.

        Relative paths of meshes are relative to the file, else to the folder of the shipped descriptions.

        Raises `DescriptionError` naming file, key, value and what was expected.
        """
        return checked(cls, *read_description(cls.kind, Path(path)))

    @checked_arguments
    def to_toml(self, path: str | Path) -> None:
        """Write a file that `from_toml` reads as an equal description; values equal to their defaults are left out.

        Paths of meshes become absolute, or relative to the file if they lie below its folder.

        Raises `OutputError` if the file cannot be written.
        """
        with atomic_write(path) as temporary:
            text = toml_text(self.model_dump(exclude_defaults=True), Path(path).parent)
            temporary.write_text(text, encoding="utf-8")


class PoseDescription(Description):
    """Pose `target_from_source`: translation, then rotation XYZ' (intrinsic) or Adept's yaw-pitch-roll ZYZ'."""

    x_mm: Coordinate = Field(default=0.0, description="translation along x of the target frame, mm")
    y_mm: Coordinate = Field(default=0.0, description="translation along y of the target frame, mm")
    z_mm: Coordinate = Field(default=0.0, description="translation along z of the target frame, mm")
    rx_deg: Angle = Field(default=0.0, description="first angle of the intrinsic XYZ' rotation, about x, deg")
    ry_deg: Angle = Field(default=0.0, description="second angle of XYZ', about the rotated y, deg")
    rz_deg: Angle = Field(default=0.0, description="third angle of XYZ', about the twice rotated z, deg")
    yaw_deg: Angle | None = Field(
        default=None, description="first angle of ZYZ', about z, deg; with pitch_deg and roll_deg instead of XYZ'"
    )
    pitch_deg: Angle | None = Field(default=None, description="second angle of ZYZ', about the rotated y, deg")
    roll_deg: Angle | None = Field(default=None, description="third angle of ZYZ', about the twice rotated z, deg")

    @model_validator(mode="after")
    def _one_convention(self) -> Self:
        zyz = [angle is not None for angle in (self.yaw_deg, self.pitch_deg, self.roll_deg)]
        if any(zyz) and not all(zyz):
            raise ValueError("yaw_deg, pitch_deg and roll_deg must be given together")
        if any(zyz) and (self.rx_deg or self.ry_deg or self.rz_deg):
            raise ValueError("give either rx_deg, ry_deg, rz_deg or yaw_deg, pitch_deg, roll_deg")
        return self


def refuse_twins(names: Sequence[str], what: str) -> None:
    """Raise ValueError for a duplicate name; `what`: the things that have these names, for the message."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"'{twice[0]}' is given twice; names of {what} must differ")


def checked(model: type[Model], data: dict[str, Any], source: str, origins: Sequence[Origin] = ()) -> Model:
    """`validate`, after the paths of files that are still relative became absolute from the current folder."""
    resolve_files(data, lambda path: _origin(path, source, origins)[0], [Path()])
    return validate(model, data, source, origins)


def validate(model: type[Model], data: Any, source: str, origins: Sequence[Origin] = ()) -> Model:
    """Check `data` against `model`.

    Raises `DescriptionError` naming the source of each wrong value, its key, the value and what was expected.

    Parameters
    ----------
    source
        Name of the file or object for messages.
    origins
        Values that came from elsewhere; a later one counts before an earlier one of the same path.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise DescriptionError.of_all(_problems(model, data, error, source, origins)) from None


def _problems(
    model: type[Description], data: Any, error: ValidationError, source: str, origins: Sequence[Origin]
) -> list[DescriptionError]:
    """One error per wrong key, where the alternatives of a key with several types are joined."""
    problems: dict[str, tuple[dict[str, Any], list[str]]] = {}
    found = error.errors()
    for item in found:
        # A list whose only item is wrong counts as too short as well.
        depth = len(item["loc"])
        if item["type"] == "too_short" and any(other["loc"][:depth] == item["loc"] != other["loc"] for other in found):
            continue
        path = _path_in(data, item["loc"], item["type"] == "missing")
        name, hidden = _origin(path, source, origins, item["msg"])
        subject: dict[str, Any] = {"file": name, "key": join_path(path[hidden:]) or None}
        named = item["type"] in ("extra_forbidden", "missing") or isinstance(item["input"], dict | list | tuple)
        if subject["key"] and not named:
            subject["value"] = item["input"]
        problems.setdefault(repr(subject), (subject, []))[1].append(_expectation(model, item))
    return [_joined(subject, list(dict.fromkeys(texts))) for subject, texts in problems.values()]


def _joined(subject: Mapping[str, Any], texts: Sequence[str]) -> DescriptionError:
    must = "must be "
    expected = " or ".join(text.removeprefix(must) for text in texts) if texts[0].startswith(must) else None
    return DescriptionError(" or ".join(texts) if expected is None else must + expected, **subject, expected=expected)


def _expectation(model: type[Description], item: Any) -> str:
    if item["type"] == "extra_forbidden":
        known = _known_keys(model, item["loc"][:-1])
        near = difflib.get_close_matches(str(item["loc"][-1]), known, n=1)
        return f"unknown key; did you mean '{near[0]}'?" if near else f"unknown key; known here: {', '.join(known)}"
    if item["type"] == "missing":
        return "missing, and it has no default"
    return str(item["msg"]).removeprefix("Value error, ").replace("Input should", "must", 1)


def _path_in(data: Any, location: KeyPath, missing: bool) -> KeyPath:
    """Path in the data of an error's location, which also names validators and the types of alternatives."""
    path: list[str | int] = []
    for part in location:
        is_item = isinstance(part, int) and isinstance(data, list | tuple) and part < len(data)
        if is_item or (isinstance(data, Mapping) and part in data):
            path.append(part)
            data = data[part]
    return (*path, location[-1]) if missing else tuple(path)


def _origin(path: KeyPath, source: str, origins: Sequence[Origin], message: str = "") -> tuple[str, int]:
    """Source of the value or table at `path`, and how many leading parts of its key the source implies."""
    above = [Origin((), source), *(origin for origin in origins if origin.path == path[: len(origin.path)])]
    nearest = max(reversed(above), key=lambda origin: len(origin.path))
    # Values that conflict inside a table may have come from elsewhere; the message names their keys.
    below = {
        origin.path: origin.source
        for origin in origins
        if len(origin.path) > len(path) and origin.path[: len(path)] == path and str(origin.path[-1]) in message
    }
    return " with ".join([nearest.source, *below.values()]), nearest.hidden


def _known_keys(model: type[Description], location: KeyPath) -> list[str]:
    """Keys of the table at `location`, where a part of it may be the kind that chooses between several tables."""
    tables: list[type[Description]] = [model]
    for part in location:
        if isinstance(part, int):
            continue
        fields = [table.model_fields[part] for table in tables if part in table.model_fields]
        tables = _descriptions_in(fields[0].annotation) if fields else [t for t in tables if part in _kinds(t)]
    return list(tables[0].model_fields) if tables else []


def _kinds(table: type[Description]) -> tuple[Any, ...]:
    field = table.model_fields.get("kind")
    return getattr(field.annotation, "__args__", ()) if field else ()


def _descriptions_in(annotation: Any) -> list[type[Description]]:
    if isinstance(annotation, type) and issubclass(annotation, Description):
        return [annotation]
    return [found for argument in getattr(annotation, "__args__", ()) for found in _descriptions_in(argument)]


def split_unit(key: str) -> tuple[str, float]:
    """Name without its unit, and the factor from that unit to SI (1 for a key without a convertible unit).

    Units that the program uses unchanged (``_px``, ``_e``, ``_dn``, ``_us``) are part of the name.
    """
    for suffix, scale in _SCALE_OF_SUFFIX.items():
        if key.endswith(suffix):
            return key[: -len(suffix)], scale
    return key, 1.0


def to_si(value: Any) -> Any:
    """Nested plain data with SI values, and keys without their units."""
    if isinstance(value, Mapping):
        converted = {}
        for key, item in value.items():
            name, scale = split_unit(key)
            converted[name] = to_si(item) if scale == 1.0 else _scaled(item, scale)
        return converted
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [to_si(item) for item in value]
    return value


def si_value(description: object, key: str) -> float:
    """SI value of one key of a description; the key's suffix is its unit."""
    return float(getattr(description, key)) * split_unit(key)[1]


def _scaled(value: Any, scale: float) -> Any:
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return [_scaled(item, scale) for item in value]
    return float(value) * scale
