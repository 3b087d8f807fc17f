"""Colour bar of a cloud, with its limits and a histogram of the values."""

from __future__ import annotations

from html import escape

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.live_cloud import ColourBar

_HEIGHT, _BAR = 60, 12  # px of the histogram and of the colours below it


def colour_bar_html(bar: ColourBar) -> str:
    """The number of points in every interval between the limits, above the colour of the interval, as HTML."""
    counts = bar.counts / max(1, bar.counts.max())
    n = len(counts)
    shown = bar.colours[np.rint(np.linspace(0, len(bar.colours) - 1, n)).astype(int)]
    columns = "".join(
        f'<rect x="{i}" y="{(1 - share) * _HEIGHT:.1f}" width="1.02" height="{share * _HEIGHT:.1f}" fill="#495057"/>'
        f'<rect x="{i}" y="{_HEIGHT}" width="1.02" height="{_BAR}" fill="{_hex(colour)}"/>'
        for i, (share, colour) in enumerate(zip(counts.tolist(), shown, strict=True))
    )
    low, high = bar.limits
    return (
        f'<div style="padding:0 0.75em 0.4em;font-size:0.85em"><svg viewBox="0 0 {n} {_HEIGHT + _BAR}" '
        f'preserveAspectRatio="none" style="width:100%;height:{_HEIGHT + _BAR}px;display:block">{columns}</svg>'
        f'<div style="display:flex;justify-content:space-between"><span>{low:.3g}</span>'
        f"<span>{escape(bar.title)}</span><span>{high:.3g}</span></div></div>"
    )


def _hex(colour: NDArray[np.float64]) -> str:
    return "#" + "".join(f"{round(float(value)):02x}" for value in colour)
