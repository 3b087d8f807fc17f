"""Meshes in assets/: closed, oriented, of the stated dimensions, consistent with the kinematics of the arm."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh

from scancell.config.robot import RobotDescription
from scancell.geometry import pose
from scancell.nominal.cell import arm_of

ASSETS = Path(__file__).resolve().parents[2] / "assets"
LINKS = [f"robots/six_axis/{name}.stl" for name in ("base", *(f"link{i}" for i in range(1, 7)))]
OTHER_LINKS = sorted(str(p.relative_to(ASSETS)) for p in ASSETS.glob("robots/*/**/*.stl") if "six_axis" not in str(p))
MACHINES = [*LINKS, *OTHER_LINKS, "tables/rotary_table.stl", "tables/table_base.stl", "sensors/profile_probe.stl"]
MACHINES += ["sensors/sensor_post.stl", "tables/chuck.stl"]
PARTS = [f"parts/{name}.stl" for name in ("sphere_on_foot", "step_block", "free_form", "machined")]

ARM = arm_of(RobotDescription.default())
SCANNING = (35.0, -25.0, 195.0, -68.0, 79.0, -10.0)  # deg


def load(name: str) -> trimesh.Trimesh:
    return trimesh.load(ASSETS / name)


@pytest.mark.parametrize("name", MACHINES + PARTS)
def test_meshes_are_closed_and_oriented(name: str) -> None:
    mesh = load(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert (ASSETS / name).stat().st_size < 2 * 1024 * 1024


@pytest.mark.parametrize("name", MACHINES)
def test_machine_meshes_have_few_faces(name: str) -> None:
    assert len(load(name).faces) <= 5000


@pytest.mark.parametrize("name", PARTS)
def test_parts_stand_on_zero_within_scan_range(name: str) -> None:
    low, high = load(name).bounds
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    assert np.hypot(*np.abs([low, high]).max(0)[:2]) <= 100.0
    assert high[2] <= 150.0


def contained(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 3) lie inside a closed mesh."""
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return scene.compute_occupancy(np.asarray(points, np.float32)).numpy().astype(bool)


def distance(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    manager = trimesh.collision.CollisionManager()
    manager.add_object("a", a)
    return float(manager.min_distance_single(b))


def bodies_at(arm: str, angles_deg: Sequence[float]) -> list[trimesh.Trimesh]:
    """Base and links of an arm in the world frame, mm, and the sensor of the default arm."""
    robot = RobotDescription.from_toml(ASSETS / "robots" / f"{arm}.toml")
    links = arm_of(robot).link_poses(np.radians(angles_deg))
    meshes = [trimesh.load(str(file)) for file in (robot.base_mesh, *(joint.mesh for joint in robot.joint))]
    if arm == "six_axis":
        meshes.append(load("sensors/profile_probe.stl"))
        links = [*links, links[-1] @ pose.translation((0.0, 0.0, 0.08))]
    for mesh, world_from_body in zip(meshes, links, strict=True):
        mesh.apply_transform(pose.from_rotation(world_from_body[:3, :3], 1e3 * world_from_body[:3, 3]))
    return meshes


@pytest.mark.parametrize(
    ("arm", "angles_deg"),
    [
        ("six_axis", SCANNING),
        ("six_axis", (0.0, -60.0, 200.0, 0.0, 60.0, 0.0)),
        ("six_axis", (35.0, -60.0, 185.0, 0.0, 55.0, 0.0)),
        ("offset_wrist", None),
        ("ur5e", None),
        ("irb1200", None),
        ("kr6_r900", None),
        ("seven_axis", None),
    ],
)
def test_adjacent_links_touch_and_others_are_separate(arm: str, angles_deg: Sequence[float] | None) -> None:
    """At given angles, or at home."""
    home = RobotDescription.from_toml(ASSETS / "robots" / f"{arm}.toml").home_deg
    bodies = bodies_at(arm, angles_deg or home)
    for i, j in itertools.combinations(range(len(bodies)), 2):
        gap = distance(bodies[i], bodies[j])
        assert gap <= 0.0 if j == i + 1 else gap > 5.0, f"{gap:.1f} mm between bodies {i} and {j}"


def test_arm_clears_table_and_part_while_scanning() -> None:
    bodies = bodies_at("six_axis", SCANNING)
    for name in ("tables/rotary_table.stl", "tables/table_base.stl", "parts/sphere_on_foot.stl"):
        obstacle = load(name).apply_translation((450.0, 0.0, 100.0))
        assert min(distance(body, obstacle) for body in bodies) > 10.0


@pytest.mark.parametrize(
    ("name", "axis_point", "axis"),
    [
        ("link1", (-75.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ("link2", (-270.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ("link3", (90.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ("link4", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ("link5", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ("link6", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ],
)
def test_links_contain_their_joint_axis(name: str, axis_point: tuple[float, ...], axis: tuple[float, ...]) -> None:
    """The joint axis of each link, by the kinematics, passes through its mesh."""
    world_from_link = ARM.link_poses(np.zeros(6))
    number = int(name[-1])
    own_from_previous = pose.inverse(world_from_link[number]) @ world_from_link[number - 1]
    assert np.abs(own_from_previous[:3, 2]) == pytest.approx(np.abs(axis), abs=1e-12)
    offset = 1e3 * own_from_previous[:3, 3] - np.array(axis_point)
    assert np.linalg.norm(np.cross(offset, axis)) < 1e-6
    mesh = load(f"robots/six_axis/{name}.stl")
    along = np.array(axis_point) + np.linspace(-400, 400, 801)[:, None] * np.array(axis)
    assert contained(mesh, along).any()


def test_platter_top_is_at_zero_and_clears_base() -> None:
    platter, foot = load("tables/rotary_table.stl"), load("tables/table_base.stl")
    assert platter.bounds[1, 2] == pytest.approx(0.0, abs=1e-6)
    assert platter.bounds[0, 2] == pytest.approx(-20.0, abs=1e-6)
    assert np.linalg.norm(platter.vertices[:, :2], axis=1).max() == pytest.approx(120.0, abs=1e-3)
    assert foot.bounds[0, 2] == pytest.approx(-100.0, abs=1e-6)
    assert 0.5 < platter.bounds[0, 2] - foot.bounds[1, 2] < 2.0


def test_sensor_housing_does_not_block_windows() -> None:
    probe = load("sensors/profile_probe.stl")
    assert probe.bounds[1, 2] < 0.0
    for window in ((60.0, 0.0, 0.0), (-60.0, 0.0, 0.0), (0.0, 0.0, 0.0)):
        assert not contained(probe, [window])[0]
    # Rays of the outermost pixels (tilt 29.3° ± 9.34°) do not intersect the housing.
    for side, tilt in itertools.product((1, -1), np.radians([29.3 - 9.34, 29.3, 29.3 + 9.34])):
        ray = np.linspace(0, 100, 201)[:, None] * np.array([-side * np.sin(tilt), 0.0, np.cos(tilt)])
        assert not contained(probe, ray + np.array([side * 60.0, 0.0, 0.0])).any()


def test_sphere_diameter() -> None:
    mesh = load("parts/sphere_on_foot.stl")
    radius = np.linalg.norm(mesh.vertices - [0.0, 0.0, 45.0], axis=1)
    on_ball = mesh.vertices[:, 2] > 25.0
    assert np.abs(radius[on_ball] - 25.0).max() < 1e-5
    middles = np.linalg.norm(mesh.triangles_center - [0.0, 0.0, 45.0], axis=1)[on_ball[mesh.faces].all(1)]
    assert 25.0 - middles.min() < 4e-3


def test_free_form_is_smooth() -> None:
    mesh = load("parts/free_form.stl")
    above = (mesh.vertices[mesh.face_adjacency_edges][:, :, 2] > 1e-6).any(1)
    assert np.degrees(mesh.face_adjacency_angles[above].max()) < 6.0
