"""One figure held against another program, and the message when that program is not here."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


class PeerMissingError(Exception):
    """The peer is not installed; the text says how to install it."""


@dataclass(frozen=True)
class Check:
    """A measured figure with the limit it must keep."""

    name: str
    value: float
    unit: str
    limit: float
    at_least: bool = False

    @property
    def passed(self) -> bool:
        """Whether the limit is kept; never for a figure that is not a number."""
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def __str__(self) -> str:
        sign = ">=" if self.at_least else "<="
        verdict = "PASS" if self.passed else "FAIL"
        return f"  {verdict}  {self.name:<66}{self.value:>11.3g} {self.unit:<6} {sign} {self.limit:g}"


def write_table(checks: Iterable[Check], file: Path, title: str, command: str) -> None:
    """Write the figures as a table in Markdown, with the command that made it."""
    rows = [
        f"| {check.name} | {check.value:.3g} {check.unit} | {check.limit:g} | {'yes' if check.passed else 'no'} |"
        for check in checks
    ]
    table = ["| what | measured | at most | kept |", "| --- | --- | --- | --- |", *rows, ""]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join([title, "", f"Written by `{command}`.", "", *table]))
