"""The server of the own pages: the browser that operates the cell, and requests and messages that are refused."""

from __future__ import annotations

import http
import socket
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from ipaddress import ip_address
from threading import Lock
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from scancell.browser.panels.handles import show_message
from scancell.config.choices import LOOPBACK
from scancell.errors import LinkError, require

if TYPE_CHECKING:
    import viser

    from scancell.browser.server.messages import Gate


class Operators:
    """The open browsers, by the numbers of their connections; one of them is the operator.

    The first one is the operator. Another one becomes the operator on request, or when it connects after the operator
    has left. All methods are thread-safe.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._present: set[int] = set()
        self._operator: int | None = None

    @property
    def operator(self) -> int | None:
        """The browser in control; None after it has left."""
        return self._operator

    def join(self, client: int) -> None:
        """Add a browser."""
        with self._lock:
            self._present.add(client)
            if self._operator is None:
                self._operator = client

    def leave(self, client: int) -> None:
        """Remove a browser."""
        with self._lock:
            self._present.discard(client)
            if self._operator == client:
                self._operator = None

    def take(self, client: int) -> None:
        """Make a browser the operator."""
        with self._lock:
            if client in self._present:
                self._operator = client


@contextmanager
def quiet_server(host: str = LOOPBACK, port: int = 8080) -> Iterator[viser.ViserServer]:
    """A running server, which is stopped at the end; it uses the next free port if `port` is in use.

    Raises
    ------
    MissingExtraError
        If viser is not installed.
    LinkError
        If `host` is no address of this machine, or requests from other pages cannot be rejected in the installed viser.
    """
    made_by = require("viser", "workspace")
    _require_own_address(host)
    # A browser may leave while its panels are being updated.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    with _without_messages(), _guarded(host) as guarded:
        server = guarded.server = made_by.ViserServer(host=host, port=port, verbose=False)
    try:
        if not guarded.is_installed:
            raise LinkError("the installed viser accepts requests from pages of other servers: install viser 1.1")
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        yield server
    finally:
        with _without_messages():
            server.stop()


def address(server: viser.ViserServer) -> str:
    """Address to open in a browser."""
    return f"http://{server.get_host()}:{server.get_port()}"


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address or name."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return all(ip_address(str(place[0]).partition("%")[0]).is_loopback for *_, place in found)


def _require_own_address(host: str) -> None:
    """Raise an error, as viser would try one port after another without end."""
    try:
        for family, kind, protocol, _, place in socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM):
            with socket.socket(family, kind, protocol) as probe:
                probe.bind(place)
    except (OSError, UnicodeError) as error:
        raise LinkError(str(error), key="host", value=host, expected="an address of this machine") from None


def is_own_page(headers: Mapping[str, str], host: str) -> bool:
    """Whether a request with these headers comes from a page of the server at `host`, or from no page at all.

    Browsers let any page on the internet open a websocket to this machine, and state the origin of the page (RFC 6455,
    section 10.2). Origin and Host must agree. Both may be a name of an attacker that resolves to this machine (DNS
    rebinding), so only addresses and names of this machine are accepted.
    """
    origin = headers.get("Origin")
    if origin is None:
        return True
    if origin not in (f"http://{headers.get('Host')}", f"https://{headers.get('Host')}"):
        return False
    try:
        name = urlsplit(origin).hostname or ""
    except ValueError:
        return False
    return name in ("localhost", host.lower(), socket.gethostname().lower()) or _is_address(name)


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


class _GatedConnection:
    """A connection of websockets that receives only messages that a `Gate` accepts."""

    def __init__(self, connection: Any, gate: Gate, show: Callable[[str], None]) -> None:
        self._connection, self._gate, self._show = connection, gate, show

    async def recv(self) -> Any:
        """The next message that is accepted."""
        while refusal := self._gate.refusal(frame := await self._connection.recv()):
            self._show(refusal)
        return frame

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)


class _Guarded:
    """Rejects pages of other servers, and messages that the own pages do not send."""

    def __init__(self, host: str) -> None:
        self._host = host
        self.is_installed = False
        self.server: Any = None

    def serve(self, serve: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap the function `serve` of websockets."""

        def guarded(
            handler: Callable[[Any], Any], *words: Any, process_request: Callable[[Any, Any], Any], **options: Any
        ) -> Any:
            def answer(connection: Any, request: Any) -> Any:
                if not is_own_page(request.headers, self._host):
                    return connection.respond(http.HTTPStatus.FORBIDDEN, "scancell: this page is not of this server\n")
                return process_request(connection, request)

            async def handle(connection: Any) -> None:
                from scancell.browser.server.messages import Gate  # noqa: PLC0415  (needs an extra)

                last: list[Any] = []  # the browser that a message is about

                def handle_of(uuid: str) -> Any:
                    found, client = self._input(uuid)
                    last[:] = [] if client is None else [client]
                    return found

                def tell(refusal: str) -> None:
                    for client in last:
                        show_message(client, refusal)
                    last.clear()

                await handler(_GatedConnection(connection, Gate(handle_of), tell))

            self.is_installed = True
            return serve(handle, *words, process_request=answer, **options)

        return guarded

    def _input(self, uuid: str) -> tuple[Any, Any]:
        """An input of the server or of one of its browsers, and that browser."""
        clients = self.server.get_clients().values() if self.server is not None else ()
        for owner in (*clients, self.server):
            if owner is not None and (found := owner.gui._gui_input_handle_from_uuid.get(uuid)) is not None:
                return found, owner if owner is not self.server else None
        return None, None


@contextmanager
def _guarded(host: str) -> Iterator[_Guarded]:
    """Make the server that is created here `_Guarded`: viser does not expose these options of websockets."""
    module = require("websockets.asyncio.server", "workspace")
    serve, made = module.serve, _Guarded(host)
    module.serve = made.serve(serve)
    try:
        yield made
    finally:
        module.serve = serve


@contextmanager
def _without_messages() -> Iterator[None]:
    """Suppress what viser prints with rich at start and stop even with ``verbose=False``."""
    console = require("rich", "workspace").get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
