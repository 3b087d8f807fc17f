"""`scancell evaluate`: a cloud against a mesh or an artefact."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.common import JsonOption, Outcome, ThreadsOption, UnitOption, run
from scancell.config.choices import Align

if TYPE_CHECKING:
    from scancell.evaluation.artefact import ArtefactEvaluation
    from scancell.evaluation.mesh_evaluation import MeshEvaluation

_SHOWN = 40  # lines of figures for people; all are in the files
_SHOWN_REGIONS = 12


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
        lines = [f"{cloud}: {len(found.signed)} points", *_lines(found)]
        return Outcome(lines, found.as_json(), files, list(found.warnings))

    run("evaluate", as_json, work)


def _lines(found: MeshEvaluation | ArtefactEvaluation) -> list[str]:
    from scancell.evaluation.artefact import ArtefactEvaluation  # noqa: PLC0415

    figures = found.figures
    lines = [
        f"  {figures.count} compared, mean {1e6 * figures.mean:.1f} um, RMS {1e6 * figures.rms:.1f} um,"
        f" D95 % {1e6 * figures.d95:.1f} um"
    ]
    if not isinstance(found, ArtefactEvaluation):
        return [*lines, *_region_lines(found)]
    if found.datum:
        lines.append(f"  datum faces: {', '.join(found.datum)}")
    lines += [_line(one.as_row()) for one in found.characteristics[:_SHOWN]]
    if len(found.characteristics) > _SHOWN:
        lines.append(f"  … {len(found.characteristics) - _SHOWN} more in evaluation.csv")
    return lines


def _region_lines(found: MeshEvaluation) -> list[str]:
    """Coverage, datum regions, and the largest regions with their frames."""
    from scancell.evaluation.mesh_evaluation import region_text  # noqa: PLC0415

    lines = [f"  {100 * found.coverage:.1f} % of the surface covered, {len(found.regions)} regions"]
    lines += [f"  datum face: region {number}: {region_text(found.regions, number)}" for number in found.datum]
    shown = list(found.by_region.items())[:_SHOWN_REGIONS]
    for number, figures in shown:
        text = region_text(found.regions, number)
        lines.append(f"  region {number}: {text}: {figures.count} points, RMS {1e6 * figures.rms:.1f} um")
    if len(found.by_region) > len(shown):
        lines.append(f"  … {len(found.by_region) - len(shown)} more in evaluation.csv")
    return lines


def _line(row: dict[str, Any]) -> str:
    """A characteristic with its error and uncertainty; a form deviation has no error beside its value."""
    shown = {name: value for name, value in row.items() if name not in ("of", "name") and value is not None}
    if not any(value for name, value in shown.items() if name.startswith("nominal_")):
        shown = {name: value for name, value in shown.items() if not name.startswith(("nominal_", "error_"))}
    words = [name.split("_") for name in shown]
    parts = [
        f"{what} {value:.{3 if unit == 'um' else 5}f} {unit}"
        for (what, unit), value in zip(words, shown.values(), strict=True)
    ]
    return f"  {row['of']}: {row['name']}: {', '.join(parts)}"
