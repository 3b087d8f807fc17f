"""The state of the cell as text, and the stop button."""

from __future__ import annotations

import base64
import io
import wave
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from scancell.browser.panels.handles import run_once, set_changed, small_html
from scancell.cell.controller import Operation
from scancell.live.state import LiveState

# The stop must work while an input has the focus, where hotkeys of viser do not.
_KEYS = Path(__file__).with_name("keys.js").read_text(encoding="utf-8")
_ALARM, _WARNING, _CALM = "#c62828", "#e08a00", "#2f7d32"
_BEEP_HZ, _BEEP_RATE, _BEEP_SECONDS = 880, 8000, 0.4


class Status:
    """Shown in all browsers, above their panels.

    Parameters
    ----------
    gui
        Of the server.
    stop
        Called by the button and the Escape key of every browser.
    """

    def __init__(self, gui: Any, stop: Callable[[], None]) -> None:
        button = gui.add_button("Stop", color="red", icon="hand-stop", hint="or the Escape key", order=-10)
        button.on_click(lambda _: stop())
        gui.add_html(run_once(_KEYS), order=-7)
        self._text = gui.add_html("", order=-9)
        self._sound = gui.add_html("", order=-8)

    def show(self, state: LiveState) -> None:
        """Show a state."""
        text, sound = state_html(state), _BEEP if state.pendant_beep else ""
        set_changed(self._text, "content", text)
        set_changed(self._sound, "content", sound)


def state_html(state: LiveState) -> str:
    """A state as HTML; every text of the cell is escaped."""
    colour = _CALM
    if state.colliding or state.controller == "emergency stop":
        colour = _ALARM
    elif state.guard_text or state.refusal or state.message:
        colour = _WARNING
    operation = "manual" if state.operation is Operation.MANUAL else "automatic"
    lines = [f'<b style="color:{colour}">{escape(state.controller)}</b>, {operation} operation, {state.time:.1f} s']
    if state.job is not None:
        lines.append(f"<b>{escape(state.job)}</b> runs")
    if state.moving:
        lines.append(f"{state.progress:.0%} of the motion, monitor speed {state.monitor_speed_in_force:.0%}")
    if state.colliding:
        lines.append(f'<b style="color:{_ALARM}">collision: {escape(" - ".join(state.colliding))}</b>')
    if state.nearest:
        first, second, distance = state.nearest
        lines.append(f"nearest: {escape(first)} - {escape(second)}, {1e3 * distance:.1f} mm")
    for name, text in (("guard", state.guard_text), ("pendant", state.pendant_text)):
        if text:
            lines.append(f'<b style="color:{_WARNING}">{name}: {escape(text)}</b>')
    lines += [escape(text) for text in (state.refusal, state.message) if text]
    for number, detected in enumerate(state.presence, start=1):
        lines.append(f"presence sensor {number}: {'something' if detected else 'nothing'}")
    for number, read in enumerate(state.distance, start=1):
        lines.append(f"distance sensor {number}: {'-' if read is None else f'{1e3 * read:.1f} mm'}")
    if state.gripper_width is not None:
        lines.append(f"gripper: {1e3 * state.gripper_width:.1f} mm")
    return small_html(lines)


def _beep() -> str:
    """HTML that repeats a tone while it is shown; the sound is embedded, because the page loads no files."""
    time = np.arange(round(2 * _BEEP_SECONDS * _BEEP_RATE)) / _BEEP_RATE
    tone = np.where(time < _BEEP_SECONDS, 8000 * np.sin(2 * np.pi * _BEEP_HZ * time), 0.0).astype("<i2")
    file = io.BytesIO()
    with wave.open(file, "wb") as out:
        out.setnchannels(1)
        out.setsampwidth(2)
        out.setframerate(_BEEP_RATE)
        out.writeframes(tone.tobytes())
    return f'<audio autoplay loop src="data:audio/wav;base64,{base64.b64encode(file.getvalue()).decode()}"></audio>'


_BEEP = _beep()
