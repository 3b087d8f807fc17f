"""`scancell scan`, `rerun`, `shot`, `render`, `extract`, `survey`, `plan`, `place`: motions and measurements."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import scancell
from scancell.cli.common import (
    KEY_RANGE,
    CellOptions,
    CharacteristicsOption,
    CloudOptions,
    Options,
    Outcome,
    OutOption,
    PartArgument,
    PartOptions,
    PathOption,
    ScanOption,
    SeedOption,
    SetOption,
    SimulationOptions,
    ThreadsOption,
    command,
    show_progress,
    words_of_features,
)
from scancell.config.choices import ScanMode

if TYPE_CHECKING:
    from scancell.config.cell import CellDescription
    from scancell.planning.path_map.path_planner import PlacedPath
    from scancell.planning.setups import SetUp
    from scancell.planning.views.coverage import CoverageReport
    from scancell.results import ScanResult


_LAYOUTS = ("present", *(f"layout_{rank}" for rank in range(1, 1001)))  # names that an earlier run may have used


@command("scan", CloudOptions)
def scan(
    part: PartArgument,
    options: CloudOptions,
    scan: ScanOption = None,
    path: PathOption = None,
    plan: Annotated[Path | None, "plan.json of `scancell plan --out` or a run, instead of a new plan"] = None,
    mode: Annotated[ScanMode | None, "scan mode; overrides the scan description"] = None,
    characteristics: CharacteristicsOption = None,
    out: OutOption = Path("out/scan"),
) -> Outcome:
    """Scan a part with the simulated cell: cloud, deviation from the mesh, pictures."""
    words = [f'scan.mode="{mode}"'] if mode else []
    setup = options.setup(scan, path, [*words, *words_of_features(characteristics)])
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
    part: Annotated[Path, "part on the table: mesh (STL, OBJ, PLY), CAD file (STEP, IGES, BREP) or artefact (TOML)"],
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


@command("plan", PartOptions)
def plan(
    part: PartArgument,
    options: PartOptions,
    path: PathOption = None,
    scan: ScanOption = None,
    optimum: Annotated[bool, "compare motions along paths with the best possible ones; takes longer"] = False,
    picture: Annotated[Path | None, "PNG file for the configuration map of a path; further paths get a number"] = None,
    all_branches: Annotated[bool, "with --picture: also the maps of the other arm branches"] = False,
    characteristics: CharacteristicsOption = None,
    out: Annotated[Path | None, "JSON file for the plan, for `scancell scan --plan`"] = None,
) -> Outcome:
    """Plan a scan: collision-free motions of arm and table within all limits, and the surface that they see."""
    setup = options.setup(scan, path, words_of_features(characteristics))
    with scancell.Scanner(setup=setup, threads=options.threads) as scanner:
        made = scanner.plan(part, unit=options.unit)
    lines = [
        f"{part.name}: {len(made.axes)} exposures in {len(made.program.segments)} segments,"
        f" {made.program.duration:.1f} s of motion"
    ]
    figures: dict[str, object] = {"exposures": len(made.axes), "duration_s": made.program.duration}
    if made.coverage is not None:
        figures["seen"] = made.coverage
    if made.coverage is not None and made.report is None:
        lines.append(f"  sees       {100 * made.coverage:.1f} % of the surface, occlusion ignored")
    if made.report is not None:
        lines += _lines_of_report(made.report)
        figures["report"] = asdict(made.report)
    lines += [f"  {line}" for line in made.reduced]
    figures["reduced"] = list(made.reduced)
    files = []
    figures["paths"] = listed = []
    for number, placed in enumerate(made.paths, start=1):
        listed.append(_figures_of(placed, optimum))
        lines.append(_line_of(listed[-1]))
        if picture is not None:
            file = picture if len(made.paths) == 1 else _numbered(picture, number)
            files += _draw(placed, str(listed[-1]["branch"]), file, all_branches)
    if out is not None:
        files.append(str(made.save(out)))
    warnings = list(made.warnings)
    if picture is not None and not made.paths:
        warnings.append(f"{picture.name} is not written: a configuration map is of a sensor path, the plan has none")
    return Outcome(lines, figures, files, warnings)


def _numbered(file: Path, number: int) -> Path:
    return file.with_stem(f"{file.stem}_{number}")


def _lines_of_report(report: CoverageReport) -> list[str]:
    return [
        f"  sees       {100 * report.share:.2f} % of the measurable surface in {report.views} views, chosen from"
        f" {report.candidates}",
        f"  time       {report.time:.1f} s by estimate; no choice of the candidates needs less than"
        f" {report.least_time:.1f} s",
        *(f"  unseen     {100 * share:.2f} %: {reason}" for reason, share in report.unseen.items()),
    ]


def _figures_of(placed: PlacedPath, optimum: bool) -> dict[str, str | float]:
    map_ = placed.lattice.map
    figures: dict[str, str | float] = {
        "name": placed.view.name,
        "branch": placed.branch_name,
        "exposures": len(placed.exposures),
        "length_m": placed.view.length,
        "duration_s": placed.run.duration,
        "cost": placed.motion.cost,
        "evaluated": map_.evaluated / map_.quality.size,
    }
    if optimum:
        from scancell.planning.path_map.ray_shooting import best_motion  # noqa: PLC0415

        best = best_motion(placed.lattice)
        assert best is not None  # the motion that was found is on the lattice
        figures["optimum"] = best.cost
    return figures


def _line_of(figures: dict[str, str | float]) -> str:
    line = (
        f"  {figures['name']:<10} {1e3 * float(figures['length_m']):.0f} mm in {figures['duration_s']:.1f} s, branch"
        f" {figures['branch']}, cost {figures['cost']:.3f}, {100 * float(figures['evaluated']):.1f} % of the map"
        " evaluated"
    )
    if "optimum" in figures:
        gap = float(figures["cost"]) / float(figures["optimum"]) - 1
        line += f", {100 * gap:.1f} % above the optimum"
    return line


def _draw(placed: PlacedPath, branch: str, file: Path, all_branches: bool) -> list[str]:
    """Draw the map of the branch that was chosen, and on request those of the others."""
    from scancell.files import name_for_file  # noqa: PLC0415
    from scancell.output.pictures import map_picture  # noqa: PLC0415

    chosen = placed.lattice.map
    chosen.require_all()
    map_picture(chosen, placed.view.name, branch, placed.run.duration, placed.motion).write(file)
    files = [str(file)]
    for number, name in enumerate(placed.branch_names if all_branches else ()):
        if number != chosen.branch:
            other = chosen.of_branch(number)
            other.require_all()
            files.append(str(file.with_stem(f"{file.stem}_{name_for_file(name)}")))
            map_picture(other, placed.view.name, name, placed.run.duration, None).write(files[-1])
    return files


@command("place", PartOptions)
def place(
    part: PartArgument,
    options: PartOptions,
    scan: ScanOption = None,
    share: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="share of the measurable surface to be scanned")
    ] = 0.99,
    out: Annotated[Path | None, "TOML file for the cell with the part set up; a second one gets _2"] = None,
) -> Outcome:
    """Propose the resting pose, position on the table and height of a free part for the best scan; or two set-ups."""
    setup = options.setup(scan)
    with show_progress(options.as_json) as progress, scancell.Scanner(setup=setup, threads=options.threads) as scanner:
        found = scanner.place(part, share, unit=options.unit, progress=progress)
    lines = [f"{part.name}: {found.summary()}"]
    files = []
    for number, one in enumerate(found.chosen, start=1):
        title = f"set-up {number}: " if len(found.chosen) > 1 else ""
        lines.append(
            f"# {title}{100 * one.scanned:.1f} % of the whole surface in about {one.time:.0f} s;"
            f" tips over at {math.degrees(one.tip_angle):.0f} deg"
        )
        if one.riser is not None:
            low, high = one.riser.bounds
            size = " x ".join(f"{1e3 * length:.0f}" for length in high - low)
            lines.append(f"# on a riser of {size} mm")
        lines += one.toml.splitlines()
        if out is not None:
            files += _write(one, setup.cell, out if number == 1 else _numbered(out, number))
    return Outcome(lines, found.figures, files)


@command("layout", PartOptions)
def layout(
    parts: Annotated[list[Path], "meshes (STL, OBJ, PLY) or artefacts (TOML) that the cell is to scan"],
    options: PartOptions,
    scan: ScanOption = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar=KEY_RANGE,
            help="bounds of a key of the cell: table.pose.x_mm=300:700; repeatable; default: table, rotation of the"
            " arm's base, sensor on the flange",
        ),
    ] = None,
    samples: Annotated[
        int,
        typer.Option(
            min=1, max=100_000, help="layouts that are screened: planned from views that are searched once for all"
        ),
    ] = 128,
    plans: Annotated[
        int, typer.Option(min=1, max=1000, help="layouts that are planned in full, the best of these")
    ] = 4,
    seed: SeedOption = 0,
    out: OutOption = Path("out/layout"),
) -> Outcome:
    """Propose where table, arm and sensor should stand for the shortest scan, beside the present layout of the cell."""
    from scancell.output.run_folder import RunFolder, command_words, manifest, write_json  # noqa: PLC0415
    from scancell.views.pictures import cell_picture  # noqa: PLC0415

    setup = options.setup(scan)
    with (
        show_progress(options.as_json) as progress,
        scancell.Scanner(setup=setup, threads=options.threads) as scanner,
        RunFolder(out, [f"{name}.{suffix}" for name in _LAYOUTS for suffix in ("toml", "png")]) as folder,
    ):
        found = scanner.layout(
            parts, vary or (), samples=samples, plans=plans, seed=seed, unit=options.unit, progress=progress
        )
        mesh = scanner.load_part(parts[0], options.unit)
        for rank, one in enumerate(found.ranked, 1):
            if one is not found.present:
                one.cell.to_toml(folder.path(f"{one.name}.toml"))
            nominal = scancell.nominal_cell(one.cell, mesh)
            axes = one.scans[0].middle if one.scans else nominal.home
            facts = [f"rank {rank}", *one.facts]
            cell_picture(nominal, axes, one.name, facts).write(folder.path(f"{one.name}.png"))
        write_json(folder.path("layouts.json"), found.figures)
        run = {"command_line": command_words(None), "seed": seed, "unit": options.unit}
        write_json(folder.path("manifest.json"), manifest(setup, parts, run))
    names = ", ".join(part.name for part in parts)
    files = [str(path) for path in folder.paths]
    return Outcome([f"{names}: {found.summary()}", f"  results    {out}"], found.figures, files)


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
