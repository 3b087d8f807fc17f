"""Stable resting poses of parts."""

import numpy as np
import pytest
import trimesh
from cells import ball, block, mesh_of

from scancell.geometry import pose
from scancell.geometry.mesh import LEAST_TIP_ANGLE, is_stable_pose, resting_poses


def test_block_rests_on_each_side_and_tips_over_its_nearer_edge():
    edges = np.array([0.05, 0.04, 0.02])
    rests = resting_poses(block(*edges))
    expected = []
    for axis in range(3):
        height, others = edges[axis], np.delete(edges, axis)
        expected += 2 * [np.arctan2(others.min(), height)]
    assert [rest.tip_angle for rest in rests] == pytest.approx(sorted(expected, reverse=True), abs=1e-9)
    downs = np.array([rest.rotation.T @ [0.0, 0.0, -1.0] for rest in rests])
    assert np.abs(np.abs(downs).max(1) - 1).max() < 1e-9
    assert len(np.unique(downs.round(6), axis=0)) == 6


def test_poses_are_invariant_under_rotation_of_the_mesh():
    made = trimesh.boolean.union(
        [
            trimesh.creation.box((0.06, 0.04, 0.01)),
            trimesh.creation.box((0.02, 0.03, 0.05), pose.translation((0.01, 0, 0.02))),
        ],
        engine="manifold",
    )
    part = mesh_of(made)
    turned = part.transformed(pose.from_euler_xyz((0.1, -0.2, 0.3), (0.4, 1.1, -0.7)))
    angles = [[rest.tip_angle for rest in resting_poses(mesh)] for mesh in (part, turned)]
    assert len(angles[0]) >= 4
    assert angles[0] == pytest.approx(angles[1], abs=1e-9)
    for rest in resting_poses(turned):
        assert np.abs(rest.rotation @ rest.rotation.T - np.eye(3)).max() < 1e-9
        assert np.linalg.det(rest.rotation) == pytest.approx(1.0)
        assert is_stable_pose(turned, pose.from_rotation(rest.rotation))
        # A part that is tilted by half the angle at which it tips over stands on an edge only.
        tilted = pose.rotation_about(0, rest.tip_angle / 2) @ rest.rotation
        assert not is_stable_pose(turned, pose.from_rotation(tilted))


def test_ball_rests_nowhere_and_cone_on_its_base():
    assert resting_poses(ball()) == []
    cone = mesh_of(trimesh.creation.cone(0.03, 0.06))
    base = max(resting_poses(cone), key=lambda rest: rest.tip_angle)
    # Its centre of mass is at a quarter of the height.
    assert base.tip_angle == pytest.approx(np.arctan2(0.03, 0.015), abs=0.02)
    assert pytest.approx([0, 0, -1], abs=1e-9) == base.rotation.T @ [0, 0, -1]
    assert all(rest.tip_angle >= LEAST_TIP_ANGLE for rest in resting_poses(cone))
