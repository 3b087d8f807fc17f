"""`scancell acceptance`: acceptance test of a sensor in the simulated cell."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scancell.cli.common import (
    AsBuiltOption,
    CellOption,
    JsonOption,
    Outcome,
    ScanOption,
    SeedOption,
    SetOption,
    ThreadsOption,
    run,
    show_progress,
)
from scancell.config.choices import Engine


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
    engine: Annotated[Engine, typer.Option("--engine", help="rendered images, or ideal ray intersection")] = (
        "geometric"
    ),
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    seed: SeedOption = 0,
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Test a sensor with artefacts over its measuring range, in both scan modes: JSON, CSV and one HTML page."""

    def work() -> Outcome:
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
                out=out,
                threads=threads,
                progress=progress,
            )
        names = ("acceptance.json", "acceptance.csv", "acceptance.html", "manifest.json")
        figures = {"largest": report.largest, "linearity_percent": report.figures["linearity_percent"]}
        lines = [report.summary(), f"  report     {out / 'acceptance.html'}"]
        return Outcome(lines, figures, [str(out / name) for name in names], report.warnings)

    run("acceptance", as_json, work)
