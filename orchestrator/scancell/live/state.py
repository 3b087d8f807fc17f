"""State of a running cell at one instant, for views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from scancell.cell.driver import Mode, Operation, refusal
from scancell.cell.instance import CellInstance
from scancell.cell.recording import RecordLayout
from scancell.geometry import pose
from scancell.nominal.cell import fmu_frame
from scancell.scanning.session import ScanSession

Array = NDArray[np.float64]

Poses = Mapping[str, Array]

_STATES = ("at rest", "moving", "braking", "emergency stop")
_NEAREST = ("truth.clearance.body_a", "truth.clearance.body_b")
_COLLISION = ("truth.collision.pairs", "truth.collision.body_a", "truth.collision.body_b")

_OUTPUTS = ("truth.collision.pairs", "truth.collision.body_a", "truth.collision.body_b")


@dataclass(frozen=True, eq=False)
class LiveState:
    """True poses and device readings of a running cell; SI units, arrays are read-only.

    Attributes
    ----------
    time
        Simulated, s.
    joints, table_angle
        Measured angles (joints,) and of the table, rad.
    world_from_body
        True pose (4, 4) of each body by name.
    destination
        Joints and table angle (axes,) to which the motion in force, or the last one, leads, rad.
    world_from_body_at_destination
        Nominal pose (4, 4) of each body there.
    controller, mode, operation
        Of the controller; `controller` in words.
    moving
        Whether an axis moves.
    refusal
        Reason why the controller rejects its command; empty if it does not.
    message
        Reason why the last command was rejected or the last job failed; empty after success.
    job
        Name of the job that runs, or waits for the robot to rest; None without one.
    progress
        Share of the motion that is done, 0 to 1.
    monitor_speed, monitor_speed_in_force
        Of the operator, 0 to 1, and what a guard allows of it.
    pendant_text, pendant_beep, guard_text
        Texts of the pendant and of the guard.
    presence
        Whether each presence sensor detects a body.
    distance
        Reading of each distance sensor, m; None where its measurement was discarded.
    gripper_width
        m; None without a gripper.
    conveyors
        Speed (m/s) and travel (m) of each conveyor.
    colliding
        Bodies of the deepest collision; None without one.
    nearest
        Nearest pair of bodies and their distance, m, up to the range of the description; None beyond.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     state = scancell.LiveCell(session).state
    >>> state.controller, state.operation.name, state.world_from_body["sensor"].shape
    ('at rest', 'AUTOMATIC', (4, 4))
    """

    time: float
    joints: Array
    table_angle: float
    world_from_body: Poses
    destination: Array
    world_from_body_at_destination: Poses
    controller: str
    moving: bool
    mode: Mode
    operation: Operation
    refusal: str
    message: str
    job: str | None
    progress: float
    monitor_speed: float
    monitor_speed_in_force: float
    pendant_text: str
    pendant_beep: bool
    guard_text: str
    presence: tuple[bool, ...]
    distance: tuple[float | None, ...]
    gripper_width: float | None
    conveyors: tuple[tuple[float, float], ...]
    colliding: tuple[str, str] | None
    nearest: tuple[str, str, float] | None

    @property
    def guarded_pair(self) -> tuple[str, str] | None:
        """Bodies that the guard warns of, slows down for or has stopped for; None if it names none."""
        for part in self.guard_text.split(": "):
            first, _, second = part.partition(" - ")
            if first in self.world_from_body and second in self.world_from_body:
                return first, second
        return None


class StateReader:
    """Reads the state of a session's cell."""

    def __init__(self, session: ScanSession) -> None:
        self._session, self._cell = session, session.cell
        self._nominal, self._true = session.nominal, session.true
        names = set(self._cell.names)

        def number(pattern: str) -> int:
            return next(i for i in count(1) if pattern.format(i) not in names) - 1

        self._frames = RecordLayout.of(names).frames
        self._poses = self._cell.real_group(
            f"truth.{frame}.{part}[{i}]"
            for frame in self._frames
            for part, size in (("position", 3), ("orientation", 4))
            for i in range(1, size + 1)
        )
        self._presence, self._distance = number("presence[{}].detected"), number("distance[{}].value")
        self._conveyors = self._cell.real_group(
            f"conveyor[{i}].{name}" for i in range(1, number("conveyor[{}].speed") + 1) for name in ("speed", "travel")
        )
        self._scalars = self._cell.real_group(
            ["controller.progress", "command.monitor_speed", "truth.clearance.distance"]
        )
        self._has_gripper = "measured.gripper.width" in names
        self._destination, self._poses_there = np.empty(0), _frozen({})

    def read(self, message: str = "", job: str | None = None) -> LiveState:
        """The present state."""
        cell, session = self._cell, self._session
        conveyors = cell.get(self._conveyors).reshape(-1, 2).tolist() if self._conveyors.count else []
        destination = _read_only(session.destination)
        progress, monitor_speed_in_force, clearance = cell.get(self._scalars).tolist()
        return LiveState(
            time=session.time,
            joints=_read_only(session.joints),
            table_angle=session.table_angle,
            world_from_body=self._world_from_body(),
            destination=destination,
            world_from_body_at_destination=self._poses_at(destination),
            controller=_STATES[cell.get_integer("controller.state")],
            moving=cell.get_boolean("controller.moving"),
            mode=Mode(cell.get_integer("controller.mode")),
            operation=Operation(cell.get_integer("command.operation")),
            refusal=refusal(cell) or "",
            message=message,
            job=job,
            progress=progress,
            monitor_speed=session.monitor_speed,
            monitor_speed_in_force=monitor_speed_in_force,
            pendant_text=cell.get_string("pendant.text"),
            pendant_beep=cell.get_boolean("pendant.beep"),
            guard_text=cell.get_string("command.pendant.text"),
            presence=tuple(session.presence(i + 1) for i in range(self._presence)),
            distance=tuple(session.distance(i + 1) for i in range(self._distance)),
            gripper_width=session.gripper_width if self._has_gripper else None,
            conveyors=tuple((speed, travel) for speed, travel in conveyors),
            colliding=self._colliding(),
            nearest=self._nearest(clearance),
        )

    def _world_from_body(self) -> Poses:
        values = self._cell.get(self._poses).reshape(-1, 7)
        frames = dict(zip(self._frames, pose.pose(values[:, :3], values[:, 3:]), strict=True))
        frames["world"] = np.eye(4)
        return _frozen({body.name: frames[fmu_frame(body.moves_with)] for body in self._true.bodies})

    def _poses_at(self, axes: Array) -> Poses:
        if not np.array_equal(axes, self._destination):
            poses = self._nominal.body_poses(axes)
            named = zip(self._nominal.bodies, poses, strict=True)
            self._destination, self._poses_there = axes, _frozen({body.name: pose_ for body, pose_ in named})
        return self._poses_there

    def _colliding(self) -> tuple[str, str] | None:
        pairs, first, second = self._cell.get_integers(_COLLISION)
        return None if pairs == 0 else (self._name(first), self._name(second))

    def _nearest(self, distance: float) -> tuple[str, str, float] | None:
        first, second = self._cell.get_integers(_NEAREST)
        if first == 0:
            return None
        return self._name(first), self._name(second), distance

    def _name(self, number: int) -> str:
        return self._true.bodies[number - 1].name


def _frozen(poses: dict[str, Array]) -> Poses:
    return MappingProxyType({name: _read_only(value) for name, value in poses.items()})


def _read_only(values: Array) -> Array:
    copied = np.array(values, float)
    copied.setflags(write=False)
    return copied


class ContactWatch:
    """Notes the pairs of bodies that come into contact, from now on until `end`.

    Parameters
    ----------
    bodies
        Names of the cell's bodies, in the order of its description for the FMU.

    Attributes
    ----------
    pairs
        ``a - b`` in the order of their first contact; of several contacts at once, the deepest.
    end
        Ends the watch.
    """

    def __init__(self, cell: CellInstance, bodies: Sequence[str]) -> None:
        self._cell, self._bodies = cell, bodies
        self.pairs: list[str] = []
        self.end = cell.on_step(self._look)

    def _look(self) -> None:
        pairs, first, second = self._cell.get_integers(_OUTPUTS)
        if pairs == 0:
            return
        pair = f"{self._bodies[first - 1]} - {self._bodies[second - 1]}"
        if pair not in self.pairs:
            self.pairs.append(pair)
