"""Poses: round trips, conventions against SciPy, accuracy near rotations of zero and pi."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scancell.geometry import pose

RNG = np.random.default_rng(7)
QUATERNIONS = RNG.normal(size=(200, 4))
ROTATIONS = pose.rotation_from_quaternion(QUATERNIONS)
POSES = pose.pose(RNG.normal(size=(200, 3)), QUATERNIONS)


def _half_turns() -> np.ndarray:
    axes = np.random.default_rng(8).normal(size=(50, 3))
    axes = np.concatenate([np.eye(3), axes / np.linalg.norm(axes, axis=1, keepdims=True)])
    return 2 * np.einsum("ni,nj->nij", axes, axes) - np.eye(3)


def test_quaternions_match_scipy():
    expected = Rotation.from_quat(np.roll(QUATERNIONS, -1, axis=1)).as_matrix()
    assert np.abs(ROTATIONS - expected).max() < 1e-14


@pytest.mark.parametrize("rotations", [ROTATIONS, _half_turns()], ids=["random", "half turns"])
def test_quaternion_round_trip(rotations):
    q = pose.quaternion_from_rotation(rotations)
    assert np.abs(pose.rotation_from_quaternion(q) - rotations).max() < 1e-14
    assert (q[:, 0] >= 0).all()


def test_zero_quaternion_is_rejected():
    with pytest.raises(ValueError, match="zero length"):
        pose.rotation_from_quaternion((0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("to_rotation", "scipy_name"), [(pose.rotation_from_euler_xyz, "XYZ"), (pose.rotation_from_euler_zyz, "ZYZ")]
)
def test_euler_angles_match_scipy_intrinsic(to_rotation, scipy_name):
    angles = RNG.uniform(-np.pi, np.pi, (100, 3))
    assert np.abs(to_rotation(angles) - Rotation.from_euler(scipy_name, angles).as_matrix()).max() < 1e-14


def test_inverse():
    assert np.abs(POSES @ pose.inverse(POSES) - np.eye(4)).max() < 1e-14


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 9e-5, 1.1e-4, 0.049, 0.051, 1.0, 3.0, np.pi - 1e-9])
def test_rotation_exp_log_round_trip(angle):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    assert np.abs(pose.log_rotation(pose.exp_rotation(angle * axis)) - angle * axis).max() < 1e-12


def test_exp_rotation_matches_scipy():
    vectors = RNG.normal(size=(100, 3)) * np.logspace(-9, 1, 100)[:, None]
    assert np.abs(pose.exp_rotation(vectors) - Rotation.from_rotvec(vectors).as_matrix()).max() < 1e-14


@pytest.mark.parametrize("largest", [1e-9, 0.5, 1.57])
def test_logarithms_of_rotations_below_a_right_angle_match_scipy(largest):
    axes = RNG.normal(size=(200, 3))
    vectors = axes / np.linalg.norm(axes, axis=1, keepdims=True) * RNG.uniform(0, largest, (200, 1))
    assert np.abs(pose.log_rotation(Rotation.from_rotvec(vectors).as_matrix()) - vectors).max() < 1e-12


def test_log_of_half_turn_has_length_pi():
    logs = pose.log_rotation(_half_turns())
    assert np.allclose(np.linalg.norm(logs, axis=1), np.pi, atol=1e-12)
    assert np.abs(pose.exp_rotation(logs) - _half_turns()).max() < 1e-12


def test_straight_interpolation_has_constant_rates():
    start, end = POSES[2], POSES[3]
    fractions = np.linspace(-0.2, 1.2, 15)
    between = pose.interpolate_straight(start, end, fractions)
    line = start[:3, 3] + fractions[:, None] * (end[:3, 3] - start[:3, 3])
    assert np.abs(between[:, :3, 3] - line).max() < 1e-14
    steps = pose.log_rotation(between[1:, :3, :3] @ np.swapaxes(between[:-1, :3, :3], 1, 2))
    assert np.abs(steps - steps[0]).max() < 1e-13
    ends = pose.interpolate_straight(start, end, np.array([0.0, 1.0]))
    assert np.abs(ends - np.stack([start, end])).max() < 1e-13


def test_transform_points_matches_homogeneous_product():
    points = RNG.normal(size=(5, 3))
    moved = pose.transform_points(POSES[:7], points)
    homogeneous = np.concatenate([points, np.ones((5, 1))], 1)
    for k in range(7):
        assert np.abs(moved[k] - (homogeneous @ POSES[k].T)[:, :3]).max() < 1e-14


def test_transform_each_matches_transform_points():
    points = RNG.normal(size=(200, 3))
    one_by_one = [pose.transform_points(own, point[None])[0] for own, point in zip(POSES, points, strict=True)]
    np.testing.assert_allclose(pose.transform_each(POSES, points), one_by_one, atol=1e-14)
