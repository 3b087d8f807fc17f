"""Jobs in a live cell: what they may do, how they are ended, and what the cell does afterwards."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from fmu_cells import CYCLE_US, EXPOSURE, moves_with_stops, turn_of_table
from live_cells import PATIENCE, SteppedCell, running

from scancell import Scanner
from scancell.cell.driver import Operation
from scancell.errors import CellError, CommandError, ProgramError
from scancell.live import cell as live_module
from scancell.live.cell import LiveCell
from scancell.live.state import Cancel, JobStopped, MoveJoints, Reset, SetMonitorSpeed, SetOperation
from scancell.programs.program import ProgramRun, run_program
from scancell.programs.robot import location, mm
from scancell.scanning.session import ScanSession

ABOVE = location(450 * mm, 0, 260 * mm, rx=np.pi)
WORDS = "from scancell import Robot, deg, location, mm\n"
STUBBORN = """
def main(robot):
    while True:
        try:
            robot.wait(1)
        except Exception:
            robot.move_home()
"""
AWAY = np.array([0.6, 0, 0, 0, 0, 0])


@pytest.fixture
def cell(ideal_scanner: Scanner) -> Iterator[SteppedCell]:
    with ideal_scanner.session(guarded=True) as session:
        yield SteppedCell(session)


def go(away: np.ndarray = AWAY) -> Callable[[ScanSession], None]:
    """A job that moves the joints from where they are."""
    return lambda session: session.move_joints(session.joints + away, speed=0.1)


def test_job_commands_session_and_states_are_read_in_each_cycle(cell: SteppedCell) -> None:
    start, seen = cell.live.state.joints, len(cell.states)
    done = cell.live.perform(lambda session: (go()(session), session.time)[1], "a move")
    state = cell.cycle()
    assert done.result(0) == state.time
    np.testing.assert_allclose(state.joints, start + AWAY, atol=1e-9)
    times = np.array([one.time for one in cell.states[seen:]])
    np.testing.assert_allclose(np.diff(times), cell.session.cycle, atol=1e-9)
    assert {one.job for one in cell.states[seen + 1 : -1]} == {"a move"}
    assert (state.job, state.message) == (None, "")


def test_stop_ends_job_and_reset_lets_the_next_one_run(cell: SteppedCell) -> None:
    start = cell.live.state.joints
    done = cell.stop_in(40, go(), cell.live.emergency_stop)
    with pytest.raises(JobStopped, match="stopped"):
        done.result(0)
    state = cell.rests()
    assert (state.controller, state.message, state.job) == ("emergency stop", "stopped", None)
    assert 0.01 < state.joints[0] - start[0] < 0.55
    refused = cell.live.perform(go(), "the job")
    cell.cycle(2)
    with pytest.raises(CommandError, match="emergency stop is in force"):
        refused.result(0)
    assert "emergency stop is in force" in cell.live.state.message
    cell.live.submit(Reset())
    cell.cycle(3)
    again = cell.live.perform(go(), "the job")
    cell.cycle(2)
    assert again.result(0) is None
    np.testing.assert_allclose(cell.live.state.joints, state.joints + AWAY, atol=1e-9)


def test_emergency_stop_stays_pressed_until_it_is_released(cell: SteppedCell) -> None:
    """The guard, which answers every other cycle, does not release the button of the operator."""
    cell.live.emergency_stop()
    cell.cycle(20)
    assert cell.session.cell.get_boolean("command.emergency_stop")
    cell.live.submit(Reset())
    cell.cycle(3)
    assert not cell.session.cell.get_boolean("command.emergency_stop")
    assert cell.live.state.controller == "at rest"


def test_cancel_ends_job_without_emergency_stop(cell: SteppedCell) -> None:
    done = cell.stop_in(40, go(), lambda: cell.live.submit(Cancel()))
    with pytest.raises(JobStopped, match="cancelled"):
        done.result(0)
    state = cell.rests()
    assert (state.controller, state.message) == ("at rest", "cancelled")
    cell.live.submit(MoveJoints(state.joints - 0.1))
    cell.cycle(4)
    np.testing.assert_allclose(cell.rests().joints, state.joints - 0.1, atol=1e-9)


@pytest.mark.parametrize(
    ("caught", "cycles", "controller"), [(Exception, 45, "at rest"), (BaseException, 48, "emergency stop")]
)
def test_job_that_catches_exceptions_is_ended(cell: SteppedCell, caught, cycles: int, controller: str) -> None:
    """One that goes on after its end by all means meets an emergency stop."""

    def stubborn(session: ScanSession) -> None:
        for sign in (1, -1, 1, -1):
            with suppress(caught):
                session.move_joints(session.joints + sign * AWAY, speed=0.1)

    before = len(cell.states)
    done = cell.stop_in(40, stubborn, lambda: cell.live.submit(Cancel()))
    assert (done.exception(0) is not None) == (caught is Exception)
    assert len(cell.states) - before < cycles
    assert cell.rests().controller == controller


def test_monitor_speed_acts_on_job_and_other_commands_are_refused(cell: SteppedCell) -> None:
    first = len(cell.states)
    cell.after(30, lambda: cell.live.submit(SetMonitorSpeed(0.0)))
    cell.after(60, lambda: cell.live.submit(MoveJoints(np.zeros(6))))
    cell.after(64, lambda: cell.live.submit(SetMonitorSpeed(1.0)))
    start = cell.live.state.joints
    done = cell.live.perform(go(), "a move")
    cell.cycle(2)
    assert done.result(0) is None
    paused = [state.joints[0] for state in cell.states[first + 55 : first + 64]]
    np.testing.assert_allclose(paused, paused[0], atol=1e-9)
    assert 0.01 < paused[0] - start[0] < 0.55
    assert cell.states[first + 63].message == "move_joints: a move is running: cancel it first"
    np.testing.assert_allclose(cell.live.state.joints, start + AWAY, atol=1e-9)


def test_job_waits_for_moves_and_excludes_others(cell: SteppedCell) -> None:
    start = cell.live.state.joints
    cell.live.submit(MoveJoints(start + 0.1))
    first = cell.live.perform(lambda session: session.joints, "the first")
    second = cell.live.perform(go(), "the second")
    state = cell.cycle(4)
    assert state.job == "the first"
    with pytest.raises(CommandError, match="the second: the first is running"):
        second.result(0)
    cell.rests()
    cell.cycle(2)
    np.testing.assert_allclose(first.result(0), start + 0.1, atol=1e-9)


def test_waiting_job_is_cancelled(cell: SteppedCell) -> None:
    for end in (lambda: cell.live.submit(Cancel()), cell.live.emergency_stop):
        cell.live.submit(MoveJoints(cell.live.state.joints + 0.3))
        job = cell.live.perform(go())
        cell.cycle(3)
        end()
        cell.cycle(2)
        assert job.cancelled()
        assert cell.live.state.job is None


def test_job_starts_after_change_of_operation(cell: SteppedCell) -> None:
    cell.live.submit(SetOperation(Operation.MANUAL))
    cell.cycle(20)
    cell.live.submit(SetOperation(Operation.AUTOMATIC))
    done = cell.live.perform(go())
    cell.cycle(20)
    assert done.result(0) is None


def test_work_between_cycles_sees_running_job(cell: SteppedCell) -> None:
    looks: list[Future[float]] = []
    for count in (10, 20):
        cell.after(count, lambda: looks.append(cell.live.between_cycles(lambda session: session.joints[0])))
    cell.live.perform(go())
    cell.cycle(2)
    angles = [look.result(0) for look in looks]
    assert cell.states[0].joints[0] < angles[0] < angles[1] < cell.live.state.joints[0]


def test_work_between_cycles_must_not_step_the_cell(cell: SteppedCell) -> None:
    stepped = cell.live.between_cycles(lambda session: session.step())
    failed = cell.live.between_cycles(lambda _: 1 / 0)
    time = cell.cycle(3).time
    with pytest.raises(CommandError, match="must not"):
        stepped.result(0)
    with pytest.raises(ZeroDivisionError):
        failed.result(0)
    assert cell.cycle().time > time


def test_records_of_an_ended_program_do_not_reach_the_next_one(cell: SteppedCell) -> None:
    """And its trigger fires no more."""
    turn = turn_of_table(cell.session.joints, "table_angle", np.radians(0.5))
    ended = cell.stop_in(40, lambda session: session.run_program(turn, EXPOSURE), lambda: cell.live.submit(Cancel()))
    with pytest.raises(JobStopped):
        ended.result(0)
    cell.rests()
    fired = cell.session.cell.get_integer("trigger.count")
    assert fired > 0

    cell.live.perform(lambda session: session.turn_table(0.0))
    cell.cycle(2)
    assert cell.session.cell.get_integer("trigger.count") == fired
    begin = cell.live.state.time
    done = cell.live.perform(lambda session: session.run_program(moves_with_stops(session.joints), EXPOSURE))
    cell.cycle(2)
    measured = done.result(0).measured
    assert len(measured.time) == 3
    assert measured.time.min() > begin


def test_program_with_a_mistake_states_its_line(cell: SteppedCell, tmp_path: Path) -> None:
    def run(text: str) -> Future[ProgramRun]:
        file = tmp_path / "program.py"
        file.write_text(WORDS + text)
        done = cell.live.perform(lambda session: run_program(file, session, "geometric", tmp_path), "program.py")
        cell.cycle(2)
        return done

    mistake = run("def main(robot):\n    robot.wait(0.1)\n    robot.set_speed(2)\n")
    assert isinstance(mistake.exception(0), ProgramError)
    assert "program.py:4: share = 2: expected a finite number above 0" in cell.live.state.message
    cell.after(20, lambda: cell.live.submit(Cancel()))
    with pytest.raises(JobStopped, match=r"program\.py:6: cancelled"):
        run(STUBBORN).result(0)
    assert cell.live.state.message.endswith("program.py:6: cancelled")
    fine = run("def main(robot):\n    robot.move_tool(location(450 * mm, 0, 300 * mm, rx=180 * deg))\n")
    assert [step.command for _, step in fine.result(0).steps] == ["move_tool"]


def test_program_that_only_polls_is_stopped(ideal_scanner: Scanner, tmp_path: Path) -> None:
    """It never steps the cell, so that time stands still."""
    file = tmp_path / "program.py"
    file.write_text("def main(robot):\n    print('begun')\n    while robot.table_angle < 1:\n        pass\n")
    with ideal_scanner.session(guarded=True) as session, running(LiveCell(session)) as live:
        begun = threading.Event()
        done = live.perform(lambda cell: run_program(file, cell, "geometric", tmp_path, printed=lambda _: begun.set()))
        assert begun.wait(PATIENCE)
        live.emergency_stop()
        assert isinstance(done.exception(PATIENCE), JobStopped)


def test_second_stop_interrupts_program_that_neither_steps_nor_polls(
    ideal_scanner: Scanner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, now, begun = tmp_path / "program.py", [0.0], threading.Event()
    file.write_text("def main(robot):\n    print('begun')\n    while True:\n        pass\n")
    interrupted: list[int] = []
    interrupt = live_module.interrupt
    monkeypatch.setattr(live_module, "interrupt", lambda thread: (interrupted.append(thread), interrupt(thread)))
    with (
        ideal_scanner.session(guarded=True) as session,
        running(LiveCell(session, clock=lambda: now[0])) as live,
    ):
        done = live.perform(lambda cell: run_program(file, cell, "geometric", tmp_path, printed=lambda _: begun.set()))
        assert begun.wait(PATIENCE)
        live.emergency_stop()
        live.emergency_stop()
        assert interrupted == []
        now[0] += 2.0
        live.emergency_stop()
        with pytest.raises(JobStopped, match=r"program\.py:[34]: stopped"):
            done.result(PATIENCE)
        live.submit(Reset())
        live.submit(MoveJoints(live.state.joints))
        assert live.perform(go()).result(PATIENCE) is None


def test_work_between_cycles_is_done_while_a_job_measures(cell: SteppedCell) -> None:
    def measure(session: ScanSession) -> float:
        look = cell.live.between_cycles(lambda looked: looked.time)
        session.profile("geometric")
        return look.result(0)

    time = cell.live.perform(measure)
    cell.cycle(2)
    assert 0 < time.result(0) < cell.live.state.time


def test_each_cycle_of_a_job_keeps_pace(ideal_scanner: Scanner, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[int] = []

    class Waits:
        def __init__(self, period: float) -> None:
            self.period = period

        def wait(self) -> None:
            waits.append(session.cell.time_us // CYCLE_US)
            if len(waits) == 100:
                ended.set()

    monkeypatch.setattr(live_module, "Pace", Waits)
    ended = threading.Event()
    with ideal_scanner.session(guarded=True) as session:
        live = LiveCell(session)
        live.perform(lambda cell: cell.run_program(moves_with_stops(cell.joints), EXPOSURE))
        live.run(ended.is_set)
        # Exposures on request divide cycles into steps.
        assert waits == list(range(1, len(waits) + 1))
        assert 100 <= len(waits) <= 101


def test_end_of_run_ends_job_and_drops_the_rest(ideal_scanner: Scanner) -> None:
    with ideal_scanner.session(guarded=True) as session:
        live, ended = LiveCell(session), threading.Event()
        session.cell.on_step(lambda: ended.set() if session.time > 1.0 else None)
        done = live.perform(lambda cell: cell.wait(1e6))
        live.run(ended.is_set, realtime=False)
        assert isinstance(done.exception(0), JobStopped)
        late = live.perform(go())
        look = live.between_cycles(lambda cell: cell.time)
        live.run(lambda: True, realtime=False)
        for future in (late, look):
            with pytest.raises(CancelledError):
                future.result(0)


def test_broken_cell_is_reported(cell: SteppedCell) -> None:
    done = cell.live.perform(lambda session: session.value("no such variable"))
    cell.cycle(2)
    assert isinstance(done.exception(0), CellError)
    assert "no such variable" in cell.live.state.message
