"""Sockets around a simulated controller, in real or in simulated time: TCP servers, and clients of UDP."""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from selectors import EVENT_READ, EVENT_WRITE, DefaultSelector
from typing import Protocol

from scancell.config.choices import LOOPBACK
from scancell.errors import LinkError
from scancell.guard.server import bound_socket, stop_signals
from scancell.guard.transport import resolved

_MAX_CLIENTS = 64
_RECEIVE = 65_536  # bytes at a time
_MOST_DATAGRAMS = 64  # of a sensor, between two cycles
_SEND_BUFFER = 65_536  # bytes in the system: a client in simulated time is not far behind
_MOST_UNSENT = 1_000_000  # bytes that wait for a client that does not read them
_STALLED = 5.0  # s without reading after which a client is disconnected in simulated time
_IDLE = 0.2  # s between looks at a cell in which nothing happens


class Peer(Protocol):
    """One client's connection, or a sensor to which the controller sends datagrams: bytes in, bytes out."""

    @property
    def is_open(self) -> bool:
        """Whether the connection lasts."""

    @property
    def is_started(self) -> bool:
        """Whether the client receives data in every cycle, or at its own rate; of a sensor, whether it answered."""

    def receive(self, received: bytes) -> bytes:
        """Answers to what the client sent."""

    def cycle(self) -> bytes:
        """What is to be sent at the end of a cycle; to a sensor that does not answer in simulated time again."""

    def close(self) -> None:
        """The connection has ended."""


class Controller(Protocol):
    """A simulated controller."""

    @property
    def cycle(self) -> float:
        """Cycle, s."""

    @property
    def is_running(self) -> bool:
        """Whether a program runs, so that time passes without a client that receives data."""

    def step(self) -> None:
        """Let a cycle pass."""


@dataclass
class Timing:
    """Cycles of a server in real time: their number, and how many began more than a cycle late.

    Attributes
    ----------
    dropped
        Bytes that were not sent to clients that do not read.
    """

    cycles: int = 0
    late: int = 0
    dropped: int = 0


class _Client:
    def __init__(self, connection: socket.socket, peer: Peer) -> None:
        self.connection, self.peer = connection, peer
        self.unsent = b""
        self.read_at = time.monotonic()


def serve_controller(
    controller: Controller,
    ports: Mapping[int, Callable[[], Peer]],
    host: str = LOOPBACK,
    realtime: bool = True,
    started: Callable[[str], None] = lambda _: None,
    sensors: Mapping[tuple[str, int], Peer] | None = None,
) -> Timing:
    """Serve clients until SIGINT or SIGTERM; to be called in the main thread.

    In real time a cycle of the controller begins when it is due by the clock. In simulated time cycles follow each
    other as fast as all clients read them, and none passes while no client receives data and no program runs, or before
    a sensor has answered.

    Parameters
    ----------
    controller
        The controller.
    ports
        For each port (0: any free one) what makes the connection of a client.
    host
        Address to listen on. Nothing is authenticated: anyone who reaches it moves the simulated robot.
    realtime
        Whether it runs in real time.
    started
        Called with the address when the servers listen.
    sensors
        What answers by datagrams of UDP, by address and port: the controller sends there in every cycle.

    Raises
    ------
    LinkError
        If an address cannot be listened on, or sent to.
    CellError
        If the FMU reports an error.
    """
    with ControllerServer(controller, ports, host, realtime, sensors) as server, stop_signals() as stop:
        server.selector.register(stop, EVENT_READ)
        started(server.address)
        server.run(lambda: bool(server.readable(stop)))
        return server.timing


class ControllerServer:
    """Sockets of all ports, and their clients; see `serve_controller` for the parameters.

    Attributes
    ----------
    selector
        Watches the sockets; others may be registered.
    address, ports
        Address that listens, and its ports, each by the one that was asked for.
    timing
        Counts of cycles.
    """

    def __init__(
        self,
        controller: Controller,
        ports: Mapping[int, Callable[[], Peer]],
        host: str,
        realtime: bool,
        sensors: Mapping[tuple[str, int], Peer] | None = None,
    ) -> None:
        self._controller, self._realtime = controller, realtime
        self.selector = DefaultSelector()
        self.timing = Timing()
        self.address, self.ports = host, dict[int, int]()
        self._listeners: dict[socket.socket, Callable[[], Peer]] = {}
        self._clients: dict[socket.socket, _Client] = {}
        self._sensors: dict[socket.socket, Peer] = {}
        self._sent_at = -math.inf  # to sensors
        self._ready: set[object] = set()
        try:
            for port, make in ports.items():
                listener = bound_socket(host, port, socket.SOCK_STREAM)
                self._listeners[listener] = make
                self.selector.register(listener, EVENT_READ)
                self.address, self.ports[port] = listener.getsockname()[:2]
            for address, sensor in (sensors or {}).items():
                connection = datagram_socket(*address)
                self._sensors[connection] = sensor
                self.selector.register(connection, EVENT_READ)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> ControllerServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all connections."""
        for client in list(self._clients.values()):
            self._drop(client)
        for source in (*self._listeners, *self._sensors):
            source.close()
        self.selector.close()

    def readable(self, source: object) -> bool:
        """Whether a registered socket was readable in the last look at them."""
        return source in self._ready

    def run(self, ended: Callable[[], bool]) -> None:
        """Serve until `ended`."""
        cycle = self._controller.cycle
        due = time.monotonic() + cycle
        while not ended():
            now = time.monotonic()
            if self._realtime:
                self._look(max(0.0, due - now))
                if (now := time.monotonic()) < due:
                    continue
                self.timing.late += now > due + cycle
                due = max(due + cycle, now - 10 * cycle)  # a short delay is caught up
            else:
                self._look(0.0 if self._may_step else _IDLE)
                if not self._may_step:
                    if time.monotonic() - self._sent_at >= _IDLE:
                        self._send_to_sensors()
                    continue
            self._step()

    @property
    def _may_step(self) -> bool:
        """Whether a cycle may pass in simulated time."""
        clients = self._clients.values()
        if not all(sensor.is_started for sensor in self._sensors.values()) or any(client.unsent for client in clients):
            return False
        is_started = bool(self._sensors) or any(client.peer.is_started for client in clients)
        return is_started or self._controller.is_running

    def _step(self) -> None:
        self._controller.step()
        self.timing.cycles += 1
        for client in list(self._clients.values()):
            self._send(client, client.peer.cycle())
        self._send_to_sensors()

    def _send_to_sensors(self) -> None:
        self._sent_at = time.monotonic()
        for connection, sensor in self._sensors.items():
            with contextlib.suppress(OSError):  # a full buffer, or nobody listens yet: the next cycle sends again
                connection.send(sensor.cycle())

    def _look(self, timeout: float) -> None:
        """Take what has come, and send what waits, for at most `timeout`, s."""
        events = self.selector.select(timeout)
        self._ready = {key.fileobj for key, mask in events if mask & EVENT_READ}
        for key, mask in events:
            source = key.fileobj
            assert isinstance(source, socket.socket)
            if source in self._listeners:
                self._accept(source)
            elif (sensor := self._sensors.get(source)) is not None:
                with contextlib.suppress(OSError):  # nothing more has come, or nobody listens at the address
                    for _ in range(_MOST_DATAGRAMS):
                        sensor.receive(source.recv(_RECEIVE))
            elif (client := self._clients.get(source)) is not None:
                if mask & EVENT_WRITE:
                    self._send(client, b"")
                if mask & EVENT_READ and source in self._clients:
                    self._receive(client)
        if not self._realtime:
            self._drop_stalled()

    def _accept(self, listener: socket.socket) -> None:
        try:
            connection, _ = listener.accept()
        except OSError:  # it has gone already
            return
        if len(self._clients) >= _MAX_CLIENTS:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        client = _Client(connection, self._listeners[listener]())
        self._clients[connection] = client
        self.selector.register(connection, EVENT_READ)
        self._send(client, client.peer.cycle())

    def _receive(self, client: _Client) -> None:
        try:
            received = client.connection.recv(_RECEIVE)
        except BlockingIOError:
            return
        except OSError:
            received = b""
        if received:
            self._send(client, client.peer.receive(received))
        if not received or not client.peer.is_open:
            self._drop(client)

    def _send(self, client: _Client, more: bytes) -> None:
        if len(client.unsent) + len(more) > _MOST_UNSENT:  # whole packages are left out
            self.timing.dropped += len(more)
            more = b""
        waiting = client.unsent + more
        if not waiting:
            return
        try:
            sent = client.connection.send(waiting)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(client)
            return
        if sent:
            client.read_at = time.monotonic()
        had_to_wait, client.unsent = bool(client.unsent), waiting[sent:]
        if had_to_wait != bool(client.unsent):
            self.selector.modify(client.connection, EVENT_READ | EVENT_WRITE if client.unsent else EVENT_READ)

    def _drop_stalled(self) -> None:
        now = time.monotonic()
        for client in list(self._clients.values()):
            if client.unsent and now - client.read_at > _STALLED:
                self._drop(client)

    def _drop(self, client: _Client) -> None:
        if self._clients.pop(client.connection, None) is None:
            return
        with contextlib.suppress(KeyError, ValueError):
            self.selector.unregister(client.connection)
        client.connection.close()
        client.peer.close()


def datagram_socket(host: str, port: int) -> socket.socket:
    """Socket of UDP that sends to an address, and receives from there alone; raises `LinkError` if there is none."""
    try:
        family, address = resolved(host, port, socket.SOCK_DGRAM)
        made = socket.socket(family, socket.SOCK_DGRAM)
        try:
            made.connect(address)
        except BaseException:
            made.close()
            raise
    except OSError as error:
        raise LinkError(f"{host}:{port}: {error}", expected="an address to send to") from None
    made.setblocking(False)
    return made
