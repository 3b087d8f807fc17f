"""The `scancell` command."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from scancell.cli.acceptance import acceptance
from scancell.cli.batch import batch
from scancell.cli.calibrate import calibrate
from scancell.cli.common import (
    JsonOption,
    Outcome,
    PathOption,
    ScanOption,
    SetOption,
    ThreadsOption,
    run,
    show_progress,
)
from scancell.cli.evaluate import evaluate
from scancell.cli.fmu import fmu_app
from scancell.cli.groups import GroupedCommands
from scancell.cli.guard import guard_app
from scancell.cli.interrupts import INTERRUPTS
from scancell.cli.mesh import mesh
from scancell.cli.options import CellOptions, CloudOptions, with_options
from scancell.cli.pictures import animate, export, page, picture
from scancell.cli.place import place
from scancell.cli.plan import plan
from scancell.cli.program import run_program
from scancell.cli.robot import robot_app
from scancell.cli.study import study_app
from scancell.cli.survey import survey
from scancell.cli.workspace import workspace
from scancell.config.choices import ScanMode

# Typer brings a copy of click along; its error for a wrong command line is the base of one that typer exports.
_UsageError = cast(type[Any], typer.BadParameter.__base__)

app = typer.Typer(
    cls=GroupedCommands,
    help="A robot cell that scans parts in 3D with a laser profile sensor, simulated end to end.",
    no_args_is_help=True,
    rich_markup_mode=None,  # importing rich takes longer than the rest of the help
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(acceptance)
app.command()(animate)
app.command()(batch)
app.command()(evaluate)
app.command()(export)
app.command()(mesh)
app.command()(page)
app.command()(picture)
app.command()(place)
app.command()(calibrate)
app.command()(plan)
app.command("run")(run_program)
app.command()(survey)
app.command()(workspace)
app.add_typer(fmu_app, name="fmu")
app.add_typer(guard_app, name="guard")
app.add_typer(robot_app, name="robot")
app.add_typer(study_app, name="study")


@app.command()
@with_options(CloudOptions)
def scan(
    part: Annotated[Path, typer.Argument(help="mesh (STL, OBJ, PLY) or artefact (TOML)")],
    options: CloudOptions,
    scan: ScanOption = None,
    path: PathOption = None,
    plan: Annotated[
        Path | None, typer.Option("--plan", help="plan.json of `scancell plan --out` or a run, in place of a new plan")
    ] = None,
    mode: Annotated[
        ScanMode | None, typer.Option("--mode", help="how the sensor is moved; overrides the scan description")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/scan"),
) -> None:
    """Scan a part with the simulated cell: cloud, deviation from the mesh, pictures."""

    def work() -> Outcome:
        from scancell.config.loading import with_path  # noqa: PLC0415
        from scancell.scanner import Scanner  # noqa: PLC0415

        setup = with_path(options.setup(scan, [f'scan.mode="{mode}"'] if mode else []), path)
        with show_progress(options.as_json) as progress, Scanner(setup=setup, threads=options.threads) as scanner:
            return options.run_into(out, setup, progress, lambda given: scanner.scan(part, plan=plan, **given))

    run("scan", options.as_json, work)


@app.command()
def rerun(
    run_folder: Annotated[Path, typer.Argument(help="run folder, or its resolved.toml")],
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/rerun"),
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Repeat a scan from the descriptions that its run folder holds."""

    def work() -> Outcome:
        from scancell.config.description import validate  # noqa: PLC0415
        from scancell.config.loading import load_resolved  # noqa: PLC0415
        from scancell.config.sensor import SensorDescription  # noqa: PLC0415
        from scancell.scanner import Scanner  # noqa: PLC0415

        resolved = run_folder / "resolved.toml" if run_folder.is_dir() else run_folder
        setup, made = load_resolved(resolved)
        options = CloudOptions(
            engine=made["engine"],
            as_built=made["as_built"],
            seed=made["seed"],
            unit=made["unit"],
            as_json=as_json,
        )
        part, calibrated = Path(made["part"]), None
        if "estimated_sensor" in made:
            calibrated = validate(SensorDescription, made["estimated_sensor"], f"{resolved}: run.estimated_sensor")
        with show_progress(as_json) as progress, Scanner(setup=setup, threads=threads) as scanner:
            if "recording" in made:
                recording = Path(made["recording"])
                return options.run_into(
                    out,
                    setup,
                    progress,
                    lambda given: scanner.render(recording, part, estimated_sensor=calibrated, **given),
                )
            plan_file = made.get("plan")
            return options.run_into(
                out,
                setup,
                progress,
                lambda given: scanner.scan(part, plan=plan_file, estimated_sensor=calibrated, **given),
            )

    run("rerun", as_json, work)


@app.command()
@with_options(CellOptions)
def shot(
    part: Annotated[Path, typer.Argument(help="mesh (STL, OBJ, PLY) or artefact (TOML)")],
    options: CellOptions,
    pose: Annotated[
        str, typer.Option("--pose", help="part_from_sensor: x,y,z in mm and XYZ' angles rx,ry,rz in degrees")
    ],
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/shot"),
) -> None:
    """Expose once from a given pose: the camera images and one profile."""

    def work() -> Outcome:
        from scancell.geometry.pose import from_euler_xyz  # noqa: PLC0415
        from scancell.scanner import Scanner  # noqa: PLC0415

        with Scanner(setup=options.setup(), threads=options.threads) as scanner:
            numbers = _numbers(pose, 6, "pose")
            result = scanner.shot(
                part,
                from_euler_xyz([1e-3 * value for value in numbers[:3]], [math.radians(angle) for angle in numbers[3:]]),
                unit=options.unit,
                engine=options.engine,
                as_built=options.as_built or (),
                seed=options.seed,
            )
        files = [str(path) for path in result.save(out)]
        lines = [result.summary(), f"  results    {out}"]
        return Outcome(lines, result.figures, files, list(result.warnings))

    run("shot", options.as_json, work)


@app.command()
@with_options(CloudOptions)
def render(
    recording: Annotated[Path, typer.Argument(help="table of trigger records (Parquet or CSV), columns as in the FMU")],
    part: Annotated[Path, typer.Argument(help="mesh (STL, OBJ, PLY) or artefact (TOML)")],
    options: CloudOptions,
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/render"),
) -> None:
    """Make images and a cloud from poses that any FMI tool recorded."""

    def work() -> Outcome:
        from scancell.scanner import Scanner  # noqa: PLC0415

        with (
            show_progress(options.as_json) as progress,
            Scanner(setup=options.setup(), threads=options.threads) as scanner,
        ):
            return options.run_into(
                out, scanner.setup, progress, lambda given: scanner.render(recording, part, **given)
            )

    run("render", options.as_json, work)


@app.command()
def extract(
    images: Annotated[
        list[Path], typer.Argument(help="images (PNG, TIFF, BMP) with the camera's name in the file name, or folders")
    ],
    sensor: Annotated[Path, typer.Option("--sensor", help="sensor description (TOML) with the calibrated cameras")],
    set_: SetOption = None,
    laser_off: Annotated[
        list[Path] | None,
        typer.Option(
            "--laser-off", help="images, or folders, of the same names with the laser off (background), to subtract"
        ),
    ] = None,
    sheet_um: Annotated[
        float | None,
        typer.Option("--sheet-um", min=0, help="flag points that, by two cameras, are farther off the laser's sheet"),
    ] = None,
    peaks: Annotated[bool, typer.Option("--peaks", help="write every peak that was found, chosen or not")] = False,
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/extract"),
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Measure the stripe in images of a sensor, real or simulated: profiles as CSV and PLY."""

    def work() -> Outcome:
        from scancell.api import extract as extract_profiles  # noqa: PLC0415

        return Outcome.of(
            extract_profiles(
                images,
                out,
                sensor=sensor,
                settings=set_ or [],
                laser_off=laser_off or [],
                sheet_um=sheet_um,
                peaks=peaks,
                threads=threads,
            )
        )

    run("extract", as_json, work)


@app.command()
def schema(
    out: Annotated[Path, typer.Option("--out", help="folder for the schemas")] = Path("docs/schemas"),
    as_json: JsonOption = False,
) -> None:
    """Write the JSON Schemas of the description files, for editors."""

    def work() -> Outcome:
        from scancell.config.schema import json_schemas  # noqa: PLC0415
        from scancell.files import atomic_write  # noqa: PLC0415

        files = []
        for kind, content in json_schemas().items():
            path = out / f"{kind}.schema.json"
            with atomic_write(path) as temporary:
                temporary.write_text(json.dumps(content, indent=1) + "\n")
            files.append(str(path))
        return Outcome(files, files=files)

    run("schema", as_json, work)


@app.command()
def version(as_json: JsonOption = False) -> None:
    """Show the versions of scancell and its dependencies."""

    def work() -> Outcome:
        from scancell.output.manifest import versions  # noqa: PLC0415

        found = versions()
        return Outcome([f"{name} {number}" for name, number in found.items()], {"versions": found})

    run("version", as_json, work)


def _numbers(text: str, count: int, argument: str) -> tuple[float, ...]:
    from scancell.errors import DescriptionError  # noqa: PLC0415

    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(abs(value) < float("inf") for value in values):
        raise DescriptionError(key=argument, value=text, expected=f"{count} finite numbers with commas between them")
    return values


def main() -> None:
    """Entry point of the command line."""
    INTERRUPTS.install()
    try:
        code = app(standalone_mode=False)
    except _UsageError as error:
        error.show()
        if "--json" in sys.argv:
            context = error.ctx
            command = context.command_path.removeprefix(context.find_root().command_path).strip() if context else ""
            fault = {"kind": "UsageError", "message": error.format_message()}
            print(json.dumps({"command": command, "ok": False, "error": fault}))
        code = error.exit_code
    sys.exit(code)
