"""Reading of PCD files (Point Cloud Library) of all encodings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.errors import DescriptionError
from scancell.text_table import decoded, lines_of, numbers_of_lines

Array = NDArray[np.float64]

_KEYS = {"VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_HEADER = 1 << 20  # bytes in which a header ends
_MOST_POINTS = 2**31
_MOST_COUNT = 1 << 20  # values of a field


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
