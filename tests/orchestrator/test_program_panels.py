"""Panels that teach and run programs, on a live cell, without a browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from live_cells import SteppedCell

from scancell import Scanner
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.teach_panel import ProgramPanel, TeachPanel, source_html
from scancell.browser.server.gate import Operators
from scancell.live.state import MoveJoints
from scancell.programs.program import LiveProgram
from scancell.programs.robot import deg, location, mm
from scancell.programs.taught import JointPoint, PosePoint, TaughtFile, TaughtProgram, TaughtStep, program_text

ABOVE = location(450 * mm, 0, 260 * mm, rx=180 * deg)
THERE = location(460 * mm, 0, 260 * mm, rx=180 * deg)
MARK = "<div data-marked"


class Handle:
    """An input or a text of a page."""

    def __init__(self, value: Any = None, **given: Any) -> None:
        self.value, self.content, self.disabled, self.hint, self.visible = value, "", False, None, True
        self.__dict__.update(given)
        self.callbacks: list[Callable[[Any], None]] = []

    def on_click(self, callback: Callable[[Any], None]) -> None:
        self.callbacks.append(callback)

    on_update = on_upload = on_click

    def enter(self, value: Any = None) -> None:
        """Enter a value, or press a button, as the user of the browser."""
        self.value = value
        for callback in self.callbacks:
            callback(SimpleNamespace(client=object()))


class Gui:
    """Makes handles, and keeps those with a name."""

    def __init__(self) -> None:
        self.named: dict[str, Handle] = {}
        self.texts: list[Handle] = []

    def _named(self, name: str, value: Any = None, **given: Any) -> Handle:
        return self.named.setdefault(name, Handle(value, **given))

    def add_button(self, name: str, **_: Any) -> Handle:
        return self._named(name)

    add_upload_button = add_button

    def add_button_group(self, name: str, _options: tuple[str, ...], **_: Any) -> Handle:
        return self._named(name)

    def add_dropdown(self, name: str, options: Any, **_: Any) -> Handle:
        return self._named(name, next(iter(options)), options=tuple(options))

    def add_text(self, name: str, value: str, **_: Any) -> Handle:
        return self._named(name, value)

    def add_number(self, name: str, value: float, **_: Any) -> Handle:
        return self._named(name, value, label=name)

    def add_slider(self, name: str, _low: float, _high: float, _step: float, value: float) -> Handle:
        return self._named(name, value)

    def add_html(self, content: str) -> Handle:
        self.texts.append(Handle(content=content))
        return self.texts[-1]


class Page:
    """One browser with both panels."""

    def __init__(self, cell: SteppedCell, out: Path, program: Path | None = None, operators: Operators | None = None):
        self.cell, self.gui, self.messages = cell, Gui(), []
        operators = operators or Operators()
        operators.join(1)
        self.sent: list[bytes] = []
        client: Any = SimpleNamespace(
            client_id=1,
            add_notification=lambda _title, text, **_: self.messages.append(text),
            send_file_download=lambda _name, content, **_: self.sent.append(content),
        )
        live, session = cell.live, cell.session
        self.operator = OperatorCommands(client, operators, live, session, lambda: cell.now + len(self.messages) * 60)
        self.taught = TaughtFile(out / "taught.py")
        self.teach = TeachPanel(self.gui, self.operator, self.taught)
        self.program = LiveProgram(live, "geometric", out)
        self.run = ProgramPanel(self.gui, self.operator, self.program, self.taught, program)

    def press(self, name: str, button: str | None = None) -> str:
        """Press a button, of a group where given, and return the message that follows."""
        before = len(self.messages)
        self.teach.show(self.cell.live.state)
        self.gui.named[name].enter(button)
        self.teach.show(self.cell.live.state)
        return "".join(self.messages[before:])

    def add(self, kind: str, name: str = "") -> str:
        self.gui.named["kind"].enter(kind)
        self.gui.named["name"].enter(name)
        return self.press("Add after this step")

    def select(self, number: int) -> None:
        step = self.gui.named["step"]
        step.enter(step.options[number - 1])

    @property
    def steps(self) -> list[str]:
        return [step.point or step.command for step in self.taught.program.steps]

    @property
    def selected(self) -> str:
        return str(self.gui.named["step"].value)


@pytest.fixture(scope="module")
def cell(ideal_scanner: Scanner) -> Iterator[SteppedCell]:
    with ideal_scanner.session(guarded=True) as session:
        yield SteppedCell(session)


@pytest.fixture
def page(cell: SteppedCell, tmp_path: Path) -> Page:
    """The sensor is above the table."""
    cell.at(ABOVE)
    return Page(cell, tmp_path)


def test_added_steps_hold_the_present_pose(page: Page) -> None:
    assert page.add("joints", "above") == ""
    page.cell.at(THERE)
    page.gui.named["step speed, %"].enter(20)
    assert page.add("line") == ""
    assert page.add("scan line", "end") == ""
    assert page.add("wait") == ""
    assert page.steps == ["above", "p1", "end", "wait"]
    program = page.taught.program
    above, line = program.points["above"], program.points["p1"]
    assert isinstance(above, JointPoint)
    assert isinstance(line, PosePoint)
    np.testing.assert_allclose(page.cell.session.nominal.world_from_sensor(np.array(above.joints)), ABOVE, atol=2e-6)
    np.testing.assert_allclose(line.world_from_tool, THERE, atol=2e-6)
    assert [step.speed for step in program.steps] == [0.3, 0.2, 0.2, 1.0]
    assert program.steps[2].value == pytest.approx(0.5 * mm)
    assert page.selected == "4 wait, 1 s"


def test_step_has_the_first_value_of_its_kind_if_added_before_the_page_offers_the_number(page: Page) -> None:
    kind = page.gui.named["kind"]
    kind.value = "wait"  # its callback, of another thread, comes later
    assert page.press("Add after this step") == ""
    assert page.selected == "1 wait, 1 s"
    page.gui.named["number"].enter(2.5)
    kind.enter("wait")
    page.press("Add after this step")
    assert page.selected == "2 wait, 2.5 s"


def test_line_after_a_turned_table_turns_it(page: Page) -> None:
    page.add("joints")
    page.cell.live.submit(MoveJoints(page.cell.session.joints, 20 * deg))
    page.cell.cycle(4)
    page.cell.rests()
    page.add("line")
    assert page.steps == ["p1", "turn_table", "p2"]
    assert page.selected == "3 p2: line, 30 %"
    page.press("this step", "Up")
    assert page.steps == ["p1", "p2", "turn_table"]
    page.select(3)
    page.press("this step", "Move to")
    page.cell.cycle(4)
    page.cell.rests()
    assert page.cell.session.table_angle == pytest.approx(20 * deg, abs=1e-5)


def test_new_step_is_added_after_the_selected_one(page: Page) -> None:
    for name in ("first", "last"):
        page.add("line", name)
    page.select(2)
    page.add("wait")
    assert page.steps == ["turn_table", "first", "wait", "last"]
    assert page.selected == "3 wait, 1 s"
    page.press("this step", "Down")
    assert page.steps == ["turn_table", "first", "last", "wait"]
    assert page.selected == "4 wait, 1 s"
    page.press("this step", "Delete")
    assert page.selected == "3 last: line, 30 %"
    page.press("this step", "Copy")
    assert page.steps == ["turn_table", "first", "last", "last"]


def test_step_is_changed_and_moved_to(page: Page) -> None:
    page.add("joints", "above")
    page.cell.at(THERE)
    page.add("line", "there")
    page.select(1)
    page.press("this step", "Move to")
    page.cell.cycle(4)
    page.cell.rests()
    np.testing.assert_allclose(page.cell.session.world_from_tool(), ABOVE, atol=5e-6)
    page.select(2)
    page.press("change its", "Pose")
    page.gui.named["step speed, %"].enter(80)
    page.press("change its", "Speed")
    page.gui.named["name"].enter("here")
    page.press("change its", "Name")
    program = page.taught.program
    assert page.selected == "2 here: line, 80 %"
    np.testing.assert_allclose(program.points["here"].world_from_tool, ABOVE, atol=5e-6)  # type: ignore[union-attr]


def test_errors_are_shown_and_change_nothing(page: Page) -> None:
    page.add("joints", "above")
    before = page.taught.text
    assert "name = 'above': expected a name that no other point has" in page.add("line", "above")
    assert "expected a Python name" in page.add("line", "two words")
    assert "no number that is typed" in page.press("change its", "Number")
    page.cell.live.submit(MoveJoints(page.cell.session.home, speed=0.1))
    page.cell.cycle(10)
    assert "the robot moves" in page.add("line", "moving")
    page.cell.rests()
    assert page.taught.text == before
    empty = Page(page.cell, page.taught.path.parent / "empty")
    assert "there is no step 1" in empty.press("this step", "Delete")


def test_browser_without_control_changes_nothing(cell: SteppedCell, tmp_path: Path) -> None:
    operators = Operators()
    operators.join(2)
    page = Page(cell, tmp_path, operators=operators)
    assert "take control first" in page.add("line", "p1")
    for name in ("this step", "change its"):
        assert "control" in page.press(name, "Delete" if name == "this step" else "Speed")
    page.gui.named["while it runs"].enter("Step")
    assert page.steps == []
    assert page.program.state is None


def test_opened_program_is_read_as_data_and_the_one_before_is_kept(page: Page) -> None:
    page.add("joints", "above")
    step = TaughtStep("move_line", "other", speed=0.5)
    text = program_text(TaughtProgram().with_step(0, step, PosePoint.of(ABOVE)))
    upload = page.gui.named["Open a taught program"]
    for content, message in (
        (b"import os\nos.remove('x')\ndef main(robot): pass\n", "the opened file:1: import os"),
        (b"\xff\xfe", "no text"),
        (b"#" * 1_000_001, "expected at most 1000000"),
    ):
        upload.enter(SimpleNamespace(name="taught.py", content=content))
        assert message in page.messages[-1]
        assert page.steps == ["above"]
    upload.enter(SimpleNamespace(name="taught.py", content=text.encode()))
    assert page.steps == ["other"]
    assert "above" in (page.taught.path.parent / "taught_1.py").read_text()
    page.press("Download the program")
    assert page.sent == [text.encode()]


def test_file_with_other_code_is_neither_changed_nor_run(page: Page) -> None:
    page.taught.path.write_text("print('own')\n")
    assert "taught.py:1: print('own')" in page.add("line")
    page.gui.named["Run the program"].enter()
    assert "taught.py:1: print('own')" in page.messages[-1]
    assert page.program.state is None
    assert "print" in page.gui.texts[0].content
    page.press("Begin a new program")
    assert (page.taught.path.parent / "taught_1.py").read_text() == "print('own')\n"
    assert page.add("line") == ""


def test_run_marks_the_active_line_and_shows_output_and_errors(cell: SteppedCell, tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text("def main(robot):\n    print('<begins>')\n    robot.wait(0.5)\n    robot.set_speed(7)\n")
    page = Page(cell, tmp_path / "out", file)
    source, text = page.gui.texts[1:]

    def shown() -> tuple[str, str]:
        page.run.show(cell.live.state)
        return source.content, text.content

    assert "def main(robot):" in shown()[0]
    assert MARK not in shown()[0]
    looks: list[tuple[str, str]] = []
    page.gui.named["Run the program"].enter()
    cell.after(10, lambda: looks.append(shown()))
    cell.cycle(2)
    (during,) = looks
    assert marked(during[0]) == "3"
    assert "own.py: running, line 3" in during[1]
    assert "&lt;begins&gt;" in during[1]
    after = shown()
    assert marked(after[0]) == "4"
    assert "own.py: failed, line 4" in after[1]
    assert "share = 7" in after[1]
    assert "program_1" in after[1]
    file.write_text("def main(robot):\n    robot.wait(1)\n")
    assert MARK not in shown()[0]


def marked(html: str) -> str:
    """Number of the marked line."""
    return html.split(MARK)[1].split(">")[1].split(maxsplit=1)[0]


def test_long_program_shows_the_lines_around_the_active_one() -> None:
    lines = tuple(f"line {number}" for number in range(1, 5001))
    run: Any = SimpleNamespace(line=3000, stage="running")
    html = source_html(lines, run)
    assert marked(html) == "3000"
    assert html.count("<div") < 500
    assert "line 2900" in html
    assert "line 3100" in html
