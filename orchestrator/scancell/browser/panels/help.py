"""Help of the workspace: texts of the tabs, keys, the tour and the exercise, whose steps tick themselves off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from scancell.arrays import Array
from scancell.browser.panels.handles import CALM, Follower, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.panels.scans import Scans
from scancell.cell.driver import Operation
from scancell.exercises import Attempt, Question, Result, sheet_file, write_sheet
from scancell.live.camera import CameraFeed, CameraFrame
from scancell.live.state import LiveState
from scancell.programs.program import LiveProgram
from scancell.programs.taught import TaughtFile

TABS = {
    "Exercise": "Items tick themselves off. They refer to the last program that was run; contacts are counted from the "
    "opening of the cell on. A figure is compared with the simulated value when it is typed.",
    "Joints": "Drag a slider, or type an angle; the robot moves after the release. The translucent arm is the target.",
    "Pose": "Type a pose of the tool, or drag the handle in the scene. A sensor that looks down has the angles "
    "180, 0, 0. The text below states whether the arm reaches the pose.",
    "Jog": "Hold a button, or J or K, to move one axis; the robot stops when you release it. The guard "
    "slows the robot down before bodies touch, and names them.",
    "Cell": "In manual operation only jogs move the robot, in automatic operation only moves and programs. The panels "
    "change the operation at rest. The monitor speed scales moves and programs.",
    "Sensor": "The sliders change the true sensor. Images and profile show the effect, because the profile is computed "
    "with the nominal sensor. Scans have the sensor of the descriptions.",
    "Scan": "Plans the scan of the descriptions, moves to its start on a free path, and scans. The geometric engine is "
    "faster, the ray-traced one renders every image. The last scan can be saved, and played back while the "
    "robot rests.",
    "Run": "Runs the program file with which the workspace was started, or the taught program. The file is read again "
    "for every run.",
    "Teach": "Add the present pose as a step, repeat, and change steps; then run the program in the tab Run. The list "
    "is a program file for scancell run.",
    "File": "Opens another part or a recorded run, records the session, and downloads a picture of the scene.",
}
KEYS = {
    "Escape": "stop the robot, from every browser",
    "J, K": "hold to jog in the negative or positive direction",
    "1 to 9": "choose the axis of the jog",
    "Ctrl+K": "list of commands",
}
_LAST = 1e6  # order of a folder at the end of a tab
_MOVED = np.radians(1.0)
_NEAR = 0.03  # m
_PLACE_PX, _WIDTH_PX = 15, 220  # from the upper right corner of the scene

_SLOW = "the browser draws it, which is slow without a graphics card"


def checklist_html(title: str, what: str, texts: Sequence[str], done: Sequence[bool]) -> str:
    """Texts with their marks, under a title that counts `what` is done; the first one that is not done is bold."""
    following = done.index(False) if False in done else -1
    lines = [f"<b>{escape(title)}</b>, {sum(done)} of {len(done)} {what} done"]
    for number, (text, is_done) in enumerate(zip(texts, done, strict=True)):
        mark = f'<span style="color:{CALM}">&#9745;</span>' if is_done else "&#9744;"
        shown = f"<b>{escape(text)}</b>" if number == following else escape(text)
        lines.append(f"{mark} {shown}")
    return small_html(lines)


def add_help(gui: Any, tab: str) -> None:
    """Add the help of a tab, folded."""
    with gui.add_folder("Help", expand_by_default=False, order=_LAST):
        gui.add_html(small_html([escape(TABS[tab])]))


@dataclass(frozen=True)
class _Step:
    text: str
    is_done: Callable[[LiveState], bool]


class HelpPanel:
    """Keys and tour, shown to all browsers.

    Parameters
    ----------
    gui
        Inputs of the server.
    feed, scans, taught, program
        Objects of the workspace.
    start
        State in which the tour begins.
    over_part
        Position (3,) in the base at which a sensor that looks down measures the part, m; None: the arm does not carry
        the sensor, and the tour has no such step.
    """

    def __init__(
        self,
        gui: Any,
        feed: CameraFeed,
        scans: Scans,
        taught: TaughtFile,
        program: LiveProgram,
        start: LiveState,
        over_part: Array | None,
    ) -> None:
        nominal = feed.as_built
        self._moved = start.time  # s
        self._held_at: Array | None = None  # joints at which the guard held a jog
        self._steps = [
            _Step(
                "Move, Joints: move joint 1",
                lambda state: _are_apart(state.joints, start.joints),
            ),
            *([] if over_part is None else [self._step_back(feed, over_part)]),
            _Step(
                "Move, Jog: jog the tool along z towards the table until the guard holds the robot",
                lambda _: self._held_at is not None,
            ),
            _Step(
                "Move, Joints: move to home position, after a stop with Reset after a stop",
                lambda state: self._held_at is not None and _are_apart(state.joints, self._held_at),
            ),
            _Step("Sensor: turn the laser about z, and look at the profile", lambda _: feed.as_built != nominal),
            _Step("Scan: scan the part", lambda _: scans.lack == ""),
            _Step("Scan: save the run folder", lambda _: scans.saved is not None),
            _Step("Program, Teach: add two poses", lambda _: taught.count >= 2),
            _Step("Program, Run: run the taught program", lambda _: _is_run(program, taught.path)),
        ]
        self._done = [False] * len(self._steps)
        with gui.add_folder("Keys and tour", expand_by_default=False, order=101):
            gui.add_html(small_html(f"<b>{escape(key)}</b>: {escape(text)}" for key, text in KEYS.items()))
            self._tour = gui.add_html("")
        self.show(start)

    def _step_back(self, feed: CameraFeed, over_part: Array) -> _Step:
        x, y, z = np.round(1e3 * over_part) + 0.0
        return _Step(
            f"Move, Pose: move back over the part, to {x:g}, {y:g}, {z:g} mm with the angles 180, 0, 0°, "
            "until the cameras show a profile",
            lambda state: self._done[0] and not state.moving and _is_at(feed.frame, over_part, self._moved),
        )

    def show(self, state: LiveState) -> None:
        """Tick off what has been done."""
        by_guard = state.guard_text.startswith(("stop", "no jog"))
        if by_guard and state.operation is Operation.MANUAL:
            self._held_at = state.joints
        if state.moving:
            self._moved = state.time
        self._done = [done or step.is_done(state) for done, step in zip(self._done, self._steps, strict=True)]
        shown = checklist_html("Tour", "steps", [step.text for step in self._steps], self._done)
        set_changed(self._tour, "content", shown)

    @property
    def next_step(self) -> str:
        """The first step that is not done, with its number, as HTML; empty at the end."""
        if all(self._done):
            return ""
        number = self._done.index(False)
        return f"<b>{number + 1} of {len(self._steps)}</b> {escape(self._steps[number].text)}"


class TourCard:
    """The next step of the tour in a small window of one browser, which stays until it is closed or the tour ends.

    Parameters
    ----------
    gui
        Inputs of the browser.
    """

    def __init__(self, gui: Any) -> None:
        self._panel = gui.add_panel()
        with self._panel.add_tab("Tour"):
            self._text = gui.add_html("")
            close = gui.add_button("Close the tour", hint='"Keys and tour" at the bottom of the panel lists all steps')
        self._panel.float(x=-_PLACE_PX, y=_PLACE_PX, width=_WIDTH_PX)
        self._is_open = True
        close.on_click(lambda _: self.close())

    def close(self) -> None:
        """Close the window."""
        self._is_open = False
        set_changed(self._panel, "visible", False)

    def show(self, step: str) -> None:
        """Show a step; an empty one closes the window."""
        if self._is_open and step:
            set_changed(self._text, "content", small_html([step]))
        elif self._is_open:
            self.close()


def _is_at(frame: CameraFrame | None, position: Array, since: float) -> bool:
    """Whether a frame that is taken after a time has a profile around a position, seen from above."""
    if frame is None or frame.time <= since or not len(frame.points_in_base):
        return False
    return bool(np.linalg.norm((frame.points_in_base.mean(0) - position)[:2]) < _NEAR)


def _are_apart(joints: Array, others: Array) -> bool:
    return bool(np.abs(joints - others).max() > _MOVED)


def _is_run(program: LiveProgram, file: Path) -> bool:
    state = program.state
    return state is not None and state.file == file and state.stage == "done"


class ExercisePanel:
    """Shows an attempt at an exercise, takes figures, and saves the result sheet in a folder."""

    def __init__(
        self, gui: Any, operator: OperatorCommands, attempt: Attempt, start_again: Callable[[], None], out: Path
    ) -> None:
        self._operator, self._attempt, self._out = operator, attempt, out
        exercise = attempt.exercise
        gui.add_html(small_html([f"<b>{exercise.number}. {escape(exercise.title)}</b>", escape(exercise.task)]))
        self._list = gui.add_html("")
        self._figures: dict[Question, Follower] = {}
        for question in (item for item in exercise.items if isinstance(item, Question)):
            field = gui.add_number(question.label, 0.0, step=0.001)
            operator.connect(field, partial(self._answer, question))
            self._figures[question] = Follower(field)
        self._student = gui.add_text("your name", "", hint="may be empty")
        self._file = gui.add_text("file", f"exercise_{exercise.number}.html", hint="in the folder of --out")
        self._picture = gui.add_checkbox("with a picture of the scene", False, hint=_SLOW)
        operator.add_inputs([self._student, self._file, self._picture])
        operator.connect(gui.add_button("Save result"), self._save)
        again = gui.add_button("Start again", hint="opens the cell anew, with the part at its first place")
        operator.connect(again, start_again)

    def _answer(self, question: Question) -> None:
        self._attempt.answer(question, self._figures[question].value)

    def show(self, _state: LiveState) -> None:
        """Show what has been reached."""
        results = self._attempt.results
        for result in results:
            if isinstance(result.item, Question) and result.value is not None:
                self._figures[result.item].show(result.value)
        done = [result.is_reached for result in results]
        set_changed(self._list, "content", checklist_html("Checklist", "items", [*map(item_text, results)], done))

    def _save(self) -> None:
        file = sheet_file(self._out, self._file.value)
        picture = self._operator.picture() if self._picture.value else None
        write_sheet(file, self._attempt, self._student.value, picture)
        self._operator.show_message(f"saved: {file}")


def item_text(result: Result) -> str:
    """An item with its limit, and its value where there is one."""
    value = f"; now {result.value_text}" if result.value_text else ""
    return f"{result.item.text} ({result.item.limit}{value})"
