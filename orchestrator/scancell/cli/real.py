"""`scancell reconstruct` and `compare`: clouds of real measurements, and their comparison with the simulation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

import scancell
from scancell.cli.common import (
    CloudUnitOption,
    FormatsOption,
    Outcome,
    OutOption,
    PartOptions,
    ScanOption,
    SeedOption,
    ThreadsOption,
    UnitOption,
    command,
    show_progress,
)
from scancell.config.choices import FlangeConvention, LatencyWord
from scancell.errors import DescriptionError


@dataclass(frozen=True)
class ReconstructOptions(PartOptions):
    """Options of `scancell.reconstruct`."""

    calibration: Annotated[
        Path | None, "results of `scancell calibrate`: calibrated cell, sensor, pose on the flange"
    ] = None
    part: Annotated[
        Path | None,
        "mesh (STL, OBJ, PLY), CAD file (STEP, IGES, BREP) or artefact (TOML); without it: cloud in the base frame",
    ] = None
    flange: Annotated[
        Path | None,
        "flange poses of the exposures, if the table of points holds none: a table,"
        " or a program or list of a robot controller",
    ] = None
    table_format: Annotated[
        str | None,
        "format of profiles of a sensor: a shipped one or a TOML file (docs/how_to/own_profiles.md);"
        " default: by the content",
    ] = None
    convention: Annotated[
        FlangeConvention | None, "convention of the columns flange_orientation_1 … of flange poses"
    ] = None
    laser_off: Annotated[Path | None, "folder of background images of the same names, to subtract"] = None
    quarter_turns: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=3,
            help="turns counter-clockwise from the images to those of the described camera; default: of --calibration",
        ),
    ] = None
    latency_ms: Annotated[
        str | None,
        typer.Option(
            metavar="MS|estimate",
            help="delay of the exposures after the latch; `estimate` finds it from the part; default: of the cell",
        ),
    ] = None
    cloud_unit: CloudUnitOption = None
    keep_all: Annotated[bool, "with --part: keep points of the table and of its neighbours"] = False
    locate: Annotated[bool, "with --part: find its pose on what carries it by the best fit of its mesh"] = False
    scan: ScanOption = None


@command("reconstruct", ReconstructOptions)
def reconstruct(
    data: Annotated[
        Path,
        typer.Argument(
            metavar="DATA",
            help="table of profile points (CSV, Parquet, YAML), profiles as a sensor writes them, or folder of images"
            " with poses.csv; with joints or flange poses; or cloud or surface without poses",
        ),
    ],
    options: ReconstructOptions,
    formats: FormatsOption = "ply",
    out: OutOption = Path("out/reconstruct"),
) -> Outcome:
    """Make a cloud with covariance from measurements of a real sensor on a robot."""
    from scancell.reconstruction.cloud_files import parse_formats  # noqa: PLC0415

    suffixes = parse_formats(formats, "formats")
    given = {**options.given, "latency_ms": _latency(options.latency_ms)}
    with show_progress(options.as_json) as progress:
        result = scancell.reconstruct(data, **given, progress=progress)
    files = [str(path) for path in result.save(out, suffixes)]
    return Outcome([result.summary(), f"  results    {out}"], result.figures, files, result.warnings)


@command("compare")
def compare(
    run_folder: Annotated[
        Path, typer.Argument(metavar="RUN", help="run folder of `scancell reconstruct`, or of a scan")
    ],
    part: Annotated[Path | None, "mesh or artefact that was measured; default: the part of the run"] = None,
    out: OutOption = Path("out/compare"),
    unit: UnitOption = "mm",
    seed: SeedOption = 0,
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Compare measurements of a part with the simulation of the same poses: figures as JSON, and a picture."""
    with show_progress(as_json) as progress:
        found = scancell.compare(run_folder, part=part, unit=unit, seed=seed, threads=threads, progress=progress)
    files = [str(path) for path in found.save(out)]
    return Outcome([found.summary(), f"  results    {out}"], found.figures, files)


def _latency(text: str | None) -> float | LatencyWord | None:
    if text is None:
        return None
    if text == "estimate":
        return "estimate"
    try:
        return float(text)
    except ValueError:
        raise DescriptionError(key="latency_ms", value=text, expected="a number of ms, or estimate") from None
