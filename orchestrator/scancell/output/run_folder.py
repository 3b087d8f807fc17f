"""Result folders that are written atomically."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from scancell.errors import OutputError
from scancell.stopwatch import Stopwatch
from scancell.values import Result


@dataclass(eq=False, repr=False)
class RunReport(Result):
    """Outcome of a command: figures, lines of text, warnings, files, and `timings`, the wall time (s) by step.

    Examples
    --------
    >>> report = scancell.RunReport({"exposures": 1}, ["1 exposures: 2520 points"])
    >>> report
    RunReport(1 exposures: 2520 points)
    >>> report.figures["exposures"]
    1
    """

    figures: dict[str, Any]
    lines: list[str]
    warnings: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    timings: dict[str, float] = field(default_factory=dict)

    def summary(self) -> str:
        """The lines of text."""
        return "\n".join(self.lines)


def run_into(out: Path, work: Callable[[RunFolder, Stopwatch], RunReport]) -> RunReport:
    """Report of `work`, completed with its files and timings; the files appear in `out` only if it succeeds.

    Raises
    ------
    OutputError
        If `out` cannot be created or written.
    """
    watch = Stopwatch()
    with RunFolder(out) as folder:
        report = work(folder, watch)
    report.files = [str(path) for path in folder.paths]
    report.timings = dict(watch.seconds)
    return report


class RunFolder:
    """Context manager that stages files in a hidden folder beside `target` and moves them there on success.

    Folders of an earlier run with the same name are replaced; other files in `target` remain.

    Attributes
    ----------
    names
        Names of the files and folders moved to `target`.

    Raises
    ------
    OutputError
        On entry, if `target` cannot be created or written.
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        self._staging = target.parent / f".{target.name}.partial-{os.getpid()}"
        self.names: list[str] = []
        self._created: list[Path] = []

    @property
    def paths(self) -> list[Path]:
        """Paths of the files and folders moved to `target`."""
        return [self.target / name for name in self.names]

    def path(self, name: str) -> Path:
        """Staging path of the file `name`; its folder exists."""
        path = self._staging / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def __enter__(self) -> Self:
        try:
            if self.target.exists() and not self.target.is_dir():
                raise OutputError("is a file", file=self.target, expected="a folder")
            self._make_parents()
            self._staging.mkdir()
            if self.target.exists() and not os.access(self.target, os.W_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            self._clear()
            raise OutputError(f"cannot be written: {error.strerror}", file=self.target) from None
        except BaseException:  # an interrupt before the context is entered
            self._clear()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._publish()
        finally:
            self._clear()

    def _make_parents(self) -> None:
        parent = self.target.parent
        missing = [folder for folder in (parent, *parent.parents) if not folder.exists()]
        for folder in reversed(missing):
            folder.mkdir(exist_ok=True)
            self._created.append(folder)

    def _clear(self) -> None:
        """Remove the staging folder, and the parent folders created for it that are empty."""
        shutil.rmtree(self._staging, ignore_errors=True)
        for folder in reversed(self._created):
            with suppress(OSError):  # not empty
                folder.rmdir()

    def _publish(self) -> None:
        try:
            self.target.mkdir(exist_ok=True)
            for item in sorted(self._staging.iterdir()):
                destination = self.target / item.name
                if item.is_dir() and destination.is_dir():
                    shutil.rmtree(destination)
                item.replace(destination)
                self.names.append(item.name)
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", file=self.target) from None
