"""Peak memory of the workspace while a part is scanned repeatedly: ``python -m bench.workspace_memory``.

PYTHONPATH=tests. It is the default scan by the geometric engine, evaluated; each one replaces the one before. A client
in another process receives everything. The figure is the peak resident memory of the process of the workspace.
"""

from __future__ import annotations

import argparse
import resource
import time

from scancell import Scanner

from .workspace_speed import opened


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.workspace_memory", description=__doc__)
    parser.add_argument("--points", type=float, default=5e6, help="to scan in all")
    parser.add_argument("--save", action="store_true", help="save the run folder of each scan")
    options = parser.parse_args()
    with Scanner() as scanner, opened(scanner, "geometric") as (workspace, _):
        scans, points = workspace.scans, 0
        _report("opened", points)
        while points < options.points:
            scans.start("geometric")
            while (state := scans.state) is None or state.stage not in ("done", "failed"):
                time.sleep(0.1)
            while workspace.live.state.job is not None or not scans.figures:
                time.sleep(0.1)
            points += state.points
            _report("scanned", points)
            if options.save:
                scans.save()
                _report("saved", points)


def _report(what: str, points: int) -> None:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{what:>8}: {points / 1e6:5.2f} million points, peak {peak:4.0f} MB", flush=True)


if __name__ == "__main__":
    main()
