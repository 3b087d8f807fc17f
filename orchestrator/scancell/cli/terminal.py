"""Progress on a terminal: bar, rate and time left."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text


class _Rate(ProgressColumn):
    """Steps per second in the stage's unit."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:,.1f} {task.fields['unit']}/s")


class TerminalProgress:
    """One line per stage on standard error."""

    def __init__(self) -> None:
        self._bars = Progress(
            TextColumn("{task.description:<12}"),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f} {task.fields[unit]}"),
            _Rate(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        self._current = self._bars.add_task("starting", total=1, unit="")
        self._begun = False

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a stage."""
        if self._begun:
            self._current = self._bars.add_task(name, total=total, unit=unit)
        else:
            self._bars.update(self._current, description=name, total=total, unit=unit)
            self._begun = True

    def advance(self, steps: float) -> None:
        """Move the bar of the present stage."""
        self._bars.advance(self._current, steps)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()
