"""The robot program of the workspace; it runs with all rights of its user, so pages cannot submit one."""

from __future__ import annotations

from collections import deque
from html import escape
from pathlib import Path
from typing import Any

from scancell.browser.panels.handles import set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.config.choices import Engine
from scancell.live.cell import LiveCell
from scancell.live.commands import Cancel
from scancell.live.state import LiveState
from scancell.programs.program import run_program
from scancell.programs.robot import Step
from scancell.scanning.session import ScanSession

_LINES = 12  # of the last commands and of printed text


class RobotProgram:
    """A program file that runs in a live cell, on request and as often as requested; shown to all browsers.

    Attributes
    ----------
    file
        Read again for each run.
    """

    def __init__(self, live: LiveCell, file: Path, engine: Engine, out: Path) -> None:
        self._live, self.file, self._engine, self._out = live, file, engine, out
        self._lines: deque[str] = deque(maxlen=_LINES)

    @property
    def lines(self) -> list[str]:
        """The last commands with their lines in the program, and printed text."""
        return list(self._lines)

    def start(self) -> None:
        """Run it when nothing else moves the robot."""
        self._lines.clear()
        self._live.perform(self._run, self.file.name)

    def _run(self, session: ScanSession) -> None:
        run_program(self.file, session, self._engine, self._out, self._note, self._lines.append)

    def _note(self, line: int, step: Step) -> None:
        self._lines.append(f"line {line}: {step.command} {step.about}".rstrip())


class ProgramPanel:
    """Runs the program."""

    def __init__(self, gui: Any, operator: OperatorCommands, program: RobotProgram) -> None:
        self._program = program
        gui.add_html(small_html([f"<b>{escape(program.file.name)}</b>"]))
        start, cancel = gui.add_button("Run the program"), gui.add_button("End the program")
        self._text = gui.add_html("")
        start.on_click(operator.operator_callback(program.start))
        cancel.on_click(operator.callback(lambda: operator.submit(Cancel())))
        operator.add_inputs([start, cancel])

    def show(self, state: LiveState) -> None:
        """Show whether the program is running, and its last commands and output."""
        now = "<b>runs</b>" if state.job == self._program.file.name else ""
        set_changed(self._text, "content", small_html([now, *map(escape, self._program.lines)]))
