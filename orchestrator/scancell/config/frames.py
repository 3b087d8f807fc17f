"""Descriptions of named tools on the flange and of user frames."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from scancell.config.description import Description, PoseDescription
from scancell.config.devices import Name

# Names of the cell's own tools and frames.
RESERVED_TOOLS = frozenset({"sensor", "gripper"})
RESERVED_FRAMES = frozenset({"world", "base", "table", "tool"})


class TcpDescription(Description):
    """A named tool centre point on the flange, such as the tip of a nozzle or of a finger.

    Commands bring it to poses, move it on straight lines and jog it, as the sensor and the gripper.
    """

    name: Name = Field(description="unique name of the tool in commands; not sensor or gripper")
    flange_from_tcp: PoseDescription = Field(description="pose of the tool centre point in the flange frame")


class FrameDescription(Description):
    """A named coordinate system for poses of programs, such as that of a fixture."""

    name: Name = Field(description="unique name of the frame in commands; not world, base, table or tool")
    moves_with: Literal["world", "table"] = Field(
        default="world", description="world: does not move; table: turns with the table"
    )
    pose: PoseDescription = Field(
        default=PoseDescription(), description="pose of the frame in that of the world, or of the table at angle 0"
    )


def check_names(tcps: tuple[TcpDescription, ...], frames: tuple[FrameDescription, ...]) -> None:
    """Raise `ValueError` for the name of a tool or user frame that another one, or one of the cell, has."""
    tools = [(f"tcp[{i}].name", tcp.name) for i, tcp in enumerate(tcps, 1)]
    places = [(f"frame[{i}].name", frame.name) for i, frame in enumerate(frames, 1)]
    for named, reserved, kind in ((tools, RESERVED_TOOLS, "tool"), (places, RESERVED_FRAMES, "frame")):
        seen = set(reserved)
        for key, name in named:
            if name in seen:
                taken = ", ".join(sorted(seen))
                raise ValueError(f"{key} = '{name}': expected a name that no other {kind} has; taken: {taken}")
            seen.add(name)
