"""Writes the table of the FMU's quality: ``PYTHONPATH=.:tests python -m bench.peers.importers_quality FUZZER FILE``.

FUZZER is the program ``robotcell-fuzz`` of a build with tests.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

from .check import Check, write_table
from .importers import importer_checks, run_tool

_CELLS = Path(__file__).parents[2] / "fmu/cells"


def fuzzer_checks(fuzzer: Path, calls: int, cycles: int) -> Iterator[Check]:
    """Growth of memory (MB) over random calls, and over instances one after the other."""
    both = [_CELLS / "clamped", _CELLS / "free"]
    for what, count, cells in (("calls", calls, both), ("cycles", cycles, both[:1]), ("cycles", cycles, both[1:])):
        said = run_tool([fuzzer, what, str(count), "1", *cells])
        found = re.search(r"growth_mb (\S+)", said)
        if found is None:
            raise RuntimeError(said)
        names = " and ".join(cell.name for cell in cells)
        named = {"calls": "random calls, no crash", "cycles": "instances come and go"}[what]
        yield Check(f"{count} {named} ({names} part): growth", float(found[1]), "MB", 1.0)


def main() -> None:
    """Run all checks and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("fuzzer", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("--calls", type=int, default=1_000_000)
    parser.add_argument("--cycles", type=int, default=10_000)
    options = parser.parse_args()
    checks = [*importer_checks(), *fuzzer_checks(options.fuzzer, options.calls, options.cycles)]
    write_table(checks, options.file, "# Quality of the FMU", "python -m bench.peers.importers_quality")


if __name__ == "__main__":
    main()
