"""Binary PLY files: millimetres, in the coordinate system of the scanned mesh file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scancell.errors import MeshError
from scancell.files import atomic_write
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files.laz import (
    RECORD,
    UNITS,
    WITHOUT_SATURATED,
    cloud_of_record,
    record_of,
    require_bounded,
)

_BLOCK = 1 << 16  # points written at a time, which bounds the memory
_PLY_HEADER = 1 << 16  # bytes in which the header of a file ends
_PLY_NAMES = {"<f8": "double", "<f4": "float", "|u1": "uchar", "<i4": "int"}


def write_ply(path: str | Path, cloud: Cloud, comments: tuple[str, ...] = ()) -> None:
    """Write a binary little-endian PLY file atomically; x, y, z and sigma in mm, time in s.

    Raises `OutputError` if the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        stream.write(_header(len(cloud), comments))
        for start in range(0, len(cloud), _BLOCK):
            stream.write(record_of(cloud[start : start + _BLOCK]).tobytes())  # `tofile` hides the cause of write errors


def read_ply(path: str | Path) -> Cloud:
    """Read a cloud written by `write_ply`, also of a version without the property ``saturated``.

    Raises `MeshError` if the file is missing, has other properties, or is truncated.
    """
    path = Path(path)
    if not path.is_file():
        raise MeshError("no such file", file=path)
    with path.open("rb") as stream:
        head = _read_ply_header(stream.read(_PLY_HEADER))
        if head is None:
            raise MeshError(file=path, expected="a binary point cloud written by scancell")
        count, kind, known = head
        stream.seek(known)
        record = np.fromfile(stream, kind, count)
    if len(record) < count:
        raise MeshError(f"file is truncated: {len(record)} of {count} points", file=path)
    return require_bounded(cloud_of_record(record), path)


def read_ply_comments(path: str | Path) -> list[str]:
    """Lines of text in the header of a PLY file.

    Raises `MeshError` if the file is missing.
    """
    path = Path(path)
    if not path.is_file():
        raise MeshError("no such file", file=path)
    with path.open("rb") as stream:
        lines = stream.read(_PLY_HEADER).partition(b"end_header\n")[0].decode("utf-8", errors="replace").splitlines()
    return [line.removeprefix("comment ") for line in lines if line.startswith("comment ")]


def _properties(kind: np.dtype[np.void]) -> list[str]:
    return [f"property {_PLY_NAMES[kind[name].str]} {name}" for name in kind.names or ()]


def _header(count: int, comments: tuple[str, ...]) -> bytes:
    notes = (f"units: {UNITS}", *comments)
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {' '.join(note.split())}" for note in notes]
    lines += [f"element vertex {count}", *_properties(RECORD), "end_header"]
    return ("\n".join(lines) + "\n").encode("utf-8")


def _read_ply_header(start: bytes) -> tuple[int, np.dtype[np.void], int] | None:
    """Number of points, type of their records and byte offset of the first one; None for another kind of PLY."""
    head, mark, _ = start.partition(b"end_header\n")
    lines = head.decode("utf-8", errors="replace").splitlines()
    properties = [line for line in lines if line.startswith("property")]
    elements = [line.split() for line in lines if line.startswith("element")]
    kinds = [kind for kind in (RECORD, WITHOUT_SATURATED) if properties == _properties(kind)]
    ours = mark and lines[:2] == ["ply", "format binary_little_endian 1.0"] and kinds
    if not ours or len(elements) != 1 or not elements[0][-1].isdecimal():
        return None
    return int(elements[0][-1]), kinds[0], len(head) + len(mark)
