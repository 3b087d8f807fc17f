"""Packets of RTDE as bytes; the servers against packets, scripts and lines that are wrong in any way."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest

from scancell.errors import MessageError, ProgramError
from scancell.wire.ur.control import ControlScript
from scancell.wire.ur.controller import UrController
from scancell.wire.ur.packets import (
    Kind,
    PacketBuffer,
    Recipe,
    names_from,
    outputs_request,
    packed,
    text_message,
    text_message_from,
    version_request,
)
from scancell.wire.ur.ports import DashboardServer, ScriptServer
from scancell.wire.ur.rtde import RtdeServer
from scancell.wire.ur.script import ScriptBuffer, statements
from scancell.wire.ur.variables import INPUTS, OUTPUTS
from wire_ur import NAMES, controller_of, mutated, packets


@pytest.fixture(scope="module")
def controller() -> Iterator[UrController]:
    with controller_of() as made:
        yield made


@pytest.fixture
def server(controller: UrController) -> Iterator[RtdeServer]:
    made = RtdeServer(controller)
    assert answers(made.receive(packed(Kind.PROTOCOL_VERSION, version_request()))) == [(Kind.PROTOCOL_VERSION, b"\1")]
    yield made
    made.close()


def answers(received: bytes) -> list[tuple[int, bytes]]:
    return [tuple(packet) for packet in PacketBuffer().packets(received)]


def test_layout_of_a_package_is_that_of_the_guide() -> None:
    """Big-endian; the header is the size of the whole packet and the letter of its kind."""
    recipe = Recipe(3, ["a", "b", "c"], ["DOUBLE", "VECTOR6INT32", "UINT8"])
    payload = recipe.pack([0.25, range(6), 7])
    assert packed(Kind.DATA, payload) == struct.pack(">HBBd6iB", 3 + 1 + 8 + 24 + 1, ord("U"), 3, 0.25, *range(6), 7)
    assert recipe.unpack(payload) == {"a": (0.25,), "b": (0, 1, 2, 3, 4, 5), "c": (7,)}


@pytest.mark.parametrize("cut", [1, 2, 3, 7])
def test_packets_arrive_whole_however_the_stream_is_cut(cut: int) -> None:
    stream = b"".join(packets())
    buffer = PacketBuffer()
    found = [packet for i in range(0, len(stream), cut) for packet in buffer.packets(stream[i : i + cut])]
    assert b"".join(packed(*packet) for packet in found) == stream


@pytest.mark.parametrize("payload", [b"", b"a,,b", b",", b"\xff"])
def test_names_that_are_none_are_refused(payload: bytes) -> None:
    with pytest.raises(MessageError):
        names_from(payload)


def test_integers_beyond_their_type_are_clipped() -> None:
    assert Recipe(1, ["a"], ["INT32"]).pack([2**40]) == struct.pack(">Bi", 1, 2**31 - 1)


def test_data_that_are_no_numbers_are_refused() -> None:
    recipe = Recipe(1, ["a"], ["DOUBLE"])
    for payload in (struct.pack(">Bd", 1, np.nan), struct.pack(">Bd", 1, np.inf), b"\1", b"\1" + bytes(9)):
        with pytest.raises(MessageError):
            recipe.unpack(payload)


@pytest.mark.parametrize("text", ["", "refused", "ä" * 300])
def test_text_messages_come_back_as_far_as_they_are_long(text: str) -> None:
    payload = text_message(text, "source", 2)
    found, source, level = text_message_from(payload)
    assert (source, level) == ("source", 2)
    assert text.startswith(found.rstrip("\ufffd"))
    assert text_message_from(text_message("a", "b", 3)) == ("a", "b", 3)
    with pytest.raises(MessageError):
        text_message_from(payload[:-1])


def test_unknown_variables_are_not_found_and_make_no_recipe(server: RtdeServer) -> None:
    asked = packed(Kind.OUTPUTS, outputs_request(125.0, ["actual_q", "actual_weather"]))
    assert answers(server.receive(asked)) == [(Kind.OUTPUTS, b"\0VECTOR6D,NOT_FOUND")]
    assert answers(server.receive(packed(Kind.START))) == [(Kind.START, b"\0")]
    assert answers(server.receive(packed(Kind.INPUTS, b"actual_q"))) == [(Kind.INPUTS, b"\0NOT_FOUND")]


@pytest.mark.parametrize("frequency", [0.0, -1.0, 501.0, np.nan, np.inf])
def test_frequencies_beyond_the_cycle_are_refused(server: RtdeServer, frequency: float) -> None:
    asked = packed(Kind.OUTPUTS, outputs_request(frequency, NAMES))
    assert answers(server.receive(asked)) == [(Kind.OUTPUTS, b"\0")]


@pytest.mark.parametrize(("frequency", "expected"), [(500.0, 1000), (125.0, 250), (333.0, 666), (1.0, 2), (0.4, 0)])
def test_number_of_packages_is_that_of_the_frequency(server: RtdeServer, frequency: float, expected: int) -> None:
    server.receive(packed(Kind.OUTPUTS, outputs_request(frequency, ["timestamp"])))
    server.receive(packed(Kind.START))
    assert sum(bool(server.cycle()) for _ in range(1000)) == expected


def test_every_variable_can_be_read_and_every_input_written(controller: UrController, server: RtdeServer) -> None:
    names = list(OUTPUTS)
    for start in range(0, len(names), 100):
        part = names[start : start + 100]
        ((_, answer),) = answers(server.receive(packed(Kind.OUTPUTS, outputs_request(500.0, part))))
        recipe = Recipe(answer[0], part, answer[1:].decode().split(","))
        server.receive(packed(Kind.START))
        ((_, data),) = answers(server.cycle())
        assert recipe.unpack(data).keys() == set(part)
    ((_, answer),) = answers(server.receive(packed(Kind.INPUTS, ",".join(INPUTS).encode())))
    recipe = Recipe(answer[0], list(INPUTS), answer[1:].decode().split(","))
    values = [[0.5] * {"VECTOR6D": 6}.get(kind, 1) for kind in recipe.types]
    before = controller.refusals.copy()
    assert server.receive(packed(Kind.DATA, recipe.pack(values))) == b""
    assert controller.refusals == before
    assert controller.registers["input_double_register_47"] == 0.5


def test_inputs_belong_to_one_client_until_it_leaves(controller: UrController, server: RtdeServer) -> None:
    other = RtdeServer(controller)
    other.receive(packed(Kind.PROTOCOL_VERSION, version_request()))
    asked = packed(Kind.INPUTS, b"input_int_register_3,input_int_register_4,")
    assert answers(server.receive(asked)) == [(Kind.INPUTS, b"\1INT32,INT32")]
    assert answers(server.receive(asked)) == [(Kind.INPUTS, b"\2INT32,INT32")]
    assert answers(other.receive(asked)) == [(Kind.INPUTS, b"\0IN_USE,IN_USE")]
    server.close()
    assert answers(other.receive(asked)) == [(Kind.INPUTS, b"\1INT32,INT32")]
    other.close()


def test_nothing_is_answered_before_the_version(controller: UrController) -> None:
    server = RtdeServer(controller)
    assert answers(server.receive(packed(Kind.OUTPUTS, outputs_request(500.0, NAMES)))) == [(Kind.OUTPUTS, b"\0")]
    assert answers(server.receive(packed(Kind.PROTOCOL_VERSION, version_request(1)))) == [
        (Kind.PROTOCOL_VERSION, b"\0")
    ]


def test_mutated_packets_end_no_server(controller: UrController) -> None:
    rng = np.random.default_rng(56)
    honest, refused = packets(), controller.refusals["RTDE"]
    server = RtdeServer(controller)
    for number in range(10_000):
        server.receive(mutated(honest[number % len(honest)], rng))
        server.cycle()
        if not server.is_open or number % 4 == 0:
            server.close()
            server = RtdeServer(controller)
            for packet in honest[:5]:
                assert PacketBuffer().packets(server.receive(packet)) is not None
            assert server.is_started
    server.close()
    assert controller.refusals["RTDE"] > refused + 1_000
    assert np.isfinite([*controller.registers.values(), controller.speed_slider]).all()
    assert controller.inputs_of_others(object()) == set()
    controller.set_speed_slider(1.0)


# Scripts


PROGRAM = """def carry():
  # up and down
  movej([0.1, -1.2, -1.9, -1.6, 1.57, 0], a=1.4, v=0.5)
  movel(p[0.3, 0, 0.4, 0, 3.14, 0], v=2 * 0.1)
  set_digital_out(3, True)
  sleep(0.5)
  textmsg("done ", 3)
end
"""


def test_statements_of_a_program() -> None:
    found = statements(PROGRAM.rstrip("\n"))
    assert [one.name for one in found] == ["movej", "movel", "set_digital_out", "sleep", "textmsg"]
    assert found[0].arguments["q"] == (0.1, -1.2, -1.9, -1.6, 1.57, 0.0)
    assert found[1].number("v") == pytest.approx(0.2)
    assert [one.line for one in found] == [3, 4, 5, 6, 7]


@pytest.mark.parametrize("cut", [1, 5, 1000])
def test_programs_are_complete_at_their_end(cut: int) -> None:
    text = f"{PROGRAM}\nstopj(2)\ndef nested():\n  if True:\n    stopj(1)\n  end\nend\n".encode()
    buffer = ScriptBuffer()
    found = [program for i in range(0, len(text), cut) for program in buffer.programs(text[i : i + cut])]
    assert [program.split("\n")[0] for program in found] == ["def carry():", "stopj(2)", "def nested():"]


@pytest.mark.parametrize(
    "line",
    [
        "while True:",
        "a = 3",
        "movej([1, 2, 3])",
        "movej([0, 0, 0, 0, 0, nan])",
        "movel(get_actual_tcp_pose())",
        "movej([0,0,0,0,0,0], speed=1)",
        "movej([0,0,0,0,0,0], 1, 1, 0, 0, 9)",
        "movej([0,0,0,0,0,0], t=2)",
        "movej()",
        "stopj(1/0)",
        "stopj(True)",
        "powerdown()",
        "set_digital_out(1, 1)",
        "__import__('os')",
        "textmsg(open('x'))",
        "(" * 500,
        "stopj(" + "1+" * 2_000 + "1)",
        "stopj(" + "9" * 400 + ")",
        "x" * 5000,
        "end",
    ],
)
def test_lines_beyond_the_subset_are_refused_with_their_number(line: str) -> None:
    with pytest.raises(ProgramError, match="line 2"):
        statements(f"def f():\n  {line}\nend")


def test_other_programs_are_no_control_scripts() -> None:
    assert ControlScript.of(PROGRAM) is None
    lines = ['  textmsg("RTDE Control Script Loaded")', "  global reg_offset_int = # int register offset", "24", "end"]
    marked = "\n".join(["def rtde_control():", *lines])
    assert ControlScript.of(marked) == ControlScript(0, 24)


def test_mutated_scripts_and_lines_end_no_server(controller: UrController) -> None:
    rng = np.random.default_rng(57)
    script, dashboard = ScriptServer(controller), DashboardServer(controller)
    lines = [b"stop\n", b"PolyscopeVersion\n", b"running\n", b"play\n", b"pause\n", b"unlock protective stop\n"]
    for number in range(2_000):
        assert script.receive(mutated(PROGRAM.encode(), rng) + b"\nend\n") == b""
        dashboard.receive(mutated(lines[number % len(lines)], rng))
        if number % 20 == 0:
            controller.step()
        if not script.is_open:
            script = ScriptServer(controller)
        if not dashboard.is_open:
            dashboard = DashboardServer(controller)
    dashboard = DashboardServer(controller)
    assert dashboard.receive(b"robotmode\n") == b"Robotmode: RUNNING\n"
    controller.stop_program()


def test_endless_scripts_and_lines_close_the_connection(controller: UrController) -> None:
    script, dashboard = ScriptServer(controller), DashboardServer(controller)
    for _ in range(20):
        script.receive(b"def f():\n" + b"x" * 100_000)
        dashboard.receive(b"x" * 1_000)
    assert not script.is_open
    assert not dashboard.is_open
