"""Compares FMUs under Wine with those on Linux: ``PYTHONPATH=.:tests:tests/fmu python -m bench.windows_fmu``.

Prints the tables of docs/fmu/windows.md. Needs the binaries of ``fmu/windows/build``, its MinGW compiler and Wine. With
``--calls`` and ``--cycles`` also random calls and instances in sequence, with the program
``build/windows/objects/fmu/robotcell-fuzz.exe`` (``ninja -C build/windows/objects robotcell-fuzz``).
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from played_calls import (
    SCENARIOS,
    Array,
    Calls,
    Player,
    continued,
    differences,
    make_player,
    missing_for_wine,
    spin_table,
    wine_environment,
)

from scancell.cell.fmu_file import FmiVersion, make_temporary_fmu

_ROOT = Path(__file__).parents[2]
_FUZZER = _ROOT / "build/windows/objects/fmu/robotcell-fuzz.exe"
_CELLS = _ROOT / "tests/fmu/cells"
_VERSIONS: tuple[FmiVersion, ...] = (2, 3)
_REPEATS = 20  # of a scenario's steps, for their cost
_GROWTH_TIMES = (0.25, 0.5, 1.0, 2.0)  # s
_TIPPING_TIMES = (0.8, 1.12, 1.17, 1.2, 1.28, 1.44)  # s
_FASTER = (1e-15, 1e-13, 1e-10)


def table(heads: Sequence[str], rows: Iterator[Sequence[object]]) -> None:
    print("\n| " + " | ".join(heads) + " |\n|" + " --- |" * len(heads), flush=True)
    for row in rows:
        print("| " + " | ".join(map(str, row)) + " |", flush=True)


def outputs(runs: dict[str, dict[int, Calls]], linux: Player, wine: Player) -> Iterator[Sequence[object]]:
    """Largest difference of real outputs up to each of some times, and number of rows where others differ."""
    for name, by_version in runs.items():
        for version, calls in by_version.items():
            (expected, _), (found, _) = linux.play(calls), wine.play(calls)
            apart, others = differences(calls, expected, found)
            until = [apart[expected[:, 0] <= time + 1e-6].max() for time in _GROWTH_TIMES]
            yield name, version, len(expected), *(f"{value:.1e}" for value in until), len(others)


def tipping(folder: Path, linux: Player, wine: Player) -> Iterator[Sequence[object]]:
    """How differences of rounding grow when a part tips over an edge: of the systems, and of Linux alone."""
    fmu = make_temporary_fmu(SCENARIOS["part slides"].cell(), folder / "tipping", 2)

    def played(player: Player, scale: float) -> tuple[Calls, Array]:
        calls = Calls(fmu)
        spin_table(calls, 90, scale)
        return calls, player.play(calls)[0]

    calls, expected = played(linux, 1.0)
    position = [1 + i for i, name in enumerate(calls.names) if name.startswith("truth.part[1].position")]
    for name, player, scale in (
        ("Wine", wine, 1.0),
        *((f"Linux, table faster by {e:.0e}", linux, 1 + e) for e in _FASTER),
    ):
        apart = np.abs(played(player, scale)[1] - expected)[:, position].max(axis=1)
        yield name, *(f"{apart[expected[:, 0] <= time + 1e-6].max():.1e}" for time in _TIPPING_TIMES)


def states(runs: dict[str, dict[int, Calls]], linux: Player, wine: Player) -> Iterator[Sequence[object]]:
    """Largest difference after a state of the other system was restored in the middle."""
    for name, by_version in runs.items():
        for version, calls in by_version.items():
            row = calls.lines.count("row") // 2
            pairs = ((linux, wine), (wine, linux), (wine, wine))
            found = [differences(calls, *continued(calls, *pair, row)) for pair in pairs]
            yield name, version, *(f"{apart.max():.1e}, {len(others)}" for apart, others in found)


def costs(runs: dict[str, dict[int, Calls]], linux: Player, wine: Player) -> Iterator[Sequence[object]]:
    """Processor time of a step, without outputs; the smallest of some runs."""
    for name, by_version in runs.items():
        calls = Calls(by_version[3].folder)
        commands = [line for line in by_version[3].lines[2:] if line != "row"]
        calls.lines += [
            "save state",
            *[line for _ in range(_REPEATS) for line in ("load state", "time 0.0", *commands)],
        ]
        found = []
        for player in (linux, wine, linux, wine):
            said = re.findall(r"steps (\d+) seconds ([0-9.]+)", player.play(calls)[1])
            found.append(1e3 * float(said[-1][1]) / int(said[-1][0]))
        best = np.minimum(found[:2], found[2:])
        yield name, f"{best[0]:.3f}", f"{best[1]:.3f}", f"{best[1] / best[0]:.2f}"


def random_calls(calls: int, cycles: int, folder: Path) -> Iterator[Sequence[object]]:
    """Random calls, and instances in sequence: growth of memory (MB)."""
    cells = [f"Z:{_CELLS / name}" for name in ("clamped", "free", "soft", "dynamic")]
    for command in (["calls", calls, 1, *cells], ["cycles", cycles, 1, cells[0]], ["cycles", cycles, 1, cells[1]]):
        words = ["wine", str(_FUZZER), *map(str, command)]
        done = subprocess.run(words, env=wine_environment(folder), capture_output=True, text=True, check=False)
        yield f"{command[0]} {command[1]}", done.returncode, done.stdout.strip() or done.stderr[-300:]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=0)
    parser.add_argument("--cycles", type=int, default=0)
    options = parser.parse_args()
    missing = missing_for_wine()
    if missing:
        raise SystemExit(missing)
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        if options.calls:
            table(["calls", "exit code", "result"], random_calls(options.calls, options.cycles, root))
            return
        folders = [root / "linux", root / "wine"]
        for folder in folders:
            folder.mkdir()
        linux, wine = make_player(folders[0], wine=False), make_player(folders[1], wine=True)
        runs: dict[str, dict[int, Calls]] = {
            name: {v: scenario.calls(make_temporary_fmu(scenario.cell(), root / f"{name} {v}", v)) for v in _VERSIONS}
            for name, scenario in SCENARIOS.items()
        }
        heads = [f"until {time} s" for time in _GROWTH_TIMES]
        table(["scenario", "FMI", "steps", *heads, "other events"], outputs(runs, linux, wine))
        heads = [f"until {time} s" for time in _TIPPING_TIMES]
        table(["part tips over the edge, m", *heads], tipping(root, linux, wine))
        table(["scenario", "FMI", "Linux to Wine", "Wine to Linux", "Wine to Wine"], states(runs, linux, wine))
        table(["scenario", "Linux, ms", "Wine, ms", "ratio"], costs(runs, linux, wine))


if __name__ == "__main__":
    main()
