"""Pages of other servers cannot command a cell that is open in a browser of the same machine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from urllib.request import urlopen

import pytest
import viser
from websockets.asyncio import server as websockets_server
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from scancell.browser.server.gate import address, is_own_page, quiet_server
from scancell.errors import LinkError


@pytest.fixture(scope="module")
def server() -> Iterator[Any]:
    with quiet_server(port=8500) as made:
        yield made


def connected(server: Any, origin: str | None) -> bool:
    """Whether a websocket client that says it is from a page of `origin` is answered with the scene."""
    url = address(server).replace("http", "ws")
    try:
        with connect(url, origin=origin, subprotocols=[f"viser-v{viser.__version__}"]) as socket:
            return len(socket.recv(timeout=60)) > 0
    except InvalidStatus as refused:
        assert refused.response.status_code == 403
        return False


def test_own_page_and_a_program_are_served(server: Any) -> None:
    assert connected(server, address(server))
    assert connected(server, None)
    with urlopen(address(server)) as page:
        assert b"<html" in page.read().lower()


@pytest.mark.parametrize(
    "origin",
    [
        "https://example.org",
        "http://127.0.0.1:1",
        "http://localhost",
        "null",
        "http://127.0.0.1.example.org:8500",
        "file://",
        "",
    ],
)
def test_page_of_another_server_is_refused(server: Any, origin: str) -> None:
    assert not connected(server, origin)


@pytest.mark.parametrize(
    ("host", "headers", "own"),
    [
        ("127.0.0.1", {"Host": "localhost:9000", "Origin": "http://localhost:9000"}, True),  # an SSH tunnel
        ("0.0.0.0", {"Host": "192.168.7.5:8080", "Origin": "http://192.168.7.5:8080"}, True),
        ("::1", {"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, True),
        ("cell.lab", {"Host": "cell.lab:8080", "Origin": "http://cell.lab:8080"}, True),
        ("127.0.0.1", {"Host": "rebound.example:8080", "Origin": "http://rebound.example:8080"}, False),
        ("127.0.0.1", {"Host": "127.0.0.1:8080", "Origin": "http://[broken"}, False),
        ("127.0.0.1", {"Origin": "http://None"}, False),
        ("127.0.0.1", {"Host": "localhost:9000"}, True),
    ],
)
def test_origin_must_match_the_host_of_this_machine(host: str, headers: dict[str, str], own: bool) -> None:
    assert is_own_page(headers, host) is own


def test_viser_that_cannot_be_guarded_is_not_started(monkeypatch: pytest.MonkeyPatch) -> None:
    def unguarded(self: Any, **_: Any) -> None:
        self.gui, self.stop = None, lambda: stopped.append(True)

    stopped: list[bool] = []
    monkeypatch.setattr(viser.ViserServer, "__init__", unguarded)
    with pytest.raises(LinkError, match="pages of other servers"), quiet_server(port=8500):
        pass
    assert stopped


def test_other_servers_of_the_process_are_left_alone(server: Any) -> None:
    assert websockets_server.serve.__module__ == "websockets.asyncio.server"
