"""Cloud against a mesh: alignment, signed distances, figures by region, coverage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.choices import Align
from scancell.errors import FitError
from scancell.evaluation.alignment import DatumPlane, best_fit, datum_fit
from scancell.evaluation.deviation import DeviationFigures, figures_by_label
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.part_surface import PartSurface
from scancell.geometry.regions import Regions, smooth_regions
from scancell.geometry.sampling import sample_surface
from scancell.geometry.shapes import ShapeMesh
from scancell.sensor import MeshSurface

Array = NDArray[np.float64]

_DATUM_REACH = 1e-3  # m: points farther from a datum plane do not belong to it
_DATUM_EDGE = 0.5e-3  # m: points nearer to another region do not, either
_COVERAGE_SAMPLES = 20_000
_COVERAGE_TOLERANCE = 1e-3  # m
_LISTED = 100  # regions with figures of their own


@dataclass(frozen=True)
class MeshEvaluation:
    """Comparison of n points with a mesh.

    Attributes
    ----------
    points_in_part
        (n, 3) aligned points, m.
    part_from_cloud
        (4, 4) alignment.
    signed, face
        (n,) distance, m, positive outside (absolute for an open mesh), and nearest face.
    figures, by_region
        Statistics of all points, and of those nearest to each of the largest regions.
    coverage
        Share of the surface, and (k,) of each region, with a point within `tolerance` (m).
    """

    points_in_part: Array
    part_from_cloud: Array
    align: Align
    mesh: Mesh
    signed: Array
    face: NDArray[np.int32]
    figures: DeviationFigures
    regions: Regions
    by_region: dict[int, DeviationFigures]
    coverage: float
    region_coverage: Array
    tolerance: float
    is_signed: bool

    def as_json(self) -> dict[str, Any]:
        """Plain data for ``evaluation.json``."""
        return {
            "mesh": self.mesh.source,
            "what": "distance from each point to the nearest point of the part, "
            + ("positive outside" if self.is_signed else "unsigned because the mesh is not closed"),
            "alignment": alignment_json(self.align, self.part_from_cloud),
            "all": self.figures.as_um(),
            "coverage": {"fraction": self.coverage, "tolerance_mm": 1e3 * self.tolerance},
            "regions": self.rows(),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One row of figures for each listed region, for JSON and CSV."""
        return [
            {
                "region": number,
                "plane": bool(self.regions.is_plane[number]),
                "area_mm2": 1e6 * float(self.regions.areas[number]),
                "coverage": float(self.region_coverage[number]) if self.region_coverage[number] >= 0 else None,
                **figures.as_um(),
            }
            for number, figures in self.by_region.items()
        ]


def evaluate_against_mesh(
    points: Array,
    mesh: Mesh,
    align: Align = "none",
    datum: Sequence[int] = (),
    *,
    tolerance: float = _COVERAGE_TOLERANCE,
    threads: int = 0,
) -> MeshEvaluation:
    """Align points (n, 3), m, and compare them with the mesh.

    Parameters
    ----------
    datum
        Numbers of three plane regions in order of precedence, for ``align="datum"``; by default the three largest of
        three directions.
    tolerance
        Distance within which a point covers the surface, m.

    Raises
    ------
    FitError
        If the points do not determine the alignment.
    """
    surface, regions = PartSurface(mesh), smooth_regions(mesh)
    moved = _alignment(points, mesh, surface, regions, align, datum, threads)
    aligned = points if align == "none" else pose.transform_points(moved, points)
    signed, face = surface.distances(aligned, threads)
    of_point = regions.of_face[face]
    listed = figures_by_label(signed, of_point)
    covered, region_coverage = _coverage(aligned, mesh, regions, tolerance)
    return MeshEvaluation(
        points_in_part=aligned,
        part_from_cloud=moved,
        align=align,
        mesh=mesh,
        signed=signed,
        face=face.astype(np.int32),
        figures=DeviationFigures.of(signed),
        regions=regions,
        by_region={number: listed[number] for number in sorted(listed)[:_LISTED]},
        coverage=covered,
        region_coverage=region_coverage,
        tolerance=tolerance,
        is_signed=surface.is_signed,
    )


def alignment_json(align: Align, part_from_cloud: Array) -> dict[str, Any]:
    """Alignment as plain data."""
    return {
        "method": align,
        "part_from_cloud": [[*row[:3], 1e3 * row[3]] for row in part_from_cloud[:3].tolist()],
        "unit": "mm",
    }


def _alignment(
    points: Array,
    mesh: Mesh,
    surface: PartSurface,
    regions: Regions,
    align: Align,
    datum: Sequence[int],
    threads: int,
) -> Array:
    if align == "none":
        return np.eye(4)

    def distances(at: Array) -> tuple[Array, Array]:
        if isinstance(mesh, ShapeMesh):
            return mesh.shapes.nearest(at)[:2]
        signed, face = surface.distances(at, threads)
        normal = mesh.normals[face]
        if surface.is_signed:
            return signed, normal
        # Without an inside the sign is that of the side of the nearest face.
        side = np.einsum("ni,ni->n", at - mesh.vertices[mesh.faces[face, 0]], normal)
        return np.copysign(signed, side), normal

    start = best_fit(points, distances)
    if align == "best-fit":
        return start
    numbers = list(datum) or _default_datum(regions)
    moved = pose.transform_points(start, points)
    signed, face = surface.distances(moved, threads)
    planes = []
    for number in numbers:
        if not 0 <= number < len(regions) or not regions.is_plane[number]:
            raise FitError(f"datum: region {number} of {mesh.source} is not one of its plane regions")
        own = regions.of_face == number
        near = np.flatnonzero((regions.of_face[face] == number) & (np.abs(signed) < _DATUM_REACH))
        others = MeshSurface(mesh.vertices, mesh.faces[~own])
        near = near[np.abs(others.signed_distances(moved[near], threads)[0]) > _DATUM_EDGE]
        point = mesh.vertices[mesh.faces[own, 0]].mean(0)
        planes.append((DatumPlane(point, regions.normals[number]), points[near]))
    return datum_fit(planes)


def _default_datum(regions: Regions) -> list[int]:
    """The largest plane region, and the next ones across those before."""
    chosen: list[int] = []
    for number in np.flatnonzero(regions.is_plane):
        normals = regions.normals[[*chosen, int(number)]]
        if np.linalg.svd(normals, compute_uv=False)[-1] > 0.3:
            chosen.append(int(number))
        if len(chosen) == 3:
            break
    return chosen


def _coverage(points: Array, mesh: Mesh, regions: Regions, tolerance: float) -> tuple[float, Array]:
    """Share of the surface, and of each region (k,), that has a point within the tolerance; NaN without samples."""
    samples, face = sample_surface(mesh, _COVERAGE_SAMPLES, 0)
    covered = sensor_rt.covered_samples(samples, mesh.normals[face], points, None, tolerance, 0.5)
    region = regions.of_face[face]
    count = np.bincount(region, minlength=len(regions))
    share = np.bincount(region, covered, minlength=len(regions)) / np.where(count, count, np.nan)
    return float(covered.mean()), share
