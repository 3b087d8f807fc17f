"""Execution of scan programs on the simulated cell, with an FMU instance that is reused between runs."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from scancell.cell.driver import Driver
from scancell.cell.instance import CellInstance
from scancell.cell.program import Program
from scancell.cell.recording import Recording
from scancell.cell.reusable import ReusableCell
from scancell.cell.session import CellSession
from scancell.closing import Closing
from scancell.config.exposure_times import exposure_span
from scancell.progress import Progress
from scancell.scanning.world import World

FOLDER_PREFIX = "scancell-fmu-"


# Commands to the cell before the program starts, such as loading the part.
PreScanHook = Callable[[CellSession], None]


class FmuRunner(Closing):
    """Runs programs on one FMU instance, which is reset for each run."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._cell: ReusableCell | None = None
        self.token = ""

    def start(self, world: World, collision_outputs: bool = False) -> CellInstance:
        """The initialised instance at time 0, with the cell and its perturbations.

        Raises `DescriptionError` if a perturbation is unknown; `CellError` if the FMU cannot be built or reports an
        error.
        """
        if self._cell is None:
            # The process id in the name lets others remove what a killed process leaves.
            self._folder = Path(tempfile.mkdtemp(prefix=f"{FOLDER_PREFIX}{os.getpid()}-"))
            self._cell = ReusableCell(self._folder)
        instance = self._cell.start(world.for_fmu(collision_outputs), world.as_built)
        self.token = instance.token
        return instance

    def units(self, world: World) -> dict[str, str | None]:
        """Units of the deviations of the cell; raises the same errors as `start`."""
        return self.start(world).units()

    def run(self, world: World, program: Program, progress: Progress, hook: PreScanHook | None = None) -> Recording:
        """Recording of `program`, executed after the commands of `hook`, which may read collision outputs.

        Raises `DescriptionError` if a perturbation is unknown; `CellError` if the FMU cannot be built or reports an
        error, or its controller rejects a command of `hook`.
        """
        progress.stage("driving", program.duration, "s")
        cycle_us = world.setup.cell.world.controller_cycle_us
        try:
            cell = self.start(world, collision_outputs=hook is not None)
            if hook is not None:
                session = CellSession(cell, world.nominal, cycle_us)
                hook(session)
                session.check_start(program)
            return Driver(cell, cycle_us, exposure_span(world.setup.sensor)).run(program, progress.advance)
        except BaseException:
            if self._cell is not None:
                self._cell.discard()  # the state of the instance is unknown
            raise

    def close(self) -> None:
        """Free the instance and its files."""
        cell, self._cell = self._cell, None
        if cell is not None:
            cell.close()
        folder, self._folder = self._folder, None
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
