"""Robot programs of the workspace; they run with all rights of its user, so pages cannot submit code."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from scancell.browser.panels.handles import pressed, run_once, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.errors import DescriptionError
from scancell.files import read_file
from scancell.live.commands import Cancel
from scancell.live.state import LiveState
from scancell.programs.live_program import LiveProgram, LiveProgramState
from scancell.programs.taught_file import TaughtFile

_TAUGHT = "the taught program"
_SHOWN = 400  # lines of a program, around the marked one
_TO_MARK = """const box = this.parentElement, row = box.querySelector("[data-marked]");
if (row) box.scrollTop = row.offsetTop - box.offsetTop - box.clientHeight / 2;"""
_BOX = "font-family:monospace;white-space:pre;overflow:auto;font-size:0.75em;line-height:1.35;margin:0.3em 0.75em"
_MARKS = {"failed": "rgba(208,48,48,0.35)", "stopped": "rgba(224,138,0,0.35)"}
_ACTIVE_MARK = "rgba(47,125,50,0.35)"


class ProgramPanel:
    """Runs the program of ``--program`` or the taught one, and shows its source, active line and output."""

    def __init__(
        self, gui: Any, operator: OperatorCommands, program: LiveProgram, taught: TaughtFile, file: Path | None
    ) -> None:
        self._program, self._taught = program, taught
        self._files = {} if file is None else {file.name: file}
        self._choice = gui.add_dropdown("program", (*self._files, _TAUGHT))
        start = gui.add_button("Run the program", hint="or continue it after a pause")
        more = gui.add_button_group("while it runs", ("Pause", "Step", "End"), hint="Step: one command, also the first")
        self._source, self._text = gui.add_html(""), gui.add_html("")
        start.on_click(operator.operator_callback(self._run))
        acts = {"Pause": program.pause, "Step": self._step, "End": lambda: operator.submit(Cancel())}
        more.on_click(operator.operator_callback(pressed(more, acts)))
        operator.add_inputs([self._choice, start])

    def show(self, state: LiveState) -> None:
        """Show the program and its run."""
        run = self._program.state
        file = self._files.get(self._choice.value, self._taught.path)
        if run is not None and run.is_active:
            set_changed(self._source, "content", source_html(run.source, run))
        else:
            source = self._lines(file)
            is_same = run is not None and run.file == file and run.source == source
            set_changed(self._source, "content", source_html(source, run if is_same else None))
        set_changed(self._text, "content", "" if run is None else run_html(run))

    def _lines(self, file: Path) -> tuple[str, ...]:
        if file == self._taught.path:
            return tuple(self._taught.text.splitlines())
        try:
            return tuple(read_file(file).decode("utf-8", errors="replace").splitlines())
        except DescriptionError as error:
            return (str(error),)

    def _file(self) -> Path:
        """The chosen file; the taught one only while it is a list of steps."""
        file = self._files.get(self._choice.value)
        if file is None:
            file, _ = self._taught.path, self._taught.program
        return file

    def _run(self) -> None:
        run = self._program.state
        if run is not None and run.is_active:
            self._program.resume()
        else:
            self._program.start(self._file())

    def _step(self) -> None:
        self._program.step(self._file())


def source_html(lines: tuple[str, ...], run: LiveProgramState | None) -> str:
    """Numbered lines of a program; the active line of its run, or that of its end, is marked."""
    marked = 0 if run is None else run.line
    first = max(0, min(marked - _SHOWN // 2, len(lines) - _SHOWN))
    colour = _ACTIVE_MARK if run is None else _MARKS.get(run.stage, _ACTIVE_MARK)
    rows = []
    for number, line in enumerate(lines[first : first + _SHOWN], start=first + 1):
        mark = f' data-marked style="background:{colour}"' if number == marked else ""
        rows.append(f"<div{mark}>{number:4} {escape(line)}</div>")
    return f'<div style="{_BOX};max-height:16em">{"".join(rows)}{run_once(_TO_MARK)}</div>'


def run_html(run: LiveProgramState) -> str:
    """Stage, error, run folder and output of a run; the last line of output first."""
    where = f", line {run.line}" if run.line else ""
    head = [f"<b>{escape(run.file.name)}: {run.stage}{where}</b>", escape(run.error)]
    if run.folder is not None:
        head.append(f"recorded: {escape(str(run.folder))}")
    rows = "".join(f"<div>{escape(line)}</div>" for line in reversed(run.output))
    return f'{small_html(head)}<div style="{_BOX};max-height:10em">{rows}</div>'
