"""Searches for a collision with the guard as it is, and with deliberate errors."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from multiprocessing import get_context

import numpy as np

from bench.guard_search.mutations import MUTATIONS, MutatedSimulation, Mutation
from bench.guard_search.search import Search
from scancell.config.cell import CellDescription
from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.geometry.mesh import Mesh
from scancell.nominal.parts import load_part
from scancell.studies.guard.draws import stratum_of
from scancell.studies.guard.run import CampaignOptions, campaign_of
from scancell.studies.guard.worlds import standing_parts

IGNORED = "ignored-pair"
TABLE, FURTHER = "table-jogs", "axis-jogs"
ALONE = {TABLE: Mutation(alone="table"), FURTHER: Mutation(alone="further", further=True)}  # no errors
IN_CAMPAIGN = "campaign"
_MOVES = 6  # to the contact of a pair


def _loaded(options: CampaignOptions) -> tuple[CellDescription, Mesh]:
    return load_setup(options.cell).cell, load_part(options.part, options.unit)


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

    `error` is one of `MUTATIONS`, `IGNORED`: the guard does not compare the pair, or of `ALONE`: no error, jogs of one
    axis.

    Raises
    ------
    ScancellError
        If there is no such error, or naming what is wrong with the cell.
    """
    known = MUTATIONS | ALONE | ({IGNORED: Mutation(ignored=(pair,))} if pair else {})
    if error and error not in known:
        raise DescriptionError(key="error", value=error, expected=f"one of {', '.join(known)}")
    mutation = known[error] if error else None
    if mutation and mutation.further and not load_setup(options.cell).cell.axis:
        raise DescriptionError(key="cell", value=options.cell, expected="a cell with axes beyond the table")
    if mutation and mutation.strata:
        return _search_campaign(options, runs, error, mutation)
    clearance, contact, done = np.inf, "", 0
    cell, part = _loaded(options)
    if mutation and mutation.alone:
        part = standing_parts()["plate"]
    with Search(cell, part, options.seed, mutation) as made:
        attempts = made.on_path(pair) if pair else made.by_hand()
        for attempt in islice(attempts, runs):
            done += 1
            clearance, contact = min(clearance, attempt.clearance), attempt.contact
            if contact:
                break
    return SearchOutcome(error, " - ".join(pair or ()), done, contact, float(clearance) if done else None)


def _search_campaign(options: CampaignOptions, runs: int, error: str, mutation: Mutation) -> SearchOutcome:
    """At most `runs` runs of a campaign that start near a body; contacts of a guard without the error do not count."""
    assert mutation.strata
    strata = (stratum_of(number) for number in count())
    concerned = (one for one in strata if one.near and mutation.strata(one))
    clearance, contact, done = np.inf, "", 0
    with campaign_of(options, simulation=partial(MutatedSimulation, mutation)) as made, campaign_of(options) as plain:
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
    cell, part = _loaded(options)
    with Search(cell, part, options.seed) as plain:
        pairs = plain.pairs
    possible = [error for error, mutation in MUTATIONS.items() if cell.axis or not mutation.further]
    tasks: list[tuple[int, str, tuple[str, str] | None]] = [(runs, error, None) for error in ("", *possible)]
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
