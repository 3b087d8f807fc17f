"""Writes the table of the FMU's quality: ``PYTHONPATH=.:tests python -m bench.peers.importers_quality FUZZER FILE``.

FUZZER is the program ``robotcell-fuzz`` of a build with tests.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from .check import Check, write_table
from .importers import importer_checks, run_tool

_CELLS = Path(__file__).parents[2] / "fmu/cells"
# Share of the cycles that a cell comes and goes: a soft part takes a third of a second to settle.
_SHARES = {"clamped": 1.0, "free": 1.0, "dynamic": 1.0, "soft": 0.01}


def fuzzer_checks(fuzzer: Path, calls: int, cycles: int) -> Iterator[Check]:
    """Growth of memory (MB) over random calls, and over instances one after the other."""
    cells = {name: _CELLS / name for name in _SHARES}
    yield _growth(
        f"{calls} random calls, no crash (cells {', '.join(cells)})", [fuzzer, "calls", calls, 1, *cells.values()]
    )
    for name, share in _SHARES.items():
        count = round(share * cycles)
        yield _growth(f"{count} instances come and go (cell {name})", [fuzzer, "cycles", count, 1, cells[name]])


def _growth(what: str, command: Sequence[object]) -> Check:
    said = run_tool([str(word) for word in command])
    found = re.search(r"growth_mb (\S+)", said)
    if found is None:
        raise RuntimeError(said)
    return Check(f"{what}: growth", float(found[1]), "MB", 1.0)


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
