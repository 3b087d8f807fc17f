"""Winding of meshes: what is certain is repaired, what is not is named, and what is right stays as it is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import export_mm, mesh_of

from scancell.errors import MeshError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, load_mesh, mass_properties
from scancell.geometry.mesh_files import weld
from scancell.geometry.orientation import is_closed, wind_outwards
from scancell.sensor import closest_points

RNG = np.random.default_rng(11)
SIZE = np.array([0.04, 0.06, 0.1])


def inverted(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1], mesh.source)


def together(*meshes: Mesh) -> Mesh:
    """One mesh of several, equal vertices joined."""
    before = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, before, strict=False)])
    first, number = weld(vertices)
    return Mesh(vertices[first], number[faces], "several")


def box(size: float, x: float = 0.0) -> Mesh:
    return box_mesh((size, size, size)).transformed(pose.translation((x, 0.0, 0.0)))


def torus() -> Mesh:
    return mesh_of(trimesh.creation.torus(0.03, 0.01, major_sections=24, minor_sections=16), "torus")


def test_box_mesh_normals_point_outwards():
    mesh = box_mesh(SIZE)
    assert mesh.orientation == "outward"
    assert mesh.areas.sum() == pytest.approx(2 * (SIZE[0] * SIZE[1] + SIZE[1] * SIZE[2] + SIZE[2] * SIZE[0]))
    assert np.allclose(mesh.bounds, [-SIZE / 2, SIZE / 2])
    assert np.allclose(np.sort(np.abs(mesh.normals), axis=1), [0.0, 0.0, 1.0])
    assert mass_properties(mesh, 1000.0).mass == pytest.approx(1000.0 * SIZE.prod())


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95, 1.0])
def test_flipped_faces_are_reoriented(share):
    mesh = torus()
    flipped = RNG.random(len(mesh.faces)) < share
    faces = np.where(flipped[:, None], mesh.faces[:, ::-1], mesh.faces)
    winding = wind_outwards(mesh.vertices, faces)
    assert winding.orientation == "outward"
    assert winding.turned == flipped.sum()
    assert Mesh(mesh.vertices, winding.faces).orientation == "outward"
    # Nothing but the winding has changed.
    assert (np.sort(winding.faces, axis=1) == np.sort(mesh.faces, axis=1)).all()
    before = Mesh(mesh.vertices, faces).orientation
    assert before == ("inward" if flipped.all() else "inconsistent")


def test_consistent_meshes_are_unchanged():
    hollow = together(box(0.1), inverted(box(0.06)))
    island = together(box(0.1), inverted(box(0.06)), box(0.02))
    apart = together(box(0.1), box(0.1, 0.3))
    for mesh in (torus(), hollow, island, apart):
        winding = wind_outwards(mesh.vertices, mesh.faces)
        assert (winding.orientation, winding.turned) == ("outward", 0)
        assert winding.faces is mesh.faces


def test_inverted_hollow_solid_keeps_cavity():
    for shells, volume in (
        ((box(0.1), inverted(box(0.06))), 0.1**3 - 0.06**3),
        ((box(0.1), inverted(box(0.06)), box(0.02)), 0.1**3 - 0.06**3 + 0.02**3),
    ):
        whole = together(*shells)
        winding = wind_outwards(whole.vertices, whole.faces[:, ::-1])
        assert (winding.orientation, winding.turned) == ("outward", len(whole.faces))
        repaired = Mesh(whole.vertices, winding.faces)
        assert mass_properties(repaired, 1000.0).mass == pytest.approx(1000.0 * volume)
        assert (repaired.normals == whole.normals).all()


def test_only_inverted_solid_is_reoriented():
    mesh = together(box(0.1), inverted(box(0.05, 0.3)))
    winding = wind_outwards(mesh.vertices, mesh.faces)
    assert (winding.orientation, winding.turned) == ("outward", 12)
    assert (winding.faces[:12] == mesh.faces[:12]).all()


def test_solids_sharing_edge_are_oriented_separately():
    beside = box(0.1).transformed(pose.translation((0.1, 0.1, 0.0)))
    mesh = together(box(0.1), inverted(beside))
    assert len(mesh.vertices) == 14
    faces = mesh.faces.copy()
    faces[3] = faces[3][::-1]
    winding = wind_outwards(mesh.vertices, faces)
    assert (winding.orientation, winding.turned) == ("outward", 13)


def test_open_mesh_keeps_majority_orientation():
    whole = box_mesh(SIZE)
    lidless = whole.faces[2:]
    assert wind_outwards(whole.vertices, lidless).orientation == "open"
    mixed = lidless.copy()
    mixed[4] = mixed[4][::-1]
    winding = wind_outwards(whole.vertices, mixed)
    assert (winding.orientation, winding.turned, winding.rim) == ("open", 1, 4)
    assert (np.roll(winding.faces[4], -list(winding.faces[4]).index(lidless[4][0])) == lidless[4]).all()
    assert not Mesh(whole.vertices, lidless).is_closed


def test_one_sided_surface_warning():
    turns = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    across = np.stack([np.cos(turns / 2) * np.cos(turns), np.cos(turns / 2) * np.sin(turns), np.sin(turns / 2)], 1)
    middle = np.stack([np.cos(turns), np.sin(turns), 0 * turns], 1)
    vertices = 0.05 * np.concatenate([middle - 0.3 * across, middle + 0.3 * across])
    k = np.arange(19)
    faces = np.concatenate([np.stack([k, k + 1, k + 20], 1), np.stack([k + 1, k + 21, k + 20], 1)])
    strip = np.concatenate([faces, [[19, 20, 39], [20, 0, 39]]])  # closed with half a twist
    winding = wind_outwards(vertices, strip)
    assert winding.orientation == "inconsistent"
    assert winding.contradictory == 40
    assert winding.turned == 0


def test_missing_or_flipped_face_is_detected():
    mesh = torus()
    assert is_closed(mesh.faces)
    for number in RNG.integers(0, len(mesh.faces), 20):
        assert not is_closed(np.delete(mesh.faces, number, axis=0))
        flipped = mesh.faces.copy()
        flipped[number] = flipped[number][::-1]
        assert not is_closed(flipped)


def test_degenerate_faces_keep_mesh_closed():
    mesh = box_mesh(SIZE)
    faces = np.concatenate([mesh.faces[:, ::-1], [[0, 0, 1], [2, 2, 2]]])
    winding = wind_outwards(mesh.vertices, faces)
    assert winding.orientation == "outward"
    assert (winding.faces[:12] == mesh.faces).all()
    faces[0] = faces[0][::-1]
    assert wind_outwards(mesh.vertices, faces).orientation == "outward"


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_inverted_file_is_corrected_with_warning(tmp_path, suffix):
    right = load_mesh(export_mm(box_mesh(SIZE), tmp_path / f"right{suffix}"))
    turned = load_mesh(export_mm(inverted(box_mesh(SIZE)), tmp_path / f"turned{suffix}"))
    assert right.warnings == ()
    assert turned.warnings == (
        f"{tmp_path / f'turned{suffix}'}: all 12 faces pointed into the material and were turned over",
    )
    for mesh in (right, turned):
        points = np.array([[0.0, 0.0, 0.051], [0.0, 0.0, 0.048]])
        _, _, signed = closest_points(mesh.vertices, mesh.faces.astype(np.uint32), points)
        assert np.allclose(signed, [0.001, -0.002])


def test_warnings_count_faces(tmp_path):
    mesh = box_mesh(SIZE)
    half = np.where((np.arange(12) % 4 == 0)[:, None], mesh.faces[:, ::-1], mesh.faces)
    (turned,) = load_mesh(export_mm(Mesh(mesh.vertices, half), tmp_path / "half.stl")).warnings
    assert turned.endswith("half.stl: 3 of 12 faces pointed to the wrong side and were turned over")
    (rim,) = load_mesh(export_mm(Mesh(mesh.vertices, mesh.faces[2:]), tmp_path / "open.stl")).warnings
    assert "open.stl: the surface is not closed (4 edges belong to one face only)" in rim


@pytest.mark.parametrize(
    ("extent", "unit", "hints"),
    [
        (2.0, "mm", ["2 mm", "`unit` inch makes it 50.8 mm"]),
        (3000.0, "mm", ["3 m", "is its unit really mm? (scale the file)"]),
        (100.0, "inch", ["2.54 m", "`unit` mm makes it 100 mm"]),
    ],
)
def test_implausible_size_warning(tmp_path, extent, unit, hints):
    path = export_mm(box_mesh(np.array([0.2, 1.0, 0.5]) * extent * 1e-3), tmp_path / "part.stl")
    (warning,) = load_mesh(path, unit).warnings
    assert all(hint in warning for hint in hints)


@pytest.mark.parametrize(
    ("extent", "unit", "hint"),
    [
        (0.08, "mm", "the largest extent is 0.08 mm: .*`unit` m makes it 80 mm.*; expected 0.5 mm to 5 m"),
        (20_000.0, "mm", "the largest extent is 20 m: .*scale the file.*; expected 0.5 mm to 5 m"),
        (60.0, "m", "the largest extent is 60 m: .*`unit` mm makes it 60 mm; `unit` inch makes it 1.52 m"),
    ],
)
def test_impossible_size_is_rejected(tmp_path, extent, unit, hint):
    path = export_mm(box_mesh(np.array([0.2, 1.0, 0.5]) * extent * 1e-3), tmp_path / "part.stl")
    with pytest.raises(MeshError, match=hint):
        load_mesh(path, unit)


def test_weld_merges_equal_positions_in_order():
    grid = RNG.integers(-3, 4, (5000, 3)).astype(np.float32) * np.float32(0.1)
    grid[RNG.random(5000) < 0.2, 0] = -0.0
    first, number = weld(grid)
    assert (grid[first][number] == grid).all()
    assert len(first) == len(np.unique(grid + 0.0, axis=0))
    assert (np.diff(first) > 0).all()
    assert (first[number] <= np.arange(len(grid))).all()
    close = np.array([[0.0, 0, 0], [np.nextafter(0, 1), 0, 0], [0, 0, 0]])
    assert weld(close)[1].tolist() == [0, 1, 0]
