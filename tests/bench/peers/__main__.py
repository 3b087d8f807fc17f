"""`python -m bench.peers` (in tests/): every figure that another program can check, PASS or FAIL, and the exit code."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator

from .check import Check, PeerMissingError
from .geometry import eaik_checks, open3d_checks
from .importers import importer_checks
from .radiance import mitsuba_checks
from .stripes import povray_checks

PEERS: dict[str, Callable[[], Iterator[Check]]] = {
    "povray": povray_checks,
    "mitsuba": mitsuba_checks,
    "open3d": open3d_checks,
    "eaik": eaik_checks,
    "importers": importer_checks,
}


def main() -> int:
    """Run the peers that are installed; 1 when a check fails."""
    parser = argparse.ArgumentParser(prog="python -m bench.peers", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(PEERS), help="this peer only; may be repeated")
    options = parser.parse_args()
    done: list[Check] = []
    for name, checks in PEERS.items():
        if options.only and name not in options.only:
            continue
        print(name, flush=True)
        try:
            for check in checks():
                print(check, flush=True)
                done.append(check)
        except PeerMissingError as missing:
            print(f"  skipped: {missing}")
    failed = sum(not check.passed for check in done)
    if not done:
        print("nothing was checked: no peer is installed")
        return 0
    print(f"{len(done) - failed} of {len(done)} checks passed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
