"""The `scancell` command."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from orchestrator.cli.batch import batch
from orchestrator.cli.common import (
    AsBuiltOption,
    CellOption,
    EngineOption,
    FormatOption,
    IdealOption,
    JsonOption,
    Outcome,
    ScanOption,
    SeedOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
    run,
    show_progress,
)
from orchestrator.cli.fmu import fmu_app
from orchestrator.cli.study import study_app
from orchestrator.config.scan import Mode

# Typer brings a copy of click along; its error for a wrong command line is the base of one that typer exports.
_UsageError = cast(type[Any], typer.BadParameter.__base__)

app = typer.Typer(
    help="A robot cell that scans parts in 3D with a laser profile sensor, simulated end to end.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(batch)
app.add_typer(fmu_app, name="fmu")
app.add_typer(study_app, name="study")


@app.command()
def scan(
    part: Annotated[Path, typer.Argument(help="mesh of the part (STL, OBJ, PLY)")],
    cell: CellOption = None,
    sensor: SensorOption = None,
    scan: ScanOption = None,
    engine: EngineOption = "ray-traced",
    mode: Annotated[
        Mode | None, typer.Option("--mode", help="how the sensor is moved; overrides the scan description")
    ] = None,
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    ideal: IdealOption = False,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/scan"),
    images: Annotated[bool, typer.Option("--images", help="keep the camera images of every exposure")] = False,
    format_: FormatOption = "ply",
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Scan a part with the simulated cell: cloud, deviation from the mesh, pictures."""

    def work() -> Outcome:
        from orchestrator.config.loading import load_setup  # noqa: PLC0415
        from orchestrator.evaluation.job import scan_to_folder  # noqa: PLC0415
        from orchestrator.evaluation.request import ScanRequest  # noqa: PLC0415
        from orchestrator.reconstruction.cloud_files import parse_formats  # noqa: PLC0415

        overrides = [*(set_ or []), *([f'scan.mode="{mode}"'] if mode else [])]
        request = ScanRequest(
            part=part,
            unit=unit,
            setup=load_setup(cell, sensor, scan, overrides, ideal),
            engine=engine,
            as_built=tuple(as_built or ()),
            seed=seed,
            images=images,
            threads=threads,
            command_line=tuple(sys.argv[1:]),
            formats=parse_formats(format_, "--format"),
        )
        with show_progress(as_json) as progress:
            report = scan_to_folder(request, out, progress)
        return Outcome(report.summary(), report.figures, report.files, report.warnings, report.timings)

    run("scan", as_json, work)


@app.command()
def shot(
    part: Annotated[Path, typer.Argument(help="mesh of the part (STL, OBJ, PLY)")],
    pose: Annotated[
        str, typer.Option("--pose", help="part_from_sensor: x,y,z in mm and XYZ' angles rx,ry,rz in degrees")
    ],
    cell: CellOption = None,
    sensor: SensorOption = None,
    engine: EngineOption = "ray-traced",
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    ideal: IdealOption = False,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/shot"),
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Expose once from a given pose: the camera images and one profile."""

    def work() -> Outcome:
        from orchestrator.config.loading import load_setup  # noqa: PLC0415
        from orchestrator.evaluation.shot import ShotRequest, shoot_to_folder  # noqa: PLC0415

        setup = load_setup(cell, sensor, None, set_ or [], ideal)
        request = ShotRequest(
            part, unit, setup, _numbers(pose, 6, "--pose"), engine, seed, threads, tuple(sys.argv[1:]), as_built or ()
        )
        report = shoot_to_folder(request, out)
        return Outcome(report.summary(), report.figures, report.files, report.warnings, report.timings)

    run("shot", as_json, work)


@app.command()
def render(
    recording: Annotated[Path, typer.Argument(help="table of trigger records (Parquet or CSV), columns as in the FMU")],
    part: Annotated[Path, typer.Argument(help="mesh of the part (STL, OBJ, PLY)")],
    cell: CellOption = None,
    sensor: SensorOption = None,
    engine: EngineOption = "ray-traced",
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    ideal: IdealOption = False,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/render"),
    images: Annotated[bool, typer.Option("--images", help="keep the camera images of every exposure")] = False,
    format_: FormatOption = "ply",
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Make images and a cloud from poses that any FMI tool recorded."""

    def work() -> Outcome:
        from orchestrator.config.loading import load_setup, require_sensor_words  # noqa: PLC0415
        from orchestrator.evaluation.job import render_to_folder  # noqa: PLC0415
        from orchestrator.evaluation.request import ScanRequest  # noqa: PLC0415
        from orchestrator.reconstruction.cloud_files import parse_formats  # noqa: PLC0415

        require_sensor_words(as_built or (), "the recording tells what the cell did")
        request = ScanRequest(
            part=part,
            unit=unit,
            setup=load_setup(cell, sensor, None, set_ or [], ideal),
            engine=engine,
            as_built=tuple(as_built or ()),
            seed=seed,
            images=images,
            threads=threads,
            command_line=tuple(sys.argv[1:]),
            formats=parse_formats(format_, "--format"),
        )
        with show_progress(as_json) as progress:
            report = render_to_folder(request, recording, out, progress)
        return Outcome(report.summary(), report.figures, report.files, report.warnings, report.timings)

    run("render", as_json, work)


@app.command()
def extract(
    images: Annotated[
        list[Path], typer.Argument(help="images (PNG, TIFF, BMP) with the camera's name in the file name, or folders")
    ],
    sensor: Annotated[Path, typer.Option("--sensor", help="sensor description (TOML) with the calibrated cameras")],
    set_: SetOption = None,
    laser_off: Annotated[
        list[Path] | None,
        typer.Option("--laser-off", help="images, or folders, of the same names with the laser off, to be taken away"),
    ] = None,
    peaks: Annotated[bool, typer.Option("--peaks", help="write every peak that was found, chosen or not")] = False,
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/extract"),
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Measure the stripe in images of a sensor, real or simulated: profiles as CSV and PLY."""

    def work() -> Outcome:
        from orchestrator.config.loading import load_setup  # noqa: PLC0415
        from orchestrator.evaluation.extract_images import ExtractionRequest, extract_to_folder  # noqa: PLC0415

        setup = load_setup(None, sensor, None, set_ or [])
        report = extract_to_folder(ExtractionRequest(images, setup.sensor, peaks, threads, laser_off or ()), out)
        return Outcome(report.summary(), report.figures, report.files, report.warnings, report.timings)

    run("extract", as_json, work)


@app.command()
def schema(
    out: Annotated[Path, typer.Option("--out", help="folder for the schemas")] = Path("docs/schemas"),
    as_json: JsonOption = False,
) -> None:
    """Write the JSON Schemas of the description files, for editors."""

    def work() -> Outcome:
        from orchestrator.config.schema import json_schemas  # noqa: PLC0415
        from orchestrator.files import atomic_write  # noqa: PLC0415

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
    """Tell the versions of scancell and of what it stands on."""

    def work() -> Outcome:
        from orchestrator.evaluation.manifest import versions  # noqa: PLC0415

        found = versions()
        return Outcome([f"{name} {number}" for name, number in found.items()], {"versions": found})

    run("version", as_json, work)


def _numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    from orchestrator.errors import DescriptionError  # noqa: PLC0415

    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(abs(value) < float("inf") for value in values):
        raise DescriptionError(f"{option} {text}: expected {count} finite numbers with commas between them")
    return values


def main() -> None:
    """Entry point; a second Ctrl-C during clean-up still ends the process."""
    signal.signal(signal.SIGTERM, lambda *_: os.kill(os.getpid(), signal.SIGINT))
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
