"""Display options of a scene, shared by all browsers."""

from __future__ import annotations

from typing import Any

from scancell.browser.scene.scene import CellScene

_SWITCHES = {
    "frames": "frames",
    "collision meshes": "collision_meshes",
    "field of view and laser": "field_of_view",
    "target of the motion": "ghost",
    "path of the sensor": "trace",
    "nearest pair": "distances",
    "presence and distance sensors": "devices",
}


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
