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
    PathOption,
    ScanOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    UnitOption,
    run,
)

if TYPE_CHECKING:
    from scancell.planning.path_map.path_planner import PlacedPath
    from scancell.planning.plan import Plan
    from scancell.planning.views.coverage import CoverageReport


def plan(
    part: Annotated[Path, typer.Argument(help="mesh (STL, OBJ, PLY) or artefact (TOML)")],
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
    all_branches: Annotated[
        bool, typer.Option("--all-branches", help="with --picture: also the maps of the other arm branches")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="JSON file for the plan, for `scancell scan --plan`")
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
        with Scanner(setup=setup, threads=threads) as scanner:
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
        lines += [f"  {line}" for line in made.reduced]
        figures["reduced"] = list(made.reduced)
        files = []
        figures["paths"] = told = []
        for number, placed in enumerate(made.paths, start=1):
            told.append(_figures_of(placed, optimum))
            lines.append(_line_of(told[-1]))
            if picture is not None:
                file = _numbered(picture, number, made)
                files += _draw(placed, str(told[-1]["branch"]), file, all_branches)
        if out is not None:
            files.append(str(made.save(out)))
        warnings = list(made.warnings)
        if picture is not None and not made.paths:
            warnings.append(
                f"{picture.name} is not written: a configuration map is of a sensor path, the plan has none"
            )
        return Outcome(lines, figures, files, warnings)

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
        "duration_s": placed.run.duration,
        "cost": placed.motion.cost,
        "evaluated": map_.evaluated / map_.quality.size,
    }
    if optimum:
        from scancell.planning.path_map.optimum import best_motion  # noqa: PLC0415

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


def _draw(placed: PlacedPath, branch: str, file: Path, all_branches: bool) -> list[str]:
    """Draw the map of the branch that was chosen, and on request those of the others."""
    from scancell.files import name_for_file  # noqa: PLC0415
    from scancell.output.map_picture import draw_map  # noqa: PLC0415

    chosen = placed.lattice.map
    chosen.require_all()
    draw_map(chosen, placed.path.name, branch, placed.run.duration, placed.motion, file)
    files = [str(file)]
    for number, name in enumerate(placed.branch_names if all_branches else ()):
        if number != chosen.branch:
            other = chosen.of_branch(number)
            other.require_all()
            files.append(str(file.with_stem(f"{file.stem}_{name_for_file(name)}")))
            draw_map(other, placed.path.name, name, placed.run.duration, None, Path(files[-1]))
    return files
