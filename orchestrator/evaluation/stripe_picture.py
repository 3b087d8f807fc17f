"""Camera images with the stripe that was found in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from orchestrator.files import atomic_write

Array = NDArray[np.float64]

_FOUND = "#ff5a36"
_FRAME = "#38c6f4"
_PAPER = "#15181d"
_TEXT = "#e8eaee"
_SOFT = "#9aa3ae"
_WIDTH = 7.2  # inches per camera
_ZOOM_PX = (64, 26)  # width and height of the close-up
_GAMMA = 0.55  # lifts the flanks of the stripe and the ambient light out of the dark


def stripe_picture(
    path: str | Path,
    images: Sequence[NDArray[np.integer]],
    peaks: Sequence[tuple[Array, Array]],
    *,
    names: Sequence[str],
    title: str = "",
) -> None:
    """Per camera its whole image with the found stripe as a line, and below a close-up with every single peak.

    Parameters
    ----------
    images
        (H, W) digital numbers, one per camera.
    peaks
        Columns and rows (px, an integer is a pixel's centre) of the peaks found, one pair of arrays per camera.
    names
        Name of each camera.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    height = max(image.shape[0] / image.shape[1] for image in images) * _WIDTH
    close_height = _ZOOM_PX[1] / _ZOOM_PX[0] * _WIDTH
    figure = Figure(figsize=((_WIDTH + 0.2) * len(images) + 0.1, height + close_height + 1.7), dpi=100)
    figure.set_facecolor(_PAPER)
    grid = figure.add_gridspec(2, len(images), height_ratios=(height, close_height), wspace=0.025, hspace=0.07)
    grid.update(left=0.01, right=0.99, top=1 - 0.95 / figure.get_figheight(), bottom=0.012)
    for column, (image, (columns, rows), name) in enumerate(zip(images, peaks, names, strict=True)):
        limits = _grey_limits(image)
        whole = figure.add_subplot(grid[0, column])
        _draw_whole(whole, image, columns, rows, limits)
        whole.set_title(_caption(image, columns, name), loc="left", color=_TEXT, fontsize=11)
        if len(columns):
            corner = _close_up(columns, rows, image.shape)
            _draw_close(figure.add_subplot(grid[1, column]), image, columns, rows, corner, limits)
            whole.add_patch(Rectangle(corner, *_ZOOM_PX, fill=False, edgecolor=_FRAME, linewidth=1.2))
    figure.text(0.01, 1 - 0.38 / figure.get_figheight(), title, color=_TEXT, fontsize=15, weight="bold")
    with atomic_write(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def _draw_whole(
    axes: Axes, image: NDArray[np.integer], columns: Array, rows: Array, limits: tuple[float, float]
) -> None:
    axes.imshow(_stretched(image, limits), cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
    order = np.argsort(columns, kind="stable")
    x, y = columns[order].astype(float), rows[order].astype(float)
    torn = np.flatnonzero((np.diff(x) > 1.5) | (np.abs(np.diff(y)) > 4.0)) + 1
    axes.plot(np.insert(x, torn, np.nan), np.insert(y, torn, np.nan), color=_FOUND, linewidth=0.9, label="found stripe")
    _finish(axes)
    axes.set(xlim=(-0.5, image.shape[1] - 0.5), ylim=(image.shape[0] - 0.5, -0.5))


def _draw_close(
    axes: Axes,
    image: NDArray[np.integer],
    columns: Array,
    rows: Array,
    corner: tuple[float, float],
    limits: tuple[float, float],
) -> None:
    axes.imshow(_stretched(image, limits), cmap="gray", vmin=0, vmax=1, interpolation="nearest")
    x0, y0 = corner
    near = (columns > x0) & (columns < x0 + _ZOOM_PX[0]) & (rows > y0) & (rows < y0 + _ZOOM_PX[1])
    axes.plot(columns[near], rows[near], "o", color=_FOUND, markersize=4.5, markeredgewidth=0, label="peak")
    _finish(axes)
    axes.set(xlim=(x0, x0 + _ZOOM_PX[0]), ylim=(y0 + _ZOOM_PX[1], y0))
    axes.spines[:].set(visible=True, color=_FRAME, linewidth=1.2)
    axes.set_title(f"close-up, {_ZOOM_PX[0]} × {_ZOOM_PX[1]} px", loc="left", color=_FRAME, fontsize=11)


def _finish(axes: Axes) -> None:
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    axes.legend(loc="upper right", facecolor=_PAPER, edgecolor="none", labelcolor=_TEXT, fontsize=10, framealpha=0.8)


def _caption(image: NDArray[np.integer], columns: Array, name: str) -> str:
    size = f"{image.shape[1]} × {image.shape[0]} px"
    return f"camera {name}   {size}, brightest {int(image.max())} DN, {len(columns)} peaks"


def _grey_limits(image: NDArray[np.integer]) -> tuple[float, float]:
    """Black and white: the image's own background and its brightest tenth of a permille."""
    black, white = np.quantile(image, [0.01, 0.9999])
    return float(black), float(max(white, black + 1))


def _stretched(image: NDArray[np.integer], limits: tuple[float, float]) -> Array:
    black, white = limits
    return np.asarray(np.clip((image - black) / (white - black), 0, 1) ** _GAMMA)


def _close_up(columns: Array, rows: Array, shape: tuple[int, ...]) -> tuple[float, float]:
    """Upper left corner of the close-up, around the middle peak, moved inside the image."""
    middle = np.argsort(columns, kind="stable")[len(columns) // 2]
    x = np.clip(np.round(columns[middle]) - _ZOOM_PX[0] / 2, 0, max(shape[1] - _ZOOM_PX[0], 0))
    y = np.clip(np.round(rows[middle]) - _ZOOM_PX[1] / 2, 0, max(shape[0] - _ZOOM_PX[1], 0))
    return float(x) - 0.5, float(y) - 0.5
