"""`scancell evaluate`, `mesh` and `acceptance`: compare clouds, reconstruct surfaces, test sensors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import scancell
from scancell.cli.common import (
    AsBuiltOption,
    CellOption,
    CloudUnitOption,
    EngineOption,
    Options,
    Outcome,
    OutOption,
    ScanOption,
    SeedOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
    command,
    show_progress,
    words_of_features,
)
from scancell.config.choices import Align, Reconstruction

if TYPE_CHECKING:
    from scancell.views.recorded_run import RecordedRun


_LARGE_MB = 20.0
# The words of scancell.views, which is slow to import.
_View = Literal["cell", "part", "orbit", "sensor"]
_Colour = Literal["deviation", "intensity"]

_CharacteristicsOption = Annotated[
    Path | None, "toleranced characteristics (TOML, docs/inspection.md); default: those of the CAD file"
]
_Run = Annotated[Path, "run folder of a scan or robot program"]
_ViewOption = Annotated[_View, "whole cell, part, once around the cell, or following the sensor"]
_SizeOption = Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="size in pixels")]
_ColourOption = Annotated[_Colour, "quantity that the colours of the cloud show"]


@command("evaluate")
def evaluate(
    cloud: Annotated[Path, "point cloud (PLY, PCD, LAS, LAZ, E57, NPZ, text, CSV) or run folder"],
    mesh: Annotated[Path | None, "nominal part: mesh (STL, OBJ, PLY) or CAD file (STEP, IGES, BREP)"] = None,
    artefact: Annotated[Path | None, "nominal artefact (TOML)"] = None,
    align: Annotated[Align, "before the comparison: nothing, least squares, or to datum planes"] = "none",
    datum: Annotated[
        str | None, "datum faces of the artefact, or numbers of plane regions of the mesh, with commas between"
    ] = None,
    out: OutOption = Path("out/evaluate"),
    unit: UnitOption = "mm",
    cloud_unit: CloudUnitOption = None,
    threads: ThreadsOption = 0,
) -> Outcome:
    """Compare a cloud with a mesh or an artefact: figures as JSON and CSV, a picture, and a report as HTML."""
    words = [word.strip() for word in datum.split(",")] if datum else []
    found = scancell.evaluate(
        cloud,
        mesh=mesh,
        artefact=artefact,
        align=align,
        datum=words,
        out=out,
        unit=unit,
        cloud_unit=cloud_unit,
        threads=threads,
    )
    files = [str(out / f"evaluation.{suffix}") for suffix in ("json", "csv", "png", "html")]
    kind = found.source["format"]
    lines = [f"{cloud} ({kind}): {len(found.distance)} points", found.summary()]
    return Outcome(lines, found.figures, files, list(found.warnings))


@command("characteristics")
def characteristics(
    part: Annotated[Path, "CAD file (STEP, IGES, BREP)"],
    out: Annotated[
        Path | None, typer.Option(help="file for the characteristics that the CAD file states (TOML)")
    ] = None,
) -> Outcome:
    """List the faces of a CAD part, and the tolerances that its file states, as a description for `inspect`."""
    from scancell.config.files import toml_text  # noqa: PLC0415
    from scancell.files import atomic_write  # noqa: PLC0415
    from scancell.inspection.annotations import annotated, face_rows  # noqa: PLC0415
    from scancell.nominal.parts import cad_part  # noqa: PLC0415

    nominal = cad_part(part)
    described, left = annotated(nominal)
    rows = face_rows(nominal)
    lines = [f"{part}: {len(rows)} faces, {len(nominal.annotations)} annotations", *map(_face_text, rows)]
    plain = {} if described is None else described.model_dump(mode="json", exclude_defaults=True)
    if described is not None and out is None:
        lines += ["", toml_text(plain).rstrip()]
    if described is not None and out is not None:
        with atomic_write(out) as temporary:
            temporary.write_text(toml_text(plain), encoding="utf-8")
        lines.append(f"  characteristics  {out}")
    figures = {"faces": rows, "characteristics": plain}
    files = [] if out is None or described is None else [str(out)]
    notes = [f"not inspected: {text}" for text in left]
    if described is None and not left:
        notes.append(f"{part}: states no tolerances; docs/inspection.md shows how to describe them")
    return Outcome(lines, figures, files, [*nominal.warnings, *notes])


def _face_text(row: dict[str, Any]) -> str:
    at = ", ".join(f"{value:.2f}" for value in row["centre_mm"])
    size = f" radius {row['radius_mm']:g} mm" if row["radius_mm"] else ""
    return f"  {row['number']:4d}  {row['kind']:10} {row['label']:16} centre ({at}) mm{size}"


@command("inspect")
def inspect(
    cloud: Annotated[Path, "point cloud or run folder, as for evaluate"],
    part: Annotated[Path, "nominal part: CAD file (STEP, IGES, BREP)"],
    characteristics: _CharacteristicsOption = None,
    capability: Annotated[
        Path | None, "capability.json of this cell and part: uncertainty by errors of the cell"
    ] = None,
    calibration: Annotated[
        Path | None, "results of `scancell calibrate` with a covariance: uncertainty by them; needs a run folder"
    ] = None,
    align: Annotated[Literal["best-fit", "none"], "how points find their faces"] = "best-fit",
    out: OutOption = Path("out/inspect"),
    cloud_unit: CloudUnitOption = None,
    threads: ThreadsOption = 0,
) -> Outcome:
    """Decide for each toleranced characteristic of a CAD part whether it conforms, with its uncertainty (ISO 14253-1).

    Writes inspection.json, inspection.csv, inspection.qif (QIF 3.0), and a report as one HTML page.
    """
    found = scancell.inspect(
        cloud,
        part,
        characteristics,
        align=align,
        capability=capability,
        calibration=calibration,
        out=out,
        cloud_unit=cloud_unit,
        threads=threads,
    )
    files = [str(out / f"inspection.{suffix}") for suffix in ("json", "csv", "qif", "html")]
    return Outcome([found.summary(), f"  report     {files[-1]}"], found.figures, files, list(found.warnings))


@dataclass(frozen=True)
class CapabilityOptions(Options):
    """Options of `scancell.capability`."""

    characteristics: _CharacteristicsOption = None
    factors: Annotated[Path | None, "study (TOML) whose factors are drawn for each measurement"] = None
    draws: Annotated[int, typer.Option(min=1, max=10_000, help="simulated calibrations: draws of all factors")] = 20
    clampings: Annotated[int, typer.Option(min=1, max=1000, help="of each: draws of the place of the part")] = 1
    repeats: Annotated[
        int, typer.Option(min=1, max=1000, help="of each: measurements; 2 or more make the table of the gauge (GRR)")
    ] = 1
    cell: CellOption = None
    sensor: SensorOption = None
    scan: ScanOption = None
    engine: EngineOption = "geometric"
    settings: SetOption = None
    as_built: AsBuiltOption = None
    seed: SeedOption = 0
    threads: ThreadsOption = 0


@command("capability", CapabilityOptions)
def capability(
    part: Annotated[Path, "CAD file (STEP, IGES, BREP)"],
    options: CapabilityOptions,
    out: OutOption = Path("out/capability"),
) -> Outcome:
    """Find which characteristics of a CAD part a cell can decide, by simulated measurements before any real one."""
    given = options.given
    given["settings"] = [*words_of_features(options.characteristics), *given.get("settings", ())]
    with show_progress(options.as_json) as progress:
        found = scancell.capability(part, **given, out=out, progress=progress)
    files = [str(out / f"capability.{suffix}") for suffix in ("json", "csv")]
    return Outcome([found.summary(), f"  results    {out}"], found.figures, files)


@command("mesh")
def mesh(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="run folder, or cloud file of scancell (PLY)")],
    out: Annotated[Path, "mesh file (STL, PLY, OBJ), mm"] = Path("out/surface.ply"),
    method: Annotated[
        Reconstruction, "smooth surface, trimmed where points are sparse; or points joined by triangles"
    ] = "poisson",
    spacing_mm: Annotated[
        float | None, typer.Option(min=0.001, help="smallest details; default: 1/250 of the extent")
    ] = None,
) -> Outcome:
    """Reconstruct the surface of a scan, for `scancell scan` or other programs (extra `mesh`)."""
    surface = scancell.mesh(run_folder, out, method=method, spacing_mm=spacing_mm)
    figures = {
        "vertices": len(surface.vertices),
        "faces": len(surface.faces),
        "area_mm2": 1e6 * float(surface.areas.sum()),
        "closed": surface.is_closed,
    }
    state = "closed" if surface.is_closed else "open"
    line = f"{run_folder}: {len(surface.faces)} faces, {figures['area_mm2']:.0f} mm², {state}"
    return Outcome([line, f"  results    {out}"], figures, [str(out)])


@dataclass(frozen=True)
class AcceptanceOptions(Options):
    """Options of `scancell.acceptance`."""

    sensor: Annotated[
        Path | None, typer.Argument(help="sensor description (TOML); the shipped default unless given")
    ] = None
    cell: CellOption = None
    scan: ScanOption = None
    quick: Annotated[bool, "fewer positions, repeats and points"] = False
    repeats: Annotated[int | None, typer.Option(min=1, help="scans of each artefact at each position; default 20")] = (
        None
    )
    factors: Annotated[Path | None, "study (TOML) whose factors are drawn anew for each repeat"] = None
    limits: Annotated[
        list[str] | None,
        typer.Option("--limit", metavar="NAME=VALUE", help="largest permitted error: 'probing size=5'; repeatable"),
    ] = None
    engine: EngineOption = "geometric"
    settings: SetOption = None
    as_built: AsBuiltOption = None
    seed: SeedOption = 0
    threads: ThreadsOption = 0


@command("acceptance", AcceptanceOptions)
def acceptance(
    options: AcceptanceOptions, out: Annotated[Path, "folder for the report"] = Path("out/acceptance")
) -> Outcome:
    """Test a sensor with artefacts over its measuring range, in both scan modes: JSON, CSV and one HTML page."""
    with show_progress(options.as_json) as progress:
        report = scancell.acceptance(**options.given, out=out, progress=progress)
    names = ("acceptance.json", "acceptance.csv", "acceptance.html", "manifest.json")
    figures = {
        "largest": report.largest,
        "limits": report.decisions,
        "linearity_percent": report.figures["linearity_percent"],
    }
    lines = [report.summary(), f"  report     {out / 'acceptance.html'}"]
    return Outcome(lines, figures, [str(out / name) for name in names], report.warnings)


@command("picture")
def picture(
    run_folder: _Run,
    out: Annotated[Path, "file for the picture (PNG)"] = Path("out/picture.png"),
    time: Annotated[float | None, "time in the run, s; default: that of the last exposure, else the end"] = None,
    view: _ViewOption = "cell",
    size: _SizeOption = "1280x720",
    colour: _ColourOption = "deviation",
    threads: ThreadsOption = 0,
) -> Outcome:
    """Render the cell of a run at one time: arm, sensor, table, part, laser, and the cloud measured until then."""
    from scancell.views import pictures  # noqa: PLC0415

    options: dict[str, Any] = {"view": view, "size": _size(size), "colour": colour, "threads": threads}
    opened, warnings = _opened(run_folder)
    at = pictures.picture(opened, out, time=time, **options)
    return Outcome([f"{out}: {opened.name} at {at:.2f} s"], {"time_s": at}, [str(out)], warnings)


@command("animate")
def animate(
    run_folder: _Run,
    out: Annotated[Path, "file of the animation, .webm or .webp"] = Path("out/scan.webm"),
    view: _ViewOption = "cell",
    size: _SizeOption = "1280x720",
    fps: Annotated[float, typer.Option(min=1, max=120, help="pictures per second")] = 25.0,
    seconds: Annotated[float | None, typer.Option(min=0.01, help="length of the animation, s; default: 10")] = None,
    speed: Annotated[
        float | None, typer.Option(min=1e-3, help="seconds of the run in one second; instead of --seconds")
    ] = None,
    colour: _ColourOption = "deviation",
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Render a whole run as a video (WebM, VP9) or animated WebP: the cloud grows as it is measured."""
    from scancell.views import pictures  # noqa: PLC0415

    options: dict[str, Any] = {"view": view, "size": _size(size), "colour": colour, "threads": threads}
    opened, warnings = _opened(run_folder)
    with show_progress(as_json) as progress:
        frames = pictures.animate(opened, out, fps=fps, seconds=seconds, speed=speed, progress=progress, **options)
    length = frames / fps
    figures = {"frames": frames, "seconds": length}
    return Outcome([f"{out}: {frames} frames, {length:.1f} s"], figures, [str(out)], warnings)


@command("page")
def page(
    run_folder: _Run,
    out: Annotated[Path, "file for the page (HTML)"] = Path("out/run.html"),
    points: Annotated[
        int, typer.Option(min=1, max=900_000, help="points of the cloud at most, evenly chosen")
    ] = 500_000,
    colour: _ColourOption = "deviation",
    threads: ThreadsOption = 0,
) -> Outcome:
    """Write a run as one HTML file with a time slider, which opens in a browser without a network."""
    from scancell.views.pictures import write_page  # noqa: PLC0415

    opened, warnings = _opened(run_folder, points)
    megabytes = write_page(opened, out, colour=colour, threads=threads) / 1e6
    if megabytes > _LARGE_MB:
        warnings.append(f"{out}: {megabytes:.1f} MB are large for an e-mail; --points {points // 2} makes it smaller")
    shown = 0 if opened.cloud is None else len(opened.cloud)
    figures = {"megabytes": megabytes, "points": shown}
    text = f"{out}: {megabytes:.1f} MB, {shown:,} of {opened.cloud_points:,} points"
    return Outcome([text], figures, [str(out)], warnings)


@command("export")
def export(
    run_folder: _Run,
    out: Annotated[Path, "file for the recording (MCAP)"] = Path("out/scan.mcap"),
    points: Annotated[int, typer.Option(min=1, help="points of the cloud at most, evenly chosen")] = 1_000_000,
    ros: Annotated[bool, "a ROS 2 bag with joints and profiles, which `reconstruct` reads again"] = False,
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Write a run as an MCAP file, which Foxglove and rerun open: poses and meshes of all bodies, and the points.

    Point clouds for other programs are written by `scan`, `rerun` and `batch` with --format: PLY, NPZ, LAZ, E57,
    PCD, XYZ.
    """
    from scancell.recorded.runs import export_bag  # noqa: PLC0415
    from scancell.views.mcap_export import export_run  # noqa: PLC0415

    if ros:
        messages, count = export_bag(run_folder, out)
        return Outcome(
            [f"{out}: {messages} messages, {count:,} points"], {"messages": messages, "points": count}, [str(out)]
        )
    opened, warnings = _opened(run_folder, points)
    with show_progress(as_json) as progress:
        messages = export_run(opened, out, threads, progress)
    shown = 0 if opened.cloud is None else len(opened.cloud)
    figures = {"messages": messages, "points": shown}
    text = f"{out}: {messages} messages, {shown:,} of {opened.cloud_points:,} points"
    return Outcome([text], figures, [str(out)], warnings)


def _opened(folder: Path, *most_points: int) -> tuple[RecordedRun, list[str]]:
    """The run, and a warning where it has no cloud to show."""
    from scancell.views.recorded_run import open_run  # noqa: PLC0415

    opened = open_run(folder, *most_points)
    missing = opened.cloud is None
    return opened, [f"{folder / 'cloud.ply'}: no such file: no cloud is shown"] if missing else []


def _size(text: str) -> tuple[int, int]:
    from scancell.errors import DescriptionError  # noqa: PLC0415

    words = text.lower().split("x")
    if len(words) != 2 or not all(word.isascii() and word.isdigit() for word in words):
        raise DescriptionError(key="size", value=text, expected="WIDTHxHEIGHT in pixels, such as 1280x720")
    width, height = map(int, words)
    if not (64 <= width <= 7680 and 64 <= height <= 7680):
        raise DescriptionError(key="size", value=text, expected="64 to 7680 pixels each way")
    return width, height
