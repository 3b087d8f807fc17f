"""A live cell: commands of operators, its states, and what the guard and a lost operator do to it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from live_cells import PATIENCE, SteppedCell, running

from scancell import Scanner
from scancell.cell.driver import JogFrame, Operation
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.live.cell import LiveCell
from scancell.live.state import (
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
from scancell.programs.robot import deg, location, mm
from scancell.progress import Pace

ABOVE = location(450 * mm, 0, 260 * mm, rx=180 * deg)
HOLD_TIME = 0.3
BELT = (
    'cell.conveyor=[{ name = "belt", pose = { x_mm = 300, y_mm = -400, z_mm = 100 }, length_mm = 300, width_mm = 100 }]'
)


@pytest.fixture(scope="module")
def scanner() -> Iterator[Scanner]:
    with Scanner(setup=load_setup(settings=[BELT], ideal=True), threads=1) as made:
        yield made


@pytest.fixture
def operator(scanner: Scanner) -> Iterator[SteppedCell]:
    with scanner.session(guarded=True) as session:
        yield SteppedCell(session, HOLD_TIME)


def test_moves_run_one_after_another(operator: SteppedCell) -> None:
    start = operator.live.state.joints
    first, second = start + 0.1, start + np.array([0.2, 0, 0.1, 0, 0, 0])
    operator.live.submit(MoveJoints(first, table_angle=0.5))
    operator.live.submit(MoveJoints(second))
    operator.cycle(4)
    state = operator.live.state
    np.testing.assert_array_equal(state.destination[:-1], first)
    expected = operator.session.nominal.frame_poses([*first, 0.5])["sensor"]
    np.testing.assert_allclose(state.world_from_body_at_destination["sensor"], expected, atol=1e-9)
    operator.until(lambda state: np.array_equal(state.destination[:-1], second))
    state = operator.rests()
    np.testing.assert_allclose(state.joints, second, atol=1e-9)
    assert state.table_angle == pytest.approx(0.5, abs=1e-9)
    passed = min(np.abs(state.joints - first).max() for state in operator.states)
    assert passed < 1e-9


def test_unreachable_target_leaves_the_arm_where_it_is(operator: SteppedCell) -> None:
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


def test_move_into_table_is_slowed_and_held(operator: SteppedCell) -> None:
    operator.at(ABOVE)
    operator.live.submit(MoveLine(pose.translation((0, 0, -0.2)) @ ABOVE))
    operator.cycle(4)
    state = operator.until(lambda state: state.guard_text.startswith("slowed to 0%"))
    slows = [bool(state.guard_text) for state in operator.states]
    assert [state.pendant_beep for state in operator.states[1:]] == slows[:-1]  # a step later
    assert not slows[0]
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
    operator.at(ABOVE)
    np.testing.assert_allclose(operator.live.state.world_from_body["sensor"], ABOVE, atol=1e-6)


def test_jog_into_table_slows_down_and_rests(operator: SteppedCell) -> None:
    operator.at(ABOVE)
    operator.live.submit(SetOperation(Operation.MANUAL))
    down = JogSensor([0, 0, -1, 0, 0, 0])
    held = operator.until(lambda state: state.guard_text.startswith("no jog: sensor - table: "), down)
    assert held.guarded_pair == ("sensor", "table")
    texts = [state.guard_text for state in operator.states]
    slowed = next(i for i, text in enumerate(texts) if text.startswith("slowed: "))
    assert texts[slowed].endswith(" mm")
    assert any(state.pendant_beep for state in operator.states)
    assert not any(state.controller == "emergency stop" for state in operator.states)
    joints = operator.cycle(30, down).joints
    np.testing.assert_allclose(joints, held.joints, atol=1e-4)
    assert not operator.touched


def test_jog_that_is_not_renewed_stops(operator: SteppedCell) -> None:
    """Within the hold time, and the controller's time to brake."""
    operator.live.submit(SetOperation(Operation.MANUAL))
    operator.cycle(12)
    assert "expected at most 7 numbers" in operator.cycle(1, JogJoints([0.1] * 8)).message
    jog = JogJoints([0.5, 0, 0, 0, 0, 0, 0])
    operator.cycle(60, jog)
    renewed = operator.live.state
    assert renewed.controller == "moving"
    state = operator.cycle(round(HOLD_TIME / operator.session.cycle) - 2)
    assert state.controller == "moving"
    last = operator.rests()
    assert state.joints[0] > renewed.joints[0] + 0.01
    assert last.time - renewed.time < HOLD_TIME + 0.3
    resting = operator.cycle(30)
    np.testing.assert_allclose(resting.joints, last.joints, atol=1e-9)
    assert operator.cycle(5, jog).controller == "moving"


def test_hold_time_of_a_jog_is_wall_clock_time(operator: SteppedCell) -> None:
    """Simulated time may be faster than the wall clock: the hold time is one of the wall clock."""
    operator.live.submit(SetOperation(Operation.MANUAL))
    operator.cycle(12)
    operator.live.submit(JogSensor([0.2, 0, 0, 0, 0, 0], JogFrame.SENSOR))
    begin = operator.now
    for _ in range(60):
        operator.cycle()
        operator.now = begin
    assert operator.live.state.controller == "moving"
    operator.now = begin + HOLD_TIME
    operator.rests()


def test_jog_needs_manual_operation(operator: SteppedCell) -> None:
    state = operator.cycle(5, JogJoints([1.0, 0, 0, 0, 0, 0, 0]))
    assert state.message == "jog_joints: the cell is in automatic operation: change to manual operation first"
    assert state.controller == "at rest"
    operator.live.submit(MoveJoints(state.joints + 0.3, speed=0.2))
    operator.cycle(20)
    operator.live.submit(SetOperation(Operation.MANUAL))
    operator.until(lambda state: state.operation is Operation.MANUAL)
    operator.until(lambda state: state.controller == "moving", JogJoints([0, 0.2, 0, 0, 0, 0, 0]))


def test_stop_drops_what_was_submitted(operator: SteppedCell) -> None:
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


def test_monitor_speed_acts_on_running_move(operator: SteppedCell) -> None:
    operator.live.submit(MoveJoints(operator.live.state.joints + 0.5, speed=0.3))
    operator.cycle(20)
    operator.live.submit(SetMonitorSpeed(0.0))
    paused = operator.cycle(30).joints
    np.testing.assert_allclose(operator.cycle(20).joints, paused, atol=1e-9)
    operator.live.submit(SetMonitorSpeed(1.0))
    operator.until(lambda state: state.progress == 1)


def test_devices_and_wrong_commands(operator: SteppedCell) -> None:
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
    ("command", "arguments"),
    [
        (JogJoints, ([2.0, 0],)),
        (JogJoints, ([np.nan] * 7,)),
        (JogSensor, ([0.0, 0, 0],)),
        (MoveJoints, ("home",)),
        (MoveJoints, ([0.0] * 6, np.inf)),
        (MoveJoints, ([0.0] * 6, None, 0.0)),
        (MoveTool, (np.eye(3),)),
        (MoveTool, (2 * np.eye(4),)),
        (MoveLine, (np.diag([1.0, 1, -1, 1]),)),
        (SetMonitorSpeed, (1.1,)),
        (SetMonitorSpeed, ("1",)),
        (OpenGripper, (-0.01,)),
        (CloseGripper, (float("inf"),)),
        (RunConveyor, (1, float("nan"))),
    ],
)
def test_malformed_command_is_refused_where_it_is_made(command: Callable[..., Command], arguments: tuple) -> None:
    with pytest.raises(DescriptionError, match="expected"):
        command(*arguments)


def test_states_are_immutable(operator: SteppedCell) -> None:
    state = operator.cycle(1)
    links = {f"link{i}" for i in range(1, 7)}
    assert set(state.world_from_body) == {*links, "base", "sensor", "table", "table_base", "belt"}
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
    with scanner.session(guarded=True) as session, running(LiveCell(session, state_cycles=2)) as live:
        start = live.state.joints
        speeds = [threading.Thread(target=live.submit, args=(SetMonitorSpeed(0.5 + 0.1 * i),)) for i in range(5)]
        for one in speeds:
            one.start()
        live.submit(MoveJoints(start + 0.1))
        # A job waits until the move has ended.
        arrived = live.perform(lambda moved: moved.joints).result(PATIENCE)
        np.testing.assert_allclose(arrived, start + 0.1, atol=1e-9)


def test_pace_catches_up_less_than_a_period() -> None:
    now, slept = [100.0], []

    def sleep(duration: float) -> None:
        slept.append(duration)
        now[0] += duration

    pace = Pace(0.5, lambda: now[0], sleep)
    for busy in (0.0, 0.2, 0.6, 0.0):
        now[0] += busy
        pace.wait()
    np.testing.assert_allclose(slept, [0.5, 0.3, 0.4])
    now[0] += 2.0
    for _ in range(3):
        pace.wait()
    np.testing.assert_allclose(slept, [0.5, 0.3, 0.4, 0.5])
