"""Deviations of the true cell from its description, as calibration estimated them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import Field

from scancell.config.description import Angle, Coordinate, Description, split_unit, to_si, validate
from scancell.config.robot import MAX_JOINTS
from scancell.errors import DescriptionError

_DIGITS = 9  # of numbers in mm, deg and ms

_Length = Field(default=0.0, description="estimated deviation, mm; as as_built of the same name")
_Angle = Field(default=0.0, description="estimated deviation, deg; as as_built of the same name")


class EstimatedToolDescription(Description):
    """Deviation of the sensor from its nominal pose on the flange: translation, then rotation XYZ', nominal frame."""

    x_mm: Coordinate = _Length
    y_mm: Coordinate = _Length
    z_mm: Coordinate = _Length
    rx_deg: Angle = _Angle
    ry_deg: Angle = _Angle
    rz_deg: Angle = _Angle


_Wobble = Field(
    default=0.0,
    description="wobble of the axis, deg: at table angle t it is tilted about the table's nominal x axis by"
    " rx_cos cos t + rx_sin sin t, and about y likewise",
)


class EstimatedTableDescription(Description):
    """Deviation of the table axis from its nominal pose, and its wobble."""

    x_mm: Coordinate = _Length
    y_mm: Coordinate = _Length
    z_mm: Coordinate = _Length
    rx_deg: Angle = _Angle
    ry_deg: Angle = _Angle
    wobble_rx_cos_deg: Angle = _Wobble
    wobble_rx_sin_deg: Angle = _Wobble
    wobble_ry_cos_deg: Angle = _Wobble
    wobble_ry_sin_deg: Angle = _Wobble


class EstimatedPlatterDescription(Description):
    """Eccentricity: position of the platter's centre from the axis, in the rotating frame."""

    x_mm: Coordinate = _Length
    y_mm: Coordinate = _Length


class EstimatedTriggerDescription(Description):
    """Timing of exposures."""

    latency_ms: Annotated[float, Field(ge=-100.0, le=100.0)] = Field(
        default=0.0, description="estimated delay of the light after the latched joints and table angle, ms"
    )


class EstimatedJointDescription(Description):
    """Denavit-Hartenberg row of a joint; `beta_deg` is Hayati's rotation about y after alpha."""

    theta_deg: Angle = _Angle
    d_mm: Coordinate = _Length
    a_mm: Coordinate = _Length
    alpha_deg: Angle = _Angle
    beta_deg: Angle = _Angle


class EstimatedDescription(Description):
    """Deviations that `scancell calibrate` found, named like those of ``--as-built``.

    Reconstruction applies them. The simulated cell, which has true deviations of its own, does not.

    Examples
    --------
    >>> estimated = scancell.EstimatedDescription.of({"tool.x": 1e-3}, joints=6)
    >>> estimated.tool.x_mm
    1.0
    """

    tool: EstimatedToolDescription = Field(default=EstimatedToolDescription(), description="pose of the sensor")
    table: EstimatedTableDescription = Field(default=EstimatedTableDescription(), description="axis of the table")
    platter: EstimatedPlatterDescription = Field(
        default=EstimatedPlatterDescription(), description="eccentricity of the platter"
    )
    trigger: EstimatedTriggerDescription = Field(
        default=EstimatedTriggerDescription(), description="timing of exposures"
    )
    dh: Annotated[tuple[EstimatedJointDescription, ...], Field(max_length=MAX_JOINTS)] = Field(
        default=(), description="geometry of the arm, a row per joint from the base; default: as described"
    )

    @classmethod
    def of(cls, deviations: Mapping[str, float], joints: int) -> Self:
        """From SI values by the names of as-built parameters, as `deviations` returns them."""
        left = dict(deviations)

        def group(model: type[Description], prefix: str) -> dict[str, float]:
            taken = {}
            for key in model.model_fields:
                name, scale = split_unit(key)
                taken[key] = round(left.pop(f"{prefix}.{name}", 0.0) / scale, _DIGITS)
            return taken

        groups: dict[str, Any] = {name: group(model, name) for name, model in _GROUPS.items()}
        rows = [group(EstimatedJointDescription, f"dh[{number}]") for number in range(1, joints + 1)]
        groups["dh"] = rows if any(any(row.values()) for row in rows) else []
        if left:
            raise DescriptionError(key="deviations", value=[*left], expected="names of as-built parameters")
        return validate(cls, groups, "estimated")

    def deviations(self) -> dict[str, float]:
        """SI values by the names of as-built parameters, such as ``tool.x`` and ``dh[3].theta``."""
        plain = to_si(self.model_dump())
        rows = plain.pop("dh")
        groups = {**plain, **{f"dh[{number}]": row for number, row in enumerate(rows, 1)}}
        return {f"{group}.{key}": value for group, values in groups.items() for key, value in values.items()}


_GROUPS: dict[str, type[Description]] = {
    "tool": EstimatedToolDescription,
    "table": EstimatedTableDescription,
    "platter": EstimatedPlatterDescription,
    "trigger": EstimatedTriggerDescription,
}
