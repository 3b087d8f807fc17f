"""The guard near a wall: jogs that the controller shows, from very slow to fast, and pairs within their clearance."""

from __future__ import annotations

import numpy as np
import pytest
from guard_walls import behind_wall, boxes, distances, near_home, straight

from bench.guard_retreat import CYCLE, ROWS, SETTINGS, run
from guard_motions import NOISE, POLL, unit
from scancell.cell.driver import Mode, Operation
from scancell.config.loading import load_setup
from scancell.config.robot import DriveDescription
from scancell.guard.guard import Guard, GuardSettings
from scancell.guard.messages import CellState
from scancell.guard.parts import NearPairs
from scancell.guard.stopping import braking_time
from scancell.scanning.session import settings_of

ROBOT = load_setup().cell.robot
CLEARANCE = 2 * SETTINGS.position_error
SPEEDS = (0.25e-3, 2.5e-3, 0.025, 0.25)  # m/s: 0.1 to 100 % of the jog speed


def wall(seed: int, gap: float):
    """Axes, direction of the wall, cell and scene; nothing else is near."""
    rng = np.random.default_rng(seed)
    while True:
        axes, direction = near_home(rng), unit(rng)
        cell, scene = behind_wall(axes, direction, gap)
        others = [k for k, pair in enumerate(scene.pairs) if pair != ("sensor", "wall")]
        if distances(cell, scene, axes[None], 0.2)[0, others].min() > 0.04:
            return axes, direction, cell, scene


def gap_of(cell, scene, axes: np.ndarray) -> float:
    return float(distances(cell, scene, axes[None], 0.2)[0, scene.pairs.index(("sensor", "wall"))])


def shown(number: int, axes: np.ndarray, rates: np.ndarray, moving: bool, operation=Operation.MANUAL) -> CellState:
    ahead = axes + CYCLE * np.arange(ROWS)[:, None] * rates
    mode = Mode.CARTESIAN_JOG if operation is Operation.MANUAL else Mode.JOINT_MOVE
    return CellState(number, POLL * number, operation, mode, moving, axes, 0.0, ahead, CYCLE, POLL * (number - 1))


@pytest.mark.parametrize("speed", SPEEDS)
def test_jog_is_stopped_where_its_stop_is_still_free_and_not_much_earlier(speed):
    """What is left: the way of the stop, the clearance, one poll, and errors of the angles, which are 0.4 mm here."""
    axes, direction, cell, scene = wall(51, 0.1)
    guard = Guard(cell, ROBOT, SETTINGS)
    rates = straight(axes, speed * direction)
    stop = speed * (SETTINGS.reaction + braking_time(rates, SETTINGS.deceleration * boxes().axis_max_acceleration) / 2)
    axes = axes + (max(0.0, 0.1 - CLEARANCE - stop - 0.004) / speed - 3 * POLL) * rates
    for number in range(1, 1200):
        if guard.answer(shown(number, axes, rates, True)).emergency_stop:
            break
        axes = axes + POLL * rates
    left = gap_of(cell, scene, axes)
    assert left + speed * POLL > CLEARANCE + stop
    assert left < CLEARANCE + 1.1 * stop + speed * POLL + 0.0025


@pytest.mark.parametrize("speed", SPEEDS)
def test_near_a_wall_only_a_jog_away_from_it_is_permitted(speed):
    """One towards it that is slower than the errors of the angles in a reaction time is refused later."""
    axes, direction, cell, _ = wall(52, 0.0008)
    guard = Guard(cell, ROBOT, SETTINGS)
    if speed > 0.01:
        towards = guard.answer(shown(1, axes, straight(axes, speed * direction), False))
        assert guard.decision.pair == ("sensor", "wall")
        assert (towards.monitor_speed, towards.emergency_stop) == (0, False)
    away = guard.answer(shown(2, axes, straight(axes, -speed * direction), False))
    assert (away.monitor_speed, away.emergency_stop) == (1, False)


def test_motions_that_bring_no_near_pair_nearer_are_permitted():
    """Random jogs and moves from poses within the clearance of a wall, against dense samples of the distances."""
    counts = run(30, 2)
    assert counts.away >= 60
    assert counts.away_refused == 0
    assert counts.nearer >= 4
    assert counts.nearer_permitted == 0


@pytest.mark.parametrize("operation", Operation)
def test_short_motions_repeated_do_not_add_up(operation):
    """100 motions of 0.1 mm towards a wall within its clearance: those permitted end where angles may be wrong."""
    axes, direction, cell, scene = wall(53, 0.0009)
    guard = Guard(cell, ROBOT, SETTINGS)
    rng, first = np.random.default_rng(5), gap_of(cell, scene, axes)
    rates = straight(axes, 1e-3 * direction)
    travel = np.minimum(CYCLE * np.arange(ROWS), 0.1)
    for number in range(1, 101):
        measured = axes + NOISE * rng.standard_normal(axes.shape)
        ahead = axes + travel[:, None] * rates
        state = CellState(
            number, float(number), operation, Mode.JOINT_MOVE, False, measured, 0.0, ahead, CYCLE, number - 0.5
        )
        answer = guard.answer(state)
        if answer.monitor_speed > 0 and not answer.emergency_stop:
            axes = ahead[-1]
    assert first - gap_of(cell, scene, axes) < 0.0005


@pytest.mark.parametrize("exact", [True, False])
def test_distance_to_be_kept_is_remembered_until_there_is_room(exact):
    cell = boxes()
    near = NearPairs(cell, [("sensor", "table")], 0.003, 1e-4)
    axes = np.append(cell.home, 0.0)

    def kept_at(distance: float) -> float:
        return float(near.update(axes, np.array([distance]), exact)[1][0])

    kept = kept_at(0.002)
    assert kept == pytest.approx(0.002, abs=1e-5 if exact else 2e-4)
    assert kept_at(0.0019) == kept
    near.begin_session()
    assert kept_at(0.001993) == kept if exact else kept_at(0.0019) == kept
    assert not near.update(axes, np.array([0.01]), exact)[0].any()
    assert kept_at(0.0019) < kept


def test_session_begins_where_something_else_has_moved_the_robot():
    """Below the stored distance by more than the errors of the angles: a motion away would be refused for ever."""
    cell = boxes()
    near = NearPairs(cell, [("sensor", "table")], 0.003, 1e-4)
    axes = np.append(cell.home, 0.0)
    near.update(axes, np.array([0.002]), exact=True)
    near.begin_session()
    _, kept = near.update(axes, np.array([0.001]), exact=True)
    assert kept[0] == pytest.approx(0.001, abs=1e-5)
    _, later = near.update(axes, np.array([0.0005]), exact=True)
    assert later == kept


def test_crawling_path_is_proved_like_any_other():
    """A path of less than 1e-6 rad in what is shown leads into a wall: the robot may go on only while it is free."""
    axes, direction, cell, scene = wall(54, 0.003)
    guard = Guard(cell, ROBOT, SETTINGS)
    rates = straight(axes, 1e-7 * direction)
    assert CYCLE * ROWS * np.abs(rates).max() < 1e-6
    for number in range(1, 400):
        answer = guard.answer(shown(number, axes, rates, True, Operation.AUTOMATIC))
        if answer.monitor_speed == 0 or answer.emergency_stop:
            break
        axes = axes + 100.0 * rates
    else:
        pytest.fail("the robot was never held")
    assert gap_of(cell, scene, axes) > CLEARANCE


def test_too_short_a_path_ahead_is_no_proof():
    axes, direction, cell, _ = wall(55, 0.1)
    guard = Guard(cell, ROBOT, GuardSettings(noise=NOISE, max_age=1.2))
    assert guard.answer(shown(1, axes, straight(axes, -0.1 * direction), True)).emergency_stop


def test_settings_follow_every_key_of_encoders_and_drives():
    """Latency of an encoder, and the twist and play of the gear behind it, which it does not see."""
    shipped = load_setup().cell
    joint = shipped.robot.joint[1]
    known = {"max_torque_n_m": 150.0, "gear_stiffness_n_m_rad": 60000.0, "backlash_deg": 0.01}
    drive = DriveDescription(motor_inertia_kg_m2=0.5, gear_damping_n_m_s_rad=40.0, **known)
    joints = tuple(one.model_copy(update={"drive": drive}) for one in shipped.robot.joint)
    late = joint.model_copy(update={"drive": drive, "encoder_latency_ms": 40.0, "encoder_noise_deg": 0.02})
    robot = shipped.robot.model_copy(update={"drive": "dynamic", "joint": (joints[0], late, *joints[2:])})
    plain, driven = settings_of(shipped), settings_of(shipped.model_copy(update={"robot": robot}))
    assert driven.reaction == pytest.approx(plain.reaction + 0.04)
    assert driven.noise == pytest.approx(np.radians(0.02), rel=1e-4)
    twist = 150.0 / 60000.0 + np.radians(0.01)
    assert np.asarray(driven.angle_error)[:-1] == pytest.approx(5 * driven.noise + twist)
    assert np.asarray(driven.angle_error)[-1] == pytest.approx(5 * driven.noise)
