"""Meshes: every kind of broken file is named, good ones arrive in metres, solids have their textbook properties."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from cells import ball, mesh_of

from scancell.errors import MeshError
from scancell.geometry import mesh as meshes
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, load_mesh
from scancell.sensor import closest_points

PLY_HEAD = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
ASCII_STL = (
    "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 {}\nendloop\nendfacet\nendsolid x\n"
)
PLY_POINTS = PLY_HEAD[: PLY_HEAD.index("element face")] + "end_header\n0 0 0\n1 0 0\n0 1 0\n"


def box(size=(0.04, 0.06, 0.1), centre=(0.0, 0.0, 0.0)) -> Mesh:
    return mesh_of(trimesh.creation.box(size, pose.translation(centre)), "box")


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("m", 1.0), ("inch", 0.0254)])
def test_formats_and_units(tmp_path, suffix, unit, metres):
    path = tmp_path / f"PART{suffix.upper()}"
    size = np.array([0.04, 0.06, 0.1])
    trimesh.creation.box(size / metres).export(path, file_type=suffix[1:])
    mesh = load_mesh(path, unit)
    assert np.allclose(np.ptp(mesh.bounds, axis=0), size, rtol=1e-6)
    assert mesh.areas.sum() == pytest.approx(2 * (0.04 * 0.06 + 0.06 * 0.1 + 0.04 * 0.1))
    assert mesh.source == str(path)
    assert mesh.warnings == ()
    assert mesh.orientation == "outward"
    assert len(mesh.vertices) == 8  # an STL file repeats each of them


def test_obj_polygons_texture_indices_and_negative_indices(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text(
        "# both sides of a square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1/1 2//2 3/1 4\nf -1 -2 -3 -4\n"
    )
    mesh = load_mesh(path, "m")
    assert len(mesh.faces) == 4
    assert mesh.areas.sum() == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", b"", "empty"),
        ("a.ply", b"", "empty"),
        ("a.obj", b"", "the file is empty"),
        ("a.stl", b"hello world\n", "begins with 'hello world'; expected 'solid'"),
        ("a.stl", b"solid x\nendsolid x\n", "no triangles"),
        ("a.stl", bytes(84), "no triangles"),
        ("a.stl", bytes(80) + b"\xff\xff\xff\xee" + bytes(50), "(not a readable|holds no) STL"),
        ("a.stl", bytes(range(1, 256)) * 50, "(not a readable|holds no) STL"),
        ("a.stl", ASCII_STL.format("foo 0").encode(), "(not a readable|holds no) STL"),
        ("a.stl", ASCII_STL.format("nan 0").encode(), r"vertex 2 is .*nan"),
        ("a.obj", b"garbage\n", "'garbage' is not a statement that is known"),
        ("a.obj", bytes(range(256)) * 50, "OBJ mesh"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", r"face 0 uses vertex \[0, 1, 8\].*0 to 2"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", r"face 0 uses vertex \[-1"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -7\n", "face 0 uses"),
        ("a.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "expected x, y and z"),
        ("a.obj", b"v 0 0 zero\nf 1 1 1\n", "not a readable OBJ"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv inf 1 0\nf 1 2 3\n", r"vertex 2 is .*inf"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 2\n", "all 2 triangles are degenerate"),
        ("a.ply", (PLY_HEAD + "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n").encode(), r"face 0 uses vertex \[0, 1, 7\]"),
        ("a.ply", (PLY_HEAD + "0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n").encode(), "face 0 uses vertex"),
        ("a.ply", (PLY_HEAD + "0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n").encode(), "vertex 2 is"),
        ("a.ply", PLY_POINTS.encode(), "no triangles"),
        ("a.ply", b"ply\n" + bytes(range(256)) * 50, "not a readable PLY"),
        ("a.ply", PLY_HEAD.replace("vertex 3", "vertex 4000000000").encode() + b"0 0 0\n", "truncated"),
        ("a.3mf", b"PK", "not a mesh format"),
        ("a", b"solid", "no suffix"),
    ],
)
def test_broken_files_get_one_clear_message(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_folders_and_units(tmp_path):
    with pytest.raises(MeshError, match="no such file"):
        load_mesh(tmp_path / "absent.stl")
    with pytest.raises(MeshError, match="is a folder; expected a regular file"):
        load_mesh(tmp_path)
    (tmp_path / "a.stl").write_bytes(b"")
    with pytest.raises(MeshError, match="unit = 'cm': expected one of mm, m, inch"):
        load_mesh(tmp_path / "a.stl", "cm")


def test_degenerate_triangles_among_good_ones_are_accepted(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 1 2\n")
    assert len(load_mesh(path).faces) == 2


@pytest.mark.parametrize("repeated", [slice(0, 1), slice(3, 9), slice(None)])
def test_repeated_faces_are_removed(tmp_path, repeated):
    solid = trimesh.creation.box((40, 60, 100))
    faces = np.asarray(solid.faces)
    again = np.roll(faces[repeated], 1, axis=1)  # begins with another vertex
    trimesh.Trimesh(solid.vertices, np.concatenate([faces, again]), process=False).export(tmp_path / "box.stl")
    mesh = load_mesh(tmp_path / "box.stl")
    assert mesh.is_closed
    assert mesh.areas.sum() == pytest.approx(2 * (24 + 40 + 60) * 1e-4)
    np.testing.assert_allclose(mesh.vertices[mesh.faces] * 1e3, solid.vertices[faces], atol=1e-5)
    (remark,) = mesh.warnings
    assert f"{len(again)} of {12 + len(again)} faces repeat another" in remark


def test_faces_without_area_beside_a_closed_surface_are_removed(tmp_path):
    """Collinear corners in the middle of the list, of vertices of the solid and of others, in a turned solid."""
    solid = trimesh.creation.box((40, 60, 100), pose.from_rotation(pose.exp_rotation(np.array([0.3, -0.5, 0.7]))))
    corners = solid.vertices[solid.faces]
    edges = corners[[0, 5, 7], :2]
    flat = np.concatenate([edges, edges.mean(1, keepdims=True)], axis=1)
    written = np.concatenate([corners[:6], flat, corners[6:]])
    trimesh.Trimesh(written.reshape(-1, 3), np.arange(written.size // 3).reshape(-1, 3), process=False).export(
        tmp_path / "box.stl"
    )
    mesh = load_mesh(tmp_path / "box.stl")
    assert mesh.orientation == "outward"
    assert len(mesh.faces) == 12
    (remark,) = mesh.warnings
    assert "3 of 15 faces have no area and were removed" in remark


def test_open_part_far_from_the_origin_keeps_its_faces(tmp_path):
    """In coordinates of a map, m, whose rounding in single precision exceeds the part; a stray vertex is no face's."""
    box = trimesh.creation.box((0.04, 0.06, 0.1))
    box.apply_translation([412_000.25, 5_921_000.5, 31.0])
    path = tmp_path / "far.obj"
    rows = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in [*box.vertices, (9e9, 0, 0)]]
    path.write_text("\n".join(rows + ["f {} {} {}".format(*face) for face in box.faces[:-1] + 1]) + "\n")
    mesh = load_mesh(path, "m")
    assert len(mesh.faces) == 11
    assert not any("no area" in remark for remark in mesh.warnings)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([0.04, 0.06, 0.1], abs=1e-8)


@pytest.mark.parametrize("error", [1e-17, 1e-7])
def test_seams_of_rounding_are_closed_and_wider_gaps_stay(tmp_path, error):
    """As a CAD program writes them: the corners of each face have their own rounding errors."""
    cube = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    corners = cube.triangles + np.random.default_rng(1).normal(0.0, error, (12, 3, 3))
    corners[0] += 1e-4  # far beyond rounding
    path = tmp_path / "cube.ply"  # STL files have single precision
    trimesh.Trimesh(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False).export(path)
    gap = load_mesh(path, "m")
    assert not gap.is_closed
    assert gap.warnings
    corners[0] -= 1e-4
    trimesh.Trimesh(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False).export(path)
    mesh = load_mesh(path, "m")
    assert mesh.is_closed
    assert mesh.warnings == ()
    assert len(mesh.vertices) == 8


def test_both_sides_of_a_sheet_are_kept(tmp_path):
    faces = np.array([[0, 1, 2], [2, 1, 0], [0, 2, 3], [3, 2, 0]])
    corners = np.array([[0, 0, 0], [50, 0, 0], [50, 40, 0], [0, 40, 0]], float)
    trimesh.Trimesh(corners, faces, process=False).export(tmp_path / "sheet.stl")
    assert len(load_mesh(tmp_path / "sheet.stl").faces) == 4


def test_clustering_keeps_the_shape_within_the_grid():
    fine = mesh_of(trimesh.creation.icosphere(6, 0.025))
    coarse = meshes.clustered(fine, 2e-3)
    assert len(coarse.faces) < len(fine.faces) / 8
    assert set(map(tuple, coarse.vertices)) <= set(map(tuple, fine.vertices))
    triangles = coarse.vertices[coarse.faces]
    assert np.abs(np.linalg.norm(triangles.mean(1), axis=1) - 0.025).max() < 4e-3
    assert meshes.mass_properties(coarse, 1.0).mass == pytest.approx(meshes.mass_properties(fine, 1.0).mass, rel=0.1)
    assert meshes.clustered(fine, 1.0) is fine


def test_mass_properties_of_a_box():
    size = np.array([0.04, 0.06, 0.1])
    centre = np.array([0.2, -0.1, 0.3])
    properties = meshes.mass_properties(box(size, centre), 2700.0)
    mass = 2700.0 * size.prod()
    assert properties.mass == pytest.approx(mass)
    assert np.allclose(properties.centre_of_mass, centre)
    expected = mass / 12 * np.diag((size**2).sum() - size**2)
    assert np.abs(properties.inertia - expected).max() < 1e-9 * mass


def test_mass_of_an_inside_out_box_and_of_an_open_one():
    whole = box()
    turned = Mesh(whole.vertices, whole.faces[:, ::-1], "inside out")
    lidless = Mesh(whole.vertices, whole.faces[2:], "open")
    for mesh in (turned, lidless):
        assert meshes.mass_properties(mesh, 1000.0).mass == pytest.approx(1000.0 * 0.04 * 0.06 * 0.1)


def test_hull_of_a_flat_mesh_is_refused():
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), "sheet.stl")
    with pytest.raises(MeshError, match=r"sheet\.stl.*no volume"):
        _ = flat.hull


def test_hull_of_many_points_is_light_and_holds_them():
    made = trimesh.creation.icosphere(7, 0.05)
    fine = Mesh(np.asarray(made.vertices) * [1.0, 0.6, 0.2], np.asarray(made.faces, np.int64), "ellipsoid")
    assert len(fine.vertices) > 50_000
    hull = fine.hull
    assert len(hull.faces) < len(fine.faces) / 4
    assert hull.orientation == "outward"
    _, _, outside = closest_points(hull.vertices, hull.faces.astype(np.uint32), fine.vertices)
    assert outside.max() < 1e-4 * 0.1 * (1 + 1e-9)


def test_hulls_look_outwards():
    rng = np.random.default_rng(3)
    for scale in ([1.0, 1.0, 1.0], [1.0, 0.3, 1e-3]):
        points = rng.normal(size=(500, 3)) * scale * 0.02 + 0.3
        hull = Mesh(points, np.arange(498).reshape(-1, 3)).hull
        assert hull.orientation == "outward"
        assert (hull.bounds == [points[:498].min(0), points[:498].max(0)]).all()


def test_reading_a_binary_stl_file_needs_no_trimesh(tmp_path):
    trimesh.creation.box((40, 60, 100)).export(tmp_path / "a.stl")
    program = (
        "import sys; from scancell.geometry.mesh import load_mesh, mass_properties; "
        f"mesh = load_mesh({str(tmp_path / 'a.stl')!r}); mesh.hull, mass_properties(mesh, 1.0); "
        "sys.exit('trimesh' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_stable_poses():
    upright = pose.translation((0, 0, 0.05))
    assert meshes.is_stable_pose(box(), upright)
    on_edge = pose.from_rotation(pose.rotation_about(0, np.pi / 4))
    assert not meshes.is_stable_pose(box(), on_edge)
    # A tetrahedron whose apex hangs far beyond its base topples; within it, it stands.
    base = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    for apex, stands in (([0.03, 0.03, 0.1], True), ([0.3, 0.3, 0.1], False)):
        leaning = Mesh(np.array([*base, apex], float), faces, "tetrahedron")
        assert meshes.is_stable_pose(leaning, np.eye(4)) == stands
    assert not meshes.is_stable_pose(ball(0.02), pose.from_rotation(pose.rotation_about(0, 0.1)))
