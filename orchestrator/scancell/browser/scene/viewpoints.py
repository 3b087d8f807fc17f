"""Viewpoints of a scene: from where a browser shows the whole cell, the part or the sensor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.nominal.cell import Body
from scancell.views.camera import framing

Array = NDArray[np.float64]
ViewName = Literal["cell", "part", "sensor"]
VIEW_NAMES: tuple[ViewName, ...] = get_args(ViewName)

_DIRECTIONS = {"cell": (-38.0, 24.0), "part": (-52.0, 38.0), "sensor": (-52.0, 20.0)}  # azimuth, elevation, deg
_CARRIED_BY = {"part": ("table", "part"), "sensor": ("sensor", "part")}  # frames of the bodies in view
_HEIGHT_PX = 800
_SAMPLES = 200  # vertices of a body


@dataclass(frozen=True)
class Viewpoint:
    """Camera of a browser: `position` and `look_at` (3,), world, m; vertical field of view `fov`, rad."""

    position: Array
    look_at: Array
    fov: float


def viewpoint(view: ViewName, bodies: Iterable[Body], frames: Mapping[str, Array], aspect: float) -> Viewpoint:
    """The nearest viewpoint that has the bodies of a view in a picture with a rim around them.

    Parameters
    ----------
    bodies, frames
        Of the cell; poses ``world_from_frame`` (4, 4) by the names of the frames.
    aspect
        Width of the picture over its height.
    """
    wanted = _CARRIED_BY.get(view)
    bodies = tuple(bodies)
    points = placed([body for body in bodies if wanted is None or body.moves_with in wanted] or bodies, frames)
    camera = framing(points, *_DIRECTIONS[view], (round(aspect * _HEIGHT_PX), _HEIGHT_PX))
    middle = (points.min(0) + points.max(0)) / 2
    forward = camera.world_from_camera[:3, 2]
    look_at = camera.centre + np.linalg.norm(middle - camera.centre) * forward
    return Viewpoint(camera.centre, look_at, float(2 * np.arctan(_HEIGHT_PX / 2 / camera.focal_px)))


def placed(bodies: Iterable[Body], frames: Mapping[str, Array]) -> Array:
    """World points (n, 3) of some vertices of bodies, m."""
    return np.concatenate(
        [
            pose.transform_points(
                frames[body.moves_with], body.mesh.vertices[:: max(1, len(body.mesh.vertices) // _SAMPLES)]
            )
            for body in bodies
        ]
    )
