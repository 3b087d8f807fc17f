"""A part that stands on the table by gravity and friction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Array, Build, CellFmu, cell_description, pose
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

GRAVITY = 9.80665
CYCLE = CYCLE_US * 1e-6


def free_cell(radius: float, azimuth: float = 0.0, yaw: float = 0.0, friction: float = 0.5) -> dict[str, Any]:
    x, y, z, w = Rotation.from_euler("z", yaw).as_quat()
    place = pose([radius * np.cos(azimuth), radius * np.sin(azimuth), 0], [w, x, y, z])
    return cell_description(fixture="free", support_from_part=place, friction=friction)


def part_on_platter(cell: CellFmu) -> Array:
    return np.linalg.inv(cell.body("table")) @ cell.body("part[1]")


def turn(cell: CellFmu, speeds: Array, angle: float = 0.0) -> float:
    """Turns the table with a list of speeds, one per controller cycle; returns the angle commanded last."""
    for speed in speeds:
        angle += speed * CYCLE
        cell.command(table=angle)
        cell.step(CYCLE_US)
    return angle


def test_it_rests_where_it_was_put(build: Build) -> None:
    description = free_cell(0.05, 0.4, 1.0)
    cell = build(3, description)
    placed = build(3, {**description, "parts": [{**description["parts"][0], "fixture": "clamped"}]})
    change = np.linalg.inv(placed.body("part[1]")) @ cell.body("part[1]")
    assert np.abs(change[:2, 3]).max() < 1e-12
    assert abs(change[2, 3]) < 0.4e-6
    assert np.abs(change[:3, :3] - np.eye(3)).max() < 1e-6


def test_a_round_base_of_many_vertices_carries_all_around(build: Build) -> None:
    """400 corners make 398 triangles on the table, more contacts than the detector returns."""
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = np.column_stack([0.02 * np.cos(angles), 0.02 * np.sin(angles)])
    hull = ConvexHull(np.vstack([np.insert(ring, 2, height, axis=1) for height in (0.0, 0.05)]))
    triangles = hull.points[hull.simplices]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    description = free_cell(0.05)
    description["parts"][0]["hull"] = {"vertices": hull.points.tolist(), "faces": faces.tolist()}
    cell = build(3, description)
    before = part_on_platter(cell)
    np.testing.assert_allclose(before[:3, 3], [0.05, 0, 0], atol=0.4e-6)
    np.testing.assert_allclose(before[:3, :3], np.eye(3), atol=1e-6)
    turn(cell, np.concatenate([np.linspace(0, 4, 40), np.full(round(2 * np.pi / CYCLE / 4), 4.0)]))
    assert np.abs((part_on_platter(cell) - before)[:3, 3]).max() < 1e-6


@pytest.mark.parametrize("radius", [0.0, 0.09])
def test_it_creeps_less_than_a_micrometre_per_turn(build: Build, radius: float) -> None:
    cell = build(3, free_cell(radius, 0.7, 0.3))
    before = part_on_platter(cell)
    ramp = np.linspace(0, 1, 32)
    per_turn = round(2 * np.pi / CYCLE)
    turn(cell, np.concatenate([ramp, np.ones(2 * per_turn), ramp[::-1], np.zeros(4)]))
    change = np.linalg.inv(before) @ part_on_platter(cell)
    assert np.abs(change[:3, 3]).max() < 1e-6
    assert np.abs(change[:3, :3] - np.eye(3)).max() < 1e-6


@pytest.mark.parametrize("azimuth_deg", [0, 30, 45])
@pytest.mark.parametrize("friction", [0.2, 0.5])
def test_it_slips_where_coulomb_says(build: Build, azimuth_deg: float, friction: float) -> None:
    radius = 0.05
    cell = build(3, free_cell(radius, np.radians(azimuth_deg), friction=friction))
    before = part_on_platter(cell)
    limit = np.sqrt(friction * GRAVITY / radius)
    held, slipping = limit * np.sqrt(0.97), limit * np.sqrt(1.03)
    ramp = np.arange(0, held, 2.0 * CYCLE)
    angle = turn(cell, np.concatenate([ramp, np.full(60, held)]))
    shift = np.linalg.norm((part_on_platter(cell) - before)[:2, 3])
    assert shift < 1e-6
    turn(cell, np.concatenate([np.arange(held, slipping, 2.0 * CYCLE), np.full(60, slipping)]), angle)
    shift = np.linalg.norm((part_on_platter(cell) - before)[:2, 3])
    assert shift > 1e-3


def test_a_part_that_does_not_stand_is_refused(build: Build) -> None:
    x, y, z, w = Rotation.from_euler("x", 0.5).as_quat()
    description = cell_description(fixture="free", support_from_part=pose([0, 0, 0.02], [w, x, y, z]))
    with pytest.raises(RuntimeError, match=r"does not stand where parts\[0\]\.support_from_part"):
        build(3, description)


def test_a_part_beyond_the_rim_is_refused(build: Build) -> None:
    with pytest.raises(RuntimeError, match=r"does not stand where parts\[0\]\.support_from_part"):
        build(2, free_cell(0.13))
