"""Tasks for tests of the study engine, importable by worker processes."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path


def open_counter(spec):
    """Task that logs each run to a file shared by all workers, and sleeps, fails or dies if its payload says so."""
    log = Path(spec["log"])

    def perform(payload, folder: Path) -> None:
        with log.open("a") as stream:
            stream.write(f"{payload['n']} {os.getpid()}\n")
        time.sleep(payload.get("sleep", 0.0))
        if payload.get("fail"):
            raise ValueError(f"number {payload['n']} is broken")
        if payload.get("die"):
            os.kill(os.getpid(), 9)
        (folder / "square.json").write_text(json.dumps(payload["n"] ** 2))

    return perform
