"""Stripe peaks of exact shapes by root finding along image columns; independent of ray tracing."""

from __future__ import annotations

import json

import numpy as np

from scancell.calibration.sensor.problem import Corners, StripePeaks, TargetExposure
from scancell.config.sensor import sensor_json
from scancell.geometry import pose
from scancell.geometry.shapes import ShapeGroup
from scancell.sensor import Sensor, triangulate_pixels

ROW_GRID = 65  # rows at which a column is searched for a change of sign
ITERATIONS = 30  # superlinear: 10 reach the resolution of doubles on smooth surfaces


def native(description) -> Sensor:
    return Sensor(json.dumps(sensor_json(description, 0)))


def stripe_rows(sensor: Sensor, camera: int, target: ShapeGroup, sensor_from_target, columns):
    """Rows (n,) at which the sheet as described meets the surface of a target, NaN where it does not."""
    height = sensor.cameras[camera].height_px
    target_from_sensor = pose.inverse(sensor_from_target)

    def distance(rows):
        pixels = np.stack([columns, rows], 1)
        points = triangulate_pixels(pixels, sensor, camera, "sheet")
        return target.nearest(pose.transform_points(target_from_sensor, points))[0]

    grid = np.linspace(0.0, height - 1.0, ROW_GRID)
    signs = np.stack([distance(np.full(len(columns), row)) for row in grid], 1)
    # The nearest to the sensor: rows grow with range.
    crosses = (signs[:, :-1] > 0.0) & (signs[:, 1:] <= 0.0)
    first = crosses.argmax(1)
    low, high = grid[first], grid[first + 1]
    rows = np.arange(len(columns))
    f_low, f_high = signs[rows, first], signs[rows, first + 1]
    for _ in range(ITERATIONS):
        middle = np.where(np.arange(len(columns)) >= 0, (low * f_high - high * f_low) / (f_high - f_low), 0.0)
        middle = np.clip(middle, low, high)
        f_middle = distance(middle)
        above = f_middle > 0.0
        # Illinois rule: halve the value of the end that stays.
        f_high = np.where(above, f_high * 0.5, f_middle)
        f_low = np.where(above, f_middle, f_low * 0.5)
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.where(crosses.any(1), middle, np.nan)


def exact_exposure(sensor, target, sensor_from_target, sigma, step=16, mounting=None, margin=0.2e-3):
    """Exposure with exact rows of every `step`-th column; `sigma` (px) is what they will be stated to have.

    Points within `margin` of the edge of a plane are left out, as extraction does.
    """
    camera, column, row = [], [], []
    for k, one in enumerate(sensor.cameras):
        columns = np.arange(step // 2, one.width_px, step, dtype=float)
        rows = stripe_rows(sensor, k, target, sensor_from_target, columns)
        pixels = np.stack([columns, rows], 1)
        points = triangulate_pixels(np.nan_to_num(pixels), sensor, k, "sheet")
        _, normal = target.nearest(pose.transform_points(pose.inverse(sensor_from_target), points))[:2]
        in_view = np.sum((normal @ sensor_from_target[:3, :3].T) * _to_source(points), 1) > 0.5
        low, high = sensor.range
        inside = np.isfinite(rows) & in_view & (points[:, 2] > low) & (points[:, 2] < high)
        inside &= _on_face(target, pose.transform_points(pose.inverse(sensor_from_target), points), margin)
        camera.append(np.full(inside.sum(), k, np.int32))
        column.append(columns[inside])
        row.append(rows[inside])
    peaks = [np.concatenate(one) for one in (camera, column, row)]
    stripe = StripePeaks(*peaks, np.full(len(peaks[1]), sigma))
    return TargetExposure(target, np.asarray(sensor_from_target), stripe, mounting=mounting)


def noisy(exposure: TargetExposure, rng) -> TargetExposure:
    """The exposure with row noise of the stated deviation."""
    stripe = exposure.stripe
    row = stripe.row + stripe.sigma * rng.standard_normal(len(stripe.row))
    return TargetExposure(
        exposure.target,
        exposure.sensor_from_target,
        StripePeaks(stripe.camera, stripe.column, row, stripe.sigma),
        exposure.corners,
        exposure.mounting,
    )


def _to_source(points):
    return -points / np.linalg.norm(points, axis=1, keepdims=True)


def _on_face(target, points, margin):
    """Whether points lie on a sphere, or inside a plane's edges by the margin."""
    inside = np.zeros(len(points), bool)
    for placed in target.shapes:
        own = pose.transform_points(pose.inverse(placed.frame_from_shape), points)
        if not placed.shape.is_solid:
            size = np.array([placed.shape.size_x, placed.shape.size_y]) / 2 - margin
            inside |= (np.abs(own[:, :2]) < size).all(1) & (np.abs(own[:, 2]) < 1e-6)
        else:
            inside |= np.abs(placed.shape.nearest(own)[0]) < 1e-6
    return inside


def board_corners(sensor: Sensor, sensor_from_board) -> Corners:
    """Corners of a board of 9 x 7 in the images of all cameras, without noise."""
    grid = np.stack(np.meshgrid(np.linspace(-0.016, 0.016, 9), np.linspace(-0.012, 0.012, 7)), -1).reshape(-1, 2)
    points = np.column_stack([grid, np.zeros(len(grid))])
    in_sensor = pose.transform_points(sensor_from_board, points)
    pixels = [np.asarray(camera.project(in_sensor)) for camera in sensor.cameras]
    camera = np.repeat(np.arange(len(pixels), dtype=np.int32), len(points))
    return Corners(camera, np.concatenate(pixels), np.tile(points, (len(pixels), 1)), 0.05)
