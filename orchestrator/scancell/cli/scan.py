"""`scancell scan`, `rerun`, `shot`, `render`, `extract` and `survey`: measure with the simulated sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import scancell
from scancell.cli.common import (
    CellOptions,
    CloudOptions,
    Options,
    Outcome,
    OutOption,
    PartArgument,
    PathOption,
    ScanOption,
    SetOption,
    SimulationOptions,
    ThreadsOption,
    command,
    show_progress,
)
from scancell.config.choices import ScanMode

if TYPE_CHECKING:
    from scancell.results import ScanResult


@command("scan", CloudOptions)
def scan(
    part: PartArgument,
    options: CloudOptions,
    scan: ScanOption = None,
    path: PathOption = None,
    plan: Annotated[Path | None, "plan.json of `scancell plan --out` or a run, instead of a new plan"] = None,
    mode: Annotated[ScanMode | None, "scan mode; overrides the scan description"] = None,
    out: OutOption = Path("out/scan"),
) -> Outcome:
    """Scan a part with the simulated cell: cloud, deviation from the mesh, pictures."""
    setup = options.setup(scan, path, [f'scan.mode="{mode}"'] if mode else [])
    with show_progress(options.as_json) as progress, scancell.Scanner(setup=setup, threads=options.threads) as scanner:
        return options.run_into(out, setup, progress, lambda given: scanner.scan(part, plan=plan, **given))


@command("rerun")
def rerun(
    run_folder: Annotated[Path, "run folder, or its resolved.toml"],
    out: OutOption = Path("out/rerun"),
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Repeat a scan from the descriptions that its run folder holds."""
    from scancell.config.description import validate  # noqa: PLC0415
    from scancell.config.loading import load_resolved  # noqa: PLC0415
    from scancell.errors import DescriptionError  # noqa: PLC0415

    resolved = run_folder / "resolved.toml" if run_folder.is_dir() else run_folder
    setup, made = load_resolved(resolved)
    if "measured" in made:
        raise DescriptionError("is of real measurements", file=resolved, expected="a simulated run; see `reconstruct`")
    if "program" in made:
        raise DescriptionError(
            file=resolved, key="run.program", value=made["program"], expected="the run of a scan; see `scancell run`"
        )
    written = {"formats": ",".join(made.get("formats", ["ply"])), "frame": made.get("frame", "part")}
    repeated_options = {key: made[key] for key in ("engine", "as_built", "seed", "unit")}
    options = CloudOptions(**repeated_options, **written, as_json=as_json)
    calibrated = None
    if "estimated_sensor" in made:
        calibrated = validate(scancell.SensorDescription, made["estimated_sensor"], f"{resolved}: run.estimated_sensor")
    with show_progress(as_json) as progress, scancell.Scanner(setup=setup, threads=threads) as scanner:

        def repeated(given: dict[str, Any]) -> ScanResult:
            given["estimated_sensor"] = calibrated
            if "recording" in made:
                return scanner.render(Path(made["recording"]), Path(made["part"]), **given)
            return scanner.scan(Path(made["part"]), plan=made.get("plan"), **given)

        return options.run_into(out, setup, progress, repeated)


@command("shot", CellOptions)
def shot(
    part: PartArgument,
    options: CellOptions,
    pose: Annotated[str, typer.Option(help="part_from_sensor: x,y,z in mm and XYZ' angles rx,ry,rz in degrees")],
    out: OutOption = Path("out/shot"),
) -> Outcome:
    """Expose once from a given pose: the camera images and one profile."""
    from scancell.geometry.pose import from_euler_xyz  # noqa: PLC0415

    numbers = _numbers(pose, 6, "pose")
    placed = from_euler_xyz([1e-3 * value for value in numbers[:3]], [math.radians(angle) for angle in numbers[3:]])
    result = scancell.shot(part, placed, **options.given)
    files = [str(path) for path in result.save(out)]
    lines = [result.summary(), f"  results    {out}"]
    return Outcome(lines, result.figures, files, list(result.warnings))


def _numbers(text: str, count: int, argument: str) -> tuple[float, ...]:
    from scancell.errors import DescriptionError  # noqa: PLC0415

    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise DescriptionError(key=argument, value=text, expected=f"{count} finite numbers with commas between them")
    return values


@command("render", CloudOptions)
def render(
    recording: Annotated[Path, "table of trigger records (Parquet or CSV), columns as in the FMU"],
    part: PartArgument,
    options: CloudOptions,
    out: OutOption = Path("out/render"),
) -> Outcome:
    """Make images and a cloud from poses that any FMI tool recorded."""
    setup = options.setup()
    with show_progress(options.as_json) as progress, scancell.Scanner(setup=setup, threads=options.threads) as scanner:
        return options.run_into(out, setup, progress, lambda given: scanner.render(recording, part, **given))


@dataclass(frozen=True, kw_only=True)
class ExtractOptions(Options):
    """Options of `scancell.extract`."""

    sensor: Annotated[Path, typer.Option(help="sensor description (TOML) with the calibrated cameras")]
    settings: SetOption = None
    laser_off: Annotated[
        list[Path] | None, "images, or folders, of the same names with the laser off (background), to subtract"
    ] = None
    sheet_um: Annotated[
        float | None, typer.Option(min=0, help="flag points farther than this off the sheet by two cameras")
    ] = None
    peaks: Annotated[bool, "write all detected peaks, also rejected ones"] = False
    threads: ThreadsOption = 0


@command("extract", ExtractOptions)
def extract(
    images: Annotated[list[Path], "images (PNG, TIFF, BMP) with the camera's name in the file name, or folders"],
    options: ExtractOptions,
    out: OutOption = Path("out/extract"),
) -> Outcome:
    """Measure the stripe in images of a sensor, real or simulated: profiles as CSV and PLY."""
    return Outcome.of(scancell.extract(images, out, **options.given))


@command("survey", SimulationOptions)
def survey(
    part: Annotated[Path, "part on the table: mesh (STL, OBJ, PLY) or artefact (TOML)"],
    options: SimulationOptions,
    out: Annotated[Path, "file for the voxels (NPZ)"] = Path("out/survey.npz"),
    radius_mm: Annotated[
        float | None, typer.Option(min=1, help="radius of the surveyed cylinder; default: that of the table + 50 mm")
    ] = None,
    height_mm: Annotated[
        float, typer.Option(min=1, help="its height above the table; space above it is assumed free")
    ] = 200.0,
    voxel_mm: Annotated[float, typer.Option(min=1, help="edge of the voxels")] = 10.0,
    pitch_mm: Annotated[
        float, typer.Option(min=0.1, help="distance between exposures; thinner objects may be missed")
    ] = 5.0,
    inflate_mm: Annotated[
        float, typer.Option(min=0, help="space within this distance of measured voxels is occupied")
    ] = 2.0,
    scan: ScanOption = None,
) -> Outcome:
    """Scan the space around the table: occupied or unseen voxels, for `occupied` of a scan description."""
    with show_progress(options.as_json) as progress:
        result = scancell.survey(
            part,
            scan=scan,
            radius=None if radius_mm is None else radius_mm / 1e3,
            height=height_mm / 1e3,
            voxel=voxel_mm / 1e3,
            pitch=pitch_mm / 1e3,
            inflation=inflate_mm / 1e3,
            progress=progress,
            **options.given,
        )
    file = result.save(out)
    return Outcome([f"{part.name}: {result.summary()}"], result.figures, [str(file)])
