"""The guard as a server: one cell at a time, over UDP or TCP."""

from __future__ import annotations

import contextlib
import signal
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from selectors import EVENT_READ, DefaultSelector
from typing import Any

from scancell.config.choices import LOOPBACK, TransportProtocol
from scancell.errors import LinkError, MessageError
from scancell.guard.endpoints import Answerer, GuardEndpoint
from scancell.guard.messages import MAX_PACKET
from scancell.guard.transport import PacketStream, resolved

_MAX_CONNECTIONS = 8
_MAX_DATAGRAMS = 64  # between two answers
_SEND_BUFFER = 16_384  # bytes: answers do not pile up for a cell that does not read them
_UNACKNOWLEDGED = (
    5_000  # ms: with full receive buffers on both sides, neither side sees what the other one acknowledges
)


def serve(
    answerer: Answerer,
    host: str = LOOPBACK,
    port: int = 0,
    protocol: TransportProtocol = "udp",
    started: Callable[[str, int], None] = lambda host, port: None,
) -> Counter[str]:
    """Answer states until SIGINT or SIGTERM; to be called in the main thread.

    Packets that do not count are counted, and nothing else comes of them. An exception of the answerer ends the server:
    without answers the robot stops.

    Parameters
    ----------
    answerer
        The guard.
    host, port
        Address to listen on; port 0: any free one. Packets are not authenticated: whoever reaches the address can open
        a session, but only when no other one is in use.
    protocol
        What carries the packets.
    started
        Called with the address when the server listens.

    Returns
    -------
    Counter
        Packets received, by `Outcome`; ``broken streams``: TCP connections closed because they held something else.

    Raises
    ------
    LinkError
        If the address cannot be listened on.
    """
    endpoint = GuardEndpoint(answerer)
    kind = socket.SOCK_DGRAM if protocol == "udp" else socket.SOCK_STREAM
    with _bound(host, port, kind) as listener, _stop_signals() as stop, DefaultSelector() as selector:
        selector.register(stop, EVENT_READ)
        started(*listener.getsockname()[:2])
        if protocol == "udp":
            _serve_datagrams(endpoint, listener, stop, selector)
        else:
            _Connections(endpoint, listener, selector).serve(stop)
    return endpoint.counts


def _serve_datagrams(
    endpoint: GuardEndpoint, listener: socket.socket, stop: socket.socket, selector: DefaultSelector
) -> None:
    selector.register(listener, EVENT_READ)
    cell: tuple[Any, ...] = ()
    while stop not in (ready := [key.fileobj for key, _ in selector.select()]):
        for _ in range(_MAX_DATAGRAMS if listener in ready else 0):
            try:
                packet, sender = listener.recvfrom(MAX_PACKET + 1)
            except BlockingIOError:
                break
            except OSError:  # about an answer to a cell that has gone
                continue
            if endpoint.receive(packet, time.monotonic()):
                cell = sender
        if (answer := endpoint.answer()) is not None:
            with contextlib.suppress(OSError):
                listener.sendto(answer, cell)


class _Connections:
    """TCP connections.

    One that sends anything else than packets, or does not read its answers, is closed; so is the oldest without a
    session where there are too many.
    """

    def __init__(self, endpoint: GuardEndpoint, listener: socket.socket, selector: DefaultSelector) -> None:
        self._endpoint, self._listener, self._selector = endpoint, listener, selector
        self._streams: dict[socket.socket, PacketStream] = {}
        self._cell: socket.socket | None = None

    def serve(self, stop: socket.socket) -> None:
        """Answer until `stop` is readable."""
        self._selector.register(self._listener, EVENT_READ)
        try:
            while stop not in (ready := [key.fileobj for key, _ in self._selector.select()]):
                for connection in list(self._streams):
                    if connection in ready:
                        self._read(connection)
                self._answer()
                if self._listener in ready:
                    self._accept()
        finally:
            for connection in list(self._streams):
                self._close(connection)

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # it has gone already
            return
        if len(self._streams) >= _MAX_CONNECTIONS:
            self._close(next(other for other in self._streams if other is not self._cell))
        connection.setblocking(False)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED)
        self._streams[connection] = PacketStream()
        self._selector.register(connection, EVENT_READ)

    def _read(self, connection: socket.socket) -> None:
        try:
            received = connection.recv(MAX_PACKET)
            for packet in self._streams[connection].packets(received):
                if self._endpoint.receive(packet, time.monotonic()):
                    self._cell = connection
            if not received:
                self._close(connection)
        except BlockingIOError:
            pass
        except MessageError:
            self._endpoint.counts["broken streams"] += 1
            self._close(connection)
        except OSError:
            self._close(connection)

    def _answer(self) -> None:
        answer = self._endpoint.answer()
        if answer is None or self._cell is None:
            return
        try:
            sent = self._cell.send(answer)
        except OSError:
            sent = 0
        if sent < len(answer):
            self._close(self._cell)

    def _close(self, connection: socket.socket) -> None:
        self._selector.unregister(connection)
        del self._streams[connection]
        connection.close()
        if connection is self._cell:
            self._cell = None


def _bound(host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    try:
        family, address = resolved(host, port, kind)
        made = socket.socket(family, kind)
        try:
            if kind is socket.SOCK_DGRAM:
                made.bind(address)
            else:  # connections of a server that has ended do not keep the port
                made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                made.bind(address)
                made.listen()
        except BaseException:
            made.close()
            raise
    except OSError as error:
        raise LinkError(f"{host}:{port}: expected an address to listen on: {error}") from None
    made.setblocking(False)
    return made


@contextlib.contextmanager
def _stop_signals() -> Iterator[socket.socket]:
    """A socket that SIGINT and SIGTERM make readable, in place of what they did before."""
    stop, waker = socket.socketpair()
    with stop, waker:
        waker.setblocking(False)
        earlier = {number: signal.signal(number, lambda *_: None) for number in (signal.SIGINT, signal.SIGTERM)}
        earlier_waker = signal.set_wakeup_fd(waker.fileno())
        try:
            yield stop
        finally:
            signal.set_wakeup_fd(earlier_waker)
            for number, handler in earlier.items():
                signal.signal(number, handler)
