"""Normals of scanned clouds against a simple reference implementation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scancell.sensor import estimate_normals

Array = NDArray[np.float64]
Inputs = tuple[Array, NDArray[np.int64], NDArray[np.int32], NDArray[np.int64], Array]

GRAZING = 0.02  # cosine to the light
FAR = 10e-3


def reference(
    points: Array, frame: Array, camera: Array, column: Array, light: Array
) -> tuple[Array, NDArray[np.int_]]:
    """Normals (m, 3) and the method used (m,), point by point with exhaustive search of neighbours."""
    at = {key: i for i, key in enumerate(zip(camera, frame, column, strict=True))}
    own = [at[key] for key in zip(camera, frame, column, strict=True)]

    def step(i: int, frames: int, columns: int) -> Array | None:
        j = at.get((camera[i], frame[i] + frames, column[i] + columns))
        return None if j is None else points[j] - points[own[i]]

    def longest(k: int, block: int, frames: int, columns: int) -> float:
        inside = [i for i in at.values() if camera[i] == k and 400 * block - 1 <= frame[i] <= 400 * (block + 1)]
        steps = [
            s for i in inside if frame[i] + frames <= 400 * (block + 1) and (s := step(i, frames, columns)) is not None
        ]
        return min(4 * float(np.median(np.linalg.norm(steps, axis=1))), FAR) if steps else 0.0

    limits = {
        (k, block, *axis): longest(k, block, *axis)
        for k in np.unique(camera)
        for block in np.unique(frame // 400)
        for axis in ((0, 1), (1, 0))
    }

    def direction(i: int, axis: tuple[int, int], reach: int) -> Array:
        total, weight = np.zeros(3), 0
        for sign in (1, -1):
            before = np.zeros(3)
            for k in range(1, reach + 1):
                to = step(i, sign * k * axis[0], sign * k * axis[1])
                if to is None or np.linalg.norm(to - before) >= limits[camera[i], frame[i] // 400, *axis]:
                    break
                total, weight, before = total + sign * k * to, weight + k, to
        return total if weight else np.full(3, np.nan)

    def plane(i: int, to_light: Array) -> Array | None:
        for stride in (1, 4, 16, 64):
            some = points[::stride]
            distance = np.linalg.norm(some - points[i], axis=1)
            near = np.argsort(distance, kind="stable")[:12]
            if len(some) < 3 or distance[near].max() >= FAR:
                continue
            _, spread, axes = np.linalg.svd(some[near] - some[near].mean(0))
            if len(spread) == 3 and spread[1] ** 2 > 0.01 * spread[0] ** 2 and abs(axes[2] @ to_light) > GRAZING:
                return np.asarray(axes[2])
        return None

    normals, method = np.full_like(points, np.nan), np.zeros(len(points), int)
    for i in range(len(points)):
        to_light = light[frame[i]] - points[i]
        to_light /= np.linalg.norm(to_light)
        along, across = direction(i, (0, 1), 6), direction(i, (1, 0), 1)
        found = np.cross(along, across)
        size = np.linalg.norm(found)
        usable = size > 0.2 * np.linalg.norm(along) * np.linalg.norm(across)
        if not (usable and abs(found @ to_light) > GRAZING * size):
            method[i] = 1
            fitted = plane(i, to_light)
            if fitted is None:
                method[i] = 2
                fitted = to_light - along * (along @ to_light) / (along @ along)
                fitted = fitted if np.linalg.norm(fitted) > GRAZING else np.full(3, np.nan)
            found = fitted
        normals[i] = np.sign(found @ to_light) * found / np.linalg.norm(found)
    return normals, method


def wavy_scan(seed: int, frames: int, columns: int, frame_step: float, column_step: float) -> Inputs:
    """A wavy surface with a step seen by two cameras, the second with descending columns; points are missing."""
    rng = np.random.default_rng(seed)
    frame, camera, column = (
        v.ravel() for v in np.meshgrid(np.arange(frames), [0, 1], np.arange(columns), indexing="ij")
    )
    column = np.where(camera == 1, columns - column, column)
    # Gaps of various lengths, missing frames and missing columns.
    kept = (rng.random(len(frame)) > 0.3 * rng.random(frames)[frame]) & (frame % 37 != 5) & (column % 11 != 7)
    kept &= (frame % 5 < 3) | (column > columns // 4)
    frame, camera, column = frame[kept], camera[kept], column[kept]
    travel = np.cumsum(frame_step * rng.uniform(0.5, 1.5, frames))
    x, y = travel[frame], column_step * column * (1 + 0.1 * camera)
    z = 1e-3 * np.sin(900 * x) * np.cos(700 * y) + np.where(y > 0.6 * y.max(), 4e-3, 0.0)
    # Steps around the largest that connects two points.
    z += np.where(rng.random(len(x)) < 0.1, 12 * column_step * rng.random(len(x)), rng.normal(0, 3e-6, len(x)))
    light = np.stack([travel, np.full(frames, y.mean()), np.full(frames, 0.12)], -1)
    return np.stack([x, y, z], -1), frame, camera.astype(np.int32), column, light


def angles(a: Array, b: Array) -> Array:
    assert (np.isnan(a[:, 0]) == np.isnan(b[:, 0])).all()
    known = np.isfinite(a[:, 0])
    return np.asarray(np.linalg.norm(a[known] - b[known], axis=1))


@pytest.mark.parametrize(
    ("frames", "columns", "frame_step", "column_step", "methods"),
    [
        (30, 50, 0.2e-3, 0.1e-3, {0, 1}),
        (402, 5, 0.2e-3, 0.3e-3, {0, 1}),  # two blocks of frames
        (8, 120, 4e-3, 0.05e-3, {0, 1, 2}),  # the twelve nearest points lie in one profile
        (3, 60, 30e-3, 2e-3, {2}),
    ],
)
def test_normals_match_reference(
    frames: int, columns: int, frame_step: float, column_step: float, methods: set[int]
) -> None:
    scan = wavy_scan(frames, frames, columns, frame_step, column_step)
    expected, method = reference(*scan)
    assert angles(estimate_normals(*scan), expected).max() < 1e-7
    assert set(method) == methods


@pytest.mark.parametrize("dense", [(50, 60), (60, 80), (400, 500)])
def test_normals_of_sparse_points_beside_dense_patch(dense: tuple[int, int]) -> None:
    """Points at 3 mm spacing on a curved surface, beside a patch whose density makes their search radius grow."""
    rng = np.random.default_rng(3)
    frame, column = (v.ravel() for v in np.indices(dense))
    i, j = (v.ravel() for v in np.indices((8, 8)))
    sparse = 0.02 + 3e-3 * np.stack([i, j], -1) + rng.uniform(0, 1e-3, (64, 2))
    xy = np.concatenate([20e-6 * np.stack([frame, column], -1), sparse])
    points = np.column_stack([xy, 3 * xy[:, 0] ** 2 + 5 * xy[:, 1] ** 2])
    frame, column = np.concatenate([frame, i]), np.concatenate([column, 1000 + 3 * j])
    light = np.tile([0.02, 0.02, 0.2], (max(dense), 1))
    found = estimate_normals(points, frame, np.zeros(len(points), np.int32), column, light)[-64:]
    points = points[-64:]  # the patch is farther than 10 mm
    for point, normal in zip(points, found, strict=True):
        distance = np.linalg.norm(points - point, axis=1)
        near = np.argpartition(distance, 12)[:12]
        if distance[near].max() > FAR:
            assert np.isnan(normal).all()
            continue
        plane = np.linalg.svd(points[near] - points[near].mean(0))[2][2]
        assert np.linalg.norm(normal - np.sign(plane[2]) * plane) < 1e-7
    assert np.isfinite(found[:, 0]).sum() > 50


def test_normals_are_independent_of_threads_and_order() -> None:
    scan = wavy_scan(5, 100, 80, 0.2e-3, 0.1e-3)
    one, four = (estimate_normals(*scan, threads=threads) for threads in (1, 4))
    assert np.array_equal(one, four, equal_nan=True)
    # Thinned neighbours depend on the order, the grid does not.
    shuffle = np.random.default_rng(1).permutation(len(one))
    points, frame, camera, column, light = scan
    mixed = estimate_normals(points[shuffle], frame[shuffle], camera[shuffle], column[shuffle], light)
    assert np.mean(np.abs(mixed - one[shuffle]).max(1) < 1e-12) > 0.99


def test_last_point_of_column_is_used() -> None:
    *arrays, light = wavy_scan(6, 20, 40, 0.2e-3, 0.1e-3)
    points, frame, camera, column = (np.concatenate([values[::7], values]) for values in arrays)
    points[: len(arrays[0][::7]), 2] += 1e-3
    expected, _ = reference(points, frame, camera, column, light)
    assert angles(estimate_normals(points, frame, camera, column, light), expected).max() < 1e-7


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frame": 3}, "point 2: frame 3 of 3"),
        ({"frame": -1}, "point 2: frame -1 of 3"),
        ({"points": np.nan}, "point 2 is not finite"),
        ({"points": np.inf}, "point 2 is not finite"),
        ({"points": 1e200}, "beyond 1000 km"),
    ],
)
def test_invalid_points_are_rejected(change: dict[str, float], message: str) -> None:
    given = {"points": np.zeros((4, 3)), "frame": np.arange(4) % 3, "camera": np.zeros(4, int), "column": np.arange(4)}
    for name, value in change.items():
        given[name][2] = value
    with pytest.raises(ValueError, match=message):
        estimate_normals(*given.values(), np.ones((3, 3)))


def test_empty_and_mismatched_arrays() -> None:
    none = np.zeros(0, np.int64)
    assert estimate_normals(np.zeros((0, 3)), none, none, none, np.ones((3, 3))).shape == (0, 3)
    with pytest.raises(ValueError, match="column"):
        estimate_normals(np.zeros((2, 3)), np.zeros(2, int), np.zeros(2, int), np.zeros(3, int), np.ones((3, 3)))
