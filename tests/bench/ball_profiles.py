"""Recorded profiles of a ball (docs/reality.md): reading, circles, repeats of a pose."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.solve import circle_in

Array = NDArray[np.float64]

BALL_RADIUS = 19.05e-3
_NEAR = 40e-6  # m, of points of the ball in the first fit of its circle
_LEAST_POINTS = 30
_LEAST_REPEATS = 3
_MOST_LAG = 50


@dataclass(frozen=True)
class Profile:
    """A recorded profile: points (n, 2), x and z, m, whether they are labelled as those of the ball (n,).

    `pose` is the folder and the name that repeats of a pose share; None: it was taken once.
    """

    pose: tuple[str, str] | None
    points: Array
    is_ball: NDArray[np.bool_]


def read_profiles(data: Path) -> Iterator[Profile]:
    """The profiles of the set, files of x and z, mm, and label."""
    for file in sorted(data.rglob("*.csv")):
        table = np.loadtxt(file, delimiter=",", ndmin=2)
        match = re.fullmatch(r"(.*)_\d+", file.stem)
        pose = (file.parent.name, match[1]) if match else None
        yield Profile(pose, 1e-3 * table[:, :2], table[:, 2] == 1)


@dataclass(frozen=True)
class FoundBall:
    """A profile and its circle."""

    profile: Profile
    circle: Circle


def repeated_poses(found: Sequence[FoundBall]) -> list[list[FoundBall]]:
    """Repeats of one pose of the ball, three or more each; some recordings of several poses share a name."""
    groups: dict[tuple[str, str], list[FoundBall]] = defaultdict(list)
    for one in found:
        if one.profile.pose is not None:
            groups[one.profile.pose].append(one)
    return [group for group in groups.values() if len(group) >= _LEAST_REPEATS and _is_same(group)]


@dataclass(frozen=True)
class Circle:
    """Circle of a profile of the ball: centre and radius (3,), m, their covariance (3, 3), and its n points.

    `distance` is the standard deviation of the points from the circle, `noise` that from point to point, m; the errors
    of `lag` points count as one.
    """

    values: Array
    covariance: Array
    distance: float
    noise: float
    points: int
    lag: float


def circle_of(profile: Array) -> Circle | None:
    """The circle of a ball in a profile (n, 2), m, without labels; None without one.

    Neighbouring points share errors: the covariance is that of independent ones times the sum of the autocorrelation.
    """
    found = circle_in(profile, 10e-6, 1.01 * BALL_RADIUS, np.random.default_rng(0))
    if found is None:
        return None
    values = np.array([*found[0], found[1]])
    kept = np.zeros(len(profile), bool)
    for limit in (3 * _NEAR, _NEAR, _NEAR):
        for _ in range(5):
            away = profile - values[:2]
            length = np.linalg.norm(away, axis=1)
            rest = length - values[2]
            kept = np.abs(rest) < limit
            if kept.sum() < _LEAST_POINTS:
                return None
            design = np.column_stack([away / length[:, None], np.ones(len(away))])[kept]
            values = values + np.linalg.lstsq(design, rest[kept], rcond=None)[0]
    rest = rest[kept]
    distance = float(np.sqrt(rest @ rest / (len(rest) - 3)))
    noise = float(np.std(np.diff(rest)) / np.sqrt(2))
    lag = 1.0
    for k in range(1, min(_MOST_LAG, len(rest) // 4)):
        correlation = float(np.mean(rest[k:] * rest[:-k])) / float(np.mean(rest**2))
        if correlation < 0:
            break
        lag += 2 * correlation
    covariance = distance**2 * lag * np.linalg.inv(design.T @ design)
    return Circle(values, covariance, distance, noise, int(kept.sum()), lag)


def write_ball_artefact(folder: Path, radius: float) -> Path:
    """The artefact of a ball, m, as a file."""
    file = folder / "ball.toml"
    file.write_text(f'name = "ball"\n[[shape]]\nname = "ball"\nkind = "sphere"\ndiameter_mm = {2e3 * radius}\n')
    return file


def _is_same(group: Sequence[FoundBall]) -> bool:
    """Whether repeats show the ball at one pose."""
    values = np.array([one.circle.values for one in group])
    return bool(np.abs(values - np.median(values, axis=0)).max() < 0.2e-3)
