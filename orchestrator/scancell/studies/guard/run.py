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

from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.nominal.parts import load_part
from scancell.studies.guard.campaign import Campaign, RunRow
from scancell.studies.guard.draws import BLOCK, DECADES, FAULTS, LENGTHS, MIXED
from scancell.studies.guard.scenario import Kind
from scancell.studies.guard.simulation import Simulation
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
    collisions = [row for row in rows if row.collided]
    motions = sum(row.motions for row in rows)
    return {
        "runs": len(rows),
        "collisions": len(collisions),
        "collisions_by_kind": dict(Counter(row.contact_kind for row in collisions)),
        "contacts_by_gripper": sum(row.by_gripper for row in rows),
        "collisions_of_twins": sum(bool(row.twin_contact) for row in rows),
        "pairs_of_twins": len({row.twin_contact for row in rows if row.twin_contact}),
        # Upper end of the one-sided 95 % interval: that of the rule of three where nothing happened.
        "probability_bound": 1 - 0.05 ** (1 / len(rows)) if rows and not collisions else None,
        "stops": dict(Counter(row.stop for row in rows if row.stop)),
        "false_stops_by_speed": {name: _share([row for row in rows if row.decade == name]) for name in DECADES},
        "false_stops_by_length": {
            name: _share([row for row in rows if row.length == name]) for name in (*LENGTHS, MIXED)
        },
        "motions": motions,
        "motions_of_at_most_a_cycle": sum(row.short for row in rows) / motions if motions else None,
    }


def _share(rows: Sequence[RunRow]) -> float | None:
    return sum(row.false_stop for row in rows) / len(rows) if rows else None


_COUNTS: dict[str, Callable[[RunRow], bool]] = {
    "twins collided": lambda row: bool(row.twin_contact),
    "collisions": lambda row: row.collided,
    "stopped by the guard": lambda row: row.stop == "guard",
    "refused": lambda row: row.stop == "refused",
    "held": lambda row: row.stop == "held",
    "false": lambda row: row.false_stop,
    "by age": lambda row: row.stop == "age",
    "slowed": lambda row: row.slowed,
}


def tables(rows: Sequence[RunRow]) -> Iterator[str]:
    """Markdown tables of a campaign."""
    by: dict[str, Callable[[RunRow], str]] = {
        "speed": lambda row: row.decade,
        "length": lambda row: row.length,
        "motions": lambda row: row.kind,
        "start": lambda row: "near a body" if row.near else "anywhere",
        "fault": lambda row: row.fault,
        "beside": lambda row: row.rival or "nothing",
        "sessions": lambda row: "renewed" if row.sessions else "one",
        "cell": lambda row: row.cell,
        "part": lambda row: row.part,
        "sends jogs": lambda row: "no" if row.silent else "yes",
        "protocol": lambda row: str(row.version),
    }
    for name, key in by.items():
        yield from _table({name: key}, rows)
    yield from _table({"collision in a": lambda row: row.contact_kind}, [row for row in rows if row.collided])


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
    """Decades, lengths, kinds and faults in their own order, other names in that of the alphabet."""
    known = [*DECADES, *LENGTHS, *Kind, MIXED, *FAULTS]
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
        Seed of all runs.
    """

    cell: str | None
    part: str
    unit: str = "mm"
    seed: int = 1


def campaign_of(
    options: CampaignOptions, folder: Path | None = None, simulation: Callable[..., Simulation] = Simulation
) -> Campaign:
    """The campaign, in this process; its files lie in `folder`, or where the system keeps temporary files.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.
    """
    given = load_part(options.part, options.unit)
    parts = {Path(options.part).stem: given, **standing_parts()}
    return Campaign(described_cells(options.cell), parts, options.seed, folder, simulation)


_kept = cache(campaign_of)  # a worker process keeps its cell


def _run(options: CampaignOptions, folder: Path, numbers: Sequence[int]) -> list[RunRow]:
    campaign = _kept(options, folder)
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
