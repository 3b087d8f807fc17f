"""Execution of campaigns in parallel and resumable, the file of their runs, and tables."""

from __future__ import annotations

import csv
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TextIO

import numpy as np

from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.nominal.parts import load_part
from scancell.studies.guard.campaign import Campaign, RunRow
from scancell.studies.guard.simulation import Protection
from scancell.studies.guard.strata import BLOCK, DECADES, FAULTS, THIRDS
from scancell.studies.guard.worlds import described_cells, standing_parts

_READ: dict[str, Callable[[str], Any]] = {"int": int, "float": float, "str": str, "bool": lambda text: text == "True"}


class RowFile:
    """A CSV file to which the rows of a campaign are appended.

    A last line that an interrupt cut short is dropped.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows: list[RunRow] = []
        if path.exists():
            self.rows = list(self._read())
        with atomic_write(path) as temporary, temporary.open("w", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerow([field.name for field in fields(RunRow)])
            _write(stream, self.rows)

    def _read(self) -> Iterator[RunRow]:
        text = self._path.read_text()
        reader = csv.DictReader(text[: text.rfind("\n") + 1].splitlines())
        names = [field.name for field in fields(RunRow)]
        if reader.fieldnames != names:
            raise DescriptionError(file=self._path, key="columns", value=reader.fieldnames, expected=str(names))
        for read in reader:
            yield RunRow(**{field.name: _READ[str(field.type)](read[field.name]) for field in fields(RunRow)})

    def append(self, row: RunRow) -> None:
        """Add a row."""
        self.rows.append(row)
        with self._path.open("a", newline="") as stream:
            _write(stream, [row])


def _write(stream: TextIO, rows: Iterable[RunRow]) -> None:
    csv.writer(stream, lineterminator="\n").writerows(asdict(row).values() for row in rows)


def summary(rows: Sequence[RunRow]) -> dict[str, Any]:
    """Figures of a campaign."""
    collisions = sum(row.collided for row in rows)
    done = [row for row in rows if np.isfinite(row.arrived_at) and np.isfinite(row.twin_arrived_at)]
    loss = [row.arrived_at / row.twin_arrived_at - 1 for row in done]
    return {
        "runs": len(rows),
        "collisions": collisions,
        "collisions_by_decade": {decade: sum(row.collided for row in own) for decade, own in _by_decade(rows)},
        "collisions_of_twins": sum(bool(row.twin_contact) for row in rows),
        "pairs_of_twins": len({row.twin_contact for row in rows if row.twin_contact}),
        # Upper end of the one-sided 95 % interval: that of the rule of three where nothing happened.
        "probability_bound": 1 - 0.05 ** (1 / len(rows)) if rows and not collisions else None,
        "stops": dict(Counter(row.stop for row in rows if row.stop)),
        "false_stops": {decade: _share(own) for decade, own in _by_decade(rows)},
        "warnings": sum(row.warnings for row in rows),
        "warnings_while_retreating": sum(row.warned_retreating for row in rows),
        "cycle_time_loss_median": float(np.median(loss)) if loss else None,
        "cycle_time_loss_95": float(np.percentile(loss, 95)) if loss else None,
    }


def _by_decade(rows: Sequence[RunRow]) -> Iterator[tuple[str, list[RunRow]]]:
    for decade in DECADES:
        yield decade, [row for row in rows if row.decade == decade]


def _share(rows: Sequence[RunRow]) -> float | None:
    return sum(row.false_stop for row in rows) / len(rows) if rows else None


_COUNTS: dict[str, Callable[[RunRow], bool]] = {
    "twins collided": lambda row: bool(row.twin_contact),
    "collisions": lambda row: row.collided,
    "stopped by the guard": lambda row: row.stop == "guard",
    "refused": lambda row: row.stop == "refused",
    "false": lambda row: row.false_stop,
    "by age": lambda row: row.stop == "age",
    "slowed": lambda row: row.halted,
}


def tables(rows: Sequence[RunRow]) -> Iterator[str]:
    """Markdown tables of a campaign."""
    by_decade: dict[str, Callable[[RunRow], str]] = {"speed": lambda row: row.decade}
    yield from _table(by_decade, rows)
    yield from _table({**by_decade, "operation": lambda row: row.operation, "twin": lambda row: row.third}, rows)
    yield from _table({"fault": lambda row: row.fault}, rows)
    yield from _table({"cell": lambda row: row.cell}, rows)
    yield from _table({"part": lambda row: row.part}, rows)
    yield from _table({"moved by": lambda row: row.motion}, rows)
    yield from _table({"shows jogs": lambda row: "no" if row.silent else "yes", **by_decade}, rows)
    shares = (0, 1, 5, 25, 50, 75)
    yield "| smallest clearance, mm | twin | " + " | ".join(f"{share} %" for share in shares) + " |"
    yield "| --- | --- |" + " --- |" * len(shares)
    for decade, of_decade in _by_decade(rows):
        for third in THIRDS:
            own = [1e3 * row.clearance for row in of_decade if row.third == third]
            if own:
                values = np.percentile(own, shares)
                yield f"| {decade} | {third} | " + " | ".join(f"{value:.1f}" for value in values) + " |"


def _table(keys: Mapping[str, Callable[[RunRow], str]], rows: Sequence[RunRow]) -> Iterator[str]:
    """Counts of the rows by keys, and the smallest clearance."""
    groups: dict[tuple[str, ...], list[RunRow]] = {}
    for row in rows:
        groups.setdefault(tuple(key(row) for key in keys.values()), []).append(row)
    yield f"| {' | '.join(keys)} | runs | {' | '.join(_COUNTS)} | smallest clearance, mm |"
    yield "| --- " * (len(keys) + len(_COUNTS) + 2) + "|"
    for names, own in sorted(groups.items(), key=lambda group: _order(group[0])):
        counts = " | ".join(str(sum(counted(row) for row in own)) for counted in _COUNTS.values())
        smallest = 1e3 * min(row.clearance for row in own)
        yield f"| {' | '.join(names)} | {len(own)} | {counts} | {smallest:.1f} |"
    yield ""


def _order(names: tuple[str, ...]) -> list[tuple[int, str]]:
    """Decades, operations, thirds and faults in their own order, other names in that of the alphabet."""
    known = [*DECADES, "manual", "automatic", *THIRDS, *FAULTS]
    return [(known.index(name) if name in known else 0, name) for name in names]


@dataclass(frozen=True)
class CampaignOptions:
    """Inputs of a campaign.

    Attributes
    ----------
    cell
        File of the cell's description; None: all shipped cells alternate.
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
    """Figures of a campaign of `runs` runs, which resumes an earlier one in `folder`.

    Raises
    ------
    ScancellError
        If the folder holds another campaign, or naming what is wrong with this one.
    """
    campaign_of(options).close()  # errors are raised here, not in a worker
    folder.mkdir(parents=True, exist_ok=True)
    described = folder / "campaign.json"
    if described.exists() and json.loads(described.read_text()) != asdict(options):
        raise DescriptionError(
            "holds another campaign", file=described, expected=f"another folder or {asdict(options)}"
        )
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
