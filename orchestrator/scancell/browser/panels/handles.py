"""Functions for the inputs of viser."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from html import escape
from typing import Any


def set_changed(handle: Any, name: str, value: Any) -> None:
    """Set an attribute only if its value differs, because each assignment is sent."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def pressed(group: Any, acts: Mapping[str, Callable[[], object]]) -> Callable[[], None]:
    """Function that calls the act of the button of a group that was pressed."""

    def act() -> None:
        acts[group.value]()

    return act


class Follower:
    """An input that shows a value of the cell.

    It is written only when the value changes, so that input of the user stays until the cell has carried it out.
    """

    def __init__(self, handle: Any) -> None:
        self._handle = handle
        self._shown: object = None

    def show(self, value: object) -> None:
        """Show the value, if it has changed."""
        if value != self._shown:
            self._shown = value
            set_changed(self._handle, "value", value)


def small_html(lines: Iterable[str]) -> str:
    """Lines of HTML in small print, without empty lines."""
    return (
        f'<div style="padding:0 0.75em 0.4em;font-size:0.85em;line-height:1.4">{"<br>".join(filter(None, lines))}</div>'
    )


def run_once(script: str) -> str:
    """HTML that runs a script in the page: the element's empty picture fails to load, without any request."""
    return f'<img src="data:," alt="" style="display:none" onerror="{escape(script)}">'
