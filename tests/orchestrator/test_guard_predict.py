"""Prediction of motion by hand, against integration of the same velocities by a Runge-Kutta method."""

from __future__ import annotations

import numpy as np
import pytest

from guard_motions import CELLS, cartesian, cell_of, random_start, twist_of
from scancell.guard.parts import Tool
from scancell.guard.stopping import Hypothesis, MeasuredState, Path, Predictor

TIMES = np.linspace(0.0, 0.5, 9)


def hypothesis_of(path: Path, axes: np.ndarray, rates: np.ndarray) -> Hypothesis:
    return Hypothesis(path, MeasuredState(0.0, axes), rates, np.zeros(len(rates)), 0.0)


@pytest.mark.parametrize("arm", CELLS)
def test_tool_poses_and_jacobians_are_those_of_the_arm(arm):
    """Products of matrices in Python, and differences of poses, on a tool that is not at the flange."""
    nominal, _ = cell_of(arm)
    tool, rng, step = Tool(nominal), np.random.default_rng(20), 1e-6
    for _ in range(10):
        joints = random_start(nominal, rng)[:-1]
        poses, jacobians = tool.poses(
            joints + step * np.vstack([0 * joints, np.eye(len(joints)), -np.eye(len(joints))])
        )
        frames = nominal.frame_poses(joints)
        np.testing.assert_allclose(poses[0], frames["sensor"], atol=1e-12)
        plus, minus = poses[1 : len(joints) + 1], poses[len(joints) + 1 :]
        np.testing.assert_allclose(jacobians[0, :3].T, (plus - minus)[:, :3, 3] / (2 * step), atol=1e-7)
        turn = (plus - minus)[:, :3, :3] @ poses[0, :3, :3].T / (2 * step)
        np.testing.assert_allclose(jacobians[0, 3:].T, turn[:, (2, 0, 1), (1, 2, 0)], atol=1e-7)


@pytest.mark.parametrize("arm", CELLS)
@pytest.mark.parametrize("name", ["translation", "rotation", "base", "tool"])
def test_cartesian_paths_are_those_of_the_integrated_twist(arm, name):
    """Where joints stay slow (no singular position is near), within 1e-6 rad after half a second."""
    nominal, jog = cell_of(arm)
    tool, predictor, rng = Tool(nominal), Predictor(nominal), np.random.default_rng(21)
    compared = 0
    for _ in range(25):
        start, twist = random_start(nominal, rng), twist_of(jog, name, rng)
        pose, jacobian = tool.poses(start[None, :-1])
        in_world = (pose[0, :3, :3] @ twist.reshape(2, 3).T).T.ravel() if name == "tool" else twist
        rates = np.append(tool.rates(jacobian, in_world[None])[0], 0.1)
        expected = cartesian(nominal, twist, name == "tool", start[:-1], TIMES)
        if np.abs(np.diff(expected, axis=0)).max() / TIMES[1] > 1.0:
            continue
        path = Path.TOOL if name == "tool" else Path.BASE
        (found,) = predictor.axes([hypothesis_of(path, start, rates)], TIMES[None])
        assert np.allclose(found[:, :-1], expected, atol=1e-6)
        assert np.allclose(found[:, -1], start[-1] + 0.1 * TIMES)
        compared += 1
    assert compared >= 5


def test_joint_interpolated_motion_is_straight():
    nominal, _ = cell_of("six_axis")
    rng = np.random.default_rng(22)
    start, rates = random_start(nominal, rng), rng.uniform(-0.5, 0.5, 7)
    (found,) = Predictor(nominal).axes([hypothesis_of(Path.JOINT, start, rates)], TIMES[None])
    assert np.allclose(found, start + TIMES[:, None] * rates)


def test_predictions_in_a_batch_equal_single_ones():
    nominal, jog = cell_of("six_axis")
    predictor, rng = Predictor(nominal), np.random.default_rng(23)
    tool = Tool(nominal)
    hypotheses = []
    for path in Path:
        start = np.append(nominal.home, 0.0)
        _, jacobian = tool.poses(start[None, :-1])
        rates = np.append(tool.rates(jacobian, 0.3 * twist_of(jog, "base", rng)[None])[0], 0.0)
        hypotheses.append(hypothesis_of(path, start, rates))
    times = np.stack([TIMES, TIMES / 2, TIMES / 5])
    together = predictor.axes(hypotheses, times)
    for i, hypothesis in enumerate(hypotheses):
        assert np.allclose(together[i], predictor.axes([hypothesis], times[i : i + 1])[0], atol=1e-9)


def test_joints_keep_their_rates_beyond_the_reach():
    """A straight path out of the workspace at uneven times: behind its end the prediction goes on evenly, finite."""
    nominal, _ = cell_of("six_axis")
    tool, predictor = Tool(nominal), Predictor(nominal)
    start = np.append(nominal.home, 0.0)
    pose, jacobian = tool.poses(start[None, :-1])
    out = pose[0, :3, 3] / np.linalg.norm(pose[0, :3, 3])
    rates = np.append(tool.rates(jacobian, np.concatenate([0.25 * out, np.zeros(3)])[None])[0], 0.0)
    times = 6.0 * np.linspace(0.0, 1.0, 61) ** 1.3
    leaving, staying = hypothesis_of(Path.BASE, start, rates), hypothesis_of(Path.BASE, start, -0.1 * rates)
    kept, found = predictor.axes([staying, leaving], np.stack([times, times]))
    np.testing.assert_allclose(kept, predictor.axes([staying], times[None])[0], atol=1e-9)
    reached, _ = tool.poses(found[:, :-1])
    straight = pose[0, :3, 3] + 0.25 * times[:, None] * out
    on_the_way = np.linalg.norm(reached[:, :3, 3] - straight, axis=1) < 1e-6
    last = int(np.argmin(on_the_way))
    assert 3 < last < 60
    assert on_the_way[:last].all()
    assert np.isfinite(found).all()
    speeds = np.diff(found[last - 2 :], axis=0) / np.diff(times[last - 2 :])[:, None]
    np.testing.assert_allclose(speeds, np.broadcast_to(speeds[0], speeds.shape), atol=1e-9)
    # Without two places before it, there are no other rates than those of the state.
    late = np.array([0.0, 5.0, 6.0])
    np.testing.assert_allclose(predictor.axes([leaving], late[None])[0], start + late[:, None] * rates, atol=1e-12)
