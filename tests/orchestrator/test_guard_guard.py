"""The guard on synthetic states: a sensor that is jogged towards walls, in a cell of boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice

import numpy as np
import pytest
from guard_walls import Square, boxes, distances, near_home, square, straight

from bench.guard_packets import extreme_states
from guard_motions import NOISE, POLL, cartesian, stopping_motion
from scancell.cell.driver import Mode, Operation
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError, MessageError
from scancell.guard.guard import Decision, Guard, GuardSettings
from scancell.guard.messages import CellState, GuardMessage
from scancell.guard.parts import UnseenApproach, jog_limits
from scancell.guard.stopping import braking_time
from scancell.nominal.cell import NominalCell

ROBOT = load_setup().cell.robot
SETTINGS = GuardSettings(noise=NOISE, angle_error=5 * NOISE)
RESTING = 3  # states before a jog begins


@cache
def deceleration() -> np.ndarray:
    return SETTINGS.deceleration * boxes().axis_max_acceleration


def guard_of(cell: NominalCell) -> Guard:
    return Guard(cell, ROBOT, SETTINGS)


def state_of(number: int, axes: np.ndarray, moving: bool = True) -> CellState:
    return CellState(number, POLL * number, Operation.MANUAL, Mode.CARTESIAN_JOG, moving, axes)


def answers(guard: Guard, states: Sequence[CellState]) -> list[tuple[GuardMessage, Decision]]:
    return [(guard.answer(state), guard.decision) for state in states]


@dataclass(frozen=True)
class Approach:
    """The tool at `speed` (m/s) along `direction` after a jog has begun, and the true axes of each poll."""

    direction: np.ndarray
    speed: float
    axes: np.ndarray

    def states(self, rng: np.random.Generator) -> list[CellState]:
        measured = self.axes + NOISE * rng.standard_normal(self.axes.shape)
        return [state_of(k, row, moving=k >= RESTING) for k, row in enumerate(measured)]


def approach_of(axes: np.ndarray, direction: np.ndarray, speed: float, way: float) -> Approach:
    """From rest at `axes` along `way` (m) at the acceleration of jogs."""
    acceleration = jog_limits(ROBOT, boxes()).line
    since = POLL * np.arange(1, int((way / speed + speed / acceleration) / POLL))
    begun = np.minimum(since, speed / acceleration)
    travel = acceleration * begun**2 / 2 + speed * (since - begun)
    joints = cartesian(boxes(), np.append(speed * direction, np.zeros(3)), False, axes[:-1], travel / speed)
    moved = np.column_stack([joints, np.full(len(joints), axes[-1])])
    return Approach(direction, speed, np.vstack([np.tile(axes, (RESTING, 1)), moved]))


def first_stop(found: Sequence[tuple[GuardMessage, Decision]]) -> int:
    return next(k for k, (message, _) in enumerate(found) if message.emergency_stop)


def towards_walls(rng: np.random.Generator, count: int) -> list[tuple[Square, Approach]]:
    """Approaches, up to contact, of walls that are farther away than a stop needs."""
    cases = square(rng, (0.09, 0.14), count)
    return [(case, approach_of(case[0], case[1], float(rng.uniform(0.05, 0.25)), case[2])) for case in cases]


def test_stops_while_the_stopping_distance_is_left_and_not_much_earlier():
    """The last permitted state leaves v T + v B / 2 and the stop from it is free; the first stopped one is needed.

    Needed: what a person may change, errors of position and angles, one poll and 20 % are all that is left of the gap.
    """
    rng = np.random.default_rng(41)
    tool = jog_limits(ROBOT, boxes())
    by_wall = 0
    for (_, direction, _, cell, scene), approach in towards_walls(rng, 12):
        found = answers(guard_of(cell), approach.states(rng))
        stop = first_stop(found)
        last = approach.axes[stop - 1]
        rates = straight(last, approach.speed * direction)
        braking = braking_time(rates, deceleration())
        way = approach.speed * (SETTINGS.reaction + braking / 2)
        left = distances(cell, scene, approach.axes[stop - 1 : stop + 1], 0.2)[:, scene.pairs.index(("sensor", "wall"))]
        assert left[0] > way
        stopping = last + stopping_motion(rates, SETTINGS.reaction, deceleration(), np.linspace(0, 1, 200))
        assert (distances(cell, scene, stopping) > 0).all()
        if found[stop][1].pair == ("sensor", "wall"):
            by_wall += 1
            limits = UnseenApproach(cell, [("sensor", "wall")], tool)
            changing = SETTINGS.reaction + POLL
            unseen = limits.bound(last, changing**2 + changing * 2 * braking)[0]
            assert left[1] < 1.2 * way + unseen + SETTINGS.position_error + 0.003
    assert by_wall >= 6


def test_warns_before_it_stops():
    """A warning names the wall with its true distance, and a time of contact that is right as far as it can see."""
    rng = np.random.default_rng(42)
    warned = 0
    for (*_, cell, scene), approach in towards_walls(rng, 6):
        found = answers(guard_of(cell), approach.states(rng))
        pair = scene.pairs.index(("sensor", "wall"))
        for k, (message, decision) in enumerate(found[: first_stop(found)]):
            if decision.pair != ("sensor", "wall") or k < RESTING + 6:  # the speed still grows
                continue
            warned += 1
            true = distances(cell, scene, approach.axes[[k]], 0.2)[0, pair]
            words = message.text.split()
            assert message.text.startswith("sensor - wall: ")
            assert float(words[3]) == pytest.approx(1e3 * true, abs=0.6)
            assert float(words[-2]) == pytest.approx(true / approach.speed, rel=0.2)
            assert message.beep == (float(words[-2]) < 0.495) or abs(float(words[-2]) - 0.5) < 0.01
    assert warned >= 10


def test_moving_away_and_rest_are_neither_warned_nor_stopped():
    """Other pairs come nearer where they are a reason, such as link 4; the sensor, which moves away, is none."""
    rng = np.random.default_rng(43)
    quiet = 0
    for axes, direction, _, cell, scene in square(rng, (0.004, 0.01), 10):
        approach = approach_of(axes, -direction, 0.15, 0.08)
        for k, (message, decision) in enumerate(answers(guard_of(cell), approach.states(rng))):
            quiet += not message.text
            assert decision.pair != ("sensor", "wall")
            if decision.pair and k >= RESTING + 3:  # the first motion is too short to know its direction
                onwards = np.arange(1, 11)[:, None] * (approach.axes[-1] - approach.axes[-2])
                future = np.vstack([approach.axes[k:], approach.axes[-1] + onwards])
                true = distances(cell, scene, future, 0.5)[:, scene.pairs.index(decision.pair)]
                assert true.min() < true[0]
        resting = [state_of(k, axes + NOISE * rng.standard_normal(7), moving=False) for k in range(5)]
        for message, _ in answers(guard_of(cell), resting):
            assert (message.emergency_stop, message.text, message.beep) == (False, "", False)
    assert quiet >= 80


def test_stop_goes_on_until_the_robot_rests():
    """Though the robot moves away from the wall after the stop."""
    rng = np.random.default_rng(44)
    (*_, cell, _), approach = towards_walls(rng, 1)[0]
    states = approach.states(rng)
    guard = guard_of(cell)
    stop = first_stop(answers(guard_of(cell), states))
    answers(guard, states[: stop + 1])
    back = [replace(state, sequence=stop + 1 + i, time=POLL * (stop + 1 + i)) for i, state in
            enumerate(reversed(states[RESTING:stop]))]  # fmt: skip
    stopped = answers(guard, back)
    assert all(message.emergency_stop for message, _ in stopped)
    assert not any(decision.stop for _, decision in stopped[3:])  # only what came before keeps it stopped
    k = stop + 1 + len(back)
    assert not guard.answer(state_of(k, back[-1].axes, moving=False)).emergency_stop
    assert not guard.answer(state_of(k + 1, back[-1].axes, moving=False)).emergency_stop


def test_answers_carry_number_and_time_of_their_states():
    rng = np.random.default_rng(45)
    guard, axes = guard_of(boxes()), near_home(rng)
    for number, time in [(7, 100.25), (9, 100.5), (2**32 - 1, 101.0), (0, 101.1)]:
        message = guard.answer(CellState(number, time, Operation.MANUAL, Mode.HOLD, False, axes))
        assert (message.state_sequence, message.state_time) == (number, time)


def test_unknown_motion_is_stopped():
    """A robot that moves in the first state of a session, of an operation, or after a pause of all states."""
    rng = np.random.default_rng(46)
    axes = near_home(rng)
    guard = guard_of(boxes())
    assert guard.answer(state_of(0, axes)).emergency_stop

    def rest_from(number: int) -> None:
        assert not any(m.emergency_stop for m, _ in answers(guard, [state_of(number + k, axes, False) for k in (0, 1)]))

    rest_from(1)
    assert not guard.answer(state_of(3, axes)).emergency_stop
    automatic = guard.answer(replace(state_of(4, axes), operation=Operation.AUTOMATIC))
    assert automatic.emergency_stop and automatic.beep
    rest_from(5)
    assert guard.answer(state_of(7 + int(4 * SETTINGS.max_age / POLL), axes)).emergency_stop


def test_reset_forgets_states_stop_and_numbers():
    rng = np.random.default_rng(47)
    axes = near_home(rng)
    guard = guard_of(boxes())
    first = guard.answer(state_of(0, axes))
    assert first.emergency_stop
    guard.reset()
    again = guard.answer(state_of(1, axes, moving=False))
    assert not again.emergency_stop
    assert again.sequence == first.sequence
    guard.reset()
    assert guard.answer(state_of(2, axes)).emergency_stop  # the state of the session before does not count


@pytest.mark.parametrize("joints", [1, 5, 7])
def test_state_of_another_cell_is_refused_and_changes_nothing(joints):
    rng = np.random.default_rng(48)
    axes = near_home(rng)
    guard = guard_of(boxes())
    answers(guard, [state_of(k, axes, moving=False) for k in range(2)])
    with pytest.raises(MessageError, match=f"axes = {joints + 1}: expected 7"):
        guard.answer(state_of(2, np.zeros(joints + 1)))
    message = guard.answer(state_of(3, axes))
    assert not message.emergency_stop
    assert message.sequence == 3


def test_motion_is_checked_before_it_is_sent():
    """Set-points through walls are refused at a place near contact, those that dense sampling finds clear are not."""
    rng = np.random.default_rng(49)
    refused = free = 0
    for axes, direction, gap, cell, scene in square(rng, (0.02, 0.05), 10):
        for way in (gap - 0.01, gap + 0.01):
            times = np.linspace(0, way / 0.1, 30)
            joints = cartesian(boxes(), np.append(0.1 * direction, np.zeros(3)), False, axes[:-1], times)
            points = np.column_stack([joints, np.full(len(joints), axes[-1])])
            dense = points[0] + np.linspace(0, 1, 40)[:, None, None] * np.diff(points, axis=0)[None]
            nearest = distances(cell, scene, (points[:-1] + dense - points[0]).reshape(-1, 7)).min()
            clash = guard_of(cell).check(points)
            if nearest <= 0:
                assert clash is not None
                assert clash.distance <= clash.clearance + 1e-3
                refused += 1
            elif nearest > 3e-3:
                assert clash is None
                free += 1
    assert refused >= 8
    assert free >= 5


@pytest.mark.parametrize("points", [np.zeros(7), np.zeros((2, 6)), np.full((2, 7), np.nan)])
def test_motion_of_another_shape_is_refused(points):
    with pytest.raises(DescriptionError, match=r"points = .*; expected finite numbers of shape"):
        guard_of(boxes()).check(points)


@pytest.mark.parametrize(("name", "value"), [("max_age", 0.0), ("angle_error", (0.0, -1e-3)), ("position_error", -1.0)])
def test_worst_case_that_cannot_be_is_refused(name, value):
    with pytest.raises(DescriptionError, match=f"{name}.* = .*: expected"):
        GuardSettings(**{name: value})


def test_states_anywhere_in_their_bounds_are_answered():
    guard, rng = guard_of(boxes()), np.random.default_rng(11)
    for _ in range(15):
        guard.reset()
        for state in islice(extreme_states(rng, joints=6), 20):
            assert guard.answer(state).state_sequence == state.sequence
