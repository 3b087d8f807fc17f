"""Execution of campaigns: parallel, resumable."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from scancell.config.cell import CellDescription
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.geometry.mesh import Mesh
from scancell.guard.guard import Guard
from scancell.jobs.guard_job import settings_of
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import load_part
from scancell.studies.guard.campaign import Campaign, RunRow
from scancell.studies.guard.mutations import MUTATIONS, Mutation
from scancell.studies.guard.rows import RowFile, summary, tables
from scancell.studies.guard.search import Search
from scancell.studies.guard.simulation import Simulation

IGNORED = "ignored-pair"
_MOVES = 6  # to the contact of a pair


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
    """

    cell: str | None
    part: str
    unit: str = "mm"
    seed: int = 1


def campaign_of(options: CampaignOptions, folder: Path | None = None) -> Campaign:
    """The campaign, in this process; its files lie in `folder`, or where the system keeps temporary files.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.
    """
    description, part = _loaded(options)
    nominal = nominal_cell(description, part)
    guard = Guard(nominal, description.robot, settings_of(description))
    return Campaign(Simulation(description, nominal, folder), guard, options.seed)


def _loaded(options: CampaignOptions) -> tuple[CellDescription, Mesh]:
    return load_setup(options.cell).cell, load_part(options.part, options.unit)


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


@dataclass(frozen=True)
class SearchOutcome:
    """What a search for a collision found.

    Attributes
    ----------
    error
        Deliberate error of the guard; empty: none.
    pair
        Pair of bodies that moves were to bring in contact, ``A - B``; empty: a search by hand.
    runs
        Guarded runs, to the first contact.
    contact
        Pair in contact; empty: none.
    clearance
        Smallest distance of bodies that were steered to each other, m; None: there was no run.
    """

    error: str
    pair: str
    runs: int
    contact: str
    clearance: float | None


def search(options: CampaignOptions, runs: int, error: str = "", pair: tuple[str, str] | None = None) -> SearchOutcome:
    """At most `runs` attempts at a collision, by hand or with moves to the contact of a pair.

    `error` is one of `MUTATIONS`, or `IGNORED`: the guard does not compare the pair.

    Raises
    ------
    ScancellError
        If there is no such error, or naming what is wrong with the cell.
    """
    known = MUTATIONS | ({IGNORED: Mutation(ignored=pair)} if pair else {})
    if error and error not in known:
        raise DescriptionError(f"error '{error}': expected one of {', '.join(known)}")
    clearance, contact, done = np.inf, "", 0
    with Search(*_loaded(options), options.seed, known[error] if error else None) as made:
        attempts = made.on_path(pair) if pair else made.by_hand()
        for attempt in islice(attempts, runs):
            done += 1
            clearance, contact = min(clearance, attempt.clearance), attempt.contact
            if contact:
                break
    return SearchOutcome(error, " - ".join(pair or ()), done, contact, float(clearance) if done else None)


def search_all(options: CampaignOptions, runs: int, workers: int = 0) -> Iterator[SearchOutcome]:
    """Searches with the guard as it is and with each error: `runs` by hand, and a few moves for each pair of bodies."""
    with Search(*_loaded(options), options.seed) as plain:
        pairs = plain.pairs
    tasks: list[tuple[int, str, tuple[str, str] | None]] = [(runs, error, None) for error in ("", *MUTATIONS)]
    tasks += [(min(runs, _MOVES), error, pair) for pair in pairs for error in ("", IGNORED)]
    with ProcessPoolExecutor(workers or os.cpu_count() or 1, get_context("spawn")) as pool:
        yield from pool.map(partial(search, options), *zip(*tasks, strict=True))


def search_table(outcomes: Sequence[SearchOutcome]) -> Iterator[str]:
    """Markdown table of searches."""
    yield "| guard | steered to | runs | contact | smallest distance, mm |"
    yield "| --- | --- | --- | --- | --- |"
    for one in outcomes:
        way = one.pair or "by hand"
        distance = "no move found" if one.clearance is None else f"{1e3 * one.clearance:.2f}"
        yield f"| {one.error or 'as it is'} | {way} | {one.runs} | {one.contact} | {distance} |"
