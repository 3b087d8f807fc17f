"""Execution of campaigns: parallel, resumable."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.nominal.parts import load_part
from scancell.studies.guard.campaign import Campaign, RunRow
from scancell.studies.guard.guarded import Protection
from scancell.studies.guard.parts import standing_parts
from scancell.studies.guard.rows import RowFile, summary, tables
from scancell.studies.guard.strata import BLOCK
from scancell.studies.guard.worlds import described_cells


@dataclass(frozen=True)
class CampaignOptions:
    """What a campaign consists of.

    Attributes
    ----------
    cell
        File of the cell's description; None: all shipped ones take turns.
    part
        Mesh file of the part, in `unit`.
    seed
        Of all runs.
    """

    cell: str | None
    part: str
    unit: str = "mm"
    seed: int = 1


def campaign_of(options: CampaignOptions, protection: Protection | None = None, folder: Path | None = None) -> Campaign:
    """The campaign, in this process; its files lie in `folder`, or where the system keeps temporary files.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.
    """
    given = load_part(options.part, options.unit)
    parts = {Path(options.part).stem: given, **standing_parts()}
    return Campaign(described_cells(options.cell), parts, options.seed, protection, folder)


_kept = cache(campaign_of)  # a worker process keeps its cell


def _run(options: CampaignOptions, folder: Path, numbers: Sequence[int]) -> list[RunRow]:
    campaign = _kept(options, None, folder)
    return [campaign.run(number) for number in numbers]


def run_campaign(
    options: CampaignOptions,
    runs: int,
    folder: Path,
    workers: int = 0,
    progress: Callable[[RunRow], None] | None = None,
) -> dict[str, Any]:
    """Figures of a campaign of `runs` runs, which goes on where an earlier one in `folder` stopped.

    Raises
    ------
    ScancellError
        If the folder holds another campaign, or naming what is wrong with this one.
    """
    campaign_of(options).close()  # what is wrong is said here, not in a worker
    folder.mkdir(parents=True, exist_ok=True)
    described = folder / "campaign.json"
    if described.exists() and json.loads(described.read_text()) != asdict(options):
        raise DescriptionError("another campaign", file=described, expected=f"another folder or {asdict(options)}")
    described.write_text(json.dumps(asdict(options), indent=1))
    file = RowFile(folder / "rows.csv")
    done = {row.number for row in file.rows}
    blocks: dict[int, list[int]] = {}  # runs with one cell, which a process makes one after the other
    for number in range(runs):
        if number not in done:
            blocks.setdefault(number // BLOCK, []).append(number)
    processes = min(workers or os.cpu_count() or 1, max(len(blocks), 1))
    # Worker processes end without freeing what they keep.
    with (
        TemporaryDirectory(prefix="scancell-campaign-") as files,
        ProcessPoolExecutor(processes, get_context("spawn")) as pool,
    ):
        try:
            for made in pool.map(partial(_run, options, Path(files)), blocks.values()):
                for row in made:
                    file.append(row)
                    if progress:
                        progress(row)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    rows = [row for row in file.rows if row.number < runs]
    with atomic_write(folder / "tables.md") as temporary:
        temporary.write_text("\n".join(tables(rows)) + "\n")
    return summary(rows)
