"""Rows of a benchmark, on screen and as JSON, and tables in pages of the documentation."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from .timing import Timing

Wanted = Literal["at least", "at most", ""]


@dataclass(frozen=True)
class Row:
    """One measured value beside what it is held against, both of the same run.

    Attributes
    ----------
    clock
        ``wall`` or ``processor``: by which time value and verdict are taken.
    other
        The value by the other clock, where it was taken.
    spread
        How far the median of the repeats lies from the best, relative to the best; None for a single run.
    wanted
        Which side of `limit` the ratio of value to peer should be on; empty when the row only informs.
    """

    name: str
    value: float
    unit: str
    peer: str
    peer_value: float
    spread: float | None = None
    wanted: Wanted = ""
    limit: float = 1.0
    clock: Literal["wall", "processor"] = "wall"
    other: float | None = None

    @property
    def ratio(self) -> float:
        """Value over peer."""
        return self.value / self.peer_value

    @property
    def verdict(self) -> str:
        """``ok`` or ``missed`` where something is wanted of the ratio."""
        if not self.wanted:
            return ""
        met = self.ratio >= self.limit if self.wanted == "at least" else self.ratio <= self.limit
        return "ok" if met else "missed"

    @property
    def wish(self) -> str:
        """The wanted ratio in words."""
        return f"{'>=' if self.wanted == 'at least' else '<='} {self.limit:g}" if self.wanted else ""


def processor_row(
    name: str, timing: Timing, unit: str, peer: str, peer_value: float, wanted: Wanted = "", limit: float = 1.0
) -> Row:
    """A time whose verdict is by processor time, with the wall time beside it."""
    return Row(name, timing.processor, unit, peer, peer_value, timing.spread, wanted, limit, "processor", timing.best)


def cpu_model() -> str:
    """Name of the processor as the kernel tells it, with the number of cores in use."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    names = [line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {len(os.sched_getaffinity(0))} cores"


def print_header() -> None:
    """Print what the columns are, and on what machine."""
    print(f"CPU: {cpu_model()}; load at start {os.getloadavg()[0]:.1f}")
    print("value: best of the repeats; spread: how much worse their median was")
    print("clock: wall time, or processor time of all threads together, which other processes hardly touch;")
    print("other: the value by the other of these clocks")
    left = f"{'name':<46}{'clock':<10}{'value':>10} {'unit':<12}{'other':>10}{'spread':>7}"
    print(f"{left}  {'peer':<42}{'peer value':>10}{'ratio':>9}  {'wanted':<9}")


def print_row(row: Row) -> None:
    """Print one row of the table."""
    spread = "" if row.spread is None else f"{100 * row.spread:.0f} %"
    other = "" if row.other is None else f"{row.other:.4g}"
    left = f"{row.name:<46}{row.clock:<10}{row.value:>10.4g} {row.unit:<12}{other:>10}{spread:>7}"
    print(f"{left}  {row.peer:<42}{row.peer_value:>10.4g}{row.ratio:>9.3g}  {row.wish:<9}{row.verdict}", flush=True)


def write_json(rows: list[Row], path: Path) -> None:
    """Write all rows to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "cpu": cpu_model(),
        "rows": [{**asdict(row), "ratio": row.ratio, "verdict": row.verdict} for row in rows],
    }
    path.write_text(json.dumps(content, indent=1) + "\n")


def replace_paragraphs(page: Path, replaced: Mapping[str, Iterable[str]]) -> None:
    """Replace tables, lists and paragraphs of a Markdown page; the text around them is written by hand.

    `replaced` holds the new lines by the beginning of the old paragraph, which one paragraph of the page has.
    """
    paragraphs = page.read_text(encoding="utf-8").rstrip("\n").split("\n\n")
    for beginning, lines in replaced.items():
        (number,) = (k for k, paragraph in enumerate(paragraphs) if paragraph.startswith(beginning))
        paragraphs[number] = "\n".join(lines)
    page.write_text("\n\n".join(paragraphs) + "\n", encoding="utf-8")
