"""`scancell batch`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orchestrator.cli.common import (
    AsBuiltOption,
    CellOption,
    JsonOption,
    Outcome,
    ScanOption,
    SensorOption,
    SetOption,
    run,
)
from orchestrator.cli.where import (
    SchedulerOption,
    ShardOption,
    WorkersOption,
    run_many,
    run_timings,
    shard_outcome,
    where_of,
)
from orchestrator.config.scan import Engine

if TYPE_CHECKING:
    from orchestrator.studies.batch import Batch
    from orchestrator.studies.task import Where

_TOLD = 5  # failures that are told one by one; the index has all


def batch(
    parts: Annotated[list[Path], typer.Argument(help="meshes (STL, OBJ, PLY), or folders of them")],
    out: Annotated[Path, typer.Option("--out", help="folder for the results")],
    config: Annotated[Path | None, typer.Option("--config", help="batch (TOML); options change what it says")] = None,
    variants: Annotated[int | None, typer.Option("--variants", min=1, help="scans of every part")] = None,
    engine: Annotated[Engine | None, typer.Option("--engine", help="light and images, or rays alone")] = None,
    format_: Annotated[
        str | None, typer.Option("--format", help="of the clouds, several with commas: ply, npz, laz, e57, pcd, xyz")
    ] = None,
    images: Annotated[bool | None, typer.Option("--images/--no-images", help="keep all camera images")] = None,
    truth: Annotated[bool | None, typer.Option("--truth/--no-truth", help="write the ground truth")] = None,
    cell: CellOption = None,
    sensor: SensorOption = None,
    scan: ScanOption = None,
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    ideal: Annotated[bool | None, typer.Option("--ideal/--noisy", help="switch off all noise")] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="keys every random number")] = None,
    unit: Annotated[str | None, typer.Option("--unit", help="unit of the mesh files: mm, m or inch")] = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = None,
    shard: ShardOption = None,
    as_json: JsonOption = False,
) -> None:
    """Scan many parts in many variants: clouds, images, ground truth and an index. The same call again resumes."""
    changes = {
        **{"engine": engine, "images": images, "truth": truth, "ideal": ideal, "seed": seed, "unit": unit},
        **{kind: path and str(path.resolve()) for kind, path in (("cell", cell), ("sensor", sensor), ("scan", scan))},
    }

    def work() -> Outcome:
        from orchestrator.config.batch import load_batch  # noqa: PLC0415
        from orchestrator.reconstruction.cloud_files import parse_formats  # noqa: PLC0415
        from orchestrator.studies.batch import check_batch, claim, open_batch  # noqa: PLC0415

        given: dict[str, Any] = {key: value for key, value in changes.items() if value is not None}
        if format_ is not None:
            given["formats"] = parse_formats(format_, "--format")
        description = load_batch(config, given, variants)
        added = {"set": (*description.set, *(set_ or [])), "as_built": (*description.as_built, *(as_built or []))}
        opened = open_batch(description.model_copy(update=added), config, parts, out)
        check_batch(opened)
        warnings = claim(opened, out).warnings
        return _made(opened, out, where_of(workers, scheduler, shard), as_json, warnings)

    run("batch", as_json, work)


def _made(opened: Batch, out: Path, where: Where, as_json: bool, warnings: list[str]) -> Outcome:
    from orchestrator.errors import EngineError  # noqa: PLC0415
    from orchestrator.studies.batch import INDEX, gather, run_batch  # noqa: PLC0415
    from orchestrator.studies.run_record import told_builds  # noqa: PLC0415

    kept = f"finished scans are kept in {out}; the same command goes on"
    made = run_many(lambda progress, tell: run_batch(opened, out, where, progress, tell), as_json, kept)
    partly = shard_outcome(made, where, "scans", "the same command without --shard writes the index", warnings)
    if partly is not None:
        return partly
    gathered = gather(opened, out, made.failed)
    failed = gathered.failed
    told = [f"{row['scan']}: {row['message']}" for row in failed[:_TOLD]]
    if failed and len(failed) == len(gathered.rows):
        raise EngineError(f"all {len(failed)} scans failed, see {out / INDEX}; the first: {told[0]}")
    figures: dict[str, Any] = {
        "parts": len(opened.parts),
        "scans": len(gathered.rows),
        "failed": len(failed),
        "new": len(made.done),
        "points": sum(row["figures"].get("points", 0) for row in gathered.rows),
    }
    lines = [f"{figures['scans'] - figures['failed']} scans of {figures['parts']} parts in {out}"]
    worse = [f"{len(failed)} scans failed: {told[0]}", *told[1:]] if failed else []
    builds = told_builds(row["scancell"] for row in gathered.rows)
    return Outcome(lines, figures, [str(out / INDEX)], [*warnings, *builds, *worse], run_timings(made))
