"""What a person asks of a job, and what the job answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
    """What came of it: figures and files, as they also lie in the folder."""

    figures: dict[str, Any]
    files: list[str]
    warnings: list[str]
    timings: dict[str, float]
    lines: list[str]

    def summary(self) -> list[str]:
        """For people."""
        return self.lines
