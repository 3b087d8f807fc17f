"""The guard as a server: one cell at a time, over UDP or TCP."""

from __future__ import annotations

import contextlib
import signal
import socket
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from selectors import EVENT_READ, DefaultSelector
from typing import Any, TypeVar

from scancell.arguments import checked_arguments
from scancell.config.choices import LOOPBACK, TransportProtocol
from scancell.errors import LinkError, MessageError
from scancell.guard.endpoints import FAILED, Answerer, GuardEndpoint
from scancell.guard.messages import MAX_PACKET
from scancell.guard.transport import PacketStream, resolved

Result = TypeVar("Result")

_MAX_CONNECTIONS = 64
_FIRST_STATE = 2.0  # s that a connection has for its first state before it may give way to another one
_MAX_DATAGRAMS = 64  # of one socket, between two answers
_SEND_BUFFER = 16_384  # bytes: answers do not pile up for a cell that does not read them
_UNACKNOWLEDGED = (
    5_000  # ms: with full receive buffers on both sides, neither side sees what the other one acknowledges
)


@checked_arguments
def serve_guard(
    answerer: Answerer,
    host: str = LOOPBACK,
    port: int = 0,
    protocol: TransportProtocol = "udp",
    started: Callable[[str, int], None] = lambda host, port: None,
) -> Counter[str]:
    """Answer states until SIGINT or SIGTERM; to be called in the main thread.

    Rejected packets are counted and have no other effect. If the answerer raises an exception, the
    state gets no answer, and without answers the robot stops; the first such exception is printed.

    Parameters
    ----------
    answerer
        The guard: a `Guard`, or any object with ``answer(state)``, which takes a `CellState` and returns a
        `GuardMessage`, and ``reset()``.
    host, port
        Address to listen on; port 0: any free one. Packets are not authenticated: anyone who reaches the address can
        open a session, but only when no other one is in use.
    protocol
        What carries the packets.
    started
        Called with the address when the server listens.

    Returns
    -------
    Counter
        Packets received, by `Outcome`; `FAILED`: states at which the answerer raised an exception; ``broken streams``:
        TCP connections closed because they held something else; ``refused connections``: those beyond the limit.

    Raises
    ------
    LinkError
        If the address cannot be listened on.

    Examples
    --------
    >>> import signal
    >>> scancell.serve_guard(scancell.guard_of(), started=lambda host, port: signal.raise_signal(signal.SIGTERM))
    Counter()
    """
    service = _Service(answerer)
    kind = socket.SOCK_DGRAM if protocol == "udp" else socket.SOCK_STREAM
    with bound_socket(host, port, kind) as listener, stop_signals() as stop, DefaultSelector() as selector:
        selector.register(stop, EVENT_READ)
        started(*listener.getsockname()[:2])
        if protocol == "udp":
            _Datagrams(service, listener, selector).serve(stop)
        else:
            _Connections(service, listener, selector).serve(stop)
    return service.counts


class _Service:
    """The guard's end of the connection; no exception of the guard leaves it."""

    def __init__(self, answerer: Answerer) -> None:
        self._endpoint = GuardEndpoint(answerer)

    @property
    def counts(self) -> Counter[str]:
        return self._endpoint.counts

    def receive(self, packet: bytes) -> bool:
        """Whether a packet is accepted."""
        return self._attempted(lambda: self._endpoint.receive(packet, time.monotonic())) or False

    def answer(self) -> bytes | None:
        """The answer that is due."""
        return self._attempted(self._endpoint.answer)

    def _attempted(self, act: Callable[[], Result]) -> Result | None:
        try:
            return act()
        except Exception:
            if not self.counts[FAILED]:
                traceback.print_exc()
            self.counts[FAILED] += 1
            return None


class _Datagrams:
    """Datagrams of UDP.

    The cell of the session has a socket of its own at the same port, connected to it: a flood from elsewhere fills the
    buffer of the other one only.
    """

    def __init__(self, service: _Service, listener: socket.socket, selector: DefaultSelector) -> None:
        self._service, self._listener, self._selector = service, listener, selector
        self._cell: socket.socket | None = None

    def serve(self, stop: socket.socket) -> None:
        """Answer until `stop` is readable."""
        self._selector.register(self._listener, EVENT_READ)
        try:
            while stop not in (ready := [key.fileobj for key, _ in self._selector.select()]):
                if self._listener in ready and (sender := self._read(self._listener)) is not None:
                    self._connect(sender)
                if self._cell is not None:
                    self._read(self._cell)
                if (answer := self._service.answer()) is not None and self._cell is not None:
                    with contextlib.suppress(OSError):
                        self._cell.send(answer)
        finally:
            self._disconnect()

    def _read(self, source: socket.socket) -> Any:
        """Sender address of the last accepted packet; None without one."""
        accepted = None
        for _ in range(_MAX_DATAGRAMS):
            try:
                packet, sender = source.recvfrom(MAX_PACKET + 1)
            except BlockingIOError:
                break
            except OSError:  # about an answer to a cell that has gone
                continue
            if self._service.receive(packet):
                accepted = sender
        return accepted

    def _connect(self, cell: Any) -> None:
        self._disconnect()
        made = socket.socket(self._listener.family, socket.SOCK_DGRAM)
        try:
            made.setblocking(False)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            # For this moment only: another process shall not bind the same port.
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind(self._listener.getsockname())
            made.connect(cell)
        except OSError:  # no address that can be answered
            made.close()
            return
        finally:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        self._selector.register(made, EVENT_READ)
        self._cell = made

    def _disconnect(self) -> None:
        if self._cell is not None:
            self._selector.unregister(self._cell)
            self._cell.close()
            self._cell = None


class _Connections:
    """TCP connections.

    One that sends anything else than packets, or does not read its answers, is closed. Where there are too many, a new
    one replaces the oldest without a session that had the time to send a first state; where none had, it is refused.
    """

    def __init__(self, service: _Service, listener: socket.socket, selector: DefaultSelector) -> None:
        self._service, self._listener, self._selector = service, listener, selector
        self._streams: dict[socket.socket, PacketStream] = {}
        self._accepted: dict[socket.socket, float] = {}  # s, in this order
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
        now = time.monotonic()
        if len(self._streams) >= _MAX_CONNECTIONS:
            oldest = next(other for other in self._accepted if other is not self._cell)
            if now - self._accepted[oldest] < _FIRST_STATE:
                self._service.counts["refused connections"] += 1
                connection.close()
                return
            self._close(oldest)
        connection.setblocking(False)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED)
        self._streams[connection], self._accepted[connection] = PacketStream(), now
        self._selector.register(connection, EVENT_READ)

    def _read(self, connection: socket.socket) -> None:
        try:
            received = connection.recv(MAX_PACKET)
            for packet in self._streams[connection].packets(received):
                if self._service.receive(packet):
                    self._cell = connection
            if not received:
                self._close(connection)
        except BlockingIOError:
            pass
        except MessageError:
            self._service.counts["broken streams"] += 1
            self._close(connection)
        except OSError:
            self._close(connection)

    def _answer(self) -> None:
        answer = self._service.answer()
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
        del self._streams[connection], self._accepted[connection]
        connection.close()
        if connection is self._cell:
            self._cell = None


def bound_socket(host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    """Socket at an address, which listens if it is of a stream; raises `LinkError` if there can be none."""
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
        raise LinkError(f"{host}:{port}: {error}", expected="an address to listen on") from None
    made.setblocking(False)
    return made


@contextlib.contextmanager
def stop_signals() -> Iterator[socket.socket]:
    """Context manager: a socket that SIGINT and SIGTERM make readable, instead of calling their earlier handlers."""
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
