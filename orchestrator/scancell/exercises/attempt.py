"""An attempt at an exercise in a live cell."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from datetime import datetime
from html import escape
from pathlib import Path
from threading import RLock

from scancell import __version__
from scancell.cell.recording import Recording
from scancell.errors import DescriptionError
from scancell.exercises.measures import Exercise, FinishedRun, Item, Question, Situation
from scancell.files import atomic_write
from scancell.live.cell import LiveCell
from scancell.live.state import ContactWatch
from scancell.output.run_folder import command_words
from scancell.programs.live_program import LiveProgram
from scancell.programs.program import ProgramRun
from scancell.programs.taught import TaughtFile
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.session import ScanSession

_SUFFIX = ".html"
_LONGEST_NAME = 200  # bytes
_STYLE = """body{font-family:sans-serif;max-width:60em;margin:2em auto;padding:0 1em}
table{border-collapse:collapse}td,th{border:1px solid #999;padding:0.3em 0.6em;text-align:left}
img{max-width:100%}"""


@dataclass(frozen=True)
class Result:
    """An item with its value: measured, or the student's figure; None without."""

    item: Item
    value: float | None
    is_reached: bool

    @property
    def value_text(self) -> str:
        """The value with its unit; empty without."""
        return "" if self.value is None else f"{round(self.value, 3) + 0.0:.15g} {self.item.unit}"


class Attempt:
    """Measures the items of an exercise in a live cell, from now on. All methods are thread-safe.

    Items refer to the last program that was run; without one that ran to its end they have no value. A figure is
    compared with the value that the simulation has when it is entered.

    Parameters
    ----------
    live, session
        The running cell.
    program, taught
        Robot programs of the workspace.

    Attributes
    ----------
    exercise, world
        The exercise, and the part and descriptions of the cell.
    """

    def __init__(
        self, exercise: Exercise, live: LiveCell, session: ScanSession, program: LiveProgram, taught: TaughtFile
    ) -> None:
        self.exercise, self.world = exercise, session.world
        self._live, self._program, self._taught = live, program, taught
        self._lock = RLock()
        self._start = live.state
        self._contacts = ContactWatch(session.cell, [body.name for body in session.true.bodies])
        self._number, self._exposures, self._clouds = 0, list[Recording](), list[Cloud]()  # of the last program
        self._finished: tuple[ProgramRun, FinishedRun] | None = None
        self._answers: dict[Question, tuple[float, bool]] = {}
        session.on_exposures = self._receive

    @property
    def results(self) -> tuple[Result, ...]:
        """Every item with its present value."""
        with self._lock:
            situation = self._situation()
            return tuple(self._result(item, situation) for item in self.exercise.items)

    def answer(self, question: Question, value: float) -> None:
        """Enter a figure.

        Raises
        ------
        DescriptionError
            If it is not finite.
        """
        if not math.isfinite(value):
            raise DescriptionError(key=question.text, value=value, expected=f"a finite number, {question.unit}")
        with self._lock:
            true_value = question.measure(self._situation())
            is_right = true_value is not None and abs(value - true_value) <= question.tolerance
            self._answers[question] = value, is_right

    def _result(self, item: Item, situation: Situation) -> Result:
        if isinstance(item, Question):
            value, is_right = self._answers.get(item, (None, False))
            return Result(item, value, is_right)
        measured = item.measure(situation)
        return Result(item, measured, measured is not None and item.is_reached(measured))

    def _situation(self) -> Situation:
        contacts = tuple(self._contacts.pairs)
        return Situation(self._start, self._live.state, contacts, self._finished_run(), self.world)

    def _finished_run(self) -> FinishedRun | None:
        """The last program; None unless it ran to its end."""
        state = self._program.state
        if state is None or state.record is None:
            return None
        if self._finished is None or self._finished[0] is not state.record:
            is_taught = state.file == self._taught.path
            exposures, clouds = (self._exposures, self._clouds) if self._number == self._program.started else ([], [])
            self._finished = state.record, FinishedRun.of(state.record, is_taught, exposures, clouds, self.world)
        return self._finished[1]

    def _receive(self, recording: Recording, cloud: Cloud | None) -> None:
        """Keep what the last program measured; called in the thread of the cell."""
        with self._lock:
            if self._number != self._program.started:
                self._number, self._exposures, self._clouds = self._program.started, [], []
            self._exposures.append(recording)
            if cloud is not None:
                self._clouds.append(cloud)


def sheet_file(folder: Path, name: str) -> Path:
    """Path of a sheet in a folder; the suffix is added where it is missing.

    Raises
    ------
    DescriptionError
        If `name` is no file name.
    """
    name = name.strip()
    name = name if name.lower().endswith(_SUFFIX) else name + _SUFFIX
    is_plain = name.isprintable() and not set(name) & set('/\\:*?"<>|') and not name.startswith(".")
    if not is_plain or len(name.encode()) > _LONGEST_NAME:
        expected = f"a file name without folders, of at most {_LONGEST_NAME} bytes, such as exercise_1{_SUFFIX}"
        raise DescriptionError(key="file", value=name, expected=expected)
    return folder / name


def write_sheet(file: Path, attempt: Attempt, student: str, picture: bytes | None = None) -> None:
    """Write the results of an attempt.

    Parameters
    ----------
    student
        Name, may be empty.
    picture
        Picture of the scene (PNG).

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    text = sheet_html(attempt, student, picture)
    with atomic_write(file) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sheet_html(attempt: Attempt, student: str, picture: bytes | None = None) -> str:
    """The text of a sheet; parameters as of `write_sheet`."""
    exercise, world, results = attempt.exercise, attempt.world, attempt.results
    is_passed = all(result.is_reached for result in results)
    title = escape(f"Exercise {exercise.number}: {exercise.title}")
    facts = {
        "student": student,
        "date": datetime.now().astimezone().isoformat(" ", "seconds"),
        "result": "passed" if is_passed else "not passed",
        "seed": str(world.seed),
        "deviations of the cell": " ".join(world.as_built) or "none",
        "scancell": __version__,
        "command": " ".join(command_words(None)),
    }
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>\n" for name, value in facts.items())
    shown = base64.b64encode(picture).decode() if picture else ""
    image = f'<p><img alt="the scene" src="data:image/png;base64,{shown}"></p>\n' if shown else ""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f"<style>{_STYLE}</style></head>\n<body><h1>{title}</h1>\n<p>{escape(exercise.task)}</p>\n"
        f"<table>\n{rows}</table>\n<h2>Items</h2>\n<table>\n"
        f"<tr><th>item</th><th>value</th><th>limit</th><th>result</th></tr>\n{''.join(map(_row, results))}</table>\n"
        f"{image}</body></html>\n"
    )


def _row(result: Result) -> str:
    reached = "passed" if result.is_reached else "not passed"
    cells = (result.item.text, result.value_text or "none", result.item.limit, reached)
    return f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>\n"
