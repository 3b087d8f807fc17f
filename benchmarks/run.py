"""Runs and scores entries: a Python file, each case within a time limit, or a folder of results."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.files import STARTED, read_table, write_text
from benchmarks.track import Case, Outcome, ResultError, Table, Track, table_of

ROOT = Path(__file__).resolve().parents[1]
_POLL = 0.01  # s
_START = 120.0  # s, for the interpreter to start


@dataclass(frozen=True)
class Standing:
    """An entry with its figures, and why cases failed."""

    entry: str
    figures: dict[str, float]
    failures: dict[str, str]


def run_python(file: Path, track: Track, inputs: Path, results: Path, names: Sequence[str], limit: float) -> None:
    """Run a Python entry on cases in `inputs`; of each there is then ``CASE.csv`` or ``CASE.error`` in `results`."""
    waiting = list(names)
    results.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    while waiting:
        (results / STARTED).unlink(missing_ok=True)
        command = [sys.executable, "-m", "benchmarks.child", file, track.name, inputs, results, *waiting]
        process = subprocess.Popen(
            [str(word) for word in command],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            _follow(process, results, waiting, limit)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _follow(process: subprocess.Popen[bytes], results: Path, waiting: list[str], limit: float) -> None:
    """Wait until all cases are done, or one takes too long or ends the process; done ones leave `waiting`."""
    end = time.monotonic() + _START
    is_running = False
    while waiting:
        if not is_running and (results / STARTED).exists():
            is_running, end = True, time.monotonic() + limit
        code = process.poll()  # before the look at the files: it may have ended after writing the last one
        if any((results / f"{waiting[0]}{suffix}").exists() for suffix in (".csv", ".error")):
            waiting.pop(0)
            end = time.monotonic() + limit
        elif code is not None or time.monotonic() > end:
            reason = f"took more than {limit:g} s" if code is None else f"the process ended with code {code}"
            write_text(results / f"{waiting.pop(0)}.error", reason)
            return
        else:
            time.sleep(_POLL)


def read_results(track: Track, cases: Sequence[Case], folder: Path) -> tuple[list[Outcome], dict[str, str]]:
    """Results of the cases, and the reasons why some have none."""
    outcomes: list[Outcome] = []
    failures: dict[str, str] = {}
    for case in cases:
        table: Table | None = None
        error, result = folder / f"{case.name}.error", folder / f"{case.name}.csv"
        if error.exists():
            failures[case.name] = error.read_text(encoding="utf-8")
        elif not result.is_file():
            failures[case.name] = f"no file {result.name}"
        else:
            try:
                table = table_of(track, read_table(result))
                track.check(case, table)
            except ResultError as reason:
                table, failures[case.name] = None, str(reason)
        outcomes.append((case, table))
    return outcomes, failures


def standing(entry: Path, track: Track, cases: Sequence[Case], inputs: Path, work: Path, limit: float) -> Standing:
    """Run an entry, if it is a Python file, with results in `work`, and score it."""
    folder = entry
    if not entry.is_dir():
        folder = work
        run_python(entry, track, inputs, folder, [case.name for case in cases], limit)
    elif (entry / track.name).is_dir():
        folder = entry / track.name
    outcomes, failures = read_results(track, cases, folder)
    return Standing(entry.stem, track.summary(outcomes), failures)


def ranked(standings: Sequence[Standing]) -> list[Standing]:
    """Best first, by the first figure; entries without one last."""

    def key(one: Standing) -> float:
        first = next(iter(one.figures.values()))
        return first if np.isfinite(first) else np.inf

    return sorted(standings, key=key)


def markdown(standings: Sequence[Standing], number: int) -> list[str]:
    """The table, and below it why cases failed."""
    heads = ["entry", *standings[0].figures, "failed"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for one in standings:
        figures = ["-" if np.isnan(value) else f"{value:.4g}" for value in one.figures.values()]
        lines.append(f"| {' | '.join([one.entry, *figures, f'{len(one.failures)} of {number}'])} |")
    for one in standings:
        for reason in sorted(set(one.failures.values())):
            names = [name for name, why in one.failures.items() if why == reason]
            more = f" and {len(names) - 1} more" if len(names) > 1 else ""
            lines += ["", f"{one.entry}, {names[0]}{more}: {reason}"]
    return lines
