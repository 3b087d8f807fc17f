"""`scancell evaluate`: a cloud against a mesh or an artefact."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scancell.cli.common import JsonOption, Outcome, ThreadsOption, UnitOption, run
from scancell.config.choices import Align


def evaluate(
    cloud: Annotated[Path, typer.Argument(help="point cloud (PLY, NPZ, XYZ, PCD, LAZ, E57; mm) or run folder")],
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
    out: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("out/evaluate"),
    unit: UnitOption = "mm",
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Compare a cloud with a mesh or an artefact: figures as JSON and CSV, and a picture."""

    def work() -> Outcome:
        from scancell.api import evaluate as evaluate_cloud  # noqa: PLC0415

        words = [word.strip() for word in datum.split(",")] if datum else []
        found = evaluate_cloud(
            cloud, mesh=mesh, artefact=artefact, align=align, datum=words, out=out, unit=unit, threads=threads
        )
        files = [str(out / f"evaluation.{suffix}") for suffix in ("json", "csv", "png")]
        lines = [f"{cloud}: {len(found.distance)} points", found.summary()]
        return Outcome(lines, found.figures, files, list(found.warnings))

    run("evaluate", as_json, work)
