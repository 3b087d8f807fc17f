"""`scancell ssp`: build packages of the robot cell and a controller of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scancell.cli.common import Outcome, command
from scancell.cli.options import SeedOption, SetOption, UnitOption


@command("ssp build")
def ssp_build(
    cell: Annotated[Path | None, typer.Argument(help="cell description (TOML)")] = None,
    part: Annotated[Path | None, typer.Option("--part", help="mesh of the part that is scanned")] = None,
    set_: SetOption = None,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    out: Annotated[Path, typer.Option("--out", help="file of the package")] = Path("out/RobotCell.ssp"),
    stop_time: Annotated[float, typer.Option("--stop-time", help="end of the default experiment, s")] = 30.0,
    ssp: Annotated[Literal["1.0", "2.0"], typer.Option("--ssp", help="version of SSP")] = "1.0",
) -> Outcome:
    """Write an SSP package: the FMU (FMI 2.0) of a cell, and a sequencer FMU that lets it pick, scan and jog."""
    from scancell.cell.fmu_file import cell_json  # noqa: PLC0415
    from scancell.cell.sequence import example_sequence  # noqa: PLC0415
    from scancell.cell.ssp import build_ssp  # noqa: PLC0415
    from scancell.config.loading import assets_dir, load_setup  # noqa: PLC0415
    from scancell.nominal.cell import nominal_cell, with_unknown_obstacles  # noqa: PLC0415
    from scancell.nominal.parts import load_part  # noqa: PLC0415

    setup = load_setup(cell, settings=set_ or [])
    mesh = load_part(part, unit) if part else load_part(assets_dir() / "parts" / "step_block.stl")
    nominal = nominal_cell(setup.cell, mesh)
    steps = example_sequence(setup, nominal)
    description = cell_json(setup.cell, with_unknown_obstacles(nominal, setup.cell), seed)
    build_ssp(description, steps, out, stop_time=stop_time, version=ssp)
    size = out.stat().st_size
    figures = {"bytes": size, "steps": len(steps), "stop_time": stop_time}
    return Outcome([f"{out}: {size / 1e6:.1f} MB, {len(steps)} steps"], figures, [str(out)])
