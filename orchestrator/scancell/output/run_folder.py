"""Result folders that are written atomically."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from scancell.errors import DescriptionError, OutputError
from scancell.files import read_json
from scancell.stopwatch import Stopwatch
from scancell.values import Result

MANIFEST = "manifest.json"


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

    Files and folders of an earlier run are replaced; others in `target` remain.

    Parameters
    ----------
    target
        The folder of the run.
    optional
        Names that not every run of this kind writes: those that the manifest of an earlier run in `target` states as
        its files are removed, unless this run writes them, too. Files of others with such names remain.

    Attributes
    ----------
    names
        Names of the files and folders moved to `target`.

    Raises
    ------
    OutputError
        On entry, if `target` cannot be created or written.
    """

    def __init__(self, target: Path, optional: Sequence[str] = ()) -> None:
        self.target = target
        self._optional = optional
        self._staging = target.parent / f".{target.name}.partial-{secrets.token_hex(4)}"
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

    def _files_of_earlier_run(self) -> set[str]:
        with suppress(DescriptionError):
            stated = read_json(self.target / MANIFEST)
            files = stated.get("files") if isinstance(stated, dict) else None
            return {name for name in files if isinstance(name, str)} if isinstance(files, list) else set()
        return set()

    def _publish(self) -> None:
        try:
            self.target.mkdir(exist_ok=True)
            written = sorted(item.name for item in self._staging.iterdir())
            former = self._files_of_earlier_run().intersection(self._optional)
            if (self._staging / MANIFEST).is_file():
                stated = {**read_json(self._staging / MANIFEST), "files": written}
                (self._staging / MANIFEST).write_text(json.dumps(stated, indent=1) + "\n")
            for name in {*written, *former}:
                if (self.target / name).is_dir():
                    shutil.rmtree(self.target / name)
                elif name not in written:
                    (self.target / name).unlink(missing_ok=True)
            for name in written:
                (self._staging / name).replace(self.target / name)
                self.names.append(name)
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", file=self.target) from None
