"""Rows of a campaign in a file, and what they say."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from scancell.errors import DescriptionError
from scancell.studies.guard.campaign import RunRow
from scancell.studies.guard.twins import THIRDS

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
        lines = [",".join(field.name for field in fields(RunRow)), *(_line(row) for row in self.rows)]
        path.write_text("\n".join(lines) + "\n")

    def _read(self) -> Iterator[RunRow]:
        text = self._path.read_text()
        reader = csv.DictReader(text[: text.rfind("\n") + 1].splitlines())
        names = [field.name for field in fields(RunRow)]
        if reader.fieldnames != names:
            raise DescriptionError(f"{self._path}: columns {reader.fieldnames}: expected {names}")
        for read in reader:
            yield RunRow(**{field.name: _READ[str(field.type)](read[field.name]) for field in fields(RunRow)})

    def append(self, row: RunRow) -> None:
        """Add a row."""
        self.rows.append(row)
        with self._path.open("a") as stream:
            stream.write(_line(row) + "\n")


def _line(row: RunRow) -> str:
    return ",".join(str(value) for value in asdict(row).values())


def summary(rows: Sequence[RunRow]) -> dict[str, Any]:
    """Figures of a campaign."""
    collisions = [row for row in rows if row.contact or row.touched]
    stops = Counter(row.stop for row in rows if row.stop)
    done = [row for row in rows if np.isfinite(row.arrived_at) and np.isfinite(row.twin_arrived_at)]
    loss = [row.arrived_at / row.twin_arrived_at - 1 for row in done]
    return {
        "runs": len(rows),
        "collisions": len(collisions),
        "collisions_of_twins": sum(bool(row.twin_contact) for row in rows),
        "pairs_of_twins": len({row.twin_contact for row in rows if row.twin_contact}),
        # Upper end of the one-sided 95 % interval: that of the rule of three where nothing happened.
        "probability_bound": 1 - 0.05 ** (1 / len(rows)) if rows and not collisions else None,
        "stops": dict(stops),
        "false_stops": {third: _share(rows, third) for third in THIRDS},
        "warnings": sum(row.warnings for row in rows),
        "warnings_while_retreating": sum(row.warned_retreating for row in rows),
        "cycle_time_loss_median": float(np.median(loss)) if loss else None,
        "cycle_time_loss_95": float(np.percentile(loss, 95)) if loss else None,
    }


def _share(rows: Sequence[RunRow], third: str) -> float | None:
    of_third = [row for row in rows if row.third == third]
    return sum(row.false_stop for row in of_third) / len(of_third) if of_third else None


def tables(rows: Sequence[RunRow]) -> Iterator[str]:
    """Markdown tables of a campaign."""
    yield "| third | runs | operation | collisions | stopped by the guard | false | by age | waiting on the path |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
    for third in THIRDS:
        for operation in ("manual", "automatic"):
            own = [row for row in rows if row.third == third and row.operation == operation]
            counts = [
                sum(bool(row.contact) or row.touched for row in own),
                sum(row.stop == "guard" for row in own),
                sum(row.false_stop for row in own),
                sum(row.stop == "age" for row in own),
                sum(row.halted for row in own),
            ]
            yield f"| {third} | {len(own)} | {operation} | " + " | ".join(str(count) for count in counts) + " |"
    yield ""
    yield "| fault | runs | collisions | stopped by the guard | by age |"
    yield "| --- | --- | --- | --- | --- |"
    for fault in dict.fromkeys(row.fault for row in rows):
        own = [row for row in rows if row.fault == fault]
        hits = sum(bool(row.contact) or row.touched for row in own)
        stops = [sum(row.stop == kind for row in own) for kind in ("guard", "age")]
        yield f"| {fault} | {len(own)} | {hits} | {stops[0]} | {stops[1]} |"
    yield ""
    shares = (0, 1, 5, 25, 50, 75)
    yield "| smallest clearance, mm | " + " | ".join(f"{share} %" for share in shares) + " |"
    yield "| --- |" + " --- |" * len(shares)
    for third in THIRDS:
        own = [row for row in rows if row.third == third]
        if own:
            values = 1e3 * np.percentile([row.clearance for row in own], shares)
            yield f"| {third} | " + " | ".join(f"{value:.1f}" for value in values) + " |"
