"""Panel of the scan, without a browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from scancell.browser.panels.scans import ScanPanel, Scans
from scancell.config.choices import Engine


class Handle:
    """An input or a text of a page."""

    def __init__(self, value: Any = None) -> None:
        self.value, self.content, self.callbacks = value, "", []

    def on_click(self, callback: Callable[[], None]) -> None:
        self.callbacks.append(callback)

    on_update = on_click

    def click(self) -> None:
        for callback in self.callbacks:
            callback()


class Gui:
    """Makes handles, and keeps those with a name."""

    def __init__(self) -> None:
        self.named: dict[str, Handle] = {}
        self.texts: list[Handle] = []

    def add_button(self, name: str, **_: object) -> Handle:
        return self.named.setdefault(name, Handle())

    def add_dropdown(self, name: str, options: tuple[str, ...], initial_value: str | None = None) -> Handle:
        return self.named.setdefault(name, Handle(initial_value or options[0]))

    def add_vector2(self, name: str, value: tuple[float, float], **_: object) -> Handle:
        return self.named.setdefault(name, Handle(value))

    def add_slider(self, name: str, *_: object, **__: object) -> Handle:
        return self.named.setdefault(name, Handle())

    def add_progress_bar(self, value: float) -> Handle:
        return Handle(value)

    def add_html(self, content: str) -> Handle:
        self.texts.append(Handle())
        self.texts[-1].content = content
        return self.texts[-1]


def operator() -> Any:
    """Every browser may operate the cell."""

    def connect(handle: Handle, act: Callable[[], None], *_: object, **__: object) -> Handle:
        handle.on_click(act)
        return handle

    return SimpleNamespace(connect=connect, submit=lambda _: None, add_inputs=lambda *_, **__: None)


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_engine_of_a_scan_is_at_first_that_of_the_workspace(engine: Engine, tmp_path: Path) -> None:
    cloud = SimpleNamespace(colour="part", bar=None, limit=lambda: None)
    scans = Scans(SimpleNamespace(), cloud, None, tmp_path, engine)  # type: ignore[arg-type]
    gui, started = Gui(), []
    scans.start = started.append  # type: ignore[method-assign]
    playback = SimpleNamespace(play_or_pause=None, go_to=None, leave=None)
    ScanPanel(gui, operator(), scans, playback)  # type: ignore[arg-type]
    gui.named["Scan the part"].click()
    assert started == [engine]
