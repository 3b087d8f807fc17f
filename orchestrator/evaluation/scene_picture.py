"""A picture of the cell: shaded meshes with sun and sky, by the ray tracer of evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.image import imsave
from numpy.typing import ArrayLike, NDArray

from orchestrator.evaluation.tracer import Tracer
from orchestrator.files import atomic_write
from orchestrator.geometry.mesh import Mesh

Array = NDArray[np.float64]

_FAR = 20.0  # m
_LIFT = 0.3e-3  # m off the surface where the way to the sun starts
_FLOOR = (0.86, 0.87, 0.88)
_SKY = (0.96, 0.97, 0.985)
_SAMPLES = 2  # per pixel and direction
_BAND = 64  # image rows traced at a time


def scene_picture(
    path: str | Path,
    meshes_in_world: Sequence[Mesh],
    colours: Sequence[tuple[float, float, float]],
    *,
    eye: ArrayLike,
    target: ArrayLike,
    field_of_view: float = np.radians(30.0),
    size_px: tuple[int, int] = (1200, 900),
) -> None:
    """Draw meshes (world frame, m, z up) over a floor at z = 0, seen from `eye` towards `target`, and write PNG.

    `colours` holds red, green, blue (0 … 1) per mesh; `field_of_view` is the vertical opening, rad.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    floor = _floor()
    meshes = [*meshes_in_world, floor]
    tracer = Tracer(meshes)
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    sun = _sun(target - eye)
    normals = np.concatenate([mesh.normals for mesh in meshes])
    paint = np.repeat(np.array([*colours, _FLOOR]), [len(mesh.faces) for mesh in meshes], axis=0)
    rays = _rays(eye, target, field_of_view, size_px)
    width, height = size_px
    image = np.empty((height, width, 3))
    for top in range(0, height, _BAND):
        band = rays[top * _SAMPLES : (top + _BAND) * _SAMPLES]
        light = _shade(_Lit(tracer, normals, paint, sun), eye, band.reshape(-1, 3))
        rows = len(band) // _SAMPLES
        image[top : top + rows] = light.reshape(rows, _SAMPLES, width, _SAMPLES, 3).mean((1, 3))
    with atomic_write(path) as temporary:
        imsave(temporary, np.clip(image, 0.0, 1.0) ** 0.9)


@dataclass(frozen=True)
class _Lit:
    """What there is to see: the tracer with normal (k, 3) and colour (k, 3) of its triangles, and where the sun is."""

    tracer: Tracer
    normals: Array
    paint: Array
    sun: Array


def _sun(view: Array) -> Array:
    """Unit vector to the sun: over the viewer's left shoulder."""
    back = -view[:2] / np.linalg.norm(view[:2])
    turn = np.radians(-40.0)
    side = np.array([np.cos(turn) * back[0] - np.sin(turn) * back[1], np.sin(turn) * back[0] + np.cos(turn) * back[1]])
    return np.array([*(side * np.cos(np.radians(52.0))), np.sin(np.radians(52.0))])


def _rays(eye: Array, target: Array, field_of_view: float, size_px: tuple[int, int]) -> Array:
    """Unit directions (H s, W s, 3) of s × s samples per pixel."""
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    width, height = size_px
    scale = 2.0 * np.tan(field_of_view / 2) / height
    x = scale * ((np.arange(width * _SAMPLES) + 0.5) / _SAMPLES - width / 2)
    y = scale * (height / 2 - (np.arange(height * _SAMPLES) + 0.5) / _SAMPLES)
    direction = ahead + x[None, :, None] * right + y[:, None, None] * up
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def _shade(lit: _Lit, eye: Array, direction: Array) -> Array:
    """Colours (n, 3): sky where nothing is hit, else sun with shadows, light from the sky and a little from the eye."""
    triangle, distance = lit.tracer.first_hit(np.broadcast_to(eye, direction.shape), direction)
    hit = np.flatnonzero(triangle >= 0)
    colour = np.tile(np.array(_SKY), (len(direction), 1))
    if not len(hit):
        return colour
    normal = lit.normals[triangle[hit]]
    towards_eye = -np.einsum("ni,ni->n", normal, direction[hit])
    normal = np.where(towards_eye[:, None] < 0, -normal, normal)
    place = eye + distance[hit][:, None] * direction[hit] + _LIFT * normal
    sun = np.clip(normal @ lit.sun, 0.0, 1.0) * ~lit.tracer.blocked(place, place + _FAR * lit.sun)
    light = 0.24 + 0.16 * normal[:, 2] + 0.2 * np.abs(towards_eye) + 0.5 * sun
    # Distance dissolves the floor into the sky, so that it needs no edge.
    haze = np.clip((distance[hit] - 2.0) / 4.0, 0.0, 1.0)[:, None]
    colour[hit] = (1 - haze) * lit.paint[triangle[hit]] * light[:, None] + haze * np.array(_SKY)
    return colour


def _floor() -> Mesh:
    corners = np.array([[-8.0, -8.0, 0.0], [8.0, -8.0, 0.0], [8.0, 8.0, 0.0], [-8.0, 8.0, 0.0]])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "floor")
