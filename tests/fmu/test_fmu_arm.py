"""Motion of the arm through FMU variables: moves, lines, jogs, emergency stop; latency, jitter and vibration."""

from __future__ import annotations

import numpy as np
import pytest
from cell_fixture import CYCLE_US, START, Array, Build, CellFmu, Parameters, all_reals, cell_description

TARGET = START + np.array([0.3, 0.2, -0.3, 0.5, -0.2, 0.8])
JOINT_MOVE, LINE_MOVE, JOINT_JOG, CARTESIAN_JOG = 2, 3, 4, 5


def start_line(cell: CellFmu, displacement: Array, speed: float = 0.2) -> None:
    """Start a line move of the sensor by `displacement` (m, world) with constant orientation."""
    for i, value in enumerate(cell.vector("truth.sensor.position", 3) + displacement, 1):
        cell.set(f"command.target.position[{i}]", float(value))
    for i, value in enumerate(cell.vector("truth.sensor.orientation", 4), 1):
        cell.set(f"command.target.orientation[{i}]", float(value))
    cell.set("command.mode", LINE_MOVE)
    cell.set("command.speed", speed)
    cell.set("command.start", 1)


def run_to_rest(cell: CellFmu, step_us: int = CYCLE_US) -> None:
    cell.step(CYCLE_US)
    while cell.get_int("controller.moving"):
        cell.step(step_us)
        assert cell.time_us < 60_000_000


@pytest.mark.parametrize("version", [2, 3])
def test_joint_move_ends_exactly_at_target(build: Build, version: int) -> None:
    cell = build(version)
    cell.start_move(TARGET, 0.5)
    cell.step(CYCLE_US)
    np.testing.assert_array_equal(cell.vector("controller.destination.q", 6), TARGET)
    assert [cell.get_int(f"controller.{n}") for n in ("mode", "state", "error", "at_destination")] == [2, 1, 0, 0]
    run_to_rest(cell)
    np.testing.assert_array_equal(cell.vector("truth.q", 6), TARGET)
    assert cell.get("truth.table")[0] == 0.5
    assert [cell.get_int(f"controller.{n}") for n in ("state", "at_destination")] == [0, 1]
    assert cell.get("controller.progress")[0] == 1.0


def test_line_move_is_straight(build: Build) -> None:
    cell = build()
    displacement = np.array([0.04, -0.1, 0.06])
    start, turn = cell.vector("truth.sensor.position", 3), cell.vector("truth.sensor.orientation", 4)
    start_line(cell, displacement)
    worst = 0.0
    cell.step(CYCLE_US)
    while cell.get_int("controller.moving"):
        cell.step(700)
        travel = cell.vector("truth.sensor.position", 3) - start
        worst = max(
            worst, float(np.linalg.norm(travel - travel @ displacement / (displacement @ displacement) * displacement))
        )
        np.testing.assert_allclose(cell.vector("truth.sensor.orientation", 4), turn, atol=1e-6)
    np.testing.assert_allclose(travel, displacement, atol=1e-10)
    assert worst < 1e-7


def test_moves_are_independent_of_communication_step(build: Build) -> None:
    ends = []
    for step_us in (40, 1000, CYCLE_US, 160_000):
        cell = build()
        start_line(cell, np.array([0.0, -0.05, 0.05]))
        while cell.time_us < 160_000:
            cell.step(step_us)
        ends.append(all_reals(cell)[1:])
    for end in ends[1:]:
        np.testing.assert_array_equal(end, ends[0])


def test_rejected_moves_report_error_and_axis(build: Build) -> None:
    cell = build()
    cell.set("command.operation", 0)
    cell.start_move(TARGET, 0.0)
    cell.step(CYCLE_US)
    assert cell.get_int("controller.error") == 1
    cell.set("command.operation", 1)
    beyond = TARGET.copy()
    beyond[2] = 5.0
    cell.start_move(beyond)
    cell.step(CYCLE_US)
    assert [cell.get_int("controller.error"), cell.get_int("controller.limit")] == [5, 3]
    assert int(cell.variables["controller.limit"].max) == len(TARGET) + 1  # the table
    cell.set("command.mode", JOINT_JOG)
    cell.step(CYCLE_US)
    assert cell.get_int("controller.error") == 2
    np.testing.assert_array_equal(cell.vector("truth.q", 6), START)


def test_emergency_stop_is_bounded_and_latched(build: Build) -> None:
    cell = build()
    cell.start_move(TARGET, 0.0)
    cell.step(CYCLE_US, 8)
    cell.set("command.emergency_stop", True)
    rates = [cell.vector("measured.qd", 6)]
    for _ in range(400):
        cell.step(1000)
        rates.append(cell.vector("measured.qd", 6))
    assert np.abs(np.diff(rates, axis=0)).max() / 1e-3 <= 20.0
    assert not rates[-1].any()
    cell.set("command.emergency_stop", False)
    cell.step(CYCLE_US, 10)
    assert [cell.get_int("controller.state"), cell.get_int("controller.error")] == [3, 3]
    cell.set("command.mode", 0)
    cell.set("command.reset", 1)
    cell.step(CYCLE_US)
    assert [cell.get_int("controller.state"), cell.get_int("controller.error")] == [0, 0]


@pytest.mark.parametrize("mode", [JOINT_MOVE, LINE_MOVE, CARTESIAN_JOG])
def test_state_during_motion_restores_exactly(build: Build, mode: int) -> None:
    description = cell_description()
    for joint in description["robot"]["joints"]:
        joint["encoder_latency"] = 0.0037
    cell, other = build(3, description), build(3, description)
    if mode == JOINT_MOVE:
        cell.start_move(TARGET, 0.0)
    elif mode == LINE_MOVE:
        start_line(cell, np.array([0.0, -0.1, 0.05]))
    else:
        cell.set("command.operation", 0)
        cell.set("command.mode", mode)
        cell.set("command.jog[2]", -0.7)
    cell.step(8 * CYCLE_US + 330)
    state = cell.serialize(cell.save())
    other.restore(other.deserialize(state), cell.time_us)
    for instance in (cell, other):
        instance.step(700, 100)
    np.testing.assert_array_equal(all_reals(cell), all_reals(other))


OUT_OF_RANGE = {
    "command.jog[3]": (1 + 1e-9, 1.0), "command.jog[4]": (-3.0, -1.0), "command.monitor_speed": (1.5, 1.0),
    "command.speed": (0.0, 1e-6), "command.max_age": (-1.0, 0.0), "command.exposure": (-1e-3, 0.0),
    "command.trigger.period": (-1.0, 0.0), "command.target.orientation[1]": (1 + 1e-12, 1.0),
}  # fmt: skip


@pytest.mark.parametrize("version", [2, 3])
def test_real_inputs_out_of_range_are_clamped_with_a_warning(build: Build, version: int) -> None:
    cell = build(version, loggingOn=True)
    for name, (value, bound) in OUT_OF_RANGE.items():
        variable = cell.variables[name]
        assert bound in (float(variable.min or "nan"), float(variable.max or "nan"))
        cell.set(name, value)
        assert cell.get(name)[0] == bound
        assert cell.log[-1] == (1, "logStatusWarning")
        assert name in cell.messages[-1]
    cell.step(CYCLE_US, 2)  # the instance stays usable
    assert cell.get("time")[0] == pytest.approx(2 * CYCLE_US * 1e-6)


@pytest.mark.parametrize(
    ("name", "range_"),
    [("as_built.trigger.jitter", "0 to 10 s"), ("as_built.vibration.base.random_rms", "0 to 1000 m")],
)
def test_parameters_out_of_range_are_rejected_when_set(build: Build, name: str, range_: str) -> None:
    with pytest.raises(RuntimeError, match=f"{name} must be from {range_}, not -0.25"):
        build(3, parameters={name: -0.25})


def test_encoder_latency_delays_readings(build: Build) -> None:
    latency = 0.0043
    description = cell_description()
    for axis in [*description["robot"]["joints"], description["table"]]:
        axis["encoder_latency"] = latency
    late, prompt = build(3, description), build()
    for cell in (late, prompt):
        cell.start_move(TARGET, 1.0)
    late.step(4300)
    for _ in range(100):
        late.step(700)
        prompt.step(700)
        np.testing.assert_allclose(late.vector("measured.q", 6), prompt.vector("truth.q", 6), atol=1e-12)
        np.testing.assert_allclose(late.vector("measured.qd", 6), prompt.vector("measured.qd", 6), atol=1e-9)
    # To first order the lag is speed times latency.
    lag = late.vector("truth.q", 6) - late.vector("measured.q", 6)
    speed = (late.vector("measured.qd", 6) + prompt.vector("measured.qd", 6)) / 2
    np.testing.assert_allclose(lag, speed * latency, rtol=0.15)


def light_delays(build: Build, step_us: int, parameters: Parameters) -> Array:
    """Delay of the light after the middle of each exposure, from the angle of a table with constant speed."""
    cell = build(3, parameters=parameters)
    cell.command(table=1e4)
    cell.step(33 * CYCLE_US)  # accelerates to 10 rad/s
    cell.trigger(1, 0.004, exposure=0.002)
    names = [n for n, v in cell.variables.items() if n.startswith("trigger.") and v.type == "Float64"]
    record_of = cell.records(step_us, 33 * CYCLE_US + 1_000_000)
    columns = {name: np.array([row[i] for row in record_of.values()]) for i, name in enumerate(names)}
    w, z = (columns[f"trigger.truth.table.orientation[{i}]"] for i in (1, 4))
    turn = 2 * np.arctan2(z, w) - columns["trigger.measured.table"]
    return np.asarray((turn + np.pi) % (2 * np.pi) - np.pi) / 10.0


def test_trigger_jitter_standard_deviation_and_repeatability(build: Build) -> None:
    parameters: Parameters = {"as_built.trigger.latency": 0.0005, "as_built.trigger.jitter": 0.00005, "seed": 4}
    delays = light_delays(build, 1000, parameters)
    assert len(delays) >= 250
    assert delays.mean() == pytest.approx(0.0005, abs=4 * 0.00005 / np.sqrt(len(delays)))
    assert delays.std() == pytest.approx(0.00005, rel=0.15)
    np.testing.assert_allclose(light_delays(build, 700, parameters), delays, atol=1e-12)
    assert not np.allclose(light_delays(build, 1000, {**parameters, "seed": 5}), delays, atol=1e-6)


def test_light_never_precedes_firing(build: Build) -> None:
    delays = light_delays(build, 1000, {"as_built.trigger.jitter": 0.003})
    assert delays.min() == pytest.approx(-0.001, abs=1e-6)  # half the exposure


SINE: Parameters = {"x": 1e-4, "y": -2e-4, "z": 3e-4, "frequency": 23.0, "phase": 0.7}
SHAKEN = {"base": ["link[1]", "link[6]", "sensor"], "flange": ["link[6]", "sensor"], "table": ["table", "part[1]"]}


@pytest.mark.parametrize("place", list(SHAKEN))
def test_vibration_displaces_true_poses_by_closed_form(build: Build, place: str) -> None:
    still = build()
    vibrating = build(parameters={f"as_built.vibration.{place}.{k}": v for k, v in SINE.items()})
    axes = still.body("link[6]")[:3, :3] if place == "flange" else np.eye(3)
    names = ["link[1]", "link[5]", "link[6]", "sensor", "table", "part[1]"]
    for _ in range(50):
        still.step(1300)
        vibrating.step(1300)
        angle = 2 * np.pi * 23.0 * still.time_us * 1e-6 + 0.7
        amplitude = axes @ [1e-4, -2e-4, 3e-4]
        for name in names:
            moved = 1.0 if name in SHAKEN[place] or (place == "base" and "link" in name) else 0.0
            displacement = vibrating.vector(f"truth.{name}.position", 3) - still.vector(f"truth.{name}.position", 3)
            speed = vibrating.vector(f"truth.{name}.velocity", 3)
            np.testing.assert_allclose(displacement, moved * amplitude * np.sin(angle), atol=1e-14)
            np.testing.assert_allclose(speed, moved * amplitude * 2 * np.pi * 23.0 * np.cos(angle), atol=1e-12)
        np.testing.assert_array_equal(vibrating.vector("measured.q", 6), still.vector("measured.q", 6))


def test_sensor_twist_is_pose_derivative_with_vibration(build: Build) -> None:
    parameters = {f"as_built.vibration.{place}.{k}": v for place in ("base", "flange") for k, v in SINE.items()}
    cell = build(parameters=parameters)
    cell.start_move(TARGET, 0.0)
    cell.step(8 * CYCLE_US)
    before = cell.vector("truth.sensor.position", 3)
    cell.step(20)
    speed = cell.vector("truth.sensor.velocity", 3)
    cell.step(20)
    after = cell.vector("truth.sensor.position", 3)
    np.testing.assert_allclose((after - before) / 40e-6, speed, atol=1e-5)


def test_random_vibration_rms_at_any_step(build: Build) -> None:
    group = "as_built.vibration.table."
    parameters: Parameters = {group + "random_rms": 5e-6, group + "random_low": 30.0, group + "random_width": 100.0}
    samples: dict[int, list[Array]] = {1000: [], 700: []}
    for step_us, found in samples.items():
        cell = build(parameters=parameters)
        while cell.time_us < 2_100_000:
            cell.step(step_us)
            if cell.time_us % 7000 == 0:
                found.append(cell.vector("truth.table.position", 3) - [0.45, 0.0, 0.1])
    np.testing.assert_array_equal(samples[1000], samples[700])
    np.testing.assert_allclose(np.std(samples[1000], axis=0), 5e-6, rtol=0.12)


@pytest.mark.parametrize("scale", [0.1, 0.2, 5.0])
def test_line_moves_of_small_and_large_arms_are_regular(build: Build, scale: float) -> None:
    """The bound of the smallest singular value, with rows in m and rad, is that of the rates of the joints."""
    description = cell_description()
    for joint in description["robot"]["joints"]:
        joint["a"] *= scale
        joint["d"] *= scale
    description["tool"]["flange_from_sensor"]["position"] = [0.01 * scale, -0.02 * scale, 0.08 * scale]
    description["table"]["world_from_table"]["position"] = [5.0, 0.0, 0.1]  # out of the way
    cell = build(2, description)
    displacement = np.array([0.0, 0.0, 0.03 * scale])
    target = cell.vector("truth.sensor.position", 3) + displacement
    start_line(cell, displacement)
    cell.step(CYCLE_US, 120)
    assert cell.get_int("controller.error") == 0
    np.testing.assert_allclose(cell.vector("truth.sensor.position", 3), target, rtol=0, atol=1e-8)
