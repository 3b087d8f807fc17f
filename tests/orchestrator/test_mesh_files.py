"""Mesh files as other programs write them: every record is read, or the file is refused with the reason."""

import struct

import numpy as np
import pytest

from bench.mesh_files import generated
from scancell.errors import MeshError
from scancell.geometry.mesh import load_mesh
from scancell.geometry.mesh_files import read_mesh, read_ply_points

# A prism over an L: 4300 mm², 15,000 mm³.
CORNERS = [(0, 0), (40, 0), (40, 12), (15, 12), (15, 30), (0, 30)]
VERTICES = np.array([(x, y, z) for z in (0, 20) for x, y in CORNERS], float)
POLYGONS = [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *([k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6))]
TRIANGLES = [(5, 4, 3), (5, 3, 0), (3, 2, 1), (3, 1, 0), (6, 9, 11), (9, 10, 11), (6, 7, 9), (7, 8, 9)] + [
    t for a, b, c, d in POLYGONS[2:] for t in ((a, b, c), (a, c, d))
]
FACETS = [
    "facet normal 0 0 0\nouter loop\n"
    + "".join("vertex {} {} {}\n".format(*VERTICES[k]) for k in triangle)
    + "endloop\nendfacet\n"
    for triangle in TRIANGLES
]
STL = "solid a\n" + "".join(FACETS[:8]) + "endsolid a\nsolid b\n" + "".join(FACETS[8:]) + "endsolid b\n"
OBJ = "".join("v {} {} {}\n".format(*v) for v in VERTICES) + "".join(
    "f " + " ".join(str(k + 1) for k in polygon) + "\n" for polygon in POLYGONS
)
PLY_HEAD = (
    "ply\nformat {}\nelement vertex 12\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 8\nproperty list {} vertex_indices\nend_header\n"
)
PLY_ROWS = "".join("{} {} {}\n".format(*v) for v in VERTICES) + "".join(
    f"{len(p)} {' '.join(map(str, p))}\n" for p in POLYGONS
)
PLY = PLY_HEAD.format("ascii 1.0", "uchar int") + PLY_ROWS


def binary_ply(order: str, length: str = "B", index: str = "i") -> bytes:
    names = {"B": "uchar", "H": "ushort", "i": "int", "I": "uint", "f": "float"}
    form = "binary_little_endian 1.0" if order == "<" else "binary_big_endian 1.0"
    body = VERTICES.astype(order + "f4").tobytes()
    body += b"".join(struct.pack(f"{order}{length}{len(p)}{index}", len(p), *p) for p in POLYGONS)
    return PLY_HEAD.format(form, f"{names[length]} {names[index]}").encode() + body


WHOLE = [
    ("a.stl", STL),
    ("a.stl", STL.replace("\n", "\r\n")),
    ("a.stl", STL.replace("\n", "\r")),
    ("a.stl", STL.replace("\n", "  ")),
    ("a.stl", STL.upper()),
    ("a.stl", "\n\n \t" + STL.replace("\n", "\n\t ")),
    ("a.stl", STL.replace("endsolid", "end solid")),
    ("a.stl", STL.replace(" a\n", " vertex facet of a solid\n").replace("endsolid b", "endsolid")),
    ("a.stl", b"\xef\xbb\xbf" + STL.replace(" a\n", " T\xfcr\n").encode("latin-1")),
    ("a.stl", STL.encode("utf-16")),
    ("a.stl", STL.replace("0 0 0\nouter", "1.#QNAN nan -1.#IND\nouter")),
    ("a.stl", "# made by x\n" + STL.replace("endfacet\n", "endfacet # vertex 1 2 3\n") + "\n\n\x1a\0\0"),
    ("a.obj", OBJ),
    ("a.obj", OBJ.replace("\n", "\r\n")),
    ("a.obj", OBJ.replace("\n", "\r")),
    ("a.obj", b"\xef\xbb\xbf# L\xe4nge C:\\\\\n" + OBJ.encode()),
    ("a.obj", OBJ.replace("v ", " \tv\t").replace("f ", "  f  ")),
    ("a.obj", OBJ.replace("\nf", " # comment\nf").replace(" 6 5", " 6 \\\r\n\t5").replace(" 3 2", " 3 \\  \n 2")),
    ("a.obj", "g folder\\\nmtllib C:\\x\\\n" + OBJ.replace("\nv", "\nvn 0 0 1\nvt 0 0\nv", 3) + "s off\nl 1 2\n"),
    ("a.obj", OBJ.replace("f 6 5", "f 6/1/1 5//2").replace("4 3", "4/ 3/7")),
    ("a.obj", OBJ.replace(".0\n", ".0 0.5 0.5 1\n").replace("f 7 8", "f -6 -5")),
    ("a.obj", OBJ.encode("utf-16")),
    ("a.ply", PLY),
    ("a.ply", PLY.replace("\n", "\r\n")),
    ("a.ply", PLY.replace("\n", "\r")),
    ("a.ply", PLY.replace("\n", "\n  \n ").replace(" ", "\t ")),
    ("a.ply", PLY.replace("ascii 1.0\n", "ascii 1.0\ncomment end_header\nobj_info T\xfcr\n").encode("latin-1")),
    ("a.ply", PLY.replace("vertex_indices", "vertex_index").replace("float", "double")),
    ("a.ply", PLY.replace("end_", "element edge 1\nproperty int a\nproperty int b\nend_") + "0 1\n"),
    ("a.ply", binary_ply("<")),
    ("a.ply", binary_ply(">", "H", "I")),
    ("a.ply", binary_ply("<", "i")),
    ("a.ply", binary_ply("<") + b"\n\0"),
]


@pytest.mark.parametrize(("name", "content"), WHOLE)
def test_files_of_other_programs_are_read_whole(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
    mesh = load_mesh(path)
    assert mesh.areas.sum() == pytest.approx(4300e-6, rel=1e-9)
    assert np.linalg.det(mesh.vertices[mesh.faces]).sum() / 6 == pytest.approx(15000e-9, rel=1e-9)
    assert mesh.orientation == "outward"
    assert mesh.warnings == ()


BINARY_STL = bytes(80) + (2).to_bytes(4, "little") + bytes(100)
REFUSED = [
    ("a.stl", STL[:-60], "expected 'endsolid', or a facet of three vertices, after 11 facets"),
    ("a.stl", STL.removesuffix("endsolid b\n"), "no 'endsolid': the file is incomplete"),
    ("a.stl", STL.replace("endsolid a\n", ""), "after 8 facets; found 'solid b'"),
    ("a.stl", STL.replace("endloop", "vertex 0 0 0\nendloop", 1), "a facet of three vertices, after 0 facets"),
    ("a.stl", STL + "facet", "expected 'solid' or the end of the file, found 'facet'"),
    ("a.stl", STL.replace("40.0 ", "4O.0 ", 1), "'4o.0' is not a number"),
    ("a.stl", STL.replace("40.0", "40-0", 1), "'40-0' is not a number"),
    ("a.stl", STL.replace(".0", ",0"), "no comma"),
    ("a.stl", BINARY_STL[:-1], "2 triangles, which take 184 bytes; the file has 183 bytes: it is truncated"),
    ("a.stl", BINARY_STL + b"\0", "the file has 185 bytes: it holds more"),
    ("a.stl", b"solid" + BINARY_STL[5:-1], "it is truncated"),
    ("a.stl", bytes(10), "it has 10 bytes"),
    ("a.stl", b"PK\3\4" + bytes(100), "ZIP archive"),
    ("a.stl", "ISO-10303-21;\n", "STEP"),
    ("a.obj", "version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
    ("a.ply", "\n<!DOCTYPE HTML>", "HTML"),
    ("a.stl", PLY, "it is a PLY file"),
    ("a.ply", STL, "it is an STL file"),
    ("a.obj", OBJ.replace("v 40.0 0.0 0.0\n", "vv 40.0 0.0 0.0\n"), "'vv 40.0 0.0 0.0' is not a statement"),
    ("a.obj", OBJ + "curv2 1 2\n", "'curv2 1 2' is not a statement"),
    ("a.obj", OBJ + "f 1 2 \\", "the last line is continued"),
    ("a.obj", OBJ.replace("f 7 8", "f 7 /8"), "'/8' is not an integer"),
    ("a.obj", OBJ.replace("f 7 8", "f 7 8.5"), "'8.5' is not an integer"),
    ("a.obj", OBJ.replace(".0\n", ".0 2\n", 1), "a weight of 1"),
    ("a.obj", OBJ.replace(".", ","), "no comma"),
    ("a.obj", OBJ + "f 1 2\n", "face 8 has 2 corners"),
    ("a.obj", OBJ + "f 1 2 3 13\n", r"face 8 uses vertex \[0, 1, 2, 12\], but the vertices are 0 to 11"),
    ("a.obj", OBJ + "f 1 2 3 7\n", "not plane"),
    ("a.obj", OBJ + "f 1 3 2 6\n", "not simple"),
    ("a.obj", OBJ + "f 1 2 3 6 1 2 3 6\n", "not simple"),
    ("a.ply", PLY[:-5], "row 8 of the 8 rows of element face"),
    ("a.ply", PLY.removesuffix("4 5 0 6 11\n"), "20 rows, but 19 lines follow: the file is truncated"),
    ("a.ply", PLY + "3 0 1 2\n", "counts 20 rows, but 21 lines follow: the file is longer"),
    ("a.ply", PLY.replace("4 5 0 6 11", "4 5 0 6 11 9"), "is no row of element face"),
    ("a.ply", PLY.replace("uchar int", "uchar float").replace("4 5 0 6 11", "4 5 0 6 1e999"), "are not integers"),
    ("a.ply", PLY.replace("uchar int", "uchar float").replace("4 5 0 6 11", "4 5 0 6 nan"), "are not integers"),
    ("a.ply", PLY.replace("element vertex 12", "element vertex 11"), "counts 19 rows, but 20 lines follow"),
    ("a.ply", PLY.replace("element face", "element vertex"), "not known, or stands there twice"),
    ("a.ply", PLY.replace("float x", "real x"), "'property real x'"),
    ("a.ply", PLY.replace("float x", "float u"), "x, y and z"),
    ("a.ply", PLY.replace("vertex_indices", "indices"), "expected a list vertex_indices"),
    ("a.ply", PLY.replace("ascii", "text"), "'format text 1.0'"),
    ("a.ply", PLY.replace("face", "tristrips"), "triangle strips"),
    ("a.ply", PLY.replace("end_header", "end header"), "no 'end_header'"),
    ("a.ply", PLY.replace("end_header", "element big 4000000000\nend_header"), "without properties"),
    ("a.ply", binary_ply("<")[:-1], "row 8 of the 8 rows of element face: the file is truncated"),
    ("a.ply", binary_ply("<", "i").replace(struct.pack("<3i", 6, 5, 4), struct.pack("<3i", -6, 5, 4)), "has -6 items"),
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("name", "content", "reason"), REFUSED)
def test_files_that_cannot_be_read_whole_are_refused_with_the_reason(tmp_path, name, content, reason):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode("latin-1"))
    with pytest.raises(MeshError, match=reason) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_bytes_behind_the_data_of_a_binary_ply_file_are_reported(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(binary_ply("<") + b"more")
    mesh = load_mesh(path)
    assert mesh.areas.sum() == pytest.approx(4300e-6)
    assert mesh.warnings == (f"{path}: 4 bytes behind the data of the last element were ignored",)


def test_polygons_that_are_nearly_plane_are_reported(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(OBJ.replace("v 40.0 12.0 20.0", "v 40.0 12.0 20.1"))
    (remark,) = load_mesh(path).warnings
    assert "1 of 8 faces are not plane" in remark


def test_points_of_ply_files(tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(binary_ply(">"))
    points, remarks = read_ply_points(path)
    np.testing.assert_array_equal(points, VERTICES)
    assert remarks == ()
    path.write_text(PLY[: PLY.index("element face")] + "end_header\n" + "1 2 3\n" * 11)
    with pytest.raises(MeshError, match="12 rows, but 11 lines follow: the file is truncated"):
        read_ply_points(path)


def test_triangles_keep_the_order_of_the_faces(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(OBJ + "f 1 2 3\n")
    _, faces, _ = read_mesh(path)
    owners = [next(k for k, p in enumerate([*POLYGONS, [0, 1, 2]]) if set(f) <= set(p)) for f in faces.tolist()[:-1]]
    assert owners == sorted(owners)
    assert faces[-1].tolist() == [0, 1, 2]


def test_generated_files_have_their_exact_area_and_volume():
    outcomes = generated(20)
    assert sum(outcomes.values()) == 20
    assert sum(number for outcome, number in outcomes.items() if "refused" in outcome) <= 1
