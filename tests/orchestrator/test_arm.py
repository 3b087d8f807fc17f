"""Arm kinematics: forward against matrix products, Jacobian against finite differences, inverse against forward."""

from dataclasses import replace

import numpy as np
import pytest

from scancell.config.robot import RobotDescription
from scancell.geometry import pose
from scancell.geometry.arm import Arm, Joint
from scancell.geometry.inverse_kinematics import BRANCH_NAMES
from scancell.nominal.cell import arm_of

ARM = arm_of(RobotDescription.default())
RNG = np.random.default_rng(3)


def _random_joints(arm: Arm, count: int) -> np.ndarray:
    lower, upper = arm.limits
    return RNG.uniform(lower, upper, (count, 6))


def _arm_variant(signs: tuple[int, int, int, int], world_from_base: np.ndarray | None = None) -> Arm:
    """Another arm with a closed form: signs of the twists, a shoulder offset, zero offsets, a displaced base."""
    alphas = [signs[0] * 90, 0, signs[1] * 90, signs[2] * 90, signs[3] * 90, 37]
    a = [0.15, 0.6, 0.12, 0.0, 0.0, 0.01]
    d = [0.45, 0.08, -0.03, -0.64, 0.0, 0.2]
    joints = [Joint(a[i], d[i], np.radians(alphas[i]), 0.3 * i - 0.8, -3.0, 3.0, 3.0, 9.0) for i in range(6)]
    return Arm(joints, np.eye(4) if world_from_base is None else world_from_base)


VARIANTS = [_arm_variant(s) for s in [(1, 1, 1, 1), (-1, -1, 1, -1), (1, -1, -1, -1), (-1, 1, -1, 1)]]
VARIANTS.append(_arm_variant((-1, 1, -1, 1), pose.from_euler_xyz((0.3, -0.2, 0.1), (0.2, 0.5, -0.4))))


def _matrix(joint: Joint, q: float) -> np.ndarray:
    t, al = q + joint.theta, joint.alpha
    c, s, ca, sa = np.cos(t), np.sin(t), np.cos(al), np.sin(al)
    return np.array(
        [[c, -s * ca, s * sa, joint.a * c], [s, c * ca, -c * sa, joint.a * s], [0, sa, ca, joint.d], [0, 0, 0, 1]]
    )


@pytest.mark.parametrize("arm", [ARM, *VARIANTS])
def test_fk_matches_product_of_dh_matrices(arm):
    for q in _random_joints(arm, 5):
        expected = [arm.world_from_base]
        for joint, angle in zip(arm.joints, q, strict=True):
            expected.append(expected[-1] @ _matrix(joint, angle))
        assert np.abs(arm.link_poses(q) - np.array(expected)).max() < 1e-14
        assert np.abs(arm.fk(q) - expected[-1]).max() < 1e-14


def test_hayati_parameter_rotates_about_y():
    joints = list(ARM.joints)
    joints[1] = replace(joints[1], beta=0.02)
    q = _random_joints(ARM, 1)[0]
    tilted = Arm(joints).link_poses(q)
    expected = ARM.link_poses(q)[2] @ pose.from_rotation(pose.rotation_about(1, 0.02))
    assert np.abs(tilted[2] - expected).max() < 1e-14
    assert not Arm(joints).has_closed_form


@pytest.mark.parametrize("arm", [ARM, VARIANTS[-1]])
def test_jacobian_matches_finite_differences(arm):
    q = _random_joints(arm, 20)
    jacobian = arm.jacobian(q)
    h = 1e-6
    for i in range(6):
        step = np.eye(6)[i] * h
        before, after = arm.fk(q - step), arm.fk(q + step)
        linear = (after[:, :3, 3] - before[:, :3, 3]) / (2 * h)
        angular = pose.log_rotation(after[:, :3, :3] @ np.swapaxes(before[:, :3, :3], 1, 2)) / (2 * h)
        assert np.abs(jacobian[:, :3, i] - linear).max() < 1e-9
        assert np.abs(jacobian[:, 3:, i] - angular).max() < 1e-9


@pytest.mark.parametrize("arm", [ARM, *VARIANTS])
def test_ik_branches_reach_target_and_include_original(arm):
    q = _random_joints(arm, 2000)
    target = arm.fk(q)
    found = arm.ik(target, filtered=False)
    exists = np.isfinite(found).all(-1)
    reached = arm.fk(np.nan_to_num(found))
    assert np.abs(reached - target[:, None])[exists].max() < 1e-12
    gap = np.abs(np.remainder(found - q[:, None] + np.pi, 2 * np.pi) - np.pi).max(-1)
    assert np.nanmin(gap, axis=1).max() < 1e-8
    # Both wrist branches of an existing arm branch always exist.
    assert (exists[:, 0::2] == exists[:, 1::2]).all()


def test_branch_names_match_geometry():
    q = _random_joints(ARM, 500)
    found = ARM.ik(ARM.fk(q), filtered=False)
    frames = ARM.link_poses(np.nan_to_num(found))
    shoulder, elbow, wrist = frames[..., 1, :3, 3], frames[..., 2, :3, 3], frames[..., 5, :3, 3]
    forward = frames[..., 1, :3, 0]
    front = ((wrist - frames[..., 0, :3, 3]) * forward).sum(-1) > 0
    reach = wrist - shoulder
    along = ((elbow - shoulder) * reach).sum(-1) / (reach**2).sum(-1)
    off_line = elbow - shoulder - along[..., None] * reach
    # Upwards is perpendicular to the line from shoulder to wrist, as seen with the arm stretched forwards.
    across = np.cross(reach, np.where(front[..., None], 1.0, -1.0) * frames[..., 1, :3, 2])
    above = (off_line * across).sum(-1) > 0
    exists = np.isfinite(found).all(-1)
    for k, name in enumerate(BRANCH_NAMES):
        lateral, vertical, flip = name.split("-")
        assert (front[exists[:, k], k] == (lateral == "lefty")).all()
        assert (above[exists[:, k], k] == (vertical == "above")).all()
        assert ((found[exists[:, k], k, 4] > 0) == (flip == "noflip")).all()
    # Simple case: arm stretched forwards with the elbow raised is "above".
    plain = np.radians([0.0, -60.0, 150.0, 0.0, 30.0, 0.0])
    k = BRANCH_NAMES.index("lefty-above-noflip")
    assert ARM.link_poses(plain)[2, 2, 3] > 0.5
    assert np.abs(ARM.ik(ARM.fk(plain)[None])[0, k] - plain).max() < 1e-12


def test_ik_round_trips_at_shoulder_singularity():
    base_from_wrist = pose.from_euler_xyz((0.0, 0.0, 0.7), (0.3, 0.4, 0.5))
    target = base_from_wrist @ pose.translation((0, 0, 0.08))
    found = ARM.ik(target[None], filtered=False)[0]
    exists = np.isfinite(found).all(-1)
    assert exists.any()
    assert np.abs(ARM.fk(found[exists]) - target).max() < 1e-12


def test_ik_and_distance_outside_reach():
    reach = 0.270 + np.hypot(0.090, 0.295)
    direction = np.array([0.6, 0.0, 0.8])
    for beyond in (-1e-6, 1e-6, 0.05):
        centre = np.array([0.075, 0.0, 0.335]) + (reach + beyond) * direction
        target = pose.translation(centre + np.array([0.0, 0.0, 0.080]))[None]
        assert np.isfinite(ARM.ik(target, filtered=False)).any() == (beyond < 0)
        assert ARM.distance_outside_reach(target)[0] == pytest.approx(max(0.0, beyond), abs=1e-12)


def test_limit_violation():
    lower, upper = ARM.limits
    assert (ARM.limit_violation((lower + upper) / 2) == 0).all()
    assert np.allclose(ARM.limit_violation(upper + 0.1), 0.1)
    assert np.allclose(ARM.limit_violation(lower - 0.2), 0.2)
