"""The paper's statements beside what scancell does: ``PYTHONPATH=tests python -m bench.paper [--page docs/paper.md]``.

Prints the table of ``docs/paper.md``, or writes it there between the two marks.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scancell.config.loading import load_setup

from . import scan_modes
from .guard_speed import answer_times
from .proximity_speed import proximity_rows
from .sensor_speed import geometric_rows
from .table import Row, cpu_model
from .workspace_speed import workspace_rows

BEGIN, END = "<!-- comparison: begin -->", "<!-- comparison: end -->"
_LAST_OF_WORKSPACE = "geometric cameras: processor"
_LATENCY = "2 ms"  # case of `scan_modes`
_SPEED = 25.0  # mm/s
_ANSWERS = 600


def collision_lines() -> Iterator[str]:
    """Whole scene of 12 bodies and 48 pairs, one unrelated pose after the other on one thread."""
    found = {row.name: row.value / 1e3 for row in proximity_rows()}
    distances, collisions = (found[f"proximity: {name}, cold"] for name in ("distances below 50 mm", "collisions"))
    yield (
        f"| collision query of the whole scene | below 10 ms | {collisions:.3f} ms; distances of all pairs up to 50 mm "
        f"{distances:.2f} ms | 12 bodies of 5200 triangles, 48 pairs, unrelated poses, processor time of one thread |"
    )


def workspace_lines() -> Iterator[str]:
    """Updates of the workspace and cycles of its cell, with both engines."""
    found: dict[str, float] = {}
    rows = workspace_rows()
    for row in rows:
        found[row.name] = row.value
        if row.name == _LAST_OF_WORKSPACE:
            break
    rows.close()  # type: ignore[attr-defined]
    updates, cycles = (
        [found[f"{engine} cameras: {what}"] for engine in ("geometric", "ray-traced")]
        for what in ("updates received", "cycles of the cell")
    )
    pairs = found["ray-traced cameras: pairs of images received"]
    yield (
        f"| the whole simulation | 30 frames/s | {updates[0]:.1f} updates/s with geometric sensing, "
        f"{updates[1]:.1f} with ray-traced images; {pairs:.1f} pairs of images/s | a client of "
        "the workspace in another process, wall time |"
    )
    cycle_ms = 1e-3 * load_setup().cell.world.controller_cycle_us
    yield (
        f"| controller cycle | 16 ms | {cycle_ms:g} ms; {cycles[0]:.1f} and {cycles[1]:.1f} cycles/s "
        f"(real time: {1e3 / cycle_ms:.1f}) | the same two runs |"
    )


def guard_lines() -> Iterator[str]:
    """Time of the guard's answer to a state."""
    times = np.concatenate(list(answer_times("six_axis", _ANSWERS, 1).values()))
    median, last = np.percentile(times, [50, 99.9])
    yield (
        f"| poll of the guard | 32 ms | answers take {median:.2f} ms in the median and {last:.1f} ms at 99.9 %; "
        f"`GuardedCell` polls in every cycle | {len(times)} answers near obstacles, by hand and automatic, processor "
        "time of one thread |"
    )


def sensing_lines() -> Iterator[str]:
    """Geometric against ray-traced profiles."""
    row: Row = list(geometric_rows())[-1]
    yield (
        f"| geometric sensing | two orders of magnitude faster than ray tracing | {row.ratio:.0f} times "
        f"({row.value:.0f} profiles/s against {row.peer_value:.0f} pairs of images/s) | part of "
        "70,000 triangles, 1024 rays, processor time of two threads |"
    )


def mode_lines() -> Iterator[str]:
    """Stop-and-look against dynamic with a latency, before and after its calibration."""
    found = scan_modes.calibrations("geometric", {_LATENCY: scan_modes.CASES[_LATENCY]})
    still, moving = (
        dict(scan_modes.scans(mode, _SPEED, found, "geometric"))[_LATENCY] for mode in ("stop-and-look", "dynamic")
    )
    yield (
        f"| stop-and-look scan | slower and more accurate than a dynamic one | {still.duration:.0f} s and "
        f"{still.rms:.2f} µm RMS; dynamic {moving.duration:.0f} s and {moving.rms:.2f} µm, with calibrated latency "
        f"{moving.calibrated_rms:.2f} µm | 400 profiles, {_SPEED:g} mm/s, trigger latency of "
        f"{_LATENCY}; simulated time |"
    )


def lines() -> Iterator[str]:
    """The table, as Markdown."""
    load = os.getloadavg()[0]
    yield f"CPU: {cpu_model()}; load at the start {load:.1f}, mostly by other work."
    yield ""
    yield "| subject | paper | scancell | measured with |"
    yield "|---|---|---|---|"
    for part in (collision_lines, workspace_lines, guard_lines, sensing_lines, mode_lines):
        yield from part()


def between_marks(text: str, table: str) -> str:
    """A page whose table is `table`."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{rest.split(END)[1]}"


def main() -> None:
    """Print or write."""
    parser = argparse.ArgumentParser(prog="python -m bench.paper", description=__doc__)
    parser.add_argument("--page", type=Path, help="page in which the table is replaced")
    page = parser.parse_args().page
    table = []
    for line in lines():
        print(line, flush=True)
        table.append(line)
    if page:
        page.write_text(between_marks(page.read_text(encoding="utf-8"), "\n".join(table)), encoding="utf-8")


if __name__ == "__main__":
    main()
