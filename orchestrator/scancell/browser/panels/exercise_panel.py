"""Task and checklist of an exercise, fields for the student's figures, and the result sheet."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

from scancell.browser.panels.checklist import checklist_html
from scancell.browser.panels.handles import Follower, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.exercises.attempt import Attempt, Result
from scancell.exercises.declaration import Question
from scancell.exercises.sheet import sheet_file, write_sheet
from scancell.live.state import LiveState

_SLOW = "the browser draws it, which is slow without a graphics card"


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
            self._add_figure(gui, question)
        self._student = gui.add_text("your name", "", hint="may be empty")
        self._file = gui.add_text("file", f"exercise_{exercise.number}.html", hint="in the folder of --out")
        self._picture = gui.add_checkbox("with a picture of the scene", False, hint=_SLOW)
        save = gui.add_button("Save result")
        again = gui.add_button("Start again", hint="opens the cell anew, with the part at its first place")
        save.on_click(operator.operator_callback(self._save))
        again.on_click(operator.operator_callback(start_again))
        operator.add_inputs([self._student, self._file, self._picture, save, again])

    def _add_figure(self, gui: Any, question: Question) -> None:
        field = gui.add_number(question.label, 0.0, step=0.001)
        self._figures[question] = Follower(field)
        field.on_update(self._operator.operator_callback(lambda: self._attempt.answer(question, field.value)))
        self._operator.add_inputs([field])

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
