"""Reconstruction of analytic surfaces measured at random joint positions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trigger_records import profiles_of, records

from scancell.cell.recording import TriggerRecords
from scancell.config.robot import RobotDescription
from scancell.geometry import pose
from scancell.nominal.cell import arm_of
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.reconstruct import (
    Envelope,
    ProfilePoints,
    points_in_part,
    poses_by_axes,
    quality_of,
    reconstruct_points,
)
from scancell.sensor import estimate_normals

ARM = arm_of(RobotDescription.default())
FLANGE_FROM_SENSOR = pose.from_euler_xyz((0.01, -0.02, 0.08), (0.1, -0.2, 0.3))
WORLD_FROM_TABLE = pose.translation((0.45, 0.0, 0.1))
TABLE_FROM_PART = pose.from_euler_xyz((0.02, 0.0, 0.03), (0.0, 0.0, 0.4))
EVERYWHERE = Envelope(-np.inf, np.inf, np.inf)
RADIUS = 0.025


def reconstruct(
    profiles: ProfilePoints, triggers: TriggerRecords, kinematics: Any, *inputs: Any, **options: Any
) -> Cloud:
    poses = poses_by_axes(triggers, lambda axes: kinematics(axes[:, :6], axes[:, 6]))
    return reconstruct_points(profiles, triggers, poses, *inputs, **options).cloud


def part_from_sensor(q: np.ndarray, table: np.ndarray) -> np.ndarray:
    turn = pose.from_rotation(pose.rotation_about(2, table))
    world_from_part = WORLD_FROM_TABLE @ turn @ TABLE_FROM_PART
    return pose.inverse(world_from_part) @ ARM.fk(q) @ FLANGE_FROM_SENSOR


def sphere_points_under_random_poses(seed: int) -> tuple[ProfilePoints, TriggerRecords]:
    """Points of a sphere at the part's origin, in the sensor frame at random joints and table angles."""
    rng = np.random.default_rng(seed)
    n, per_frame = 40, 50
    q = np.radians([35, -25, 195, -68, 79, -10]) + rng.uniform(-0.5, 0.5, (n, 6))
    table = rng.uniform(-7, 7, n)
    direction = rng.normal(size=(n * per_frame, 3))
    on_sphere = RADIUS * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    frame = np.repeat(np.arange(n), per_frame)
    in_sensor = points_in_part(on_sphere, frame, pose.inverse(part_from_sensor(q, table)))
    return profiles_of(in_sensor, frame, np.tile(np.arange(per_frame), n)), records(q, table)


def sweep_over_sphere(noise: float = 0.0) -> tuple[ProfilePoints, TriggerRecords, np.ndarray]:
    """Profiles and triggers of 60 frames over a sphere, and the centre of the sphere in the part frame."""
    n, columns = 60, 400
    q = np.tile(np.radians([35, -25, 195, -68, 79, -10]), (n, 1))
    table = np.linspace(0.0, 0.9, n)  # another pose of the sensor relative to the part in every frame
    poses = part_from_sensor(q, table)
    middle = poses[n // 2] @ np.array([0.0, 0.0, 0.12, 1.0])
    centre = middle[:3]
    frame, column, found = [], [], []
    y = np.linspace(-0.02, 0.02, columns)
    for i in range(n):
        c = np.append(centre, 1.0)
        cx, cy, cz, _ = pose.inverse(poses[i]) @ c
        square = RADIUS**2 - cx**2 - (y - cy) ** 2
        seen = np.flatnonzero(square > 0)
        z = cz - np.sqrt(square[seen])
        found.append(np.stack([np.zeros(len(seen)), y[seen], z], -1))
        frame.append(np.full(len(seen), i))
        column.append(seen)
    points = np.concatenate(found)
    points[:, 2] += np.random.default_rng(1).normal(0.0, noise, len(points)) if noise else 0.0
    return profiles_of(points, np.concatenate(frame), np.concatenate(column)), records(q, table), centre


def test_sphere_from_random_poses() -> None:
    profiles, triggers = sphere_points_under_random_poses(3)
    cloud = reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)
    radius = np.linalg.norm(cloud.points_in_part, axis=1)
    assert np.abs(radius - RADIUS).max() < 1e-12


def test_points_carry_trigger_data() -> None:
    profiles, triggers = sphere_points_under_random_poses(4)
    triggers = replace(triggers, index=triggers.index + 100, segment=np.arange(40) // 10 + 1)
    cloud = reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)
    assert np.array_equal(cloud.profile, profiles.frame + 101)
    assert np.array_equal(cloud.segment, profiles.frame // 10 + 1)
    assert np.array_equal(cloud.time, triggers.time[profiles.frame])


def test_joint_error_matches_jacobian() -> None:
    """An error of measured joint 3 displaces the points by the cross product of its axis and lever arm."""
    profiles, triggers = sphere_points_under_random_poses(5)
    error = 1e-6
    wrong = replace(triggers, axes=triggers.axes + error * np.eye(7)[2])
    right = reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)
    moved = reconstruct(profiles, wrong, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)
    links = ARM.link_poses(triggers.q)
    axis, origin = links[:, 2, :3, 2], links[:, 2, :3, 3]
    world_from_sensor = ARM.fk(triggers.q) @ FLANGE_FROM_SENSOR
    in_world = points_in_part(profiles.points_in_sensor, profiles.frame, world_from_sensor)
    shift = np.cross(axis[profiles.frame], in_world - origin[profiles.frame]) * error
    rotation = pose.from_rotation(pose.rotation_about(2, triggers.table))
    part_from_world = pose.inverse(WORLD_FROM_TABLE @ rotation @ TABLE_FROM_PART)[:, :3, :3]
    expected = np.einsum("mij,mj->mi", part_from_world[profiles.frame], shift)
    assert np.abs(moved.points_in_part - right.points_in_part - expected).max() < 1e-11


@pytest.mark.parametrize(("noise", "median", "most"), [(0.0, 0.2, 2.0), (5e-6, 2.0, 180.0)])
def test_normals_of_swept_sphere(noise: float, median: float, most: float) -> None:
    profiles, triggers, centre = sweep_over_sphere(noise)
    cloud = reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)
    true = (cloud.points_in_part - centre) / RADIUS
    known = np.isfinite(cloud.normals[:, 0])
    assert known.mean() > 0.995, "all but what light only grazes"
    angle = np.degrees(np.arccos(np.clip((cloud.normals * true)[known].sum(1), -1, 1)))
    assert np.linalg.norm(cloud.normals[known], axis=1) == pytest.approx(1.0)
    assert np.median(angle) < median
    assert np.quantile(angle, 0.95) < most


@pytest.mark.parametrize("profiles", [1, 3])
def test_normals_of_distant_profiles_lie_in_sheet(profiles: int) -> None:
    """Arcs across a cylinder at 40 mm spacing: the plane through an arc is the laser sheet, not the surface."""
    angle = np.linspace(-1.0, 1.0, 1200)
    arc = np.stack([0 * angle, RADIUS * np.sin(angle), 0.13 - RADIUS * np.cos(angle)], -1)
    frame = np.repeat(np.arange(profiles), len(angle))
    points = np.tile(arc, (profiles, 1)) + 0.04 * frame[:, None] * np.array([1.0, 0.0, 0.0])
    source = np.stack([0.04 * np.arange(profiles), np.zeros(profiles), np.zeros(profiles)], -1)
    column = np.tile(np.arange(len(angle)), profiles)
    found = estimate_normals(points, frame, np.zeros(len(points), np.int32), column, source)
    true = np.tile(np.stack([0 * angle, np.sin(angle), -np.cos(angle)], -1), (profiles, 1))
    assert np.isfinite(found).all()
    assert (found * true).sum(1).min() > np.cos(np.radians(0.6)), "six columns to one side, at the ends"


def test_envelope_removes_points_outside() -> None:
    profiles, triggers = sphere_points_under_random_poses(6)
    everything = reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)
    envelope = Envelope(0.02, 0.045, 0.03)
    kept = reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, envelope)
    on_table = pose.transform_points(TABLE_FROM_PART, everything.points_in_part)
    x, y, z = on_table.T
    inside = (z >= 0.02) & (z <= 0.045) & (x * x + y * y <= 0.03**2)
    assert 0 < inside.sum() < len(everything)
    assert np.array_equal(kept.points_in_part, everything.points_in_part[inside])


def test_batches_concatenate() -> None:
    profiles, triggers = sphere_points_under_random_poses(7)
    split = int(np.searchsorted(profiles.frame, 25))
    columns = {name: getattr(profiles, name) for name in ProfilePoints.__dataclass_fields__}
    first = ProfilePoints(**{name: values[:split] for name, values in columns.items()})
    second = ProfilePoints(**{name: values[split:] for name, values in columns.items()})
    joined = ProfilePoints.concatenate([first, second])
    assert np.array_equal(joined.frame, profiles.frame)
    assert np.array_equal(joined.points_in_sensor, profiles.points_in_sensor)
    assert len(reconstruct(joined, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)) == len(profiles.frame)


def test_frame_without_trigger_is_rejected() -> None:
    profiles, triggers = sphere_points_under_random_poses(7)
    short = replace(
        triggers, **{name: getattr(triggers, name)[:30] for name in ("index", "segment", "time", "axes", "rates")}
    )
    with pytest.raises(ValueError, match="30 trigger records"):
        reconstruct(profiles, short, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)


def test_empty_profiles_give_empty_cloud() -> None:
    profiles = profiles_of(np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int))
    triggers = records(np.zeros((2, 6)), np.zeros(2))
    assert len(reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE)) == 0


def test_quality_decreases_with_sigma_and_flags() -> None:
    sigma = np.array([0.0, 10e-6, 20e-6, 100e-6])
    clean, warned = quality_of(sigma, np.zeros(4, int)), quality_of(sigma, np.full(4, 8))
    assert clean[0] == 1.0 and clean[2] == pytest.approx(0.5)
    assert (np.diff(clean) < 0).all() and (warned < clean).all() and (warned > 0).all()


def test_rolling_shutter_uses_pose_at_row_time() -> None:
    """Arm and table in motion: each point is transformed by the joints at the exposure of its row."""
    rng = np.random.default_rng(4)
    n, m = 30, 3000
    _, triggers = sphere_points_under_random_poses(4)
    q, table = triggers.q[:n], triggers.table[:n]
    qd, table_rate = rng.uniform(-0.5, 0.5, (n, 6)), rng.uniform(-1.0, 1.0, n)
    frame, time_offset = np.sort(rng.integers(0, n, m)), rng.uniform(-5e-3, 5e-3, m)
    direction = rng.normal(size=(m, 3))
    on_sphere = RADIUS * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    poses = part_from_sensor(
        q[frame] + qd[frame] * time_offset[:, None], table[frame] + table_rate[frame] * time_offset
    )
    in_sensor = points_in_part(on_sphere, np.arange(m), pose.inverse(poses))
    profiles = replace(profiles_of(in_sensor, frame, np.arange(m)), time_offset=time_offset)
    triggers = replace(records(q, table), rates=np.column_stack([qd, table_rate]))
    cloud = reconstruct(profiles, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE, normals=False)
    assert np.abs(cloud.points_in_part - on_sphere).max() < 0.1e-6
    late = replace(profiles, time_offset=np.zeros(m))
    wrong = reconstruct(late, triggers, part_from_sensor, TABLE_FROM_PART, EVERYWHERE, normals=False)
    assert np.abs(wrong.points_in_part - on_sphere).max() > 1e-3
