"""Paths along the contour of a part: stand-off, incidence and direction against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import mesh_of, planning_cell

from scancell.config.scan import ContourDescription, PathDescription
from scancell.errors import PlanningError
from scancell.geometry.mesh import Mesh
from scancell.planning.path_map.path_planner import PathPlanner, PlacedPath
from scancell.planning.views.sensor_paths import contour_poses, sensor_paths

STANDOFF = 0.09


def standing_cylinder(radius: float = 0.03, height: float = 0.04) -> Mesh:
    solid = trimesh.creation.cylinder(radius, height, sections=720)
    return mesh_of(solid.apply_translation((0, 0, height / 2)))


def l_shape(arm: float = 0.08, width: float = 0.03) -> Mesh:
    outline = np.array([(0, 0), (arm, 0), (arm, width), (width, width), (width, arm), (0, arm)])
    low = np.column_stack([outline, np.zeros(6)])
    triangles = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [tuple(reversed(t)) for t in triangles] + [tuple(i + 6 for i in t) for t in triangles]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, j + 6), (i, j + 6, i + 6)]
    return Mesh(np.concatenate([low, low + np.array([0, 0, 0.03])]), np.array(faces, np.int64), "L")


@pytest.mark.parametrize("turns", [1, -1])
def test_around_a_cylinder_stand_off_and_elevation_are_constant(turns: int) -> None:
    contour = ContourDescription(height_mm=20.0, elevation_deg=35.0, turns=turns, start_deg=90.0, smoothing_mm=4.0)
    poses = contour_poses(contour, standing_cylinder(), STANDOFF)
    origin, looking, along = poses[:, :3, 3], poses[:, :3, 2], poses[:, :3, 0]
    target = origin + STANDOFF * looking
    assert np.abs(np.hypot(*target[:, :2].T) - 0.03).max() < 1.5e-4  # the average over 4 mm of a circle lies inside it
    assert np.abs(target[:, 2] - 0.02).max() < 1e-12
    assert np.abs(np.degrees(np.arcsin(-looking[:, 2])) - 35.0).max() < 1e-9
    # Against the outward normal, in the plane through the axis.
    outward = target[:, :2] / np.linalg.norm(target[:, :2], axis=1)[:, None]
    assert np.abs((outward * looking[:, :2]).sum(1) + np.cos(np.radians(35.0))).max() < 1e-4
    azimuth = np.unwrap(np.arctan2(origin[:, 1], origin[:, 0]))
    assert np.degrees(azimuth[0]) == pytest.approx(90.0, abs=4.0)
    assert np.degrees(azimuth[-1] - azimuth[0]) == pytest.approx(360.0 * turns, abs=1e-6)
    # The laser sheet, the plane of sensor y and z, is upright: x is level, and along the contour.
    assert np.abs(along[:, 2]).max() < 1e-12
    assert np.abs((along * looking).sum(1)).max() < 1e-12
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)


def test_the_sensor_turns_evenly_around_the_edges_of_a_block() -> None:
    solid = mesh_of(trimesh.creation.box((0.06, 0.04, 0.03)).apply_translation((0, 0, 0.015)))
    poses = contour_poses(ContourDescription(height_mm=10.0, smoothing_mm=8.0), solid, STANDOFF)
    azimuth = np.unwrap(np.arctan2(-poses[:, 1, 2], -poses[:, 0, 2]))
    assert np.degrees(np.diff(azimuth)).max() < 35.0
    assert np.diff(azimuth).min() > -1e-9
    # Along the faces it looks straight at them.
    share = [np.mean(np.abs(np.sin(azimuth - side)) < 1e-6) for side in (0.0, np.pi / 2)]
    assert min(share) > 0.1


def test_a_contour_too_concave_for_the_stand_off_is_refused_with_its_place() -> None:
    contour = ContourDescription(height_mm=10.0, smoothing_mm=6.0)
    with pytest.raises(PlanningError, match=r"at \(\d+, \d+\) mm it is more concave than the stand-off allows"):
        contour_poses(contour, l_shape(), STANDOFF)


def test_smoothing_over_more_than_a_quarter_of_the_contour_is_refused() -> None:
    expected = r"smoothing_mm = 100000.0: the contour is 188.\d mm long; expected at most 47.\d"
    with pytest.raises(PlanningError, match=expected):
        contour_poses(ContourDescription(height_mm=10.0, smoothing_mm=1e5), standing_cylinder(), STANDOFF)


def test_a_height_beside_the_part_is_refused() -> None:
    with pytest.raises(PlanningError, match=r"height_mm = 50.0: the part has no closed contour there .* 0 to 40 mm"):
        contour_poses(ContourDescription(height_mm=50.0), standing_cylinder(), STANDOFF)


def test_a_contour_is_planned_like_any_path() -> None:
    cell = planning_cell(standing_cylinder())
    description = PathDescription(
        speed_mm_s=100.0, standoff_mm=100.0, contour=ContourDescription(height_mm=25.0, elevation_deg=40.0)
    )
    (path,) = sensor_paths(description, cell.nominal.part, cell.nominal.table_from_part)
    assert isinstance(PathPlanner(cell, 0.005).place(path), PlacedPath)
