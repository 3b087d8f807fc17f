"""What is written into a picture of the cell: part, time, points, the grid's pitch, and the colours of the cloud."""

from __future__ import annotations

import numpy as np

from scancell.output.drawing import INK, Pixels, Sheet, text_width
from scancell.views import shading
from scancell.views.coloured_cloud import ColouredCloud


def captioned(image: Pixels, name: str, time: float, cloud: ColouredCloud | None) -> Pixels:
    """The picture (h, w, 3) with its caption, whose size goes with the height, on paler ground."""
    height, width, _ = image.shape
    size, rim = max(9.0, height / 42), height / 30
    facts = [f"t = {time:.2f} s", f"grid {1e3 * shading.GRID:.0f} mm"]
    if cloud is not None:
        share = cloud.measured_until(time) / max(len(cloud.time), 1)
        facts.insert(1, f"{cloud.total * share:,.0f} points")
    line = "  ·  ".join(facts)
    written = max(text_width(name, 1.15 * size, bold=True), text_width(line, size))
    pale = image.copy()
    _pale(pale, rim / 2, rim / 2, 1.5 * rim + written, rim + 3 * size)
    if cloud is not None:
        _pale(pale, width - 2 * rim - 256, height - 1.5 * rim - 3.2 * size, width - rim / 2, height - rim / 2)
    sheet = Sheet.of(pale)
    sheet.text(rim, rim + size, name, 1.15 * size, INK, bold=True)
    sheet.text(rim, rim + 2.5 * size, line, size, INK)
    if cloud is not None:
        _colour_bar(sheet, cloud, width - 1.25 * rim, height - rim, size)
    return sheet.pixels


def _pale(image: Pixels, left: float, top: float, right: float, bottom: float) -> None:
    """Blend a rectangle of an image (h, w, 3) with white, so that text on it can be read."""
    area = image[max(0, round(top)) : round(bottom), max(0, round(left)) : round(right)]
    area[:] = (0.4 * area + 0.6 * 255).astype(np.uint8)


def _colour_bar(sheet: Sheet, cloud: ColouredCloud, right: float, bottom: float, size: float) -> None:
    """The colour scale of the cloud, its lower right corner at (right, bottom)."""
    bar = np.repeat(cloud.scale[None], max(4, round(0.55 * size)), 0).astype(np.uint8)
    left, top = round(right - bar.shape[1]), round(bottom - 1.5 * size - bar.shape[0])
    sheet.image(bar, left, top)
    low, high = cloud.limits
    for x, value in ((left, low), (left + bar.shape[1] / 2, (low + high) / 2), (left + bar.shape[1], high)):
        label = f"{value:+.3g}" if low < 0 and value else f"{value:.3g}"
        sheet.text(x, bottom, label.replace("-", "\N{MINUS SIGN}"), 0.85 * size, INK, "ms")
    sheet.text(left + bar.shape[1] / 2, top - 0.5 * size, cloud.title, 0.85 * size, INK, "ms")
