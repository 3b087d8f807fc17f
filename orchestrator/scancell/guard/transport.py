"""Transports of packets between cell and guard; none of them blocks."""

from __future__ import annotations

import contextlib
import itertools
import socket
from collections import deque
from collections.abc import Iterator
from typing import Any, Protocol, runtime_checkable

from scancell.arguments import checked_arguments
from scancell.errors import LinkError, MessageError
from scancell.guard.channel import Arrival, Channel
from scancell.guard.endpoints import Answerer, GuardEndpoint
from scancell.guard.messages import MAX_PACKET, packet_length

_CONNECTING = 5.0  # s
_MAX_UNSENT = 16 * MAX_PACKET
_MAX_RECEIVED = 64  # packets at once, so that a flood does not hold up the cell


@runtime_checkable
class Transport(Protocol):
    """Carries packets to the guard, and its packets back."""

    def send(self, packet: bytes, time: float) -> None:
        """Send a packet at `time`, s; a packet that cannot be sent is lost."""
        ...

    def receive(self, time: float) -> list[Arrival]:
        """What has arrived until `time`, s, and was not received before."""
        ...

    def reset(self) -> None:
        """Connect again, if there is a connection."""
        ...

    def close(self) -> None:
        """End all connections."""
        ...


class PacketStream:
    """Packets in a stream of bytes: their headers state their lengths."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def packets(self, received: bytes) -> Iterator[bytes]:
        """Packets that are complete with the bytes `received`.

        Raises
        ------
        MessageError
            Where something else than a packet begins: the stream cannot be read any further.
        """
        self._bytes += received
        while len(self._bytes) >= 8 and len(self._bytes) >= (length := packet_length(bytes(self._bytes[:8]))):
            packet = bytes(self._bytes[:length])
            del self._bytes[:length]
            yield packet


class InProcess:
    """A guard in this process, in simulated time.

    Parameters
    ----------
    answerer
        The guard: a `Guard`, or another object with ``answer(state)`` and ``reset()``.
    compute_time
        Of an answer, s. Of the states that arrive meanwhile, the newest is the next to be answered.

    Examples
    --------
    >>> guard = scancell.guard_of()
    >>> link = scancell.Link(scancell.InProcess(guard, compute_time=0.003), guard.settings.max_age)
    >>> with scancell.Scanner() as scanner, scanner.session() as session:
    ...     guarded = scancell.GuardedCell(session.cell, 16_000, link, guard.settings.max_age)
    ...     link.send(guarded.state(), 0.0)
    >>> len(link.poll(0.002)), len(link.poll(0.004))
    (0, 1)
    """

    @checked_arguments
    def __init__(self, answerer: Answerer, compute_time: float = 0.0) -> None:
        self.endpoint = GuardEndpoint(answerer)
        self._compute_time = compute_time
        self._free_at = -float("inf")
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._answers: deque[Arrival] = deque()
        self._numbers = itertools.count()

    def send(self, packet: bytes, time: float) -> None:
        """Hand a `packet` to the guard at `time`, s."""
        self._waiting.append((time, packet))

    def receive(self, time: float) -> list[Arrival]:
        """Answers finished until `time`, s."""
        while self._waiting and (start := max(self._waiting[0][0], self._free_at)) <= time:
            while self._waiting and self._waiting[0][0] <= start:
                sent_at, packet = self._waiting.popleft()
                self.endpoint.receive(packet, sent_at)
            if (answer := self.endpoint.answer()) is not None:
                self._free_at = start + self._compute_time
                self._answers.append(Arrival(self._free_at, next(self._numbers), answer))
        finished = []
        while self._answers and self._answers[0].time <= time:
            finished.append(self._answers.popleft())
        return finished

    def reset(self) -> None:
        """Nothing: there is no connection."""

    def close(self) -> None:
        """Nothing: there is no connection."""


class FaultyTransport:
    """Another transport behind a channel in each direction; the channels' time is that of the calls."""

    def __init__(self, transport: Transport, to_guard: Channel, to_cell: Channel) -> None:
        self._transport = transport
        self._to_guard, self._to_cell = to_guard, to_cell

    def send(self, packet: bytes, time: float) -> None:
        """Send a packet at `time`, s."""
        self._to_guard.send(packet, time)

    def receive(self, time: float) -> list[Arrival]:
        """Packets that have passed both channels until `time`, s."""
        for arrival in self._to_guard.receive(time):
            self._transport.send(arrival.packet, arrival.time)
        for answer in self._transport.receive(time):
            self._to_cell.send(answer.packet, answer.time)
        return self._to_cell.receive(time)

    def reset(self) -> None:
        """Connect the transport again; packets in transit still arrive."""
        self._transport.reset()

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()


class UdpTransport:
    """Datagrams to a guard's server (``scancell guard serve``).

    Parameters
    ----------
    host, port
        Name or address of the server's machine, and its port. Whether it is there shows in its answers.

    Raises
    ------
    LinkError
        If the address is none.

    Examples
    --------
    >>> link = scancell.Link(scancell.UdpTransport("127.0.0.1", 4000), age_limit=0.12)
    >>> link.age(0.0)  # without an answer so far
    inf
    >>> link.close()
    """

    @checked_arguments
    def __init__(self, host: str, port: int) -> None:
        self._socket = _connected(host, port, socket.SOCK_DGRAM)

    def send(self, packet: bytes, time: float) -> None:
        """Send `packet` as a datagram; it is lost if there is no server or no room. `time` has no effect."""
        with contextlib.suppress(OSError):
            self._socket.send(packet)

    def receive(self, time: float) -> list[Arrival]:
        """Datagrams that have arrived, with `time`, s, as that of their arrival."""
        arrived: list[Arrival] = []
        for number in range(_MAX_RECEIVED):
            try:
                arrived.append(Arrival(time, number, self._socket.recv(MAX_PACKET + 1)))
            except BlockingIOError:
                break
            except OSError:  # the server of an earlier datagram was not there
                continue
        return arrived

    def reset(self) -> None:
        """Nothing: there is no connection."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpTransport:
    """A connection to a guard's server (``scancell guard serve --transport tcp``).

    Once it is broken, nothing is sent or received until `reset`.

    Parameters
    ----------
    host, port
        Name or address of the server's machine, and its port.

    Raises
    ------
    LinkError
        If there is no server.

    Examples
    --------
    >>> scancell.TcpTransport("127.0.0.1", 9)
    Traceback (most recent call last):
        ...
    scancell.errors.LinkError: 127.0.0.1:9: ...; expected a guard that listens there
    """

    @checked_arguments
    def __init__(self, host: str, port: int) -> None:
        self._address = host, port
        self._open()

    def _open(self) -> None:
        self._socket = _connected(*self._address, socket.SOCK_STREAM)
        self._stream, self._unsent = PacketStream(), bytearray()

    def send(self, packet: bytes, time: float) -> None:
        """Send `packet`, or as much of it as there is room for, and the remainder with the next ones.

        `time` has no effect.
        """
        self._unsent += packet
        try:
            del self._unsent[: self._socket.send(self._unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self.close()
        if len(self._unsent) > _MAX_UNSENT:
            self.close()

    def receive(self, time: float) -> list[Arrival]:
        """Packets that have arrived completely, with `time`, s, as that of their arrival."""
        packets: list[bytes] = []
        try:
            received = self._socket.recv(_MAX_RECEIVED * MAX_PACKET)
            for packet in self._stream.packets(received):
                packets.append(packet)
            if not received:
                self.close()
        except BlockingIOError:
            pass
        except (OSError, MessageError):
            self.close()
        return [Arrival(time, number, packet) for number, packet in enumerate(packets)]

    def reset(self) -> None:
        """Connect again.

        Raises
        ------
        LinkError
            If there is no server.
        """
        self.close()
        self._open()

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()
        self._unsent.clear()


def _connected(host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    try:
        family, address = resolved(host, port, kind)
        made = socket.socket(family, kind)
        try:
            made.settimeout(_CONNECTING)
            made.connect(address)
            made.setblocking(False)
            if kind is socket.SOCK_STREAM:
                made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except BaseException:
            made.close()
            raise
    except OSError as error:
        raise LinkError(f"{host}:{port}: {error}", expected="a guard that listens there") from None
    return made


def resolved(host: str, port: int, kind: socket.SocketKind) -> tuple[socket.AddressFamily, Any]:
    """Family and address of a host; `OSError` if there is none."""
    if not 0 <= port <= 65535:  # getaddrinfo takes it modulo 65536
        raise OSError("expected a port from 0 to 65535")
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=kind)[0]
    except UnicodeError:  # a name that no host can have
        raise OSError("expected the name or address of a host") from None
    return family, address
