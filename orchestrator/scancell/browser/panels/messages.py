"""Messages to the person at one browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from scancell.errors import ScancellError

if TYPE_CHECKING:
    import viser

_SHOWN = 8.0  # s


def say(client: viser.ClientHandle, text: str) -> None:
    """Show a message in a browser for a while."""
    client.add_notification("scancell", text, auto_close_seconds=_SHOWN, color="orange")


def said_to_person(act: Callable[[], object]) -> Callable[[Any], None]:
    """A callback of viser that acts on what a person did, not on what the program shows; says what went wrong."""

    def called(event: Any) -> None:
        if event.client is None:
            return
        report_errors(act, lambda text: say(event.client, text))

    return called


def report_errors(act: Callable[[], object], say: Callable[[str], None]) -> None:
    """Act; any error is said, as nobody else would hear of it."""
    try:
        act()
    except ScancellError as error:
        say(str(error))
    except Exception as error:
        say(f"This failed: {type(error).__name__}: {error}")
