"""`scancell place`: how a free part is best set up for scanning."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from scancell.cli.common import (
    CellOption,
    JsonOption,
    Outcome,
    ScanOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
    run,
    show_progress,
)

if TYPE_CHECKING:
    from scancell.config.cell import CellDescription
    from scancell.planning.setups import SetUp


def place(
    part: Annotated[Path, typer.Argument(help="mesh (STL, OBJ, PLY) or artefact (TOML)")],
    cell: CellOption = None,
    sensor: SensorOption = None,
    scan: ScanOption = None,
    set_: SetOption = None,
    share: Annotated[
        float, typer.Option("--share", min=0.01, max=1.0, help="share of the accessible surface to be scanned")
    ] = 0.99,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="TOML file for the cell with the part set up; a second one gets _2"),
    ] = None,
    unit: UnitOption = "mm",
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Propose how a free part rests, where on the table and at what height it is scanned best; or two set-ups."""

    def work() -> Outcome:
        from scancell.config.loading import load_setup  # noqa: PLC0415
        from scancell.scanner import Scanner  # noqa: PLC0415

        setup = load_setup(cell, sensor, scan, set_ or [])
        with show_progress(as_json) as progress, Scanner(setup=setup, threads=threads) as scanner:
            found = scanner.place(part, share, unit=unit, progress=progress)
        lines = [f"{part.name}: {found.summary()}"]
        files = []
        for number, one in enumerate(found.chosen, start=1):
            title = f"set-up {number}: " if len(found.chosen) > 1 else ""
            lines.append(
                f"# {title}{100 * one.scanned:.1f} % of the whole surface in about {one.time:.0f} s;"
                f" tips over at {np.degrees(one.tip_angle):.0f} deg"
            )
            if one.riser is not None:
                size = " x ".join(f"{1e3 * length:.0f}" for length in np.ptp(one.riser.vertices, axis=0))
                lines.append(f"# on a riser of {size} mm")
            lines += one.toml.splitlines()
            if out is not None:
                files += _write(one, setup.cell, out if number == 1 else out.with_stem(f"{out.stem}_{number}"))
        return Outcome(lines, found.figures, files)

    run("place", as_json, work)


def _write(one: SetUp, cell: CellDescription, file: Path) -> list[str]:
    """Write the cell with a set-up, and its riser beside it; returns the files."""
    from scancell.files import atomic_write  # noqa: PLC0415
    from scancell.geometry.mesh_files import write_stl  # noqa: PLC0415

    riser = file.with_name(f"{file.stem}_riser.stl").absolute()
    written = [str(file)]
    if one.riser is not None:
        with atomic_write(riser) as temporary:
            write_stl(temporary, 1e3 * one.riser.vertices, one.riser.faces)
        written.append(str(riser))
    one.in_cell(cell, str(riser)).to_toml(file)
    return written
