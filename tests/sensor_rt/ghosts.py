"""Images of polished parts with the ghost reflections that a two-camera sensor must reject, by geometry alone.

Two kinds of reflection: the laser, reflected by one wall, lights a spot on another (``bounced``); and a camera sees the
stripe in a wall as in a mirror (``mirrored``). Both leave the sheet, so that two cameras place them differently.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from stripe_images import stripe

from scancell.sensor import Camera, Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SLOPES = np.linspace(-0.11, 0.11, 40_001)  # dy/dz of the laser rays from the origin, in the plane X = 0


@dataclass(frozen=True)
class Wall:
    """Planar region: points p with ``normal . (p - origin) = 0`` where ``holds(p)``; the normal points outwards."""

    origin: Array
    normal: Array
    holds: Callable[[Array], Mask]

    def meet(self, start: Array, direction: Array) -> Array:
        """Distances (n,) along the rays to the wall, inf where they miss it or come from behind."""
        towards = direction @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((self.origin - start) @ self.normal) / towards
            point = start + distance[:, None] * direction
        hit = (towards < 0.0) & (distance > 1e-6) & self.holds(point)
        return np.where(hit, distance, np.inf)

    def mirror(self, vectors: Array, is_point: bool) -> Array:
        offset = vectors - self.origin if is_point else vectors
        return np.asarray(vectors - 2.0 * (offset @ self.normal)[:, None] * self.normal)


def first_hit(walls: list[Wall], start: Array, direction: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distance to the nearest wall, and its index."""
    distances = np.stack([wall.meet(start, direction) for wall in walls])
    return distances.min(axis=0), distances.argmin(axis=0)


def v_groove(yaw: float, depth: float = 0.006, floor: float = 0.124) -> list[Wall]:
    """Groove of 90 degrees in a flat plate; its axis is rotated by `yaw` from X (across the sheet) towards Y."""
    across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])

    def side(sign: float) -> Wall:
        normal = (-sign * across + np.array([0.0, 0.0, -1.0])) / np.sqrt(2.0)
        return Wall(
            np.array([0.0, 0.0, floor]), normal, lambda p: (sign * (p @ across) >= 0.0) & (sign * (p @ across) <= depth)
        )

    top = Wall(np.array([0.0, 0.0, floor - depth]), np.array([0.0, 0.0, -1.0]), lambda p: np.abs(p @ across) >= depth)
    return [side(1.0), side(-1.0), top]


def step(yaw: float, height: float = 0.01, floor: float = 0.13) -> list[Wall]:
    """Vertical wall through the sensor axis between a low and a high plane, rotated by `yaw` from X."""
    normal = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    return [
        Wall(np.array([0.0, 0.0, floor]), down, lambda p: p @ normal >= 0.0),
        Wall(np.array([0.0, 0.0, floor - height]), down, lambda p: p @ normal < 0.0),
        Wall(np.zeros(3), normal, lambda p: (p[:, 2] > floor - height) & (p[:, 2] < floor)),
    ]


@dataclass
class Views:
    """Rows per column (NaN: none) of the stripe and of its reflections in one camera."""

    direct: list[Array] = field(default_factory=list)
    bounced: list[Array] = field(default_factory=list)
    mirrored: list[Array] = field(default_factory=list)

    @property
    def ghosts(self) -> list[Array]:
        return self.bounced + self.mirrored


def view(walls: list[Wall], sensor: Sensor, camera: Camera) -> Views:
    """Image curves of a camera: stripe segments, one per wall, and reflections, one per pair of walls."""
    views = Views()
    centre = np.asarray(camera.sensor_from_camera)[:3, 3]
    rays = np.stack([np.zeros_like(SLOPES), SLOPES, np.ones_like(SLOPES)], axis=1)
    distance, lit = first_hit(walls, np.zeros((1, 3)), rays)
    spots = distance[:, None] * rays
    for a in range(len(walls)):
        mine = lit == a
        views.direct += _curves(camera, mine & _visible(walls, centre, spots), spots)
        reflected = walls[a].mirror(rays, is_point=False)
        reach, onto = first_hit(walls, spots, reflected)
        with np.errstate(invalid="ignore"):
            second = spots + np.where(np.isfinite(reach), reach, 0.0)[:, None] * reflected
        for b in range(len(walls)):
            if b == a:
                continue
            bounced = mine & np.isfinite(reach) & (onto == b) & _visible(walls, centre, second)
            views.bounced += _curves(camera, bounced, second)
            image = walls[b].mirror(spots, is_point=True)
            to_mirror = walls[b].meet(centre[None], image - centre)
            mirrored = mine & (to_mirror < 1.0)
            with np.errstate(invalid="ignore"):
                at_mirror = centre + np.where(np.isfinite(to_mirror), to_mirror, 0.0)[:, None] * (image - centre)
            mirrored &= _visible(walls, centre, at_mirror)
            views.mirrored += _curves(camera, mirrored, image)
    return views


def _visible(walls: list[Wall], centre: Array, points: Array) -> Mask:
    distance, _ = first_hit(walls, centre[None], points - centre)
    return np.asarray(distance > 1.0 - 1e-6)


def _curves(camera: Camera, present: Mask, points: Array) -> list[Array]:
    """Rows per column (NaN: none) of the segments of a curve of points (n, 3) that are `present`.

    A stretch that turns back over its own columns becomes two.
    """
    pixels = np.asarray(camera.project(points))
    onwards = np.sign(np.diff(pixels[:, 0], append=pixels[-1, 0]))
    breaks = np.flatnonzero((np.diff(present.astype(int)) != 0) | (np.diff(onwards) != 0)) + 1
    columns = np.arange(camera.width_px)
    curves = []
    for stretch in np.split(np.arange(len(pixels)), breaks):
        if len(stretch) < 2 or not present[stretch[0]]:
            continue
        column, row = pixels[stretch, 0], pixels[stretch, 1]
        if column[0] > column[-1]:
            column, row = column[::-1], row[::-1]
        curves.append(np.interp(columns, column, row, left=np.nan, right=np.nan))
    return curves


def draw(curves: list[Array], heights: list[Array], sigma: float, height_px: int) -> Array:
    """Electrons (height, width) of the segments within the image."""
    light = np.zeros((height_px, len(curves[0])))
    for rows, height in zip(curves, heights, strict=True):
        seen = np.isfinite(rows) & (rows > -10.0) & (rows < height_px + 10.0)
        if seen.any():
            light[:, seen] += stripe(rows[seen], sigma, height[seen], height_px)
    return light
