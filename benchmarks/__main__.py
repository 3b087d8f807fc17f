"""``python -m benchmarks TRACK ENTRY...``: run and rank entries of a track of the open benchmark."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.files import write_case
from benchmarks.run import markdown, ranked, standing
from benchmarks.tracks import NAMES, track_named

ENTRIES = Path(__file__).parent / "entries"


def main(arguments: list[str] | None = None) -> None:
    """Export, run, score, print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("track", choices=NAMES)
    parser.add_argument(
        "entry",
        nargs="*",
        help=f"Python file, folder of results, or one of: {', '.join(sorted(p.stem for p in ENTRIES.glob('*.py')))}",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the cases; 1 to 9 are for development")
    parser.add_argument("--cases", type=int, help="number of cases")
    parser.add_argument("--limit", type=float, help="seconds that an entry may take for a case")
    parser.add_argument("--export", type=Path, metavar="FOLDER", help="write the inputs of all cases to files")
    options = parser.parse_args(arguments)
    track = track_named(options.track)
    entries = [_entry(parser, text) for text in options.entry]
    if not entries and options.export is None:
        parser.error("name an entry, or --export FOLDER")
    number = track.default_cases if options.cases is None else options.cases
    limit = track.limit if options.limit is None else options.limit
    if options.seed < 0 or number < 1 or not limit > 0:
        parser.error("--seed: expected at least 0; --cases: at least 1; --limit: more than 0")
    cases = track.cases(options.seed, number)
    with tempfile.TemporaryDirectory(prefix="scancell-benchmark-") as name:
        inputs = Path(name) / "inputs" if options.export is None else options.export / track.name
        for case in cases:
            write_case(inputs / case.name, case)
        if entries:
            found = [
                standing(entry, track, cases, inputs, Path(name) / f"results {number}", limit)
                for number, entry in enumerate(entries)
            ]
            print("\n".join(markdown(ranked(found), len(cases))))


def _entry(parser: argparse.ArgumentParser, text: str) -> Path:
    """The file or folder of an entry; a name alone is one of those that ship."""
    for path in (Path(text), ENTRIES / f"{text}.py"):
        if path.is_dir() or (path.is_file() and path.suffix == ".py"):
            return path.resolve()
    return parser.error(f"{text}: expected a Python file, a folder of results, or the name of an entry in {ENTRIES}")


if __name__ == "__main__":
    main()
