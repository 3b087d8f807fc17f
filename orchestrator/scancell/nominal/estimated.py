"""The cell with the deviations that calibration estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scancell.config.cell import CellDescription
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell

_DH = ("theta", "d", "a", "alpha", "beta")
_POSE = ("x", "y", "z", "rx", "ry", "rz")
WOBBLE = ("rx_cos", "rx_sin", "ry_cos", "ry_sin")


def as_estimated(nominal: NominalCell, cell: CellDescription) -> NominalCell:
    """The nominal cell with the deviations that its description states as estimated, if it does."""
    return nominal if cell.estimated is None else estimated_cell(nominal, cell.estimated.deviations())


def estimated_cell(nominal: NominalCell, deviations: Mapping[str, float]) -> NominalCell:
    """The nominal cell with deviations by the names of as-built parameters, SI; those not given are 0."""

    def values(group: str, *keys: str) -> list[float]:
        return [deviations.get(f"{group}.{key}", 0.0) for key in keys]

    def delta(group: str) -> NDArray[np.float64]:
        found = values(group, *_POSE)
        return pose.from_euler_xyz(found[:3], found[3:])

    joints = [
        replace(joint, **{key: getattr(joint, key) + deviations.get(f"dh[{number}].{key}", 0.0) for key in _DH})
        for number, joint in enumerate(nominal.arm.joints, 1)
    ]
    return replace(
        nominal,
        arm=replace(nominal.arm, joints=joints),
        flange_from_sensor=nominal.flange_from_sensor @ delta("tool"),
        world_from_table=nominal.world_from_table @ delta("table"),
        eccentricity=(*values("platter", "x", "y"),),
        wobble=(*values("table", *(f"wobble_{key}" for key in WOBBLE)),),
        trigger_latency=deviations.get("trigger.latency", 0.0),
    )
