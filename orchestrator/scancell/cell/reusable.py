"""A cell that can be restarted with other descriptions without loading its FMU again."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from scancell.cell.as_built import parse_as_built
from scancell.cell.fmu_file import make_temporary_fmu
from scancell.cell.instance import CellInstance
from scancell.closing import Closing
from scancell.errors import ScancellError


class ReusableCell(Closing):
    """Keeps an FMU instance from one `start` to the next and resets it where the new cell has the same variables.

    Use it as a context manager. Its files lie in a new folder in `folder`, or where the system keeps temporary files.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="scancell-cell-", dir=folder))
        self._instance: CellInstance | None = None
        self._built = 0

    def start(self, description: Mapping[str, Any], as_built: Sequence[str] = ()) -> CellInstance:
        """The instance at time 0, of the cell of a description (`cell_json`) with perturbations (``key=value``).

        The instance belongs to this object: it is valid until the next `start`, `discard` or `close`.

        Raises
        ------
        DescriptionError
            If a perturbation is unknown.
        CellError
            If the FMU cannot be built or refuses the cell.
        """
        if self._instance is not None:
            file = self._folder / "cell.json"
            file.write_text(json.dumps(description))
            try:
                self._instance.reset(file, parse_as_built(as_built, self._instance.units()))
            except ScancellError:  # its variables are others, or a new FMU refuses the cell, too
                self.discard()
            except BaseException:
                self.discard()
                raise
            else:
                return self._instance
        fmu = make_temporary_fmu(description, self._folder / f"fmu{self._built}")
        self._built += 1
        self._instance = CellInstance(fmu, parameters=lambda units: parse_as_built(as_built, units))
        return self._instance

    def discard(self) -> None:
        """Free the instance, which may be unusable after an error; the next `start` makes another."""
        instance, self._instance = self._instance, None
        if instance is not None:
            with suppress(Exception):
                instance.close()

    def close(self) -> None:
        """Free the instance and its files."""
        self.discard()
        shutil.rmtree(self._folder, ignore_errors=True)
