"""Elements that panels share: handles, delayed calls, rates, colours and messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from html import escape
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from scancell.browser.scene.scene import ColourBar
from scancell.errors import ScancellError

if TYPE_CHECKING:
    import viser


ALARM, WARNING, CALM = "#c62828", "#8a5300", "#2f7d32"  # of text on white
FIELDS = {ALARM: "#fdecea", WARNING: "#fff4e0"}  # behind a sentence of this colour
DIMMED, MARKED = "#59636e", "#cfe2ff"  # secondary text; background of a marked row

_PRIMARY, _PRIMARY_HOVER, _STOP, _STOP_HOVER = "#1864ab", "#14548f", ALARM, "#a61f1f"
# Colours of the page's theme that are lighter by default, with the background that their text is on, or with its text.
THEME = {
    "--mantine-color-dimmed": DIMMED,
    "--mantine-color-gray-6": DIMMED,  # labels of the ends of sliders
    "--mantine-color-blue-6": _PRIMARY,
    "--mantine-color-blue-filled": _PRIMARY,
    "--mantine-color-blue-filled-hover": _PRIMARY_HOVER,
    "--mantine-color-blue-outline": _PRIMARY,
    "--mantine-color-blue-text": _PRIMARY,
    "--mantine-color-blue-light-color": _PRIMARY,
    "--mantine-color-red-6": _STOP,
    "--mantine-color-red-filled": _STOP,
    "--mantine-color-red-filled-hover": _STOP_HOVER,
}

# A folder is a bar with its label; by default a closed one is a bordered field, as of a text input.
_FOLDER = ".mantine-Paper-root[data-with-border]:has(> .mantine-Paper-root)"
_BARS = (
    f"{_FOLDER}{{padding-bottom:0}}"
    f"{_FOLDER} > .mantine-Paper-root{{position:static;transform:none;display:flex;justify-content:space-between;"
    "align-items:center;padding:0.3em 0.6em;background:var(--mantine-color-gray-1)}"
    f"{_FOLDER} > :last-child{{display:none}}"
)

_HEIGHT, _BAR = 60, 12  # px of the histogram and of the colours below it

SHOWN = 8.0  # s, for which a message is shown


def set_changed(handle: Any, name: str, value: Any) -> None:
    """Set an attribute only if its value differs, because each assignment is sent."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


class Follower:
    """An input that shows a value of the cell.

    It is written only when the value changes, so that input of the user stays until the cell has carried it out.
    """

    def __init__(self, handle: Any) -> None:
        self.handle = handle
        self._shown: object = None

    @property
    def value(self) -> Any:
        """Value of the input, as the user may have changed it."""
        return self.handle.value

    def show(self, value: object) -> None:
        """Show the value, if it has changed."""
        if value != self._shown:
            self._shown = value
            set_changed(self.handle, "value", value)


def small_html(lines: Iterable[str]) -> str:
    """Lines of HTML in small print, without empty lines."""
    return (
        f'<div style="padding:0 0.75em 0.4em;font-size:0.85em;line-height:1.4">{"<br>".join(filter(None, lines))}</div>'
    )


def run_once(script: str) -> str:
    """HTML that runs a script in the page: the element's empty picture fails to load, without any request."""
    return f'<img src="data:," alt="" style="display:none" onerror="{escape(script)}">'


class Debounce:
    """Reports a change of a value after the value has not changed for `delay` seconds."""

    def __init__(self, clock: Callable[[], float] = monotonic, delay: float = 0.2) -> None:
        self._clock, self._delay = clock, delay
        self._changed: float | None = None

    @property
    def is_pending(self) -> bool:
        """Whether a change is pending."""
        return self._changed is not None

    def change(self) -> None:
        """Note that the value changes now."""
        self._changed = self._clock()

    def take(self) -> bool:
        """Whether a change is due; clears it if so."""
        if self._changed is None or self._clock() - self._changed < self._delay:
            return False
        self._changed = None
        return True


class Rate:
    """Mean change of a value per second of wall time; a value that decreases begins anew.

    Parameters
    ----------
    span
        Wall time over which the mean is taken, s.
    clock
        s.
    """

    def __init__(self, span: float = 3.0, clock: Callable[[], float] = monotonic) -> None:
        self._span, self._clock = span, clock
        self._values: deque[tuple[float, float]] = deque()

    def add(self, value: float) -> None:
        """Add the present value."""
        if self._values and value < self._values[-1][1]:
            self._values.clear()
        now = self._clock()
        self._values.append((now, value))
        while len(self._values) > 2 and self._values[1][0] <= now - self._span:
            self._values.popleft()

    @property
    def per_second(self) -> float | None:
        """The mean change; None before there are values of a whole span."""
        if not self._values:
            return None
        (first, low), (last, high) = self._values[0], self._values[-1]
        return (high - low) / (last - first) if last - first >= self._span else None


def theme_html() -> str:
    """HTML that sets the colours of the page's theme, and the look of its folders."""
    rules = "".join(f"{name}:{colour};" for name, colour in THEME.items())
    return f"<style>:root:root:root{{{rules}}}{_BARS}</style>"


def colour_bar_html(bar: ColourBar) -> str:
    """The number of points in every interval between the limits, above the colour of the interval, as HTML."""
    counts = bar.counts / max(1, bar.counts.max())
    n = len(counts)
    shown = np.rint(bar.colours[np.rint(np.linspace(0, len(bar.colours) - 1, n)).astype(int)]).astype(int).tolist()
    columns = "".join(
        f'<rect x="{i}" y="{(1 - share) * _HEIGHT:.1f}" width="1.02" height="{share * _HEIGHT:.1f}" fill="#495057"/>'
        f'<rect x="{i}" y="{_HEIGHT}" width="1.02" height="{_BAR}" fill="rgb({red},{green},{blue})"/>'
        for i, (share, (red, green, blue)) in enumerate(zip(counts.tolist(), shown, strict=True))
    )
    low, high = bar.limits
    return (
        f'<div style="padding:0 0.75em 0.4em;font-size:0.85em"><svg viewBox="0 0 {n} {_HEIGHT + _BAR}" '
        f'preserveAspectRatio="none" style="width:100%;height:{_HEIGHT + _BAR}px;display:block">{columns}</svg>'
        f'<div style="display:flex;justify-content:space-between"><span>{low:.3g}</span>'
        f"<span>{escape(bar.title)}</span><span>{high:.3g}</span></div></div>"
    )


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
