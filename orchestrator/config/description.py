"""Base of all descriptions: frozen, nothing unknown accepted, messages for people."""

from __future__ import annotations

import difflib
from typing import Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from orchestrator.errors import DescriptionError

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class Description(BaseModel):
    """A typed piece of a TOML file, in the units that its keys name."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False, validate_default=True)


Model = TypeVar("Model", bound=Description)


class PoseDescription(Description):
    """Pose `target_from_source`: translation, then rotation XYZ' (intrinsic) or Adept's yaw-pitch-roll ZYZ'."""

    x_mm: Finite = 0.0
    y_mm: Finite = 0.0
    z_mm: Finite = 0.0
    rx_deg: Finite = 0.0
    ry_deg: Finite = 0.0
    rz_deg: Finite = 0.0
    yaw_deg: Finite | None = Field(default=None, description="first angle of ZYZ'; excludes rx, ry, rz")
    pitch_deg: Finite | None = Field(default=None, description="second angle of ZYZ'")
    roll_deg: Finite | None = Field(default=None, description="third angle of ZYZ'")

    @model_validator(mode="after")
    def _one_convention(self) -> Self:
        zyz = [angle is not None for angle in (self.yaw_deg, self.pitch_deg, self.roll_deg)]
        if any(zyz) and not all(zyz):
            raise ValueError("yaw_deg, pitch_deg and roll_deg belong together")
        if any(zyz) and (self.rx_deg or self.ry_deg or self.rz_deg):
            raise ValueError("give either rx_deg, ry_deg, rz_deg or yaw_deg, pitch_deg, roll_deg")
        return self


def validate(model: type[Model], data: Any, source: str) -> Model:
    """Check `data` against `model`.

    Raises
    ------
    DescriptionError
        Naming `source`, each wrong key, its value and what was expected.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = [_message(model, data, item) for item in error.errors()]
        raise DescriptionError("\n".join(f"{source}: {line}" for line in lines)) from None


def _message(model: type[Description], data: Any, item: Any) -> str:
    location = [part for part in item["loc"] if not (isinstance(part, str) and part.startswith("function-"))]
    key = ".".join(str(part) for part in location) or "(whole file)"
    if item["type"] == "extra_forbidden":
        known = _known_keys(model, location[:-1])
        near = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f"; did you mean '{near[0]}'?" if near else f"; known here: {', '.join(known)}"
        return f"{key}: unknown key{hint}"
    if item["type"] == "missing":
        return f"{key}: missing, and it has no default"
    expected = str(item["msg"]).removeprefix("Value error, ")
    if isinstance(item["input"], dict | list) and not isinstance(data, str):
        return f"{key}: {expected}"
    return f"{key} = {item['input']!r}: {expected}"


def _known_keys(model: type[Description], location: list[Any]) -> list[str]:
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
