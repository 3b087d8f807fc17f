"""Programs as JSON for the FMU: a part of the format of saved plans."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from scancell.cell.program import Program

FORMAT = 2


def program_data(program: Program) -> dict[str, Any]:
    """A program as plain data for JSON, SI units, without loss of precision."""
    return {
        "format": FORMAT,
        "settle": program.settle,
        "segments": [
            {
                "id": segment.id,
                "name": segment.name,
                "trigger": {"kind": segment.trigger.kind, "interval": segment.trigger.interval},
                "trigger_from": segment.trigger_from,
                "trigger_to": segment.trigger_to,
                "belt": None if segment.belt is None else asdict(segment.belt),
                "time": segment.times.tolist(),
                "q": segment.axes[:, :-1].tolist(),
                "table": segment.axes[:, -1].tolist(),
            }
            for segment in program.segments
        ],
    }


@contextmanager
def temporary_program_file(program: Program, folder: Path) -> Iterator[Path]:
    """A new file in `folder` with a program, removed at the end."""
    handle, name = tempfile.mkstemp(prefix="program-", suffix=".json", dir=folder)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(json.dumps(program_data(program)))  # faster than json.dump
        yield Path(name).absolute()
    finally:
        Path(name).unlink(missing_ok=True)
