"""The state of the cell as text, and the stop button."""

from __future__ import annotations

import base64
import io
import wave
from collections.abc import Callable
from html import escape
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from scancell.browser.panels.handles import (
    ALARM,
    CALM,
    FIELDS,
    WARNING,
    Rate,
    run_once,
    set_changed,
    small_html,
    theme_html,
)
from scancell.browser.panels.scans import PLAYBACK
from scancell.cell.driver import GUARD_TOO_OLD, Operation
from scancell.live.scan import LiveScanState
from scancell.live.state import LiveState

# The stop must work while an input has the focus, where hotkeys of viser do not.
_KEYS, _CONNECTION = (
    Path(__file__).with_name(name).read_text(encoding="utf-8") for name in ("keys.js", "connection.js")
)
_LINES, _LINE_EM = 6, 1.2  # reserved for the state, so that what is below stays in its place; height of a line
_SLOW = 0.9  # of real time, below which the simulation is called slow
_BEEP_HZ, _BEEP_RATE, _BEEP_SECONDS = 880, 8000, 0.4


class Status:
    """Shown in all browsers, above their panels.

    Parameters
    ----------
    gui
        Inputs of the server.
    stop
        Called by the button and the Escape key of every browser.
    clock
        s.
    """

    def __init__(self, gui: Any, stop: Callable[[], None], clock: Callable[[], float] = monotonic) -> None:
        self._clock, self._time, self._done = clock, Rate(clock=clock), Rate(clock=clock)
        button = gui.add_button("Stop", color="red", icon="hand-stop", hint="or the Escape key", order=-10)
        button.on_click(lambda _: stop())
        gui.add_html(theme_html() + run_once(_KEYS) + run_once(_CONNECTION), order=-7)
        self._pulse = gui.add_html("", order=-7)
        self._text = gui.add_html("", order=-9)
        self._sound = gui.add_html("", order=-8)

    def show(self, state: LiveState, scan: LiveScanState | None = None) -> None:
        """Show a state, and the progress of the last scan."""
        done = share_done(state, scan)
        self._time.add(state.time)
        self._done.add(done)
        set_changed(self._pulse, "content", f'<span data-pulse="{int(self._clock())}"></span>')
        text = state_html(state, pace(self._time.per_second, done, self._done.per_second))
        sound = _BEEP if state.pendant_beep else ""
        set_changed(self._text, "content", text)
        set_changed(self._sound, "content", sound)


def share_done(state: LiveState, scan: LiveScanState | None) -> float:
    """Share of the scan that runs, or of the motion, that is done; 0 if neither is."""
    if scan is not None and scan.stage in ("scanning", "sensing") and scan.planned:
        return scan.sensed / scan.planned
    return state.progress if state.moving else 0.0


def pace(rate: float | None, done: float, done_rate: float | None) -> str:
    """Text of a slow simulation and of the time left.

    Parameters
    ----------
    rate
        Simulated seconds per second; None if unknown.
    done, done_rate
        Share that is done, and its rate, 1/s.
    """
    texts = []
    if rate is not None and rate < _SLOW:
        texts.append(f"slow simulation: {rate:.0%} of real time")
    if done_rate and 0.0 < done < 1.0:
        texts.append(f"about {(1 - done) / done_rate:.0f} s left")
    return ", ".join(texts)


def advice(state: LiveState) -> str:
    """One sentence: what stopped the robot or keeps it from moving, and what to do; empty if nothing does."""
    what, _, about = state.guard_text.partition(": ")
    about = about.replace(" - ", " and ").replace(": ", ", ")
    if state.controller == "emergency stop":
        cause = "The Stop button stopped the robot"
        if what == "stop":
            cause = f"The guard stopped the robot ({about})"
        elif state.refusal == GUARD_TOO_OLD:
            cause = "The robot stopped because the guard did not answer in time"
        then = "wait until it is at rest" if state.moving else 'press "Reset after a stop", then move it away'
        return f"{cause}: {then}."
    if state.job == PLAYBACK:
        return 'A recorded scan is played back, and the robot cannot be moved: press "Back to the running cell" first.'
    if what == "no jog":
        return f"The guard permits no jog in this direction ({about}): jog in another one."
    if what == "slowed to 0%":
        return f"The guard holds the robot on its path ({about}): end the motion and choose another target."
    return ""


def state_html(state: LiveState, pace: str = "") -> str:
    """A state and a text on its pace as HTML; every text of the cell is escaped."""
    stopped = state.controller == "emergency stop"
    colour = CALM
    if state.colliding or stopped:
        colour = ALARM
    elif state.guard_text or state.refusal or state.message:
        colour = WARNING
    operation = "manual" if state.operation is Operation.MANUAL else "automatic"
    lines = [f'<b style="color:{colour}">{escape(state.controller)}</b>, {operation} operation, {state.time:.1f} s']
    lines += [f'<b style="color:{WARNING}">{pace}</b>'] if pace.startswith("slow") else [pace]
    lines += _motion_lines(state)
    sentence = advice(state)
    if sentence:
        lines.append(_sentence_html(sentence, ALARM if stopped else WARNING))
    else:
        for name, text in (("guard", state.guard_text), ("pendant", state.pendant_text)):
            if text:
                lines.append(f'<b style="color:{WARNING}">{name}: {escape(text)}</b>')
    # The sentence states the reason of a stop.
    lines += [escape(text) for text in ("" if stopped else state.refusal, state.message) if text]
    devices = _device_lines(state)
    height = _LINE_EM * (_LINES + len(devices))
    return f'<div data-status style="height:{height:.1f}em;overflow-y:auto">{small_html(lines + devices)}</div>'


def _motion_lines(state: LiveState) -> list[str]:
    """Job, progress, collision and nearest pair."""
    lines = []
    if state.job is not None:
        lines.append(f"<b>{escape(state.job)}</b> runs")
    if state.moving:
        lines.append(f"{state.progress:.0%} of the motion, monitor speed {state.monitor_speed_in_force:.0%}")
    if state.colliding:
        lines.append(f'<b style="color:{ALARM}">collision: {escape(" - ".join(state.colliding))}</b>')
    if state.nearest:
        first, second, distance = state.nearest
        lines.append(f"nearest: {escape(first)} - {escape(second)}, {1e3 * distance:.1f} mm")
    return lines


def _device_lines(state: LiveState) -> list[str]:
    """Readings of the devices."""
    lines = []
    for number, detected in enumerate(state.presence, start=1):
        lines.append(f"presence sensor {number}: {'something' if detected else 'nothing'}")
    for number, read in enumerate(state.distance, start=1):
        lines.append(f"distance sensor {number}: {'-' if read is None else f'{1e3 * read:.1f} mm'}")
    if state.gripper_width is not None:
        lines.append(f"gripper: {1e3 * state.gripper_width:.1f} mm")
    return lines


def _sentence_html(sentence: str, colour: str) -> str:
    return (
        f'<div role="alert" style="margin:0.3em 0;padding:0.4em 0.6em;border-left:4px solid {colour};'
        f'background:{FIELDS[colour]};color:{colour};font-weight:600">{escape(sentence)}</div>'
    )


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
