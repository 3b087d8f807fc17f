"""Surface normals from the order in which a scanner measures: along the profile, and from profile to profile.

Three ways in turn, until one gives a direction that light could have come from: the grid of profiles and columns; the
plane through the nearest points; and, where no other profile is near, the profile alone. A profile does not tell how
the surface leans against the laser's sheet; it is then taken to be square to it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_REACH = 6  # columns to either side that the direction along the profile is taken from
_GAP = 4.0  # neighbours farther apart than this many typical distances belong to different surfaces
_FAR = 10e-3  # m: profiles farther apart say nothing of the slope between them
_LEAST_SINE = 0.2  # of the angle between the two directions, below which they span no surface
_BLOCK = 400  # frames worked on at a time, which bounds the memory
_LEAST_SPREAD = 1e-2  # of the smaller to the larger variance of neighbours in their plane: less is a line
_LEAST_COSINE = 0.02  # to the light: a plane that stands within a degree of edge-on is rather the laser's sheet
_NEIGHBOURS = 12  # for points without an ordered neighbourhood


def estimate_normals(
    points: Array, frame: Index, camera: NDArray[np.int32], column: Index, sensor_in_part: Array
) -> Array:
    """Unit normals (m, 3) of the surface at points (m, 3), towards the sensor; NaN for one alone or edge-on.

    Parameters
    ----------
    frame, camera, column
        (m,) where each point was seen; the points of one camera form a grid of frames and columns.
    sensor_in_part
        (n, 3) where the light came from in each frame, m.
    """
    to_light = sensor_in_part[frame] - points
    to_light /= np.linalg.norm(to_light, axis=1, keepdims=True)
    normals, along = np.full_like(points, np.nan), np.full_like(points, np.nan)
    for one_camera in np.unique(camera):
        of_camera = camera == one_camera
        for start in range(0, len(sensor_in_part), _BLOCK):
            wanted = (frame >= start) & (frame < start + _BLOCK)
            rows = np.flatnonzero(of_camera & (frame >= start - 1) & (frame <= start + _BLOCK))
            if len(rows):
                found = _grid_normals(points[rows], frame[rows], column[rows])
                for result, values in zip((normals, along), found, strict=True):
                    result[rows[wanted[rows]]] = values[wanted[rows]]
    lonely = np.flatnonzero(~_lit(normals, to_light))
    if len(lonely) and len(points) >= 3:
        normals[lonely] = _plane_normals(points, lonely, to_light[lonely])
    alone = lonely[~_lit(normals[lonely], to_light[lonely])]
    normals[alone] = _square_to(along[alone], to_light[alone])
    outward = np.einsum("mi,mi->m", normals, to_light) >= 0
    return np.asarray(np.where(outward[:, None], normals, -normals))


def _lit(normals: Array, to_light: Array) -> NDArray[np.bool_]:
    """Whether light from there (m, 3) falls on surfaces with normals (m, 3) of either sign; it does not on NaN."""
    return np.asarray(np.abs(np.einsum("mi,mi->m", normals, to_light)) > _LEAST_COSINE)


def _square_to(along: Array, to_light: Array) -> Array:
    """Unit vectors (m, 3) square to directions (m, 3) and as near as can be to the light's (m, 3); NaN: none is."""
    share = np.einsum("mi,mi->m", along, to_light) / np.einsum("mi,mi->m", along, along)
    normal = to_light - share[:, None] * along
    length = np.linalg.norm(normal, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where((length > _LEAST_COSINE)[:, None], normal / length[:, None], np.nan))


def _grid_normals(points: Array, frame: Index, column: Index) -> tuple[Array, Array]:
    """Normals (m, 3) of points that one camera saw, NaN where a direction is missing, and directions of the profile."""
    first = column.min() - _REACH
    grid = np.full((int(np.ptp(frame)) + 3, int(np.ptp(column)) + 1 + 2 * _REACH, 3), np.nan)
    where = (frame - frame.min() + 1, column - first)
    grid[where] = points
    along = _direction(np.swapaxes(grid, 0, 1), _REACH).swapaxes(0, 1)[where]
    across = _direction(grid, 1)[where]
    normal = np.cross(along, across)
    length = np.linalg.norm(normal, axis=1)
    spread = np.linalg.norm(along, axis=1) * np.linalg.norm(across, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where((length > _LEAST_SINE * spread)[:, None], normal / length[:, None], np.nan), along


def _direction(grid: Array, reach: int) -> Array:
    """Direction of the first axis of a grid (a, b, 3) at each point, from up to `reach` neighbours on either side.

    The weighted sum of differences to neighbours that unbroken chains of short steps lead to (weights as in the
    slope of a straight-line fit); zero sum of weights gives NaN. A point at the end of a chain uses its one side.
    """
    step = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    known = step[np.isfinite(step)]
    if not len(known):
        return np.full_like(grid, np.nan)
    joined = step < min(_GAP * np.median(known), _FAR)
    total = np.zeros_like(grid)
    weight = np.zeros(grid.shape[:2])
    for sign in (1, -1):
        chain = np.ones(grid.shape[:2], bool)
        for k in range(1, reach + 1):
            chain = chain & _link(joined, k, sign, grid.shape[:2])
            difference = np.where(chain[..., None], sign * (np.roll(grid, -sign * k, axis=0) - grid), 0.0)
            total += k * difference
            weight += k * chain
    return np.where(weight[..., None] > 0, total, np.nan)


def _link(joined: NDArray[np.bool_], k: int, sign: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether the k-th step from each point, forwards or backwards, is a short one between two points."""
    link = np.zeros(shape, bool)
    if sign > 0:
        link[: shape[0] - k] = joined[k - 1 :]
    else:
        link[k:] = joined[: shape[0] - k]
    return link


def _plane_normals(points: Array, chosen: Index, to_light: Array) -> Array:
    """Normals of the planes that fit the nearest neighbours of `chosen` points best; `to_light` (k, 3) from these.

    A profile is far denser than the profiles are near to each other, so that the nearest neighbours may all lie on one
    line, or on a curve in the laser's sheet. Then every fourth, sixteenth, … point is asked instead, until neighbours
    span a surface that the light falls on. Points that are `_FAR` away have no say.
    """
    normals = np.full((len(chosen), 3), np.nan)
    todo = np.arange(len(chosen))
    for stride in (1, 4, 16, 64):
        some = points[::stride]
        if len(some) < 3 or not len(todo):
            break
        distance, near = cKDTree(some).query(points[chosen[todo]], k=min(_NEIGHBOURS, len(some)), workers=-1)
        offset = some[near] - some[near].mean(axis=1, keepdims=True)
        values, vectors = np.linalg.eigh(np.einsum("mki,mkj->mij", offset, offset))
        found = (values[:, 1] > _LEAST_SPREAD * values[:, 2]) & (distance[:, -1] < _FAR)
        normals[todo[found]] = vectors[found, :, 0]
        todo = todo[~(found & _lit(vectors[:, :, 0], to_light[todo]))]
    return normals
