"""`scancell plan` and `place`: the motion of a scan, and set-ups of a free part, without scanning."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

import scancell
from scancell.cli.common import Outcome, PartArgument, PartOptions, PathOption, ScanOption, command, show_progress

if TYPE_CHECKING:
    from scancell.config.cell import CellDescription
    from scancell.planning.path_map.path_planner import PlacedPath
    from scancell.planning.setups import SetUp
    from scancell.planning.views.coverage import CoverageReport


@command("plan", PartOptions)
def plan(
    part: PartArgument,
    options: PartOptions,
    path: PathOption = None,
    scan: ScanOption = None,
    optimum: Annotated[bool, "compare motions along paths with the best possible ones; takes longer"] = False,
    picture: Annotated[Path | None, "PNG file for the configuration map of a path; further paths get a number"] = None,
    all_branches: Annotated[bool, "with --picture: also the maps of the other arm branches"] = False,
    out: Annotated[Path | None, "JSON file for the plan, for `scancell scan --plan`"] = None,
) -> Outcome:
    """Plan a scan: collision-free motions of arm and table within all limits, and the surface that they see."""
    with scancell.Scanner(setup=options.setup(scan, path), threads=options.threads) as scanner:
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
    from scancell.output.map_picture import map_picture  # noqa: PLC0415

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
            f" tips over at {np.degrees(one.tip_angle):.0f} deg"
        )
        if one.riser is not None:
            size = " x ".join(f"{1e3 * length:.0f}" for length in np.ptp(one.riser.vertices, axis=0))
            lines.append(f"# on a riser of {size} mm")
        lines += one.toml.splitlines()
        if out is not None:
            files += _write(one, setup.cell, out if number == 1 else _numbered(out, number))
    return Outcome(lines, found.figures, files)


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
