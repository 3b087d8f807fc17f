"""The simulated KUKA over RSI: packets as bytes, and corrections of a sensor of our own."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
import pytest

from scancell.errors import MessageError
from scancell.geometry import pose
from scancell.wire.kuka.controller import MOST_LATE, RsiController, RsiServer
from scancell.wire.kuka.packets import (
    AXES,
    FRAME,
    Answer,
    answer_from,
    answer_packet,
    frame_of,
    pose_from,
    state_from,
    state_packet,
)
from wire_sensors import RESOLUTION, kuka_controller, mutated, served

Elements = dict[str, dict[str, float]]


@pytest.fixture
def controller() -> Iterator[RsiController]:
    with kuka_controller() as made:
        yield made


@pytest.fixture
def server(controller: RsiController) -> RsiServer:
    return RsiServer(controller)


@pytest.fixture
def absolute() -> Iterator[RsiController]:
    with kuka_controller(is_absolute=True) as made:
        yield made


def run(controller: RsiController, cycles: int, **corrections: object) -> Elements:
    """Let cycles pass, each answered with the same corrections; the last state."""
    server = RsiServer(controller)
    for _ in range(cycles):
        ipoc = state_from(server.cycle())[0]
        numbers = {name: np.array(values, float) for name, values in corrections.items()}
        server.receive(answer_packet(Answer(ipoc, numbers)))
        controller.step()
    return state_from(server.cycle())[1]


def silent(controller: RsiController, cycles: int) -> Elements:
    for _ in range(cycles):
        controller.step()
    return state_from(RsiServer(controller).cycle())[1]


def numbers(element: dict[str, float], names: tuple[str, ...]) -> np.ndarray:
    return np.array([element[name] for name in names])


def test_packets_are_xml_as_the_maker_describes_it() -> None:
    packet = state_packet({"RIst": {"X": 1.5, "Y": 2.0}, "Delay": {"D": 3}, "DiL": 5}, 4208163634)
    expected = b'<RIst X="1.500000" Y="2.000000"/><Delay D="3"/><DiL>5</DiL><IPOC>4208163634</IPOC></Rob>'
    assert packet == b'<Rob Type="KUKA">' + expected
    answer = answer_from(
        b'<Sen Type="ImFree"><EStr>Message</EStr><Tech T21="1.09" T22="2.08"/><RKorr X="4.0" Y="7.0" Z="32.0" A="6.0"'
        b' B="0.0" C="-1e-1"/><FREE>1</FREE><DiO>125</DiO><IPOC> 4208163634 </IPOC></Sen>'
    )
    assert (answer.ipoc, answer.outputs, answer.text, answer.unknown) == (4208163634, 125, "Message", ("FREE",))
    assert answer.corrections["RKorr"] == pytest.approx([4.0, 7.0, 32.0, 6.0, 0.0, -0.1])
    read = answer_from(answer_packet(answer))
    assert (read.ipoc, read.outputs, read.text) == (answer.ipoc, answer.outputs, answer.text)
    assert read.corrections["RKorr"] == pytest.approx(answer.corrections["RKorr"])


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"\xff\xfe",
        b"<Sen>",
        b"<Rob><IPOC>1</IPOC></Rob>",
        b"<Sen/>",
        b"<Sen><IPOC>-1</IPOC></Sen>",
        b"<Sen><IPOC>1e3</IPOC></Sen>",
        b"<Sen><IPOC>" + b"9" * 40 + b"</IPOC></Sen>",
        b'<Sen><RKorr X="nan"/><IPOC>1</IPOC></Sen>',
        b'<Sen><RKorr X="1e5"/><IPOC>1</IPOC></Sen>',
        b'<Sen><RKorr A1="1"/><IPOC>1</IPOC></Sen>',
        b'<Sen><AKorr A1="one"/><IPOC>1</IPOC></Sen>',
        b"<Sen><DiO>true</DiO><IPOC>1</IPOC></Sen>",
        b'<!DOCTYPE a [<!ENTITY b "c">]><Sen><EStr>&b;</EStr><IPOC>1</IPOC></Sen>',
        b'<?xml version="1.0" encoding="none"?><Sen><IPOC>1</IPOC></Sen>',
        b"<Sen><IPOC>1</IPOC></Sen>" + b" " * 8000,
    ],
)
def test_packets_that_are_no_answers_are_refused(packet: bytes) -> None:
    with pytest.raises(MessageError):
        answer_from(packet)


@pytest.mark.parametrize("frame", [(100, 200, 300, 40, 20, -170), (0, 0, 0, -90, 0, 0), (1, 2, 3, 0, 0, 0)])
def test_frames_are_turned_about_z_then_y_then_x(frame: tuple[float, ...]) -> None:
    place = pose_from(np.array(frame, float))
    a, b, c = np.radians(frame[3:])
    turns = (pose.exp_rotation(angle * axis) for angle, axis in zip((a, b, c), np.eye(3)[::-1], strict=True))
    about_z, about_y, about_x = turns
    assert place[:3, :3] == pytest.approx(about_z @ about_y @ about_x, abs=1e-12)
    assert place[:3, 3] == pytest.approx(np.array(frame[:3]) * 1e-3)
    assert frame_of(place) == pytest.approx(frame, abs=1e-9)


def test_pose_of_the_flange_with_axes_at_zero_is_that_of_the_data_sheet(controller: RsiController) -> None:
    """The arm is stretched out level: 25 + 455 + 420 + 80 mm forward, 400 + 35 mm up, flange forward."""
    robot = controller.robot
    place = frame_of(robot.carrier_from_base @ robot.base_from_flange(np.zeros(6)))
    assert place[:3] == pytest.approx([980.0, 0.0, 435.0], abs=1e-6)
    turned = robot.carrier_from_base @ robot.base_from_flange(np.radians([90.0, 0, 0, 0, 0, 0]))
    assert frame_of(turned)[:3] == pytest.approx([0.0, -980.0, 435.0], abs=1e-6)  # A1 turns clockwise from above


def test_relative_corrections_of_axes_add_up(controller: RsiController) -> None:
    start = np.degrees(controller.robot.targets)
    step = [0.02, -0.01, 0.01, 0.03, 0.0, -0.05]
    run(controller, 100, AKorr=step)
    state = run(controller, 200)
    assert numbers(state["ASPos"], AXES) == pytest.approx(start + 100 * np.array(step), abs=1e-5)
    assert numbers(state["AIPos"], AXES) == pytest.approx(numbers(state["ASPos"], AXES), abs=np.degrees(RESOLUTION))


def test_relative_corrections_of_the_pose_add_up_along_the_axes_of_the_base(controller: RsiController) -> None:
    start = numbers(run(controller, 1)["RSol"], FRAME)
    run(controller, 100, RKorr=[0.2, -0.1, -0.3, 0.0, 0.0, 0.0])
    state = run(controller, 100)
    assert numbers(state["RSol"], FRAME)[:3] == pytest.approx(np.add(start[:3], [20.0, -10.0, -30.0]), abs=1e-4)
    run(controller, 100, RKorr=[0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    turned = run(controller, 100)
    assert numbers(turned["RSol"], FRAME)[:3] == pytest.approx(numbers(state["RSol"], FRAME)[:3], abs=1e-3)
    before, after = (pose_from(numbers(s["RSol"], FRAME))[:3, :3] for s in (state, turned))
    assert np.degrees(pose.log_rotation(after @ before.T)) == pytest.approx([0.0, 0.0, 10.0], abs=1e-4)


def test_relative_corrections_of_the_pose_count_from_the_present_axes(controller: RsiController) -> None:
    run(controller, 100, AKorr=[0.1, -0.1, 0.1, 0.2, -0.1, 0.1])
    start = numbers(run(controller, 100)["RSol"], FRAME)
    run(controller, 100, RKorr=[0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    state = run(controller, 100)
    assert numbers(state["RSol"], FRAME) == pytest.approx(np.add(start, [20.0, 0, 0, 0, 0, 0]), abs=1e-4)


def test_absolute_corrections_count_from_the_start(absolute: RsiController) -> None:
    start = run(absolute, 1)
    for _ in range(2):
        state = run(absolute, 300, RKorr=[10.0, 0.0, -20.0, 0.0, 0.0, 0.0])
        shift = numbers(state["RSol"], FRAME) - numbers(start["RSol"], FRAME)
        assert shift == pytest.approx([10.0, 0.0, -20.0, 0.0, 0.0, 0.0], abs=1e-4)
    turned = run(absolute, 300, RKorr=[10.0, 0.0, -20.0, 0.0, 0.0, 0.0], AKorr=[0.0] * 5 + [5.0])
    change = numbers(turned["ASPos"], AXES) - numbers(state["ASPos"], AXES)
    assert change == pytest.approx([0.0] * 5 + [5.0], abs=1e-5)
    back = run(absolute, 300, RKorr=[0.0] * 6, AKorr=[0.0] * 6)
    assert numbers(back["ASPos"], AXES) == pytest.approx(numbers(start["ASPos"], AXES), abs=1e-5)


def test_late_answers_are_counted_and_have_no_effect(controller: RsiController, server: RsiServer) -> None:
    run(controller, 10)
    late, _ = state_from(server.cycle())
    start = controller.robot.targets
    silent(controller, 3)
    server.receive(answer_packet(Answer(late, {"AKorr": np.full(6, 1.0)})))
    state = silent(controller, 1)
    assert state["Delay"] == {"D": 4.0}
    assert controller.robot.targets == pytest.approx(start, abs=1e-12)
    assert controller.refusals.total() == 0
    state = run(controller, 10)
    assert state["Delay"] == {"D": 4.0}
    assert controller.is_guided


def test_last_correction_stays_in_force_until_the_robot_stops(controller: RsiController) -> None:
    """As with ``HOLDON="1"``: a relative correction goes on with every packet that is not answered, up to 100."""
    lines: list[str] = []
    controller._show = lines.append
    run(controller, 50, AKorr=[0.05, 0, 0, 0, 0, 0])
    state = silent(controller, MOST_LATE)
    assert controller.is_guided
    assert state["Delay"] == {"D": MOST_LATE}
    assert np.degrees(controller.robot.target_rates[0]) == pytest.approx(0.05 / controller.cycle, rel=1e-6)
    silent(controller, 100)
    assert not controller.is_guided
    assert not controller.robot.is_moving
    assert "101 packets in a row" in lines[-1]
    rest = controller.robot.targets
    run(controller, 10)
    assert controller.is_guided
    assert controller.robot.targets == pytest.approx(rest, abs=1e-12)


@pytest.mark.parametrize("shift", [-4, 1000, 10**9])
def test_answers_to_no_packet_are_refused(controller: RsiController, server: RsiServer, shift: int) -> None:
    ipoc = state_from(server.cycle())[0]
    server.receive(answer_packet(Answer(ipoc + shift if shift > 0 else 4)))
    assert controller.refusals["RSI"] == 1
    assert not server.is_started


def test_second_answer_to_a_packet_has_no_effect(controller: RsiController, server: RsiServer) -> None:
    run(controller, 5)
    start = controller.robot.targets
    ipoc = state_from(server.cycle())[0]
    for angle in (0.0, 1.0):
        server.receive(answer_packet(Answer(ipoc, {"AKorr": np.full(6, angle)})))
    controller.step()
    assert controller.robot.targets == pytest.approx(start, abs=1e-12)


def test_pose_out_of_reach_ends_the_motion_at_rest(controller: RsiController) -> None:
    run(controller, 20, AKorr=[0.05, 0, 0, 0, 0, 0])
    run(controller, 1, RKorr=[9000.0, 0, 0, 0, 0, 0])
    assert not controller.is_guided
    assert controller.refusals["RSI"] == 1
    silent(controller, 100)
    assert not controller.robot.is_moving


def test_outputs_texts_and_unknown_elements(controller: RsiController, server: RsiServer) -> None:
    lines: list[str] = []
    controller._show = lines.append
    for _ in range(3):
        ipoc = state_from(server.cycle())[0]
        server.receive(f"<Sen><EStr>hi</EStr><Door>1</Door><DiO>6</DiO><IPOC>{ipoc}</IPOC></Sen>".encode())
        controller.step()
    assert controller.robot.outputs == 6
    assert controller.refusals["RSI"] == 3
    assert sum("'hi'" in line for line in lines) == 1


def test_axes_beyond_their_limits_stop_there(controller: RsiController) -> None:
    """And leave them at once, however long corrections led beyond."""
    state = run(controller, 600, AKorr=[1.0, 0, 0, 0, 0, 0])
    assert state["ASPos"]["A1"] == pytest.approx(170.0, abs=1e-5)
    state = run(controller, 100, AKorr=[-0.1, 0, 0, 0, 0, 0])
    assert state["ASPos"]["A1"] == pytest.approx(160.0, abs=0.5)


@pytest.mark.parametrize("cycle_us", [4000, 12000])
def test_simulated_time_loses_no_cycle_and_waits_for_the_sensor(cycle_us: int) -> None:
    """Four seconds (`bench.wire_sensors` for ten minutes); a sensor that pauses receives the same state again."""
    with (
        kuka_controller(**{"cell.world.controller_cycle_us": cycle_us}) as controller,
        served(controller, RsiServer(controller)) as (sensor, _),
    ):
        ipocs: list[int] = []
        while not ipocs or ipocs[-1] - ipocs[0] < 4000:
            ipocs.append(state_from(sensor.receive())[0])
            if len(ipocs) != 100:  # left unanswered: sent again
                sensor.answer(answer_packet(Answer(ipocs[-1])))
    assert ipocs[99] == ipocs[100]
    assert set(np.diff(ipocs[100:])) == {cycle_us // 1000}
    assert controller.late == 0


def test_mutated_packets_end_no_server(controller: RsiController, server: RsiServer) -> None:
    """500 without sockets (`bench.wire_sensors` for 100,000 over UDP)."""
    rng = np.random.default_rng(1)
    run(controller, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for i in range(500):
            ipoc, _ = state_from(server.cycle())
            corrections = {"AKorr": rng.normal(0, 0.01, 6), "RKorr": rng.normal(0, 0.1, 6)}
            server.receive(mutated(answer_packet(Answer(ipoc, corrections, i, "text")), rng))
            controller.step()
    assert state_from(server.cycle())[0] == ipoc + 4
    run(controller, 200)
    assert controller.is_guided
    assert not controller.robot.is_moving
