"""`scancell batch`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scancell.cli.common import (
    AsBuiltOption,
    CellOption,
    JsonOption,
    Outcome,
    ScanOption,
    SensorOption,
    SetOption,
    run,
)
from scancell.cli.execution import (
    SchedulerOption,
    ShardOption,
    WorkersOption,
    execution_target,
    run_many,
    run_timings,
    shard_outcome,
)
from scancell.config.choices import Engine

if TYPE_CHECKING:
    from scancell.studies.batch import Batch
    from scancell.studies.task import ExecutionTarget

_MAX_LISTED = 5  # failures that are printed; the index has all


def batch(
    parts: Annotated[list[Path], typer.Argument(help="meshes (STL, OBJ, PLY), folders of them, or artefacts (TOML)")],
    out: Annotated[Path, typer.Option("--out", help="folder for the results")],
    config: Annotated[
        Path | None, typer.Option("--config", help="batch description (TOML); options override its keys")
    ] = None,
    variants: Annotated[int | None, typer.Option("--variants", min=1, help="number of scans of every part")] = None,
    engine: Annotated[
        Engine | None, typer.Option("--engine", help="ray-traced: rendered camera images; geometric: ray intersections")
    ] = None,
    format_: Annotated[
        str | None,
        typer.Option("--format", help="formats of the clouds, separated by commas: ply, npz, laz, e57, pcd, xyz"),
    ] = None,
    images: Annotated[bool | None, typer.Option("--images/--no-images", help="keep all camera images")] = None,
    truth: Annotated[bool | None, typer.Option("--truth/--no-truth", help="write the ground truth")] = None,
    cell: CellOption = None,
    sensor: SensorOption = None,
    scan: ScanOption = None,
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    ideal: Annotated[bool | None, typer.Option("--ideal/--noisy", help="switch off all noise")] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="random seed")] = None,
    unit: Annotated[str | None, typer.Option("--unit", help="unit of the mesh files: mm, m or inch")] = None,
    workers: WorkersOption = 0,
    scheduler: SchedulerOption = None,
    shard: ShardOption = None,
    as_json: JsonOption = False,
) -> None:
    """Scan many parts in many variants: clouds, images, ground truth and an index. The same command resumes."""
    changes = {
        **{"engine": engine, "images": images, "truth": truth, "ideal": ideal, "seed": seed, "unit": unit},
        **{kind: path and str(path.resolve()) for kind, path in (("cell", cell), ("sensor", sensor), ("scan", scan))},
    }

    def work() -> Outcome:
        from scancell.config.batch import load_batch  # noqa: PLC0415
        from scancell.reconstruction.cloud_files import parse_formats  # noqa: PLC0415
        from scancell.studies.batch import open_batch  # noqa: PLC0415

        given: dict[str, Any] = {key: value for key, value in changes.items() if value is not None}
        if format_ is not None:
            given["formats"] = parse_formats(format_, "format")
        description = load_batch(config, given, variants)
        added = {"set": (*description.set, *(set_ or [])), "as_built": (*description.as_built, *(as_built or []))}
        opened = open_batch(description.model_copy(update=added), config, parts, out)
        target = execution_target(workers, scheduler, shard)
        target.check()
        opened.check()
        opened.begin(out)
        return _run(opened, out, target, as_json, opened.check_same(out).warnings)

    run("batch", as_json, work)


def _run(opened: Batch, out: Path, target: ExecutionTarget, as_json: bool, warnings: list[str]) -> Outcome:
    from scancell.errors import WorkersError  # noqa: PLC0415
    from scancell.studies.batch import INDEX, write_index  # noqa: PLC0415
    from scancell.studies.run_record import mixed_build_warnings  # noqa: PLC0415

    kept = f"finished scans are kept in {out}; the same command resumes"
    made = run_many(lambda progress, announce: opened.run(out, target, progress, announce), as_json, kept)
    partly = shard_outcome(made, target, "scans", "the same command without --shard writes the index", warnings)
    if partly is not None:
        return partly
    collected = write_index(opened, out, made.failed)
    failed = collected.failed
    messages = [f"{row['scan']}: {row['message']}" for row in failed[:_MAX_LISTED]]
    if failed and len(failed) == len(collected.rows):
        raise WorkersError(f"all {len(failed)} scans failed, see {out / INDEX}; the first: {messages[0]}")
    figures: dict[str, Any] = {
        "parts": len(opened.parts),
        "scans": len(collected.rows),
        "failed": len(failed),
        "new": len(made.done),
        "points": sum(row["figures"].get("points", 0) for row in collected.rows),
    }
    lines = [f"{figures['scans'] - figures['failed']} scans of {figures['parts']} parts in {out}"]
    worse = [f"{len(failed)} scans failed: {messages[0]}", *messages[1:]] if failed else []
    builds = mixed_build_warnings(row["scancell"] for row in collected.rows)
    return Outcome(lines, figures, [str(out / INDEX)], [*warnings, *builds, *worse], run_timings(made))
