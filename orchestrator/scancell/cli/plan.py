"""`scancell plan`: the motion of a scan without making it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scancell.cli.common import (
    CellOption,
    JsonOption,
    Outcome,
    ScanOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
    run,
)

if TYPE_CHECKING:
    from scancell.planning.coverage import CoverageReport
    from scancell.planning.path_planner import PlacedPath
    from scancell.planning.planner import Plan

PathOption = Annotated[
    Path | None, typer.Option("--path", help="sensor path (TOML) instead of the views of the scan description")
]


def plan(
    part: Annotated[Path, typer.Argument(help="mesh of the part (STL, OBJ, PLY)")],
    path: PathOption = None,
    cell: CellOption = None,
    sensor: SensorOption = None,
    scan: ScanOption = None,
    set_: SetOption = None,
    optimum: Annotated[
        bool, typer.Option("--optimum", help="compare motions along paths with the best possible ones; takes longer")
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="PNG file for the configuration map of a path; further paths get a number"),
    ] = None,
    unit: UnitOption = "mm",
    threads: ThreadsOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Plan a scan: collision-free motions of arm and table within all limits, and what they see of the part."""

    def work() -> Outcome:
        from scancell.config.loading import load_setup, with_path  # noqa: PLC0415
        from scancell.scanner import Scanner  # noqa: PLC0415

        setup = with_path(load_setup(cell, sensor, scan, set_ or []), path)
        with Scanner.from_setup(setup, threads) as scanner:
            made = scanner.plan(part, unit=unit)
        lines = [
            f"{part.name}: {len(made.q)} exposures in {len(made.program.segments)} segments,"
            f" {made.program.duration:.1f} s of motion"
        ]
        figures: dict[str, object] = {"exposures": len(made.q), "duration_s": made.program.duration}
        if made.coverage is not None:
            figures["seen"] = made.coverage
        if made.coverage is not None and made.report is None:
            lines.append(f"  sees       {100 * made.coverage:.1f} % of the surface, occlusion ignored")
        if made.report is not None:
            lines += _lines_of_report(made.report)
            figures["report"] = asdict(made.report)
        files = []
        figures["paths"] = told = []
        for number, placed in enumerate(made.paths, start=1):
            told.append(_figures_of(placed, optimum))
            lines.append(_line_of(told[-1]))
            if picture is not None:
                files.append(_draw(placed, str(told[-1]["branch"]), _numbered(picture, number, made)))
        return Outcome(lines, figures, files, list(made.warnings))

    run("plan", as_json, work)


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
        "name": placed.path.name,
        "branch": placed.branch_name,
        "exposures": len(placed.exposures),
        "length_m": placed.path.length,
        "duration_s": float(placed.run.times[-1]),
        "cost": placed.motion.cost,
        "evaluated": map_.evaluated / map_.quality.size,
    }
    if optimum:
        from scancell.planning.optimum import best_motion  # noqa: PLC0415

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


def _numbered(picture: Path, number: int, made: Plan) -> Path:
    return picture if len(made.paths) == 1 else picture.with_stem(f"{picture.stem}_{number}")


def _draw(placed: PlacedPath, branch: str, file: Path) -> str:
    from scancell.output.map_picture import draw_map  # noqa: PLC0415

    placed.lattice.map.require_all()
    draw_map(placed, branch, file)
    return str(file)
