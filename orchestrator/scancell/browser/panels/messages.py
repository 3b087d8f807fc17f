"""Messages to the user of one browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from scancell.errors import ScancellError

if TYPE_CHECKING:
    import viser

SHOWN = 8.0  # s, for which a message is shown


def show_message(client: viser.ClientHandle, text: str) -> None:
    """Show a message in a browser for a while."""
    client.add_notification("scancell", text, auto_close_seconds=SHOWN, color="orange")


def report_errors(act: Callable[[], object], show: Callable[[str], None]) -> None:
    """Call `act` and show any error as a message: viser would discard it in one of its threads."""
    try:
        act()
    except ScancellError as error:
        show(str(error))
    except Exception as error:
        show(f"This failed: {type(error).__name__}: {error}")
