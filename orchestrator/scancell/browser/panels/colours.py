"""Colours of texts, which have a contrast of at least 4.5:1 (WCAG 2.2, success criterion 1.4.3)."""

from __future__ import annotations

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


def theme_html() -> str:
    """HTML that sets the colours of the page's theme, and the look of its folders."""
    rules = "".join(f"{name}:{colour};" for name, colour in THEME.items())
    return f"<style>:root:root:root{{{rules}}}{_BARS}</style>"
