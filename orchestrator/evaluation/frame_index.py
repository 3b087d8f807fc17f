"""Which files of a folder are camera images of which exposure: a table beside them, written with them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal

from orchestrator.errors import ImageError

INDEX = "frames.csv"
Laser = Literal["on", "off"]
_LASER: dict[str, Laser] = {"on": "on", "off": "off"}


@dataclass(frozen=True)
class Frame:
    """One image: its exposure, its camera, whether the laser was on, and its file in the folder of the index."""

    exposure: str
    camera: str
    laser: Laser
    file: str


def write_index(frames: Sequence[Frame], path: Path) -> None:
    """Write the table (CSV)."""
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [column.name for column in fields(Frame)])
        writer.writeheader()
        writer.writerows(asdict(frame) for frame in frames)


def read_index(path: Path) -> list[Frame]:
    """Read what `write_index` wrote.

    Raises
    ------
    ImageError
        If it cannot be read, naming file, line and value.
    """
    columns = [column.name for column in fields(Frame)]
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ImageError(f"{path}: cannot be read: {error}") from None
    frames = []
    for line, row in enumerate(rows, start=2):
        missing = [name for name in columns if not row.get(name)]
        if missing:
            raise ImageError(f"{path}: line {line}: has no {missing[0]}; expected the columns {', '.join(columns)}")
        laser = _LASER.get(row["laser"])
        if laser is None:
            raise ImageError(f"{path}: line {line}: laser = {row['laser']!r}: expected on or off")
        frames.append(Frame(row["exposure"], row["camera"], laser, row["file"]))
    return frames
