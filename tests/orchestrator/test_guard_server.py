"""The guard as a process, over UDP and TCP.  Limits of time only end tests that hang."""

from __future__ import annotations

import itertools
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from guard_answers import FAILS, HANGS, STOP_FROM, JointLimitGuard, guard_process, state_at, until
from scancell.config.cell import LinkDescription
from scancell.config.choices import LOOPBACK
from scancell.errors import LinkError
from scancell.guard.endpoints import FAILED, REJECTED, SUPERSEDED, Outcome
from scancell.guard.messages import MAX_PACKET, CellState, GuardMessage, PlacedPart
from scancell.guard.server import serve_guard
from scancell.guard.transport import Link, TcpTransport, UdpTransport, faulty_link

TRANSPORTS = {"udp": UdpTransport, "tcp": TcpTransport}
CLIENT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "guard_client.py"
both_protocols = pytest.mark.parametrize("protocol", TRANSPORTS)


def link_to(protocol: str, port: int) -> Link:
    return Link(TRANSPORTS[protocol](LOOPBACK, port), age_limit=HANGS)


def answered(link: Link, state: CellState) -> GuardMessage:
    """The answer to a state, once it is there."""
    link.send(state, state.time)
    # Answers to earlier states may still be on their way.
    return until(lambda: next((a for a in link.poll(state.time) if a.state_sequence == state.sequence), None))


def reopened(link: Link, sequence: int) -> None:
    """Send states until one is answered: a session may have to wait for the end of the one before."""

    def attempt() -> list[GuardMessage] | None:
        nonlocal sequence
        sequence += 1
        state = state_at(sequence)
        link.send(state, state.time)
        return link.poll(state.time) or None

    until(attempt)


@both_protocols
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=["SIGTERM", "SIGINT"])
def test_states_are_answered_until_a_signal_ends_the_server(protocol, number):
    with guard_process(protocol) as server:
        assert server.host == LOOPBACK
        link = link_to(protocol, server.port)
        angles = np.linspace(0, 1.2, 25)
        for i, angle in enumerate(angles):
            answer = answered(link, state_at(i, angle))
            assert answer.emergency_stop == answer.beep == (angle >= STOP_FROM)
            assert answer.monitor_speed == pytest.approx(np.clip(2 * (1 - angle), 0, 1))
        assert server.end(number) == 0
        assert server.counts == link.counts == {Outcome.ACCEPTED: len(angles)}
        link.close()


@both_protocols
def test_killed_server_leaves_no_answer_and_a_new_one_waits_for_a_reset(protocol):
    with guard_process(protocol) as server:
        link = link_to(protocol, server.port)
        for i in range(5):
            answered(link, state_at(i))
        assert server.end(signal.SIGKILL) == -signal.SIGKILL
    for i in range(5, 10):
        link.send(state_at(i), state_at(i).time)
        assert link.poll(state_at(i).time) == []
    assert link.age(state_at(9).time) == pytest.approx(5 * 0.032)

    with guard_process(protocol, server.port) as server:
        for i in range(10, 20):
            link.send(state_at(i), state_at(i).time)
            assert link.poll(state_at(i).time) == []
        link.reset()
        assert link.age(20.0) == np.inf
        reopened(link, 20)
        assert server.end() == 0
        # The broken connection of TCP carries nothing; over UDP the new process itself refuses the old session.
        assert server.counts.get(Outcome.OTHER_SESSION, 0) == (10 if protocol == "udp" else 0)
        link.close()


@both_protocols
def test_one_cell_at_a_time(protocol):
    with guard_process(protocol) as server:
        first, second = link_to(protocol, server.port), link_to(protocol, server.port)
        answered(first, state_at(0))
        second.send(state_at(0), 0.0)
        answered(first, state_at(1))
        assert second.poll(0.0) == []
        reopened(second, 1)
        first.send(state_at(2), 0.0)
        answered(second, state_at(1000))
        assert first.poll(0.0) == []
        first.close()
        answered(second, state_at(1001))
        second.close()
        assert server.end() == 0
        assert server.counts[Outcome.BUSY] >= 1
        assert server.counts[Outcome.OTHER_SESSION] == 1


@both_protocols
def test_states_that_cannot_be_judged_get_no_answer_and_do_not_end_the_server(protocol):
    """States of another arm, and one at which the guard raises an exception."""
    with guard_process(protocol) as server:
        link = link_to(protocol, server.port)
        for i in range(50):
            link.send(replace(state_at(i), axes=np.zeros(4)), state_at(i).time)
        answered(link, state_at(50))
        link.send(state_at(51, FAILS), state_at(51).time)
        assert server.process.stdout is not None
        while "OverflowError: an error of the guard" not in server.process.stdout.readline():
            pass
        answered(link, state_at(52))
        link.close()
        assert server.end() == 0
        assert link.counts == {Outcome.ACCEPTED: 2}
        assert (server.counts[Outcome.ACCEPTED], server.counts[FAILED]) == (53, 1)
        assert server.counts.get(REJECTED, 0) + server.counts.get(SUPERSEDED, 0) == 50


@both_protocols
def test_state_of_the_largest_size_is_received_whole(protocol):
    """64 points ahead of a cell of 16 axes, which the guard of this test does not know."""
    axes = np.zeros(16)
    parts = tuple(PlacedPart(number, 0, (0, 0, 0, 1, 0, 0, 0)) for number in range(1, 9))
    large = replace(
        state_at(0), axes=axes, ahead=np.tile(axes, (64, 1)), spacing=0.016, widths=np.zeros(4), parts=parts
    )
    assert len(large.encode(1, 0)) == MAX_PACKET
    with guard_process(protocol) as server:
        link = link_to(protocol, server.port)
        link.send(large, large.time)
        answered(link, state_at(1))
        link.close()
        assert server.end() == 0
        assert server.counts.get(Outcome.MALFORMED, 0) == 0
        assert server.counts[Outcome.ACCEPTED] == 2


def test_flood_does_not_displace_states_of_the_cell():
    """The server is stopped until the flood has filled the buffers of its port."""
    with guard_process("udp") as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        link = link_to("udp", server.port)
        answered(link, state_at(0))
        for i in range(1, 20):
            server.process.send_signal(signal.SIGSTOP)
            for _ in range(2000):
                other.sendto(bytes(1000), (LOOPBACK, server.port))
            link.send(state_at(i), state_at(i).time)
            server.process.send_signal(signal.SIGCONT)
            answers = until(lambda i=i: link.poll(state_at(i).time) or None)
            assert [answer.state_sequence for answer in answers] == [i]
        link.close()
        assert server.end() == 0
        assert server.counts[Outcome.ACCEPTED] == 20
        assert server.counts[Outcome.MALFORMED] > 0


def test_connection_with_anything_but_packets_is_closed():
    with guard_process("tcp") as server:
        link = link_to("tcp", server.port)
        answered(link, state_at(0))
        packet = state_at(0).encode(1, 1)
        for text in (b"GET / HTTP/1.1\r\n\r\n", packet[:4] + b"\3" + packet[5:], packet[:6] + b"\xff\xff", bytes(9999)):
            with socket.create_connection((LOOPBACK, server.port), HANGS) as other:
                other.sendall(text)
                assert closed(other)
        with socket.create_connection((LOOPBACK, server.port), HANGS) as other:
            other.sendall(packet[:-1] + bytes([packet[-1] ^ 1]) + packet[:50])  # refused, and one that never ends
            answered(link, state_at(1))
            answered(link, state_at(2))
        assert server.end() == 0
        assert server.counts == {Outcome.ACCEPTED: 3, "broken streams": 4, Outcome.MALFORMED: 1}
        link.close()


def test_idle_connections_shut_out_neither_the_cell_nor_a_newcomer():
    with guard_process("tcp") as server:
        oldest = socket.create_connection((LOOPBACK, server.port), HANGS)
        link, silent = link_to("tcp", server.port), link_to("tcp", server.port)
        answered(link, state_at(0))
        idle = [socket.create_connection((LOOPBACK, server.port), HANGS) for _ in range(100)]
        assert closed(idle[-1])  # beyond the limit
        answered(link, state_at(1))
        reopened(silent, 2)  # a connection that had not sent yet
        oldest.setblocking(False)
        until(lambda: makes_room(oldest, server.port))
        for connection in (oldest, *idle):
            connection.close()
        link.close()
        silent.close()
        assert server.end() == 0


def makes_room(oldest: socket.socket, port: int) -> bool | None:
    """Whether the oldest connection is closed for a new one; None if not yet."""
    socket.create_connection((LOOPBACK, port), HANGS).close()
    try:
        return oldest.recv(1) == b""
    except BlockingIOError:
        return None


def test_cell_that_does_not_read_its_answers_is_disconnected():
    with guard_process("tcp") as server, socket.socket() as cell:
        cell.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        cell.settimeout(HANGS)
        cell.connect((LOOPBACK, server.port))
        sequence = itertools.count()
        with pytest.raises(ConnectionError):
            while True:
                cell.sendall(state_at(next(sequence)).encode(1, 0))
        assert server.end() == 0
        assert server.counts[Outcome.ACCEPTED] >= 100


def closed(connection: socket.socket) -> bool:
    """Whether the other side closes a connection."""
    try:
        return connection.recv(1) == b""
    except ConnectionResetError:
        return True


@both_protocols
def test_faults_between_sockets(protocol):
    """The link is dead for a time of the caller's clock, and a third of the answers arrives twice."""
    with guard_process(protocol) as server:
        faults = LinkDescription(to_guard={"dead_from_s": 1.0, "dead_until_s": 2.0}, to_cell={"duplication": 0.3})
        link = faulty_link(TRANSPORTS[protocol](LOOPBACK, server.port), faults, age_limit=HANGS, seed=3)
        for i in range(100):
            state = state_at(i)
            link.send(state, state.time)
            if 1.0 <= state.time < 2.0:
                assert link.poll(state.time) == []
            else:
                answers = until(lambda state=state: link.poll(state.time) or None)
                assert [answer.state_sequence for answer in answers] == [i]
        assert link.counts[Outcome.DUPLICATE] > 10
        assert server.end() == 0
        assert server.counts == {Outcome.ACCEPTED: 100 - 31}
        link.close()


@both_protocols
def test_port_in_use_is_refused_while_a_cell_is_served(protocol):
    with guard_process(protocol) as server:
        link = link_to(protocol, server.port)
        answered(link, state_at(0))
        with pytest.raises(LinkError, match=f"127.0.0.1:{server.port}: .*; expected an address to listen on"):
            serve_guard(JointLimitGuard(), port=server.port, protocol=protocol)
        answered(link, state_at(1))
        link.close()
        assert server.end() == 0


def test_addresses_that_cannot_be_used():
    with guard_process("tcp") as server:
        assert server.end() == 0
    with pytest.raises(LinkError, match=f"127.0.0.1:{server.port}: .*; expected a guard that listens there"):
        TcpTransport(LOOPBACK, server.port)
    with pytest.raises(LinkError, match="expected an address to listen on"):
        serve_guard(JointLimitGuard(), port=70000)
    with pytest.raises(LinkError, match="expected a guard"):
        UdpTransport("no host", 1)


def run_client(port: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(CLIENT), LOOPBACK, str(port)]
    return subprocess.run(command, capture_output=True, text=True, timeout=HANGS, check=False)


def test_example_client_is_stopped_by_the_guard():
    assert len(CLIENT.read_text().splitlines()) <= 50
    with guard_process("udp") as server:
        done = run_client(server.port)
        assert done.stderr == "emergency stop by the guard\n"
        assert server.end() == 0
        assert server.counts == {Outcome.ACCEPTED: len(done.stdout.splitlines())}
    angles = [float(line.split()[3]) for line in done.stdout.splitlines()]
    assert STOP_FROM <= angles[-1] < STOP_FROM + 0.04
    assert max(angles[:-1]) < STOP_FROM


def test_example_client_stops_without_a_guard():
    with guard_process("udp") as server:
        assert server.end() == 0
    done = run_client(server.port)
    assert (done.stdout, done.stderr) == ("", "stopped: no answer\n")
