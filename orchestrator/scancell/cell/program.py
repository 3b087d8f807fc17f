"""Programs of the planner for the cell: segments of set-points with rules that trigger the sensor."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scancell.values import Value

TriggerKind = Literal["off", "time", "table_angle", "path_distance", "request", "belt_travel"]

FORMAT = 2


@dataclass(frozen=True)
class TriggerRule:
    """Rule by which the sensor is triggered.

    `interval` is in seconds (``time``), radians (``table_angle``) or metres (``path_distance``, ``belt_travel``);
    it is 0 for ``off`` and ``request`` (one exposure on demand, as stop-and-look needs).
    """

    kind: TriggerKind = "off"
    interval: float = 0.0


@dataclass(frozen=True)
class BeltRun:
    """Travel of a belt while the arm is at rest.

    Attributes
    ----------
    conveyor
        Number of the conveyor, from 1.
    speed
        m/s, signed; the belt starts from rest and comes to rest again.
    trigger_from, trigger_to
        Measured travel since the start of the cell (m) from which and up to which the sensor is triggered. The first
        exposure fires in the first controller cycle that begins beyond `trigger_from`.
    """

    conveyor: int
    speed: float
    trigger_from: float
    trigger_to: float


@dataclass(frozen=True, eq=False, repr=False)
class Segment(Value):
    """One uninterrupted motion.

    Attributes
    ----------
    id
        Number that the trigger records of this segment carry, >= 1 and unique in the program.
    times
        (n,) seconds from the start of the segment, starting at 0, one per controller cycle.
    axes
        (n, joints + 1) set-points of joints and table in radians (not wrapped).
    trigger
        Rule in force between `trigger_from` and `trigger_to`.
    trigger_from, trigger_to
        Seconds from the start of the segment; the first exposure fires at `trigger_from`, and so approach and
        run-out stay dark.
    name
        What the segment scans, or where it leads, for messages.
    belt
        Travel of a belt after the motion, for the rule ``belt_travel``.
    further
        (n, k) set-points of the axes beside joints and table, rad or m.
    """

    id: int
    times: NDArray[np.float64]
    axes: NDArray[np.float64]
    trigger: TriggerRule = TriggerRule()
    trigger_from: float = 0.0
    trigger_to: float = 0.0
    name: str = ""
    belt: BeltRun | None = None
    further: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def all_axes(self) -> NDArray[np.float64]:
        """Set-points (n, axes) of joints, table and further axes, rad or m."""
        return np.hstack([self.axes, self.further]) if self.further.size else self.axes


@dataclass(frozen=True, eq=False, repr=False)
class Program(Value):
    """A checked motion from rest to rest; each segment starts where the one before ends.

    `stop_and_look` programs request one exposure at the end of every segment whose rule is ``request``,
    after `settle` seconds at rest.
    """

    segments: tuple[Segment, ...]
    settle: float = 0.0

    @property
    def names(self) -> dict[int, str]:
        """Segment id → name."""
        return {segment.id: segment.name for segment in self.segments}

    @property
    def start(self) -> NDArray[np.float64]:
        """Joints and table angle (joints + 1,), rad, at which it starts."""
        return np.asarray(self.segments[0].axes[0])

    @property
    def further(self) -> tuple[float, ...]:
        """Positions of the axes beside joints and table at which it starts, rad or m."""
        return tuple(self.segments[0].further[0].tolist()) if self.segments[0].further.size else ()

    @property
    def duration(self) -> float:
        """Seconds of motion, without settling."""
        return float(sum(segment.times[-1] for segment in self.segments))


def program_data(program: Program) -> dict[str, Any]:
    """A program as plain data for JSON, SI units, without loss of precision."""
    return {
        "format": FORMAT,
        "settle": program.settle,
        "segments": [
            {
                "id": segment.id,
                "name": segment.name,
                "trigger": {"kind": segment.trigger.kind, "interval": segment.trigger.interval},
                "trigger_from": segment.trigger_from,
                "trigger_to": segment.trigger_to,
                "belt": None if segment.belt is None else asdict(segment.belt),
                "time": segment.times.tolist(),
                "q": segment.axes[:, :-1].tolist(),
                "table": segment.axes[:, -1].tolist(),
                **({"further": segment.further.tolist()} if segment.further.size else {}),
            }
            for segment in program.segments
        ],
    }


@contextmanager
def temporary_program_file(program: Program, folder: Path) -> Iterator[Path]:
    """A new file in `folder` with a program, removed at the end."""
    handle, name = tempfile.mkstemp(prefix="program-", suffix=".json", dir=folder)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(json.dumps(program_data(program)))  # faster than json.dump
        yield Path(name).absolute()
    finally:
        Path(name).unlink(missing_ok=True)
