"""Rows of a benchmark: on screen and as JSON."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass(frozen=True)
class Row:
    """One measured value beside what it is held against, both of the same run."""

    name: str
    value: float
    unit: str
    peer: str
    peer_value: float

    @property
    def ratio(self) -> float:
        """Value over peer."""
        return self.value / self.peer_value


def cpu_model() -> str:
    """Name of the processor as the kernel tells it, with the number of cores in use."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    names = [line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {len(os.sched_getaffinity(0))} cores"


def report(rows: list[Row], path: Path) -> None:
    """Print the table and write it to `path`."""
    print(f"CPU: {cpu_model()}")
    print(f"{'name':<34}{'value':>12} {'unit':<12}{'peer':<46}{'peer value':>12}{'ratio':>9}")
    for row in rows:
        numbers = f"{row.peer_value:>12.4g}{row.ratio:>9.3g}"
        print(f"{row.name:<34}{row.value:>12.4g} {row.unit:<12}{row.peer:<46}{numbers}")
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"cpu": cpu_model(), "rows": [{**asdict(row), "ratio": row.ratio} for row in rows]}
    path.write_text(json.dumps(content, indent=1) + "\n")
