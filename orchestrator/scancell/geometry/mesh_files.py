"""Reading of triangle meshes from STL, OBJ and PLY files, and welding of equal vertices.

Every record of a file is accounted for: it is read, or known to hold no surface (names, materials, texture
coordinates), or the file is refused with the record that is not understood.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scancell.errors import MeshError
from scancell.files import MAX_FILE_BYTES, read_file, require_file
from scancell.geometry.orientation import connected_components
from scancell.geometry.polygons import ROUNDING, triangulated

Vertices = NDArray[np.floating[Any]]
Faces = NDArray[np.int64]
Remarks = tuple[str, ...]
MeshContent = tuple[Vertices, Faces, Remarks]

FORMATS = (".stl", ".obj", ".ply")

_STL_HEAD = 84  # bytes: header and number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_BLOCK = 1 << 16

# What files of another kind begin with, in lower case.
_OTHER_CONTENTS = {
    b"version https://git-lfs": "a pointer of Git LFS, not the file itself: fetch it with `git lfs pull`",
    b"<!doctype html": "a web page (HTML), not the file that it offers",
    b"<html": "a web page (HTML), not the file that it offers",
    b"<": "an XML file (AMF, COLLADA, X3D or VTK)",
    b"pk\x03\x04": "a ZIP archive (a 3MF file is one)",
    b"\x1f\x8b": "compressed with gzip",
    b"7z\xbc\xaf": "a 7z archive",
    b"iso-10303-21": "a STEP file: name it .step",
    b"\xd0\xcf\x11\xe0": "a document of a CAD or office program",
    b"gltf": "a binary glTF file",
    b"{": "a JSON file (glTF is one)",
    b"%pdf": "a PDF document",
    b"#vrml": "a VRML file",
    b"off\n": "an OFF file",
    b"off\r": "an OFF file",
    b"ply\n": "a PLY file: name it .ply",
    b"ply\r": "a PLY file: name it .ply",
    b"solid": "an STL file: name it .stl",
}


def read_mesh(path: Path) -> MeshContent:
    """Vertices (n, 3) in the unit of the file, faces (m, 3), neither welded nor validated, and remarks.

    Polygons are divided into triangles, see `scancell.geometry.polygons.triangulated`.

    Raises `MeshError` if the file is missing, empty, of an unknown format, or holds something that is not understood.
    """
    require_file(path, MeshError)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise MeshError(f"{suffix or 'no suffix'} is not a mesh format", file=path, expected=", ".join(FORMATS))
    readers: dict[str, Callable[[bytes], MeshContent]] = {".stl": _read_stl, ".obj": _read_obj, ".ply": _read_ply}
    with _content(path, f"a readable {suffix[1:].upper()} mesh") as data:
        vertices, faces, remarks = readers[suffix](data)
    return vertices, faces, tuple(f"{path}: {remark}" for remark in remarks)


def read_ply_points(path: Path) -> tuple[Vertices, Remarks]:
    """Vertices (n, 3) of a PLY file, with or without faces, and remarks; raises `MeshError` like `read_mesh`."""
    with _content(path, "a readable PLY file") as data:
        elements, remarks = _ply_elements(data)
        return _ply_vertices(elements), tuple(f"{path}: {remark}" for remark in remarks)


@contextmanager
def _content(path: Path, expected: str) -> Iterator[bytes]:
    """Content of a file; a `ValueError` about it becomes a `MeshError` that names the file and what else it may be."""
    data = read_file(path, MeshError, MAX_FILE_BYTES)
    try:
        yield data
    except (ValueError, MemoryError, OverflowError) as error:
        start = data[:1024].removeprefix(b"\xef\xbb\xbf").lstrip().lower()
        own = {".stl": b"solid", ".ply": b"ply"}.get(path.suffix.lower(), b"\n")
        kinds = [kind for mark, kind in _OTHER_CONTENTS.items() if start.startswith(mark) and not mark.startswith(own)]
        reason = f"it is {kinds[0]}" if kinds else str(error) or "it is too large"
        raise MeshError(f"not {expected}: {reason}", file=path) from None


def weld(vertices: Vertices) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Merge vertices (n, 3) of equal coordinates.

    A tenth of the time of `np.unique` and a fifth of that of trimesh, which sort: 0.4 s for a million triangles.

    Returns
    -------
    first
        (k,) indices of the vertices to keep, ascending: the first one at each position.
    number
        (n,) index of each vertex among those kept.
    """
    hashes = _position_hashes(vertices)
    earliest = np.arange(len(hashes))
    pending = earliest
    slots = 1 << len(hashes).bit_length()
    table = np.empty(slots, np.int64)
    # Vectorised hash table: the first vertex of each slot is stored, those of other hashes are inserted next round.
    while len(pending):
        slot = (hashes[pending] & np.uint64(slots - 1)).astype(np.int64)
        table[slot[::-1]] = pending[::-1]
        found = table[slot]
        same = hashes[found] == hashes[pending]
        earliest[pending[same]] = found[same]
        pending = pending[~same]
    kept = earliest == np.arange(len(hashes))
    return np.flatnonzero(kept), (np.cumsum(kept) - 1)[earliest]


def weld_seams(vertices: Vertices, faces: Faces) -> Faces:
    """Faces (m, 3) after joining vertices of open edges that differ by rounding only.

    CAD programs write a corner that two faces share as 0 in one of them and as 1e-17 in the other.
    """
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(edges[count == 1])
    if not len(rim):
        return faces
    cells = vertices[rim] / (ROUNDING * np.abs(vertices).max())
    # Two grids, as a pair may lie on both sides of the border of a cell of one of them.
    joined = [rim[first[number]] for first, number in (weld(np.round(cells)), weld(np.round(cells + 0.5)))]
    label = connected_components(len(vertices), np.concatenate([rim, rim]), np.concatenate(joined))
    return np.unique(label, return_index=True)[1][label][faces]


def _position_hashes(vertices: Vertices) -> NDArray[np.uint64]:
    """64-bit hashes (n,) of positions (n, 3); collision probability 2^-64 per pair."""
    bits = np.dtype(f"u{vertices.dtype.itemsize}")
    factor, shift = np.uint64(0x9E3779B97F4A7C15), np.uint64(32)
    hashes = np.empty(len(vertices), np.uint64)
    for start in range(0, len(vertices), _BLOCK):
        positions = np.ascontiguousarray(vertices[start : start + _BLOCK] + vertices.dtype.type(0))  # -0 becomes 0
        value = np.zeros(len(positions), np.uint64)
        for column in positions.view(bits).T:
            value = (value + column) * factor
            value = (value ^ (value >> shift)) * factor
            value ^= value >> shift
        hashes[start : start + _BLOCK] = value
    return hashes


def write_stl(path: Path, vertices: Vertices, faces: Faces) -> None:
    """Write a binary STL file of vertices (n, 3), in the unit of the file, and faces (m, 3); its normals are zero."""
    triangles = np.zeros(len(faces), _STL_TRIANGLE)
    triangles["corners"] = vertices[faces].reshape(triangles["corners"].shape)
    head = b"scancell".ljust(80, b" ") + len(faces).to_bytes(4, "little")
    path.write_bytes(head + triangles.tobytes())


# Text


def _text(data: bytes) -> bytes:
    """Text with line feeds and blanks as the only white space; names and comments may be of any encoding."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        data = data.decode("utf-16", "replace").encode()
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data.translate(bytes.maketrans(b"\t\v\f", b"   ")).rstrip(b" \n\0\x1a")


def _table(lines: list[bytes], dtype: type = float) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """The numbers of all lines, and how many each line has."""
    text = b"\n".join(lines) + b"\n" if lines else b""
    raw = np.frombuffer(b"\n" + text, np.uint8)
    blank = (raw == ord(" ")) | (raw == ord("\n"))
    words = np.flatnonzero(blank[:-1] & ~blank[1:])
    counts = np.diff(np.searchsorted(words, np.flatnonzero(raw[1:] == ord("\n"))), prepend=0)
    return _numbers(text, len(words), dtype), counts


def _numbers(text: bytes, count: int, dtype: type = float) -> NDArray[Any]:
    """The `count` numbers of a text."""
    try:
        values: NDArray[Any] = np.fromstring(text, dtype, sep=" ") if count else np.empty(0, dtype)
    except ValueError:
        values = np.empty(0)
    if len(values) == count:
        return values
    for word in text.split():
        try:
            np.fromstring(word, dtype, sep=" ").reshape(1)
        except ValueError:
            comma = ": numbers have a decimal point, no comma, and blanks between them" if b"," in word else ""
            raise ValueError(f"{_shown(word)} is not {'a number' if dtype is float else 'an integer'}{comma}") from None
    raise ValueError("numbers cannot be read")


def _shown(text: bytes) -> str:
    """The first line of a text, for messages."""
    line = text.lstrip().partition(b"\n")[0]
    return repr(line[:60].decode("utf-8", "replace")) + ("..." if len(line) > 60 else "")


# STL: names end with the line, or where the next record begins in files without line breaks.

_STL_SOLID = re.compile(rb"\s*solid\b(?:(?!\bfacet\s+normal\b|\bend\s*solid\b)[^\n])*")
_STL_END = re.compile(rb"\bend\s*solid\b([^\n]*)")
_STL_FACET = re.compile(
    rb"\s*facet\s+normal(?:\s+\S+){3}\s+outer\s+loop"
    + rb"\s+vertex\s+(\S+\s+\S+\s+\S+)" * 3
    + rb"\s+endloop\s+endfacet(?!\S)"
)


def _read_stl(data: bytes) -> MeshContent:
    count = int.from_bytes(data[80:_STL_HEAD], "little")
    if len(data) >= _STL_HEAD and len(data) == _STL_HEAD + count * _STL_TRIANGLE.itemsize:
        corners: Vertices = np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEAD)["corners"].reshape(-1, 3)
    else:
        text = _text(data).lower()
        if b"#" in text:
            text = re.sub(rb"(?<!\S)#[^\n]*", b"", text)
        if b"\0" in text or not _STL_SOLID.match(text):
            raise ValueError(_binary_stl_fault(data, count))
        corners = _text_stl(text)
    return corners, np.arange(len(corners)).reshape(-1, 3), ()


def _binary_stl_fault(data: bytes, count: int) -> str:
    """Why a file that is not a text STL file is no binary one."""
    if not re.search(rb"[\0-\x08\x0e-\x19]", data):
        return f"it begins with {_shown(data)}; expected 'solid', or a binary file"
    if len(data) < _STL_HEAD:
        return f"it has {len(data)} bytes; expected {_STL_HEAD} bytes of header and 50 for each triangle"
    expected = _STL_HEAD + count * _STL_TRIANGLE.itemsize
    fault = "is truncated" if len(data) < expected else "holds more, or the number is wrong"
    return f"the header says {count} triangles, which take {expected} bytes; the file has {len(data)} bytes: it {fault}"


def _text_stl(text: bytes) -> Vertices:
    """Corners (3 m, 3) of all solids of a text in lower case."""
    solids, at = [], 0
    while at < len(text):
        solid = _STL_SOLID.match(text, at)
        if not solid:
            if not text[at:].strip():
                break
            raise ValueError(f"expected 'solid' or the end of the file, found {_shown(text[at : at + 200])}")
        end = _STL_END.search(text, solid.end())
        facets = text[solid.end() : end.start() if end else None]
        corners, count = _STL_FACET.subn(rb"\1 \2 \3 ", facets)
        try:
            solids.append(_numbers(corners, 9 * count))
        except ValueError:
            _require_facets(facets)
            raise
        if not end:
            raise ValueError(f"{_shown(solid[0])} has no 'endsolid': the file is incomplete")
        at = end.start(1) + _stl_name_length(end[1])
    return np.concatenate(solids).reshape(-1, 3)


def _stl_name_length(line: bytes) -> int:
    """Length of the name in what follows 'endsolid' in a line, where another solid with facets may follow."""
    last = max((facet.start() for facet in re.finditer(rb"\bfacet\s+normal\b", line)), default=0)
    solid = re.search(rb"\bsolid\b", line[:last])
    return solid.start() if solid else len(line)


def _require_facets(text: bytes) -> None:
    """Raise `ValueError` unless the text consists of facets; their numbers may be wrong."""
    at = number = 0
    while facet := _STL_FACET.match(text, at):
        at, number = facet.end(), number + 1
    if text[at:].strip():
        found = _shown(text[at : at + 200])
        raise ValueError(f"expected 'endsolid', or a facet of three vertices, after {number} facets; found {found}")


# OBJ

_OBJ_NO_SURFACE = frozenset(
    b"vt vn vp g o s mg p l usemtl mtllib usemap maplib bevel c_interp d_interp lod shadow_obj trace_obj".split()
)
_OBJ_NAMES = frozenset(b"g o usemtl mtllib usemap maplib shadow_obj trace_obj".split())


def _read_obj(data: bytes) -> MeshContent:
    text = re.sub(rb"#[^\n]*", b"", _text(data))
    places: list[bytes] = []
    polygons: list[bytes] = []
    before: list[int] = []  # number of vertices before each polygon
    begun = b""
    for line in text.split(b"\n"):
        statement = begun + line.lstrip(b" ")
        word, _, numbers = statement.partition(b" ")
        if b"\\" in line and word not in _OBJ_NAMES and line.rstrip(b" ").endswith(b"\\"):
            begun = statement.rstrip(b" ")[:-1] + b" "
            continue
        begun = b""
        if word == b"v":
            places.append(numbers)
        elif word in (b"f", b"fo"):
            polygons.append(numbers)
            before.append(len(places))
        elif word and word not in _OBJ_NO_SURFACE:
            raise ValueError(f"{_shown(statement)} is not a statement that is known")
    if begun:
        raise ValueError(f"{_shown(begun)}: the last line is continued, the file is incomplete")
    if not places and not polygons:
        raise ValueError("no vertices and no faces")
    values, columns = _table(places)
    start = np.cumsum(columns) - columns
    # x y z, with a weight, with a colour, or with both or an opacity
    wrong = ~np.isin(columns, (3, 4, 6, 7))
    wrong[~wrong] |= (columns[~wrong] == 4) & (values[np.minimum(start[~wrong] + 3, len(values) - 1)] != 1)
    if wrong.any():
        raise ValueError(
            f"vertex {_shown(places[np.argmax(wrong)])}; expected x, y and z, and perhaps a weight of 1 or a colour"
        )
    vertices = values[start[:, None] + np.arange(3)]
    # Behind the number of a vertex stand those of its texture coordinates and its normal.
    corners, counts = _table(
        re.sub(rb"(?<=\d)/[^ \n]*", b"", b"\n".join(polygons)).split(b"\n") if polygons else [], np.int64
    )
    so_far = np.repeat(np.array(before, np.int64), counts)  # 1 is the first vertex, -1 the last one so far
    corners = np.where(corners > 0, corners - 1, np.where(corners < 0, so_far + corners, -1))
    return vertices, *triangulated(vertices, corners, counts)


# PLY

_PLY_TYPES = {
    name: np.dtype(code)
    for code, names in {
        "<i1": ("char", "int8"),
        "<u1": ("uchar", "uint8"),
        "<i2": ("short", "int16"),
        "<u2": ("ushort", "uint16"),
        "<i4": ("int", "int32"),
        "<u4": ("uint", "uint32"),
        "<f4": ("float", "float32"),
        "<f8": ("double", "float64"),
    }.items()
    for name in names
}
_DOUBLE = np.dtype("<f8")


class _Property(NamedTuple):
    """A property of a PLY element; `length` is the type of the numbers of items where it is a list."""

    name: str
    type: np.dtype[Any]
    length: np.dtype[Any] | None


class _Column(NamedTuple):
    """Values of a property of all rows, one row after another; `lengths` has the number of those of each row."""

    values: NDArray[Any]
    lengths: NDArray[np.int64] | None = None


def _read_ply(data: bytes) -> MeshContent:
    elements, remarks = _ply_elements(data)
    vertices = _ply_vertices(elements)
    if any(len(column.values) for column in elements.get("tristrips", {}).values()):
        raise ValueError("it holds triangle strips (element tristrips); export faces")
    faces = elements.get("face", {})
    lists = [faces[name] for name in ("vertex_indices", "vertex_index") if name in faces]
    if not faces:
        return vertices, np.empty((0, 3), np.int64), remarks
    if len(lists) != 1 or lists[0].lengths is None:
        raise ValueError(f"element face has {', '.join(faces)}; expected a list vertex_indices")
    with np.errstate(invalid="ignore"):  # what is not finite has no integer
        corners = lists[0].values.astype(np.int64)
    if (corners != lists[0].values).any():
        raise ValueError("numbers of vertices are not integers")
    triangles, more = triangulated(vertices, corners, lists[0].lengths)
    return vertices, triangles, (*remarks, *more)


def _ply_vertices(elements: dict[str, dict[str, _Column]]) -> Vertices:
    columns = elements.get("vertex", {})
    places = [columns[name].values for name in "xyz" if name in columns and columns[name].lengths is None]
    if len(places) != 3:
        raise ValueError("it has no element vertex with x, y and z")
    return np.stack(places, axis=1)


def _ply_elements(data: bytes) -> tuple[dict[str, dict[str, _Column]], Remarks]:
    """Columns of all elements by element and property, and remarks."""
    if data[:3] == b"\xef\xbb\xbf" or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        data = _text(data)
    begin = re.match(rb"\s*ply[ \t]*(\r\n?|\n)", data)
    if not begin:
        raise ValueError(f"it begins with {_shown(data[:80])}; expected 'ply'")
    ending = rb"\r" if begin[1] == b"\r" else rb"\r?\n"
    end = re.search(rb"(?:\r|\n)[ \t]*end_header[ \t]*" + ending, data)
    if not end:
        raise ValueError("its header has no 'end_header'")
    header = data[begin.end() : end.start()].decode("latin-1")
    order, elements = _ply_header(header.split("\r" if ending == rb"\r" else "\n"))
    body = data[end.end() :]
    lengths = None
    if order is None:
        lines = [line for line in _text(body).split(b"\n") if line.strip(b" ")]
        counted = sum(element[1] for element in elements)
        if len(lines) != counted:
            fault = "truncated" if len(lines) < counted else "longer than that"
            raise ValueError(f"its header counts {counted} rows, but {len(lines)} lines follow: the file is {fault}")
        values, words = _table(lines)
        raw = values.view(np.uint8)
        lengths = np.cumsum(words) * values.itemsize
    else:
        raw = np.frombuffer(body, np.uint8)
    result: dict[str, dict[str, _Column]] = {}
    at = read = 0
    for name, rows, properties in elements:
        result[name], starts = _ply_columns(raw, at, name, rows, properties)
        at = int(starts[-1])
        if lengths is not None:
            same = lengths[read : read + rows] == starts[1:]
            if not same.all():
                raise ValueError(
                    f"{_shown(lines[read + int(np.argmin(same))])} is no row of element {name} as the header has it"
                )
        read += rows
    if at == len(raw) or not body[at:].strip(b"\0\r\n \x1a"):
        return result, ()
    return result, (f"{len(raw) - at} bytes behind the data of the last element were ignored",)


def _ply_header(lines: list[str]) -> tuple[str | None, list[tuple[str, int, list[_Property]]]]:
    """Byte order (None: text) and the elements with number of rows and properties."""
    orders = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
    form = ""
    elements: list[tuple[str, int, list[_Property]]] = []
    for line in lines:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", form, "1.0"] if form in orders:
                pass
            case ["element", name, rows] if rows.isdecimal() and name not in (element[0] for element in elements):
                elements.append((name, int(rows), []))
            case ["property", *types, name] if (
                elements
                and (len(types) == 1 or (len(types) == 3 and types[0] == "list" and types[1] in _PLY_TYPES))
                and types[-1] in _PLY_TYPES
                and name not in (known.name for known in elements[-1][2])
            ):
                item, *count = (_PLY_TYPES[kind] for kind in reversed(types) if kind != "list")
                elements[-1][2].append(_Property(name, item, count[0] if count else None))
            case _:
                raise ValueError(
                    f"its header has the line {_shown(line.encode())}, which is not known, or stands there twice"
                )
    if form not in orders:
        raise ValueError("its header states no format")
    for element, number, properties in elements:
        if number and not properties:
            raise ValueError(f"its element {element} has {number} rows without properties")
    if orders[form] is None:  # all numbers of a text are read as doubles
        elements = [
            (name, rows, [_Property(p.name, _DOUBLE, p.length and _DOUBLE) for p in ps]) for name, rows, ps in elements
        ]
    elif orders[form] == ">":
        elements = [
            (name, rows, [_Property(p.name, p.type.newbyteorder(), p.length and p.length.newbyteorder()) for p in ps])
            for name, rows, ps in elements
        ]
    return orders[form], elements


def _ply_columns(
    raw: NDArray[np.uint8], at: int, name: str, rows: int, properties: list[_Property]
) -> tuple[dict[str, _Column], NDArray[np.int64]]:
    """Columns of an element whose rows begin at byte `at`, and where each row, and the next element, begins."""
    starts = _row_starts(raw, at, name, rows, properties)
    cursor = starts[:-1]
    columns = {}
    for key, kind, count in properties:
        if count is None:
            columns[key] = _Column(_gathered(raw, cursor, kind))
            cursor = cursor + kind.itemsize
            continue
        counts = _gathered(raw, cursor, count).astype(np.int64)
        cursor = cursor + count.itemsize
        first = np.cumsum(counts) - counts
        places = np.repeat(cursor - first * kind.itemsize, counts) + np.arange(counts.sum()) * kind.itemsize
        columns[key] = _Column(_gathered(raw, places, kind), counts)
        cursor = cursor + counts * kind.itemsize
    return columns, starts


def _gathered(raw: NDArray[np.uint8], at: NDArray[np.int64], kind: np.dtype[Any]) -> NDArray[Any]:
    """The values whose bytes begin at `at`."""
    return np.asarray(raw[at[:, None] + np.arange(kind.itemsize)].view(kind)[:, 0])


def _row_starts(
    raw: NDArray[np.uint8], at: int, name: str, rows: int, properties: list[_Property]
) -> NDArray[np.int64]:
    """Bytes (rows + 1,) at which the rows of an element begin, and the data behind them.

    Usually all rows have lists of the same length; only where they have not, each row is looked at.
    """
    lists = [p.length is not None for p in properties]
    first = _walked(raw, at, name, min(rows, 1), properties)
    size = first[-1] - at
    if rows * size <= len(raw) - at:
        starts = at + size * np.arange(rows + 1, dtype=np.int64)
        if not any(lists) or rows < 2:
            return starts
        same, offset = True, 0
        for _, kind, count in properties:
            if count is None:
                offset += kind.itemsize
            else:
                counts = _gathered(raw, starts[:-1] + offset, count)
                same = same and bool((counts == counts[0]).all())
                offset += count.itemsize + int(counts[0]) * kind.itemsize
        if same:
            return starts
    return np.array(_walked(raw, at, name, rows, properties), np.int64)


def _walked(raw: NDArray[np.uint8], at: int, name: str, rows: int, properties: list[_Property]) -> list[int]:
    """Bytes of `_row_starts`, found row by row; raises `ValueError` at a row that is not complete."""
    lengths = [(p.length and struct.Struct(_struct_format(p.length)), p.type.itemsize) for p in properties]
    starts, total, view = [at], len(raw), raw.data
    for row in range(rows):
        for length, size in lengths:
            if length is None:
                at += size
            else:
                number = length.unpack_from(view, at)[0] if at + length.size <= total else 0
                if not (number >= 0 and number == int(number)):
                    raise ValueError(f"a list of row {row + 1} of element {name} has {number} items")
                at += length.size + int(number) * size
        if at > total:
            raise ValueError(f"it ends in row {row + 1} of the {rows} rows of element {name}: the file is truncated")
        starts.append(at)
    return starts


def _struct_format(kind: np.dtype[Any]) -> str:
    return (">" if kind.byteorder == ">" else "<") + kind.char
