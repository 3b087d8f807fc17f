"""Proposed layouts against random ones within the same bounds: time of the scan at equal coverage.

``python -m bench.layouts [--random 200] [--planned 20] [--vary KEY=LOW:HIGH]… [--cell CELL]… PART…`` proposes layouts
for each part and cell, screens random ones, plans the first of these in full, and prints medians, and how well
screening ranks what is planned; a layout that scans less than the proposed one counts as infinitely slow.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

import scancell
from scancell.planning.layout import WORTH, layout_bounds
from scancell.progress import NullProgress


def at_equal_coverage(scanned: list[float], times: list[float], least: float) -> np.ndarray:
    """Times (n,), s, infinite for layouts that scan less than `least`, but for `WORTH`."""
    return np.where(np.array(scanned) >= least - WORTH, times, np.inf)


def compare(part: Path, cell: str | None, options: argparse.Namespace) -> None:
    """Print figures of the proposed layouts of a part in a cell, of the present one, and of random ones."""
    scanner = scancell.Scanner(cell=cell, settings={"scan.coverage.share": options.share})
    name = f"{scanner.setup.cell.robot.name:12} {part.stem:12}"

    def say(text: str) -> None:
        print(f"{name} {text}", flush=True)

    start, wall = time.process_time(), time.perf_counter()
    planner = scanner._layout_planner([scanner.load_part(part)], NullProgress())
    say(f"views: {time.process_time() - start:.0f} s of the processor")
    bounds = layout_bounds(scanner.setup.cell, options.vary or ())
    found = planner.propose(bounds, options.samples, options.plans, 0)
    took = time.process_time() - start, time.perf_counter() - wall
    say(f"answer after {took[0]:.0f} s of the processor, {took[1]:.0f} s on the clock; refused {found.refused}")
    for layout in found.ranked:
        estimate = planner.screen(layout.values)
        say(f"{layout.name} {100 * layout.scanned:.1f} % in {layout.time:.2f} s, screening {estimate.time:.2f} s")
    best = found.chosen[0]

    low, high = np.array([*bounds.values()]).T
    draws = np.random.default_rng(1).uniform(low, high, (options.random, len(low)))
    random = [dict(zip(bounds, row, strict=True)) for row in draws.tolist()]
    start, estimate = time.process_time(), planner.screen(best.values)
    screened = [planner.screen(at) for at in random]
    each = (time.process_time() - start) / (1 + len(random))
    times = at_equal_coverage([one.scanned for one in screened], [one.time for one in screened], estimate.scanned)
    say(f"screening, {each:.2f} s each: proposed {estimate.time:.2f} s, {figures(times, estimate.time)}")

    layouts = []
    for at, one in zip(random[: options.planned], screened, strict=False):
        layouts.append(planner.planned("random", at))
        made = layouts[-1]
        say(
            f"random: screening {100 * one.scanned:.1f} % in {one.time:.2f} s, plan {100 * made.scanned:.1f} % in"
            f" {made.time:.2f} s {made.problem}"
        )
    times = at_equal_coverage([one.scanned for one in layouts], [one.time for one in layouts], best.scanned)
    estimates = np.array([one.time for one in screened[: len(layouts)]])
    both = np.isfinite(times) & np.isfinite(estimates)
    rank = spearmanr(estimates[both], times[both]).statistic if both.sum() > 2 else np.nan
    say(f"planned: {figures(times, best.time)}; rank correlation with screening {rank:.2f} ({both.sum()} layouts)")


def figures(times: np.ndarray, best: float) -> str:
    """Number and medians of times (n,), s, of which those of less coverage are infinite, and share above `best`."""
    equal = times[np.isfinite(times)]
    shown = f"{np.median(equal):.2f} s" if len(equal) else "none"
    return (
        f"{len(equal)} of {len(times)} random ones scan as much, median {np.median(times):.2f} s, of these {shown};"
        f" proposed is faster than {100 * (times > best).mean():.1f} %"
    )


def main() -> None:
    """Compare for all cells and parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="+", type=Path)
    parser.add_argument("--cell", action="append")
    parser.add_argument("--vary", action="append")
    parser.add_argument("--share", type=float, default=0.9)
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--plans", type=int, default=3)
    parser.add_argument("--random", type=int, default=200)
    parser.add_argument("--planned", type=int, default=20)
    options = parser.parse_args()
    for cell in options.cell or [None]:
        for part in options.parts:
            compare(part, cell, options)


if __name__ == "__main__":
    main()
