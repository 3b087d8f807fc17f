"""Proposed layouts against random ones within the same bounds: time of the scan at equal coverage.

``python -m bench.layouts [--random 200] [--planned 10] [--cell CELL]… PART…`` screens random layouts for each part and
cell, plans some of them in full, and prints medians, and how well the estimate ranks what is planned; a layout that
scans less than the proposed one counts as infinitely slow.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

import scancell
from scancell.planning.layout import WORTH, layout_bounds, ranking, sampled
from scancell.progress import NullProgress


def at_equal_coverage(scanned: list[float], times: list[float], least: float) -> np.ndarray:
    """Times (n,), s, infinite for layouts that scan less than `least`, but for `WORTH`."""
    return np.where(np.array(scanned) >= least - WORTH, times, np.inf)


class Case:
    """A part in a cell, with random layouts within the default bounds."""

    def __init__(self, part: Path, cell: str | None, options: argparse.Namespace) -> None:
        self.options = options
        self.scanner = scancell.Scanner(cell=cell, settings={"scan.coverage.share": options.share})
        self.name = f"{self.scanner.setup.cell.robot.name:12} {part.stem:12}"
        self.part = self.scanner.load_part(part)
        self.planner = self.scanner._layout_planner([self.part], NullProgress())
        self.bounds = layout_bounds(self.scanner.setup.cell, ())
        low, high = np.array([*self.bounds.values()]).T
        draws = np.random.default_rng(1).uniform(low, high, (options.random, len(low)))
        self.random = [dict(zip(self.bounds, row, strict=True)) for row in draws.tolist()]

    def say(self, text: str) -> None:
        """Print a line with the name of the case."""
        print(f"{self.name} {text}", flush=True)

    def compare_by_screening(self) -> None:
        """Print the estimates of the layout that screening puts first, and of the random ones."""
        start = time.process_time()
        proposals = [self.planner.screen(at) for at in sampled(self.bounds, self.options.samples, 0)]
        took = time.process_time() - start
        best = proposals[ranking([one.scanned for one in proposals], [one.time for one in proposals])[0]]
        present = self.planner.screen({})
        others = [self.planner.screen(at) for at in self.random]
        times = at_equal_coverage([one.scanned for one in others], [one.time for one in others], best.scanned)
        self.say(
            f"screening of {len(proposals)}: {took:.0f} s of the processor; best {best.time:.1f} s, present"
            f" {present.time:.1f} s; {medians(times)}; best is faster than {100 * (times > best.time).mean():.0f} %"
        )

    def compare_by_planning(self) -> None:
        """Print the proposed layout, the present one, and random ones as they are planned."""
        start, wall = time.process_time(), time.perf_counter()
        found = self.planner.propose(self.bounds, self.options.samples, self.options.plans, 0)
        took = time.process_time() - start, time.perf_counter() - wall
        self.say(f"proposal: {took[0]:.0f} s of the processor, {took[1]:.0f} s on the clock")
        for layout in found.ranked:
            self.say(f"{layout.name} {100 * layout.scanned:.1f} % in {layout.time:.1f} s")
        best = found.chosen[0]
        layouts = [self.planner.planned("random", at) for at in self.random[: self.options.planned]]
        times = at_equal_coverage([one.scanned for one in layouts], [one.time for one in layouts], best.scanned)
        planned = np.isfinite([one.time for one in layouts])
        estimates = [self.planner.screen(at).time for at in self.random[: self.options.planned]]
        rank = spearmanr(np.array(estimates)[planned], np.array([one.time for one in layouts])[planned]).statistic
        self.say(
            f"planned: {planned.sum()} of {len(layouts)} can be; {medians(times)}; proposed is faster than"
            f" {100 * (times > best.time).mean():.0f} %; rank correlation of estimate and plan {rank:.2f}"
        )
        for estimate, one in zip(estimates, layouts, strict=True):
            self.say(f"random: estimate {estimate:.1f} s, {100 * one.scanned:.1f} % in {one.time:.1f} s {one.problem}")


def medians(times: np.ndarray) -> str:
    """Median of all times, and of those that are finite."""
    equal = times[np.isfinite(times)]
    shown = f"{np.median(equal):.1f} s" if len(equal) else "none"
    return f"{len(equal)} of {len(times)} random ones scan as much, median {np.median(times):.1f} s, of these {shown}"


def main() -> None:
    """Compare by screening for all parts and cells, then by planning."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="+", type=Path)
    parser.add_argument("--cell", action="append")
    parser.add_argument("--share", type=float, default=0.9)
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--plans", type=int, default=3)
    parser.add_argument("--random", type=int, default=200)
    parser.add_argument("--planned", type=int, default=20)
    options = parser.parse_args()
    cases = [(part, cell) for cell in options.cell or [None] for part in options.parts]
    for part, cell in cases:
        Case(part, cell, options).compare_by_screening()
    for part, cell in cases:
        Case(part, cell, options).compare_by_planning()


if __name__ == "__main__":
    main()
