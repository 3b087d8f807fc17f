"""Robot programs in a live cell: active line, pause, step, output, errors, and the run folder of each run."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from live_cells import PATIENCE, SteppedCell

from scancell import Scanner
from scancell.config.loading import assets_dir
from scancell.errors import CommandError, ProgramError
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.live.scan import LiveChunk
from scancell.live.state import Cancel
from scancell.programs.program import LiveProgram, LiveProgramState
from scancell.reconstruction.cloud_files import read_ply
from scancell.views.recorded_run import open_run

THREE = """from scancell import Robot, deg


def main(robot: Robot) -> None:
    print("begins")
    robot.turn_table(5 * deg)
    robot.turn_table(10 * deg)
    robot.turn_table(15 * deg)
"""
SCAN_LINE = """from scancell import Robot, deg, location, mm


def main(robot: Robot) -> None:
    robot.move_tool(location(430 * mm, 0, 230 * mm, rx=180 * deg))
    robot.scan_line(location(470 * mm, 0, 230 * mm, rx=180 * deg), spacing=0.5 * mm)
"""


class Rig:
    """A program in a live cell that a test steps, and what operators do at its cycles."""

    def __init__(self, cell: SteppedCell, folder: Path) -> None:
        self.cell, self.out, self.file = cell, folder / "out", folder / "program.py"
        self.program = LiveProgram(cell.live, "geometric", self.out)
        self.file.write_text(THREE)
        self.seen: list[LiveProgramState] = []
        self.end = cell.session.cell.on_step(self._look)

    def _look(self) -> None:
        if (state := self.program.state) is not None:
            self.seen.append(state)

    @property
    def state(self) -> LiveProgramState:
        state = self.program.state
        assert state is not None
        return state

    @property
    def table_deg(self) -> float:
        return float(np.degrees(self.cell.session.table_angle))

    def runs(self, *events: tuple[int, Callable[[], object]], paused: bool = False) -> LiveProgramState:
        """Start the program, let events happen some cycles later, and return its last state."""
        self.program.start(self.file, paused)
        for count, event in events:
            self.cell.after(count, event)
        self.cell.cycle(2)
        assert not self.state.is_active
        return self.state


@pytest.fixture(scope="module")
def cell(ideal_scanner: Scanner) -> Iterator[SteppedCell]:
    with ideal_scanner.session(guarded=True) as session:
        yield SteppedCell(session)


@pytest.fixture
def rig(cell: SteppedCell, tmp_path: Path) -> Iterator[Rig]:
    """The table is at 0."""
    turned = cell.live.perform(lambda session: session.turn_table(0.0))
    cell.until(lambda _: turned.done())
    made = Rig(cell, tmp_path)
    yield made
    made.end()


def test_active_line_follows_the_commands(rig: Rig) -> None:
    ended = rig.runs()
    assert (ended.stage, ended.line, ended.error) == ("done", 0, "")
    assert ended.output[0] == "begins"
    assert [line.split(":")[0] for line in ended.output[1:-1]] == ["line 6", "line 7", "line 8"]
    assert re.fullmatch(r"done in \d\.\d\d s, no contact", ended.output[-1])
    running = [state.line for state in rig.seen if state.stage == "running"]
    assert sorted(set(running)) == [6, 7, 8]
    assert running == sorted(running)
    assert "\n".join(ended.source) == THREE.rstrip("\n")


def test_paused_program_rests_in_front_of_the_next_command(rig: Rig) -> None:
    """For 60 cycles; the table is where the command before has brought it."""
    angles: list[float] = []
    ended = rig.runs((20, rig.program.pause), (150, lambda: angles.append(rig.table_deg)), (160, rig.program.resume))
    paused = [state for state in rig.seen if state.stage == "paused"]
    assert len(paused) > 60
    assert len({state.line for state in paused}) == 1
    reached = {7: 5.0, 8: 10.0}[paused[0].line]
    assert angles == [pytest.approx(reached, abs=1e-6)]
    assert ended.stage == "done"
    assert rig.table_deg == pytest.approx(15.0, abs=1e-6)


def test_step_carries_out_one_command(rig: Rig) -> None:
    angles: list[float] = []
    events = [(count, lambda: rig.program.step(rig.file)) for count in (100, 300)]
    looks = [(count - 1, lambda: angles.append(rig.table_deg)) for count in (100, 300, 500)]
    rig.program.step(rig.file)  # starts it, in front of its first command
    for count, event in [*events, *looks, (500, rig.program.resume)]:
        rig.cell.after(count, event)
    rig.cell.cycle(2)
    np.testing.assert_allclose(angles, [0.0, 5.0, 10.0], atol=1e-6)
    assert [state.line for state in rig.seen if state.stage == "paused"][::150][:3] == [6, 7, 8]
    assert rig.state.stage == "done"


def test_step_in_a_running_program_pauses_it(rig: Rig) -> None:
    rig.runs((10, lambda: rig.program.step(rig.file)), (200, rig.program.resume))
    assert {state.line for state in rig.seen if state.stage == "paused"} == {7}


def test_paused_program_is_cancelled_without_a_motion(rig: Rig) -> None:
    ended = rig.runs((60, lambda: rig.cell.live.submit(Cancel())), paused=True)
    assert (ended.stage, ended.line) == ("stopped", 6)
    assert "program.py:6: cancelled" in ended.error
    assert rig.table_deg == pytest.approx(0.0, abs=1e-9)
    assert rig.cell.live.state.job is None


@pytest.mark.parametrize(
    ("text", "line", "error"),
    [
        ("def main(robot):\n    robot.wait(0.1)\n    1 / 0\n", 3, "ZeroDivisionError"),
        ("def main(robot):\n    robot.move_tool(\n", 2, "never closed"),
        ("def main(robot):\n    pass\n    robot.set_tool('gripper')\n", 3, "the cell has no gripper"),
        ("go = 1\n", 0, "has no function main"),
    ],
)
def test_failed_program_shows_the_line_of_its_error(rig: Rig, text: str, line: int, error: str) -> None:
    rig.file.write_text(text)
    ended = rig.runs()
    assert (ended.stage, ended.line) == ("failed", line)
    assert error in ended.error


def test_second_start_is_rejected_until_the_first_has_ended(rig: Rig) -> None:
    rejected: list[CommandError] = []

    def start_again() -> None:
        try:
            rig.program.start(rig.file)
        except CommandError as error:
            rejected.append(error)

    rig.runs((20, start_again))
    assert [str(error) for error in rejected] == ["program.py is running: end it first"]
    assert rig.runs().stage == "done"
    for command in (rig.program.pause, rig.program.resume):
        with pytest.raises(CommandError, match="no program is running"):
            command()
    with pytest.raises(ProgramError, match=r"none\.py: no such file"):
        rig.program.start(rig.file.with_name("none.py"))


def test_each_run_has_a_run_folder(rig: Rig) -> None:
    """Also a stopped one; its times are those of the cell."""
    begins = rig.cell.session.time
    first = rig.runs()
    second = rig.runs((20, lambda: rig.cell.live.submit(Cancel())))
    assert (first.folder, second.folder) == (rig.out / "program_1", rig.out / "program_2")
    run = open_run(rig.out / "program_1")
    assert run.motion.start == pytest.approx(begins, abs=0.1)
    turned = [run.motion.frames(time)["table"] for time in (run.motion.start, run.motion.duration)]
    assert np.degrees(np.arccos(turned[0][:3, 0] @ turned[1][:3, 0])) == pytest.approx(15.0, abs=1e-3)


def test_points_of_a_scan_line_come_while_it_is_measured(ideal_scanner: Scanner, tmp_path: Path) -> None:
    """In chunks, the first ones while the sensor moves; together they are the recorded cloud."""
    chunks: list[LiveChunk] = []
    during: list[int] = []
    with ideal_scanner.session(assets_dir() / "parts" / "free_form.stl") as session:
        cell, waited = session.cell, Event()

        def count_chunks() -> None:
            """While the line is driven; it does not go on before the first chunk has come."""
            if cell.get_integer("command.trigger.mode") != 0:
                for _ in range(PATIENCE * 100 if cell.get_integer("trigger.count") > 40 else 0):
                    if chunks:
                        break
                    waited.wait(0.01)
                during.append(len(chunks))

        made = Rig(SteppedCell(session), tmp_path)
        made.program = LiveProgram(made.cell.live, "geometric", made.out, lambda: chunks.append)
        made.file.write_text(SCAN_LINE)
        cell.on_cycle(16_000, count_chunks)
        state, surface = made.runs(), session.world.part_surface
        assert session.on_points is None
    assert (state.stage, state.error) == ("done", "")
    assert len(chunks) > during[-1] > 0
    saved = read_ply(state.folder / "cloud.ply")
    points = np.concatenate([chunk.points_in_part for chunk in chunks])
    np.testing.assert_allclose(points, saved.points_in_part, atol=1e-6)
    assert np.isfinite(saved.normals).all(axis=1).mean() > 0.9
    exact = deviation_from_mesh(saved, surface).distance
    np.testing.assert_allclose(np.concatenate([chunk.deviation for chunk in chunks]), exact, atol=1e-6)


def test_long_output_is_cut(rig: Rig) -> None:
    rig.file.write_text("def main(robot):\n    print('x' * 10**6)\n    for i in range(10**4): print(i)\n")
    ended = rig.runs()
    assert len(ended.output) == 200
    assert ended.output[-2] == "9999"
    assert ended.folder is None
