"""Points of thin parts are told from table points by the nominal footprint of the part."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import mesh_of
from trigger_records import profiles_of, records

from scancell.config.loading import assets_dir
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, load_mesh, sample_surface
from scancell.geometry.shapes import Cone, Cylinder, Sphere
from scancell.reconstruction.foreign import footprint_of
from scancell.reconstruction.reconstruct import Envelope, reconstruct_points, table_warnings

MARGIN = 0.5e-3
NOISE = 5e-6
SIZE = np.array([0.06, 0.04])
TURNED = pose.from_euler_xyz((0.02, 0.01, 0.0), (0.0, 0.0, 0.4))  # on the table


def placed(mesh: Mesh, bottom: float = 0.0) -> Mesh:
    """The mesh with its lowest point at a height."""
    return mesh.transformed(pose.translation((0.0, 0.0, bottom - mesh.bounds[0, 2])))


def sheet(thickness: float, bottom: float = 0.0) -> Mesh:
    return placed(box_mesh((*SIZE, thickness), "sheet"), bottom)


def union(*meshes: Mesh) -> Mesh:
    return mesh_of(trimesh.boolean.union([trimesh.Trimesh(mesh.vertices, mesh.faces) for mesh in meshes]), "union")


FLANGE = union(sheet(0.45e-3), placed(box_mesh((0.02, 0.02, 0.02))))


def measured(part: Mesh, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Noisy points (n, 3) in the frame of a turned part: on its upper sides, on the table; all shifted from nominal."""
    rng = np.random.default_rng(4)
    points, face = sample_surface(part, 40_000, 4)
    x, y = rng.uniform(-0.05, 0.05, (2, 40_000))
    beside = (np.abs(x) > SIZE[0] / 2) | (np.abs(y) > SIZE[1] / 2)
    both = (points[part.normals[face][:, 2] > 0.5], np.stack([x, y, 0 * x], 1)[beside])
    top, table = (one + np.array(shift) + rng.normal(0, NOISE, (len(one), 1)) * [0, 0, 1] for one in both)
    return top, table


def kept(part: Mesh, points: np.ndarray, margin: float = MARGIN):
    """Flags (n,) of the points that are kept, and the counts."""
    envelope = Envelope(margin, 0.2, 0.12, footprint_of(part, TURNED, margin), TURNED[:2, 3] + part.bounds[:, :2] * 1.5)
    number = np.arange(len(points))
    profiles = profiles_of(points, 0 * number, number)
    triggers = records(np.zeros((1, 6)), np.zeros(1))
    made = reconstruct_points(profiles, triggers, lambda _: np.eye(4)[None], TURNED, envelope, normals=False)
    cloud, dropped = made.cloud, made.dropped
    assert dropped.kept == len(cloud)
    return np.isin(number, cloud.column), dropped


@pytest.mark.parametrize("part", [sheet(0.1e-3), sheet(0.45e-3), sheet(0.5e-3), sheet(0.501e-3), FLANGE])
def test_all_points_of_a_thin_part_are_kept_and_all_of_the_table_dropped(part: Mesh) -> None:
    top, table = measured(part)
    flags, dropped = kept(part, np.concatenate([top, table]))
    assert flags[: len(top)].all()
    assert not flags[len(top) :].any()
    assert dropped.low == len(table)
    assert dropped.kept_low == (top[:, 2] < MARGIN).sum() > 0
    assert dropped.ambiguous < 0.01 * len(top)  # in the cells of its edges
    assert not table_warnings(dropped, 1e3 * MARGIN)


@pytest.mark.parametrize("shift", [(0.5e-3, 0.0, 0.0), (0.3e-3, -0.6e-3, 0.0), (-0.5e-3, 0.5e-3, 0.1e-3)])
def test_lateral_errors_up_to_the_tolerance_neither_cut_the_part_nor_keep_the_table(shift) -> None:
    part = sheet(0.45e-3)
    top, table = measured(part, shift)
    flags, dropped = kept(part, np.concatenate([top, table]))
    assert flags[: len(top)].all()
    assert not flags[len(top) :].any()
    assert 0 < dropped.ambiguous < 0.1 * len(top)


def test_sheet_on_a_lower_table_loses_nothing_but_its_rim_and_says_so() -> None:
    part = sheet(0.5e-3)
    top, table = measured(part, (0.0, 0.0, -0.4e-3))
    flags, dropped = kept(part, np.concatenate([top, table]))
    from_rim = (SIZE / 2 - np.abs(top[:, :2])).min(1)
    assert flags[: len(top)][from_rim > 1.5e-3].all()
    assert not flags[len(top) :].any()
    assert dropped.ambiguous == pytest.approx(len(top), rel=0.01)
    (warning,) = table_warnings(dropped, 1e3 * MARGIN)
    assert warning.startswith(f"{dropped.ambiguous} points lower than scan.table_margin_mm = 0.5")
    assert f"{dropped.kept_low} low points kept, {dropped.low} dropped" in warning


def test_table_higher_than_described_is_warned_of() -> None:
    part = sheet(5e-3)
    top, table = measured(part, (0.0, 0.0, 0.8e-3))
    flags, dropped = kept(part, np.concatenate([top, table]))
    assert flags.all()
    assert dropped.beside > 0.1 * len(table)
    (warning,) = table_warnings(dropped, 1e3 * MARGIN)
    assert "up to 1 mm higher than scan.table_margin_mm = 0.5" in warning


def test_table_below_an_overhang_is_not_the_part() -> None:
    """A mushroom on a thin plate: its cap hides the plate from above, but not the table beside the plate."""
    plate, stem, cap = Cylinder(0.01, 0.4e-3).mesh(), Cylinder(0.005, 0.02).mesh(), Cylinder(0.018, 5e-3).mesh()
    part = union(placed(plate), placed(stem), placed(cap, 0.02 - 1e-5))
    rng = np.random.default_rng(5)
    radius, angle = np.sqrt(rng.uniform(0, 0.017**2, 5000)), rng.uniform(-np.pi, np.pi, 5000)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.where(radius < 0.01, 0.4e-3, 0.0)], 1)
    points[:, 2] += rng.normal(0, NOISE, 5000)
    flags, _ = kept(part, points)
    on_plate = (radius < 0.01) & (radius > 5.3e-3)
    assert flags[on_plate].all()
    assert not flags[radius > 0.01].any()


def test_table_below_a_bent_sheet_is_not_the_part() -> None:
    """A sheet of 1 mm bent like a roof: beside its lower edges light from the open ends meets the table below it."""
    leg = [(x, y, z) for x, z in ((0.0, 0.021), (0.021, 0.0), (0.0196, 0.0), (0.0, 0.0196)) for y in (-0.02, 0.02)]
    part = union(*(mesh_of(trimesh.convex.convex_hull(np.array(leg) * (side, 1.0, 1.0))) for side in (-1.0, 1.0)))
    rng = np.random.default_rng(7)
    y = rng.uniform(-0.019, 0.019, 20_000)
    below = np.column_stack([rng.uniform(-0.0194, 0.0194, 20_000), y, rng.normal(0, NOISE, 20_000)])
    flags, dropped = kept(part, below)
    assert not flags[np.abs(below[:, 0]) < 0.0192].any()
    assert flags.mean() < 0.01
    assert dropped.ambiguous < 0.02 * len(below)


def test_points_above_the_margin_are_never_removed() -> None:
    rng = np.random.default_rng(6)
    points = np.concatenate([rng.uniform((-0.05, -0.05, MARGIN), (0.05, 0.05, 0.03), (20_000, 3))])
    for part in (sheet(0.45e-3), FLANGE, sheet(5e-3)):
        assert kept(part, points)[0].all()


def test_sheet_on_a_plate_is_told_from_the_plate_by_a_margin_above_it() -> None:
    """A fixture plate of 10 mm that the description does not know; the margin lies above it."""
    part = sheet(0.4e-3, 0.01)
    top, table = measured(part)
    table[:, 2] += 0.01
    flags, _ = kept(part, np.concatenate([top, table]), margin=10.5e-3)
    assert flags[: len(top)].all()
    assert not flags[len(top) :].any()


@pytest.mark.parametrize("name", ["free_form", "machined", "sphere_on_foot", "step_block"])
def test_parts_without_low_upper_sides_have_no_footprint(name: str) -> None:
    """So that nothing changes for them, and nothing is spent."""
    part = placed(load_mesh(assets_dir() / "parts" / f"{name}.stl"))
    assert footprint_of(part, TURNED, MARGIN) is None
    assert footprint_of(placed(Sphere(0.01).mesh()), TURNED, MARGIN) is None


def test_noise_of_the_table_beside_the_rim_of_a_cone_is_not_the_part() -> None:
    """There the nominal part is as low as the noise, so that heights tell nothing."""
    cone = placed(Cone(0.03, 0.01, 0.04).mesh())
    rng = np.random.default_rng(5)
    angle, radius = rng.uniform(0, 2 * np.pi, 50_000), rng.uniform(0.0302, 0.033, 50_000)
    beside = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.normal(0, NOISE, 50_000)], 1)
    flags, dropped = kept(cone, beside)
    assert not flags.any()
    assert dropped.low == len(beside)


def test_large_thin_part_has_a_bounded_grid() -> None:
    footprint = footprint_of(placed(box_mesh((4.0, 0.3, 0.4e-3))), np.eye(4), MARGIN)
    assert footprint is not None
    assert max(footprint.covered.shape) <= 2001
    flags, _ = footprint.part_points(np.array([[1.9, 0.1, 0.4e-3], [1.9, 0.2, 0.0], [0.0, 0.0, -2e-3]]))
    assert flags.tolist() == [True, False, False]
