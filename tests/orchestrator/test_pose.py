"""Poses: round trips, conventions against SciPy, exact limits near zero and half a turn."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from orchestrator.geometry import pose

RNG = np.random.default_rng(7)
QUATERNIONS = RNG.normal(size=(200, 4))
ROTATIONS = pose.rotation_from_quaternion(QUATERNIONS)
POSES = pose.pose(RNG.normal(size=(200, 3)), QUATERNIONS)


def _half_turns() -> np.ndarray:
    axes = np.random.default_rng(8).normal(size=(50, 3))
    axes = np.concatenate([np.eye(3), axes / np.linalg.norm(axes, axis=1, keepdims=True)])
    return 2 * np.einsum("ni,nj->nij", axes, axes) - np.eye(3)


def test_quaternions_follow_scipy_with_w_first():
    expected = Rotation.from_quat(np.roll(QUATERNIONS, -1, axis=1)).as_matrix()
    assert np.abs(ROTATIONS - expected).max() < 1e-14


@pytest.mark.parametrize("rotations", [ROTATIONS, _half_turns()], ids=["random", "half turns"])
def test_quaternion_round_trip(rotations):
    q = pose.quaternion_from_rotation(rotations)
    assert np.abs(pose.rotation_from_quaternion(q) - rotations).max() < 1e-14
    assert (q[:, 0] >= 0).all()


def test_zero_quaternion_is_refused():
    with pytest.raises(ValueError, match="zero length"):
        pose.rotation_from_quaternion((0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("to_rotation", "to_angles", "scipy_name"),
    [
        (pose.rotation_from_euler_xyz, pose.euler_xyz_from_rotation, "XYZ"),
        (pose.rotation_from_euler_zyz, pose.euler_zyz_from_rotation, "ZYZ"),
    ],
)
def test_euler_angles_are_intrinsic_and_round_trip(to_rotation, to_angles, scipy_name):
    angles = RNG.uniform(-np.pi, np.pi, (100, 3))
    assert np.abs(to_rotation(angles) - Rotation.from_euler(scipy_name, angles).as_matrix()).max() < 1e-14
    assert np.abs(to_rotation(to_angles(ROTATIONS)) - ROTATIONS).max() < 1e-14


@pytest.mark.parametrize("middle", [-np.pi / 2, np.pi / 2])
def test_euler_xyz_round_trips_where_its_axes_align(middle):
    rotation = pose.rotation_from_euler_xyz((0.4, middle, -1.1))
    again = pose.rotation_from_euler_xyz(pose.euler_xyz_from_rotation(rotation))
    assert np.abs(again - rotation).max() < 1e-9


@pytest.mark.parametrize("middle", [0.0, np.pi])
def test_euler_zyz_round_trips_where_its_axes_align(middle):
    rotation = pose.rotation_from_euler_zyz((0.4, middle, -1.1))
    again = pose.rotation_from_euler_zyz(pose.euler_zyz_from_rotation(rotation))
    assert np.abs(again - rotation).max() < 1e-9


def test_inverse_undoes():
    assert np.abs(POSES @ pose.inverse(POSES) - np.eye(4)).max() < 1e-14


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 9e-5, 1.1e-4, 0.049, 0.051, 1.0, 3.0, np.pi - 1e-9])
def test_logarithms_undo_exponentials_at_every_angle(angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    assert np.abs(pose.log_rotation(pose.exp_rotation(angle * axis)) - angle * axis).max() < 1e-12
    twist = np.concatenate([[0.3, -0.2, 0.5], angle * axis])
    assert np.abs(pose.log_twist(pose.exp_twist(twist)) - twist).max() < 1e-12


def test_log_of_a_half_turn_has_length_pi():
    logs = pose.log_rotation(_half_turns())
    assert np.allclose(np.linalg.norm(logs, axis=1), np.pi, atol=1e-12)
    assert np.abs(pose.exp_rotation(logs) - _half_turns()).max() < 1e-12


def test_screw_interpolation_has_constant_twist():
    start, end = POSES[0], POSES[1]
    between = pose.interpolate(start, end, np.linspace(0, 1, 11))
    assert np.abs(between[0] - start).max() < 1e-14
    assert np.abs(between[-1] - end).max() < 1e-13
    steps = pose.log_twist(pose.inverse(between[:-1]) @ between[1:])
    assert np.abs(steps - steps[0]).max() < 1e-12


def test_straight_interpolation_moves_on_a_line_and_turns_evenly():
    start, end = POSES[2], POSES[3]
    fractions = np.linspace(-0.2, 1.2, 15)
    between = pose.interpolate_straight(start, end, fractions)
    line = start[:3, 3] + fractions[:, None] * (end[:3, 3] - start[:3, 3])
    assert np.abs(between[:, :3, 3] - line).max() < 1e-14
    rates = pose.angular_velocity(between[:-1], between[1:], 0.1)
    assert np.abs(rates - rates[0]).max() < 1e-12


def test_angular_velocity_of_a_turn_about_a_world_axis():
    rate = np.array([0.1, -0.7, 0.4])
    before = POSES[4]
    after = pose.from_rotation(pose.exp_rotation(0.02 * rate)) @ before
    assert np.abs(pose.angular_velocity(before, after, 0.02) - rate).max() < 1e-12


def test_points_follow_their_frame():
    points = RNG.normal(size=(5, 3))
    moved = pose.transform_points(POSES[:7], points)
    homogeneous = np.concatenate([points, np.ones((5, 1))], 1)
    for k in range(7):
        assert np.abs(moved[k] - (homogeneous @ POSES[k].T)[:, :3]).max() < 1e-14


def test_each_point_follows_a_pose_of_its_own():
    points = RNG.normal(size=(200, 3))
    one_by_one = [pose.transform_points(own, point[None])[0] for own, point in zip(POSES, points, strict=True)]
    np.testing.assert_allclose(pose.transform_each(POSES, points), one_by_one, atol=1e-14)
