"""Poses on the way of the homotopy continuation, and the Jacobian that follows them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scancell.geometry.continuation import SixJoints, _Line, _logarithm, _times_transposed, _turned

ARM = SixJoints(
    a=(0.05, 0.4, 0.03, 0.0, 0.02, 0.0),
    d=(0.4, 0.01, 0.0, 0.45, 0.1, 0.08),
    alpha=(1.5, 0.1, 1.4, -1.6, 1.3, 0.2),
    beta=(0.0, 0.05, 0.0, 0.0, -0.04, 0.0),
)


def rotations(count: int, seed: int) -> np.ndarray:
    """(3, 3, count), as the module holds them."""
    return Rotation.random(count, random_state=seed).as_matrix().transpose(1, 2, 0).astype(complex)


def test_logarithm_is_the_rotation_vector() -> None:
    rotation = rotations(50, 1)
    vectors = Rotation.from_matrix(rotation.real.transpose(2, 0, 1)).as_rotvec()
    np.testing.assert_allclose(_logarithm(rotation).T, vectors, atol=1e-9)


def test_product_with_the_transpose_is_that_of_matrices() -> None:
    a, b = rotations(20, 2) * (1 + 0.3j), rotations(20, 3)
    expected = np.einsum("ikm,jkm->ijm", a, b)
    np.testing.assert_allclose(_times_transposed(a, b), expected, atol=1e-14)


@pytest.mark.parametrize("time", [0.0, 0.3, 1.0])
def test_turn_is_that_of_the_rotation_vector(time) -> None:
    rotation = rotations(20, 4)
    turn = np.random.default_rng(4).normal(size=(3, 20))
    turned = _turned(rotation, turn.astype(complex), np.full(20, time))
    expected = Rotation.from_rotvec(time * turn.T).as_matrix() @ rotation.real.transpose(2, 0, 1)
    np.testing.assert_allclose(turned.transpose(2, 0, 1), expected, atol=1e-12)


def test_line_leads_from_one_pose_to_the_other() -> None:
    rng = np.random.default_rng(5)
    start, end = rng.normal(size=(3, 8)).astype(complex), rng.normal(size=(3, 8)).astype(complex)
    line = _Line.between(start, rotations(8, 6), end, rotations(8, 7), 8)
    for time, position, rotation in [(0.0, start, rotations(8, 6)), (1.0, end, rotations(8, 7))]:
        reached, turned = line.at(np.full(8, time))
        np.testing.assert_allclose(reached, position, atol=1e-12)
        np.testing.assert_allclose(turned, rotation, atol=1e-9)


def test_jacobian_is_the_derivative_of_the_pose() -> None:
    rng = np.random.default_rng(8)
    theta = rng.uniform(-3, 3, (6, 4)) + 1j * rng.uniform(-1, 1, (6, 4))
    _, rotation, jacobian = ARM.flange(theta)
    step = 1e-6
    for joint in range(6):
        change = np.zeros_like(theta)
        change[joint] = step
        (ahead, turned, _), (behind, _, _) = ARM.flange(theta + change), ARM.flange(theta - change)
        np.testing.assert_allclose(jacobian[:, :3, joint].T, (ahead - behind) / (2 * step), atol=1e-7)
        np.testing.assert_allclose(
            jacobian[:, 3:, joint].T, _logarithm(_times_transposed(turned, rotation)) / step, atol=2e-3
        )
