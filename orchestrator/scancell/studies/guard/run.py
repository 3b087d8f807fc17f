"""Execution of campaigns: parallel, resumable."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import count, islice
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
from scancell.nominal.parts import load_part
from scancell.studies.guard.campaign import Campaign, RunRow
from scancell.studies.guard.mutations import MUTATIONS, Mutation
from scancell.studies.guard.parts import standing_parts
from scancell.studies.guard.rows import RowFile, summary, tables
from scancell.studies.guard.search import Search
from scancell.studies.guard.strata import BLOCK, THIRDS, stratum_of
from scancell.studies.guard.worlds import described_cells

IGNORED = "ignored-pair"
IN_CAMPAIGN = "campaign"
_MOVES = 6  # to the contact of a pair


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


def campaign_of(options: CampaignOptions, mutation: Mutation | None = None, folder: Path | None = None) -> Campaign:
    """The campaign, in this process; its files lie in `folder`, or where the system keeps temporary files.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.
    """
    given = load_part(options.part, options.unit)
    parts = {Path(options.part).stem: given, **standing_parts()}
    return Campaign(described_cells(options.cell), parts, options.seed, mutation, folder)


def _loaded(options: CampaignOptions) -> tuple[CellDescription, Mesh]:
    return load_setup(options.cell).cell, load_part(options.part, options.unit)


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


@dataclass(frozen=True)
class SearchOutcome:
    """What a search for a collision found.

    Attributes
    ----------
    error
        Deliberate error of the guard; empty: none.
    pair
        Pair of bodies that moves were to bring in contact, ``A - B``; empty: a search by hand; `IN_CAMPAIGN`: runs of a
        campaign.
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
    """At most `runs` attempts at a collision, by hand, with moves to the contact of a pair, or as in a campaign.

    `error` is one of `MUTATIONS`, or `IGNORED`: the guard does not compare the pair.

    Raises
    ------
    ScancellError
        If there is no such error, or naming what is wrong with the cell.
    """
    known = MUTATIONS | ({IGNORED: Mutation(ignored=pair)} if pair else {})
    if error and error not in known:
        raise DescriptionError(key="error", value=error, expected=f"one of {', '.join(known)}")
    mutation = known[error] if error else None
    if mutation and mutation.strata:
        return _search_campaign(options, runs, error, mutation)
    clearance, contact, done = np.inf, "", 0
    with Search(*_loaded(options), options.seed, mutation) as made:
        attempts = made.on_path(pair) if pair else made.by_hand()
        for attempt in islice(attempts, runs):
            done += 1
            clearance, contact = min(clearance, attempt.clearance), attempt.contact
            if contact:
                break
    return SearchOutcome(error, " - ".join(pair or ()), done, contact, float(clearance) if done else None)


def _search_campaign(options: CampaignOptions, runs: int, error: str, mutation: Mutation) -> SearchOutcome:
    """At most `runs` runs of a campaign whose twins collide; contacts of a guard without the error do not count."""
    assert mutation.strata
    strata = (stratum_of(number) for number in count())
    concerned = (one for one in strata if one.third == THIRDS[0] and mutation.strata(one))
    clearance, contact, done = np.inf, "", 0
    with campaign_of(options, mutation) as made, campaign_of(options) as plain:
        for stratum in islice(concerned, runs):
            row = made.run(stratum.number)
            done += 1
            clearance = min(clearance, row.clearance)
            if row.collided and not plain.run(stratum.number).collided:
                contact = row.contact or "bodies"
                break
    return SearchOutcome(error, IN_CAMPAIGN, done, contact, float(clearance) if done else None)


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
