"""Removal of points on neighbouring bodies by nominal geometry, and counts of discarded points."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import cell_file, export_mm
from trigger_records import profiles_of, records

from scancell.cell.recording import TriggerRecords
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.nominal.cell import nominal_cell
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.foreign import Neighbour, Neighbours, foreign_points, neighbours_of
from scancell.reconstruction.reconstruct import (
    Dropped,
    Envelope,
    ProfilePoints,
    points_in_part,
    poses_by_axes,
    reconstruct_points,
    why_empty,
)

DEVICES = """
[[conveyor]]
name = "belt"
pose = { x_mm = 450.0, y_mm = -350.0, z_mm = 110.0 }
length_mm = 400.0
width_mm = 100.0

[[further_part]]
name = "rider"
mesh = "block.stl"
stands_on = "conveyor[1]"
pose = { x_mm = 100.0 }

[[further_part]]
name = "bracket"
mesh = "block.stl"
pose = { y_mm = 60.0, rz_deg = 30.0 }
"""
RNG = np.random.default_rng(8)
PART = box_mesh((0.06, 0.04, 0.03), "part").transformed(pose.translation((0.0, 0.0, 0.015)))
NOISE = 50e-6
TABLE = 6  # column of the table among the positions of the axes
TABLE_FROM_PART = pose.from_euler_xyz((0.02, 0.0, 0.03), (0.0, 0.0, 0.4))


def part_from_sensor(q: np.ndarray, table: np.ndarray) -> np.ndarray:
    return pose.from_euler_xyz(q[:, :3], q[:, 3:])


def surface(mesh: Mesh, count: int = 3000) -> np.ndarray:
    points = trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.faces), count, seed=3)[0]
    return np.asarray(points) + RNG.normal(0.0, NOISE, (count, 3))


def turned(points: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", pose.rotation_about(2, angle), points)


def beside(x: float, rides: bool = True, name: str = "neighbour") -> Neighbour:
    return Neighbour(name, PART.transformed(pose.translation((x, 0.0, 0.0))), rides)


def around(*bodies: Neighbour) -> Neighbours:
    return Neighbours(bodies, PART, np.eye(4), TABLE)


def test_points_are_assigned_to_nearest_body():
    near, far = beside(0.07), beside(-0.09)
    still = np.zeros(3000)
    neighbours = around(near, far)
    assert (foreign_points(surface(PART), still, neighbours) == -1).all()
    assert (foreign_points(surface(near.mesh), still, neighbours) == 0).all()
    assert (foreign_points(surface(far.mesh), still, neighbours) == 1).all()


def test_bodies_beside_a_belt_stand_and_those_on_it_travel():
    post = PART.transformed(pose.translation((0.08, 0.12, 0.0)))  # which the part passes
    standing, riding = Neighbour("post", post, rides=False), beside(-0.08)
    travel = RNG.uniform(-0.05, 0.3, 3000)
    neighbours = Neighbours((standing, riding), PART, np.eye(4), axis=7, slides=True)
    seen = surface(standing.mesh)
    seen[:, 0] -= travel  # in the frame that moves with the belt
    assert (foreign_points(seen, travel, neighbours) == 0).all()
    assert np.mean(foreign_points(surface(standing.mesh), travel, neighbours) == 0) < 0.4  # if it travelled, too
    assert (foreign_points(surface(riding.mesh), travel, neighbours) == 1).all()
    assert (foreign_points(surface(PART), travel, neighbours) == -1).all()


def test_static_neighbour_is_found_at_all_table_angles():
    standing = beside(0.08, rides=False)
    angle = RNG.uniform(-7.0, 7.0, 3000)
    neighbours = around(standing)
    assert (foreign_points(turned(surface(standing.mesh), -angle), angle, neighbours) == 0).all()
    assert (foreign_points(surface(PART), angle, neighbours) == -1).all()
    # A body at this place at angle 0 that rotates with the table must not match.
    riding = surface(standing.mesh)
    assert np.mean(foreign_points(riding, angle, neighbours) == 0) < 0.2


def test_point_on_the_axis_of_the_table_is_found_on_a_body_that_surrounds_it():
    cover = Neighbour("cover", box_mesh((0.04, 0.04, 0.01)).transformed(pose.translation((0.0, 0.0, 0.1))), True)
    on_axis = np.array([[0.0, 0.0, 0.105]])
    for body in (cover, Neighbour("cover", cover.mesh, False)):
        assert foreign_points(on_axis, np.zeros(1), around(body)).tolist() == [0]


def test_part_points_at_contact_with_neighbour_are_kept():
    touching = beside(0.06)
    still = np.zeros(3000)
    assert (foreign_points(surface(PART), still, around(touching)) == -1).all()
    points = surface(touching.mesh)
    owner = foreign_points(points, still, around(touching))
    distance = points[:, 0] - 0.03  # from the common face
    assert (owner[distance > 1.5e-3 + 4 * NOISE] == 0).all()
    assert (owner[distance < 1.5e-3 - 4 * NOISE] == -1).all()


def test_measurement_errors_are_not_foreign():
    """Points off the part are kept: only the distance to the neighbours counts."""
    away = surface(PART) + np.array([0.0, 0.0, 0.02])
    assert (foreign_points(away, np.zeros(3000), around(beside(0.07))) == -1).all()


@pytest.mark.parametrize(("closed", "owner"), [(True, 0), (False, -1)])
def test_points_inside_closed_neighbour_are_foreign(closed, owner):
    mesh = beside(0.07).mesh
    neighbour = Neighbour("n", Mesh(mesh.vertices, mesh.faces if closed else mesh.faces[2:]), True)
    inside = np.array([[0.07, 0.0, 0.015], [0.075, 0.005, 0.01]])
    assert (foreign_points(inside, np.zeros(2), around(neighbour)) == owner).all()


def test_neighbours_have_poses_of_cell_description(tmp_path):
    export_mm(PART, tmp_path / "block.stl")
    nominal = nominal_cell(load_setup(cell_file(tmp_path, DEVICES)).cell, PART)
    found = {body.name: body for body in neighbours_of(nominal).bodies}
    assert set(found) == {"base", "table_base", "belt", "rider", "bracket"}
    assert {name for name, body in found.items() if body.rides} == {"bracket"}
    frames = nominal.frame_poses(nominal.home)
    for name, frame in (("bracket", "part[3]"), ("rider", "part[2]"), ("belt", "world")):
        mesh = next(body.mesh for body in nominal.bodies if body.name == name)
        in_world = found[name].mesh.transformed(nominal.world_from_table)
        assert np.allclose(in_world.vertices, mesh.transformed(frames[frame]).vertices, atol=1e-12)


def measured(points_in_table: np.ndarray) -> tuple[ProfilePoints, TriggerRecords]:
    """Profiles and triggers of points on the table, each from its own pose, which is stored in the joints."""
    n = len(points_in_table)
    q = RNG.uniform(-1.0, 1.0, (n, 6))
    in_part = pose.transform_points(pose.inverse(TABLE_FROM_PART), points_in_table)
    in_sensor = points_in_part(in_part, np.arange(n), pose.inverse(part_from_sensor(q, np.zeros(n))))
    return profiles_of(in_sensor, np.arange(n), np.arange(n)), records(q, np.zeros(n))


def reconstructed(
    profiles: ProfilePoints, triggers: TriggerRecords, envelope: Envelope, neighbours: Neighbours
) -> tuple[Cloud, Dropped]:
    poses = poses_by_axes(triggers, lambda axes: part_from_sensor(axes[:, :TABLE], axes[:, TABLE]))
    made = reconstruct_points(profiles, triggers, poses, TABLE_FROM_PART, envelope, False, neighbours)
    return made.cloud, made.dropped


def test_all_measured_points_are_counted():
    envelope = Envelope(0.5e-3, 0.2, 0.12)
    low, high, outside = np.array([[0.01, 0.02, 0.3e-3], [0, 0, -0.1]]), [[0, 0, 0.3]], [[0.11, 0.11, 0.05]]
    points = np.concatenate([low, high, outside, surface(PART, 30), surface(beside(0.07).mesh, 20)])
    points[-50:, 2] += 0.8e-3
    profiles, triggers = measured(points)
    neighbours = around(beside(0.07))
    cloud, dropped = reconstructed(profiles, triggers, envelope, neighbours)
    assert (dropped.measured, dropped.low, dropped.high, dropped.outside) == (54, 2, 1, 1)
    assert dropped.foreign == {"neighbour": 20}
    assert len(cloud) == dropped.kept == 30
    assert dropped.highest_low == pytest.approx(0.3e-3)


def test_empty_cloud_message_names_causes():
    envelope = Envelope(0.5e-3, 0.2, 0.12)
    points = np.concatenate([surface(PART, 50) * np.array([1, 1, 0]) + np.array([0, 0, 0.4e-3]), [[0.3, 0, 0.01]]])
    cloud, dropped = reconstructed(*measured(points), envelope, around())
    assert len(cloud) == 0
    thin, far = why_empty(dropped, envelope)
    assert thin.startswith("50 of 51 measured points lie lower than scan.table_margin_mm = 0.5 above the table")
    assert "highest of them at 0.40 mm" in thin
    assert far.startswith("1 of 51 measured points lie farther than cell.table.radius_mm = 120")
    _, nothing = reconstructed(*measured(points[:0]), envelope, around())
    assert "no view meets the part" in why_empty(nothing, envelope)[0]
