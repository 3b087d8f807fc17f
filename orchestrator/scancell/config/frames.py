"""Descriptions of named tools on the flange, of user frames, and of axes and sensors beside arm, table and tool."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from scancell.config.description import Description, Fraction, PoseDescription
from scancell.config.devices import Name

# Names of the cell's own tools and frames.
RESERVED_TOOLS = frozenset({"sensor", "gripper"})
RESERVED_FRAMES = frozenset({"world", "base", "table", "tool"})

# Names that would be those of other frames, or of columns of files: ``NAME_deg``, ``NAME_mm``.
_COLUMNS = ("part", "sensor", "flange", "x", "y", "z", "rx", "ry", "rz", "sigma", "diameter")

_Delay = Annotated[float, Field(ge=0.0, le=1e7)]  # ms


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


class AxisDescription(Description):
    """An axis beside the joints and the table, such as a track of the arm or the tilt of a positioner.

    What it carries turns about z of its frame, or slides along it. It is placed, but neither moved nor simulated yet.
    """

    name: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]*$")] = Field(
        description="unique name of the axis in moves_with, variables and columns; not that of another frame or column"
    )
    kind: Literal["revolute", "prismatic"] = Field(description="revolute: turns; prismatic: slides")
    moves_with: str = Field(default="world", description="what carries it: world, table, link[i] or another axis")
    pose: PoseDescription = Field(
        default=PoseDescription(), description="pose of the axis in the frame of its carrier, with all axes at 0"
    )


class FurtherSensorDescription(Description):
    """A sensor beside that of the tool; these are numbered from ``sensor[2]``. It is placed, but not simulated yet."""

    moves_with: str = Field(default="world", description="what carries it: world, table, link[i] or an axis")
    pose: PoseDescription = Field(
        default=PoseDescription(), description="pose of the sensor in the frame of its carrier"
    )


def check_carriers(axes: tuple[AxisDescription, ...], others: Mapping[str, str], joints: int) -> None:
    """Raise `ValueError` for an axis whose name is taken, and for a carrier that does not exist or carries itself.

    `others` are the carriers of what is not an axis, by their keys; ``robot.moves_with`` carries the links.
    """
    links = [f"link[{i}]" for i in range(1, joints + 1)]
    carriers = {"table": "world", **dict.fromkeys(links, others["robot.moves_with"])}
    for number, axis in enumerate(axes, 1):
        if axis.name in {*carriers, *RESERVED_FRAMES, *_COLUMNS} or re.fullmatch(r"qd{0,2}[0-9]+", axis.name):
            raise ValueError(f"axis[{number}].name = '{axis.name}': expected a name of no other frame or column")
        carriers[axis.name] = axis.moves_with
    keys = {f"axis[{i}].moves_with": axis.moves_with for i, axis in enumerate(axes, 1)} | dict(others)
    for key, carrier in keys.items():
        if carrier != "world" and carrier not in carriers:
            raise ValueError(f"{key} = '{carrier}': expected world, {', '.join(carriers)}")
        above = carrier
        for _ in carriers:
            above = carriers.get(above, "world")
        if above != "world":
            raise ValueError(f"{key} = '{carrier}': expected what does not move with itself")


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


class ChannelDescription(Description):
    """One direction of a network; by default a perfect one.

    See the example of `faulty_link`.
    """

    delay_ms: _Delay = Field(default=0.0, description="minimum delay of a packet, ms")
    jitter_ms: _Delay = Field(
        default=0.0, description="mean of the exponentially distributed extra delay, ms; packets overtake each other"
    )
    loss: Fraction = Field(default=0.0, description="probability that a packet is lost outside bursts")
    burst: Fraction = Field(default=0.0, description="probability per packet that a burst of losses begins with it")
    burst_packets: float = Field(default=10.0, ge=1.0, le=1e6, description="mean length of a burst, in packets")
    burst_loss: Fraction = Field(default=1.0, description="probability that a packet is lost in a burst")
    duplication: Fraction = Field(
        default=0.0, description="probability that a packet is delivered twice, with independent delays"
    )
    replay: Fraction = Field(default=0.0, description="probability that a packet is delivered again after replay_ms")
    replay_ms: _Delay = Field(default=1000.0, description="time after which packets are delivered again, ms")
    dead_from_s: Annotated[float, Field(ge=0.0, le=1e9)] | None = Field(
        default=None, description="time from which on nothing is sent or delivered, s"
    )
    dead_until_s: Annotated[float, Field(ge=0.0, le=1e9)] | None = Field(
        default=None, description="time at which the link recovers, s"
    )


class LinkDescription(Description):
    """Faults of the connection between a cell and its guard; by default none.

    See the example of `faulty_link`.
    """

    to_guard: ChannelDescription = Field(default=ChannelDescription(), description="network from cell to guard")
    to_cell: ChannelDescription = Field(default=ChannelDescription(), description="network from guard to cell")
    clock_offset_ms: Annotated[float, Field(ge=-1e11, le=1e11)] = Field(
        default=0.0, description="time of the controller's clock at time 0, ms"
    )
    clock_drift_ppm: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = Field(
        default=0.0, description="relative error of the rate of the controller's clock, ppm"
    )
    stale: Fraction = Field(default=0.0, description="probability that an old state is sent instead of the new one")
    stale_polls: int = Field(default=1, ge=1, le=1000, description="age of an old state, in polls")
