"""Deviation of a cloud from the CAD mesh or the exact shapes of the part: distances and their statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import PartSurface
from scancell.reconstruction.cloud import Cloud
from scancell.values import Value

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DeviationFigures:
    """Statistics of `count` distances, m; signed ones are positive outside the material.

    `d95`, `d99_9` and `max_abs` are the 95 % and 99.9 % quantiles and the maximum of the absolute distance;
    `standard_deviation` is about the mean, `rms` about zero.
    """

    count: int
    mean: float
    standard_deviation: float
    rms: float
    d95: float
    d99_9: float
    max_abs: float
    maximum: float
    minimum: float

    @classmethod
    def of(cls, distance: Array) -> DeviationFigures:
        """Statistics of distances (n,), m; NaN without points."""
        if len(distance) == 0:
            return cls(0, *([float("nan")] * 8))
        mean, maximum, minimum = float(distance.mean()), float(distance.max()), float(distance.min())
        work = distance - mean
        # No BLAS: its sums depend on the number of threads.
        variance = float(np.square(work, out=work).mean())
        d95, d99_9 = _upper_quantiles(np.abs(distance, out=work), (0.95, 0.999))
        return cls(
            count=len(distance),
            mean=mean,
            standard_deviation=variance**0.5,
            rms=(variance + mean**2) ** 0.5,
            d95=d95,
            d99_9=d99_9,
            max_abs=max(maximum, -minimum),
            maximum=maximum,
            minimum=minimum,
        )

    def text(self) -> str:
        """A line of text."""
        return (
            f"  {self.count} compared, mean {1e6 * self.mean:.1f} um, RMS {1e6 * self.rms:.1f} um,"
            f" D95 % {1e6 * self.d95:.1f} um"
        )

    def as_um(self) -> dict[str, int | float | None]:
        """Figures in µm, by names with the suffix ``_um``, for JSON; None instead of NaN."""
        plain = asdict(self)
        count = plain.pop("count")
        figures = {f"{name}_um": None if np.isnan(value) else 1e6 * value for name, value in plain.items()}
        return {"count": count, **figures}


@dataclass(frozen=True, eq=False, repr=False)
class Deviation(Value):
    """Distance (n,) of each point of a cloud, in m, the mesh face nearest to it, and the figures.

    Distances are positive outside the material where `is_signed`, and absolute otherwise: a mesh that is not closed
    has no inside. `is_exact`: they are distances to the exact shapes of the part, of which the mesh is a tessellation.
    `by_camera` and `by_segment` are the figures by index of the camera and by segment of the plan.

    Examples
    --------
    >>> result = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 40})
    >>> len(result.deviation.distance) == len(result.cloud)
    True
    >>> result.deviation.rms < 2e-6
    True
    """

    distance: Array
    face: NDArray[np.int32]
    figures: DeviationFigures
    by_camera: dict[int, DeviationFigures]
    by_segment: dict[int, DeviationFigures]
    is_signed: bool = True
    is_exact: bool = False

    @classmethod
    def of(
        cls,
        cloud: Cloud,
        distance: Array,
        face: NDArray[np.integer[Any]],
        is_signed: bool = True,
        is_exact: bool = False,
    ) -> Deviation:
        """From the distance (n,) of each point of the cloud and its nearest face (n,); flags as of `Deviation`."""
        return cls(
            distance=distance,
            face=face.astype(np.int32),
            figures=DeviationFigures.of(distance),
            by_camera=figures_by_label(distance, cloud.camera),
            by_segment=figures_by_label(distance, cloud.segment),
            is_signed=is_signed,
            is_exact=is_exact,
        )

    @property
    def mean(self) -> float:
        """Mean distance, m."""
        return self.figures.mean

    @property
    def rms(self) -> float:
        """Root mean square of the distances, m."""
        return self.figures.rms

    @property
    def d95(self) -> float:
        """95 % quantile of the absolute distances, m."""
        return self.figures.d95

    @property
    def max_abs(self) -> float:
        """Largest absolute distance, m."""
        return self.figures.max_abs

    def as_json(self, cameras: Sequence[str], segments: Mapping[int, str]) -> dict[str, Any]:
        """Plain data for ``deviation.json``; `cameras` and `segments` are names by index and by id."""
        return {
            "what": "distance from each exported point to the nearest point of the "
            + ("exact shapes, " if self.is_exact else "mesh, ")
            + ("positive outside" if self.is_signed else "unsigned because the mesh is not closed"),
            "d95_um": "95 % of the absolute distances are smaller",
            "d99_9_um": "99.9 % of the absolute distances are smaller",
            "all": self.figures.as_um(),
            "by_camera": {cameras[key]: figures.as_um() for key, figures in self.by_camera.items()},
            "by_segment": [
                {"id": key, "name": segments.get(key, str(key)), **figures.as_um()}
                for key, figures in self.by_segment.items()
            ],
        }


def deviation_from_mesh(cloud: Cloud, mesh: Mesh | PartSurface, threads: int = 0) -> Deviation:
    """Distances of all points of the cloud to a mesh, or its exact shapes, in the same frame; no point is left out.

    A `PartSurface` is a mesh prepared for queries, which serves any number of clouds. `threads` does not change the
    result; 0 uses all cores. Distances to an open mesh are absolute: it has no inside.
    """
    surface = mesh if isinstance(mesh, PartSurface) else PartSurface(mesh)
    distance, face = surface.distances(cloud.points_in_part, threads)
    return Deviation.of(cloud, distance, face, surface.is_signed, surface.is_exact)


def _upper_quantiles(values: Array, shares: tuple[float, ...]) -> list[float]:
    """Quantiles at ascending shares near 1, linear between the values, whose order it changes."""
    places = np.asarray(shares) * (len(values) - 1)
    first = int(places[0])
    values.partition(first)
    largest = np.sort(values[first:])
    return [float(value) for value in np.interp(places - first, np.arange(len(largest)), largest)]


def figures_by_label(distance: Array, label: NDArray[np.integer[Any]]) -> dict[int, DeviationFigures]:
    """Figures of the points of each label (n,), by rising label."""
    if not len(label):
        return {}
    lowest = int(label.min())
    present = np.flatnonzero(np.bincount(label - lowest)) + lowest
    return {int(key): DeviationFigures.of(distance[label == key]) for key in present}
