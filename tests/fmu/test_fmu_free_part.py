"""A free part on the table: gravity and friction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cell_fixture import CYCLE_US, Array, Build, CellFmu, box_part, cell_description, pose
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from scancell.cell.fmu_file import mesh_json

GRAVITY = 9.80665
CYCLE = CYCLE_US * 1e-6


def free_cell(
    radius: float, azimuth: float = 0.0, yaw: float = 0.0, friction: float = 0.5, stick: bool = True
) -> dict[str, Any]:
    x, y, z, w = Rotation.from_euler("z", yaw).as_quat()
    place = pose([radius * np.cos(azimuth), radius * np.sin(azimuth), 0], [w, x, y, z])
    cell = cell_description(fixture="free", support_from_part=place, friction=friction)
    cell["contact"]["stick"] = stick
    return cell


def part_on_platter(cell: CellFmu) -> Array:
    return np.linalg.inv(cell.body("table")) @ cell.body("part[1]")


def rotate_table(cell: CellFmu, speeds: Array, angle: float = 0.0) -> float:
    """Rotate the table with one speed per controller cycle; return the last commanded angle."""
    for speed in speeds:
        angle += speed * CYCLE
        cell.command(table=angle)
        cell.step(CYCLE_US)
    return angle


def test_part_rests_at_initial_pose(build: Build) -> None:
    description = free_cell(0.05, 0.4, 1.0)
    cell = build(3, description)
    placed = build(3, {**description, "parts": [{**description["parts"][0], "fixture": "clamped"}]})
    change = np.linalg.inv(placed.body("part[1]")) @ cell.body("part[1]")
    assert np.abs(change[:2, 3]).max() < 1e-12
    assert abs(change[2, 3]) < 0.4e-6
    assert np.abs(change[:3, :3] - np.eye(3)).max() < 1e-6


def test_round_base_with_many_vertices_is_supported_all_around(build: Build) -> None:
    """400 vertices give a base of 398 triangles, more contacts than the detector returns."""
    angles = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = np.column_stack([0.02 * np.cos(angles), 0.02 * np.sin(angles)])
    hull = ConvexHull(np.vstack([np.insert(ring, 2, height, axis=1) for height in (0.0, 0.05)]))
    triangles = hull.points[hull.simplices]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    description = free_cell(0.05)
    description["parts"][0]["hull"] = mesh_json(hull.points, faces)
    cell = build(3, description)
    before = part_on_platter(cell)
    np.testing.assert_allclose(before[:3, 3], [0.05, 0, 0], atol=0.4e-6)
    np.testing.assert_allclose(before[:3, :3], np.eye(3), atol=1e-6)
    rotate_table(cell, np.concatenate([np.linspace(0, 4, 40), np.full(round(2 * np.pi / CYCLE / 4), 4.0)]))
    assert np.abs((part_on_platter(cell) - before)[:3, 3]).max() < 1e-6


@pytest.mark.parametrize("radius", [0.0, 0.09])
def test_part_creeps_less_than_a_micrometre_per_turn(build: Build, radius: float) -> None:
    cell = build(3, free_cell(radius, 0.7, 0.3))
    before = part_on_platter(cell)
    ramp = np.linspace(0, 1, 32)
    per_turn = round(2 * np.pi / CYCLE)
    rotate_table(cell, np.concatenate([ramp, np.ones(2 * per_turn), ramp[::-1], np.zeros(4)]))
    change = np.linalg.inv(before) @ part_on_platter(cell)
    assert np.abs(change[:3, 3]).max() < 1e-6
    assert np.abs(change[:3, :3] - np.eye(3)).max() < 1e-6


@pytest.mark.parametrize("azimuth_deg", [0, 30, 45, 110, 225])
@pytest.mark.parametrize(("friction", "stick"), [(0.2, True), (0.5, True), (0.5, False)])
def test_part_slips_at_coulomb_limit(build: Build, azimuth_deg: float, friction: float, stick: bool) -> None:
    radius = 0.05
    cell = build(3, free_cell(radius, np.radians(azimuth_deg), friction=friction, stick=stick))
    before = part_on_platter(cell)
    limit = np.sqrt(friction * GRAVITY / radius)
    # Without stick constraints the engine lets the part creep outwards by (w h)^2 r / 2 in a step of h = 1 ms.
    held, slipping = limit * np.sqrt(0.98 if stick else 0.7), limit * np.sqrt(1.02)
    ramp = np.arange(0, held, 2.0 * CYCLE)
    angle = rotate_table(cell, np.concatenate([ramp, np.full(60, held)]))
    shift = np.linalg.norm((part_on_platter(cell) - before)[:2, 3])
    creep = radius / 2 * held**2 * 1e-3 * (60 + len(ramp) / 3) * CYCLE
    assert shift < (1e-6 if stick else 1.1 * creep)
    rotate_table(cell, np.concatenate([np.arange(held, slipping, 2.0 * CYCLE), np.full(60, slipping)]), angle)
    shift = np.linalg.norm((part_on_platter(cell) - before)[:2, 3])
    assert shift > 1e-3


def several_parts() -> dict[str, Any]:
    """Five boxes of different sizes and orientations, all around the table."""
    description = cell_description()
    places = [(0.05, 0.3, 0.0), (0.08, 1.9, 0.5), (0.0, 0.0, 1.1), (0.09, 3.4, 2.0), (0.07, 5.0, 0.8)]
    description["parts"] = []
    for k, (radius, azimuth, yaw) in enumerate(places):
        place = free_cell(radius, azimuth, yaw)["parts"][0]["support_from_part"]
        size = 0.02 + 0.003 * k
        description["parts"].append(
            box_part(size, 0.03, size, mass=0.1 * (k + 1), fixture="free", support_from_part=place)
        )
    return description


def poses_on_platter(cell: CellFmu, parts: int) -> Array:
    world_from_table = cell.body("table")
    return np.stack([np.linalg.inv(world_from_table) @ cell.body(f"part[{i}]") for i in range(1, parts + 1)])


def test_many_parts_creep_less_than_a_micrometre_per_turn(build: Build) -> None:
    """With a displaced, tilted and wobbling axis, too."""
    wrong = {"as_built.table.x": 2e-4, "as_built.table.rx": 2e-3, "as_built.platter.y": 3e-4}
    wobble = {"as_built.table.wobble_amplitude": 5e-4, "as_built.table.wobble_direction": 0.7}
    cell = build(3, several_parts(), {**wrong, **wobble})
    before = poses_on_platter(cell, 5)
    ramp = np.linspace(0, 1.5, 48)
    per_turn = round(2 * np.pi / CYCLE / 1.5)
    rotate_table(cell, np.concatenate([ramp, np.full(2 * per_turn, 1.5), ramp[::-1], np.zeros(4)]))
    change = poses_on_platter(cell, 5) - before
    assert np.abs(change[:, :3, 3]).max() < 1e-6
    assert np.abs(change[:, :3, :3]).max() < 1e-4  # a turn by 1e-4 rad moves a corner by 2 micrometres


def test_only_parts_beyond_coulomb_radius_slip(build: Build) -> None:
    """Coulomb's limit is at r = mu g / w^2: parts 2.1 % inside stick, parts 2 % outside slip."""
    description = several_parts()
    limit = 0.07
    for part, radius in zip(description["parts"], (0.979, 1.02, 0.0, 0.979, 1.02), strict=True):
        place = np.array(part["support_from_part"]["position"])
        length = np.linalg.norm(place)
        if length:
            part["support_from_part"]["position"] = list(place * radius * limit / length)
    cell = build(3, description)
    before = poses_on_platter(cell, 5)
    speed = np.sqrt(0.5 * GRAVITY / limit)
    rotate_table(cell, np.concatenate([np.arange(0, speed, 0.5 * CYCLE), np.full(60, speed)]))
    shift = np.linalg.norm((poses_on_platter(cell, 5) - before)[:, :2, 3], axis=1)
    assert (shift[[0, 2, 3]] < 1e-6).all()
    assert (shift[[1, 4]] > 1e-3).all()


def test_part_slides_off_the_table_and_others_stay(build: Build) -> None:
    description = several_parts()
    description["parts"][3]["friction"] = 0.05
    cell = build(3, description)
    before = poses_on_platter(cell, 5)
    rotate_table(cell, np.concatenate([np.arange(0, 4, 2.0 * CYCLE), np.full(80, 4.0)]))
    shift = np.linalg.norm((poses_on_platter(cell, 5) - before)[:, :2, 3], axis=1)
    assert (shift[[0, 1, 2, 4]] < 1e-6).all()
    assert cell.vector("truth.part[4].position", 3)[2] < 0  # it falls


def test_unstable_part_is_rejected(build: Build) -> None:
    x, y, z, w = Rotation.from_euler("x", 0.5).as_quat()
    description = cell_description(fixture="free", support_from_part=pose([0, 0, 0.02], [w, x, y, z]))
    with pytest.raises(RuntimeError, match=r"is not stable at parts\[0\]\.support_from_part"):
        build(3, description)


def test_part_beyond_table_rim_is_rejected(build: Build) -> None:
    with pytest.raises(RuntimeError, match=r"is not stable at parts\[0\]\.support_from_part"):
        build(2, free_cell(0.13))
