"""Point-cloud files: one writer for all formats.

Coordinates are millimetres in the coordinate system of the scanned mesh file (E57: metres, by its standard); normals
point out of the surface, towards the sensor; times are seconds since the start of the run. Files of clouds of several
sensors have a field more: the number of the sensor.

======  =============================================================================================================
ply     all fields; positions and times in double precision, the others as floats and integers
npz     all fields at full precision, units in the names of the arrays
laz     all fields, extra dimensions for those not in LAS 1.4; positions rounded to 10 nm
e57     all fields, extension ``scancell`` for those not in the standard; organised: rows are exposures, columns pixels
pcd     all fields; positions in single precision (8 nm at 100 mm), because other programs accept no doubles
xyz     all fields as text, names in the first line; positions rounded to 1 nm
======  =============================================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files.formats import read_ply, read_ply_comments, write_ply

# Writes a cloud with comments to a path; `write_cloud` makes the result atomic.
_Write = Callable[[Path, Cloud, Sequence[str]], None]
FORMATS = ("ply", "npz", "laz", "e57", "pcd", "xyz")

__all__ = [
    "FORMATS",
    "parse_formats",
    "read_ply",
    "read_ply_comments",
    "transformed_columns",
    "write_cloud",
    "write_ply",
]


def write_cloud(
    path: Path, cloud: Cloud, comments: Sequence[str] = (), frame_from_part: NDArray[np.float64] | None = None
) -> None:
    """Write a cloud atomically in the format given by the suffix of `path`.

    Raises `DescriptionError` if the suffix is not in `FORMATS`; `OutputError` if the file cannot be written.

    Parameters
    ----------
    comments
        Lines of text for the header of the file.
    frame_from_part
        Transform (4, 4) applied to points and normals; identity by default.
    """
    write = _writer(parse_formats(path.suffix.removeprefix(".").lower(), "format", path)[0])
    if frame_from_part is not None and not np.array_equal(frame_from_part, np.eye(4)):
        cloud = transformed_columns(cloud, frame_from_part)
    with atomic_write(path) as temporary:
        write(temporary, cloud, comments)


def read_cloud(path: Path) -> Cloud:
    """The cloud of a file that scancell has written: PLY, or NPZ at full precision.

    Raises `MeshError` if the file is missing or not a cloud of scancell.
    """
    from scancell.reconstruction.cloud_files import formats  # noqa: PLC0415

    return formats.read_npz(path) if path.suffix.lower() == ".npz" else read_ply(path)


def transformed_columns(cloud: Cloud, target_from_source: NDArray[np.float64]) -> Cloud:
    """Columns of a cloud file in another frame, for reading and writing: a `Cloud` itself is in the part frame."""
    points = pose.transform_points(target_from_source, cloud.points_in_part)
    return replace(cloud, points_in_part=points, normals=cloud.normals @ target_from_source[:3, :3].T)


def parse_formats(text: str, key: str, file: str | Path | None = None) -> tuple[str, ...]:
    """Distinct formats of a comma-separated list such as ``ply,laz``.

    Raises `DescriptionError` naming `file` and `key`, the unknown word and the known ones; `MissingExtraError` if the
    package that writes a format is not installed.
    """
    words = tuple(dict.fromkeys(word.strip().lower() for word in text.split(",")))
    for word in words:
        if word not in FORMATS:
            raise DescriptionError(
                file=file, key=key, value=word, expected=f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
            )
        _writer(word)
    return words


def _writer(name: str) -> _Write:
    """Writer of a format; imported on demand, because the libraries are slow to import."""
    match name:
        case "ply":
            return lambda path, cloud, comments: write_ply(path, cloud, tuple(comments))
        case "laz":
            from scancell.reconstruction.cloud_files.laz import write_laz  # noqa: PLC0415

            return write_laz
        case "e57":
            from scancell.reconstruction.cloud_files.e57 import write_e57  # noqa: PLC0415

            return write_e57
    from scancell.reconstruction.cloud_files import formats  # noqa: PLC0415

    return {"npz": formats.write_npz, "pcd": formats.write_pcd, "xyz": formats.write_xyz}[name]
