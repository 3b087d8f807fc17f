"""Index of the camera images in a folder (``frames.csv``): exposure, camera and laser state of each file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal

from scancell.errors import ImageError

INDEX = "frames.csv"
Laser = Literal["on", "off"]
_LASER: dict[str, Laser] = {"on": "on", "off": "off"}


@dataclass(frozen=True)
class ImageEntry:
    """One image: exposure, camera, laser state, and file name relative to the folder of the index."""

    exposure: str
    camera: str
    laser: Laser
    file: str


def write_index(frames: Sequence[ImageEntry], path: Path) -> None:
    """Write the index as CSV."""
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [column.name for column in fields(ImageEntry)])
        writer.writeheader()
        writer.writerows(asdict(frame) for frame in frames)


def read_index(path: Path) -> list[ImageEntry]:
    """Frames of an index written by `write_index`.

    Raises
    ------
    ImageError
        If the file cannot be read or is invalid, naming line and value.
    """
    columns = [column.name for column in fields(ImageEntry)]
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ImageError(f"cannot be read: {error}", file=path) from None
    frames = []
    for line, row in enumerate(rows, start=2):
        missing = [name for name in columns if not row.get(name)]
        if missing:
            raise ImageError(
                f"has no {missing[0]}", file=path, key=f"line {line}", expected=f"the columns {', '.join(columns)}"
            )
        laser = _LASER.get(row["laser"])
        if laser is None:
            raise ImageError(file=path, key=f"line {line}: laser", value=row["laser"], expected="on or off")
        frames.append(ImageEntry(row["exposure"], row["camera"], laser, row["file"]))
    return frames
