"""An attempt at an exercise in a live cell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from threading import RLock

from scancell.cell.recording import Recording
from scancell.errors import DescriptionError
from scancell.exercises.declaration import Exercise, Item, Question
from scancell.exercises.situation import FinishedRun, Situation
from scancell.live.cell import LiveCell
from scancell.live.contacts import ContactWatch
from scancell.programs.live_program import LiveProgram
from scancell.programs.program import ProgramRun
from scancell.programs.taught_file import TaughtFile
from scancell.reconstruction.cloud import Cloud
from scancell.scanning.session import ScanSession


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
