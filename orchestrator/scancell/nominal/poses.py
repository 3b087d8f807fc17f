"""Poses from descriptions to matrices, and to the form in which the FMU's description holds them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.cell import FixtureDescription, PartDescription, ToolDescription
from scancell.config.description import PoseDescription
from scancell.config.units import to_si
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh

Array = NDArray[np.float64]


def pose_matrix(description: PoseDescription) -> Array:
    """(4, 4) of a described pose."""
    si = to_si(description.model_dump())
    position = (si["x"], si["y"], si["z"])
    if si["yaw"] is not None:
        return pose.from_rotation(pose.rotation_from_euler_zyz((si["yaw"], si["pitch"], si["roll"])), position)
    return pose.from_euler_xyz(position, (si["rx"], si["ry"], si["rz"]))


def tool_matrix(tool: ToolDescription) -> Array:
    """``flange_from_sensor`` (4, 4), given directly or from the dimensions of the fixture."""
    if tool.flange_from_sensor is not None:
        return pose_matrix(tool.flange_from_sensor)
    assert isinstance(tool.fixture, FixtureDescription)  # the description has exactly one of the two
    si = to_si(tool.fixture.model_dump())
    return np.asarray(
        pose.from_rotation(pose.rotation_about(2, si["rotation"]))
        @ pose.translation((si["offset"], 0.0, si["plate"] + si["reach"]))
        @ pose.from_rotation(pose.rotation_about(1, si["tilt"]))
    )


def lay_down(part: Mesh, description: PartDescription) -> Array:
    """``table_from_part`` (4, 4): bounding box centred on the axis, lowest point on the table, then displaced."""
    si = to_si(description.model_dump())
    rotation = pose.rotation_from_euler_xyz((si["rx"], si["ry"], si["rz"]))
    vertices = part.vertices @ rotation.T
    low, high = vertices.min(0), vertices.max(0)
    centre = (low + high) / 2
    return pose.from_rotation(rotation, (si["x"] - centre[0], si["y"] - centre[1], si["z"] - low[2]))


def pose_json(target_from_source: Array) -> dict[str, Any]:
    """Position (m) and quaternion (w, x, y, z) of a (4, 4) matrix."""
    quaternion = pose.quaternion_from_rotation(target_from_source[:3, :3])
    return {"position": target_from_source[:3, 3].tolist(), "quaternion": quaternion.tolist()}
