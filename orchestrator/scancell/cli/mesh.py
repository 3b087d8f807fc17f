"""`scancell mesh`: the surface of a scan as a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scancell.cli.common import JsonOption, Outcome, run
from scancell.config.choices import Reconstruction


def mesh(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="run folder, or cloud file of scancell (PLY)")],
    out: Annotated[Path, typer.Option("--out", help="mesh file (STL, PLY, OBJ), mm")] = Path("out/surface.ply"),
    method: Annotated[
        Reconstruction,
        typer.Option("--method", help="smooth surface, cut off where points are sparse; or points joined by triangles"),
    ] = "poisson",
    spacing_mm: Annotated[
        float | None,
        typer.Option("--spacing-mm", min=0.001, help="smallest details; default: 1/250 of the extent"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Reconstruct the surface of a scan, for `scancell scan` or other programs (extra `mesh`)."""

    def work() -> Outcome:
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

    run("mesh", as_json, work)
