"""Runs a program on the simulated cell."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator.cell.as_built import parse_as_built
from orchestrator.cell.driver import DriveOptions, Driver
from orchestrator.cell.fmu_file import build_fmu, cell_json
from orchestrator.cell.fmu_info import describe_fmu
from orchestrator.cell.fmu_package.contents import THROWN_AWAY
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.nominal import NominalCell
from orchestrator.cell.program import Program
from orchestrator.cell.recording import Recording
from orchestrator.cell.session import CellSession
from orchestrator.config.loading import Setup
from orchestrator.progress import Progress


@dataclass(frozen=True)
class Drive:
    """What became of a program: the recording, and which FMU ran it."""

    recording: Recording
    fmu_token: str


# Commands to the cell that come before the program.
Before = Callable[[CellSession], None]


def drive(
    setup: Setup,
    nominal: NominalCell,
    program: Program,
    as_built: Sequence[str],
    seed: int,
    progress: Progress,
    before: Before | None = None,
) -> Drive:
    """Build the cell's FMU, perturb it, and let it run `program`.

    Parameters
    ----------
    as_built
        Perturbations as ``key=value`` words, see `orchestrator.cell.as_built`; those of the sensor do not matter here.
    before
        What is to happen first: it brings the part to the table, say, and the axes to where the program starts.

    Raises
    ------
    DescriptionError
        If a perturbation is unknown.
    CellError
        If the FMU cannot be built or reports an error, or its controller refuses what comes `before`.
    """
    with tempfile.TemporaryDirectory(prefix="scancell-") as folder:
        fmu = Path(folder) / "RobotCell2.fmu"
        build_fmu(cell_json(setup.cell, nominal, seed), fmu, 2, THROWN_AWAY)
        progress.stage("driving", program.duration, "s")
        options = DriveOptions.of(setup)
        with CellInstance(fmu, parameters=lambda units: parse_as_built(as_built, units)) as cell:
            if before is not None:
                session = CellSession(cell, nominal, options.cycle_us)
                before(session)
                session.check_start(program)
            recording = Driver(cell, options).run(program, progress.advance)
        return Drive(recording, describe_fmu(fmu).token)
