"""State of a running cell at one instant, for views."""

from __future__ import annotations

import ctypes
import functools
import inspect
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from enum import Enum
from itertools import count
from types import MappingProxyType
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.cell.driver import Mode, Operation, refusal
from scancell.cell.instance import CellInstance
from scancell.cell.recording import RecordLayout
from scancell.cell.session import CellSession
from scancell.errors import CommandError, DescriptionError, ScancellError
from scancell.geometry import pose
from scancell.nominal.cell import fmu_frame
from scancell.progress import CallbackProgress, Progress
from scancell.scanning.session import SEEN, ScanSession

P = ParamSpec("P")

Poses = Mapping[str, Array]

_STATES = ("at rest", "moving", "braking", "emergency stop")
_NEAREST = ("truth.clearance.body_a", "truth.clearance.body_b")
_COLLISION = ("truth.collision.pairs", "truth.collision.body_a", "truth.collision.body_b")

_SEEN_US = round(SEEN * 1e6)

T = TypeVar("T")

CLOSED = "the cell is closed"  # why a job ends with the cell


class CommandKind(Enum):
    """How a `LiveCell` carries out a command."""

    JOG = "moves the robot by hand for as long as it is renewed"
    MOVE = "moves the robot to a destination when the moves before it have ended"
    AT_REST = "cancels all motion, and starts when the robot rests"
    AT_ONCE = "starts in the next cycle"
    CANCEL = "cancels all motion and the job"


_NEEDS_OPERATION = {CommandKind.JOG: Operation.MANUAL, CommandKind.MOVE: Operation.AUTOMATIC}


@dataclass(frozen=True, eq=False)
class Command:
    """Command of an operator.

    Attributes
    ----------
    name
        Name of the command of a session that does the same: ``move_joints``.
    kind
        How a live cell carries it out.
    method
        Name of the method of a session that starts it: ``start_move_joints``.
    arguments
        Arguments of this method by name.
    """

    name: str
    kind: CommandKind
    method: str
    arguments: Mapping[str, Any]

    @property
    def needs_operation(self) -> Operation | None:
        """The operation without which the controller rejects it."""
        return _NEEDS_OPERATION.get(self.kind)

    def start(self, session: CellSession) -> None:
        """Give the command to the controller of `session`, which is not stepped.

        Raises
        ------
        CommandError
            If the cell cannot carry it out.
        """
        getattr(session, self.method)(**self.arguments)


def _command(name: str, kind: CommandKind, start: Callable[Concatenate[CellSession, P], None]) -> Callable[P, Command]:
    """Function with the parameters of the method `start` of a session that checks them and makes a command."""
    signature = inspect.signature(start)
    signature = signature.replace(parameters=list(signature.parameters.values())[1:], return_annotation="Command")

    @functools.wraps(start)
    def make(*args: P.args, **kwargs: P.kwargs) -> Command:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return Command(name, kind, start.__name__, bound.arguments)

    make.__doc__ = (
        f"Make the command of a live cell that calls `CellSession.{start.__name__}`. See the example of `LiveCell`."
    )
    vars(make)["__signature__"] = signature
    return checked_arguments(make)


JogJoints = _command("jog_joints", CommandKind.JOG, CellSession.start_jog_joints)
JogSensor = _command("jog_sensor", CommandKind.JOG, CellSession.start_jog_sensor)
MoveJoints = _command("move_joints", CommandKind.MOVE, CellSession.start_move_joints)
MoveAxis = _command("move_axis", CommandKind.MOVE, CellSession.start_move_axis)
MoveTool = _command("move_tool", CommandKind.MOVE, CellSession.start_move_tool)
MoveLine = _command("move_line", CommandKind.MOVE, CellSession.start_move_line)
SetMonitorSpeed = _command("set_monitor_speed", CommandKind.AT_ONCE, CellSession.set_monitor_speed)
SetOperation = _command("set_operation", CommandKind.AT_REST, CellSession.request_operation)
Reset = _command("reset", CommandKind.AT_REST, CellSession.release_emergency_stop)
Cancel = _command("cancel", CommandKind.CANCEL, CellSession.hold)
OpenGripper = _command("open_gripper", CommandKind.AT_ONCE, CellSession.start_open_gripper)
CloseGripper = _command("close_gripper", CommandKind.AT_ONCE, CellSession.start_close_gripper)
RunConveyor = _command("run_conveyor", CommandKind.AT_ONCE, CellSession.run_conveyor)


@dataclass(frozen=True, eq=False)
class LiveState:
    """True poses and device readings of a running cell; SI units, arrays are read-only.

    Attributes
    ----------
    time
        Simulated, s.
    joints, table_angle, further_axes
        Measured angles (joints,) and of the table, rad, and positions (k,) of the axes beyond it, rad or m.
    world_from_body
        True pose (4, 4) of each body by name.
    destination
        Joints and table angle (axes,) to which the motion in force, or the last one, leads, rad.
    world_from_body_at_destination
        Nominal pose (4, 4) of each body there.
    controller, mode, operation
        State, mode and operation of the controller; the state in words.
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
        Monitor speed of the operator, 0 to 1, and the one that a guard allows.
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
    further_axes: Array
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
    def axes(self) -> Array:
        """Measured positions (axes,) of all axes: joints, table, further axes."""
        return np.array([*self.joints, self.table_angle, *self.further_axes])

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
            further_axes=_read_only(session.further_axes),
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
        pairs, first, second = self._cell.get_integers(_COLLISION)
        if pairs == 0:
            return
        pair = f"{self._bodies[first - 1]} - {self._bodies[second - 1]}"
        if pair not in self.pairs:
            self.pairs.append(pair)


class LiveControl:
    """Commands a session that another object steps; see `LiveCell` for the parameters.

    Moves wait for the one that runs. A change of operation and a reset wait until the robot rests.
    """

    def __init__(self, session: ScanSession, hold_time: float, clock: Callable[[], float]) -> None:
        self._session, self._cell = session, session.cell
        self._hold_time, self._clock = hold_time, clock
        self._moves: deque[Command] = deque()
        self._jog_until: float | None = None
        self._at_rest: Command | None = None
        self._settled_us = 0
        self._moving = False  # a move that was begun has not ended

    def cancel_motion(self) -> None:
        """Drop all moves and jogs; the robot stops."""
        self._moves.clear()
        self._jog_until, self._at_rest, self._moving = None, None, False
        self._session.hold()

    def press_emergency_stop(self) -> None:
        """Cancel the motion and press the emergency stop."""
        self.cancel_motion()
        self._session.press_emergency_stop()

    @property
    def is_free(self) -> bool:
        """Whether nothing moves the robot and no motion is queued."""
        waits = self._moves or self._moving or self._jog_until is not None or self._is_settling
        return not waits and not self._cell.get_boolean("controller.moving")

    def apply(self, command: Command) -> None:
        """Start a command, or queue it.

        Raises
        ------
        CommandError
            If it cannot be carried out.
        """
        match command.kind:
            case CommandKind.JOG:
                self._jog(command)
            case CommandKind.MOVE:
                self._moves.append(command)
            case CommandKind.AT_REST:
                self.cancel_motion()
                self._at_rest = command
            case CommandKind.CANCEL:
                self.cancel_motion()
            case CommandKind.AT_ONCE:
                command.start(self._session)

    def begin_cycle(self) -> None:
        """Start what is due in the next cycle.

        Raises
        ------
        CommandError
            If a move cannot be started; the queued moves are dropped.
        """
        self._act_at_rest()
        self._keep_jog()
        self._begin_move()

    def end_cycle(self) -> None:
        """Update whether a move has ended."""
        self._moving = self._moving and not self._move_ended()

    def _jog(self, command: Command) -> None:
        """Start or renew a jog, but not before the guard has seen the robot at rest in manual operation."""
        operation = Operation(self._cell.get_integer("command.operation"))
        if self._is_settling:
            return
        if operation is not Operation.MANUAL:
            reason = "the cell is in automatic operation: change to manual operation first"
            raise CommandError(f"{command.name}: {reason}")
        command.start(self._session)
        self._jog_until = self._clock() + self._hold_time

    def _keep_jog(self) -> None:
        """Renew the heartbeat while the jog is renewed, else end the jog."""
        if self._jog_until is None:
            return
        if self._clock() < self._jog_until:
            self._session.renew_heartbeat()
        else:
            self._jog_until = None
            self._session.hold()

    def _act_at_rest(self) -> None:
        if self._at_rest is None or self._cell.get_boolean("controller.moving"):
            return
        self._at_rest.start(self._session)
        # A reset needs the next cycle of the controller, another operation the next answer of the guard.
        self._settled_us = self._cell.time_us + (_SEEN_US if self._at_rest.name == "set_operation" else 1)
        self._at_rest = None

    @property
    def _is_settling(self) -> bool:
        """Whether nothing may move the robot yet."""
        return self._at_rest is not None or self._cell.time_us < self._settled_us

    def _begin_move(self) -> None:
        if not self._moves or self._moving or self._is_settling:
            return
        move = self._moves.popleft()
        try:
            move.start(self._session)
        except (CommandError, DescriptionError):
            self._moves.clear()
            raise
        self._moving = True

    def _move_ended(self) -> bool:
        """Whether a move is done or was rejected; a rejected one drops the queued moves."""
        if self._cell.get_integer("controller.error") != 0:
            self._moves.clear()
            return True
        return self._cell.get_boolean("controller.at_destination")


class JobStopped(BaseException):
    """Ends a job of a `LiveCell` out of the step in which it is stopped.

    It is not an `Exception`, so that a program which catches errors of its commands does not continue.

    Parameters
    ----------
    why
        Reason for the end.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session(guarded=True) as session:
    ...     live = scancell.LiveCell(session)
    ...     job = live.perform(lambda session: live.submit(scancell.Cancel()) or session.wait(60), "wait")
    ...     live.run(job.done, realtime=False)
    >>> job.exception()
    JobStopped('cancelled')
    """

    def __init__(self, why: str = "stopped") -> None:
        super().__init__(why)


def interrupt(thread: int) -> None:
    """Raise `JobStopped` in a thread, by its identifier, when it next runs Python code."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(JobStopped))


def withdraw_interrupt(thread: int) -> None:
    """Drop an interrupt that has not been raised."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), None)


class SubmittedJob(Generic[T]):
    """Work with its result, which another thread may wait for."""

    def __init__(self, name: str, work: Callable[[ScanSession], T]) -> None:
        self.name, self._work = name, work
        self.future: Future[T] = Future()

    def refuse(self, error: ScancellError) -> None:
        """Give the error as the result, unless the work was cancelled."""
        if self.future.set_running_or_notify_cancel():
            self.future.set_exception(error)

    def run(self, session: ScanSession) -> str:
        """Run the work unless it was cancelled, and return its error message or an empty string.

        Raises
        ------
        BaseException
            An interrupt of the process, which is no error of the work.
        """
        if not self.future.set_running_or_notify_cancel():
            return ""
        try:
            result = self._work(session)
        except BaseException as error:
            self.future.set_exception(error)
            if not isinstance(error, Exception | SystemExit | JobStopped):
                raise
            is_own = isinstance(error, ScancellError | JobStopped)
            return str(error) if is_own else f"{type(error).__name__}: {error}"
        self.future.set_result(result)
        return ""


Work = SubmittedJob[Any]


def ready_to_move(session: ScanSession) -> NDArray[np.float64]:
    """Change to automatic operation, where it is not in force, and come to rest; the positions (axes,) there, rad."""
    if session.cell.get_integer("command.operation") != Operation.AUTOMATIC:
        session.set_operation(Operation.AUTOMATIC)
    return session.come_to_rest()


def while_stepping(session: ScanSession, work: Callable[[Progress], T]) -> T:
    """Step a session in a job while another thread does `work`, and return its result or raise its error.

    If the job is stopped, or the process ends, the progress that `work` gets cancels it.
    """
    future: Future[T] = Future()
    stopped = threading.Event()

    def do() -> None:
        try:
            future.set_result(work(CallbackProgress(lambda *_: not stopped.is_set() and process_goes_on())))
        except BaseException as error:
            future.set_exception(error)

    # No daemon: Python ends these when the process ends, which aborts it where they compute in C++.
    threading.Thread(target=do, name="plan").start()
    try:
        while not future.done():
            session.step()
    finally:
        stopped.set()
    return future.result()


def process_goes_on(*_: object) -> bool:
    """Whether the main thread has not ended; a callback of progress that cancels the work of other threads then."""
    return threading.main_thread().is_alive()
