"""Contrast of the texts of the panels."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

from contrast import contrast, rgb
from scancell.browser.panels.handles import ALARM, CALM, DIMMED, FIELDS, MARKED, THEME, WARNING, theme_html

WHITE = "#ffffff"


def test_contrast_of_known_colours() -> None:
    """Black on white is 21:1; #767676 is the lightest grey that reaches 4.5:1 on white."""
    assert contrast(rgb(WHITE), rgb("#000000")) == pytest.approx(21)
    assert contrast(rgb("rgb(118, 118, 118)"), rgb(WHITE)) == pytest.approx(4.54, abs=0.01)
    assert contrast(rgb("#777777"), rgb(WHITE)) < 4.5


@pytest.mark.parametrize(
    ("text", "behind"),
    [
        *((colour, WHITE) for colour in (ALARM, WARNING, CALM, DIMMED, *THEME.values())),
        *FIELDS.items(),
        ("#000000", MARKED),
    ],
)
def test_texts_are_legible(text: str, behind: str) -> None:
    """Of filled buttons, the text is white and the theme's colour behind it."""
    assert contrast(rgb(text), rgb(behind)) >= 4.5


def test_theme_is_set_on_the_page() -> None:
    assert all(f"{name}:{colour};" in theme_html() for name, colour in THEME.items())


def test_banner_of_a_lost_connection_is_legible() -> None:
    script = files("scancell.browser.panels").joinpath("connection.js").read_text(encoding="utf-8")
    found = re.search(r"background:(#\w{6});color:(#\w{6})", script)
    assert found is not None
    assert contrast(rgb(found[1]), rgb(found[2])) >= 4.5
