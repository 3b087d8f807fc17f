"""The example of the documentation: a straight motion between two taught poses collides, the planned one does not."""

from __future__ import annotations

import numpy as np
import pytest

from bench.naive_motion import CLEARANCE, Motion, example
from benchmarks.planning_cases import judge_of
from scancell.planning.model import MOTION_SHARE, PlanningCell


@pytest.fixture(scope="module")
def motions() -> tuple[PlanningCell, Motion, Motion]:
    return example()


def test_both_motions_join_the_same_free_poses(motions) -> None:
    cell, naive, planned = motions
    np.testing.assert_allclose(naive.points[[0, -1]], planned.points[[0, -1]], atol=1e-12)
    ends = naive.points[[0, -1]]
    assert cell.clearance_violations(ends, CLEARANCE) == []


def test_only_the_straight_motion_collides(motions) -> None:
    """By our own distances, and by python-fcl."""
    cell, naive, planned = motions
    found = []
    for motion in (naive, planned):
        poses = cell.nominal.body_poses(motion.points)
        found.append(judge_of(cell).first_collision(poses))
    assert naive.distance.min() == 0.0
    assert found[0] is not None
    assert {found[0].body_a, found[0].body_b} & {"part", "table"}
    assert planned.distance.min() >= MOTION_SHARE * CLEARANCE
    assert found[1] is None
