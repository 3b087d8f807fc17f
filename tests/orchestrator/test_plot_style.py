"""One style of all plots: colours of reports are those of the style, and every script or page that draws uses it."""

from __future__ import annotations

from pathlib import Path

import pytest

mpl = pytest.importorskip("matplotlib")
pytest.importorskip("matplotlib.style")

from scancell.studies.page import BLUE, ORANGE, svg  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
DRAWS = "import matplotlib.pyplot as plt\n"


def test_reports_have_the_colours_of_the_style() -> None:
    drawn = svg(2.0, 1.0, 1, lambda axes: [axes.plot([0, 1], [0, 1], color=colour) for colour in (BLUE, ORANGE)])
    with mpl.style.context("scancell.plots"):
        cycle = mpl.rcParams["axes.prop_cycle"].by_key()["color"]
    assert all(colour in drawn for colour in cycle[:2])


def test_whatever_draws_uses_the_style() -> None:
    drawing = {
        path: text
        for folder in ("docs", "tests/bench", "benchmarks")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".md") and DRAWS in (text := path.read_text(encoding="utf-8"))
    }
    assert len(drawing) > 10
    for path, text in drawing.items():
        assert text.count('plt.style.use("scancell.plots")') >= text.count(DRAWS), path
        assert 'layout="constrained"' not in text, path
