"""A live cell: commands of operators, its states, and what the guard and a lost operator do to it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from scancell import Scanner
from scancell.cell.controller import JogFrame, Operation
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.live.cell import LiveCell
from scancell.live.commands import (
    CloseGripper,
    Command,
    JogJoints,
    JogSensor,
    MoveJoints,
    MoveLine,
    MoveTool,
    OpenGripper,
    Reset,
    RunConveyor,
    SetMonitorSpeed,
    SetOperation,
)
from scancell.live.state import LiveState
from scancell.programs.robot import deg, location, mm
from scancell.stopwatch import Pace

ABOVE = location(450 * mm, 0, 260 * mm, rx=180 * deg)
BELT = (
    'cell.conveyor=[{ name = "belt", pose = { x_mm = 300, y_mm = -400, z_mm = 100 }, length_mm = 300, width_mm = 100 }]'
)
HOLD_TIME = 0.3


class Clock:
    """Advances when `now` is set."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Operator:
    """A live cell whose clock goes on with its cycles, as on a machine in time."""

    def __init__(self, live: LiveCell, clock: Clock, period: float) -> None:
        self.live, self.clock, self.period = live, clock, period
        self.states: list[LiveState] = []

    def cycle(self, count: int = 1, *commands: Command) -> LiveState:
        for _ in range(count):
            for command in commands:
                self.live.submit(command)
            self.live.step()
            self.clock.now += self.period
            self.states.append(self.live.state)
        return self.live.state

    def until(self, condition: Callable[[LiveState], bool], *commands: Command) -> LiveState:
        for _ in range(1500):
            if condition(state := self.cycle(1, *commands)):
                return state
        raise AssertionError(f"the condition never held: {self.live.state}")

    def rests(self) -> LiveState:
        self.cycle(2)
        return self.until(lambda state: not state.moving)

    def at(self, target: np.ndarray = ABOVE) -> None:
        self.live.submit(MoveTool(target))
        self.cycle(4)
        self.rests()

    @property
    def touched(self) -> bool:
        return any(state.colliding for state in self.states)


@pytest.fixture(scope="module")
def scanner() -> Iterator[Scanner]:
    with Scanner(setup=load_setup(settings=[BELT], ideal=True), threads=1) as made:
        yield made


@pytest.fixture
def operator(scanner: Scanner) -> Iterator[Operator]:
    with scanner.session(guarded=True) as session:
        clock = Clock()
        made = Operator(LiveCell(session, HOLD_TIME, clock), clock, session.cycle)
        made.cycle(8)
        yield made


def test_moves_run_one_after_another(operator: Operator) -> None:
    start = operator.live.state.joints
    first, second = start + 0.1, start + np.array([0.2, 0, 0.1, 0, 0, 0])
    operator.live.submit(MoveJoints(first, table_angle=0.5))
    operator.live.submit(MoveJoints(second))
    operator.cycle(4)
    np.testing.assert_array_equal(operator.live.state.destination[:-1], first)
    operator.until(lambda state: np.array_equal(state.destination[:-1], second))
    state = operator.rests()
    np.testing.assert_allclose(state.joints, second, atol=1e-9)
    assert state.table_angle == pytest.approx(0.5, abs=1e-9)
    passed = min(np.abs(state.joints - first).max() for state in operator.states)
    assert passed < 1e-9


def test_tool_pose_round_trip_and_straight_line(operator: Operator) -> None:
    operator.at()
    operator.states.clear()
    end = ABOVE @ pose.from_euler_xyz((0.05, -0.03, -0.02), (0.1, -0.05, 0.2))
    operator.live.submit(MoveLine(end, speed=0.5))
    operator.rests()
    operator.rests()
    sensor = np.array([state.world_from_body["sensor"] for state in operator.states])
    np.testing.assert_allclose(sensor[-1], end, atol=1e-6)
    along = end[:3, 3] - ABOVE[:3, 3]
    fraction = (sensor[:, :3, 3] - ABOVE[:3, 3]) @ along / (along @ along)
    straight = pose.interpolate_straight(ABOVE, end, fraction)
    np.testing.assert_allclose(sensor, straight, atol=1e-5)
    np.testing.assert_allclose(operator.live.state.world_from_body_at_destination["sensor"], end, atol=1e-6)


def test_unreachable_target_leaves_the_arm_where_it_is(operator: Operator) -> None:
    start = operator.live.state.joints
    operator.live.submit(MoveTool(location(3, 0, 0)))
    operator.live.submit(MoveJoints(start + 0.1))
    state = operator.cycle(20)
    assert "the sensor cannot be brought to (3000.0, 0.0, 0.0) mm" in state.message
    np.testing.assert_allclose(state.joints, start, atol=1e-12)
    operator.live.submit(MoveLine(pose.translation((0, 0, 2.0)) @ state.world_from_body["sensor"]))
    operator.cycle(20)
    assert "out of reach" in operator.live.state.refusal
    np.testing.assert_allclose(operator.live.state.joints, start, atol=1e-12)


def test_move_into_table_is_slowed_and_held(operator: Operator) -> None:
    operator.at()
    operator.live.submit(MoveLine(pose.translation((0, 0, -0.2)) @ ABOVE))
    operator.cycle(4)
    state = operator.until(lambda state: state.guard_text.startswith("slowed to 0%"))
    assert "sensor - table" in state.guard_text
    state = operator.cycle(60)
    assert (state.monitor_speed, state.monitor_speed_in_force) == (1.0, 0.0)
    assert state.nearest is not None
    assert set(state.nearest[:2]) == {"sensor", "table"}
    assert state.nearest[2] > 0
    assert 0 < state.progress < 1
    assert not operator.touched
    operator.live.emergency_stop()
    operator.rests()
    operator.live.submit(Reset())
    operator.at()
    np.testing.assert_allclose(operator.live.state.world_from_body["sensor"], ABOVE, atol=1e-6)


def test_jog_into_table_is_warned_then_stopped(operator: Operator) -> None:
    operator.at()
    operator.live.submit(SetOperation(Operation.MANUAL))
    down = JogSensor([0, 0, -1, 0, 0, 0])
    operator.until(lambda state: state.controller == "emergency stop", down)
    texts = [state.guard_text for state in operator.states]
    warned = next(i for i, text in enumerate(texts) if "contact in" in text)
    stopped = next(i for i, text in enumerate(texts) if text.startswith("stop: sensor - table"))
    assert warned < stopped
    assert any(state.pendant_beep for state in operator.states)
    operator.cycle(30, down)
    assert operator.live.state.controller == "emergency stop"
    assert not operator.touched


def test_jog_that_is_not_renewed_stops(operator: Operator) -> None:
    """Within the hold time, and the controller's time to brake."""
    operator.live.submit(SetOperation(Operation.MANUAL))
    operator.cycle(12)
    assert "expected at most 7 numbers" in operator.cycle(1, JogJoints([0.1] * 8)).message
    jog = JogJoints([0.5, 0, 0, 0, 0, 0, 0])
    operator.cycle(60, jog)
    renewed = operator.live.state
    assert renewed.controller == "moving"
    state = operator.cycle(round(HOLD_TIME / operator.period) - 2)
    assert state.controller == "moving"
    last = operator.rests()
    assert state.joints[0] > renewed.joints[0] + 0.01
    assert last.time - renewed.time < HOLD_TIME + 0.3
    resting = operator.cycle(30)
    np.testing.assert_allclose(resting.joints, last.joints, atol=1e-9)
    assert operator.cycle(5, jog).controller == "moving"


def test_frozen_clock_of_jog_is_the_operators_not_the_cells(operator: Operator) -> None:
    """Simulated time may be faster than the wall clock: the hold time is one of the wall clock."""
    operator.live.submit(SetOperation(Operation.MANUAL))
    operator.cycle(12)
    operator.live.submit(JogSensor([0.2, 0, 0, 0, 0, 0], JogFrame.SENSOR))
    begin = operator.clock.now
    for _ in range(60):
        operator.cycle()
        operator.clock.now = begin
    assert operator.live.state.controller == "moving"
    operator.clock.now = begin + HOLD_TIME
    operator.rests()


def test_jog_needs_manual_operation(operator: Operator) -> None:
    state = operator.cycle(5, JogJoints([1.0, 0, 0, 0, 0, 0, 0]))
    assert state.message == "jog_joints: the cell is in automatic operation: change to manual operation first"
    assert state.controller == "at rest"
    operator.live.submit(MoveJoints(state.joints + 0.3, speed=0.2))
    operator.cycle(20)
    operator.live.submit(SetOperation(Operation.MANUAL))
    operator.until(lambda state: state.operation is Operation.MANUAL)
    operator.until(lambda state: state.controller == "moving", JogJoints([0, 0.2, 0, 0, 0, 0, 0]))


def test_stop_drops_what_was_submitted(operator: Operator) -> None:
    start = operator.live.state.joints
    operator.live.submit(MoveJoints(start + 0.6, speed=0.3))
    moving = operator.cycle(25)
    assert moving.controller == "moving"
    operator.live.submit(MoveJoints(start))
    operator.live.submit(SetMonitorSpeed(0.5))
    operator.live.emergency_stop()
    stopped = operator.rests()
    assert stopped.controller == "emergency stop"
    assert np.abs(stopped.joints - start).max() < 0.55
    assert operator.cycle(10).monitor_speed == 1.0
    operator.live.submit(MoveJoints(start))
    assert "emergency stop is in force" in operator.cycle(3).refusal
    operator.live.submit(Reset())
    np.testing.assert_allclose(operator.cycle(30).joints, stopped.joints, atol=1e-9)
    operator.live.submit(MoveJoints(start))
    operator.cycle(4)
    np.testing.assert_allclose(operator.rests().joints, start, atol=1e-9)


def test_monitor_speed_acts_on_running_move(operator: Operator) -> None:
    operator.live.submit(MoveJoints(operator.live.state.joints + 0.5, speed=0.3))
    operator.cycle(20)
    operator.live.submit(SetMonitorSpeed(0.0))
    paused = operator.cycle(30).joints
    np.testing.assert_allclose(operator.cycle(20).joints, paused, atol=1e-9)
    operator.live.submit(SetMonitorSpeed(1.0))
    operator.until(lambda state: state.progress == 1)


def test_devices_and_wrong_commands(operator: Operator) -> None:
    operator.live.submit(RunConveyor(1, 0.1))
    state = operator.cycle(30)
    speed, travel = state.conveyors[0]
    assert speed == pytest.approx(0.1)
    assert travel > 0.02
    assert "run_conveyor: conveyor = 2: expected 1 to 1" in operator.cycle(1, RunConveyor(2, 0.1)).message
    for command in (OpenGripper(0.02), CloseGripper(5.0)):
        assert operator.cycle(1, command).message == "the cell has no gripper"
    assert "expected 6 angles" in operator.cycle(1, MoveJoints([0.0, 1.0])).message
    assert operator.cycle(1, RunConveyor(1, 0.0)).message == ""


@pytest.mark.parametrize(
    "make",
    [
        lambda: JogJoints([2.0, 0]),
        lambda: JogSensor([0.0, 0, 0]),
        lambda: JogJoints([np.nan] * 7),
        lambda: MoveJoints("home"),
        lambda: MoveJoints([0.0] * 6, speed=0.0),
        lambda: MoveJoints([0.0] * 6, table_angle=np.inf),
        lambda: MoveTool(np.eye(3)),
        lambda: MoveTool(2 * np.eye(4)),
        lambda: MoveLine(np.diag([1.0, 1, -1, 1])),
        lambda: MoveLine(np.eye(4), speed=1.1),
        lambda: SetMonitorSpeed(1.1),
        lambda: SetMonitorSpeed("1"),
        lambda: OpenGripper(-0.01),
        lambda: CloseGripper(float("inf")),
        lambda: RunConveyor(1, float("nan")),
    ],
)
def test_malformed_command_is_refused_where_it_is_made(make: Callable[[], Command]) -> None:
    with pytest.raises(DescriptionError, match="expected"):
        make()


def test_states_are_immutable(operator: Operator) -> None:
    state = operator.cycle(1)
    assert set(state.world_from_body) == {
        *(f"link{i}" for i in range(1, 7)),
        "base",
        "sensor",
        "table",
        "table_base",
        "belt",
    }
    with pytest.raises(ValueError, match="read-only"):
        state.joints[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        state.world_from_body["sensor"][0, 0] = 1.0
    with pytest.raises(TypeError):
        state.world_from_body["sensor"] = np.eye(4)  # type: ignore[index]
    before = state.joints.copy()
    operator.live.submit(MoveJoints(before + 0.2))
    operator.cycle(20)
    np.testing.assert_array_equal(state.joints, before)


def test_commands_from_other_threads(scanner: Scanner) -> None:
    """One thread steps the cell as fast as it can; the others command it."""
    with scanner.session(guarded=True) as session:
        live = LiveCell(session, state_cycles=2)
        start, ended, arrived = live.state.joints, threading.Event(), threading.Event()

        def check() -> bool:
            if live.state.progress == 1 and live.state.destination[0] > start[0]:
                arrived.set()
            return ended.is_set()

        thread = threading.Thread(target=live.run, args=(check, False))
        thread.start()
        try:
            speeds = [threading.Thread(target=live.submit, args=(SetMonitorSpeed(0.5 + 0.1 * i),)) for i in range(5)]
            for one in speeds:
                one.start()
            live.submit(MoveJoints(start + 0.1))
            assert arrived.wait(120)
        finally:
            ended.set()
            thread.join()
        np.testing.assert_allclose(live.state.joints, start + 0.1, atol=1e-9)


def test_pace_catches_up_less_than_a_period() -> None:
    clock, slept = Clock(), []

    def sleep(duration: float) -> None:
        slept.append(duration)
        clock.now += duration

    pace = Pace(0.5, clock, sleep)
    pace.wait()
    clock.now += 0.2
    pace.wait()
    clock.now += 0.6
    pace.wait()
    pace.wait()
    np.testing.assert_allclose(slept, [0.5, 0.3, 0.4])
    clock.now += 2.0
    for _ in range(3):
        pace.wait()
    np.testing.assert_allclose(slept, [0.5, 0.3, 0.4, 0.5])
