"""Occupied space from voxels and clouds: bodies of planning."""

from __future__ import annotations

import numpy as np
import pytest
from cells import CYCLE, RANGE, ball, cloud_of

from scancell.config.loading import load_setup
from scancell.errors import DescriptionError
from scancell.geometry.mesh import box_mesh
from scancell.geometry.voxels import VoxelGrid
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell
from scancell.planning.space_map import read_voxels, with_occupied_space, write_voxels
from scancell.reconstruction.cloud_files import FORMATS, write_cloud
from scancell.reconstruction.cloud_files.read import read_cloud_file
from scancell.scanner import Scanner

BLOCK = box_mesh((0.04, 0.03, 0.02), "block")


def random_grid(seed: int, filled: float) -> VoxelGrid:
    rng = np.random.default_rng(seed)
    return VoxelGrid(rng.uniform(-1, 1, 3), 0.01, rng.random((7, 5, 6)) < filled)


def occupied(file, **more) -> str:
    words = "".join(f", {key} = {value}" for key, value in more.items())
    return f'scan.occupied=[{{ file = "{file}"{words} }}]'


@pytest.mark.parametrize("filled", [0.02, 0.5, 1.0])
def test_surface_encloses_the_volume_of_the_occupied_voxels(filled) -> None:
    """By the divergence theorem, about any point; the area counts the faces between occupied and other voxels."""
    grid = random_grid(1, filled)
    mesh = grid.surface()
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(grid.occupied.sum() * 1e-6)
    padded = np.pad(grid.occupied, 1).astype(int)
    faces = sum(np.abs(np.diff(padded, axis=axis)).sum() for axis in range(3))
    assert mesh.areas.sum() == pytest.approx(faces * 1e-4)
    assert len(mesh.faces) <= 2 * faces


def test_full_grid_has_the_surface_of_a_box() -> None:
    grid = VoxelGrid(np.zeros(3), 0.01, np.ones((20, 30, 40), bool))
    assert len(grid.surface().faces) == 12


def test_space_within_the_inflation_of_a_point_is_occupied() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.05, 0.05, (40, 3))
    grid = VoxelGrid.around(points, 0.004, 0.011)
    away = rng.normal(size=(40, 500, 3))
    away *= 0.011 * rng.random((40, 500, 1)) ** (1 / 3) / np.linalg.norm(away, axis=-1, keepdims=True)
    near = (points[:, None] + away).reshape(-1, 3)
    assert grid.contains(near).all()
    assert grid.occupied[tuple(grid.index(near).T)].all()
    # Nothing farther than the inflation and two diagonals of a voxel is.
    filled = grid.centres[grid.occupied]
    distance = np.linalg.norm(filled[:, None] - points, axis=-1).min(1)
    assert distance.max() <= 0.011 + 2 * np.sqrt(3) * 0.004


def test_voxels_are_read_as_written(tmp_path) -> None:
    grids = {"world": random_grid(3, 0.3), "table": random_grid(4, 0.3)}
    write_voxels(tmp_path / "survey.npz", grids, note=np.array("a survey"))
    read = read_voxels(tmp_path / "survey.npz")
    assert set(read) == set(grids)
    for frame, grid in grids.items():
        np.testing.assert_allclose(read[frame].origin, grid.origin, atol=1e-15)
        assert read[frame].spacing == pytest.approx(grid.spacing)
        np.testing.assert_array_equal(read[frame].occupied, grid.occupied)


@pytest.mark.parametrize("kind", FORMATS)
def test_points_of_every_cloud_file_are_read(tmp_path, kind) -> None:
    points = np.random.default_rng(5).uniform(-0.1, 0.1, (200, 3))
    write_cloud(tmp_path / f"cloud.{kind}", cloud_of(points))
    np.testing.assert_allclose(read_cloud_file(tmp_path / f"cloud.{kind}").points, points, atol=2e-8)


@pytest.mark.parametrize(("frame", "moves_with"), [("world", "world"), ("base", "world"), ("table", "table")])
def test_cloud_becomes_a_body_in_its_frame(tmp_path, frame, moves_with) -> None:
    points = np.random.default_rng(6).uniform(-0.02, 0.02, (50, 3)) + np.array([0.1, 0.2, 0.3])
    write_cloud(tmp_path / "cloud.ply", cloud_of(points))
    setup = load_setup(settings=[occupied(tmp_path / "cloud.ply", frame=f'"{frame}"', voxel_mm=2)])
    nominal = nominal_cell(setup.cell, BLOCK)
    body = with_occupied_space(nominal, setup.scan.occupied).bodies[-1]
    assert (body.name, body.moves_with) == ("occupied[1]", moves_with)
    low, high = body.mesh.bounds
    assert (low <= points.min(0)).all()
    assert (high >= points.max(0)).all()
    assert (high - low <= np.ptp(points, axis=0) + 2 * 0.002 + 1e-9).all()


def test_cloud_in_the_frame_of_the_part_lies_on_the_part(tmp_path) -> None:
    points = ball().vertices
    write_cloud(tmp_path / "cloud.npz", cloud_of(points))
    words = [occupied(tmp_path / "cloud.npz", voxel_mm=1), "cell.part.x_mm=40"]
    setup = load_setup(settings=words)
    body = with_occupied_space(nominal_cell(setup.cell, ball()), setup.scan.occupied).bodies[-1]
    np.testing.assert_allclose(body.mesh.bounds.mean(0), [0.04, 0.0, 0.025], atol=1e-3)
    assert body.moves_with == "table"


def test_motion_avoids_a_measured_post(tmp_path) -> None:
    """A motion that is free in the cell as described passes through the points of a post."""
    rng = np.random.default_rng(7)
    post = rng.uniform([0.30, 0.39, 0.1], [0.32, 0.41, 0.35], (5000, 3))
    write_cloud(tmp_path / "cloud.xyz", cloud_of(post))
    setup = load_setup(settings=[occupied(tmp_path / "cloud.xyz", frame='"world"', inflate_mm=3)])
    nominal = nominal_cell(setup.cell, BLOCK)
    start = np.append(nominal.home, 0.0)
    end = start + np.radians([35.0, 0, 0, 0, 0, 0, 0])
    cells = [nominal, with_occupied_space(nominal, setup.scan.occupied)]
    free, clash = (PlanningCell(c, RANGE, CYCLE).motion_check(0.005).first_clashes(start, end)[0] for c in cells)
    assert free is None
    assert clash is not None
    assert {clash.body_a, clash.body_b} == {"sensor", "occupied[1]"}


def test_measured_space_around_the_arm_is_not_ignored(tmp_path) -> None:
    """Pairs that always intersect are left out by construction; measured space never is, but for the platter."""
    write_voxels(tmp_path / "v.npz", {"world": VoxelGrid(np.full(3, -0.15), 0.05, np.ones((6, 6, 20), bool))})
    setup = load_setup(settings=[occupied(tmp_path / "v.npz")])
    cell = PlanningCell(with_occupied_space(nominal_cell(setup.cell, BLOCK), setup.scan.occupied), RANGE, CYCLE)
    with_space = {pair[0] for pair in cell.proximity.pairs if pair[1] == "occupied[1]"}
    assert with_space == {*(f"link{i}" for i in range(1, 7)), "sensor", "table", "part"}


def bad_voxels(tmp_path, **changes):
    arrays = {
        "kind": np.array("scancell voxels 1"),
        "world_origin_mm": np.zeros(3),
        "world_spacing_mm": np.array(10.0),
        "world_occupied": np.ones((2, 2, 2), bool),
        **changes,
    }
    np.savez(tmp_path / "bad.npz", **{key: value for key, value in arrays.items() if value is not None})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": np.array("other")}, "kind = 'other': expected 'scancell voxels 1'"),
        ({"kind": None}, "expected an array points_in_part_mm; found world_origin_mm"),
        ({"world_occupied": None}, "expected an array world_occupied, table_occupied or fixed"),
        ({"world_spacing_mm": None}, "lacks the array world_spacing_mm"),
        ({"world_origin_mm": np.array([0.0, np.nan, 0.0])}, "world_origin_mm = .*: expected 3 finite numbers"),
        ({"world_spacing_mm": np.array(-1.0)}, r"world_spacing_mm = -1.0: expected a positive number"),
        ({"world_occupied": np.ones((2, 2))}, r"world_occupied: float64 of shape \(2, 2\); expected bool with three"),
    ],
)
def test_wrong_voxel_file_is_refused_by_name_and_array(tmp_path, changes, message) -> None:
    bad_voxels(tmp_path, **changes)
    setup = load_setup(settings=[occupied(tmp_path / "bad.npz")])
    with Scanner(setup=setup) as scanner, pytest.raises(DescriptionError, match=message) as caught:
        scanner.plan(BLOCK)
    assert str(tmp_path / "bad.npz") in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cloud.xyz", "1 2 nan\n", "holds no usable point: of 1, 1 not finite"),
        ("cloud.xyz", "one two three\n", "lacks a column of positions"),
        ("cloud.xyz", "", "the file is empty"),
        ("cloud.npz", "no archive", "not a file of voxels or points"),
        ("cloud.ply", "ply\nformat ascii 1.0\nend_header\n", "no element vertex with x, y and z"),
        ("cloud.pcd", "VERSION 0.7\n", "has no line DATA"),
        ("cloud.step", "", "the file is empty"),
        ("cloud.xyz", "0 0 0\n900000 900000 900000\n", "voxels of 5 mm would be needed"),
    ],
)
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_wrong_cloud_is_refused_by_name(tmp_path, name, content, message) -> None:
    (tmp_path / name).write_text(content)
    setup = load_setup(settings=[occupied(tmp_path / name)])
    with Scanner(setup=setup) as scanner, pytest.raises(DescriptionError, match=message) as caught:
        scanner.plan(BLOCK)
    assert str(tmp_path / name) in str(caught.value)


def test_missing_file_of_occupied_space_is_refused_by_key() -> None:
    with pytest.raises(DescriptionError, match=r"occupied\[1\].file = 'nothing.npz': no such file"):
        load_setup(settings=[occupied("nothing.npz")])
