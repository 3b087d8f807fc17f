"""`scancell survey`: what stands around the table beside what the cell describes."""

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
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
    run,
    show_progress,
)


def survey(
    part: Annotated[Path, typer.Argument(help="part on the table: mesh (STL, OBJ, PLY) or artefact (TOML)")],
    out: Annotated[Path, typer.Option("--out", help="file for the voxels (NPZ)")] = Path("out/survey.npz"),
    radius_mm: Annotated[
        float | None,
        typer.Option("--radius-mm", min=1, help="radius of the surveyed cylinder; default: the table's and 50 mm"),
    ] = None,
    height_mm: Annotated[
        float, typer.Option("--height-mm", min=1, help="its height above the table; space above it is taken as free")
    ] = 200.0,
    voxel_mm: Annotated[float, typer.Option("--voxel-mm", min=1, help="edge of the voxels")] = 10.0,
    pitch_mm: Annotated[
        float, typer.Option("--pitch-mm", min=0.1, help="distance between exposures; what is thinner may be missed")
    ] = 5.0,
    inflate_mm: Annotated[
        float, typer.Option("--inflate-mm", min=0, help="space within this distance of measured voxels is occupied")
    ] = 2.0,
    cell: CellOption = None,
    sensor: SensorOption = None,
    scan: ScanOption = None,
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    ideal: Annotated[bool, typer.Option("--ideal", help="switch off all noise")] = False,
    seed: SeedOption = 0,
    unit: UnitOption = "mm",
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Scan the space around the table: voxels of what is occupied or unseen, for `occupied` of a scan description."""

    def work() -> Outcome:
        from scancell.config.loading import load_setup  # noqa: PLC0415
        from scancell.scanner import Scanner  # noqa: PLC0415

        setup = load_setup(cell, sensor, scan, set_ or [], ideal)
        with show_progress(as_json) as progress, Scanner(setup=setup, threads=threads) as scanner:
            result = scanner.survey(
                part,
                unit=unit,
                radius=None if radius_mm is None else radius_mm / 1e3,
                height=height_mm / 1e3,
                voxel=voxel_mm / 1e3,
                pitch=pitch_mm / 1e3,
                inflation=inflate_mm / 1e3,
                as_built=as_built or (),
                seed=seed,
                progress=progress,
            )
        file = result.save(out)
        return Outcome([f"{part.name}: {result.summary()}"], result.figures, [str(file)])

    run("survey", as_json, work)
