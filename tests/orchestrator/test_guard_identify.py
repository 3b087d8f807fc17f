"""Identification of motion by hand: seeded random motions of every kind by three arms and axes, at encoder noise."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from guard_motions import AXIS, CELLS, KIND_OF, KINDS, NOISE, WITH_AXES, cell_of, described_cell, random_motion
from scancell.guard.endpoints import Identifier, _Window
from scancell.guard.parts import Tool
from scancell.guard.stopping import Kind, MeasuredState, Path
from scancell.scanning.session import settings_of

MOTIONS = 100  # of each kind


@pytest.mark.parametrize("arm", [*CELLS, *WITH_AXES])
def test_kinds_and_paths_from_three_samples(arm):
    """At least 99.5 % are of the true kind; the true path stays possible, and the true rates are within their error."""
    noise = np.asarray(settings_of(described_cell(arm)).noise)
    identifier = Identifier(cell_of(arm)[0], noise)
    rng = np.random.default_rng(11)
    wrong, missing, outside = Counter(), Counter(), 0
    kinds = (*KINDS, AXIS) if arm in WITH_AXES else KINDS
    for name in kinds:
        for _ in range(MOTIONS):
            motion = random_motion(arm, name, rng)
            found = identifier.identify(motion.states(rng, noise))
            wrong[name] += found.kind is not KIND_OF[name]
            missing[name] += motion.path not in [hypothesis.path for hypothesis in found.hypotheses]
            rates = (motion.axes[-1] - motion.axes[0]) / (motion.times[-1] - motion.times[0])
            outside += bool((np.abs(found.hypotheses[0].rates - rates) > found.hypotheses[0].rate_error).any())
    count = MOTIONS * len(kinds)
    assert wrong.total() <= 0.005 * count, wrong
    assert missing.total() <= 0.002 * count, missing
    assert outside <= 0.005 * count


@pytest.mark.parametrize("name", ["single joint", "translation", "rotation"])
def test_speed_along_a_motion_is_free(name):
    """Samples at uneven times of the same path: the kind is that of the path, whatever the speed on it."""
    nominal, _ = cell_of("six_axis")
    identifier, rng = Identifier(nominal, NOISE), np.random.default_rng(12)
    kinds = Counter()
    for _ in range(100):
        motion = random_motion("six_axis", name, rng, times=np.array([0.0, 0.032, 0.096]))
        uneven = [replace(state, time=0.032 * i) for i, state in enumerate(motion.states(rng))]
        kinds[identifier.identify(uneven).kind] += 1
    assert kinds[KIND_OF[name]] >= 99


@pytest.mark.parametrize(("name", "path"), [("joints", Path.JOINT), ("base", Path.BASE), ("tool", Path.TOOL)])
def test_straightness_of_the_true_path_is_chi_squared(name, path):
    """Noise alone bends the path, in the five directions across it: the mean is 5, the variance 10."""
    nominal, _ = cell_of("six_axis")
    tool, noise, rng = Tool(nominal), np.full(7, NOISE), np.random.default_rng(16)
    found = []
    for _ in range(200):
        states = random_motion("six_axis", name, rng).states(rng)
        axes = np.array([state.axes for state in states])
        found.append(_Window(tool, np.array([state.time for state in states]), axes, noise).straightness(path))
    assert np.mean(found) == pytest.approx(5.0, abs=5 * np.sqrt(10 / len(found)))


def test_two_states_give_the_rates_between_them():
    """All paths of joints and tool are possible: nothing shows how it bends."""
    nominal, _ = cell_of("six_axis")
    rng = np.random.default_rng(17)
    for name in ("single joint", "joints", "base"):
        states = random_motion("six_axis", name, rng).states(rng)[:2]
        found = Identifier(nominal, NOISE).identify(states)
        rates = (states[1].axes - states[0].axes) / (states[1].time - states[0].time)
        assert found.kind is KIND_OF[name]
        assert {hypothesis.path for hypothesis in found.hypotheses} == set(Path)
        moved = np.abs(found.hypotheses[0].rates) > 0
        np.testing.assert_allclose(found.hypotheses[0].rates[moved], rates[moved], rtol=1e-9)
        assert (np.abs(found.hypotheses[0].rates - rates) <= found.hypotheses[0].rate_error).all()


def test_curved_tool_motion_is_distinguished_from_joint_motion():
    """At a hundredth of the noise, the helix of the tool frame, the line and joint motion are three paths."""
    nominal, _ = cell_of("six_axis")
    identifier, rng = Identifier(nominal, NOISE / 100), np.random.default_rng(13)
    alone = Counter()
    for name in ("joints", "base", "tool"):
        for _ in range(40):
            motion = random_motion("six_axis", name, rng)
            found = identifier.identify(motion.states(rng, NOISE / 100))
            assert motion.path in [hypothesis.path for hypothesis in found.hypotheses]
            alone[name] += len(found.hypotheses) == 1
    assert min(alone.values()) >= 20


def test_changes_of_rates_are_bounded_by_their_age():
    """Axes that accelerate at +-1 rad/s2 at random, with lost states: rates differ by at most the time since then."""
    nominal, _ = cell_of("six_axis")
    identifier, rng = Identifier(nominal, 1e-9), np.random.default_rng(15)
    nearest = np.inf
    for _ in range(300):
        steps = rng.choice([1, 1, 2, 5, 10], 2)
        now = np.concatenate([[0], np.cumsum(steps)])  # in polls
        rate = rng.uniform(-1, 1, 7) + 0.032 / 8 * np.cumsum(np.repeat(rng.choice([-1, 1], (now[-1], 7)), 8, 0), 0)
        axes = np.append(nominal.home, 0.0) + np.vstack([np.zeros(7), np.cumsum(rate * 0.032 / 8, 0)])
        states = [MeasuredState(0.032 * float(k), axes[8 * k]) for k in now]
        found = identifier.identify(states).hypotheses[0]
        room = found.rate_age + 0.032 / 8 + 1e-4 - np.abs(found.rates - rate[-1])
        nearest = min(nearest, room.min())
        assert (room >= 0).all()
    assert nearest < 0.02  # axes that accelerate one way all the time use it up


def test_arm_at_rest_does_not_move():
    """Standing axes have no rate, and the error of it covers what the noise may hide."""
    nominal, _ = cell_of("six_axis")
    rng = np.random.default_rng(14)
    found = Identifier(nominal, NOISE).identify(random_motion("six_axis", "rest", rng).states(rng))
    assert found.kind is Kind.REST
    (hypothesis,) = found.hypotheses
    assert hypothesis.path is Path.JOINT
    assert not hypothesis.rates.any()
    assert (hypothesis.rate_error >= 4 * NOISE / (0.032 * np.sqrt(2)) * (1 - 1e-9)).all()


def test_motion_that_changes_within_the_samples_leaves_all_paths_possible():
    nominal, _ = cell_of("six_axis")
    axes = np.append(nominal.home, 0.0)
    turn = np.radians(1.0) * np.eye(7)
    states = [MeasuredState(0.032 * i, q) for i, q in enumerate((axes, axes + turn[0], axes + turn[1]))]
    found = Identifier(nominal, NOISE).identify(states)
    assert {hypothesis.path for hypothesis in found.hypotheses} == set(Path)


def test_states_out_of_order_and_lone_states_are_refused():
    nominal, _ = cell_of("six_axis")
    state = MeasuredState(0.0, nominal.start)
    for states in ([state], [state, state], [MeasuredState(1.0, nominal.start), state]):
        with pytest.raises(ValueError, match="order of time"):
            Identifier(nominal, NOISE).identify(states)
