"""Tools on the flange and frames of a nominal cell, by their names."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.errors import CommandError, DescriptionError
from scancell.nominal.cell import NominalCell

Array = NDArray[np.float64]


def tool_names(nominal: NominalCell) -> tuple[str, ...]:
    """``sensor``, ``gripper`` if the cell has one, and the tools of the description."""
    gripper = () if nominal.flange_from_finger is None else ("gripper",)
    return ("sensor", *gripper, *nominal.flange_from_tcp)


def frame_names(nominal: NominalCell) -> tuple[str, ...]:
    """``base``, ``table``, and the user frames of the description."""
    return ("base", "table", *nominal.user_frames)


def flange_from_tool(nominal: NominalCell, tool: str) -> Array:
    """Pose (4, 4) of a tool on the flange; the origin of ``gripper`` lies between its pads.

    Raises
    ------
    CommandError
        If `tool` is ``gripper`` and the cell has none.
    DescriptionError
        If the cell has no such tool.
    """
    if tool == "sensor":
        return nominal.flange_from_sensor
    if tool in nominal.flange_from_tcp:
        return nominal.flange_from_tcp[tool]
    if tool != "gripper":
        raise DescriptionError(key="tool", value=tool, expected=_listed(tool_names(nominal)))
    fingers = nominal.flange_from_finger
    if fingers is None:
        raise CommandError("the cell has no gripper")
    flange_from_gripper = fingers[0].copy()
    flange_from_gripper[:3, 3] = fingers[:, :3, 3].mean(0)
    return np.asarray(flange_from_gripper)


def world_from_frame(nominal: NominalCell, frame: str, axes: ArrayLike) -> Array:
    """Pose (4, 4) of ``base``, ``table`` or a user frame at positions of the axes.

    Raises
    ------
    DescriptionError
        If the cell has no such frame.
    """
    if frame in ("base", "table"):
        return nominal.world_from(frame, axes)
    if frame not in nominal.user_frames:
        raise DescriptionError(key="frame", value=frame, expected=_listed(frame_names(nominal)))
    found = nominal.user_frames[frame]
    return np.asarray(nominal.world_from(found.parent, axes) @ found.parent_from_joint)


def _listed(names: Collection[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
