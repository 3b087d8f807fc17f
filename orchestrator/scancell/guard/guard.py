"""The guard of a robot: answers each of its states with a permission to move on, or with an emergency stop.

An answer permits motion until its state is `max_age` old; then the controller stops by itself.  So a stop is proved for
each answer as if it were the last one: even if all later messages are lost, the robot stops without contact.
Where no stop is proved, the answer is an emergency stop, and the proof of an earlier answer holds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import Length, Shape, Threads, Within, checked_arguments, checked_fields, checked_value
from scancell.arrays import Array
from scancell.cell.driver import Mode, MonitorSpeed, Operation
from scancell.cell.instance import CellInstance
from scancell.config.robot import RobotDescription
from scancell.errors import DescriptionError, MessageError
from scancell.geometry import pose
from scancell.geometry.mesh import reduced
from scancell.guard.check import Contact, JogCheck, JogVerdict, ManualCheck, PathCheck, Verdict
from scancell.guard.endpoints import Identifier
from scancell.guard.messages import MAX_TEXT, CellState, GuardMessage, PlacedPart, axes_digest, axis_bits
from scancell.guard.parts import FreePath, NearPairs, PartTracker, carriers, jog_limits
from scancell.guard.stopping import Hypothesis, MeasuredState, WorstCase
from scancell.guard.transport import Link
from scancell.nominal.cell import NominalCell
from scancell.progress import Pace
from scancell.proximity.motion_check import MotionCheck, MotionClash
from scancell.proximity.scene import cell_scene

_POLL_CYCLES = 2  # of the controller; it answers position queries no faster
_EMERGENCY = 3  # controller.state
_AHEAD = 64  # points of the path ahead, a cycle of path clock apart; the first one is the present set-point

_Positive = Length
_NotNegative = Annotated[float, Within(0.0)]

_MAX_FACES = 400
_STATES = 3
_BEEP = 0.5  # s to a contact
_AT_LIMIT = 0.9  # of the permitted speed, from which on a jog counts as slowed


class GuardedCell:
    """Steps a cell that exchanges messages with its guard.

    Parameters
    ----------
    cell
        A running instance at a multiple of the controller's cycle.
    cycle_us
        The controller's cycle, µs.
    link
        To the guard; None: without a guard.
    max_age
        Age of the last answer's state at which the controller stops, s.
    shows_jogs
        Whether the guard sees where a jog leads before it moves the robot, and limits its speed; else it identifies
        jogs by measured states.
    parts
        Follows what the gripper and belts move; None: the guard does not know where these parts are.

    Attributes
    ----------
    monitor_speed
        Monitor speed of the operator, 0 to 1; the lower one of this and the guard's is in force.
    stop_pressed
        Whether the operator keeps the emergency stop pressed, independently of the guard.

    Examples
    --------
    >>> guard = scancell.guard_of(part="part.stl")
    >>> link = scancell.Link(scancell.InProcess(guard, compute_time=0.003), guard.settings.max_age)
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     guarded = scancell.GuardedCell(session.cell, 16_000, link, guard.settings.max_age)
    ...     guarded.attach()
    ...     session.move_tool(scancell.location(0.45, 0.0, 0.05, rx=np.pi))
    Traceback (most recent call last):
        ...
    scancell.errors.CommandError: move_tool: held by the guard ...: slowed to 0%: sensor - part

    `Scanner.session` with ``guarded=True`` does the same.
    """

    @checked_arguments
    def __init__(
        self,
        cell: CellInstance,
        cycle_us: int,
        link: Link | None,
        max_age: float,
        shows_jogs: bool = True,
        parts: PartTracker | None = None,
    ) -> None:
        self._cell, self._cycle_us, self._link, self._shows_jogs = cell, cycle_us, link, shows_jogs
        self._parts = parts
        axes = cell.axis_names("")
        self._prismatic = axis_bits(cell.prismatic_axes())
        self._digest = axes_digest(axes, self._prismatic)
        self._widths = cell.real_group([name for name in cell.names if name == "measured.gripper.width"])
        belts = sum(name.startswith("measured.conveyor[") and name.endswith("].travel") for name in cell.names)
        self._travel = cell.real_group([f"measured.conveyor[{i}].travel" for i in range(1, belts + 1)])
        self._measured = cell.real_group([f"measured.{axis}" for axis in axes])
        self._rate = cell.real_group(["controller.rate"])
        self._path_time = cell.real_group(["controller.path_time"])
        self._ahead = cell.path_ahead(_AHEAD)
        self._guard_time = cell.real_group(["command.guard.time"])
        self._monitor_speed = cell.real_group(["command.monitor_speed"])
        self._polls = 0
        self._sequence = 0
        self._allowed = 1.0 if link is None else 0.0  # by the last answer
        self.monitor_speed = 1.0
        self.stop_pressed = False
        if link is not None:
            cell.set(cell.real_group(["command.guard.max_age"]), np.array([max_age]))

    def attach(self) -> None:
        """Poll at the end of every controller cycle from now on, however the cell is stepped.

        So commands and programs of a `CellSession` cannot step the cell past its guard.
        """
        self.poll()
        self._cell.on_cycle(self._cycle_us, self.poll)

    @checked_arguments
    def set_monitor_speed(self, share: MonitorSpeed) -> None:
        """Change the operator's monitor speed to `share`, 0 to 1.

        It acts at once, but never beyond what the guard allows, and scales no jog.

        Raises
        ------
        DescriptionError
            If it is out of its range.
        """
        self.monitor_speed = share
        self._apply_monitor_speed()

    def _apply_monitor_speed(self) -> None:
        manual = self._cell.get_integer("command.operation") == Operation.MANUAL
        speed = self._allowed if manual else min(self.monitor_speed, self._allowed)
        self._cell.set(self._monitor_speed, np.array([speed]))

    def poll(self) -> list[GuardMessage]:
        """Send the state when a query is due, and apply the answers that have arrived; to be called once a cycle.

        The answers are returned, see `Link.poll`.
        """
        if self._link is None:
            return []
        time = self._cell.time_us * 1e-6
        if self._polls % _POLL_CYCLES == 0:
            self._link.send(self.state(), time)
        self._polls += 1
        answers = self._link.poll(time)
        if answers:
            last = answers[-1]
            self._cell.set(self._guard_time, np.array([time - self._link.age(time)]))
            self._allowed = last.monitor_speed
            self._apply_monitor_speed()
            stop = self.stop_pressed or any(answer.emergency_stop for answer in answers)
            self._cell.set_boolean("command.emergency_stop", stop)
            if last.text or self._cell.get_integer("controller.state") != _EMERGENCY:  # else the reason stays
                self._cell.set_string("command.pendant.text", last.text)
            self._cell.set_boolean("command.pendant.beep", last.beep)
        return answers

    def run(self, seconds: float, act: Callable[[], bool]) -> None:
        """Run in real time for `seconds` of the cell, or until `act`, which is called once a cycle, returns true.

        A machine that is too slow makes the cell's clock slow, which is that of the ages: see `Pace`.
        """
        pace = Pace(self._cycle_us * 1e-6)
        end = self._cell.time_us + round(seconds * 1e6)
        while self._cell.time_us < end and not act():
            self.poll()
            self._cell.step_to(self._cell.time_us + self._cycle_us)
            pace.wait()

    def state(self) -> CellState:
        """The cell as the controller answers a query."""
        cell = self._cell
        operation = Operation(cell.get_integer("command.operation"))
        mode = Mode(cell.get_integer("controller.mode"))
        automatic = operation is Operation.AUTOMATIC
        follows = mode not in (Mode.HOLD, Mode.SERVO) if automatic else self._shows_jogs
        self._sequence = (self._sequence + 1) % 2**32
        axes = cell.get(self._measured).copy()
        return CellState(
            self._sequence,
            cell.time_us * 1e-6,
            operation,
            mode,
            cell.get_boolean("controller.moving"),
            axes,
            float(np.clip(cell.get(self._rate)[0], 0.0, 1.0)),
            cell.get(self._ahead).reshape(_AHEAD, len(axes)).copy() if follows else (),
            self._cycle_us * 1e-6 if follows else 0.0,
            float(cell.get(self._path_time)[0]) if follows else 0.0,
            self._shows_jogs,
            cell.get(self._widths).copy(),
            self._placed_parts(axes),
            prismatic=self._prismatic,
            digest=self._digest,
        )

    def _placed_parts(self, axes: NDArray[np.float64]) -> tuple[PlacedPart, ...]:
        if self._parts is None:
            return ()
        has_gripper = self._widths.count > 0
        width = float(self._cell.get(self._widths)[0]) if has_gripper else 0.0
        gripped = has_gripper and self._cell.get_boolean("measured.gripper.gripped")
        return self._parts.update(axes, self._cell.get(self._travel), width, gripped)


@checked_fields
@dataclass(frozen=True)
class GuardSettings:
    """Worst case for which stops are proved.

    Attributes
    ----------
    max_age
        Age of the last answer's state at which the controller stops by itself, s. A longer one bears more loss of
        packets, and keeps the robot farther from everything.
    cycle
        Cycle of the controller, s: it notices the age, and brakes, one cycle late each.
    noise
        Standard deviation of the measured positions, rad, or m of prismatic axes: one for all axes, or (axes,).
    angle_error
        Largest error of the measured positions, likewise: of the encoders, and of the gears behind them.
    latency
        Largest age of measured positions when the controller stamps them, s.
    position_error
        Largest deviation of a body from its nominal position, m: two bodies may be nearer by twice as much.
    mesh_error
        Largest error of the simplified meshes that the guard compares, m: it adds to the distance to be kept.
    deceleration
        Share of the axes' accelerations that braking attains.
    horizon
        Time for which a motion by hand is predicted for warnings, s.
    threads
        Threads of the checks of motions before they begin; 0 uses all cores. An answer takes one.

    Raises
    ------
    DescriptionError
        If a value is negative, or 0 where there is no such worst case.

    Examples
    --------
    >>> settings = scancell.GuardSettings(max_age=0.2, position_error=0.002)
    >>> print(f"{settings.reaction:.3f} s")
    0.232 s
    >>> guard = scancell.guard_of(part="part.stl", settings=settings)
    """

    max_age: _Positive = 0.12
    cycle: _Positive = 0.016
    noise: _Positive | tuple[_Positive, ...] = float(np.radians(0.005))
    angle_error: _NotNegative | tuple[_NotNegative, ...] = float(np.radians(0.025))
    latency: _NotNegative = 0.0
    position_error: _NotNegative = 1e-3
    mesh_error: _NotNegative = 0.2e-3
    deceleration: _Positive = 0.95
    horizon: _Positive = 1.0
    threads: Threads = 1

    @property
    def reaction(self) -> float:
        """Time from a measured state to the beginning of braking, if no later answer arrives, s."""
        return self.latency + self.max_age + 2 * self.cycle


@dataclass(frozen=True)
class Decision:
    """Decision that follows from a state.

    Attributes
    ----------
    stop
        Whether to make an emergency stop.
    monitor_speed
        0 to 1.
    text, beep
        For the pendant.
    pair
        Bodies that are the reason of a stop, a lower speed or a warning; empty: there are none.
    free_until
        Time for which a motion by hand without a shown path, if it continues, is free of contact, s; inf: as far as it
        is predicted.
    """

    stop: bool = False
    monitor_speed: float = 1.0
    text: str = ""
    beep: bool = False
    pair: tuple[str, ...] = ()
    free_until: float = np.inf


class Guard:
    """Guards the robot of one cell; `guard_of` makes one from descriptions.

    Parameters
    ----------
    nominal
        The nominal cell of the guard, measured space included (`nominal_cell`).
    robot
        Description of the robot (``CellDescription.robot``): the limits of jogging.
    settings
        The worst case; None: the defaults of `GuardSettings`.
    ignored
        Pairs of names of bodies, in either order, that are not compared.
    movable
        Numbers of the parts, from 1, that are only where a state places them.

    Attributes
    ----------
    settings
        The worst case.
    decision
        The last one: ``stop``, ``monitor_speed`` (0 to 1), ``text`` and ``beep`` for the pendant, and the ``pair`` of
        bodies that is its reason.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> guard = scancell.Guard(nominal, setup.cell.robot)
    >>> home = np.append(nominal.home, 0.0)  # joints and table
    >>> guard.check([home, home + 0.1]) is None
    True
    """

    @checked_arguments
    def __init__(
        self,
        nominal: NominalCell,
        robot: RobotDescription,
        settings: GuardSettings | None = None,
        ignored: Collection[tuple[str, str]] = (),
        movable: Collection[int] = (),
    ) -> None:
        self.settings = settings = settings or GuardSettings()
        self._axes, joints = len(nominal.axes), len(nominal.arm.joints)
        for key in ("noise", "angle_error"):
            if np.ndim(value := getattr(settings, key)) and len(value) != self._axes:
                raise DescriptionError(key=key, value=value, expected=f"one number, or {self._axes} for all axes")
        further = [f"axis.{axis.name}" for axis in nominal.further_axes]
        self._names = [*(f"q[{i}]" for i in range(1, joints + 1)), "table", *further]
        self._prismatic = axis_bits(nominal.prismatic)
        self._digest = axes_digest(self._names, self._prismatic)
        meshes = {body.name: reduced(body.mesh, _MAX_FACES, settings.mesh_error) for body in nominal.bodies}
        bodies = tuple(replace(body, mesh=meshes[body.name].mesh, patches=()) for body in nominal.bodies)
        self._nominal, self._limits = replace(nominal, bodies=bodies), jog_limits(robot, nominal)
        self._errors = {name: found.error for name, found in meshes.items()}
        self._ignored = [frozenset(pair) for pair in ignored]
        self._movable = {"part" if number == 1 else f"part[{number}]": number for number in movable}
        self._identifier = Identifier(nominal, settings.noise)
        self._parts: tuple[PlacedPart, ...] = ()
        self._near: NearPairs | None = None
        self._place(())
        self.reset()

    def _place(self, parts: tuple[PlacedPart, ...]) -> None:
        """Make the checks of a cell with its movable parts at the poses of `parts`, without those not placed."""
        settings, nominal = self.settings, self._with_parts(parts)
        scene = cell_scene(nominal, {body.name: body.mesh for body in nominal.bodies}).without(self._ignored)
        errors = np.array([self._errors[a] + self._errors[b] for a, b in scene.pairs])
        clearance = 2 * settings.position_error + errors
        deceleration = settings.deceleration * nominal.axis_max_acceleration
        angle_error = np.broadcast_to(np.asarray(settings.angle_error, float), (self._axes,))
        age, delay, limits = settings.latency + settings.max_age, 2 * settings.cycle, self._limits
        worst = WorstCase(age, 0.0, delay, deceleration, angle_error, limits)
        near = NearPairs(nominal, scene.pairs, clearance, angle_error)
        if self._near is not None:
            near.take_over(self._near)
        self._parts, self._near = parts, near
        self._manual = ManualCheck(nominal, scene, near, worst, settings.horizon)
        self._free_path = FreePath(nominal, scene, near)
        self._jogs = JogCheck(nominal, self._free_path, settings.reaction, deceleration, limits)
        self._automatic = PathCheck(self._free_path, settings.reaction, deceleration)
        self._motions = MotionCheck(nominal, scene, clearance, settings.threads)

    def _with_parts(self, parts: tuple[PlacedPart, ...]) -> NominalCell:
        placed = {part.number: part for part in parts}
        bodies = []
        for body in self._nominal.bodies:
            number = self._movable.get(body.moves_with)
            if number is None:
                bodies.append(body)
            elif number in placed:
                position, quaternion = np.split(np.array(placed[number].pose), [3])
                at = pose.from_rotation(pose.rotation_from_quaternion(quaternion), position)
                carrier = carriers(self._nominal)[placed[number].carrier]
                bodies.append(replace(body, moves_with=carrier, mesh=body.mesh.transformed(at)))
        return replace(self._nominal, bodies=tuple(bodies))

    def reset(self) -> None:
        """Forget all states: a session begins. What pairs within their clearance have to keep stays."""
        self._number = 0
        self._time = 0.0  # of the last state
        self._operation: Operation | None = None
        self._states: deque[MeasuredState] = deque(maxlen=_STATES)
        assert self._near is not None
        self._near.begin_session()
        self._moving = 0  # states since the robot was at rest
        self._speeds: deque[tuple[float, float]] = deque()
        self._stopping = False
        self.decision = Decision()

    def renewed(self) -> Guard:
        """A guard of the same cell that knows nothing of the past, without the time that a first one takes.

        Examples
        --------
        >>> setup = scancell.load_setup()
        >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
        >>> scancell.Guard(nominal, setup.cell.robot).renewed().decision.stop
        False
        """
        guard = copy(self)
        guard._near = None
        guard._place(())
        guard.reset()
        return guard

    def check(self, points: ArrayLike) -> MotionClash | None:
        """None if a motion is proved free of contact, else a point of it where it is not.

        Parameters
        ----------
        points
            Set-points (n, axes) of joints, table and further axes, rad or m.

        Returns
        -------
        MotionClash or None
            Two bodies (``body_a``, ``body_b``), their ``distance`` and the ``clearance`` that they need, m, at the
            set-point ``index``, or in the motion from there on.

        Raises
        ------
        DescriptionError
            If `points` have another shape, or are not finite.
        """
        checked = checked_value("points", points, Annotated[Array, Shape((None, self._axes))])
        return self._motions.clash_along(np.asarray(checked, float))

    def answer(self, state: CellState) -> GuardMessage:
        """The permission that follows from a `state` (`GuardedCell.state`), or an emergency stop.

        Raises
        ------
        MessageError
            If the state is that of another cell.
        """
        self._require_own_axes(state)
        parts = tuple(part for part in state.parts if part.number in self._movable.values())
        if parts != self._parts:
            self._place(parts)
        if state.operation is not self._operation:
            # What is in force on a path that was taken up before is not known; of later ones no state was answered.
            before = state.time if self._operation is None else self._time
            self._states.clear()
            self._speeds = deque([(before, 1.0)])
            self._operation = state.operation
        self._time = state.time
        decision = self._by_hand(state) if state.operation is Operation.MANUAL else self._on_path(state)
        self._speeds.append((state.time, decision.monitor_speed))
        self.decision = decision
        # A stop continues until the robot is at rest; then the controller waits for a reset by an operator.
        self._stopping = decision.stop or (self._stopping and state.moving)
        self._number = (self._number + 1) % 2**32
        # The reason of a stop stays on the pendant until it is over.
        shown = "" if self._stopping and not decision.stop else decision.text
        text = shown.encode()[:MAX_TEXT].decode(errors="ignore")
        return GuardMessage(
            self._number, state.sequence, state.time, decision.monitor_speed, self._stopping, text, decision.beep
        )

    def _require_own_axes(self, state: CellState) -> None:
        """Raise `MessageError` for a state of other axes; those beside joints and table must have kinds."""
        further = self._names[self._names.index("table") + 1 :]
        if (axes := np.size(state.axes)) != self._axes:
            others = f", and {', '.join(further)}" if further else ""
            raise MessageError(key="axes", value=axes, expected=f"{self._axes}, the cell's joints and table{others}")
        if state.version == 1 and further:
            raise MessageError(key="version", value=1, expected=f"2, which has axes such as {further[0]}")
        if state.prismatic != self._prismatic:
            slides = [name for i, name in enumerate(self._names) if self._prismatic >> i & 1]
            named = f", of which {', '.join(slides)} slide" if slides else ", all revolute axes"
            raise MessageError(key="prismatic", value=state.prismatic, expected=f"{self._prismatic}{named}")
        if state.digest not in (0, self._digest):
            expected = f"{self._digest}, of {', '.join(self._names)}{'' if self._prismatic else ', revolute axes'}"
            raise MessageError(key="digest", value=state.digest, expected=expected)

    def _by_hand(self, state: CellState) -> Decision:
        axes, path = np.asarray(state.axes), _path(state)
        oldest = state.time - _STATES * self.settings.max_age
        while self._states and self._states[0].time < oldest:
            self._states.popleft()
        self._states.append(MeasuredState(state.time, axes))
        self._moving = self._moving + 1 if state.moving else 0
        if not state.moving and not _leads_away(path):
            return Decision()
        if len(path):
            return self._on_jog(state, axes, path)
        if len(self._states) < 2:
            return Decision(True, text="stop: the robot moves in an unknown way", beep=True)
        verdict = self._manual.check(self._hypotheses(), only_stop=True, begins=self._moving < _STATES)
        if not verdict.stop_is_proved:
            return _stop(verdict)
        if verdict.contacts:
            return _warning(verdict.contacts[0])
        return Decision()

    def _hypotheses(self) -> Sequence[Hypothesis]:
        """Motions to check."""
        return self._identifier.identify(list(self._states)).hypotheses

    def _on_jog(self, state: CellState, axes: Array, path: Array) -> Decision:
        exact = state.version > 1
        if not state.limits_jogs:  # it has the speed that is shown, or rests
            verdict = self._jogs.check(axes, path, state.spacing, 1.0, exact)
            if verdict.stop_is_proved:
                return Decision()
            return _jog_decision(verdict, 0.0, state.moving, state.moving)
        in_force = max(state.rate, self._allowed(state))
        verdict = self._jogs.check(axes, path, state.spacing, in_force, exact)
        stops = not verdict.stop_is_proved and in_force > 0
        slows = state.rate >= _AT_LIMIT * verdict.permitted
        return _jog_decision(verdict, verdict.permitted if verdict.stop_is_proved else 0.0, stops, slows)

    def _on_path(self, state: CellState) -> Decision:
        path = _path(state)
        if len(path) < 2 and (state.moving or state.mode is Mode.SERVO):
            return Decision(True, text="stop: no path is known", beep=True)
        if not state.moving and not _leads_away(path):
            return Decision()
        axes, in_force, exact = np.asarray(state.axes), self._allowed(state), state.version > 1
        verdict = self._automatic.check(axes, path, state.spacing, state.rate, in_force, exact)
        speed = verdict.monitor_speed
        if verdict.clash is None:
            return Decision(not verdict.stop_is_proved, speed)
        pair = verdict.clash.body_a, verdict.clash.body_b
        if not verdict.stop_is_proved:
            return Decision(True, speed, f"stop: {' - '.join(pair)}", True, pair)
        slows = speed < 1
        return Decision(False, speed, f"slowed to {speed:.0%}: {' - '.join(pair)}" if slows else "", slows, pair)

    def _allowed(self, state: CellState) -> float:
        """Largest monitor speed that may be in force on the path of a state until its answer arrives.

        The controller takes up a path at rest, and waits there for an answer to a later state.
        """
        oldest = state.time - self.settings.reaction
        while self._speeds and (self._speeds[0][0] < oldest or self._speeds[0][0] <= state.path_time):
            self._speeds.popleft()
        return max((speed for _, speed in self._speeds), default=0.0)


def _path(state: CellState) -> Array:
    """Path (n, axes), rad or m, from the time of a state on; empty if none is shown.

    In version 1 the rows begin one spacing later: a jog is continued backwards, another path begins where the axes are
    measured, so that a motion shorter than the spacing counts as one, too.
    """
    ahead = np.asarray(state.ahead)
    if state.version > 1 or not len(ahead):
        return ahead
    if state.operation is Operation.AUTOMATIC:
        return np.vstack([state.axes, ahead])
    return np.vstack([3 * ahead[0] - 3 * ahead[1] + ahead[2], ahead]) if len(ahead) > 2 else ahead


def _leads_away(path: Array) -> bool:
    """Whether a path (n, axes) is a motion."""
    return len(path) > 0 and bool(np.ptp(path, axis=0).any())


def _stop(verdict: Verdict) -> Decision:
    if not verdict.without_stop:
        return Decision(True, text="stop: the motion changes too fast", beep=True)
    near = verdict.without_stop[0]
    pair = near.body_a, near.body_b
    return Decision(True, 1.0, f"stop: {' - '.join(pair)}: {near.distance * 1e3:.0f} mm", True, pair)


def _jog_decision(verdict: JogVerdict, speed: float, stops: bool, slows: bool) -> Decision:
    """An emergency stop, or the permitted speed of a jog; the bodies that it approaches are named in any case."""
    word = "stop" if stops else "slowed" if speed else "no jog"
    clash = verdict.clash
    if clash is None:
        return Decision(stops, speed, "" if speed == 1 else f"{word}: the motion changes too fast", speed < 1)
    pair = clash.body_a, clash.body_b
    near = f"{' - '.join(pair)}: {verdict.distance * 1e3:.0f} mm"
    return Decision(stops, speed, f"{word}: {near}" if stops or slows else near, stops or slows, pair)


def _warning(contact: Contact) -> Decision:
    found = contact.approach
    pair = found.body_a, found.body_b
    text = f"{' - '.join(pair)}: {found.distance * 1e3:.0f} mm, contact in {contact.free_until:.2f} s"
    return Decision(text=text, beep=contact.free_until < _BEEP, pair=pair, free_until=contact.free_until)
