"""Parts that stick out of the table: what the table turns into the arm."""

from __future__ import annotations

import numpy as np

from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, joined

_FOOT = (0.32, 0.05, 0.006)  # m: bounding boxes are centred on the table's axis
_SEGMENTS = 14  # of the ring


def standing_parts() -> dict[str, Mesh]:
    """Parts by name, m, each on a foot that is longer than the table: a vertical plate, a post, a segment of a ring."""
    plate = _box((0.004, 0.16, 0.15), (0.155, 0.0, 0.075))
    post = _box((0.01, 0.01, 0.22), (0.15, 0.0, 0.11))
    angles = np.radians(np.linspace(-30.0, 210.0, _SEGMENTS))
    ring = [
        _box((0.012, 0.035, 0.012), (0.06, 0.07 * np.cos(angle), 0.09 + 0.07 * np.sin(angle)), float(angle))
        for angle in angles
    ]
    # The ring's plane is across the foot: the table moves it along its axis and across.
    legs = [_box((0.012, 0.012, 0.06), (0.06, side * 0.0606, 0.03)) for side in (-1, 1)]
    found = {"plate": [plate], "post": [post], "ring": [*ring, *legs]}
    return {name: joined([box_mesh(_FOOT), *boxes], name) for name, boxes in found.items()}


def _box(size: tuple[float, float, float], centre: tuple[float, float, float], angle: float = 0.0) -> Mesh:
    """A box at `centre`, m, turned about x by `angle`, rad."""
    return box_mesh(size).transformed(pose.from_rotation(pose.rotation_about(0, angle), centre))
