"""What a person asks of a job, and what the job answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.config.loading import Setup
from orchestrator.config.scan import Engine


@dataclass(frozen=True)
class ScanRequest:
    """What a person asks for."""

    part: Path
    unit: str
    setup: Setup
    engine: Engine
    as_built: Sequence[str]
    seed: int
    images: bool
    threads: int
    command_line: Sequence[str]
    formats: Sequence[str] = ("ply",)


@dataclass
class ScanReport:
    """What came of it: figures, lines for people, warnings, files, and seconds by station."""

    figures: dict[str, Any]
    lines: list[str]
    warnings: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    timings: dict[str, float] = field(default_factory=dict)
