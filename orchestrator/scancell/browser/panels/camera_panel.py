"""Camera images, viewpoints of one browser, and switches of what the scene shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.browser.panels.handles import Follower, run_once, set_changed, small_html
from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.scene.devices import field_corners
from scancell.browser.scene.scene import VIEW_NAMES, CellScene, ViewName, Viewpoint
from scancell.config.sensor import SensorDescription
from scancell.errors import require
from scancell.live.camera import CameraFeed, CameraFrame

_PLACE_PX, _WIDTH_PX, _PLOT_PX = 15, 530, 130
_BRIGHTEST = 255  # of the images

Rgb = NDArray[np.uint8]

_WIDTH = 480  # px, of an image as it is sent
_STRIPE = (40, 220, 60)
_PANEL = 400  # px
_GAP = 4  # px between images
_ENLARGE, _CLICK = "enlarge", "click to enlarge"  # texts that the script finds
_SCRIPT = Path(__file__).with_name("images.js").read_text(encoding="utf-8")
_SCRIPT = _SCRIPT.replace("@ENLARGE@", _ENLARGE).replace("@CLICK@", _CLICK)
_LEAST_ROOM = 0.2  # mm above and below a profile
_COLOURS = ("#e07820", "#2878d2", "#3ca050", "#a046aa")

_FOLLOW = "follow"
_RESIZED = 0.02  # relative change of the aspect ratio, from which a viewpoint is fitted again
_STILL = 1e-3  # m: the user has not moved the camera

_SWITCHES = {
    "frames": "frames",
    "collision meshes": "collision_meshes",
    "field of view and laser": "field_of_view",
    "target of the motion": "ghost",
    "path of the sensor": "trace",
    "nearest pair": "distances",
    "presence and distance sensors": "devices",
}


class EnlargedImage:
    """A floating panel for one camera; nothing is sent while it is closed.

    Parameters
    ----------
    gui
        Inputs of viser.
    names
        Names of the cameras.
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


class CameraPanel:
    """Shows frames of a feed; in a cell with several sensors those of the chosen one, which all browsers share.

    Parameters
    ----------
    gui
        Inputs of viser.
    feed
        Feed of the cameras; frames are made while its switch, which all browsers share, is on.
    sensors
        Nominal descriptions by name, the main one first; or that of the only sensor.
    beside
        Dock the panel at the left edge, else below the main panel, where a narrow window has room.
    """

    def __init__(
        self, gui: Any, feed: CameraFeed, sensors: SensorDescription | Mapping[str, SensorDescription], beside: bool
    ) -> None:
        self._feed = feed
        described = sensors if isinstance(sensors, Mapping) else {sensors.name: sensors}
        panel = gui.add_panel()
        with panel.add_tab("Cameras"):
            self._choice = self._chooser(gui, [*described]) if len(described) > 1 else None
            self._views = [SensorView(gui, feed, sensor, number) for number, sensor in enumerate(described.values(), 1)]
            on = gui.add_checkbox("cameras", feed.wanted)
            gui.add_html(run_once(_SCRIPT))
        self._on, self._number = Follower(on), 1
        self._show_chosen()
        if beside:
            panel.dock_left()
            panel.set_width(_PANEL)
        else:
            panel.dock_below(gui.main_panel)
        on.on_update(lambda event: setattr(feed, "wanted", on.value) if event.client is not None else None)

    def _chooser(self, gui: Any, names: list[str]) -> Follower:
        dropdown = gui.add_dropdown("sensor", names, initial_value=self._feed.sensor)
        dropdown.on_update(
            lambda event: setattr(self._feed, "sensor", dropdown.value) if event.client is not None else None
        )
        return Follower(dropdown)

    def _show_chosen(self) -> None:
        for number, view in enumerate(self._views, 1):
            view.set_visible(number == self._number)

    def show(self) -> None:
        """Show the last frame, if it is new."""
        self._on.show(self._feed.wanted)
        if self._choice is not None:
            chosen = self._feed.sensor
            self._choice.show(chosen)
            number = self._feed.sensors.index(chosen) + 1
            if number != self._number:
                self._number = number
                self._show_chosen()
        self._views[self._number - 1].show()

    def show_enlarged(self) -> None:
        """Show the last frame in the enlarged image, if it is open and the frame is new."""
        for view in self._views:
            view.show_enlarged()


class SensorView:
    """Shows frames of one sensor: the images side by side, with the stripe that was found in them, and the profile."""

    def __init__(self, gui: Any, feed: CameraFeed, sensor: SensorDescription, number: int) -> None:
        self._feed, self._number = feed, number
        self._names, self._shown = tuple(camera.name for camera in sensor.camera), 0
        half = round(1e3 * float(field_corners(sensor)[:, 1].max()), 1)
        self._width = (-half, half)
        self._range = (sensor.range.near_mm, sensor.range.far_mm)
        self._why_dark = f"no stripe: no surface that returns light is {self._range[0]:g} to {self._range[1]:g} mm away"
        self._uplot = require("viser.uplot", "workspace")
        blank = np.full((2, 2, 3), 40, np.uint8)
        label = f"{' | '.join(self._names)}, {_CLICK}"
        self._image = gui.add_image(blank, label=label, format="jpeg", visible=False)
        self._text = gui.add_html(small_html(["the first images are being made"]))
        self._plot = self._add_plot(gui)
        self._enlarge = gui.add_button_group(_ENLARGE, self._names)
        self._marks = gui.add_checkbox("found stripe", True)
        self._redrawn = 0
        self._large = EnlargedImage(gui, self._names, self._drawn)
        self._enlarge.on_click(lambda event: self._large.open(event.target.value))
        self._marks.on_update(lambda _: self._redraw())

    def set_visible(self, visible: bool) -> None:
        """Show or hide all of it; an image and a profile appear with their frame."""
        for handle in (self._enlarge, self._marks, self._text, self._plot):
            set_changed(handle, "visible", visible)
        if not visible:
            set_changed(self._image, "visible", False)
            self._large.close()

    def show(self) -> None:
        """Show the last frame, if it is new and of this sensor."""
        wanted, frame = self._feed.wanted, self._feed.frame
        if frame is not None and frame.sensor != self._number:
            frame = None
        for handle in (self._plot, self._text):
            set_changed(handle, "visible", wanted)
        has_images = frame is not None and frame.images is not None
        set_changed(self._image, "visible", wanted and has_images)
        if frame is None or frame.number == self._shown or not wanted:
            return
        self._shown = frame.number
        self._text.content = _summary(frame, self._why_dark)
        if frame.images is not None:
            self._image.image = side_by_side([self._drawn(frame, i, _WIDTH) for i in range(len(self._names))])
        self._plot.data = profile_data(frame, len(self._names))
        self._fit_range(1e3 * frame.points_in_sensor[:, 2])

    def show_enlarged(self) -> None:
        """Show the last frame in the enlarged image, if it is open and the frame is new and of this sensor."""
        frame = self._feed.frame
        self._large.show(None if frame is not None and frame.sensor != self._number else frame, self._redrawn)

    def _redraw(self) -> None:
        self._shown = 0
        self._redrawn += 1

    def _drawn(self, frame: CameraFrame, camera: int, width: int | None = None) -> Rgb:
        """Image of a camera, at most `width` px wide, with the stripe if it is switched on."""
        assert frame.images is not None
        stripe = frame.stripes[camera] if self._marks.value else np.zeros((0, 2))
        return with_stripe(frame.images[camera], stripe, width)

    def _add_plot(self, gui: Any) -> Any:
        uplot = self._uplot
        series = [uplot.Series(label="y, mm")]
        for name, colour in zip(self._names, _COLOURS, strict=False):
            points = uplot.Series_Points(show=True, size=3, fill=colour, stroke=colour)
            series.append(uplot.Series(label=f"z, mm: {name}", stroke=colour, width=0, points=points))
        nothing = np.zeros(1)
        return gui.add_uplot((nothing, *[nothing] * len(self._names)), tuple(series), scales=self._scales(), height=220)

    def _scales(self) -> dict[str, Any]:
        """The range axis of the sensor points away from it: near is above."""
        return {
            "x": self._uplot.Scale(time=False, range=self._width),
            "y": self._uplot.Scale(dir=-1, range=self._range),
        }

    def _fit_range(self, z: NDArray[np.float64]) -> None:
        """Fit the axes to the profile; new axes need a new plot, so not every frame changes them."""
        if not len(z):
            return
        low, high = float(z.min()), float(z.max())
        shown = self._range[1] - self._range[0]
        room = max(0.5 * (high - low), _LEAST_ROOM)
        if low < self._range[0] or high > self._range[1] or shown > 4 * (high - low + 2 * room):
            self._range = (round(low - room, 2), round(high + room, 2))
            self._plot.scales = self._scales()


def side_by_side(images: list[Rgb]) -> Rgb:
    """One picture (height, width, 3) of images, which may have different heights."""
    height = max(len(image) for image in images)
    padded = [np.pad(image, ((0, height - len(image)), (0, _GAP), (0, 0)), constant_values=255) for image in images]
    return np.hstack(padded)[:, :-_GAP]


def with_stripe(image: NDArray[np.uint8], stripe: NDArray[np.float64], width: int | None = None) -> Rgb:
    """An image in grey, at most `width` px wide, with marks at image positions (n, 2), column and row."""
    scale = 1.0 if width is None else min(1.0, width / image.shape[1])
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    # A stripe is narrower than a pixel of the smaller image; its brightest pixels stay.
    grown = cv2.dilate(image, np.ones((max(1, round(1 / scale)),) * 2, np.uint8))
    grey = cv2.resize(grown, size, interpolation=cv2.INTER_NEAREST)
    shown = np.repeat(np.asarray(grey, np.uint8)[..., None], 3, axis=2)
    column, row = np.rint((stripe + 0.5) * scale - 0.5).astype(np.int64).T
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    shown[row[inside], column[inside]] = _STRIPE
    return shown


def profile_data(frame: CameraFrame, cameras: int) -> tuple[NDArray[np.float64], ...]:
    """Data of a profile for a plot, mm: y in order, and z for each camera, NaN at points of other cameras."""
    if not len(frame.points_in_sensor):
        return (np.zeros(1), *[np.full(1, np.nan)] * cameras)
    order = np.argsort(frame.points_in_sensor[:, 1])
    points, camera = 1e3 * frame.points_in_sensor[order], frame.camera[order]
    return (points[:, 1], *(np.where(camera == number, points[:, 2], np.nan) for number in range(cameras)))


def _summary(frame: CameraFrame, why_dark: str) -> str:
    points = frame.points_in_sensor
    lines = [frame.error] if frame.error else [f"{len(points)} points, {frame.time:.2f} s"]
    if len(points):
        z = 1e3 * points[:, 2]
        lines.append(f"range {z.min():.2f} to {z.max():.2f} mm, mean {z.mean():.3f} mm")
    elif not frame.error:
        lines.append(why_dark)
    return small_html(map(escape, lines))


class ViewPanel:
    """Buttons for viewpoints; *follow* keeps the sensor where it is in the picture.

    Until the user moves the camera, the chosen view is fitted again when panels or the window change the size of the
    picture.

    Parameters
    ----------
    gui, camera
        Inputs and camera of one browser.
    """

    def __init__(self, gui: Any, camera: Any, operator: OperatorCommands, scene: CellScene) -> None:
        self._camera, self._scene = camera, scene
        self._aspect, self._view, self._fitted = 0.0, VIEW_NAMES[0], np.asarray(camera.position, float)
        self._followed: NDArray[np.float64] | None = None
        buttons = gui.add_button_group("view", (*VIEW_NAMES, _FOLLOW), order=90)
        buttons.on_click(operator.callback(lambda: self.choose(buttons.value)))
        self.choose(VIEW_NAMES[0])

    def choose(self, name: str) -> None:
        """Show a view, or follow the sensor."""
        self._followed = self._scene.position("sensor") if name == _FOLLOW else None
        self._fit(next((view for view in VIEW_NAMES if view == name), "sensor"))

    def update(self) -> None:
        """Follow the sensor, and fit the view to another size of the picture."""
        if self._followed is not None:
            now = self._scene.position("sensor")
            moved, self._followed = now - self._followed, now
            if moved.any():
                self._camera.position = np.asarray(self._camera.position) + moved  # and what it looks at
            return
        is_resized = abs(self._present_aspect() / self._aspect - 1) > _RESIZED
        if is_resized and np.abs(np.asarray(self._camera.position) - self._fitted).max() < _STILL:
            self._fit(self._view)

    def _present_aspect(self) -> float:
        width, height = self._camera.image_width, self._camera.image_height
        return width / height if width > 0 and height > 0 else 1.0

    def _fit(self, view: ViewName) -> None:
        self._view, self._aspect = view, self._present_aspect()
        seen: Viewpoint = self._scene.viewpoint(view, self._aspect)
        self._camera.position, self._camera.look_at = seen.position, seen.look_at
        self._camera.fov = seen.fov
        self._fitted = seen.position


def add_view_options(gui: Any, scene: CellScene) -> None:
    """Add a folder of switches to the panel."""
    with gui.add_folder("Display", expand_by_default=False, order=100):
        for label, option in _SWITCHES.items():
            add_switch(gui, scene, label, option)
        gui.add_button("Clear the path of the sensor").on_click(lambda _: scene.clear_trace())


def add_switch(gui: Any, scene: CellScene, label: str, option: str) -> None:
    """Add a checkbox for an option of a scene."""
    box = gui.add_checkbox(label, getattr(scene.options, option))
    box.on_update(lambda _: setattr(scene.options, option, box.value))
