"""Deviation of a cloud from the CAD mesh: signed distances of all points and the figures that sum them up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.geometry.mesh import Mesh
from orchestrator.reconstruction.cloud import Cloud

Array = NDArray[np.float64]

# (vertices (n, 3), faces (m, 3), points (k, 3)) -> closest (k, 3), face (k,), signed distance (k,), outside positive
ClosestPoints = Callable[[Any, Any, Any], tuple[Any, Any, Any]]


@dataclass(frozen=True)
class DeviationFigures:
    """Figures of `count` signed distances in metres; positive is outside the material.

    `d95` and `d99_9` are the 95 % and 99.9 % quantiles of the distance's magnitude, `max_abs` the largest of all;
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
    def of(cls, signed: Array) -> DeviationFigures:
        """Figures of signed distances (n,) in metres; NaN for no points at all."""
        if len(signed) == 0:
            return cls(0, *([float("nan")] * 8))
        magnitude = np.abs(signed)
        d95, d99_9 = np.quantile(magnitude, [0.95, 0.999])
        return cls(
            count=len(signed),
            mean=float(signed.mean()),
            standard_deviation=float(signed.std()),
            rms=float(np.sqrt(np.mean(signed**2))),
            d95=float(d95),
            d99_9=float(d99_9),
            max_abs=float(magnitude.max()),
            maximum=float(signed.max()),
            minimum=float(signed.min()),
        )

    def as_um(self) -> dict[str, int | float | None]:
        """The figures in micrometres under names that say so, for JSON; None for a figure that does not exist."""
        plain = asdict(self)
        count = plain.pop("count")
        figures = {f"{name}_um": None if np.isnan(value) else 1e6 * value for name, value in plain.items()}
        return {"count": count, **figures}


@dataclass(frozen=True)
class Deviation:
    """Signed distance (n,) of each point of a cloud, in m, the mesh face nearest to it, and the figures."""

    signed: Array
    face: NDArray[np.int64]
    figures: DeviationFigures
    by_camera: dict[int, DeviationFigures]
    by_segment: dict[int, DeviationFigures]

    def as_json(self) -> dict[str, Any]:
        """Plain data for ``deviation.json``."""
        return {
            "what": "signed distance from each exported point to the nearest point of the mesh, positive outside",
            "all": self.figures.as_um(),
            "by_camera": {str(key): figures.as_um() for key, figures in self.by_camera.items()},
            "by_segment": {str(key): figures.as_um() for key, figures in self.by_segment.items()},
        }


def deviation_from_mesh(cloud: Cloud, mesh: Mesh, closest_points: ClosestPoints) -> Deviation:
    """Distances of all points of the cloud to the mesh in the same frame; no point is left out.

    `closest_points` finds the nearest points of a mesh: `sensor_rt.closest_points`, or another that judges it.
    """
    points = np.ascontiguousarray(cloud.points_in_part)
    _, face, signed = closest_points(mesh.vertices, mesh.faces.astype(np.uint32), points)
    signed = np.asarray(signed, float)
    return Deviation(
        signed=signed,
        face=np.asarray(face, np.int64),
        figures=DeviationFigures.of(signed),
        by_camera=_groups(signed, cloud.camera),
        by_segment=_groups(signed, cloud.segment),
    )


def _groups(signed: Array, label: NDArray[np.int32]) -> dict[int, DeviationFigures]:
    return {int(key): DeviationFigures.of(signed[label == key]) for key in np.unique(label)}
