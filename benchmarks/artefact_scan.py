"""Synthetic scans of an artefact: two balls on stems on a plate, which are not quite what they should be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.track import Array
from scancell.geometry.fits import fit_plane, fit_sphere

# Nominal artefact, mm: the plate's top is z = 0.
CENTRES = np.array([[-40.0, 0.0, 30.0], [40.0, 0.0, 30.0]])
RADIUS, STEM_RADIUS, PLATE = 12.5, 4.0, (120.0, 60.0)
NOISE, ROBOT = 0.008, 0.005  # mm: of a point at normal incidence; of the position of a profile in each coordinate
OUTLIERS = 0.005  # share of the points
_OUTLIER = 2.0  # mm, largest
_VIEWS_DEG = (-40.0, 0.0, 40.0)
_PITCH, _SPACING = 1.0, 0.4  # mm, between profiles and points
_LEAST_COSINE = np.cos(np.radians(66.0))
PLATE_FACE = 2  # surfaces: the balls 0 and 1, the plate, stems


@dataclass(frozen=True)
class Built:
    """The artefact as built, mm."""

    radius: Array  # (2,)
    spacing: float  # added to the nominal one
    form: Array  # (3,), amplitude of balls and plate


@dataclass(frozen=True)
class Scan:
    """Points (n, 3) on the true surfaces, mm; their surface, profile and view (unit vector to the sensor), cosine."""

    points: Array
    surface: Array
    profile: Array
    towards: Array
    cosine: Array


def draw(rng: np.random.Generator) -> Built:
    """Sizes within 20 µm, spacing within 30 µm, amplitudes of form of 2 to 15 µm."""
    return Built(RADIUS + rng.uniform(-0.01, 0.01, 2), rng.uniform(-0.03, 0.03), rng.uniform(0.002, 0.015, 3))


def trace(built: Built) -> Scan:
    """The nearest points along parallel rays of profiles from three sides, below 66° of incidence."""
    parts, profiles = [], 0
    centres = CENTRES + np.outer([-0.5, 0.5], [built.spacing, 0.0, 0.0])
    for view in np.radians(_VIEWS_DEG):
        ray = np.array([0.0, np.sin(view), -np.cos(view)])
        x, s = np.meshgrid(np.arange(-60.0, 60.0, _PITCH), np.arange(-60.0, 60.0, _SPACING), indexing="ij")
        along = np.array([0.0, np.cos(view), np.sin(view)])
        origin = np.column_stack([x.ravel(), np.zeros((x.size, 2))]) + s.reshape(-1, 1) * along - 100.0 * ray
        hits = [_sphere(origin, ray, *ball) for ball in zip(centres, built.radius, strict=True)]
        hits += [_plate(origin, ray), *(_stem(origin, ray, centre) for centre in centres)]
        depth = np.stack(hits)
        surface = depth.argmin(0)
        seen = np.isfinite(depth.min(0))
        points = origin + np.where(seen, depth.min(0), 0.0)[:, None] * ray
        normal, height = _surface(points, surface, centres, built.form)
        cosine = -(normal @ ray)
        kept = seen & (cosine > _LEAST_COSINE)
        profile = profiles + np.repeat(np.arange(len(x)), x.shape[1])
        profiles += len(x)
        towards = np.broadcast_to(-ray, points.shape)
        parts.append([v[kept] for v in (points + height[:, None] * normal, surface, profile, towards, cosine)])
    return Scan(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _sphere(origin: Array, ray: Array, centre: Array, radius: float) -> Array:
    """Distances (n,) along the ray, infinite where it misses."""
    b = (origin - centre) @ ray
    square = b**2 - ((origin - centre) ** 2).sum(1) + radius**2
    return np.asarray(np.where(square > 0, -b - np.sqrt(np.maximum(square, 0.0)), np.inf))


def _plate(origin: Array, ray: Array) -> Array:
    depth = -origin[:, 2] / ray[2]
    x, y = (origin + depth[:, None] * ray)[:, :2].T
    return np.asarray(np.where((np.abs(x) < PLATE[0] / 2) & (np.abs(y) < PLATE[1] / 2), depth, np.inf))


def _stem(origin: Array, ray: Array, centre: Array) -> Array:
    away, flat = (origin - centre)[:, :2], ray[:2]
    a, b = flat @ flat, away @ flat
    square = b**2 - a * ((away**2).sum(1) - STEM_RADIUS**2)
    depth = (-b - np.sqrt(np.maximum(square, 0.0))) / a if a > 0 else np.full(len(b), np.inf)
    z = origin[:, 2] + np.where(np.isfinite(depth), depth, 0.0) * ray[2]
    return np.asarray(np.where((square > 0) & (z > 0) & (z < centre[2]), depth, np.inf))


def _surface(points: Array, surface: Array, centres: Array, form: Array) -> tuple[Array, Array]:
    """Normals (n, 3), and heights (n,) of the form deviation: two waves around a ball, a twist of the plate."""
    normal, height = np.tile([0.0, 0.0, 1.0], (len(points), 1)), np.zeros(len(points))
    for ball, centre in enumerate(centres):
        on = surface == ball
        normal[on] = (points[on] - centre) / np.linalg.norm(points[on] - centre, axis=1, keepdims=True)
        x, y, _ = normal[on].T
        height[on] = form[ball] * (x**2 - y**2)
        stem = surface == 3 + ball
        normal[stem] = (points[stem] - centre) * [1, 1, 0] / STEM_RADIUS
    plate = surface == PLATE_FACE
    height[plate] = form[PLATE_FACE] * np.prod(points[plate, :2] / (np.array(PLATE) / 2), axis=1)
    return normal, height


def measured(scan: Scan, rng: np.random.Generator) -> Array:
    """Points (n, 3), mm, with noise along the view, errors of the robot, outliers, and the artefact displaced."""
    count = len(scan.points)
    away = NOISE / scan.cosine * rng.normal(size=count)
    wrong = rng.random(count) < OUTLIERS
    away[wrong] += rng.uniform(-_OUTLIER, _OUTLIER, wrong.sum())
    points = scan.points + away[:, None] * scan.towards
    points += (ROBOT * rng.normal(size=(int(scan.profile.max()) + 1, 3)))[scan.profile.astype(int)]
    turn = Rotation.from_rotvec(np.radians(rng.uniform(-0.2, 0.2, 3)))
    return np.asarray(turn.apply(points) + rng.uniform(-0.3, 0.3, 3))


def truth(scan: Scan) -> Array:
    """Deviations of size of the balls and of their spacing, and forms of balls and plate, µm.

    Of the least-squares elements of the points without noise.
    """
    balls = [fit_sphere(1e-3 * scan.points[scan.surface == ball]) for ball in range(2)]
    plate = fit_plane(1e-3 * scan.points[scan.surface == PLATE_FACE])
    spacing = np.linalg.norm(balls[1].centre - balls[0].centre) - 1e-3 * np.linalg.norm(CENTRES[1] - CENTRES[0])
    sizes = [2 * (ball.radius - 1e-3 * RADIUS) for ball in balls]
    return 1e6 * np.array([*sizes, spacing, *(one.form for one in (*balls, plate))])
