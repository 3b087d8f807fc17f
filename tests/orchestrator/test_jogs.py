"""Random starts, jogs and moves of the guard's campaign."""

from __future__ import annotations

import numpy as np

from guard_motions import cell_of
from scancell.cell.controller import Mode
from scancell.studies.guard.jogs import Draws

NOMINAL, _ = cell_of("six_axis")
LOWER, UPPER = NOMINAL.arm.limits


def test_starts_and_targets_are_inside_the_limits() -> None:
    """By a hundredth of a radian at least, so that a jog can begin in any direction, and they reach up to there."""
    draws, rng = Draws(NOMINAL), np.random.default_rng(1)
    starts = np.array([draws.start(rng) for _ in range(2000)])
    moves = [draws.move(start, 0.5, rng) for start in starts[:300]]
    targets = np.array([move.values for move in moves if move.mode is Mode.JOINT_MOVE])
    for axes in (starts, targets):
        room = np.minimum(axes[:, :-1] - LOWER, UPPER - axes[:, :-1])
        assert (room.min(0) > 0.01).all()
        assert room.min() < 0.1
    near_home = (np.abs(starts[:, :-1] - NOMINAL.home) < 0.71).all(1)
    assert 0.4 < near_home.mean() < 0.6


def test_largest_deflection_of_a_jog_is_full() -> None:
    draws, rng = Draws(NOMINAL), np.random.default_rng(2)
    jogs = [draws.jog(rng) for _ in range(500)]
    np.testing.assert_allclose([np.abs(jog.values).max() for jog in jogs], 1.0)
    assert {jog.mode for jog in jogs} == {Mode.JOINT_JOG, Mode.CARTESIAN_JOG}
    table = np.array([jog.values[-1] != 0 for jog in jogs])
    alone = np.array([not jog.values[:-1].any() for jog in jogs])
    assert 0.1 < alone.mean() < 0.2
    assert 0.3 < table.mean() < 0.4
