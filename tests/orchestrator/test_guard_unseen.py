"""Bounds on unseen changes of a jog, against motions that change within its limits, integrated numerically."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from guard_walls import distances, square

from guard_motions import cell_of, unit
from scancell.config.loading import load_setup
from scancell.geometry.pose import transform_points
from scancell.guard.parts import Tool, UnseenApproach, jog_limits
from scancell.nominal.cell import NominalCell
from scancell.proximity.scene import ProximityScene

TIME = 0.25  # s: reaction and half the braking time of a jog, with the default settings
STEP = 0.005  # s
STEPS = round(TIME / STEP)

# Acceleration (joints + 1,) wanted of the axes, from the Jacobian (6, joints) of the tool.
Wish = Callable[[np.ndarray], np.ndarray]


def limits_of(cell: NominalCell):
    return jog_limits(load_setup().cell.robot, cell)


def within_limits(wanted: np.ndarray, jacobian: np.ndarray, cell: NominalCell) -> np.ndarray:
    """The largest acceleration along a wanted one that the limits allow, (joints + 1,)."""
    limits = limits_of(cell)
    tool = jacobian @ wanted[:-1]
    shares = [*(np.abs(wanted) / limits.axes), np.linalg.norm(tool[:3]) / limits.line]
    return wanted / max(*shares, np.linalg.norm(tool[3:]) / limits.turn)


def jogged(cell: NominalCell, start: np.ndarray, twist: np.ndarray | None, rates: np.ndarray, wish: Wish | None):
    """Axes (2, joints + 1) at the end: of a jog that goes on evenly, and of one that changes as wished.

    The jog keeps a twist (6,) of the tool, or the rates of the axes where there is none; changes add rates.
    """
    tool = Tool(cell)
    axes, changes = np.stack([start, start]), np.zeros_like(start)
    for _ in range(STEPS):
        _, jacobians = tool.poses(axes[:, :-1])
        now = np.tile(rates, (2, 1))
        if twist is not None:
            now[:, :-1] = tool.rates(jacobians, np.tile(twist, (2, 1)))
        if wish is not None:
            change = STEP * within_limits(wish(jacobians[1]), jacobians[1], cell)
            now[1] += changes + change / 2
            changes += change
        axes = axes + STEP * now
    return axes


def random_jogs(cell: NominalCell, axes: np.ndarray, rng: np.random.Generator):
    """Twist or none, and rates (joints + 1,), up to full deflection."""
    _, jog = cell_of("six_axis")
    if rng.random() < 0.5:
        twist = np.append(jog.line * rng.random() * unit(rng), jog.turn * rng.random() * unit(rng))
        return twist, np.zeros(7)
    rates = rng.uniform(-1, 1, 7) * jog.axes * rng.choice([1.0, 0.0], 7)
    _, jacobian = Tool(cell).poses(axes[None, :-1])
    speed = np.linalg.norm(jacobian[0, :3] @ rates[:-1])
    return None, rates * min(1.0, jog.line / max(speed, 1e-9))


def nearer(cell: NominalCell, scene: ProximityScene, axes: np.ndarray) -> np.ndarray:
    """By how much pairs are nearer with the changes than without, (pairs,), m."""
    even, changed = distances(cell, scene, axes, np.inf)
    return np.where((even > 0) & (changed > 0), even - changed, 0.0)


def test_unseen_changes_stay_within_the_bound():
    """Random directions, kept or changed at random, of random jogs; and the fastest approach of a wall or of links."""
    rng = np.random.default_rng(51)
    used = 0.0
    for case, (start, direction, _, cell, scene) in enumerate(square(rng, (0.3, 0.4), 24)):
        twist, rates = random_jogs(cell, start, rng)
        kept = rng.standard_normal(7) * rng.choice([1.0, 0.0], 7, p=[0.7, 0.3]) + 1e-3
        wishes: list[Wish] = [
            lambda _, kept=kept: kept,
            lambda _: rng.standard_normal(7),
            lambda jacobian, way=direction: np.append(np.linalg.lstsq(jacobian[:3], way, rcond=None)[0], 0.0),
        ]
        axes = jogged(cell, start, twist, rates, wishes[case % len(wishes)])
        bound = UnseenApproach(cell, scene.pairs, limits_of(cell)).bound(start, TIME**2)
        found = nearer(cell, scene, axes)
        assert (found <= bound).all(), [(scene.pairs[i], found[i], bound[i]) for i in np.flatnonzero(found > bound)]
        used = max(used, float((found[bound > 0] / bound[bound > 0]).max()))
    assert used > 0.5  # the bound of some pair is nearly used up


def test_bound_of_the_sensor_is_at_most_three_times_what_the_tool_can_do():
    """Straight to a wall at the jog's acceleration, the sensor gets a t2 / 2 nearer; rotation is what is added."""
    rng = np.random.default_rng(52)
    for start, _, _, cell, scene in square(rng, (0.1, 0.2), 20):
        limits = limits_of(cell)
        bound = UnseenApproach(cell, scene.pairs, limits).bound(start, TIME**2)[scene.pairs.index(("sensor", "wall"))]
        assert limits.line * TIME**2 / 2 <= bound <= 3 * limits.line * TIME**2 / 2


def test_bound_grows_with_the_squared_time():
    rng = np.random.default_rng(53)
    start, _, _, cell, scene = next(iter(square(rng, (0.1, 0.2), 1)))
    unseen = UnseenApproach(cell, scene.pairs, limits_of(cell))
    bounds = np.array([unseen.bound(start, time**2) for time in (0.1, 0.2, 0.3)])
    assert (np.diff(bounds, axis=0) >= 0).all()
    by_tool = scene.pairs.index(("sensor", "wall"))
    np.testing.assert_allclose(bounds[:, by_tool], bounds[0, by_tool] * np.array([1, 4, 9]), rtol=0.05)


def test_no_time_changes_nothing():
    cell, _ = cell_of("six_axis")
    pairs = [("sensor", "table"), ("link1", "link4"), ("sensor", "link1")]
    assert (UnseenApproach(cell, pairs, limits_of(cell)).bound(np.append(cell.home, 0.0), 0.0) == 0.0).all()


def test_table_alone_brings_nearer_what_turns_with_it():
    """Only pairs of which one turns with the table; the farthest point moves by its radius times the angle."""
    cell, _ = cell_of("six_axis")
    pairs = [("sensor", "part"), ("sensor", "base")]
    limits = limits_of(cell)
    axes = np.append(cell.home, 0.0)
    still = type(limits)(np.zeros(7), 0.0, 0.0)
    turning = type(limits)(np.append(np.zeros(6), 2.0), 0.0, 0.0)
    assert not UnseenApproach(cell, pairs, still).bound(axes, 0.04).any()
    part, base = UnseenApproach(cell, pairs, turning).bound(axes, 0.04)
    names = [body.name for body in cell.bodies]
    poses = cell.body_poses(cell.home[None])[0]
    points = transform_points(poses[names.index("part")], cell.bodies[names.index("part")].mesh.vertices)
    radius = np.linalg.norm((points - poses[names.index("table"), :3, 3])[:, :2], axis=1).max()
    assert base == 0.0
    assert 0.02 * 2.0 * radius <= part <= 1.2 * 0.02 * 2.0 * radius
