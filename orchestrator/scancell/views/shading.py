"""Colours of surfaces in pictures: one sun, light from the sky, a soft highlight, and the floor with its grid.

Colours are linear light, 0 to 1; `displayed` turns them into pixels.
"""

from __future__ import annotations

import numpy as np

from scancell.arrays import Array, Image

SUN = np.array([-0.30, -0.52, 0.80]) / np.linalg.norm([-0.30, -0.52, 0.80])  # towards it, in the world
GRID = 0.1  # m between the lines on the floor

_SKY, _BOUNCE = 0.46, 0.26  # of a white surface that looks up, and down
_SUNLIGHT = 0.62
_HIGHLIGHT, _SHARPNESS = 0.10, 5  # strength, and the exponent of the highlight as a power of two
_FLOOR = np.array([0.76, 0.775, 0.79])
_BACKDROP = np.array([0.89, 0.905, 0.925])
_LINE, _LINE_WIDTH = 0.80, 1.2e-3  # darkness of grid lines, and their width, m
FLOOR_END = 3.2  # m from the middle of the cell, where the floor has become the backdrop
_FADE_FROM = 1.0  # m from there, where that begins
_GAMMA = 2.0


def linear(colour: tuple[float, float, float]) -> Array:
    """Linear light (3,) of a displayed colour, 0 to 1."""
    return np.asarray(colour, float) ** _GAMMA


def displayed(light: Array) -> Image:
    """Pixels (..., 3) of linear light (..., 3)."""
    return np.asarray(255 * np.sqrt(np.clip(light, 0.0, 1.0)) + 0.5, np.uint8)


def shade(colour: Array, normals: Array, towards_viewer: Array, sunlit: Array) -> Array:
    """Light (n, 3) of surfaces with linear colours (n, 3) and unit normals (n, 3) on the viewer's side.

    `towards_viewer` (n, 3) is of unit length; `sunlit` (n,) is 0 in shadow, else 1. Sky and floor light by the
    direction of the normal alone; the highlight is Blinn's.
    """
    sky = 0.5 * (1 + normals[:, 2])
    cosine = np.maximum(normals @ SUN, 0.0) * sunlit
    facing = np.einsum("ni,ni->n", normals, towards_viewer)
    diffuse = (_BOUNCE + (_SKY - _BOUNCE) * sky) * (0.75 + 0.25 * facing) + _SUNLIGHT * cosine
    half = towards_viewer + SUN
    gloss = np.einsum("ni,ni->n", normals, half) / np.sqrt(np.einsum("ni,ni->n", half, half))
    gloss = np.maximum(gloss, 0.0) * (cosine > 0)
    for _ in range(_SHARPNESS):
        gloss = gloss * gloss
    return np.asarray(colour * diffuse[:, None] + _HIGHLIGHT * gloss[:, None])


def floor_light(points: Array, middle: Array, pixel_sizes: tuple[Array, Array], sunlit: Array) -> Array:
    """Light (n, 3) of points (n, 3) on the floor, which fades into the backdrop away from `middle` (3,).

    `pixel_sizes` (n,) are the widths of a pixel on the floor along world x and y, m; the grid is averaged over them.
    """
    lines = np.zeros(len(points))
    for axis, size in enumerate(pixel_sizes):
        off = np.abs(points[:, axis] - GRID * np.rint(points[:, axis] / GRID))
        cover = np.clip((_LINE_WIDTH / 2 + size / 2 - off) / size, 0.0, np.minimum(_LINE_WIDTH / size, 1.0))
        lines = np.maximum(lines, cover)
    brightness = (1 - (1 - _LINE) * lines) * (0.70 + 0.30 * sunlit)
    light = _FLOOR**_GAMMA * brightness[:, None]
    away = np.hypot(points[:, 0] - middle[0], points[:, 1] - middle[1])
    fade = np.clip((away - _FADE_FROM) / (FLOOR_END - _FADE_FROM), 0.0, 1.0)
    fade = fade * fade * (3 - 2 * fade)
    return np.asarray(light + fade[:, None] * (_BACKDROP**_GAMMA - light))


def backdrop(count: int) -> Array:
    """Light (count, 3) where nothing is seen."""
    return np.tile(_BACKDROP**_GAMMA, (count, 1))
