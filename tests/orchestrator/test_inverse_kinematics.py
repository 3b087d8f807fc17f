"""Inverse kinematics of all kinds of arms: every branch against EAIK, singular poses, limits, turns, held joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.inverse_kinematics import compare, random_joints, shipped_arms, skew_arm
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.arm import Arm, HeldJoint, Joint, dh_from_axes

RIGHT = np.pi / 2
RNG = np.random.default_rng(8)
DEFAULT = next(arm for name, arm in shipped_arms() if name == "six_axis")


def arm_of_rows(rows: list[tuple[float, float, float]], limit: float = 3.2, held: tuple[HeldJoint, ...] = ()) -> Arm:
    """An arm by a (m), d (m) and alpha (multiples of 90 degrees) of each joint."""
    return Arm([Joint(a, d, RIGHT * alpha, 0.0, -limit, limit) for a, d, alpha in rows], np.eye(4), held)


# Axes 2, 3 and 4 are parallel; the last two have an offset.
THREE_PARALLEL = arm_of_rows([(0, 0.09, 1), (-0.42, 0, 0), (-0.39, 0, 0), (0, 0.11, 1), (0, 0.095, -1), (0, 0.08, 0)])
# No known decomposition: an offset between axes 4 and 6, up to 16 solutions.
OFFSET_WRIST = arm_of_rows([(0, 0.25, -1), (0.54, 0, 0), (0.03, 0, -1), (0, 0.54, 1), (0, 0.15, -1), (0, 0.16, 0)])
SKEW = skew_arm()
SEVEN_ROWS = [(0, 0.34, -1), (0, 0, 1), (0, 0.4, 1), (0, 0, -1), (0, 0.4, -1), (0, 0, 1), (0, 0.13, 0)]


def seven(*values: float) -> Arm:
    return arm_of_rows([(float(a), float(d), float(k)) for a, d, k in SEVEN_ROWS], held=(HeldJoint(2, values),))


def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(np.remainder(a - b + np.pi, 2 * np.pi) - np.pi).max(-1)


def reached(arm: Arm, targets: np.ndarray, found: np.ndarray) -> float:
    """Largest deviation of the poses of all branches found (n, branches, joints) from their targets."""
    exists = np.isfinite(found).all(-1)
    assert exists.any(1).all(), "every pose is reached"
    return float(np.abs(arm.fk(np.nan_to_num(found)) - targets[:, None])[exists].max())


@pytest.mark.parametrize(
    ("arm", "count"),
    [(DEFAULT, 2000), (THREE_PARALLEL, 200), (seven(0.0), 1000), (seven(0.4), 100)],
    ids=["closed form", "three parallel axes", "joint 3 held at 0", "joint 3 held at 0.4"],
)
def test_every_branch_is_that_of_eaik(arm: Arm, count: int) -> None:
    found = compare(arm, random_joints(arm, count))
    assert found.branches > 2 * count
    assert found.missing == found.further == found.lost == 0
    assert found.worst < 1e-6
    assert found.unreached < 1e-9


@pytest.mark.parametrize("arm", [OFFSET_WRIST, SKEW], ids=["offset wrist", "skew axes"])
def test_arm_without_decomposition_has_all_branches(arm: Arm) -> None:
    """Real polynomials of even degree: the number of solutions is even, and the pose's own joints are among them."""
    assert len(arm.branch_names) == 16
    q = RNG.uniform(-np.pi, np.pi, (100, 6))
    targets = arm.fk(q)
    found = arm.ik(targets, filtered=False)
    assert reached(arm, targets, found) < 1e-9
    assert np.nanmin(distance(found, q[:, None]), axis=1).max() < 1e-6
    number = np.isfinite(found[..., 0]).sum(1)
    assert (number % 2 == 0).all()
    assert number.max() > 4


@pytest.mark.parametrize(("kind", "expected"), [("skew", 16), ("right angles", 16), ("parallel", 8), ("wrist", 8)])
def test_number_of_complex_solutions(kind: str, expected: int) -> None:
    """16 in general (Primrose, 1986); 8 with three parallel axes, or three through a point (Pieper, 1968)."""
    rng = np.random.default_rng(4)
    for _ in range(2):
        a, d, alpha = rng.uniform(0.05, 0.5, 6), rng.uniform(-0.3, 0.3, 6), rng.choice([-RIGHT, RIGHT], 6)
        if kind == "skew":
            alpha = rng.uniform(-2, 2, 6)
        elif kind == "parallel":
            alpha[1:3] = 0
        elif kind == "wrist":
            a[3:5], d[4] = 0, 0
        arm = Arm([Joint(*row) for row in np.column_stack([a, d, alpha]).tolist()])
        assert len(arm.branch_names) == expected
        assert not arm.has_closed_form


@pytest.mark.parametrize(
    ("arm", "q"),
    [
        (THREE_PARALLEL, [0.3, -1.0, 1.2, 0.4, 0.0, 0.7]),
        (THREE_PARALLEL, [0.3, -1.0, 0.0, 0.4, 0.9, 0.7]),
        (OFFSET_WRIST, [0.3, -1.0, -np.pi / 2, 0.4, 0.0, 0.7]),
        (OFFSET_WRIST, [0.3, -1.0, 1.2, 0.0, 0.0, 0.7]),
        (seven(0.4), [0.3, -1.0, 0.4, 0.9, 0.2, 0.0, 0.7]),
        (DEFAULT, [0.3, -1.0, 1.2, 0.4, 0.0, 0.7]),
        (DEFAULT, [0.3, -1.0, np.arctan2(0.295, -0.09), 0.4, 0.5, 0.7]),
    ],
    ids=["wrist straight", "arm extended", "arm extended", "wrist straight", "held", "wrist straight", "arm extended"],
)
def test_singular_poses_are_reached(arm: Arm, q: list[float]) -> None:
    # Around the pose, too: nearly singular ones are the hard ones.
    joints = np.array(q) + np.multiply.outer([0.0, 1e-9, 1e-6, 1e-4], [0.0, 1.0, 0.0, -1.0, 1.0, 0.5, 0.0][: len(q)])
    for joint in arm.held:
        joints[:, joint.index] = joint.values[0]
    targets = arm.fk(joints)
    assert reached(arm, targets, arm.ik(targets, filtered=False)) < 1e-9


@pytest.mark.parametrize("arm", [DEFAULT, THREE_PARALLEL], ids=["closed form", "numerical"])
def test_joints_at_limits_are_found(arm: Arm) -> None:
    lower, upper = arm.limits
    q = np.where(RNG.random((30, 6)) < 0.4, np.where(RNG.random((30, 6)) < 0.5, lower, upper), 0.3 * (lower + upper))
    q[:, 4] = np.where(np.abs(q[:, 4]) < 0.1, 0.7, q[:, 4])
    found = arm.ik(arm.fk(q))
    assert np.nanmin(distance(found, q[:, None]), axis=1).max() < 1e-6
    exists = np.isfinite(found).all(-1)
    assert arm.within_limits(found[exists]).all()


def test_reference_chooses_turn_of_joint_six() -> None:
    """A range of ±360 degrees holds two turns of most angles."""
    q = np.array([0.4, -1.0, 2.9, 0.3, 0.8, 1.0])
    for turn in (0.0, -2 * np.pi):
        near = q + np.array([0, 0, 0, 0, 0, turn])
        found = DEFAULT.ik(DEFAULT.fk(q)[None], reference=near)[0]
        assert np.nanmin(np.abs(found - near).max(-1)) < 1e-9
    beyond = DEFAULT.ik(DEFAULT.fk(q)[None], reference=q + np.array([0, 0, 0, 0, 0, 2 * np.pi]))[0]
    assert np.nanmin(np.abs(beyond - q).max(-1)) < 1e-9, "another turn would leave the limits"


def test_nearest_turn_is_the_best_of_all_turns() -> None:
    q, goal = RNG.uniform(-9, 9, (500, 6)), RNG.uniform(-7, 7, (500, 6))
    lower, upper = DEFAULT.limits
    turned = DEFAULT.nearest_turn(q, goal)
    options = q[..., None] + 2 * np.pi * np.arange(-4, 5)
    outside = np.maximum(0, np.maximum(lower[:, None] - options, options - upper[:, None]))
    cost = 1e6 * outside + np.abs(options - goal[..., None])
    np.testing.assert_allclose(turned, np.take_along_axis(options, cost.argmin(-1)[..., None], -1)[..., 0], atol=1e-12)


def test_turns_without_a_reference_are_near_zero_in_a_range_of_any_width() -> None:
    q = RNG.uniform(-np.pi, np.pi, (100, 6))
    joints = [replace(joint, min=-200 * np.pi, max=3 * np.pi) for joint in DEFAULT.joints]
    np.testing.assert_allclose(replace(DEFAULT, joints=joints).nearest_turn(q + 4 * np.pi), q, atol=1e-12)


@pytest.mark.parametrize("joints", [4, 5])
def test_arm_of_fewer_joints_attains_its_own_poses_only(joints: int) -> None:
    arm = Arm(SKEW.joints[:joints])
    q = RNG.uniform(-np.pi, np.pi, (30, joints))
    targets = arm.fk(q)
    found = arm.ik(targets, filtered=False)
    assert found.shape == (30, len(arm.branch_names), joints)
    assert reached(arm, targets, found) < 1e-9
    assert np.nanmin(distance(found, q[:, None]), axis=1).max() < 1e-6
    assert np.isnan(arm.ik(targets @ pose.translation((0.01, 0.02, 0.03)), filtered=False)).all()


def test_dependent_joints_are_refused() -> None:
    planar = arm_of_rows([(0.3, 0, 0), (0.3, 0.1, 0), (0.2, 0, 0), (0.1, 0, 1), (0.1, 0.1, 1), (0, 0.2, 0)])
    with pytest.raises(DescriptionError, match="joints that are independent"):
        planar.ik(np.eye(4)[None])


def test_held_joints_multiply_branches() -> None:
    values = (-0.3, 0.0, 0.5)
    arm = seven(*values)
    q = RNG.uniform(-2, 2, (20, 7))
    q[:, 2] = RNG.choice(values, 20)
    targets = arm.fk(q)
    found = arm.ik(targets, filtered=False)
    assert found.shape[1] == len(arm.branch_names) == 24
    assert reached(arm, targets, found) < 1e-9
    assert np.nanmin(distance(found, q[:, None]), axis=1).max() < 1e-6
    for k, name in enumerate(arm.branch_names):
        held = found[np.isfinite(found[:, k, 2]), k, 2]
        assert len(held)
        assert set(held) == {values[k // 8]}
        assert name.endswith(f"joint 3 at {np.degrees(values[k // 8]):g} deg")


def test_two_joints_of_eight_are_held() -> None:
    rows = [(0.1, 0.34, -1), *[(float(a), float(d), float(k)) for a, d, k in SEVEN_ROWS]]
    arm = arm_of_rows(rows, held=(HeldJoint(0, (0.2, 0.4)), HeldJoint(3, (0.0,))))
    q = RNG.uniform(-2, 2, (10, 8))
    q[:, 0], q[:, 3] = 0.4, 0.0
    found = arm.ik(arm.fk(q), filtered=False)
    assert len(arm.branch_names) == 16
    assert np.nanmin(distance(found, q[:, None]), axis=1).max() < 1e-6


@pytest.mark.parametrize(
    ("arm", "start"),
    [
        (THREE_PARALLEL, [0.4, -1.0, 1.3, 0.3, 0.8, 1.0]),
        (DEFAULT, [0.4, -1.0, 2.9, 0.3, 0.8, 1.0]),
        (seven(0.0), [0.4, -1.0, 0.0, 1.3, 0.3, 0.8, 1.0]),
    ],
    ids=["numerical", "closed form", "held"],
)
def test_branches_along_path_are_continuous(arm: Arm, start: list[float]) -> None:
    q = np.array(start)
    path = pose.translation(np.linspace(0, 0.08, 17)[:, None] * np.array([0.6, -0.5, 0.62])) @ arm.fk(q)
    found = arm.ik_along(path[None], reference=q, filtered=False)[0]
    own = int(np.nanargmin(distance(found[0], q)))
    assert distance(found[0, own], q) < 1e-6
    assert np.abs(np.diff(found[:, own], axis=0)).max() < 0.2
    assert np.abs(arm.fk(found[:, own]) - path).max() < 1e-9
    # Every pose of the path has the same set of branches, whatever their order.
    for k in (8, 16):
        single = arm.ik(path[k], filtered=False)[0]
        single, along = (x[np.isfinite(x).all(-1)] for x in (single, found[k]))
        assert distance(along[:, None], single[None]).min(1).max() < 1e-6


def test_path_is_followed_alike_at_any_spacing_of_its_poses() -> None:
    """Coarse paths are followed in straight legs, fine ones many poses at a time, to where they leave the reach."""
    q = np.array([0.4, -1.0, 1.3, 0.3, 0.8, 1.0])
    length = np.linspace(0, 1.0, 1501) ** 2  # it begins with poses that hardly differ
    path = pose.translation(length[:, None] * np.array([0.8, -0.3, 0.5])) @ THREE_PARALLEL.fk(q)
    fine = THREE_PARALLEL.ik_along(path[None], filtered=False)[0]
    coarse = THREE_PARALLEL.ik_along(path[None, ::100], filtered=False)[0]
    own = int(np.nanargmin(distance(fine[0], q)))
    end = int(np.isfinite(fine[:, own]).all(-1).sum())
    assert 100 < end < 1500
    assert np.isnan(fine[end:, own]).all()
    assert np.abs(THREE_PARALLEL.fk(fine[:end, own]) - path[:end]).max() < 1e-9
    assert np.isfinite(coarse[: (end - 1) // 100 + 1, own]).all()
    np.testing.assert_allclose(coarse[: (end - 1) // 100 + 1, own], fine[:end:100, own], atol=1e-7)


def test_hard_poses_do_not_change_others() -> None:
    """Poses are solved in blocks, and those that need more starts than others are among them."""
    q = np.tile([0.3, -1.0, 1.2, 0.4, 0.9, 0.7], (300, 1))
    q[200:, 4] = 0.0
    found = THREE_PARALLEL.ik(THREE_PARALLEL.fk(q), filtered=False)
    assert found.shape == (300, 8, 6)
    np.testing.assert_allclose(found[:200], np.broadcast_to(found[0], (200, 8, 6)), atol=1e-8)
    assert np.isfinite(found[200:]).all(-1).any(1).all()


def test_calibrated_arm_keeps_named_branches() -> None:
    joints = [replace(j, a=j.a + 2e-4, d=j.d - 3e-4, alpha=j.alpha + 1e-3, beta=5e-4) for j in DEFAULT.joints]
    arm = Arm(joints)
    assert arm.branch_names == DEFAULT.branch_names
    assert not arm.has_closed_form
    q = np.array([[0.4, -1.0, 2.9, 0.3, 0.8, 1.0]])
    found, nominal = arm.ik(arm.fk(q)), DEFAULT.ik(DEFAULT.fk(q))
    both = np.isfinite(found).all(-1) & np.isfinite(nominal).all(-1)
    assert both.any()
    assert np.abs(found - nominal)[both].max() < 0.05
    q = random_joints(DEFAULT, 60)
    found = arm.ik(arm.fk(q), filtered=False)
    exists = np.isfinite(found).all(-1)
    assert np.abs(arm.fk(np.nan_to_num(found)) - arm.fk(q)[:, None])[exists].max() < 1e-9
    # Near a singularity the nominal branch may not exist at the calibrated pose; elsewhere it must be found.
    assert (np.nanmin(distance(found, q[:, None]), axis=1) < 1e-5).mean() > 0.9


def test_calibrated_arm_with_nearly_parallel_axes_has_all_branches() -> None:
    """The deviations turn the 8 solutions of the ideal arm into 16, half of them almost at infinity."""
    deviations = np.random.default_rng(2).normal(0, [2e-4, 2e-4, 1e-3], (6, 3))
    joints = [
        replace(joint, a=joint.a + a, d=joint.d + d, alpha=joint.alpha + alpha)
        for joint, (a, d, alpha) in zip(THREE_PARALLEL.joints, deviations, strict=True)
    ]
    arm = Arm(joints)
    q = random_joints(arm, 250, seed=6)  # among them poses that one start alone loses
    targets = arm.fk(q)
    found = arm.ik(targets, filtered=False)
    assert reached(arm, targets, found) < 1e-9
    assert np.nanmin(distance(found, q[:, None]), axis=1).max() < 1e-6


def lines(kind: str) -> tuple[np.ndarray, np.ndarray]:
    points, directions = RNG.uniform(-0.5, 0.5, (6, 3)), pose.exp_rotation(RNG.normal(size=(6, 3)))[:, :, 2]
    if kind == "parallel":
        directions[2], directions[3] = directions[1], -directions[1]
    elif kind == "intersecting":
        points[2] = points[1] + 0.3 * directions[1]
        points[5] = points[4] - 0.2 * directions[4]
    elif kind == "coincident":
        points[3], directions[3] = points[2] + 0.4 * directions[2], directions[2]
    return points, directions


@pytest.mark.parametrize("kind", ["skew", "parallel", "intersecting", "coincident"])
@pytest.mark.parametrize("end_on_axis", [True, False])
def test_dh_of_axes_moves_like_rotations_about_them(kind: str, end_on_axis: bool) -> None:
    points, directions = lines(kind)
    end = pose.from_rotation(pose.exp_rotation(RNG.normal(size=3)), RNG.uniform(-0.5, 0.5, 3))
    if end_on_axis:
        x = np.cross(directions[5], [0.3, 0.5, 0.8])
        x /= np.linalg.norm(x)
        end = pose.from_rotation(
            np.column_stack([x, np.cross(directions[5], x), directions[5]]), points[5] + 0.1 * directions[5]
        )
    chain, last_from_end = dh_from_axes(points, directions, end)
    q = RNG.uniform(-np.pi, np.pi, 6)
    expected = np.eye(4)
    for point, direction, angle in zip(points, directions, q, strict=True):
        turn = pose.from_rotation(pose.exp_rotation(angle * direction))
        expected = expected @ pose.translation(point) @ turn @ pose.translation(-point)
    assert np.abs(chain.fk(q) @ last_from_end - expected @ end).max() < 1e-12
    if end_on_axis:
        assert np.abs(last_from_end - np.eye(4)).max() < 1e-12
