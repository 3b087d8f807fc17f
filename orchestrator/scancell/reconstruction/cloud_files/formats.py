"""Formats of point-cloud files of scancell's own and of PCL: NPZ, text, PLY and PCD."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.errors import DescriptionError, MeshError
from scancell.files import atomic_write, require_file
from scancell.reconstruction.cloud import Cloud
from scancell.text_table import decoded, lines_of, numbers_of_lines

MM = 1e3
_LARGEST_MM, _LATEST = 1e9, 1e10  # of a position, mm, and a time, s
UNITS = "x y z sigma in mm, time in s; normals towards the sensor"

# Positions in double precision: far from the origin single precision would lose micrometres.
RECORD = np.dtype(
    [
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("nx", "<f4"),
        ("ny", "<f4"),
        ("nz", "<f4"),
        ("sigma", "<f4"),
        ("intensity", "<f4"),
        ("quality", "<f4"),
        ("camera", "u1"),
        ("column", "<i4"),
        ("segment", "<i4"),
        ("profile", "<i4"),
        ("time", "<f8"),
        ("saturated", "u1"),
    ]
)
_FIELDS = [(name, RECORD[name].str) for name in RECORD.names or ()]
# Of files by earlier versions.
WITHOUT_SATURATED = np.dtype(_FIELDS[:-1])
# Of clouds of several sensors.
WITH_SENSOR = np.dtype([*_FIELDS, ("sensor", "u1")])
_FIRST_SAME = 7  # field from which on records hold what clouds do

_PCD_TYPES = {"f": "F", "i": "I", "u": "U"}
_PCD_NAMES = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}
_DECIMALS = {"x": "%.6f", "y": "%.6f", "z": "%.6f", "time": "%.9f"}


_SAME = ("normals", "intensity", "quality", "camera", "column", "segment", "profile")

_BLOCK = 1 << 16  # points written at a time, which bounds the memory
_PLY_HEADER = 1 << 16  # bytes in which the header of a file ends
_PLY_NAMES = {"<f8": "double", "<f4": "float", "|u1": "uchar", "<i4": "int"}

_KEYS = {"VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_HEADER = 1 << 20  # bytes in which a header ends
_MOST_POINTS = 2**31
_MOST_COUNT = 1 << 20  # values of a field


def record_type(cloud: Cloud) -> np.dtype[np.void]:
    """`RECORD`, or `WITH_SENSOR` where points are of further sensors."""
    return WITH_SENSOR if (cloud.sensor != 1).any() else RECORD


def record_of(cloud: Cloud, kind: np.dtype[np.void] | None = None) -> NDArray[Any]:
    """Records (n,) of a cloud, mm and s, of its `record_type`, or of that of a cloud of which it is a part."""
    record = np.zeros(len(cloud), record_type(cloud) if kind is None else kind)
    for axis, name in enumerate("xyz"):
        record[name] = cloud.points_in_part[:, axis] * MM
        record[f"n{name}"] = cloud.normals[:, axis]
    record["sigma"] = cloud.sigma * MM
    for name in (record.dtype.names or ())[_FIRST_SAME:]:
        record[name] = getattr(cloud, name)
    return record


def require_bounded(cloud: Cloud, path: Path) -> Cloud:
    """The cloud of a file, whose positions and times are finite and bounded; else raises `MeshError`."""
    for name, values, largest in (("x, y, z", cloud.points_in_part * MM, _LARGEST_MM), ("time", cloud.time, _LATEST)):
        wrong = np.flatnonzero(~(np.abs(values.reshape(len(values), -1)) <= largest).all(1))
        if len(wrong):
            row = int(wrong[0])
            expected = f"finite numbers from {-largest:g} to {largest:g}"
            raise MeshError(file=path, key=f"{name} of point {row + 1}", value=values[row].tolist(), expected=expected)
    return cloud


def cloud_of_record(record: NDArray[Any]) -> Cloud:
    """Cloud of records (n,), see `record_of`; of type `WITHOUT_SATURATED`, no point is saturated."""
    names = record.dtype.names or ()
    return Cloud(
        points_in_part=np.stack([record[name] for name in "xyz"], -1) / MM,
        normals=np.stack([record[f"n{name}"] for name in "xyz"], -1).astype(float),
        sigma=record["sigma"] / MM,
        intensity=record["intensity"].astype(float),
        quality=record["quality"].astype(float),
        camera=record["camera"].astype(np.int32),
        column=record["column"].astype(np.int32),
        profile=record["profile"].astype(np.int64),
        segment=record["segment"].astype(np.int32),
        time=record["time"].astype(float),
        saturated=record["saturated"].astype(bool) if "saturated" in names else np.zeros(len(record), bool),
        sensor=record["sensor"] if "sensor" in names else np.ones(len(record), np.uint8),
    )


def write_npz(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write a compressed archive: ``points_in_part_mm``, ``normals`` (n, 3), ``sigma_mm`` (n,), …, ``comments``."""
    np.savez_compressed(
        path,
        points_in_part_mm=cloud.points_in_part * MM,
        sigma_mm=cloud.sigma * MM,
        time_s=cloud.time,
        saturated=cloud.saturated,
        comments=np.array([UNITS, *comments]),
        **{name: getattr(cloud, name) for name in _SAME},
        **_sensor_column(cloud),
    )


def _sensor_column(cloud: Cloud) -> dict[str, Any]:
    return {"sensor": cloud.sensor} if (cloud.sensor != 1).any() else {}


def read_npz(path: Path) -> Cloud:
    """The cloud of an archive of `write_npz`.

    Raises `MeshError` if the file is missing or no such archive.
    """
    require_file(path, MeshError)
    try:
        with np.load(path) as archive:
            cloud = Cloud(
                points_in_part=archive["points_in_part_mm"] / MM,
                sigma=archive["sigma_mm"] / MM,
                time=archive["time_s"],
                saturated=archive["saturated"] if "saturated" in archive else np.zeros(len(archive["time_s"]), bool),
                sensor=archive["sensor"] if "sensor" in archive else np.ones(len(archive["time_s"]), np.uint8),
                **{name: archive[name] for name in _SAME},
            )
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        EOFError,
        MemoryError,
        BadZipFile,
        DescriptionError,
    ) as error:
        raise MeshError(f"{path}: not a cloud of scancell: {error}") from None
    return require_bounded(cloud, path)


def write_pcd(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write binary PCD 0.7; positions in single precision, because other programs accept no double x, y, z."""
    record = record_of(cloud)
    single = np.dtype([(name, "<f4" if name in "xyz" else record.dtype[name].str) for name in record.dtype.names or ()])
    kinds = [single[name] for name in single.names or ()]
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {' '.join(note.split())}" for note in (UNITS, *comments)),
        "VERSION 0.7",
        f"FIELDS {' '.join(_PCD_NAMES.get(name, name) for name in single.names or ())}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(_PCD_TYPES[kind.kind] for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {len(record)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(record)}",
        "DATA binary",
    ]
    with path.open("wb") as stream:
        stream.write(("\n".join(lines) + "\n").encode())
        stream.write(record.astype(single).tobytes())  # `tofile` hides the cause of write errors


def write_xyz(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write text, one line per point; header lines with the names of the columns, the units and the comments."""
    kind = record_type(cloud)
    names = kind.names or ()
    head = "\n".join([" ".join(names), UNITS, *(" ".join(note.split()) for note in comments)])
    floats = {name: _DECIMALS.get(name, "%.7g") for name in names}
    layout = [floats[name] if kind[name].kind == "f" else "%d" for name in names]
    np.savetxt(path, record_of(cloud), layout, header=head, encoding="utf-8")


def write_ply(path: str | Path, cloud: Cloud, comments: tuple[str, ...] = ()) -> None:
    """Write a binary little-endian PLY file atomically; x, y, z and sigma in mm, time in s.

    Raises `OutputError` if the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        kind = record_type(cloud)
        stream.write(_header(len(cloud), kind, comments))
        for start in range(0, len(cloud), _BLOCK):
            record = record_of(cloud[start : start + _BLOCK], kind)
            stream.write(record.tobytes())  # `tofile` hides the cause of write errors


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


def _header(count: int, kind: np.dtype[np.void], comments: tuple[str, ...]) -> bytes:
    notes = (f"units: {UNITS}", *comments)
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {' '.join(note.split())}" for note in notes]
    lines += [f"element vertex {count}", *_properties(kind), "end_header"]
    return ("\n".join(lines) + "\n").encode("utf-8")


def _read_ply_header(start: bytes) -> tuple[int, np.dtype[np.void], int] | None:
    """Number of points, type of their records and byte offset of the first one; None for another kind of PLY."""
    head, mark, _ = start.partition(b"end_header\n")
    lines = head.decode("utf-8", errors="replace").splitlines()
    properties = [line for line in lines if line.startswith("property")]
    elements = [line.split() for line in lines if line.startswith("element")]
    kinds = [kind for kind in (RECORD, WITHOUT_SATURATED, WITH_SENSOR) if properties == _properties(kind)]
    ours = mark and lines[:2] == ["ply", "format binary_little_endian 1.0"] and kinds
    if not ours or len(elements) != 1 or not elements[0][-1].isdecimal():
        return None
    return int(elements[0][-1]), kinds[0], len(head) + len(mark)


@dataclass(frozen=True)
class _Field:
    name: str
    kind: np.dtype[np.generic]
    count: int


@dataclass(frozen=True)
class PcdHeader:
    """Header of a PCD file; `body` is the byte at which the points begin."""

    fields: tuple[_Field, ...]
    points: int
    encoding: str
    body: int
    moved_viewpoint: bool


def read_pcd(path: Path, data: bytes) -> tuple[Array, PcdHeader]:
    """Positions (n, 3) in the unit of the file, and the header.

    Raises `DescriptionError` if the header is wrong, or the file holds other than the stated number of points.
    """
    header = _read_header(path, data)
    body = data[header.body :]
    if header.encoding == "ascii":
        return _of_text(path, body, header, data[: header.body].count(b"\n")), header
    size = sum(field.kind.itemsize * field.count for field in header.fields) * header.points
    if header.encoding == "binary_compressed":
        if header.points == 0:
            return np.zeros((0, 3)), header
        if len(body) < 8:
            raise DescriptionError("is truncated: the points are missing", file=path)
        packed, unpacked = (int(value) for value in np.frombuffer(body, "<u4", 2))
        if unpacked != size:
            raise DescriptionError(
                file=path, key="size of the points without compression", value=unpacked, expected=f"{size} bytes"
            )
        _require_size(path, body[8:], packed)
        try:
            columns = decompressed(body[8 : 8 + packed], size, path)
        except DescriptionError:
            if packed != size:
                raise
            columns = body[8 : 8 + size]  # writers store as it is what compression does not shorten
        return _of_columns(columns, header), header
    _require_size(path, body, size)
    return _of_records(body, header), header


def _require_size(path: Path, body: bytes, size: int) -> None:
    """Refuse bodies that are shorter than stated, or longer by more than padding."""
    if len(body) < size:
        raise DescriptionError(f"is truncated: {len(body)} of {size} bytes of points", file=path)
    if body[size:].strip(b"\0\r\n \t"):
        raise DescriptionError(f"holds {len(body) - size} bytes behind the points that its header states", file=path)


def _header_words(path: Path, data: bytes) -> tuple[dict[str, list[str]], int]:
    """Values of the lines of a header by their keys, and the byte at which the points begin."""
    words: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in words:
        end = data.find(b"\n", start, start + _HEADER)
        if end < 0:
            raise DescriptionError("has no line DATA", file=path, expected="a PCD file")
        key, *values = data[start:end].decode("latin-1").split() or ["#"]
        start = end + 1
        if key.startswith("#"):
            continue
        key = {"COLUMNS": "FIELDS"}.get(key.upper(), key.upper())
        if key not in _KEYS:
            raise DescriptionError(file=path, key="header", value=key[:40], expected=", ".join(sorted(_KEYS)))
        if key in words:
            raise DescriptionError("is there twice", file=path, key=key)
        words[key] = values
    return words, start


def _read_header(path: Path, data: bytes) -> PcdHeader:
    words, start = _header_words(path, data)
    names = words.get("FIELDS", [])
    sizes, kinds = (words.get(key, []) for key in ("SIZE", "TYPE"))
    counts = words.get("COUNT", ["1"] * len(names))
    for key, values in (("SIZE", sizes), ("TYPE", kinds), ("COUNT", counts)):
        if len(values) != len(names):
            raise DescriptionError(file=path, key=key, value=" ".join(values), expected=f"{len(names)}, one a field")
    fields = []
    for name, size, kind, count in zip(names, sizes, kinds, counts, strict=True):
        if kind.upper() not in _SIZES or not size.isdecimal() or int(size) not in _SIZES[kind.upper()]:
            raise DescriptionError(
                file=path, key=f"TYPE and SIZE of {name}", value=f"{kind} {size}",
                expected="F 4, F 8, I or U with 1, 2, 4, 8",
            )  # fmt: skip
        if not count.isdecimal() or int(count) > _MOST_COUNT:
            raise DescriptionError(file=path, key=f"COUNT of {name}", value=count, expected="a number of values")
        fields.append(_Field(name, np.dtype(f"<{kind.lower()}{size}"), int(count)))
    for axis in "xyz":
        found = [field for field in fields if field.name == axis]
        if len(found) != 1 or found[0].count != 1:
            raise DescriptionError(file=path, key="FIELDS", value=" ".join(names), expected=f"one field {axis}")
    encoding = " ".join(words["DATA"]).lower()
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise DescriptionError(file=path, key="DATA", value=encoding, expected="ascii, binary or binary_compressed")
    viewpoint = words.get("VIEWPOINT", [])
    moved = [value for value in viewpoint if value.strip("0.")] not in ([], ["1"])
    return PcdHeader(tuple(fields), _count(path, words), encoding, start, moved)


def _count(path: Path, words: dict[str, list[str]]) -> int:
    """Number of points: POINTS, which is WIDTH times HEIGHT."""

    def number(key: str) -> int | None:
        if key not in words:
            return None
        text = " ".join(words[key])
        if not text.isdecimal() or len(text) > 10 or int(text) > _MOST_POINTS:
            raise DescriptionError(file=path, key=key, value=text, expected="a number of points")
        return int(text)

    width, height, points = (number(key) for key in ("WIDTH", "HEIGHT", "POINTS"))
    product = None if width is None else width * (1 if height is None else height)
    if points is None and product is None:
        raise DescriptionError("is missing", file=path, key="POINTS")
    if points is not None and product is not None and points != product:
        raise DescriptionError(file=path, key="POINTS", value=points, expected=f"WIDTH times HEIGHT, {product}")
    return points if points is not None else product or 0


def _of_text(path: Path, body: bytes, header: PcdHeader, above: int) -> Array:
    lines, numbers = [], []
    for number, line in enumerate(lines_of(decoded(body, path)[0] if body else ""), above + 1):
        if line.strip():
            lines.append(line)
            numbers.append(number)
    if len(lines) != header.points:
        raise DescriptionError(
            f"holds {len(lines)} lines of points", file=path, expected=f"{header.points} by its header"
        )
    width = sum(field.count for field in header.fields)
    wrong = next((row for row, line in enumerate(lines) if len(line.split()) != width), None)
    if wrong is not None:
        raise DescriptionError(
            file=path, key=f"line {numbers[wrong]}", value=lines[wrong][:40], expected=f"{width} values"
        )
    starts = dict(zip((field.name for field in header.fields), _starts(header, text=True), strict=True))
    return numbers_of_lines(lines, [starts[axis] for axis in "xyz"], " ", ".", path, numbers)


def _starts(header: PcdHeader, *, text: bool = False) -> list[int]:
    """Column, or byte, at which each field of a point begins."""
    sizes = [field.count * (1 if text else field.kind.itemsize) for field in header.fields]
    return [sum(sizes[:k]) for k in range(len(sizes))]


def _of_records(body: bytes, header: PcdHeader) -> Array:
    """Positions of points whose fields lie side by side."""
    at = {field.name: (start, field.kind) for field, start in zip(header.fields, _starts(header), strict=True)}
    size = sum(field.kind.itemsize * field.count for field in header.fields)
    record = np.dtype({
        "names": list("xyz"), "formats": [at[axis][1] for axis in "xyz"], "offsets": [at[axis][0] for axis in "xyz"],
        "itemsize": size,
    })  # fmt: skip
    found = np.frombuffer(body, record, header.points)
    return np.stack([found[axis].astype(float) for axis in "xyz"], -1).reshape(-1, 3)


def _of_columns(body: bytes, header: PcdHeader) -> Array:
    """Positions of points whose fields follow each other, each for all points."""
    axes, start = {}, 0
    for field in header.fields:
        if field.name in ("x", "y", "z"):
            axes[field.name] = np.frombuffer(body, field.kind, header.points, start).astype(float)
        start += field.kind.itemsize * field.count * header.points
    return np.stack([axes[axis] for axis in "xyz"], -1)


def decompressed(packed: bytes, size: int, path: Path) -> bytes:
    """The `size` bytes that the LZF compression of Marc Lehmann has packed.

    Raises `DescriptionError` if the packed bytes are damaged.
    """
    made, at, end = bytearray(), 0, len(packed)
    try:
        while at < end:
            control = packed[at]
            at += 1
            if control < 32:  # so many bytes as they are, and one
                if at + control + 1 > end:
                    raise IndexError
                made += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            begin = len(made) - ((control & 31) << 8) - packed[at] - 1
            at += 1
            length += 2
            if begin < 0:
                raise IndexError
            if begin + length <= len(made):
                made += made[begin : begin + length]
            else:  # repeats bytes that it writes
                period = bytes(made[begin:])
                made += (period * (length // len(period) + 1))[:length]
            if len(made) > size:
                raise IndexError
    except IndexError:
        raise DescriptionError("the compressed points are damaged", file=path) from None
    if len(made) != size:
        raise DescriptionError(f"the compressed points are damaged: {len(made)} of {size} bytes", file=path)
    return bytes(made)
