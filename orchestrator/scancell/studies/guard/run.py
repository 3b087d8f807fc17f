"""Execution of campaigns: parallel, resumable."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scancell.config.cell import CellDescription
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.geometry.mesh import load_mesh
from scancell.guard.guard import Guard
from scancell.jobs.guard_job import settings_of
from scancell.nominal.cell import nominal_cell
from scancell.studies.guard.campaign import Campaign, RunRow
from scancell.studies.guard.mutations import MUTATIONS
from scancell.studies.guard.rows import RowFile, summary, tables
from scancell.studies.guard.simulation import Simulation


@dataclass(frozen=True)
class CampaignOptions:
    """What a campaign consists of.

    Attributes
    ----------
    cell
        File of the cell's description; None: the shipped default.
    part
        Mesh file of the part, in `unit`.
    seed
        Of all runs.
    mutation
        Name of a deliberate error of the guard; empty: none.
    """

    cell: str | None
    part: str
    unit: str = "mm"
    seed: int = 1
    mutation: str = ""


def campaign_of(options: CampaignOptions, folder: Path | None = None) -> Campaign:
    """The campaign, in this process; its files lie in `folder`, or where the system keeps temporary files.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.
    """
    description: CellDescription = load_setup(options.cell).cell
    nominal = nominal_cell(description, load_mesh(options.part, options.unit))
    settings = settings_of(description)
    if options.mutation and options.mutation not in MUTATIONS:
        raise DescriptionError(f"mutation '{options.mutation}': expected one of {', '.join(MUTATIONS)}")
    simulation = Simulation(description, nominal, folder)
    if not options.mutation:
        return Campaign(simulation, Guard(nominal, description.robot, settings), options.seed)
    return MUTATIONS[options.mutation](simulation, settings, options.seed)


_kept = cache(campaign_of)  # a worker process keeps its cell


def _run(options: CampaignOptions, folder: Path, number: int) -> RunRow:
    return _kept(options, folder).run(number)


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
        raise DescriptionError(f"{described}: another campaign: expected another folder or {asdict(options)}")
    described.write_text(json.dumps(asdict(options), indent=1))
    file = RowFile(folder / "rows.csv")
    done = {row.number for row in file.rows}
    missing = [number for number in range(runs) if number not in done]
    count = min(workers or os.cpu_count() or 1, max(len(missing), 1))
    # Worker processes end without freeing what they keep.
    with (
        TemporaryDirectory(prefix="scancell-campaign-") as files,
        ProcessPoolExecutor(count, get_context("spawn")) as pool,
    ):
        for row in pool.map(partial(_run, options, Path(files)), missing):
            file.append(row)
            if progress:
                progress(row)
    rows = [row for row in file.rows if row.number < runs]
    with atomic_write(folder / "tables.md") as temporary:
        temporary.write_text("\n".join(tables(rows)) + "\n")
    return summary(rows)
