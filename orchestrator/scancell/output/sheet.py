"""Drawing of pictures: sheets of pixels, axes of plots and their legends, in the style of all plots."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from scancell.files import atomic_write

Point = tuple[float, float]
Pixels = NDArray[np.uint8]
Tick = tuple[float, str]

_STYLE = dict(
    re.findall(r"^([a-z][\w.]*): (.*)$", Path(__file__).parents[1].joinpath("plots.mplstyle").read_text(), re.M)
)
INK, EDGE, GRID = (f"#{_STYLE[key]}" for key in ("text.color", "axes.edgecolor", "grid.color"))
COLOURS = tuple(f"#{colour}" for colour in re.findall(r"\b[0-9a-f]{6}\b", _STYLE["axes.prop_cycle"]))
SOFT = "#7d8590"
TEXT_SIZE, TITLE_SIZE = 15.0, 19.0  # px


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
        self, x: float, y: float, text: str, size: float = TEXT_SIZE, colour: str = INK, anchor: str = "ls",
        bold: bool = False, halo: str | None = None,
    ) -> None:  # fmt: skip
        """Write a line of text `size` px high.

        `anchor` is the point of the text at (x, y): l, m or r for its left end, middle or right end, and s, m or a for
        its base line, middle or top. `halo` is a colour around the letters, from which they stand out.
        """
        self._draw.text(
            (x, y), text, colour, _font(size, bold), anchor, stroke_width=3 * (halo is not None), stroke_fill=halo
        )

    def text_upwards(self, x: float, y: float, text: str, size: float = TEXT_SIZE, colour: str = INK) -> None:
        """Write a line of text that reads upwards, its middle at (x, y)."""
        left, _, right, bottom = _font(size, False).getbbox(text, anchor="la")
        label = Image.new("L", (int(right - left) + 2, int(bottom) + 2), 0)
        ImageDraw.Draw(label).text((0, 0), text, 255, _font(size, False))
        label = label.rotate(90, expand=True)
        self._image.paste(colour, (int(x - label.width / 2), int(y - label.height / 2)), label)

    def line(self, points: Sequence[Point], colour: str, width: int = 1) -> None:
        """Join points by straight lines."""
        self._draw.line(points, colour, width, "curve" if width > 1 and len(points) > 2 else None)

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

    def legend(self, x: float, y: float, entries: Iterable[tuple[str, str]], ink: str = INK) -> None:
        """Write labels and their colours in a row that begins at `x` and has its middle at `y`."""
        for label, colour in entries:
            self.rectangle(x, y - 7, x + 14, y + 7, colour, EDGE)
            self.text(x + 21, y, label, colour=ink, anchor="lm")
            x += 43 + text_width(label)

    def png(self) -> bytes:
        """The image as PNG."""
        stream = io.BytesIO()
        self._image.save(stream, "png", compress_level=2)
        return stream.getvalue()

    def write(self, path: str | Path) -> None:
        """Write a PNG file.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        with atomic_write(path) as temporary:
            temporary.write_bytes(self.png())


class Axes:
    """Axes of a plot in the rectangle `box` (left, top, right, bottom, px) of a sheet, drawn before its values.

    Parameters
    ----------
    x, y
        Limits of the values.
    labels
        Labels of both axes.
    title, legend
        Above the plot; labels of colours.
    x_ticks, y_ticks
        Values with their texts; by default round numbers.
    """

    def __init__(
        self, sheet: Sheet, box: tuple[int, int, int, int], x: Point, y: Point, labels: tuple[str, str],
        title: str = "", legend: Iterable[tuple[str, str]] = (), x_ticks: Sequence[Tick] | None = None,
        y_ticks: Sequence[Tick] | None = None,
    ) -> None:  # fmt: skip
        self._sheet, self._box, self._x, self._y = sheet, box, x, y
        left, top, right, bottom = box
        sheet.text(left, top - 42, title, TITLE_SIZE, bold=True)
        sheet.legend(left, top - 20, legend)
        widest = 0.0
        for value, label in ticks(*y, (bottom - top) // 55) if y_ticks is None else y_ticks:
            at = self.at(x[0], value)[1]
            sheet.line([(left, at), (right, at)], GRID)
            sheet.line([(left - 6, at), (left, at)], EDGE)
            sheet.text(left - 10, at, label, anchor="rm")
            widest = max(widest, text_width(label))
        for value, label in ticks(*x, (right - left) // 75) if x_ticks is None else x_ticks:
            at = self.at(value, y[0])[0]
            sheet.line([(at, bottom), (at, bottom + 6)], EDGE)
            sheet.text(at, bottom + 24, label, anchor="ms")
        sheet.line([(left, top), (left, bottom), (right, bottom)], EDGE)
        sheet.text((left + right) / 2, bottom + 50, labels[0], anchor="ms")
        sheet.text_upwards(left - 28 - widest, (top + bottom) / 2, labels[1])

    def at(self, x: float, y: float) -> Point:
        """The pixel of a value."""
        left, top, right, bottom = self._box
        along, up = (x - self._x[0]) / (self._x[1] - self._x[0]), (y - self._y[0]) / (self._y[1] - self._y[0])
        return round(left + along * (right - left)), round(bottom - up * (bottom - top))

    def line(self, points: Iterable[Point], colour: str, width: int = 2) -> None:
        """Join values by straight lines."""
        self._sheet.line([self.at(*point) for point in points], colour, width)

    def dots(self, points: Iterable[Point], colour: str) -> None:
        """Mark values."""
        for point in points:
            self._sheet.dot(*self.at(*point), 4, colour)

    def bar(self, left: float, right: float, low: float, high: float, colour: str) -> None:
        """Fill a rectangle."""
        (x0, y1), (x1, y0) = self.at(left, low), self.at(right, high)
        self._sheet.rectangle(x0, y0, x1, y1, colour)


def resized(pixels: Pixels, width: int, height: int, sharp: bool = False) -> Pixels:
    """An image (h, w, 3) at another size; `sharp` keeps the edges of its pixels."""
    how = Image.Resampling.NEAREST if sharp else Image.Resampling.BOX
    return np.asarray(Image.fromarray(pixels).resize((width, height), how))


def text_width(text: str, size: float = TEXT_SIZE, bold: bool = False) -> float:
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
