"""The guard of a robot: answers each of its states with a permission to move on, or with an emergency stop.

An answer permits motion until its state is `max_age` old; then the controller stops by itself.  So a stop is proved for
each answer as if it were the last one: even if all later messages are lost, the robot stops without contact.
Where no stop is proved, the answer is an emergency stop, and the proof of an earlier answer holds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import Shape, checked_arguments, checked_value
from scancell.cell.controller import Mode, Operation
from scancell.config.robot import RobotDescription
from scancell.errors import MessageError
from scancell.geometry import pose
from scancell.geometry.reduction import reduced
from scancell.guard.check import Contact, ManualCheck, Verdict
from scancell.guard.free_path import FreePath
from scancell.guard.identify import Identifier
from scancell.guard.jog_check import JogCheck, JogVerdict
from scancell.guard.messages import MAX_TEXT, CellState, GuardMessage, PlacedPart, axes_digest
from scancell.guard.motion import Hypothesis, MeasuredState
from scancell.guard.near import NearPairs
from scancell.guard.path_check import PathCheck, PathVerdict
from scancell.guard.settings import GuardSettings
from scancell.guard.stopping import WorstCase
from scancell.guard.unseen import jog_limits
from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_check import MotionCheck, MotionClash
from scancell.proximity.scene import cell_scene

Array = NDArray[np.float64]

_MAX_FACES = 400
_STATES = 3
_BEEP = 0.5  # s to a contact
_AT_LIMIT = 0.9  # of the permitted speed, from which on a jog counts as slowed


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
    """

    stop: bool = False
    monitor_speed: float = 1.0
    text: str = ""
    beep: bool = False
    pair: tuple[str, ...] = ()


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
        self._axes = len(nominal.arm.joints) + 1
        self._names = [*(f"q[{i}]" for i in range(1, self._axes)), "table"]
        self._digest = axes_digest(self._names)
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
                carrier = self._carrier(placed[number])
                bodies.append(replace(body, moves_with=carrier, mesh=body.mesh.transformed(at)))
        return replace(self._nominal, bodies=tuple(bodies))

    def _carrier(self, part: PlacedPart) -> str:
        if part.carrier in (0, self._axes):
            return "table" if part.carrier else "world"
        return f"link[{part.carrier}]"

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

    def check(self, points: ArrayLike) -> MotionClash | None:
        """None if a motion is proved free of contact, else a point of it where it is not.

        Parameters
        ----------
        points
            Set-points of joints and table (n, axes), rad.

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
        if (axes := np.size(state.axes)) != self._axes:
            raise MessageError(key="axes", value=axes, expected=f"{self._axes}, the cell's joints and table")
        if state.prismatic or state.digest not in (0, self._digest):
            raise MessageError(
                key="digest", value=state.digest, expected=f"{self._digest}, of {', '.join(self._names)}, revolute axes"
            )
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

    def _by_hand(self, state: CellState) -> Decision:
        axes, path = np.asarray(state.axes), _path(state)
        oldest = state.time - _STATES * self.settings.max_age
        while self._states and self._states[0].time < oldest:
            self._states.popleft()
        self._states.append(MeasuredState(state.time, axes[:-1], float(axes[-1])))
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
        verdict = self._path_verdict(state, path)
        speed = verdict.monitor_speed
        if verdict.clash is None:
            return Decision(not verdict.stop_is_proved, speed)
        pair = verdict.clash.body_a, verdict.clash.body_b
        if not verdict.stop_is_proved:
            return Decision(True, speed, f"stop: {' - '.join(pair)}", True, pair)
        slows = speed < 1
        return Decision(False, speed, f"slowed to {speed:.0%}: {' - '.join(pair)}" if slows else "", slows, pair)

    def _path_verdict(self, state: CellState, path: Array) -> PathVerdict:
        axes, exact = np.asarray(state.axes), state.version > 1
        return self._automatic.check(axes, path, state.spacing, state.rate, self._allowed(state), exact)

    def _allowed(self, state: CellState) -> float:
        """Largest monitor speed that may be in force on the path of a state until its answer arrives.

        The controller takes up a path at rest, and waits there for an answer to a later state.
        """
        oldest = state.time - self.settings.reaction
        while self._speeds and (self._speeds[0][0] < oldest or self._speeds[0][0] <= state.path_time):
            self._speeds.popleft()
        return max((speed for _, speed in self._speeds), default=0.0)


def _path(state: CellState) -> Array:
    """Path (n, axes), rad, from the time of a state on; empty if none is shown.

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
    return Decision(text=text, beep=contact.free_until < _BEEP, pair=pair)
