"""Meshes of surfaces of revolution."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.geometry.mesh import Mesh

Array = NDArray[np.float64]


def chords(radius: float, chord_error: float) -> int:
    """Even number of chords of a circle that stay within `chord_error` of it."""
    half_angle = np.arccos(max(1.0 - chord_error / radius, 0.5))
    return 2 * int(np.ceil(np.pi / half_angle / 2))


def revolved_mesh(profile: Array, segments: int, source: str) -> Mesh:
    """Mesh of a polyline (k, 2) of radius and z, material on its left, turned about z."""
    angle = 2 * np.pi * np.arange(segments) / segments
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    is_closed = bool((profile[0] == profile[-1]).all())
    corners = profile[:-1] if is_closed else profile
    rings = [_ring(radius, z, circle) for radius, z in corners]
    first = np.cumsum([0, *(len(ring) for ring in rings)])
    pairs = [(k, (k + 1) % len(rings)) for k in range(len(profile) - 1)]
    strips = [_strip(int(first[a]), len(rings[a]), int(first[b]), len(rings[b])) for a, b in pairs]
    return Mesh(np.concatenate(rings), np.concatenate(strips), source)


def _ring(radius: float, z: float, circle: Array) -> Array:
    """Vertices of one corner of the profile: a circle, or a point on the axis."""
    if radius == 0.0:
        return np.array([[0.0, 0.0, z]])
    return np.column_stack([radius * circle, np.full(len(circle), z)])


def _strip(low: int, low_count: int, high: int, high_count: int) -> NDArray[np.int64]:
    """Faces between two rings of vertices, of which one may be a point."""
    count = max(low_count, high_count)
    here = np.arange(count)
    after = (here + 1) % count
    below = np.stack([low + here, low + after, high + after % high_count], 1)
    above = np.stack([low + here % low_count, high + after, high + here], 1)
    return np.concatenate([below] * (low_count > 1) + [above] * (high_count > 1))
