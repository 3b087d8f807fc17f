"""Predicted standard deviations of the least-squares surfaces of features of a CAD part, by the views of a scan.

Each sample of a face that a view sees adds information on the motions of the face's surface, and on its size, by the
noise of points and by what the points of a profile have in common. The deviation of a feature is that of its radius, or
the largest of the place of its surface anywhere on the feature (G-optimality). Views are worth the logarithm of what
they take off it, down to the goal: information is additive, so that a view is worth less the more is known.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scancell.arrays import Array, Flags, Indices
from scancell.config.scan import FeatureGoalDescription
from scancell.geometry.cad import CadMesh, find_faces
from scancell.geometry.shapes import PartSurface
from scancell.planning.views.views import Pass, Sweep

_UNKNOWN = 1e-3  # m: deviation of a surface that nothing was measured of
_DETERMINED = 1e-4  # m, of a surface that something was measured of
_SIZED = ("cylinder", "sphere", "torus")
_OF_SHARE = 14.0  # worth of all of a face, about that of its place within 1 um
_PLACE = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])  # of the seven parameters of a surface
_BINS = 24  # of a view, by which exposures that meet a face are counted
_FREE = 1e-9  # of the goal: shortfall that does not count
_LEAST_GAIN = 0.02


@dataclass(frozen=True)
class PointNoise:
    """Noise of measured points by the sensor and the encoders.

    Attributes
    ----------
    deviation
        Standard deviation of a point, m.
    common
        That of all points of a profile, m.
    pitch
        Distance of points along the laser line, m.
    """

    deviation: float
    common: float
    pitch: float


class Goal(Protocol):
    """Goal of the choice of views, with the gain of each candidate towards it."""

    least_gain: float  # that a view must add

    def add(self, view: Sweep | Pass, seen: Flags, count: int) -> None:
        """Take the next candidate, which sees samples (n,) in `count` exposures."""

    def shortfall(self, chosen: Iterable[int]) -> float:
        """What is missing with candidates of these numbers; 0: nothing."""

    def gains(self, chosen: Iterable[int]) -> Array:
        """(c,) what each candidate takes off the shortfall."""


class SeenShare:
    """A share of all n samples."""

    def __init__(self, share: float, samples: int) -> None:
        self._seen: list[Flags] = []
        self._samples, self._goal = samples, int(np.ceil(share * samples))

    least_gain = 2.0  # samples

    def add(self, view: Sweep | Pass, seen: Flags, count: int) -> None:
        """See `Goal`."""
        self._seen.append(seen)

    def shortfall(self, chosen: Iterable[int]) -> float:
        """See `Goal`: number of samples."""
        return float(max(0, self._goal - int(self._covered(chosen).sum())))

    def gains(self, chosen: Iterable[int]) -> Array:
        """See `Goal`: number of samples; more than what is missing has no value."""
        covered = self._covered(chosen)
        added = (np.array(self._seen, bool).reshape(-1, self._samples) & ~covered).sum(1)
        return np.asarray(np.minimum(added, max(0, self._goal - int(covered.sum()))), float)

    def _covered(self, chosen: Iterable[int]) -> Flags:
        covered = np.zeros(self._samples, bool)
        for number in chosen:
            covered |= self._seen[number]
        return covered


@dataclass(frozen=True)
class FeatureOutlook:
    """Prediction for a feature.

    Attributes
    ----------
    faces, of
        As the goal names them.
    wanted, predicted
        Standard deviation of its surface, m; NaN without such a goal.
    best
        That by all views that the arm can make, m.
    seen, wanted_share
        Share of the measurable part of its faces.
    """

    faces: tuple[int | str, ...]
    of: str
    wanted: float
    predicted: float
    best: float
    seen: float
    wanted_share: float

    @property
    def limit(self) -> str:
        """What keeps the goal from being met; empty if it is."""
        faces = f"{self.of} of {' '.join(map(str, self.faces))}"
        if self.best > _DETERMINED:
            return f"{faces}: no view determines it (access)"
        if self.predicted > self.wanted * (1 + _FREE):
            told = f"{1e6 * self.predicted:.2g} um by the chosen views, {1e6 * self.best:.2g} um by all possible ones"
            return f"{faces}: {told}; {1e6 * self.wanted:.2g} um are wanted (noise)"
        if self.seen < self.wanted_share:
            return f"{faces}: {100 * self.seen:.0f} % seen; {100 * self.wanted_share:.0f} % are wanted (access)"
        return ""


class FeatureGoals:
    """Deviations of features, and shares of their faces, see the module.

    Parameters
    ----------
    part
        The CAD part.
    samples, normals
        (n, 3) samples that are judged, in the frame of the part, m, and their unit normals.
    points
        (n, 3) the samples in the frame of the table, m.
    goals
        Of each feature.
    noise
        Of points.
    """

    def __init__(
        self,
        part: CadMesh,
        samples: Array,
        normals: Array,
        points: Array,
        goals: Sequence[FeatureGoalDescription],
        noise: PointNoise,
    ) -> None:
        self._goals, self._noise, self._points = goals, noise, points
        face = part.cad_face[PartSurface(part).distances(samples)[1]]
        self._rows: list[Indices] = []
        self._derivatives: list[Array] = []
        self._areas: list[float] = []  # of a sample, m²
        for goal in goals:
            numbers = find_faces(part, goal.faces)
            rows = np.flatnonzero(np.isin(face, numbers))
            area = float(part.areas[np.isin(part.cad_face, numbers)].sum())
            self._rows.append(rows)
            self._areas.append(area / max(len(rows), 1))
            self._derivatives.append(
                _derivatives(samples[rows], normals[rows], part.cad_faces[numbers[0]].kind in _SIZED)
            )
        self._wanted = np.array([1e-6 * goal.deviation_um if goal.deviation_um else np.inf for goal in goals])
        self._share = np.array([goal.share for goal in goals])
        self._seen: list[list[Flags]] = []
        self._told: list[Array] = []

    least_gain = _LEAST_GAIN

    def add(self, view: Sweep | Pass, seen: Flags, count: int) -> None:
        """See `Goal`."""
        own = [seen[rows] for rows in self._rows]
        self._seen.append(own)
        self._told.append(np.array([self._information(k, view, flags, count) for k, flags in enumerate(own)]))

    def _information(self, number: int, view: Sweep | Pass, seen: Flags, count: int) -> Array:
        """Information (7, 7) that a view adds on a feature."""
        if not seen.any():
            return np.zeros((7, 7))
        derivatives, noise = self._derivatives[number][seen], self._noise
        profiles, spacing = _exposures(view, self._points[self._rows[number][seen]], count)
        own = noise.deviation**2 * spacing * noise.pitch / self._areas[number]
        # What a profile has in common is as often independent as profiles meet the feature.
        variance = own + noise.common**2 * len(derivatives) / profiles
        return np.asarray(derivatives.T @ derivatives / variance)

    def shortfall(self, chosen: Iterable[int]) -> float:
        """See `Goal`."""
        numbers = list(chosen)
        return float(self._missing(self._sum(numbers)[None], self._shares(numbers)[None])[0])

    def gains(self, chosen: Iterable[int]) -> Array:
        """See `Goal`."""
        numbers = list(chosen)
        told = self._sum(numbers) + np.array(self._told).reshape(-1, len(self._goals), 7, 7)
        shares = np.zeros((len(told), len(self._goals)))
        for k, covered in enumerate(self._covered(numbers)):
            if len(covered) and self._share[k] > 0:
                shares[:, k] = (np.array([own[k] for own in self._seen]) | covered).mean(1)
        return np.asarray(self.shortfall(numbers) - self._missing(told, shares))

    def outlooks(self, chosen: Iterable[int], possible: Iterable[int]) -> tuple[FeatureOutlook, ...]:
        """Predictions with chosen candidates, and with all that are possible."""
        chosen, possible = list(chosen), list(possible)
        found = np.sqrt(self._variances(np.stack([self._sum(chosen), self._sum(possible)])))
        shares = self._shares(chosen)
        return tuple(
            FeatureOutlook(
                goal.faces,
                goal.of,
                float(self._wanted[k]) if goal.deviation_um else float("nan"),
                *((float(found[0, k]), float(found[1, k])) if goal.deviation_um else (float("nan"), float("nan"))),
                float(shares[k]),
                goal.share,
            )
            for k, goal in enumerate(self._goals)
        )

    def _missing(self, told: Array, shares: Array) -> Array:
        """Shortfall (c,) with information (c, f, 7, 7) and seen shares (c, f)."""
        with np.errstate(divide="ignore"):
            deviation = np.log(self._variances(told) / self._wanted**2) / 2
        deviation = np.where(deviation < _FREE, 0.0, deviation)
        share = np.maximum(0.0, self._share - shares)
        return np.asarray((deviation + _OF_SHARE * share).sum(1))

    def _variances(self, told: Array) -> Array:
        """(c, f) largest variance of the surface on each feature, m², with information (c, f, 7, 7)."""
        found = np.zeros(told.shape[:2])
        for k, derivatives in enumerate(self._derivatives):
            if not len(derivatives):
                found[:, k] = _UNKNOWN**2
                continue
            # The place does not count the size, and conversely.
            counted = derivatives * _PLACE if self._goals[k].of == "place" else 1 - _PLACE[None]
            covariance = np.linalg.inv(told[:, k] + np.eye(7) / _UNKNOWN**2)
            found[:, k] = np.einsum("ni,cij,nj->cn", counted, covariance, counted, optimize=True).max(1)
        return found

    def _sum(self, chosen: Sequence[int]) -> Array:
        return np.asarray(np.sum([self._told[i] for i in chosen], axis=0) + np.zeros((len(self._goals), 7, 7)))

    def _covered(self, chosen: Sequence[int]) -> list[Flags]:
        return [
            np.any([self._seen[i][k] for i in chosen], axis=0) if chosen else np.zeros(len(rows), bool)
            for k, rows in enumerate(self._rows)
        ]

    def _shares(self, chosen: Sequence[int]) -> Array:
        return np.array([covered.mean() if len(covered) else 0.0 for covered in self._covered(chosen)])


def _derivatives(samples: Array, normals: Array, is_sized: bool) -> Array:
    """(k, 7) changes of distances by turns and shifts of a surface, of about equal effect, and by its size."""
    if not len(samples):
        return np.zeros((0, 7))
    local = samples - samples.mean(0)
    size = max(float(np.linalg.norm(local, axis=1).max()), 1e-9)
    grown = np.full((len(samples), 1), float(is_sized))
    return np.hstack([np.cross(local, normals) / size, normals, grown])


def _exposures(view: Sweep | Pass, points: Array, count: int) -> tuple[float, float]:
    """Number of the exposures of a view that meet points (k, 3), and their distance there, m."""
    sensor = view.crossings(points)[0][:, :3, 3]
    if isinstance(view, Sweep):
        share = np.arctan2(sensor[:, 1], sensor[:, 0]) / (2 * np.pi) % 1.0
        spacing = 2 * np.pi * float(np.hypot(points[:, 0], points[:, 1]).mean()) / count
    else:
        share = np.linalg.norm(sensor - view.start[:3, 3], axis=1) / view.length
        spacing = view.length / max(count - 1, 1)
    met = len(np.unique(np.floor(_BINS * share[np.isfinite(share)])))
    return max(1.0, met / _BINS * count), spacing
