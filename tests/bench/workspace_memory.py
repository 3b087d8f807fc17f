"""Peak memory of the workspace while a part is scanned repeatedly: ``python -m bench.workspace_memory``.

PYTHONPATH=tests. It is the default scan by the geometric engine, evaluated; each one replaces the one before. A client
in another process receives everything. The figures are the peak resident memory of the process of the workspace, and
which part of the present one are pages of files, which the system drops where memory is short.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

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
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    present, of_files = (int(status[name].split()[0]) / 1024 for name in ("VmRSS", "RssFile"))
    now = f"now {present:4.0f} MB, of them {of_files:4.0f} MB pages of files"
    print(f"{what:>8}: {points / 1e6:5.2f} million points, peak {peak:4.0f} MB, {now}", flush=True)


if __name__ == "__main__":
    main()
