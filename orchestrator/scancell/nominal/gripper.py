"""The gripper's frames and bodies as described."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.cell import FixtureDescription, PartDescription, ToolDescription
from scancell.config.description import PoseDescription, si_value, to_si
from scancell.config.devices import GripperDescription
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, joined, load_mesh

Array = NDArray[np.float64]


def start_width(gripper: GripperDescription) -> float:
    """Distance between the pads at the start, m."""
    return si_value(gripper, "stroke_mm" if gripper.start_mm is None else "start_mm")


def gripper_from_finger(width: float) -> Array:
    """Frames (2, 4, 4) of the fingers with the pads `width` (m) apart."""
    first = pose.translation((width / 2, 0.0, 0.0))
    return np.stack([first, pose.from_rotation(pose.rotation_about(2, np.pi)) @ first])


def finger_mesh(gripper: GripperDescription) -> Mesh:
    """A finger in its own frame, metres.

    Raises `MeshError` if a described mesh cannot be used.
    """
    if gripper.finger_mesh is not None:
        return load_mesh(Path(gripper.finger_mesh))
    si = to_si(gripper.model_dump(include={"finger_thickness_mm", "finger_width_mm", "finger_length_mm"}))
    size = (si["finger_thickness"], si["finger_width"], si["finger_length"])
    return box_mesh(size, "finger").transformed(pose.translation((size[0] / 2, 0.0, size[2] / 2)))


def finger_travel_mesh(gripper: GripperDescription, finger: Mesh) -> Mesh:
    """Convex hull of a `finger` at all widths, in its frame at the start width, metres."""
    start, stroke = start_width(gripper), si_value(gripper, "stroke_mm")
    ends = [finger.transformed(pose.translation(((width - start) / 2, 0.0, 0.0))) for width in (0.0, stroke)]
    return joined(ends, finger.source).hull


def housing_mesh(gripper: GripperDescription) -> Mesh | None:
    """Housing that carries the fingers, in the gripper's frame, metres; None if not described.

    Raises `MeshError` if a described mesh cannot be used.
    """
    if gripper.housing_mesh is not None:
        return load_mesh(Path(gripper.housing_mesh))
    if gripper.housing_mm is None:
        return None
    size = to_si({"housing_mm": gripper.housing_mm})["housing"]
    return box_mesh(size, "gripper").transformed(pose.translation((0.0, 0.0, -size[2] / 2)))


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
