"""A server of viser that prints nothing and offers no link of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from scancell.config.choices import LOOPBACK
from scancell.extras import require

if TYPE_CHECKING:
    import viser


@contextmanager
def quiet_server(host: str = LOOPBACK, port: int = 8080) -> Iterator[viser.ViserServer]:
    """A running server, which is stopped in the end; a taken port makes it take the next free one.

    Raises
    ------
    MissingExtraError
        If viser is not installed.
    """
    with _without_messages():
        server = require("viser", "workspace").ViserServer(host=host, port=port, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        yield server
    finally:
        with _without_messages():
            server.stop()


def address(server: viser.ViserServer) -> str:
    """To open in a browser."""
    return f"http://{server.get_host()}:{server.get_port()}"


@contextmanager
def _without_messages() -> Iterator[None]:
    """Without what viser prints by rich when it starts and stops, whatever it is told."""
    console = require("rich", "workspace").get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
