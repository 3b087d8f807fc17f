"""What decides the results in a folder, kept beside them, so that nobody goes on with another question there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orchestrator.errors import DescriptionError
from orchestrator.evaluation.manifest import versions
from orchestrator.files import atomic_write

DESCRIPTION = "description.json"


def write_record(spec: Mapping[str, Any], out: Path) -> None:
    """Keep `spec`, and the versions of what will answer it, in the folder `out`.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    with atomic_write(out / DESCRIPTION) as temporary:
        temporary.write_text(json.dumps({"versions": versions(), **spec}, indent=1) + "\n")


def difference_from_record(spec: Mapping[str, Any], out: Path) -> str:
    """The first key of `spec` that the results in `out` were made without, for people; empty if there is none.

    Raises
    ------
    FileNotFoundError
        If nothing was begun in `out`.
    DescriptionError
        If the record there cannot be read.
    """
    record = out / DESCRIPTION
    try:
        before = json.loads(record.read_text())
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise DescriptionError(f"{record}: cannot be read: {error}") from None
    return _difference(before, json.loads(json.dumps(spec)))


def _difference(before: Any, now: Any, path: str = "") -> str:
    """The first place where two descriptions differ, for people."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in now:
            found = _difference(before.get(key), now[key], f"{path}.{key}".lstrip("."))
            if found:
                return found
        return ""
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        pairs = enumerate(zip(before, now, strict=True), 1)
        return next(filter(None, (_difference(a, b, f"{path}[{i}]") for i, (a, b) in pairs)), "")
    return "" if before == now else f"{path} was {before!r}, is {now!r}"
