"""Clouds of any program: what any format and encoding holds is read, and every record is accounted for."""

from __future__ import annotations

import itertools
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest

from bench.file_mutants import CLOUDS, FORMATS, campaign
from scancell.errors import DescriptionError
from scancell.reconstruction.cloud_files.formats import decompressed
from scancell.reconstruction.cloud_files.read import read_cloud_file

POINTS = np.round(np.random.default_rng(4).uniform(-80.0, 120.0, (37, 3)), 4)  # mm
PCD_KINDS = {"F 4": "<f4", "F 8": "<f8", "I 4": "<i4", "U 1": "u1", "I 2": "<i2"}


def read(path: Path, unit: str | None = None) -> np.ndarray:
    return 1e3 * read_cloud_file(path, unit).points


def packed(data: bytes) -> bytes:
    """LZF with repetitions of up to 264 bytes at distances of up to 8192, as its specification allows."""
    made, literal, at = bytearray(), bytearray(), 0
    seen: dict[bytes, int] = {}

    def flush() -> None:
        while literal:
            made.append(len(literal[:32]) - 1)
            made.extend(literal[:32])
            del literal[:32]

    while at < len(data):
        key = data[at : at + 3]
        start = seen.get(key, -1)
        seen[key] = at
        if len(key) == 3 and start >= 0 and at - start <= 8192:
            length = 3
            while length < 264 and at + length < len(data) and data[start + length] == data[at + length]:
                length += 1
            flush()
            back, code = at - start - 1, length - 2
            made.append((min(code, 7) << 5) | (back >> 8))
            if code >= 7:
                made.append(code - 7)
            made.append(back & 255)
            at += length
        else:
            literal.append(data[at])
            at += 1
    flush()
    return bytes(made)


def write_pcd(
    path: Path, points: np.ndarray, fields: list[tuple[str, str, int]], encoding: str, end: str = "\n"
) -> None:
    """PCD of fields (name, type and size, count) in the given order; those that are no axis hold noise."""
    rng = np.random.default_rng(1)
    columns = []
    for name, kind, count in fields:
        values = points[:, "xyz".index(name)][:, None] if name in "xyz" else rng.integers(1, 99, (len(points), count))
        columns.append(values.astype(PCD_KINDS[kind]))
    head = [
        "# .PCD v0.7", "VERSION .7", f"FIELDS {' '.join(name for name, _, _ in fields)}",
        f"SIZE {' '.join(kind[2:] for _, kind, _ in fields)}", f"TYPE {' '.join(kind[0] for _, kind, _ in fields)}",
        f"COUNT {' '.join(str(count) for _, _, count in fields)}", f"WIDTH {len(points)}", "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(points)}", f"DATA {encoding}",
    ]  # fmt: skip
    if encoding == "ascii":
        rows = [" ".join(repr(float(v)) for column in columns for v in column[row]) for row in range(len(points))]
        body = (end.join(rows) + end).encode()
    elif encoding == "binary":
        body = b"".join(column[row].tobytes() for row in range(len(points)) for column in columns)
    else:
        plain = b"".join(column.tobytes() for column in columns)
        small = packed(plain)
        body = np.array([len(small), len(plain)], "<u4").tobytes() + small
    path.write_bytes((end.join(head) + end).encode() + body)


LAYOUTS = [
    [("x", "F 4", 1), ("y", "F 4", 1), ("z", "F 4", 1)],
    [("intensity", "F 4", 1), ("z", "F 8", 1), ("x", "F 8", 1), ("y", "F 8", 1)],
    [("x", "F 4", 1), ("y", "F 4", 1), ("z", "F 4", 1), ("_", "U 1", 4), ("fpfh", "F 4", 33), ("_", "I 2", 3)],
    [("label", "U 1", 1), ("x", "F 8", 1), ("hist", "I 4", 5), ("y", "F 4", 1), ("z", "F 4", 1)],
]


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("layout", LAYOUTS, ids=range(len(LAYOUTS)))
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_pcd_of_any_layout_and_encoding(tmp_path: Path, encoding: str, layout: list, end: str) -> None:
    write_pcd(tmp_path / "a.pcd", POINTS, layout, encoding, end)
    np.testing.assert_allclose(read(tmp_path / "a.pcd"), POINTS, rtol=1e-6)


def test_integer_and_stored_pcd(tmp_path: Path) -> None:
    whole = np.round(POINTS)
    write_pcd(tmp_path / "a.pcd", whole, [(axis, "I 4", 1) for axis in "xyz"], "binary")
    np.testing.assert_allclose(read(tmp_path / "a.pcd"), whole)
    plain = POINTS.T.astype("<f4").tobytes()  # a writer that could not shorten the points
    write_pcd(tmp_path / "b.pcd", POINTS, LAYOUTS[0], "binary_compressed")
    head = (tmp_path / "b.pcd").read_bytes().partition(b"compressed\n")[0] + b"compressed\n"
    (tmp_path / "b.pcd").write_bytes(head + np.array([len(plain)] * 2, "<u4").tobytes() + plain)
    np.testing.assert_allclose(read(tmp_path / "b.pcd"), POINTS, rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_compressed_bytes_are_restored(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = bytes(rng.integers(0, 2 + seed**3, 4000).astype(np.uint8)) + bytes(300) + b"ab" * 200
    assert decompressed(packed(data), len(data), Path("a")) == data


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd_with_other_than_the_stated_points_is_refused(tmp_path: Path, encoding: str) -> None:
    write_pcd(tmp_path / "a.pcd", POINTS, LAYOUTS[0], encoding)
    data = (tmp_path / "a.pcd").read_bytes()
    for changed in (data[:-30], data + b"1 2 3 " * 9, data.replace(b"POINTS 37", b"POINTS 36"),
                    data.replace(b"37", b"38"), data.replace(b"FIELDS x y", b"FIELDS x x"),
                    data.replace(b"WIDTH", b"WIDT\0H")):  # fmt: skip
        (tmp_path / "b.pcd").write_bytes(changed)
        with pytest.raises(DescriptionError, match=r"b\.pcd"):
            read_cloud_file(tmp_path / "b.pcd")


def ply(points: np.ndarray, order: str, kinds: str = "double", faces: int = 2) -> bytes:
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    head = (
        f"ply\nformat {name} 1.0\ncomment of a test\nelement vertex {len(points)}\n"
        f"property uchar red\nproperty {kinds} x\n"
        f"property {kinds} y\nproperty {kinds} z\nelement face {faces}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    lengths = [3 + k for k in range(faces)]
    if order == "":
        rows = [f"7 {' '.join(map(str, point))}" for point in points.tolist()]
        rows += [f"{n} {' '.join('1' * n)}" for n in lengths]
        return (head + "\n".join(rows) + "\n").encode()
    record = np.dtype([("red", "u1"), ("at", order + {"double": "f8", "float": "f4"}[kinds], 3)])
    table = np.zeros(len(points), record)
    table["at"] = points
    return head.encode() + table.tobytes() + b"".join(bytes([n]) + np.ones(n, order + "i4").tobytes() for n in lengths)


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("kind", ["float", "double"])
def test_ply_of_any_encoding_and_truncated_ones(tmp_path: Path, order: str, kind: str) -> None:
    data = ply(POINTS, order, kind)
    (tmp_path / "a.ply").write_bytes(data)
    np.testing.assert_allclose(read(tmp_path / "a.ply"), POINTS, rtol=1e-6)
    for changed in (data[: len(data) * 2 // 3], data[:-3]):
        (tmp_path / "b.ply").write_bytes(changed)
        with pytest.raises(DescriptionError, match=r"b\.ply"):
            read_cloud_file(tmp_path / "b.ply")
    (tmp_path / "c.ply").write_bytes(data + b"1 2 3 4\n")
    try:
        assert read_cloud_file(tmp_path / "c.ply").warnings, "what follows the elements is said, or refused"
    except DescriptionError as error:
        assert "c.ply" in str(error)


HEADERS = (
    "", "x{0}y{0}z{0}i\n", "# x y z i\n", "//X Y Z Intensity\n",
    "Device{0}LLT\nPoints{0}9\n\nX [mm]{0}Y [mm]{0}Z [mm]{0}I\n",
    "37\n", "% a comment\n\n",
)  # fmt: skip
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le")


@pytest.mark.parametrize(("separator", "decimal"), [p for p in itertools.product(",;\t |", ".,") if p[0] != p[1]])
@pytest.mark.parametrize("header", HEADERS)
def test_text_in_any_dialect(tmp_path: Path, separator: str, decimal: str, header: str) -> None:
    if (separator, decimal) == ("|", ","):
        pytest.skip("no known writer")
    rows = [separator.join(f"{v:.4f}" for v in (*point, 5.0)) for point in POINTS]
    text = header.format(separator) + "\n".join(rows).replace(".", decimal) + "\n"
    encodings = ENCODINGS if header in HEADERS[:2] else ENCODINGS[:1]
    for encoding, end in itertools.product(encodings, ("\n", "\r\n", "\r")):
        path = tmp_path / "a.txt"
        path.write_bytes(text.replace("\n", end).encode(encoding))
        np.testing.assert_allclose(read(path), POINTS, atol=1e-9)


@pytest.mark.parametrize("suffix", ["txt", "asc", "csv", "xyz", "pts"])
def test_order_of_columns_and_units_are_those_of_their_names(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_text("id,z_m,y_m,x_m\n" + "".join(f"{k},{z},{y},{x}\n" for k, (x, y, z) in enumerate(POINTS / 1e3)))
    np.testing.assert_allclose(read(path), POINTS, atol=1e-9)
    with pytest.raises(DescriptionError, match="cloud_unit"):
        read_cloud_file(path, "inch")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1 2 3\n4 5\n6 7 8\n", "line 2"),
        ("1 2 3\n4 abc 5\n6 7 8\n", "line 2"),
        ("1 2 3\n6 7 8\nEnd of file\n9 9 9\n", "line 3"),
        ("5\n1 2 3\n4 5 6\n", "line 1"),
        ("a,b,c\n1,2,3\n", "x, y and z"),
        ("x,x,y,z\n1,2,3,4\n", "twice"),
        ("1,5, 2,5, 3,5\n1,5, 2,5, 3,5\n", "decimal marks"),
        ("1 2\n3 4\n", "x, y and z"),
        (" ".join("1" * 40) + "\n" + " ".join("2" * 40), "matrix of heights"),
        ("1_0 2 3\n1 2 3\n", "line 1"),
        ("x,y,z\n", "no"),
        ("1.5 2 -3.01.6 4\n1 2 3\n4 5 6\n", "line 1"),
        ("-6 z\n1 2 3\n4 5 6\n", "line 1"),
        ("\0\0\1\2", "text"),
    ],
)
def test_text_that_cannot_be_accounted_for_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(DescriptionError, match=reason):
        read_cloud_file(tmp_path / "a.txt")


MARKS = {
    "nan": "not finite",
    "inf": "not finite",
    "zeros": "0, 0, 0",
    "-327.68": "z = -327.68",
    "-99999.99": "z = -99999.99",
}


@pytest.mark.parametrize("mark", MARKS)
@pytest.mark.parametrize("suffix", ["pcd", "ply", "txt", "csv"])
def test_missing_points_are_left_out_and_counted(tmp_path: Path, mark: str, suffix: str) -> None:
    points, path = POINTS.copy(), tmp_path / f"a.{suffix}"
    points[[0, 5, 36]] = 0.0
    if mark != "zeros":
        points[[0, 5, 36], 2] = float(mark)
    match suffix:
        case "pcd":
            write_pcd(path, points, LAYOUTS[1], "binary")
        case "ply":
            path.write_bytes(ply(points, "<"))
        case _:
            separator = " " if suffix == "txt" else ";"
            path.write_text("".join(separator.join(map(str, point)) + "\n" for point in points.tolist()))
    found = read_cloud_file(path)
    np.testing.assert_allclose(1e3 * found.points, np.delete(POINTS, [0, 5, 36], 0), atol=1e-9)
    assert (found.records, sum(found.dropped.values())) == (37, 3)
    assert MARKS[mark] in found.warnings[0]
    assert "3 of 37" in found.warnings[0]


def test_height_of_two_of_four_points_is_no_mark(tmp_path: Path) -> None:
    """Two others do not tell how far heights of points lie apart."""
    path = tmp_path / "a.xyz"
    path.write_text("18 76 -35.3\n-26 7 -35.3\n-26 71 79.5\n8 44 71.2\n")
    assert len(read_cloud_file(path).points) == 4


@pytest.mark.parametrize("first", ["26.546g-40.872 -89.476", "-84.54DATA ascii", "78.052\xdc-59.879 -43.138"])
def test_damaged_first_row_is_no_header(tmp_path: Path, first: str) -> None:
    path = tmp_path / "a.xyz"
    path.write_text(first + "\n" + "1 2 3\n4 5 6\n", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"line 1.*: expected as many values as the lines below have"):
        read_cloud_file(path)


@pytest.mark.parametrize("first", ["3.2.1 of a program", "scan 2026-11-30", "mm", "2026-11-30"])
def test_words_above_the_table_are_kept_apart(tmp_path: Path, first: str) -> None:
    path = tmp_path / "a.xyz"
    path.write_text(first + "\n" + "1 2 3\n4 5 6\n", encoding="utf-8")
    found = read_cloud_file(path)
    assert len(found.points) == 2 and "1 line above the table" in found.kind


def test_single_origin_and_planes_are_kept(tmp_path: Path) -> None:
    lattice = np.array(list(itertools.product(range(5), repeat=3)), float)
    (tmp_path / "a.xyz").write_text("\n".join(" ".join(map(str, point)) for point in lattice.tolist()))
    found = read_cloud_file(tmp_path / "a.xyz")
    assert len(found.points) == len(lattice)
    assert not found.warnings


def test_plane_of_repeated_heights_is_kept_and_said(tmp_path: Path) -> None:
    """A flat face in coarse steps above a rough one is no value of missing points."""
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(0, 60, (200, 2)), rng.uniform(-0.05, 0.05, 200)])
    points[:80, 2] = 10.0
    (tmp_path / "a.xyz").write_text("\n".join(" ".join(map(str, point)) for point in points.tolist()))
    found = read_cloud_file(tmp_path / "a.xyz")
    assert len(found.points) == 200
    assert "80 points have z = 10, apart from all others" in found.warnings[0]


@pytest.mark.parametrize(("unit", "factor"), [(None, 1.0), ("mm", 1.0), ("m", 1e3), ("inch", 25.4)])
def test_unit_of_the_cloud(tmp_path: Path, unit: str | None, factor: float) -> None:
    write_pcd(tmp_path / "a.pcd", POINTS, LAYOUTS[1], "binary")
    np.testing.assert_allclose(read(tmp_path / "a.pcd", unit), POINTS * factor)


def test_far_points_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("500000123.5 5400000455.9 300015.3\n" * 3)
    with pytest.raises(DescriptionError, match=r"a\.xyz: point 1 .* 5400 km .*1000 km"):
        read_cloud_file(tmp_path / "a.xyz")


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las_of_other_programs(tmp_path: Path, suffix: str) -> None:
    las = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    las.header.scales = np.full(3, 1e-4)
    las.x, las.y, las.z = POINTS.T
    las.withheld = np.arange(37) == 4
    las.write(tmp_path / f"a.{suffix}")
    found = read_cloud_file(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(1e3 * found.points, np.delete(POINTS, 4, 0), atol=1e-9)
    assert found.dropped == {"withheld": 1}
    data = (tmp_path / f"a.{suffix}").read_bytes()
    (tmp_path / f"b.{suffix}").write_bytes(data[:-40])
    with pytest.raises(DescriptionError, match=r"b\.la"):
        read_cloud_file(tmp_path / f"b.{suffix}")


def test_e57_with_pose_and_invalid_points(tmp_path: Path) -> None:
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        columns = {f"cartesian{axis}": POINTS[:, k] / 1e3 for k, axis in enumerate("XYZ")}
        columns["cartesianInvalidState"] = (np.arange(37) < 2).astype(np.int8) * 2
        file.write_scan_raw(columns, rotation=np.array([1.0, 0, 0, 0]), translation=np.array([1.0, 2.0, 3.0]))
    found = read_cloud_file(tmp_path / "a.e57")
    np.testing.assert_allclose(1e3 * found.points, POINTS[2:] + np.array([1e3, 2e3, 3e3]), atol=1e-6)
    assert found.dropped == {"marked as invalid": 2}


def surface(separator: str, decimal: str, rows: int = 4) -> str:
    x, y = np.arange(5) * 0.5, np.arange(rows) * 0.25
    lines = ["Info", "Frame,Row Count,Column Count".replace(",", separator), f"1,{rows},5".replace(",", separator)]
    lines.append(separator.join(["Y\\X", *(f"{v:.3f}" for v in x)]))
    for k, v in enumerate(y):
        heights = [f"{0.1 * i + v:.4f}" if (i, k) != (2, 1) else "" for i in range(5)]
        lines.append(separator.join([f"{v:.3f}", *heights]))
    lines.append("End")
    return "\n".join(lines).replace(".", decimal)


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", ","), ("\t", ".")])
def test_surface_as_a_matrix(tmp_path: Path, separator: str, decimal: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(surface(separator, decimal))
    found = read_cloud_file(path)
    x, y, z = 1e3 * found.points.T
    np.testing.assert_allclose(z, 0.2 * x + y, atol=1e-9)
    assert (found.records, dict(found.dropped)) == (20, {"without a height": 1})
    path.write_text(surface(separator, decimal).replace(f"1{separator}4{separator}5", f"1{separator}6{separator}5"))
    with pytest.raises(DescriptionError, match="row_count"):
        read_cloud_file(path)


def test_content_decides_and_names_that_contradict_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_bytes(ply(POINTS, "<"))
    np.testing.assert_allclose(read(tmp_path / "a.xyz"), POINTS)
    (tmp_path / "a.pcd").write_text("1 2 3\n")
    with pytest.raises(DescriptionError, match="PCD"):
        read_cloud_file(tmp_path / "a.pcd")


@pytest.mark.parametrize("kind", FORMATS)
def test_mutated_files_are_read_whole_or_refused(kind: str) -> None:
    count = 300 if kind in CLOUDS else 60 if kind == "urdf" else 150
    outcomes, _ = campaign(kind, count, seed=5)
    assert sum(outcomes.values()) == count
    assert min(outcomes["read"], outcomes["refused"]) > 1
