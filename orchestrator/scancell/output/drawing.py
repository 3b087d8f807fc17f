"""A sheet of pixels to draw text, lines and images on, written as PNG.

A plotting library needs half a second to be imported and another half for a page; Pillow needs a few milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from scancell.files import atomic_write

Pixels = NDArray[np.uint8]
Point = tuple[float, float]

INK = "#222831"
SOFT = "#7d8590"


class Sheet:
    """An image of `width` × `height` px; x grows to the right and y downwards from the upper left corner."""

    def __init__(self, width: int, height: int, background: str = "#ffffff") -> None:
        self._image = Image.new("RGB", (width, height), background)
        self._draw = ImageDraw.Draw(self._image)

    @classmethod
    def of(cls, pixels: Pixels) -> Sheet:
        """A sheet that shows an image (height, width, 3)."""
        sheet = cls(pixels.shape[1], pixels.shape[0])
        sheet.image(pixels, 0, 0)
        return sheet

    @property
    def pixels(self) -> Pixels:
        """(height, width, 3)."""
        return np.asarray(self._image)

    def text(
        self, x: float, y: float, text: str, size: float, colour: str = INK, anchor: str = "ls", bold: bool = False
    ) -> None:
        """Write a line of text `size` px high.

        `anchor` is the point of the text at (x, y): l, m or r for its left end, middle or right end, and s, m or a for
        its base line, middle or top.
        """
        self._draw.text((x, y), text, colour, _font(size, bold), anchor)

    def text_upwards(self, x: float, y: float, text: str, size: float, colour: str = INK) -> None:
        """Write a line of text that reads upwards, its middle at (x, y)."""
        left, _, right, bottom = _font(size, False).getbbox(text, anchor="la")
        label = Image.new("L", (int(right - left) + 2, int(bottom) + 2), 0)
        ImageDraw.Draw(label).text((0, 0), text, 255, _font(size, False))
        label = label.rotate(90, expand=True)
        self._image.paste(colour, (int(x - label.width / 2), int(y - label.height / 2)), label)

    def line(self, points: Sequence[Point], colour: str, width: int = 1) -> None:
        """Join points by straight lines."""
        self._draw.line(points, colour, width, "curve" if width > 1 and len(points) > 2 else None)

    def dashes(
        self, start: Point, end: Point, colour: str, dash: float = 0.0, gap: float = 0.0, width: int = 2
    ) -> None:
        """A horizontal or vertical line, downwards or to the right, in dashes or (`dash` 0) whole."""
        (x0, y0), (x1, y1) = start, end
        length, upright = max(x1 - x0, y1 - y0), y1 - y0 > x1 - x0
        for begin in np.arange(0, length, dash + gap) if dash else [0.0]:
            stop = min(begin + dash, length) if dash else length
            if upright:
                self._draw.rectangle((x0 - width // 2, y0 + begin, x0 - width // 2 + width - 1, y0 + stop - 1), colour)
            else:
                self._draw.rectangle((x0 + begin, y0 - width // 2, x0 + stop - 1, y0 - width // 2 + width - 1), colour)

    def rectangle(
        self, left: float, top: float, right: float, bottom: float, fill: str | None = None,
        outline: str | None = None, width: int = 1,
    ) -> None:  # fmt: skip
        """A rectangle; the sides lie in it."""
        self._draw.rectangle((left, top, right, bottom), fill, outline, width)

    def polygon(self, points: Sequence[Point], fill: str) -> None:
        """A filled polygon."""
        self._draw.polygon(points, fill)

    def dot(self, x: float, y: float, radius: float, colour: str) -> None:
        """A filled circle."""
        self._draw.ellipse((x - radius, y - radius, x + radius, y + radius), colour)

    def image(self, pixels: Pixels, left: int, top: int) -> None:
        """Put an image (height, width, 3) down."""
        self._image.paste(Image.fromarray(pixels), (left, top))

    def write(self, path: str | Path) -> None:
        """Write a PNG file.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        with atomic_write(path) as temporary:
            self._image.save(temporary, "png", compress_level=2)


def resized(pixels: Pixels, width: int, height: int, sharp: bool = False) -> Pixels:
    """An image (h, w, 3) at another size; `sharp` keeps the edges of its pixels."""
    how = Image.Resampling.NEAREST if sharp else Image.Resampling.BOX
    return np.asarray(Image.fromarray(pixels).resize((width, height), how))


def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width (px) of a line of text."""
    return float(_font(size, bold).getlength(text))


@cache
def _font(size: float, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(__file__).parent / "fonts" / name, size, layout_engine=ImageFont.Layout.BASIC)


def interpolated_colours(colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """256 colours (256, 3), linearly between evenly spaced ones (n, 3)."""
    at = np.linspace(0, len(colours) - 1, 256)
    return np.stack([np.interp(at, np.arange(len(colours)), channel) for channel in colours.T], 1)


def ticks(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """At most `most` + 1 round values (steps of 1, 2, 2.5 or 5) between two limits, and how to write them."""
    raw = (high - low) / most
    decade = 10.0 ** np.floor(np.log10(raw))
    step = next(factor * decade for factor in (1, 2, 2.5, 5, 10) if factor * decade >= raw * (1 - 1e-9))
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    decimals = next(n for n in range(20) if abs(round(step, n) - step) < 1e-6 * step)
    values = [step * k for k in range(int(first), int(last) + 1)]
    return [(value, f"{value:.{decimals}f}".replace("-", "\N{MINUS SIGN}")) for value in values]
