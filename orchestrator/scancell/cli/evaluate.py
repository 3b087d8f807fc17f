"""`scancell evaluate`, `mesh` and `acceptance`: compare clouds, reconstruct surfaces, test sensors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scancell.cli.common import Outcome, command, show_progress
from scancell.cli.options import (
    AsBuiltOption,
    CellOption,
    CloudUnitOption,
    EngineOption,
    OutOption,
    ScanOption,
    SeedOption,
    SetOption,
    ThreadsOption,
    UnitOption,
)
from scancell.config.description import Align, Reconstruction


@command("evaluate")
def evaluate(
    cloud: Annotated[Path, typer.Argument(help="point cloud (PLY, PCD, LAS, LAZ, E57, NPZ, text, CSV) or run folder")],
    mesh: Annotated[Path | None, typer.Option("--mesh", help="nominal part: mesh (STL, OBJ, PLY)")] = None,
    artefact: Annotated[Path | None, typer.Option("--artefact", help="nominal artefact (TOML)")] = None,
    align: Annotated[
        Align, typer.Option("--align", help="before the comparison: nothing, least squares, or to datum planes")
    ] = "none",
    datum: Annotated[
        str | None,
        typer.Option(
            "--datum", help="datum faces of the artefact, or numbers of plane regions of the mesh, with commas between"
        ),
    ] = None,
    out: OutOption = Path("out/evaluate"),
    unit: UnitOption = "mm",
    cloud_unit: CloudUnitOption = None,
    threads: ThreadsOption = 0,
) -> Outcome:
    """Compare a cloud with a mesh or an artefact: figures as JSON and CSV, a picture, and a report as HTML."""
    from scancell.api import evaluate as evaluate_cloud  # noqa: PLC0415

    words = [word.strip() for word in datum.split(",")] if datum else []
    found = evaluate_cloud(
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


@command("mesh")
def mesh(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="run folder, or cloud file of scancell (PLY)")],
    out: Annotated[Path, typer.Option("--out", help="mesh file (STL, PLY, OBJ), mm")] = Path("out/surface.ply"),
    method: Annotated[
        Reconstruction,
        typer.Option("--method", help="smooth surface, trimmed where points are sparse; or points joined by triangles"),
    ] = "poisson",
    spacing_mm: Annotated[
        float | None,
        typer.Option("--spacing-mm", min=0.001, help="smallest details; default: 1/250 of the extent"),
    ] = None,
) -> Outcome:
    """Reconstruct the surface of a scan, for `scancell scan` or other programs (extra `mesh`)."""
    from scancell.api import mesh as mesh_of_run  # noqa: PLC0415

    surface = mesh_of_run(run_folder, out, method=method, spacing_mm=spacing_mm)
    figures = {
        "vertices": len(surface.vertices),
        "faces": len(surface.faces),
        "area_mm2": 1e6 * float(surface.areas.sum()),
        "closed": surface.is_closed,
    }
    state = "closed" if surface.is_closed else "open"
    line = f"{run_folder}: {len(surface.faces)} faces, {figures['area_mm2']:.0f} mm², {state}"
    return Outcome([line, f"  results    {out}"], figures, [str(out)])


@command("acceptance")
def acceptance(
    sensor: Annotated[
        Path | None, typer.Argument(help="sensor description (TOML); the shipped default unless given")
    ] = None,
    cell: CellOption = None,
    scan: ScanOption = None,
    out: Annotated[Path, typer.Option("--out", help="folder for the report")] = Path("out/acceptance"),
    quick: Annotated[bool, typer.Option("--quick", help="fewer positions, repeats and points")] = False,
    repeats: Annotated[
        int | None, typer.Option("--repeats", min=1, help="scans of each artefact at each position; default 20")
    ] = None,
    factors: Annotated[
        Path | None, typer.Option("--factors", help="study (TOML) whose factors are drawn anew for each repeat")
    ] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option("--limit", metavar="NAME=VALUE", help="largest permitted error: 'probing size=5'; repeatable"),
    ] = None,
    engine: EngineOption = "geometric",
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    seed: SeedOption = 0,
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Test a sensor with artefacts over its measuring range, in both scan modes: JSON, CSV and one HTML page."""
    from scancell.api import acceptance as test  # noqa: PLC0415

    with show_progress(as_json) as progress:
        report = test(
            sensor,
            cell=cell,
            scan=scan,
            settings=set_ or [],
            as_built=as_built or [],
            engine=engine,
            seed=seed,
            quick=quick,
            repeats=repeats,
            factors=factors,
            limits=limit or [],
            out=out,
            threads=threads,
            progress=progress,
        )
    names = ("acceptance.json", "acceptance.csv", "acceptance.html", "manifest.json")
    figures = {
        "largest": report.largest,
        "limits": report.decisions,
        "linearity_percent": report.figures["linearity_percent"],
    }
    lines = [report.summary(), f"  report     {out / 'acceptance.html'}"]
    return Outcome(lines, figures, [str(out / name) for name in names], report.warnings)
