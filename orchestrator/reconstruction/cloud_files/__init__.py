"""Clouds on disk: one function for all formats, and what each can carry.

Coordinates are millimetres in the coordinate system of the mesh file that was scanned (E57: metres, as its standard
demands); normals look out of the surface, towards the sensor; times are seconds since the start of the run.

======  =============================================================================================================
ply     every field; positions and times as doubles, the rest as floats and whole numbers
npz     every field at full precision, by name, with the unit in the name
laz     every field: extra dimensions beside those of LAS 1.4; positions rounded to 10 nm
e57     every field: extension ``scancell`` beside the standard's; organised: rows are exposures, columns pixels
pcd     every field; positions as floats, because other programs accept no doubles there (8 nm at 100 mm)
xyz     every field as text, named in the first line; positions rounded to 1 nm
======  =============================================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from orchestrator.errors import DescriptionError
from orchestrator.files import atomic_write
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.cloud_files.ply import read_ply, write_ply

# Writes a file that need not appear whole; comments say what the cloud is.
_Write = Callable[[Path, Cloud, Sequence[str]], None]
FORMATS = ("ply", "npz", "laz", "e57", "pcd", "xyz")

__all__ = ["FORMATS", "parse_formats", "read_ply", "write_cloud", "write_ply"]


def write_cloud(path: Path, cloud: Cloud, comments: Sequence[str] = ()) -> None:
    """Write a cloud in the format that the suffix of `path` names; it appears whole or not at all.

    Raises
    ------
    DescriptionError
        If the suffix is none of `FORMATS`.
    OutputError
        If the file cannot be written.
    """
    write = _writer(parse_formats(path.suffix.removeprefix(".").lower(), str(path))[0])
    with atomic_write(path) as temporary:
        write(temporary, cloud, comments)


def parse_formats(text: str, option: str) -> tuple[str, ...]:
    """Formats from a list like ``ply,laz``, each once.

    Raises
    ------
    DescriptionError
        Naming `option`, the unknown word and the known ones.
    """
    words = tuple(dict.fromkeys(word.strip().lower() for word in text.split(",")))
    unknown = [word for word in words if word not in FORMATS]
    if unknown:
        raise DescriptionError(f"{option}: '{unknown[0]}': expected {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")
    return words


def _writer(name: str) -> _Write:
    """Imported when asked for, because the libraries behind them take their time."""
    match name:
        case "ply":
            return lambda path, cloud, comments: write_ply(path, cloud, tuple(comments))
        case "laz":
            from orchestrator.reconstruction.cloud_files.laz import write_laz  # noqa: PLC0415

            return write_laz
        case "e57":
            from orchestrator.reconstruction.cloud_files.e57 import write_e57  # noqa: PLC0415

            return write_e57
    from orchestrator.reconstruction.cloud_files import plain  # noqa: PLC0415

    return {"npz": plain.write_npz, "pcd": plain.write_pcd, "xyz": plain.write_xyz}[name]
