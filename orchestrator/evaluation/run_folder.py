"""A folder of results that appears whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from orchestrator.errors import OutputError
from orchestrator.evaluation.request import ScanReport
from orchestrator.evaluation.stopwatch import Stopwatch


def run_into(out: Path, work: Callable[[RunFolder, Stopwatch], ScanReport]) -> ScanReport:
    """Do a piece of work that leaves its files in `out`, whole or not at all; its report learns their names.

    Raises
    ------
    OutputError
        If `out` cannot be made or written.
    """
    watch = Stopwatch()
    with RunFolder(out) as folder:
        report = work(folder, watch)
    report.files = [str(out / name) for name in folder.names]
    report.timings = dict(watch.seconds)
    return report


class RunFolder:
    """Collects files in a hidden folder beside `target`; they move to `target` when the block ends without error.

    Files of an earlier run that this run does not write stay; folders that it writes are replaced.

    Raises
    ------
    OutputError
        If `target` cannot be made or written, before any work is done.
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        self._staging = target.parent / f".{target.name}.partial-{os.getpid()}"
        self.names: list[str] = []
        self._made: list[Path] = []

    def path(self, name: str) -> Path:
        """Where to write the file `name`, for now."""
        path = self._staging / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def __enter__(self) -> Self:
        try:
            if self.target.exists() and not self.target.is_dir():
                raise OutputError(f"{self.target}: expected a folder, found a file")
            self._make_parents()
            self._staging.mkdir()
            if self.target.exists() and not os.access(self.target, os.W_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            self._clear()
            raise OutputError(f"{self.target}: cannot be written: {error.strerror}") from None
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
            self._made.append(folder)

    def _clear(self) -> None:
        """Remove what was staged, and the folders made for it that are still empty."""
        shutil.rmtree(self._staging, ignore_errors=True)
        for folder in reversed(self._made):
            with suppress(OSError):  # it holds something by now
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
            raise OutputError(f"{self.target}: cannot be written: {error.strerror}") from None
