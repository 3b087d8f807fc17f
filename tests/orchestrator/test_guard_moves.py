"""Moves under a guard in automatic operation: a model of the worst controller, late and lost answers, walls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from guard_walls import boxes, distances, near_home, square, straight

from guard_motions import NOISE, POLL
from scancell.cell.driver import Mode, Operation
from scancell.config.loading import load_setup
from scancell.guard.check import RATE_SLOPE
from scancell.guard.guard import Guard, GuardSettings
from scancell.guard.messages import CellState, GuardMessage
from scancell.nominal.cell import NominalCell
from scancell.proximity.scene import ProximityScene

SETTINGS = GuardSettings(noise=NOISE, angle_error=5 * NOISE)
ROBOT = load_setup().cell.robot
AHEAD = POLL * np.arange(33)
NEAR = 0.003, 0.02  # m: gaps that a robot at full speed cannot stop in
BEGIN = 10  # polls at rest before the move


@dataclass(frozen=True)
class Move:
    """From `start` (joints + 1,), rad, on at constant `rates` (rad/s), after a ramp of speed, for `length` s."""

    start: np.ndarray
    rates: np.ndarray
    length: float = np.inf

    @property
    def braking(self) -> float:
        """s that the slowest axis needs to brake from full speed."""
        return float((np.abs(self.rates) / (SETTINGS.deceleration * boxes().axis_max_acceleration)).max())

    def at(self, clock: np.ndarray) -> np.ndarray:
        """Axes (n, joints + 1) at values of the path clock; ramps need a quarter of the deceleration."""
        rise = 4 * self.braking
        gone = np.minimum(np.asarray(clock, float), self.length)
        travelled = np.where(gone < rise, gone**2 / (2 * rise), gone - rise / 2)
        return self.start + travelled[:, None] * self.rates


@dataclass
class Robot:
    """Goes on for the whole reaction time after the last answered state, where a true one would slow down before."""

    move: Move
    path_time: float
    answered: float = -np.inf
    speed: float = 1.0
    stopped: bool = False
    clock: float = 0.0
    rate: float = 0.0
    course: list[float] = field(default_factory=list)

    def take_up(self, move: Move, time: float) -> None:
        self.move, self.path_time, self.clock, self.rate = move, time, 0.0, 0.0

    def hear(self, answer: GuardMessage) -> None:
        self.answered, self.speed = answer.state_time, answer.monitor_speed
        self.stopped |= answer.emergency_stop

    def cycle(self, time: float) -> None:
        goes = self.answered > self.path_time and time < self.answered + SETTINGS.reaction and not self.stopped
        target = self.speed if goes else 0.0
        if self.clock == 0:
            self.rate = target
        slowest = 0.75 / self.move.braking  # what the ramp leaves of the deceleration
        change = np.clip(target - self.rate, -slowest * SETTINGS.cycle, RATE_SLOPE * SETTINGS.cycle)
        self.clock += SETTINGS.cycle * (self.rate + change / 2)
        self.rate += change
        self.course.append(self.clock)


def resting(number: int, axes: np.ndarray) -> CellState:
    return CellState(number, POLL * number, Operation.AUTOMATIC, Mode.HOLD, False, axes)


def on_path(number: int, move: Move, clock: float, rate: float, path_time: float) -> CellState:
    axes = move.at(np.array([clock]))[0]
    shown = move.at(clock + AHEAD)
    moving = rate > 0
    return CellState(
        number, POLL * number, Operation.AUTOMATIC, Mode.JOINT_MOVE, moving, axes, rate, shown, POLL, path_time
    )


def drive(
    guard: Guard, move: Move, rng: np.random.Generator, silent_from: float, cycles: int = 300
) -> tuple[Robot, list[GuardMessage]]:
    """A move that begins from rest while permissive answers are under way; none arrives from `silent_from` (s) on."""
    robot = Robot(move, -1.0)
    given: list[GuardMessage] = []
    arriving: list[tuple[float, GuardMessage]] = []
    begin = BEGIN * POLL + SETTINGS.cycle
    for k in range(cycles):
        time = k * SETTINGS.cycle
        if k % 2 == 0:
            state = on_path(k // 2, robot.move, robot.clock, robot.rate, robot.path_time)
            shown = state if time > begin else resting(k // 2, move.start)
            given.append(guard.answer(replace(shown, axes=shown.axes + NOISE * rng.standard_normal(len(shown.axes)))))
            if time < silent_from and rng.random() < 0.8:
                arriving.append((time + rng.uniform(0.0, 0.1), given[-1]))
        for arrival in [arrival for arrival in arriving if arrival[0] <= time]:
            arriving.remove(arrival)
            if arrival[1].state_time > robot.answered:
                robot.hear(arrival[1])
        if k == 2 * BEGIN + 1:
            robot.take_up(move, begin)
        if time >= begin:
            robot.cycle(time)
    return robot, given


def moves(
    rng: np.random.Generator, count: int, gaps: tuple[float, float], speeds: tuple[float, float] = (0.3, 1.0)
) -> Iterator[tuple[Move, NominalCell, ProximityScene]]:
    """Moves towards walls, m/s."""
    for axes, direction, _, cell, scene in square(rng, gaps, count):
        yield Move(axes, straight(axes, float(rng.uniform(*speeds)) * direction)), cell, scene


def test_moves_stop_without_contact_whenever_the_guard_falls_silent():
    """Robots rest in front of the walls that the same motions would have hit if they had gone on."""
    rng = np.random.default_rng(71)
    began = needed = 0
    for move, cell, scene in moves(rng, 12, (0.03, 0.12)):
        for silent_from in (np.inf, float(rng.uniform(BEGIN * POLL, 1.5))):
            robot, given = drive(Guard(cell, ROBOT, SETTINGS), move, rng, silent_from)
            assert not any(answer.emergency_stop for answer in given)
            assert [answer.beep for answer in given] == [answer.monitor_speed < 1 for answer in given]
            assert robot.rate == 0.0
            assert distances(cell, scene, move.at(np.array(robot.course)), 0.05).min() > 0
            began += robot.clock > 0.05
            needed += distances(cell, scene, move.at(robot.clock + np.linspace(0, 2, 300)), 0.05).min() <= 0
    assert began >= 12
    assert needed >= 20


def test_slow_moves_rest_in_front_of_a_wall_whatever_the_noise():
    """At 1 mm/s the errors of the angles are larger than what the robot travels in a reaction time."""
    rng = np.random.default_rng(75)
    for move, cell, scene in moves(rng, 6, (0.0045, 0.006), (0.8e-3, 1.2e-3)):
        robot, given = drive(Guard(cell, ROBOT, SETTINGS), move, rng, np.inf, 900)
        assert not any(answer.emergency_stop for answer in given)
        assert robot.rate == 0.0
        assert given[-1].monitor_speed == 0.0
        left = distances(cell, scene, move.at(np.array(robot.course[-1:])), 0.05).min()
        assert 2 * SETTINGS.position_error < left < 2 * SETTINGS.position_error + 0.0015


def test_answers_from_before_a_path_do_not_permit_it():
    """Of the same states, only what they say of the path's time differs: full speed may be in force, or cannot."""
    rng = np.random.default_rng(72)
    slowed = stopped = 0
    for move, cell, _ in moves(rng, 12, NEAR):
        guard = Guard(cell, ROBOT, SETTINGS)
        assert all(guard.answer(resting(k, move.start)).monitor_speed == 1.0 for k in range(BEGIN))
        new = guard.answer(on_path(BEGIN, move, 0.0, 0.0, (BEGIN - 0.5) * POLL))
        assert not new.emergency_stop
        slowed += new.monitor_speed < 0.5
        guard.reset()
        for k in range(BEGIN):
            guard.answer(resting(k, move.start))
        old = guard.answer(on_path(BEGIN, move, 0.0, 0.0, (BEGIN - 1.5) * POLL))
        assert old.monitor_speed == new.monitor_speed
        stopped += old.emergency_stop
    assert slowed >= 6
    assert stopped >= 6


@pytest.mark.parametrize("change", [None, "session", "operation"])
def test_path_that_began_before_the_session_is_stopped(change):
    """A path that was taken up before the session, or before manual operation, may have full speed at once."""
    rng = np.random.default_rng(73)
    for move, cell, _ in moves(rng, 4, NEAR):
        guard = Guard(cell, ROBOT, SETTINGS)
        guard.answer(resting(0, move.start))
        if change == "session":
            guard.reset()
        elif change == "operation":
            guard.answer(replace(resting(2, move.start), operation=Operation.MANUAL))
        assert guard.answer(on_path(3, move, 0.0, 0.0, 0.5 * POLL)).emergency_stop == bool(change)


def test_end_of_a_move_and_rest_permit_full_speed():
    rng = np.random.default_rng(74)
    axes = near_home(rng)
    guard = Guard(boxes(), ROBOT, SETTINGS)
    move = Move(axes, 0.3 * np.eye(7)[0], 0.5)
    states = [resting(0, axes), on_path(1, move, 0.0, 0.0, 0.5 * POLL), on_path(2, move, 0.5, 0.0, 0.5 * POLL)]
    for state in states:
        answer = guard.answer(state)
        assert (answer.monitor_speed, answer.emergency_stop, answer.text) == (1.0, False, "")
