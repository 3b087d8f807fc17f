"""Cases and results as files: images as PNG, tables as CSV, all other inputs in ``case.json``."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.track import Case, ResultError, Table

STARTED = "started"  # file that the process of an entry writes before it loads it
_MOST_BYTES = 100_000_000


def write_text(path: Path, text: str) -> None:
    """A file that is complete or absent."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.part")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(path)


def write_table(path: Path, table: Mapping[str, Any]) -> None:
    """A CSV file; numbers keep every digit."""
    lines = [",".join(table)]
    columns = [[str(v) if isinstance(v, str) else repr(float(v)) for v in values] for values in table.values()]
    lines += [",".join(row) for row in zip(*columns, strict=True)]
    write_text(path, "\n".join(lines) + "\n")


def read_table(path: Path) -> Table:
    """Columns of a CSV file; those named ``name`` are text, all others numbers. Raises `ResultError`."""
    if path.stat().st_size > _MOST_BYTES:
        raise ResultError(f"{path}: larger than {_MOST_BYTES} bytes")
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            head, *rows = [row for row in csv.reader(stream) if row]
        columns = list(zip(*rows, strict=True)) if rows else [()] * len(head)
        pairs = zip((name.strip() for name in head), columns, strict=True)
        return {name: np.array(values, str if name == "name" else float) for name, values in pairs}
    except (ValueError, csv.Error) as error:
        raise ResultError(f"{path}: {error}") from None


def write_case(folder: Path, case: Case) -> None:
    """The inputs of a case: ``KEY/0000.png`` of images, ``KEY.csv`` of tables, ``case.json`` of the rest."""
    folder.mkdir(parents=True, exist_ok=True)
    values = {}
    for key, value in case.inputs.items():
        if isinstance(value, np.ndarray):
            (folder / key).mkdir(exist_ok=True)
            for number, image in enumerate(value):
                file = folder / key / f"{number:04d}.png"
                if not cv2.imwrite(str(file), image):
                    raise OSError(f"{file}: not written")
        elif isinstance(value, Mapping) and all(isinstance(column, np.ndarray) for column in value.values()):
            write_table(folder / f"{key}.csv", value)
        else:
            values[key] = value
    write_text(folder / "case.json", json.dumps(values, indent=1) + "\n")


def read_case(folder: Path) -> dict[str, Any]:
    """The inputs that `write_case` wrote."""
    inputs: dict[str, Any] = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    inputs |= {path.stem: read_table(path) for path in sorted(folder.glob("*.csv"))}
    for images in (path for path in folder.iterdir() if path.is_dir()):
        files = sorted(images.glob("*.png"))
        inputs[images.name] = np.stack([cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files])
    return inputs
