"""Clients of RTDE and of the dashboard."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Sequence

from scancell.errors import LinkError
from scancell.values import Closing
from scancell.wire.ur.packets import (
    Kind,
    Numbers,
    Packet,
    PacketBuffer,
    Recipe,
    controller_version_from,
    outputs_request,
    packed,
    recipe_from,
    version_request,
)

_RECEIVE = 65_536
_LINE = 10_000  # bytes of an answer of the dashboard


class _Connection(Closing):
    """A TCP connection with a limit of waiting, s."""

    def __init__(self, host: str, port: int, timeout: float) -> None:
        self._name, self._timeout = f"{host}:{port}", timeout
        try:
            self._socket = socket.create_connection((host, port), timeout)
        except OSError as error:
            raise LinkError(f"{self._name}: {error}", expected="a controller that listens there") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._socket.close()

    def _receive(self, timeout: float) -> bytes:
        """What has come; empty where nothing came within `timeout`, s."""
        try:
            self._socket.settimeout(max(timeout, 1e-6))
            received = self._socket.recv(_RECEIVE)
        except TimeoutError:
            return b""
        except OSError as error:
            raise LinkError(f"{self._name}: {error}") from None
        if not received:
            raise LinkError(f"{self._name}: the controller closed the connection")
        return received

    def _send(self, payload: bytes) -> None:
        try:
            self._socket.settimeout(self._timeout)
            self._socket.sendall(payload)
        except OSError as error:
            raise LinkError(f"{self._name}: {error}") from None


class RtdeClient(_Connection):
    """A client of RTDE.

    Parameters
    ----------
    host, port
        Address of the controller.
    timeout
        Longest wait for an answer, s.

    Raises
    ------
    LinkError
        If there is no controller, it refuses the protocol, or the connection ends; so do all methods.
    MessageError
        If it sends something else than the protocol states; so do all methods.
    """

    def __init__(self, host: str, port: int = 30004, timeout: float = 2.0) -> None:
        super().__init__(host, port, timeout)
        self._buffer = PacketBuffer()
        self._waiting: list[Packet] = []
        self._outputs: Recipe | None = None
        try:
            if self._request(Kind.PROTOCOL_VERSION, version_request()) != b"\1":
                raise LinkError(f"{self._name}: RTDE version 2 was refused")
            self.version = controller_version_from(self._request(Kind.CONTROLLER_VERSION))
        except BaseException:
            self.close()
            raise

    def set_outputs(self, names: Sequence[str], frequency: float) -> None:
        """Ask for variables at a frequency, Hz."""
        self._outputs = recipe_from(self._request(Kind.OUTPUTS, outputs_request(frequency, names)), names)

    def set_inputs(self, names: Sequence[str]) -> Recipe:
        """Recipe for `write` of input variables, which other clients cannot write from now on."""
        return recipe_from(self._request(Kind.INPUTS, ",".join(names).encode()), names)

    def start(self) -> None:
        """Start to receive data."""
        if self._request(Kind.START) != b"\1":
            raise LinkError(f"{self._name}: the start was refused")

    def write(self, recipe: Recipe, values: Sequence[Numbers | float]) -> None:
        """Write input variables."""
        self._send(packed(Kind.DATA, recipe.pack(values)))

    def receive(self, timeout: float) -> list[dict[str, tuple[float, ...]]]:
        """Values of all packages that came, in their order, after a wait of at most `timeout`, s, for the first one."""
        end = time.monotonic() + timeout
        while True:
            assert self._outputs is not None
            packages = [self._outputs.unpack(packet.payload) for packet in self._taken() if packet.kind == Kind.DATA]
            if packages or (left := end - time.monotonic()) <= 0.0:
                return packages
            self._waiting += self._buffer.packets(self._receive(left))

    def _taken(self) -> list[Packet]:
        taken, self._waiting = self._waiting, []
        return taken

    def _request(self, kind: Kind, payload: bytes = b"") -> bytes:
        """Payload of the answer; data that come before it wait."""
        self._send(packed(kind, payload))
        end = time.monotonic() + self._timeout
        while True:
            for number, packet in enumerate(self._waiting):
                if packet.kind == kind:
                    return self._waiting.pop(number).payload
            if (left := end - time.monotonic()) <= 0.0:
                raise LinkError(f"{self._name}: no answer to {kind.name} within {self._timeout:g} s")
            self._waiting += self._buffer.packets(self._receive(left))


class DashboardClient(_Connection):
    """A client of the dashboard; parameters and errors are those of `RtdeClient`."""

    def __init__(self, host: str, port: int = 29999, timeout: float = 2.0) -> None:
        super().__init__(host, port, timeout)
        self._rest = b""
        self.greeting = self._line()

    def request(self, line: str) -> str:
        """Answer to a line."""
        self._send(f"{line}\n".encode())
        return self._line()

    def _line(self) -> str:
        end = time.monotonic() + self._timeout
        while b"\n" not in self._rest:
            if (left := end - time.monotonic()) <= 0.0 or len(self._rest) > _LINE:
                raise LinkError(f"{self._name}: no line within {self._timeout:g} s")
            self._rest += self._receive(left)
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode(errors="replace").strip()
