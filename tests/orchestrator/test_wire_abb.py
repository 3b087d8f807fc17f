"""The simulated ABB over EGM: messages as bytes, and corrections of a sensor of our own."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
import pytest

import scancell
from scancell.errors import DescriptionError, LinkError, MessageError
from scancell.geometry import pose
from scancell.wire.abb.controller import COMM_TIMEOUT, EgmController, EgmServer
from scancell.wire.abb.packets import ROBOT, SENSOR, Kind, Message, packed, pose_from, pose_message, unpacked
from scancell.wire.robot import VirtualRobot
from scancell.wire.serve import ControllerServer
from wire_sensors import RESOLUTION, abb_controller, mutated, served

HEADER = {"seqno": 1, "tm": 0, "mtype": int(Kind.CORRECTION)}


@pytest.fixture
def controller() -> Iterator[EgmController]:
    with abb_controller() as made:
        yield made


@pytest.fixture
def server(controller: EgmController) -> EgmServer:
    return EgmServer(controller)


def correction(**fields: object) -> bytes:
    return packed({"header": HEADER, **fields}, SENSOR)


def to_joints(joints: np.ndarray) -> bytes:
    return correction(planned={"joints": {"joints": np.degrees(joints).tolist()}})


def to_pose(base_from_tcp: np.ndarray) -> bytes:
    return correction(planned={"cartesian": pose_message(base_from_tcp)})


def at_speeds(**speeds: object) -> bytes:
    return correction(speedRef=speeds)


def run(server: EgmServer, controller: EgmController, answer: bytes | None, cycles: int) -> Message:
    """Let cycles pass, each answered; the last state."""
    state = b""
    for _ in range(cycles):
        controller.step()
        state = server.cycle()
        if answer is not None:
            server.receive(answer)
    return unpacked(state, ROBOT)


def test_bytes_are_those_of_protocol_buffers() -> None:
    """By hand: tags are number << 3 | wire type, little-endian doubles, varints of seven bits."""
    message = {"header": {"seqno": 300, "mtype": 3}, "planned": {"joints": {"joints": [1.0, -2.0]}}}
    header = b"\x08\xac\x02\x18\x03"
    numbers = b"\x09" + np.array([1.0], "<f8").tobytes() + b"\x09" + np.array([-2.0], "<f8").tobytes()
    planned = b"\x0a" + bytes([len(numbers)]) + numbers
    expected = b"\x0a" + bytes([len(header)]) + header + b"\x12" + bytes([len(planned)]) + planned
    assert packed(message, SENSOR) == expected
    assert unpacked(expected, SENSOR) == message
    packed_numbers = b"\x0a\x10" + np.array([1.0, -2.0], "<f8").tobytes()
    assert unpacked(b"\x12" + bytes([len(packed_numbers) + 2, 0x0A, len(packed_numbers)]) + packed_numbers, SENSOR) == {
        "planned": {"joints": {"joints": [1.0, -2.0]}}
    }


def test_unknown_fields_are_left_out_and_messages_merge() -> None:
    unknown = b"\x78\x01" + b"\x7a\x02ab" + b"\x7d" + bytes(4) + b"\x79" + bytes(8)
    assert unpacked(unknown + b"\x0a\x02\x08\x05" + b"\x0a\x02\x18\x03", SENSOR) == {"header": {"seqno": 5, "mtype": 3}}


@pytest.mark.parametrize(
    "payload",
    [
        b"\x0a",
        b"\x0a\x05\x08",
        b"\x80" * 11,
        b"\x0b",
        b"\x08\x01",
        b"\x0a\x09\x09" + bytes(8),
        b"\x12\x0b\x0a\x09\x09" + np.array([np.nan], "<f8").tobytes(),
        packed({"planned": {"joints": {"joints": [0.0] * 33}}}, SENSOR),
    ],
)
def test_bytes_that_are_no_message_are_refused(payload: bytes) -> None:
    with pytest.raises(MessageError):
        unpacked(payload, SENSOR)


def test_pose_is_read_back() -> None:
    base_from_tcp = pose.from_rotation(pose.exp_rotation(np.array([0.3, -1.0, 2.0])), (0.4, -0.1, 0.7))
    assert pose_from(pose_message(base_from_tcp)) == pytest.approx(base_from_tcp, abs=1e-12)


@pytest.mark.parametrize("wrong", [{"orient": {"u0": 0.0}}, {"pos": {"x": 1.0}}, {"orient": dict.fromkeys("abcd", 0)}])
def test_pose_without_all_numbers_is_refused(wrong: Message) -> None:
    with pytest.raises(MessageError):
        pose_from({**pose_message(np.eye(4)), **wrong})


def test_joints_are_followed_and_read_back(server: EgmServer, controller: EgmController) -> None:
    goal = controller.robot.home + np.array([0.1, -0.05, 0.05, 0.2, -0.1, 0.3])
    state = run(server, controller, to_joints(goal), 200)
    measured = np.radians(state["feedBack"]["joints"]["joints"])
    assert measured == pytest.approx(goal, abs=RESOLUTION)
    assert np.radians(state["planned"]["joints"]["joints"]) == pytest.approx(goal, abs=1e-9)
    assert state["mciConvergenceMet"] == 1
    assert (state["mciState"], state["motorState"], state["rapidExecState"]) == (
        {"state": 3},
        {"state": 1},
        {"state": 2},
    )
    assert state["feedBack"]["time"] == {"sec": 0, "usec": 800_000}
    assert state["header"] == {"seqno": 200, "tm": 800, "mtype": Kind.DATA}


def test_pose_is_followed_and_read_back(server: EgmServer, controller: EgmController) -> None:
    goal = controller.robot.base_from_tcp(controller.robot.home) @ pose.translation((0.03, -0.02, 0.05))
    state = run(server, controller, to_pose(goal), 200)
    assert pose_from(state["planned"]["cartesian"]) == pytest.approx(goal, abs=1e-6)
    assert pose_from(state["feedBack"]["cartesian"]) == pytest.approx(goal, abs=1e-5)


def test_streamed_line_is_straight(server: EgmServer, controller: EgmController) -> None:
    """Set-points along a line at 50 mm/s: once at that speed, the TCP is on it in every cycle, few cycles behind."""
    robot = controller.robot
    start, step = robot.base_from_tcp(robot.home), 0.05 * robot.cycle
    places = []
    for i in range(200):
        server.receive(to_pose(start @ pose.translation((step * i, 0.0, 0.0))))
        controller.step()
        places.append(robot.base_from_tcp(robot.targets)[:3, 3])
    way = (np.array(places) - start[:3, 3]) @ start[:3, :3]
    assert np.abs(way[20:, 1:]).max() < 1e-6
    assert way[-1, 0] == pytest.approx(199 * step, abs=4 * step)


def test_speeds_of_joints_and_of_the_tcp(server: EgmServer, controller: EgmController) -> None:
    robot = controller.robot
    run(server, controller, at_speeds(joints={"joints": [5.0, 0.0, 0.0, 0.0, 0.0, 0.0]}), 100)
    assert np.degrees(robot.target_rates) == pytest.approx([5.0, 0, 0, 0, 0, 0], abs=1e-6)
    run(server, controller, at_speeds(cartesians={"value": [0.0, 0.0, -20.0, 0.0, 0.0, 0.0]}), 100)
    twist = robot.tcp_jacobian(robot.targets) @ robot.target_rates
    assert twist == pytest.approx([0.0, 0.0, -0.02, 0.0, 0.0, 0.0], abs=2e-5)
    run(server, controller, at_speeds(joints={"joints": [0.0] * 6}), 100)
    assert not robot.is_moving


def test_silence_of_the_sensor_ends_guidance_at_rest(server: EgmServer, controller: EgmController) -> None:
    robot, lines = controller.robot, []
    controller._show = lines.append
    run(server, controller, at_speeds(joints={"joints": [10.0] * 6}), 20)
    assert robot.is_moving
    run(server, controller, None, round(COMM_TIMEOUT / robot.cycle))
    assert controller.is_guided
    state = run(server, controller, None, 100)
    assert not robot.is_moving
    assert state["mciState"] == {"state": 2}
    assert "no correction for 1 s" in lines[-1]
    state = run(server, controller, to_joints(robot.home), 300)
    assert state["mciState"] == {"state": 3}
    assert robot.targets == pytest.approx(robot.home, abs=1e-9)


def test_correction_without_content_keeps_what_is_in_force(server: EgmServer, controller: EgmController) -> None:
    run(server, controller, correction(), 10)
    assert not controller.is_guided
    run(server, controller, at_speeds(joints={"joints": [1.0] * 6}), 10)
    run(server, controller, correction(), round(2.0 / controller.cycle))
    assert controller.is_guided
    assert controller.robot.is_moving


@pytest.mark.parametrize(
    "wrong",
    [
        correction(planned={"joints": {"joints": [0.0] * 5}}),
        correction(planned={"joints": {"joints": [0.0] * 6}, "cartesian": pose_message(np.eye(4))}),
        correction(planned={"joints": {"joints": [0.0] * 6}, "externalJoints": {"joints": [1.0]}}),
        correction(planned={"cartesian": {"pos": {"x": 1.0}}}),
        to_pose(pose.translation((5.0, 0.0, 0.0))),
        to_pose(pose.translation((1e280, 0.0, 0.0))),
        correction(
            planned={"cartesian": {**pose_message(np.eye(4)), "orient": dict.fromkeys(("u0", "u1", "u2", "u3"), 1e300)}}
        ),
        at_speeds(cartesians={"value": [1.0, 2.0, 3.0]}),
        at_speeds(joints={"joints": [1.0]}),
    ],
)
def test_correction_that_cannot_be_followed_ends_guidance(
    server: EgmServer, controller: EgmController, wrong: bytes
) -> None:
    run(server, controller, at_speeds(joints={"joints": [10.0] * 6}), 20)
    server.receive(wrong)
    state = run(server, controller, None, 100)
    assert controller.refusals["EGM"] == 1
    assert not controller.robot.is_moving
    assert state["mciState"] == {"state": 1}
    state = run(server, controller, to_joints(controller.robot.home), 300)
    assert state["mciConvergenceMet"] == 1


@pytest.mark.parametrize("kind", [None, 0, Kind.DATA, Kind.PATH_CORRECTION, 99])
def test_other_messages_are_refused_and_guidance_goes_on(
    server: EgmServer, controller: EgmController, kind: int | None
) -> None:
    run(server, controller, at_speeds(joints={"joints": [10.0] * 6}), 20)
    header = {} if kind is None else {"mtype": int(kind)}
    server.receive(packed({"header": header, "planned": {"joints": {"joints": [0.0] * 6}}}, SENSOR))
    assert controller.refusals["EGM"] == 1
    assert controller.is_guided
    assert controller.robot.is_moving


@pytest.mark.parametrize("angle", [1e6, -1e300])
def test_joints_beyond_their_limits_stop_at_the_limits(
    server: EgmServer, controller: EgmController, angle: float
) -> None:
    goal = np.append(controller.robot.home[:5], np.radians(angle))
    state = run(server, controller, to_joints(goal), 800)
    assert controller.robot.is_within_limits(controller.robot.targets)
    assert abs(state["planned"]["joints"]["joints"][5]) == pytest.approx(360.0, abs=1e-6)
    assert state["mciConvergenceMet"] == 0


def test_simulated_time_loses_no_cycle_and_waits_for_the_sensor(controller: EgmController) -> None:
    """Four seconds (`bench.wire_sensors` for ten minutes); a sensor that pauses receives the same state again."""
    with served(controller, EgmServer(controller)) as (sensor, server):
        times = []
        while not times or times[-1] < 4_000:
            times.append(unpacked(sensor.receive(), ROBOT)["header"]["tm"])
            if len(times) == 100:
                continue  # left unanswered: sent again
            sensor.answer(to_joints(controller.robot.home))
    assert times[99] == times[100]
    assert (np.diff(times[100:]) == 4).all()
    assert server.timing.cycles * 4 == pytest.approx(times[-1], abs=8)


def test_mutated_packets_end_no_server(server: EgmServer, controller: EgmController) -> None:
    """500 in simulated time without sockets (`bench.wire_sensors` for 100,000 over UDP); honest ones in between."""
    rng = np.random.default_rng(1)
    home = controller.robot.home
    honest = [
        to_joints(home + 0.01),
        to_pose(controller.robot.base_from_tcp(home)),
        at_speeds(joints={"joints": [1.0] * 6}, cartesians={"value": [0.0] * 6}),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for i in range(500):
            server.receive(mutated(honest[i % 3], rng))
            controller.step()
            assert unpacked(server.cycle(), ROBOT)["header"]["seqno"] == i + 1
    state = run(server, controller, to_joints(home), 1000)
    assert state["mciConvergenceMet"] == 1


def test_arm_of_seven_joints_and_wrong_addresses_are_refused() -> None:
    cell = scancell.assets_dir() / "cells" / "seven_axis.toml"
    with (
        scancell.Scanner(cell) as scanner,
        scanner.session() as session,
        pytest.raises(DescriptionError, match="6 joints"),
    ):
        EgmController(VirtualRobot(session))


def test_address_that_does_not_exist_is_an_error(controller: EgmController) -> None:
    with pytest.raises(LinkError, match="address to send to"):
        ControllerServer(controller, {}, "127.0.0.1", False, {("no host", 6510): EgmServer(controller)})
