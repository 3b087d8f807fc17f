"""Display options of a scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class SceneOptions:
    """Switches of a scene; each may be set at any time from any thread.

    Attributes
    ----------
    frames
        Axes of all frames, with their names.
    collision_meshes
        The meshes of which the cell computes collisions and distances, as wire frames.
    field_of_view
        Outline of the sensor's measuring range, and the laser's sheet while the laser is on.
    ghost
        The arm and the table where the motion in force leads.
    trace
        Line along which the sensor's origin went.
    distances
        Line between the nearest bodies, with its length.
    devices
        Presence sensors, distance sensors and light curtains.
    """

    frames: bool = False
    collision_meshes: bool = False
    field_of_view: bool = True
    ghost: bool = True
    trace: bool = True
    distances: bool = True
    devices: bool = True
    _changed: Callable[[], None]

    def __init__(self, changed: Callable[[], None]) -> None:
        object.__setattr__(self, "_changed", changed)

    def __setattr__(self, name: str, value: Any) -> None:
        if not isinstance(getattr(SceneOptions, name, None), bool):
            raise AttributeError(f"a scene has no option {name}")
        object.__setattr__(self, name, bool(value))
        self._changed()
