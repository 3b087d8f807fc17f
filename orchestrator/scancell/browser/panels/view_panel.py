"""Viewpoints of one browser."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.browser.panels.operator_commands import OperatorCommands
from scancell.browser.scene.scene import CellScene
from scancell.browser.scene.viewpoints import VIEW_NAMES, ViewName, Viewpoint

_FOLLOW = "follow"
_RESIZED = 0.02  # relative change of the aspect ratio, from which a viewpoint is fitted again
_STILL = 1e-3  # m: the user has not moved the camera


class ViewPanel:
    """Buttons for viewpoints; *follow* keeps the sensor where it is in the picture.

    Until the user moves the camera, the chosen view is fitted again when panels or the window change the size of the
    picture.

    Parameters
    ----------
    gui, camera
        Of one browser.
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
        elif abs(self._present_aspect() / self._aspect - 1) > _RESIZED and self._is_untouched:
            self._fit(self._view)

    @property
    def _is_untouched(self) -> bool:
        return bool(np.abs(np.asarray(self._camera.position) - self._fitted).max() < _STILL)

    def _present_aspect(self) -> float:
        width, height = self._camera.image_width, self._camera.image_height
        return width / height if width > 0 and height > 0 else 1.0

    def _fit(self, view: ViewName) -> None:
        self._view, self._aspect = view, self._present_aspect()
        seen: Viewpoint = self._scene.viewpoint(view, self._aspect)
        self._camera.position, self._camera.look_at = seen.position, seen.look_at
        self._camera.fov = seen.fov
        self._fitted = seen.position
