"""Transports of packets between cell and guard; none of them blocks."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import math
import socket
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np

from scancell.arguments import Within, checked_arguments
from scancell.config.cell import ChannelDescription, LinkDescription
from scancell.errors import LinkError, MessageError
from scancell.guard.endpoints import Answerer, CellEndpoint, GuardEndpoint
from scancell.guard.messages import MAX_PACKET, CellState, GuardMessage, packet_length

_CONNECTING = 5.0  # s
_MAX_UNSENT = 16 * MAX_PACKET
_MAX_RECEIVED = 64  # packets at once, so that a flood does not hold up the cell


@dataclass(frozen=True, order=True)
class Arrival:
    """A packet at the time of its arrival, s; `number` orders those of the same time."""

    time: float
    number: int
    packet: bytes


class Channel:
    """One direction of a network.

    Losses follow the model of Gilbert (1960) and Elliott (1963): a chain of two states, inside and outside bursts,
    steps with every packet.  Every packet draws the same number of random numbers, so that two descriptions can be
    compared with the same luck.

    Parameters
    ----------
    description
        Faults.
    seed
        Random seed.

    Attributes
    ----------
    counts
        Packets sent, and how many of them were lost, delivered twice, and replayed.
    """

    def __init__(self, description: ChannelDescription, seed: int | np.random.SeedSequence) -> None:
        self._description = description
        self._rng = np.random.default_rng(seed)
        self._in_burst = False
        self._arrivals: list[Arrival] = []
        self._number = 0
        self.counts: Counter[str] = Counter()

    def send(self, packet: bytes, time: float) -> None:
        """Send a packet at `time`, s; times do not decrease."""
        change, loss, delay, duplication, delay_of_copy, replay = self._rng.random(6)
        described = self._description
        self._in_burst = change >= 1 / described.burst_packets if self._in_burst else change < described.burst
        self.counts["sent"] += 1
        if self._is_dead(time) or loss < (described.burst_loss if self._in_burst else described.loss):
            self.counts["lost"] += 1
            return
        arrival = time + self._delay(delay)
        self._deliver(packet, arrival)
        if duplication < described.duplication:
            self.counts["duplicated"] += 1
            self._deliver(packet, time + self._delay(delay_of_copy))
        if replay < described.replay:
            self.counts["replayed"] += 1
            self._deliver(packet, arrival + 1e-3 * described.replay_ms)

    def receive(self, time: float) -> list[Arrival]:
        """Packets that have arrived until `time`, s, and were not received before, in the order of arrival."""
        arrived = []
        while self._arrivals and self._arrivals[0].time <= time:
            arrived.append(heapq.heappop(self._arrivals))
        return arrived

    def _delay(self, draw: float) -> float:
        return 1e-3 * (self._description.delay_ms - self._description.jitter_ms * math.log1p(-draw))

    def _deliver(self, packet: bytes, time: float) -> None:
        if self._is_dead(time):
            self.counts["lost"] += 1
            return
        heapq.heappush(self._arrivals, Arrival(time, self._number, packet))
        self._number += 1

    def _is_dead(self, time: float) -> bool:
        start, end = self._description.dead_from_s, self._description.dead_until_s
        return start is not None and time >= start and (end is None or time < end)


@runtime_checkable
class Transport(Protocol):
    """Carries packets to the guard, and its packets back."""

    def send(self, packet: bytes, time: float) -> None:
        """Send a packet at `time`, s; a packet that cannot be sent is lost."""
        ...

    def receive(self, time: float) -> list[Arrival]:
        """Packets that have arrived until `time`, s, and were not received before."""
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
        Compute time of an answer, s. Of the states that arrive meanwhile, the newest is the next to be answered.

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


class CellFaults:
    """Faults of a controller: a wrong clock, and queries that answer with old states.

    An old state has the number of the new one and the time at which it was measured.
    """

    def __init__(self, description: LinkDescription, seed: int | np.random.SeedSequence) -> None:
        self._description = description
        self._rng = np.random.default_rng(seed)
        self._measured: deque[CellState] = deque(maxlen=description.stale_polls + 1)

    def clock(self, time: float) -> float:
        """Reading of the controller's clock at `time`, s."""
        return 1e-3 * self._description.clock_offset_ms + time * (1 + 1e-6 * self._description.clock_drift_ppm)

    def queried(self, state: CellState) -> CellState:
        """The state to send in place of one with true times."""
        self._measured.append(state)
        is_stale = self._rng.random() < self._description.stale
        sent = self._measured[0] if is_stale else state
        path_time = self.clock(sent.path_time) if sent.spacing else 0.0
        return replace(sent, sequence=state.sequence, time=self.clock(sent.time), path_time=path_time)


class Link:
    """Sends states of the cell to its guard and receives the answers, without waiting.

    Times are those of the controller's clock in s, simulated or not; they do not decrease.

    Parameters
    ----------
    transport
        Carries the packets: `InProcess`, `UdpTransport` or `TcpTransport`.
    age_limit
        Answers to states older than that are refused, s.
    faults
        Faults of the controller; then the times are true ones. None: no faults.

    Examples
    --------
    >>> guard = scancell.guard_of()
    >>> link = scancell.Link(scancell.InProcess(guard, compute_time=0.003), guard.settings.max_age)
    >>> with scancell.Scanner() as scanner, scanner.session() as session:
    ...     guarded = scancell.GuardedCell(session.cell, 16_000, link, guard.settings.max_age)
    ...     guarded.attach()
    ...     session.wait(0.8)
    ...     print(f"{link.counts['accepted']} answers, the last one to a state {link.age(session.time):.3f} s old")
    25 answers, the last one to a state 0.032 s old
    """

    @checked_arguments
    def __init__(self, transport: Transport, age_limit: float, faults: CellFaults | None = None) -> None:
        self._transport, self._faults = transport, faults
        self._endpoint = CellEndpoint(age_limit)

    @property
    def counts(self) -> Counter[str]:
        """Numbers of packets received, by result: ``accepted``, ``stale``, ``duplicate`` …"""
        return self._endpoint.counts

    def send(self, state: CellState, time: float) -> None:
        """Send a `state` of the cell (`GuardedCell.state`) at `time`, s."""
        sent = self._faults.queried(state) if self._faults else state
        self._transport.send(self._endpoint.packet(sent), time)

    def poll(self, time: float) -> list[GuardMessage]:
        """New answers at `time`, s, in the order of their numbers; the last one applies.

        Each has ``monitor_speed`` (0 to 1), ``emergency_stop``, ``text`` and ``beep`` for the pendant, and the time
        ``state_time``, s, of the state that it answers.
        """
        received = [
            self._endpoint.receive(arrival.packet, self._clock(time)) for arrival in self._transport.receive(time)
        ]
        return [answer for answer in received if answer is not None]

    def age(self, time: float) -> float:
        """Age at `time`, s, of the state that the last accepted answer is about; infinite before the first."""
        return self._endpoint.age(self._clock(time))

    def reset(self) -> None:
        """Open a new session, also with a restarted guard; only after a reset by an operator.

        Raises
        ------
        LinkError
            If the transport needs a connection and there is no server.
        """
        self._transport.reset()
        self._endpoint.reset()

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()

    def _clock(self, time: float) -> float:
        return self._faults.clock(time) if self._faults else time


@checked_arguments
def faulty_link(
    transport: Transport,
    description: LinkDescription,
    age_limit: float,
    seed: Annotated[int, Within(0)],
    kind: type[Link] = Link,
) -> Link:
    """Make a link with faults, which are the same for the same seed.

    Parameters
    ----------
    transport, age_limit
        As of `Link`.
    description
        The faults.
    seed
        Seed of the random numbers.
    kind
        Class of the link.

    Examples
    --------
    >>> faults = scancell.LinkDescription(to_cell=scancell.ChannelDescription(delay_ms=2, loss=0.5))
    >>> guard = scancell.guard_of()
    >>> link = scancell.faulty_link(scancell.InProcess(guard), faults, guard.settings.max_age, seed=1)
    >>> with scancell.Scanner() as scanner, scanner.session() as session:
    ...     scancell.GuardedCell(session.cell, 16_000, link, guard.settings.max_age).attach()
    ...     session.wait(0.8)
    ...     link.counts["accepted"] < 25
    True
    """
    to_guard, to_cell, of_cell = np.random.SeedSequence(seed).spawn(3)
    channels = Channel(description.to_guard, to_guard), Channel(description.to_cell, to_cell)
    return kind(FaultyTransport(transport, *channels), age_limit, CellFaults(description, of_cell))
