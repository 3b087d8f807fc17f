"""The file in which a workspace keeps the program that is taught."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import RLock

from scancell.errors import OutputError, ScancellError
from scancell.files import atomic_write, first_free, read_text
from scancell.programs.taught import TaughtProgram
from scancell.programs.taught_text import program_text, read_program


class TaughtFile:
    """A taught program in a file, which may also be edited by hand. All methods are thread-safe.

    Attributes
    ----------
    path
        Of the file; without it the program is empty.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = RLock()
        self._text = ""
        self._program = TaughtProgram()

    @property
    def text(self) -> str:
        """Content of the file; that of an empty program without it.

        Raises
        ------
        OutputError
            If it cannot be read.
        """
        if not self.path.exists():
            return program_text(TaughtProgram())
        return read_text(self.path, OutputError)

    @property
    def program(self) -> TaughtProgram:
        """The program of the file.

        Raises
        ------
        DescriptionError
            With the line, if the file was edited to something that is no list of steps.
        OutputError
            If it cannot be read.
        """
        with self._lock:
            text = self.text
            if text != self._text:
                self._program, self._text = read_program(text, str(self.path)), text
            return self._program

    @property
    def count(self) -> int:
        """Number of steps; 0 if the file cannot be read."""
        try:
            return len(self.program.steps)
        except ScancellError:
            return 0

    def edit(self, change: Callable[[TaughtProgram], TaughtProgram]) -> None:
        """Replace the program by `change` of it, and write the file.

        Raises
        ------
        ScancellError
            As of `program` and of the change; if the file cannot be written.
        """
        with self._lock:
            self.write(change(self.program))

    def write(self, program: TaughtProgram) -> None:
        """Write the file with a program.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        with self._lock, atomic_write(self.path) as temporary:
            temporary.write_text(program_text(program), encoding="utf-8")

    def set_aside(self) -> Path | None:
        """Begin an empty program: rename the file to the first of ``taught_1.py``, ``taught_2.py``, ... that is free.

        Returns
        -------
        Path or None
            The new name; None if there is no file.

        Raises
        ------
        OutputError
            If it cannot be renamed.
        """
        with self._lock:
            kept = first_free(self.path.parent, f"{self.path.stem}_{{}}{self.path.suffix}")
            try:
                return self.path.rename(kept)
            except FileNotFoundError:
                return None
            except OSError as error:
                raise OutputError(f"cannot be renamed: {error.strerror}", file=self.path) from error
