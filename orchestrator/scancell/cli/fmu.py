"""`scancell fmu`: build and inspect FMUs of the robot cell."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from scancell.cli.common import Outcome, command
from scancell.cli.options import SeedOption, SetOption, UnitOption


@command("fmu build")
def fmu_build(
    cell: Annotated[Path | None, typer.Argument(help="cell description (TOML)")] = None,
    part: Annotated[Path | None, typer.Option("--part", help="mesh of the part on the table")] = None,
    set_: SetOption = None,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    out: Annotated[Path, typer.Option("--out", help="folder for the FMUs")] = Path("out"),
    fmi: Annotated[int | None, typer.Option("--fmi", min=2, max=3, help="only this FMI version")] = None,
    clock: Annotated[
        bool, typer.Option("--clock", help="FMI 3: declare the clock trigger.clock (some importers fail on clocks)")
    ] = False,
    arrays: Annotated[
        bool,
        typer.Option("--arrays", help="FMI 3: array variables instead of indexed scalars (few importers read arrays)"),
    ] = False,
    integers: Annotated[
        bool, typer.Option("--integers", help="integers instead of enumerations, for libcosim and ecos")
    ] = False,
    ahead: Annotated[
        bool, typer.Option("--ahead", help="controller.ahead, the path ahead of the controller, which a guard reads")
    ] = False,
    records: Annotated[
        bool, typer.Option("--records", help="FMI 3: arrays of all records that a communication step completed")
    ] = False,
    sequencer: Annotated[
        bool, typer.Option("--sequencer", help="also write CellSequencer2.fmu and CellSequencer3.fmu, which command it")
    ] = False,
) -> Outcome:
    """Write the co-simulation FMUs of a cell: RobotCell2.fmu (FMI 2.0) and RobotCell3.fmu (FMI 3.0)."""
    from scancell.cell.fmu_file import build_fmu, build_sequencer_fmu, cell_json  # noqa: PLC0415
    from scancell.cell.fmu_package.contents import FmuOptions  # noqa: PLC0415
    from scancell.cell.sensing import simplified  # noqa: PLC0415
    from scancell.config.loading import assets_dir, load_setup  # noqa: PLC0415
    from scancell.nominal.cell import nominal_cell, with_unknown_obstacles  # noqa: PLC0415
    from scancell.nominal.parts import load_part  # noqa: PLC0415

    setup = load_setup(cell, settings=set_ or [])
    mesh = load_part(part, unit) if part else load_part(assets_dir() / "parts" / "step_block.stl")
    nominal = with_unknown_obstacles(nominal_cell(setup.cell, mesh), setup.cell)
    description = cell_json(setup.cell, nominal, seed)
    files = []
    options = FmuOptions(clock=clock, arrays=arrays, integers=integers, ahead=ahead, records=records)
    for version in (fmi,) if fmi else (2, 3):
        path = out / f"RobotCell{version}.fmu"
        build_fmu(description, path, 2 if version == 2 else 3, options)
        files.append(str(path))
        if sequencer:
            path = out / f"CellSequencer{version}.fmu"
            build_sequencer_fmu(description, path, 2 if version == 2 else 3)
            files.append(str(path))
    sizes = {Path(file).name: Path(file).stat().st_size for file in files}
    lighter = simplified(setup.cell, nominal)
    lines = [f"{file}: {Path(file).stat().st_size / 1e6:.1f} MB" for file in files]
    figures = {"bytes": sizes, "simplified": [asdict(body) for body in lighter]}
    return Outcome([*lines, *(body.line() for body in lighter)], figures, files)


@command("fmu info")
def fmu_info(
    fmu: Annotated[Path, typer.Argument(help="FMU file, or folder of an unpacked FMU")],
    filter_: Annotated[
        str, typer.Option("--filter", metavar="PREFIX", help="only variables whose name starts with this")
    ] = "",
) -> Outcome:
    """Show version, token and variables of an FMU: name, unit, start value and description of each."""
    from scancell.cell.fmu_info import describe_fmu  # noqa: PLC0415

    info = describe_fmu(fmu)
    return Outcome(info.lines(filter_), info.figures(filter_))
