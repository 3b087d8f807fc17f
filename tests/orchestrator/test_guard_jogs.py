"""Jogs that the guard slows down: a robot on a line towards a wall, which follows the permitted speed."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from guard_walls import boxes, distances, square, straight

from guard_motions import NOISE, POLL
from scancell.cell.driver import Mode, Operation
from scancell.config.loading import load_setup
from scancell.guard.guard import Guard, GuardSettings
from scancell.guard.messages import CellState, GuardMessage
from scancell.guard.parts import jog_limits
from scancell.nominal.cell import NominalCell
from scancell.proximity.scene import ProximityScene

ROBOT = load_setup().cell.robot
SETTINGS = GuardSettings(noise=NOISE, angle_error=5 * NOISE)
CYCLE, ROWS = SETTINGS.cycle, 64
SPEED = 0.25  # m/s of the tool at full deflection


@dataclass
class Jogging:
    """A robot on a straight line at full speed `rates` (joints + 1,), rad/s; the state of a controller that jogs it.

    The answers are taken up in the order of their states, if they are not too old.
    """

    cell: NominalCell
    axes: np.ndarray
    rates: np.ndarray
    requested: float = 1.0
    share: float = 0.0
    time: float = 0.0
    answered: float = -1.0
    permitted: float = 0.0
    stopped: bool = False
    number: int = 0
    course: list[np.ndarray] = field(default_factory=list)
    slope: float = jog_limits(ROBOT, boxes()).line / SPEED

    def state(self, rng: np.random.Generator) -> CellState:
        self.number += 1
        measured = self.axes + NOISE * rng.standard_normal(len(self.axes))
        ahead = self.axes + CYCLE * np.arange(ROWS)[:, None] * self.rates
        moving = self.share > 0
        return CellState(
            self.number, self.time, Operation.MANUAL, Mode.CARTESIAN_JOG, moving, measured, self.share, ahead, CYCLE,
            0.0, limits_jogs=True,
        )  # fmt: skip

    def hear(self, answer: GuardMessage) -> None:
        if answer.state_time > self.answered and self.time - answer.state_time <= SETTINGS.max_age:
            self.answered, self.permitted = answer.state_time, answer.monitor_speed
            self.stopped |= answer.emergency_stop

    def cycle(self) -> None:
        """One cycle; a robot that brakes late, two cycles after the largest age."""
        late = self.answered >= 0 and self.time >= self.answered + SETTINGS.reaction
        target = min(self.requested, self.permitted)
        slope = self.slope
        if self.stopped or late:
            deceleration = SETTINGS.deceleration * self.cell.axis_max_acceleration
            target, slope = 0.0, float((deceleration / np.abs(self.rates).clip(1e-9)).min())
        change = float(np.clip(target - self.share, -slope * CYCLE, slope * CYCLE))
        self.axes = self.axes + CYCLE * (self.share + change / 2) * self.rates
        self.share += change
        self.time += CYCLE
        self.course.append(self.axes)


def drive(
    robot: Jogging,
    guard: Guard,
    rng: np.random.Generator,
    delay: float = 0.0,
    dies_at: float = np.inf,
    cycles: int = 300,
) -> list[GuardMessage]:
    answers: list[GuardMessage] = []
    arriving: deque[tuple[float, GuardMessage]] = deque()
    for k in range(cycles):
        if k % 2 == 0:
            answers.append(guard.answer(robot.state(rng)))
            if robot.time < dies_at:
                arriving.append((robot.time + delay, answers[-1]))
        while arriving and arriving[0][0] <= robot.time:
            robot.hear(arriving.popleft()[1])
        robot.cycle()
    return answers


def towards_walls(rng: np.random.Generator, count: int, gaps: tuple[float, float] = (0.06, 0.12)):
    for axes, direction, _, cell, scene in square(rng, gaps, count):
        yield Jogging(cell, axes, straight(axes, SPEED * direction)), scene


def least(robot: Jogging, scene: ProximityScene) -> np.ndarray:
    """Smallest distance of each pair on the course."""
    return distances(robot.cell, scene, np.array(robot.course), 0.2).min(0)


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("requested", [1.0, 0.1])
def test_jog_slows_down_and_rests_in_front_of_a_wall_without_an_emergency_stop(requested: float, delay: float) -> None:
    """At every delay of the answers, near to what the clearance and the errors of the angles leave."""
    rng = np.random.default_rng(81)
    for robot, scene in towards_walls(rng, 3, (0.06, 0.08) if requested == 1 else (0.012, 0.016)):
        robot.requested = requested
        answers = drive(robot, Guard(robot.cell, ROBOT, SETTINGS), rng, delay)
        assert not any(answer.emergency_stop for answer in answers)
        assert answers[-1].monitor_speed == 0
        assert robot.share == 0
        assert 2 * SETTINGS.position_error < least(robot, scene).min() < 0.006
        named = [answer.text for answer in answers if answer.text]
        assert all(": " in text and " mm" in text for text in named)
        assert any(text.startswith("slowed: ") for text in named)
        assert named[-1].startswith(("no jog: ", "slowed: "))


def test_robot_stops_without_contact_whenever_the_link_dies() -> None:
    """At 20 times of each approach; the next answer would have reduced the speed."""
    rng = np.random.default_rng(82)
    for robot, scene in towards_walls(rng, 2):
        for dies_at in np.linspace(0.1, 1.2, 20):
            run = replace(robot, course=[])
            drive(run, Guard(run.cell, ROBOT, SETTINGS), rng, 0.03, dies_at, 130)
            assert run.share == 0
            assert least(run, scene).min() > 2 * SETTINGS.position_error


def test_speed_that_earlier_answers_permit_counts_until_they_are_too_old() -> None:
    """A path that turns to a wall: a stop is proved for the speed that may still be in force."""
    rng = np.random.default_rng(83)
    robot, _ = next(towards_walls(rng, 1, (0.012, 0.014)))
    guard = Guard(robot.cell, ROBOT, SETTINGS)
    robot.time = POLL
    assert guard.answer(replace(robot, rates=-robot.rates).state(rng)).monitor_speed == 1
    robot.time += SETTINGS.reaction
    assert guard.answer(robot.state(rng)).emergency_stop
    robot.time += POLL
    later = guard.answer(robot.state(rng))
    assert not later.emergency_stop
    assert 0 < later.monitor_speed < 0.2


def test_answers_to_states_before_the_path_do_not_count() -> None:
    rng = np.random.default_rng(84)
    robot, _ = next(towards_walls(rng, 1, (0.012, 0.014)))
    guard = Guard(robot.cell, ROBOT, SETTINGS)
    resting = replace(robot.state(rng), ahead=(), spacing=0.0, path_time=0.0)
    assert guard.answer(resting).monitor_speed == 1
    robot.time = POLL
    shown = robot.state(rng)
    assert not guard.answer(shown).emergency_stop
    guard.reset()
    guard.answer(resting)
    assert guard.answer(replace(shown, path_time=-POLL)).emergency_stop


def test_controller_that_does_not_limit_jogs_is_permitted_the_speed_that_it_shows_or_stopped() -> None:
    rng = np.random.default_rng(85)
    for robot, _ in towards_walls(rng, 4, (0.01, 0.07)):
        states = [replace(robot.state(rng), limits_jogs=False, moving=moving) for moving in (False, True)]
        resting, moving = (Guard(robot.cell, ROBOT, SETTINGS).answer(state) for state in states)
        assert (resting.monitor_speed, resting.emergency_stop) in [(1, False), (0, False)]
        assert moving.emergency_stop == (resting.monitor_speed == 0)


@pytest.mark.parametrize("gap", [0.0008, 0.0018, 0.0026])
def test_jog_away_from_a_near_wall_is_permitted_at_full_speed(gap: float) -> None:
    """From within the clearance, and from where the errors of the angles leave no room for a stop."""
    rng = np.random.default_rng(86)
    for robot, _ in towards_walls(rng, 3, (gap, gap + 1e-5)):
        away = replace(robot, rates=-robot.rates)
        guard = Guard(robot.cell, ROBOT, SETTINGS)
        assert guard.answer(away.state(rng)).monitor_speed == 1
        assert not any(answer.emergency_stop for answer in drive(away, guard, rng, cycles=20))
        assert guard.answer(robot.state(rng)).monitor_speed < 0.01
