"""One camera image in full size, with the intensities along a column."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.browser.panels.handles import set_changed, small_html
from scancell.extras import require
from scancell.live.camera import CameraFrame

_PLACE_PX, _WIDTH_PX, _PLOT_PX = 15, 530, 130
_BRIGHTEST = 255  # of the images


class EnlargedImage:
    """A floating panel for one camera; nothing is sent while it is closed.

    Parameters
    ----------
    gui
        Of viser.
    names
        Of the cameras.
    drawn
        Makes the picture (height, width, 3) of the image of a camera, by its number.
    """

    def __init__(self, gui: Any, names: Sequence[str], drawn: Callable[[CameraFrame, int], NDArray[np.uint8]]) -> None:
        self._names, self._drawn = names, drawn
        self._camera, self._shown = 0, (0, 0, 0)
        self._panel = gui.add_panel(visible=False)
        with self._panel.add_tab("Image"):
            self._image = gui.add_image(np.full((2, 2, 3), 40, np.uint8), label=names[0], format="jpeg")
            self._column = gui.add_slider("column, px", 0, 1, 1, 0)
            self._text = gui.add_html("")
            self._plot = self._add_plot(gui)
            close = gui.add_button("Close the image")
        self._panel.float(x=_PLACE_PX, y=_PLACE_PX, width=_WIDTH_PX)
        close.on_click(lambda _: self.close())

    def open(self, name: str) -> None:
        """Show the image of a camera."""
        self._camera, self._shown = self._names.index(name), (0, 0, 0)
        self._image.label = name
        self._panel.visible = True

    def close(self) -> None:
        """Close the panel."""
        self._panel.visible = False

    def show(self, frame: CameraFrame | None, redrawn: int) -> None:
        """Show a frame, if it, the column or the number of changes of the drawing is new."""
        key = (0 if frame is None else frame.number, int(self._column.value), redrawn)
        if not self._panel.visible or frame is None or key == self._shown:
            return
        if frame.images is None:
            why = frame.error or "the geometric engine makes no images"
            set_changed(self._text, "content", small_html([escape(why)]))
            return
        width = frame.images.shape[2]
        if self._column.max != width - 1:
            self._column.max = width - 1
            self._column.value = width // 2
        self._shown = (frame.number, int(self._column.value), redrawn)
        self._image.image = self._drawn(frame, self._camera)
        column = min(int(self._column.value), width - 1)
        self._plot.data = column_profile(frame, self._camera, column)
        set_changed(self._text, "content", small_html([column_text(frame, self._camera, column)]))

    def _add_plot(self, gui: Any) -> Any:
        uplot = require("viser.uplot", "workspace")
        series = (uplot.Series(label="row, px"), uplot.Series(label="intensity, 8 bits", stroke="#2878d2", width=1))
        scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(range=(0, _BRIGHTEST))}
        return gui.add_uplot((np.zeros(1), np.zeros(1)), series, scales=scales, height=_PLOT_PX)


def column_profile(frame: CameraFrame, camera: int, column: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows, px, and intensities of a column of an image, as of 8 bits."""
    assert frame.images is not None
    values = frame.images[camera][:, column].astype(float)
    return np.arange(len(values), dtype=float), values


def column_text(frame: CameraFrame, camera: int, column: int) -> str:
    """The peaks found in a column, and its largest intensity."""
    values = column_profile(frame, camera, column)[1]
    stripe = frame.stripes[camera]
    rows = stripe[np.rint(stripe[:, 0]) == column, 1]
    found = "no peak found" if not len(rows) else "peak at row " + ", ".join(f"{row:.2f}" for row in rows)
    saturated = ", saturated" if values.max() >= _BRIGHTEST else ""
    return f"column {column}: {found}, largest intensity {values.max():.0f} of {_BRIGHTEST}{saturated}"
