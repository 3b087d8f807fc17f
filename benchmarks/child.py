"""Runs a Python entry in a process of its own: ``python -m benchmarks.child FILE TRACK INPUTS RESULTS CASE...``.

Writes ``CASE.csv``, or ``CASE.error`` with the reason, for one case after the other.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.files import STARTED, read_case, write_table, write_text
from benchmarks.track import ResultError, table_of
from benchmarks.tracks import track_named


def load(file: Path, name: str) -> Callable[[dict[str, Any]], Any]:
    """The function `name` of a Python file."""
    spec = importlib.util.spec_from_file_location("benchmark_entry", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file}: expected a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # data classes look it up
    spec.loader.exec_module(module)
    function = getattr(module, name, None)
    if not callable(function):
        raise AttributeError(f"{file} has no function {name}")
    return function


def main(file: str, name: str, inputs: str, results: str, *cases: str) -> None:
    """Run the cases."""
    track = track_named(name)
    write_text(Path(results) / STARTED, "")
    function, failed = None, ""
    try:
        function = load(Path(file), name)
    except BaseException as error:
        failed = f"{type(error).__name__}: {error}"
    for case in cases:
        reason = failed
        if function is not None:
            try:
                table = table_of(track, function(read_case(Path(inputs) / case)))
                write_table(Path(results) / f"{case}.csv", table)
                continue
            except ResultError as error:
                reason = str(error)
            except BaseException as error:
                reason = f"{type(error).__name__}: {error}"
        write_text(Path(results) / f"{case}.error", " ".join(reason.split())[:300])


if __name__ == "__main__":
    main(*sys.argv[1:])
