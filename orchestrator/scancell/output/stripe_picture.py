"""Picture of camera images with the stripe that was found in them, as lines and in close-ups."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.output.sheet import TITLE_SIZE, Pixels, Sheet, resized

_FOUND = "#ff5a36"
_FRAME = "#38c6f4"
_PAPER = "#15181d"
_TEXT = "#e8eaee"
_WIDTH = 720  # px per camera
_GAP = 18  # px between pictures and around them
_HEAD = 92  # px above the images
_BETWEEN = 46  # px between image and close-up
_ZOOM_PX = (64, 26)  # width and height of the close-up
_CLOSE_UP_FINE = 3  # pixels drawn along each side of a pixel of the close-up, which smooths the marks
_GAMMA = 0.55  # lifts the flanks of the stripe and the ambient light out of the dark


def exposure_picture(
    images: NDArray[np.uint16], sensor: sensor_rt.Sensor, title: str, background: NDArray[np.uint16] | None = None
) -> Sheet:
    """Picture of the images (cameras, H, W) of an exposure with the stripe that the sensor's extraction finds.

    `background` are laser-off images of the same shape to subtract before extraction.
    """
    peaks = sensor_rt.extract(images[None], sensor, background=None if background is None else background[None])
    found = [
        (np.asarray(peaks.column)[peaks.camera == k], np.asarray(peaks.row)[peaks.camera == k])
        for k in range(len(sensor.cameras))
    ]
    return stripe_picture(list(images), found, names=[camera.name for camera in sensor.cameras], title=title)


def stripe_picture(
    images: Sequence[NDArray[np.integer]],
    peaks: Sequence[tuple[Array, Array]],
    *,
    names: Sequence[str],
    title: str = "",
) -> Sheet:
    """Per camera its whole image with the found stripe as a line, and below a close-up with every single peak.

    Parameters
    ----------
    images
        (H, W) digital numbers, one per camera.
    peaks
        Columns and rows (px, an integer is a pixel's centre) of the peaks found, one pair of arrays per camera.
    names
        Name of each camera.
    """
    height = max(round(image.shape[0] / image.shape[1] * _WIDTH) for image in images)
    close_height = round(_ZOOM_PX[1] / _ZOOM_PX[0] * _WIDTH)
    close_top = _HEAD + height + _BETWEEN
    sheet = Sheet((_WIDTH + _GAP) * len(images) + _GAP, close_top + close_height + _GAP, _PAPER)
    sheet.text(_GAP, 38, title, TITLE_SIZE, _TEXT, bold=True)
    for number, (image, (columns, rows), name) in enumerate(zip(images, peaks, names, strict=True)):
        left = _GAP + number * (_WIDTH + _GAP)
        grey = _grey(image)
        size = f"{image.shape[1]} × {image.shape[0]} px"
        caption = f"camera {name}   {size}, brightest {int(image.max())} DN, {len(columns)} peaks"
        sheet.text(left, _HEAD - 10, caption, colour=_TEXT)
        sheet.image(_whole(grey, columns, rows), left, _HEAD)
        sheet.legend(left + _WIDTH - 116, _HEAD - 15, [("found stripe", _FOUND)], _TEXT)
        if not len(columns):
            continue
        corner = _close_up(columns, rows, image.shape)
        scale = _WIDTH / image.shape[1]
        x, y = left + (corner[0] + 0.5) * scale, _HEAD + (corner[1] + 0.5) * scale
        sheet.rectangle(x, y, x + _ZOOM_PX[0] * scale, y + _ZOOM_PX[1] * scale, outline=_FRAME, width=2)
        sheet.text(left, close_top - 9, f"close-up, {_ZOOM_PX[0]} × {_ZOOM_PX[1]} px", colour=_FRAME)
        sheet.image(_close(grey, columns, rows, corner, close_height), left, close_top)
        sheet.rectangle(left, close_top, left + _WIDTH - 1, close_top + close_height - 1, outline=_FRAME, width=2)
        sheet.legend(left + _WIDTH - 116, close_top - 14, [("peak", _FOUND)], _TEXT)
    return sheet


def _whole(grey: Pixels, columns: Array, rows: Array) -> Pixels:
    """The image (height, `_WIDTH`, 3) with a line along the stripe, broken where it is torn."""
    height, width = grey.shape[:2]
    shown = (_WIDTH, round(height / width * _WIDTH))
    small = width <= _WIDTH
    # Drawn in the finer of both sizes: making it smaller smooths the line.
    sheet = Sheet.of(resized(grey, *shown, sharp=True) if small else grey)
    scale = _WIDTH / width if small else 1.0
    order = np.argsort(columns, kind="stable")
    x, y = columns[order].astype(float), rows[order].astype(float)
    torn = np.flatnonzero((np.diff(x) > 1.5) | (np.abs(np.diff(y)) > 4.0)) + 1
    points = np.stack([(x + 0.5) * scale, (y + 0.5) * scale], 1)
    for piece in np.split(points, torn):
        if len(piece) > 1:
            sheet.line([(px, py) for px, py in piece.tolist()], _FOUND, 2)
    return sheet.pixels if small else resized(sheet.pixels, *shown)


def _close(grey: Pixels, columns: Array, rows: Array, corner: tuple[float, float], height: int) -> Pixels:
    """The pixels from `corner` on, each of them visible, with a dot at each peak."""
    x0, y0 = corner
    left, top = round(x0 + 0.5), round(y0 + 0.5)
    cut = np.zeros((_ZOOM_PX[1], _ZOOM_PX[0], 3), np.uint8)  # images may be smaller
    inside = grey[top : top + _ZOOM_PX[1], left : left + _ZOOM_PX[0]]
    cut[: inside.shape[0], : inside.shape[1]] = inside
    sheet = Sheet.of(resized(cut, _WIDTH * _CLOSE_UP_FINE, height * _CLOSE_UP_FINE, sharp=True))
    scale = _WIDTH * _CLOSE_UP_FINE / _ZOOM_PX[0]
    near = (columns > x0) & (columns < x0 + _ZOOM_PX[0]) & (rows > y0) & (rows < y0 + _ZOOM_PX[1])
    for x, y in zip(columns[near], rows[near], strict=True):
        sheet.dot((x - x0) * scale, (y - y0) * scale, 3.0 * _CLOSE_UP_FINE, _FOUND)
    return resized(sheet.pixels, _WIDTH, height)


def _grey(image: NDArray[np.integer]) -> Pixels:
    """Greys (H, W, 3): black is the image's own background, white the brightest ten-thousandth."""
    count = np.cumsum(np.bincount(image.ravel()))
    black, white = np.searchsorted(count, np.array([0.01, 0.9999]) * image.size)
    value = np.clip((np.arange(len(count)) - black) / max(white - black, 1), 0, 1)
    grey = (255 * value**_GAMMA).astype(np.uint8)[image]
    return np.repeat(grey[:, :, None], 3, axis=2)


def _close_up(columns: Array, rows: Array, shape: tuple[int, ...]) -> tuple[float, float]:
    """Upper left corner of the close-up, around the middle peak, moved inside the image."""
    middle = np.argsort(columns, kind="stable")[len(columns) // 2]
    x = np.clip(np.round(columns[middle]) - _ZOOM_PX[0] / 2, 0, max(shape[1] - _ZOOM_PX[0], 0))
    y = np.clip(np.round(rows[middle]) - _ZOOM_PX[1] / 2, 0, max(shape[0] - _ZOOM_PX[1], 0))
    return float(x) - 0.5, float(y) - 0.5
