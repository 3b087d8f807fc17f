"""`scancell fmu`: build and inspect FMUs of the robot cell."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

import scancell
from scancell.cli.common import Outcome, SeedOption, SetOption, UnitOption, command


@command("fmu build")
def fmu_build(
    cell: Annotated[Path | None, typer.Argument(help="cell description (TOML)")] = None,
    part: Annotated[Path | None, "mesh of the part on the table"] = None,
    settings: SetOption = None,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    out: Annotated[Path, "folder for the FMUs"] = Path("out"),
    fmi: Annotated[int | None, typer.Option(min=2, max=3, help="only this FMI version")] = None,
    clock: Annotated[bool, "FMI 3: declare the clock trigger.clock (some importers fail on clocks)"] = False,
    arrays: Annotated[bool, "FMI 3: array variables instead of indexed scalars (few importers read arrays)"] = False,
    integers: Annotated[bool, "integers instead of enumerations, for libcosim and ecos"] = False,
    ahead: Annotated[bool, "controller.ahead, the path ahead of the controller, which a guard reads"] = False,
    records: Annotated[bool, "FMI 3: arrays of all records that a communication step completed"] = False,
    sequencer: Annotated[bool, "also write CellSequencer2.fmu and CellSequencer3.fmu, which command it"] = False,
    sensor: Annotated[
        bool,
        "also write ProfileSensor3.fmu (FMI 3), which gives the profile of each trigger; of each further sensor, too",
    ] = False,
) -> Outcome:
    """Write the co-simulation FMUs of a cell: RobotCell2.fmu (FMI 2.0) and RobotCell3.fmu (FMI 3.0)."""
    from scancell.cell.fmu_file import (  # noqa: PLC0415
        build_fmu,
        build_sensor_fmu,
        build_sequencer_fmu,
        simplified,
    )
    from scancell.nominal.cell import with_unknown_obstacles  # noqa: PLC0415

    setup = scancell.load_setup(cell, settings=settings or [])
    example = scancell.assets_dir() / "parts" / "step_block.stl"
    mesh = scancell.load_part(part, unit) if part else scancell.load_part(example)
    nominal = with_unknown_obstacles(scancell.nominal_cell(setup.cell, mesh), setup.cell)
    description = scancell.cell_json(setup.cell, nominal, seed)
    files = []
    options = scancell.FmuOptions(clock=clock, arrays=arrays, integers=integers, ahead=ahead, records=records)
    for version in (fmi,) if fmi else (2, 3):
        path = out / f"RobotCell{version}.fmu"
        build_fmu(description, path, 2 if version == 2 else 3, options)
        files.append(str(path))
        if sequencer:
            path = out / f"CellSequencer{version}.fmu"
            build_sequencer_fmu(description, path, 2 if version == 2 else 3)
            files.append(str(path))
    if sensor:
        from scancell.scanning.pipeline import ScanPipeline  # noqa: PLC0415

        with ScanPipeline() as pipeline:
            for world in pipeline.load(setup, mesh, seed=seed).sensors:
                path = out / f"ProfileSensor3{'' if world.number == 1 else f'_{world.name}'}.fmu"
                build_sensor_fmu(world.for_sensor_fmu(), path)
                files.append(str(path))
    sizes = {Path(file).name: Path(file).stat().st_size for file in files}
    lighter = simplified(setup.cell, nominal)
    lines = [f"{file}: {Path(file).stat().st_size / 1e6:.1f} MB" for file in files]
    figures = {"bytes": sizes, "simplified": [asdict(body) for body in lighter]}
    return Outcome([*lines, *(body.line() for body in lighter)], figures, files)


@command("fmu info")
def fmu_info(
    fmu: Annotated[Path, "FMU file, or folder of an unpacked FMU"],
    filter_: Annotated[str, typer.Option(metavar="PREFIX", help="only variables whose name starts with this")] = "",
) -> Outcome:
    """Show version, token and variables of an FMU: name, unit, start value and description of each."""
    from scancell.cell.fmu_info import describe_fmu  # noqa: PLC0415

    info = describe_fmu(fmu)
    return Outcome(info.lines(filter_), info.figures(filter_))


@command("ssp build")
def ssp_build(
    cell: Annotated[Path | None, typer.Argument(help="cell description (TOML)")] = None,
    part: Annotated[Path | None, "mesh of the part that is scanned"] = None,
    settings: SetOption = None,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    out: Annotated[Path, "file of the package"] = Path("out/RobotCell.ssp"),
    stop_time: Annotated[float, "end of the default experiment, s"] = 30.0,
    ssp: Annotated[Literal["1.0", "2.0"], "version of SSP"] = "1.0",
) -> Outcome:
    """Write an SSP package: the FMU (FMI 2.0) of a cell, and a sequencer FMU that lets it pick, scan and jog."""
    from scancell.cell.driver import example_sequence  # noqa: PLC0415
    from scancell.cell.ssp import build_ssp  # noqa: PLC0415
    from scancell.nominal.cell import with_unknown_obstacles  # noqa: PLC0415

    setup = scancell.load_setup(cell, settings=settings or [])
    example = scancell.assets_dir() / "parts" / "step_block.stl"
    mesh = scancell.load_part(part, unit) if part else scancell.load_part(example)
    nominal = scancell.nominal_cell(setup.cell, mesh)
    steps = example_sequence(setup, nominal)
    description = scancell.cell_json(setup.cell, with_unknown_obstacles(nominal, setup.cell), seed)
    build_ssp(description, steps, out, stop_time=stop_time, version=ssp)
    size = out.stat().st_size
    figures = {"bytes": size, "steps": len(steps), "stop_time": stop_time}
    return Outcome([f"{out}: {size / 1e6:.1f} MB, {len(steps)} steps"], figures, [str(out)])


@command("robot from-urdf")
def from_urdf(
    urdf: Annotated[Path, "URDF file of a serial arm of 4 to 8 joints, and of what is around it"],
    tip: Annotated[str, typer.Option(help="link at the end of the arm, which carries the tool")],
    out: Annotated[Path, typer.Option(help="robot file (TOML) to write; meshes go into a folder beside")],
    cell: Annotated[
        Path | None, "cell description (TOML) to write: axes before arm and table, table, obstacles"
    ] = None,
    base: Annotated[str | None, "link on which the arm stands; joints before it become axes of the cell"] = None,
    table: Annotated[str | None, "link that becomes the table; the last joint before it turns it"] = None,
    home: Annotated[str | None, "joint angles of the home position, deg, commas between them"] = None,
    hold: Annotated[
        list[int] | None, "joint that inverse kinematics holds: one for each beyond six; repeatable"
    ] = None,
) -> Outcome:
    """Write the arm of a URDF file as a robot file, and with --cell its axes, table and fixed links as a cell."""
    import numpy as np  # noqa: PLC0415

    from scancell.errors import DescriptionError  # noqa: PLC0415
    from scancell.geometry import pose  # noqa: PLC0415
    from scancell.nominal.from_urdf import RAMP_TIME, robot_from_urdf  # noqa: PLC0415

    try:
        angles = [float(word) for word in (home or "").split(",") if word.strip()]
    except ValueError:
        raise DescriptionError(key="home", value=home, expected="angles with commas between them") from None
    made = robot_from_urdf(urdf, tip, out, angles, hold or (), cell=cell, base=base, table=table)
    figures = {"joints": len(made.description.joint)}
    lines = [
        f"{made.description.name}: {len(made.description.joint)} joints",
        f"  written to {out}",
        f"  accelerations are assumed: full speed in {RAMP_TIME:g} s (max_acceleration)",
    ]
    warnings = list(made.warnings)
    remainder = made.flange_from_tip
    if made.cell is not None:
        figures |= {"axes": len(made.cell.axis), "obstacles": len(made.cell.obstacle)}
        carried = [
            ("the arm", made.cell.robot_moves_with),
            ("the table", made.cell.table.moves_with),
            *((f"axis '{axis.name}'", axis.moves_with) for axis in made.cell.axis),
            *((f"obstacle '{obstacle.name}'", obstacle.moves_with) for obstacle in made.cell.obstacle),
        ]
        lines.append(f"  cell written to {cell}: {len(made.cell.axis)} axes, {len(made.cell.obstacle)} obstacles")
        for carrier in ("world", *(axis.name for axis in made.cell.axis)):
            names = [name for name, moves_with in carried if moves_with == carrier]
            lines.append(f"    {carrier} carries {', '.join(names) or 'nothing'}")
    elif np.abs(remainder - np.eye(4)).max() > 1e-9:
        x, y, z = 1e3 * remainder[:3, 3]
        rx, ry, rz = np.degrees(pose.euler_xyz_from_rotation(remainder[:3, :3]))
        warnings.append(
            f"link '{tip}' is not the flange of the file: its pose on the flange, to be put before the tool, is"
            f" x_mm = {x:.6f}, y_mm = {y:.6f}, z_mm = {z:.6f}, rx_deg = {rx:.6f}, ry_deg = {ry:.6f},"
            f" rz_deg = {rz:.6f}"
        )
    return Outcome(lines, figures, [str(file) for file in made.files], warnings)
