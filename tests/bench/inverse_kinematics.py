"""Inverse kinematics of the shipped arms against EAIK, and its time: ``python -m bench.inverse_kinematics``.

Needs PYTHONPATH=tests. Poses are those of random joints. EAIK (https://github.com/OstermD/EAIK) decomposes arms into
subproblems in closed form, another method than either of ours.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from eaik.IK_DH import DhRobot
from numpy.typing import NDArray

from scancell.config.loading import assets_dir
from scancell.config.robot import RobotDescription
from scancell.geometry.arm import Arm, Joint
from scancell.nominal.cell import arm_of

Array = NDArray[np.float64]

SAME = 1e-6  # rad: branches of both that differ by less are one
_BLOCK = 2000


@dataclass(frozen=True)
class Comparison:
    """Counts over all poses.

    Attributes
    ----------
    branches
        Branches that EAIK finds, or we for arms that it cannot decompose.
    missing, further
        Branches of EAIK that we lack, and of ours that EAIK lacks.
    worst
        Largest difference between branches of both, rad.
    unreached
        Largest distance (m, or of a rotation's components) between a target and the pose of a branch of ours.
    lost
        Poses for which none of our branches is the joints that the pose was made from.
    """

    branches: int = 0
    missing: int = 0
    further: int = 0
    worst: float = 0.0
    unreached: float = 0.0
    lost: int = 0

    def __add__(self, other: Comparison) -> Comparison:
        counts = (getattr(self, name) + getattr(other, name) for name in ("branches", "missing", "further"))
        worst, unreached = max(self.worst, other.worst), max(self.unreached, other.unreached)
        return Comparison(*counts, worst, unreached, self.lost + other.lost)


def peer_of(arm: Arm) -> DhRobot:
    """The same arm for EAIK, which knows no offsets of joint angles; joints that are held are fixed at one value."""
    dimensions = (arm.column(name) for name in ("alpha", "a", "d"))
    fixed = [(joint.index, joint.values[0] + arm.joints[joint.index].theta) for joint in arm.held]
    return DhRobot(*dimensions, fixed_axes=fixed)


def compare(arm: Arm, q: Array) -> Comparison:
    """All branches at the poses of joints q (n, joints), without regard to limits; base at the origin."""
    peer = peer_of(arm)
    total = Comparison()
    for start in range(0, len(q), _BLOCK):
        joints = q[start : start + _BLOCK]
        targets = arm.fk(joints)
        ours = arm.ik(targets, filtered=False)
        answers = peer.IK_batched(targets, 1) if peer.hasKnownDecomposition() else [None] * len(targets)
        for answer, found, made, target in zip(answers, ours, joints, targets, strict=True):
            mine = found[np.isfinite(found).all(-1)]
            total += _compare(arm, mine, mine if answer is None else _exact(answer, arm), made, target)
    return total


def _exact(answer: Any, arm: Arm) -> Array:
    """EAIK's solutions (m, joints) without those that only come as near as possible."""
    exact = np.array([not approximate for approximate in answer.is_LS], bool)
    return np.array(answer.Q).reshape(-1, len(arm.joints))[exact] - arm.column("theta")


def _compare(arm: Arm, ours: Array, theirs: Array, made: Array, target: Array) -> Comparison:
    gap = _distance(ours[:, None], theirs[None])
    nearest = gap.min(0, initial=np.inf), gap.min(1, initial=np.inf)
    both = nearest[0][nearest[0] < SAME]
    return Comparison(
        len(theirs),
        int((nearest[0] >= SAME).sum()),
        int((nearest[1] >= SAME).sum()),
        float(both.max(initial=0.0)),
        float(np.abs(arm.fk(ours) - target).max(initial=0.0)),
        int(not (_distance(ours, made) < 1e-4).any()),
    )


def _distance(a: Array, b: Array) -> Array:
    return np.asarray(np.abs(np.remainder(a - b + np.pi, 2 * np.pi) - np.pi).max(-1))


def random_joints(arm: Arm, count: int, seed: int = 0) -> Array:
    """(count, joints) over the whole turn of every joint; those that are held at their first value."""
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, len(arm.joints)))
    for joint in arm.held:
        q[:, joint.index] = joint.values[0]
    return q


def shipped_arms() -> Iterator[tuple[str, Arm]]:
    """Name and kinematics of every shipped arm, its base at the world's origin."""
    for file in sorted((assets_dir() / "robots").glob("*.toml")):
        arm = arm_of(RobotDescription.from_toml(file))
        yield file.stem, replace(arm, world_from_base=np.eye(4))


def skew_arm() -> Arm:
    """An arm whose axes have no special position: no method decomposes it."""
    rows = np.random.default_rng(8).uniform([0.1, -0.3, -2, 0], [0.5, 0.3, 2, 0], (6, 4))
    return Arm([Joint(*row) for row in rows.tolist()])


def time_per_pose(arm: Arm, count: int) -> float:
    """Seconds of `Arm.ik` for each of `count` poses, best of three."""
    lower, upper = arm.limits
    targets = arm.fk(np.random.default_rng(1).uniform(lower, upper, (count, len(arm.joints))))
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        arm.ik(targets)
        best = min(best, time.perf_counter() - start)
    return best / count


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(prog="python -m bench.inverse_kinematics", description=__doc__)
    parser.add_argument("--poses", type=int, default=100_000)
    parser.add_argument("--timed", type=int, default=100_000, help="poses for the time of a closed form")
    parser.add_argument("--only", help="name of the only arm to measure")
    options = parser.parse_args()
    for name, arm in [*shipped_arms(), ("skew axes", skew_arm())]:
        if options.only and name != options.only:
            continue
        print(name)
        print(f"  {compare(arm, random_joints(arm, options.poses))}")
        timed = options.timed if arm.has_closed_form else max(1, options.timed // 100)
        print(f"  {1e6 * time_per_pose(arm, timed):.2f} us for each of {timed} poses in one call")


if __name__ == "__main__":
    main()
