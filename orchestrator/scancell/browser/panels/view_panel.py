"""Viewpoints of one browser, and switches of what the scene shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.scene.scene import VIEW_NAMES, CellScene, ViewName, Viewpoint

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
