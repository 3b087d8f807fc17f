"""The whole line: the scan that `make scan` makes, station by station."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from scancell import Scanner
from scancell.config.loading import assets_dir

from .table import Row

LIMIT_S = 60.0


def line_rows() -> Iterator[Row]:
    """Seconds of the default scan, and the share of each station in it. Long enough to be run once."""
    part = assets_dir() / "parts" / "free_form.stl"
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as folder, Scanner() as scanner:
        start, start_processor = time.perf_counter(), time.process_time()
        result = scanner.scan(part)
        result.save(Path(folder) / "scan", command_line=["bench"])
        whole, processor = time.perf_counter() - start, time.process_time() - start_processor
    profiles = len(result.recording)
    yield Row(
        f"default scan, {profiles} profiles", whole, "s", "limit on 2 cores", LIMIT_S, None, "at most", other=processor
    )
    for station, seconds in result.timings.items():
        yield Row(f"default scan: {station}", seconds, "s", "whole scan", whole)
