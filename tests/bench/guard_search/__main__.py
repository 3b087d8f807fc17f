"""Steers a person who jogs, and the network, to the worst moment: ``python -m bench.guard_search PART``.

The cell is at the limits of what its guard assumes (docs/guard_campaign.md). The status is 1 if a guard without an
error lets the robot collide. PYTHONPATH=tests.
"""

from __future__ import annotations

import argparse
import sys

from bench.guard_search.outcomes import search, search_all, search_table
from scancell.studies.guard.run import CampaignOptions


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.guard_search", description=__doc__)
    parser.add_argument("part", help="mesh of the part on the table")
    parser.add_argument("--cell", help="cell description (TOML)")
    parser.add_argument("--unit", default="mm")
    parser.add_argument("--seed", type=int, default=1, help="of all runs")
    parser.add_argument("--runs", type=int, default=500, help="largest number of guarded runs of a search")
    parser.add_argument("--error", default="", help="deliberate error of the guard; all: each; table-jogs: none")
    parser.add_argument("--workers", type=int, default=0, help="0: one per core")
    chosen = parser.parse_args()
    options = CampaignOptions(chosen.cell, chosen.part, chosen.unit, chosen.seed)
    every = chosen.error == "all"
    found = search_all(options, chosen.runs, chosen.workers) if every else [search(options, chosen.runs, chosen.error)]
    made = list(found)
    print("\n".join(search_table(made)))
    return int(any(outcome.contact for outcome in made if not outcome.error))


if __name__ == "__main__":
    sys.exit(main())
