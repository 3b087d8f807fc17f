"""Division of plane polygons into triangles by ear clipping, and refusal of polygons that bound no surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array, Indices

Mask = NDArray[np.bool_]

ROUNDING = 1e-6  # of the largest coordinate: a few last digits of single precision
MOST_WARPED = 0.01  # of the size of a polygon: distance of its corners from their plane
_WORTH_A_REMARK = 1e-5  # of the size of the mesh: the same, where the surface is uncertain by as much
_BLOCK = 1 << 17  # corners that are worked on at a time
_CLOSE = 1e-9  # of the size of a polygon: clearance of other corners from a good ear


def triangulated(
    vertices: NDArray[np.floating[Any]], corners: Indices, counts: Indices
) -> tuple[Indices, tuple[str, ...]]:
    """Triangles (m, 3) of polygons in the order of the polygons, and remarks.

    Parameters
    ----------
    vertices
        (n, 3) positions.
    corners
        Numbers of the vertices of all polygons, one polygon after another.
    counts
        (k,) number of corners of each polygon.

    Raises
    ------
    ValueError
        If a polygon has fewer than three corners or vertices that do not exist, is not simple, or not plane: a corner
        lies farther from the plane of the polygon than 0.01 of its size. Polygons that touch themselves, as those that
        reach a hole through a bridge, are simple here. Corners that differ by 1e-6 of the largest coordinate, the
        rounding of single precision, count as equal.
    """
    if (counts == 3).all():
        return corners.reshape(-1, 3), ()
    if (counts < 3).any():
        face = int(np.argmax(counts < 3))
        raise ValueError(f"face {face} has {counts[face]} corners; expected 3 or more")
    number = np.repeat(np.arange(len(counts)), counts)  # polygon of each corner
    wrong = (corners < 0) | (corners >= len(vertices))
    if wrong.any():
        face = int(number[np.argmax(wrong)])
        used = corners[number == face].tolist()
        raise ValueError(f"face {face} uses vertex {used}, but the vertices are 0 to {len(vertices) - 1}")
    if not np.isfinite(vertices[corners]).all():
        raise ValueError("NaN or infinite vertices")

    before = np.arange(-1, len(corners) - 1)
    before[np.cumsum(counts) - counts] = np.cumsum(counts) - 1
    repeats = (vertices[corners] == vertices[corners[before]]).all(1) & (counts[number] > 3)
    corners, number = corners[~repeats], number[~repeats]
    counts = np.bincount(number, minlength=len(counts))
    first = np.cumsum(counts) - counts
    made = np.maximum(counts - 2, 0)
    place = np.cumsum(made) - made
    triangles = np.empty((made.sum(), 3), np.int64)
    rounding = ROUNDING * float(np.abs(vertices[corners]).max(initial=0.0))
    warp = np.zeros(len(counts))
    for size in np.unique(counts[made > 0]).tolist():
        alike, step = np.flatnonzero(counts == size), max(1, _BLOCK // size)
        for polygons in (alike[start : start + step] for start in range(0, len(alike), step)):
            ring = corners[first[polygons][:, None] + np.arange(size)]
            local, warp[polygons], fault = _divided(vertices[ring].astype(float), rounding)
            if fault.any():
                face, size_of = int(polygons[np.argmax(fault)]), int(counts[polygons[np.argmax(fault)]])
                reason = "plane" if fault[np.argmax(fault)] == _WARPED else "simple: its edges intersect"
                raise ValueError(
                    f"face {face}, a polygon of {size_of} corners, is not {reason}; divide it into triangles first"
                )
            rows = place[polygons][:, None] + np.arange(size - 2)
            triangles[rows] = np.take_along_axis(ring[:, None], local, axis=2)
    largest = float(np.ptp(vertices[corners], axis=0).max(initial=0.0))
    warped = warp > _WORTH_A_REMARK * largest
    if not warped.any():
        return triangles, ()
    return triangles, (
        f"{warped.sum()} of {len(counts)} faces are not plane (up to {warp.max():.2g} in the unit of the file): "
        "the surface is uncertain by as much",
    )


_WARPED, _CROSSED = 1, 2


def _divided(points: Array, rounding: float) -> tuple[Indices, Array, NDArray[np.int64]]:
    """Triangles (k, n - 2, 3) of polygons (k, n, 3), distances (k,) of corners from the plane, and faults (k,)."""
    count, corners, _ = points.shape
    fan = np.stack(np.broadcast_arrays(0, np.arange(1, corners - 1), np.arange(2, corners)), axis=1)
    triangles = np.tile(fan.astype(np.int64), (count, 1, 1))
    fault = np.zeros(count, np.int64)
    warp = np.zeros(count)
    if corners == 3:
        return triangles, warp, fault
    points = points - points[:, :1]
    points -= points.mean(1, keepdims=True)
    size = np.ptp(points, axis=1).max(1)
    points /= size[:, None, None]  # positive: repeated corners were removed
    slack = np.maximum(rounding / size, 1e-12)
    following = np.roll(points, -1, axis=1)
    normal = np.cross(points, following).sum(1)
    doubled_area = np.linalg.norm(normal, axis=1)
    normal /= np.where(doubled_area > 0, doubled_area, 1.0)[:, None]
    across = np.take_along_axis(points, np.abs(points).max(2).argmax(1)[:, None, None], axis=1)[:, 0]
    across -= np.einsum("ki,ki->k", across, normal)[:, None] * normal
    across /= np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
    axes = np.stack([across, np.cross(normal, across)], axis=2)
    height = np.abs(np.einsum("kni,ki->kn", points, normal)).max(1)
    plane = np.einsum("kni,kij->knj", points, axes)

    # A line, or a strip as thin as the rounding of its corners: any triangles will do.
    strip = np.linalg.norm(np.cross(points, across[:, None]), axis=2).max(1) <= 2 * slack
    fault[~strip & (height > MOST_WARPED + slack)] = _WARPED
    fault[~strip & (doubled_area <= slack)] = _CROSSED  # parts of both senses
    edges = np.roll(plane, -1, axis=1) - plane
    turn = np.arctan2(_cross(edges, np.roll(edges, -1, axis=1)), (edges * np.roll(edges, -1, axis=1)).sum(2))
    convex = (turn > 1e-6).all(1) & (np.abs(turn.sum(1) - 2 * np.pi) < 1e-3)
    rest = np.flatnonzero(~strip & ~convex & (fault == 0))
    if len(rest):
        triangles[rest], clipped = _clip_ears(plane[rest], slack[rest])
        fault[rest[~clipped]] = _CROSSED
        if corners > 4:  # two triangles of the same sense at a common edge do not overlap
            for k in rest[clipped]:
                if _overlap(plane[k][triangles[k]], float(2 * slack[k])):
                    fault[k] = _CROSSED
    warp[~strip] = (height * size)[~strip]
    return triangles, warp, fault


def _clip_ears(plane: Array, slack: Array) -> tuple[Indices, Mask]:
    """Triangles (k, n - 2, 3) of anticlockwise polygons (k, n, 2), and whether each polygon could be divided.

    An ear is a triangle of three consecutive corners that holds no other corner; the roundest one is cut off. Without
    ears that are clear of all corners, one that others touch will do, or one without an area.
    """
    count, corners, _ = plane.shape
    every = np.arange(count)
    ring = np.tile(np.arange(corners), (count, 1))
    at = plane
    scores = np.stack([_ear(at, np.full(count, k), slack) for k in range(corners)], axis=1)
    possible = np.ones(count, bool)
    triangles = np.empty((count, corners - 2, 3), np.int64)
    for step in range(corners - 3):
        length = corners - step
        stuck = np.flatnonzero(scores.max(1) < 1)  # scores of corners that are not neighbours of a cut may be old
        if len(stuck):
            again = [_ear(at[stuck], np.full(len(stuck), k), slack[stuck]) for k in range(length)]
            scores[stuck] = np.stack(again, axis=1)
        tip = scores.argmax(1)
        possible &= scores[every, tip] >= 0
        triangles[:, step] = ring[every[:, None], (tip[:, None] + [-1, 0, 1]) % length]
        keep = np.arange(length) != tip[:, None]
        ring, scores = ring[keep].reshape(count, -1), scores[keep].reshape(count, -1)
        at = at[keep].reshape(count, -1, 2)
        for neighbour in (tip - 1) % (length - 1), tip % (length - 1):
            scores[every, neighbour] = _ear(at, neighbour, slack)
    triangles[:, -1] = ring
    possible &= _cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]) >= -2 * slack
    return triangles, possible


def _ear(at: Array, tip: Indices, slack: Array) -> Array:
    """Score (k,) of the ears at the corners `tip` (k,) of polygons (k, m, 2): negative if they are none.

    1 to 2: clear of other corners, by roundness; 0 to 1: other corners touch it, or it has no area.
    """
    length = at.shape[1]
    a, b, c = (at[np.arange(len(at)), (tip + k) % length] for k in (-1, 0, 1))
    inside = np.full(at.shape[:2], np.inf)
    other = np.ones(at.shape[:2], bool)
    longest = np.zeros(len(at))
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        span = np.sqrt((side**2).sum(1))
        longest = np.maximum(longest, span)
        offset = at - start[:, None]
        np.minimum(inside, _cross(side[:, None], offset) / np.maximum(span, 1e-300)[:, None], out=inside)
        other &= (offset**2).sum(2) > slack[:, None] ** 2
    inside = np.where(other, inside, -np.inf).max(1)
    area = _cross(b - a, c - a)
    height = area / np.maximum(longest, 1e-300)
    roundness = height / np.maximum(longest, 1e-300)
    clear = (height > slack) & (inside < -_CLOSE)
    touched = (height >= -slack) & (inside <= slack)
    return np.where(clear, 1 + roundness, np.where(touched, np.clip(roundness, 0, 1), -1.0))


def _overlap(triangles: Array, slack: float) -> bool:
    """Whether two of the anticlockwise triangles (t, 3, 2) overlap by more than `slack`."""
    side = np.roll(triangles, -1, axis=1) - triangles
    span = np.linalg.norm(side, axis=2)
    side = side / np.where(span > 0, span, 1.0)[..., None]
    step = max(1, (1 << 18) // len(triangles))
    blocks = []
    for start in range(0, len(triangles), step):
        part = slice(start, start + step)
        offset = triangles[None, :, None] - triangles[part][:, None, :, None]  # (p, t, side, corner, 2)
        beyond = (_cross(side[part][:, None, :, None], offset) <= slack).all(3) & (span[part] > slack)[:, None]
        blocks.append(beyond.any(2))
    apart = np.concatenate(blocks)
    apart |= apart.T
    area = _cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    thin = area <= slack * span.max(1)
    apart |= thin | thin[:, None]
    np.fill_diagonal(apart, True)
    return not apart.all()


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
