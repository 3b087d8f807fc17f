"""The whole line: the scan that `make scan` makes, station by station."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from orchestrator.config import load_setup
from orchestrator.config.loading import assets_dir
from orchestrator.evaluation.job import scan_to_folder
from orchestrator.evaluation.request import ScanRequest
from orchestrator.progress import Silent

from .table import Row

LIMIT_S = 60.0


def line_rows() -> Iterator[Row]:
    """Seconds of the default scan, and the share of each station in it. Long enough to be run once."""
    request = ScanRequest(
        part=assets_dir() / "parts" / "free_form.stl",
        unit="mm",
        setup=load_setup(),
        engine="ray-traced",
        as_built=(),
        seed=0,
        images=False,
        threads=0,
        command_line=("bench",),
    )
    with tempfile.TemporaryDirectory(prefix="scancell-bench-") as folder:
        start, start_processor = time.perf_counter(), time.process_time()
        report = scan_to_folder(request, Path(folder) / "scan", Silent())
        whole, processor = time.perf_counter() - start, time.process_time() - start_processor
    profiles = report.figures["profiles"]
    yield Row(
        f"default scan, {profiles} profiles", whole, "s", "limit on 2 cores", LIMIT_S, None, "at most", other=processor
    )
    for station, seconds in report.timings.items():
        yield Row(f"default scan: {station}", seconds, "s", "whole scan", whole)
