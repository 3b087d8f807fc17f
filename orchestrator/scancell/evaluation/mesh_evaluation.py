"""Cloud against a mesh: alignment, signed distances, figures by region, coverage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.config.choices import Align
from scancell.errors import FitError
from scancell.evaluation.alignment import DatumPlane, best_fit_of_starts, check_request, datum_fit
from scancell.evaluation.deviation import Deviation, DeviationFigures, figures_by_label
from scancell.geometry import pose
from scancell.geometry.mesh import METRES_PER_UNIT, Mesh, Regions, sample_surface, smooth_regions
from scancell.geometry.shapes import PartSurface
from scancell.output.run_folder import RunFolder, SavedResult
from scancell.sensor import MeshSurface

_DATUM_REACH = 1e-3  # m: points farther from a datum plane do not belong to it
_DATUM_EDGE = 0.5e-3  # m: points nearer to another region do not, either
_DATUM_POINTS = 20  # that a face needs to be chosen as datum
_NAMED = 10  # regions in a message
_DATUM_AREA = 1e-6  # m², over which they must spread
_DIRECTIONS = 0.3  # least singular value of the unit normals of chosen datum faces
_SIZES_DIFFER = 3.0  # factor between the extents of cloud and mesh from which on a unit is doubted
_SAME_SIZE = 1.5  # factor up to which another unit explains it
_UNIT_PAIRS = tuple(permutations(METRES_PER_UNIT, 2))
_COVERAGE_SAMPLES = 20_000
_COVERAGE_TOLERANCE = 1e-3  # m
_LISTED = 100  # regions with figures of their own
_SHOWN = 12  # of them in the summary


class Evaluation(SavedResult):
    """A comparison of a cloud with a mesh or an artefact."""

    align: Align
    source: Mapping[str, Any]
    warnings: tuple[str, ...]
    _row_title: ClassVar[str]

    def rows(self) -> list[dict[str, Any]]:
        """One mapping for each characteristic or region, as in ``evaluation.csv``."""
        raise NotImplementedError

    def _reported(self) -> tuple[Array, Deviation, Mesh]:
        """Points, deviations and mesh of the report: those of `_drawn`, with points that belong to no feature."""
        return self._drawn()

    def _drawn(self) -> tuple[Array, Deviation, Mesh]:
        """Contents of the picture: points (n, 3) in the part, m, their deviations, and the mesh."""
        raise NotImplementedError

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        from scancell.output.run_folder import write_json  # noqa: PLC0415  (files are optional)
        from scancell.output.tables import columns_of, write_csv  # noqa: PLC0415

        write_json(folder.path("evaluation.json"), self.figures)
        write_csv(folder.path("evaluation.csv"), columns_of(self.rows()))
        folder.path("evaluation.png").write_bytes(self.picture())
        self._write_report(folder.path("evaluation.html"))

    def picture(self) -> bytes:
        """The deviations on the part, as PNG."""
        from scancell.output.deviation_report import deviation_picture  # noqa: PLC0415  (imports OpenCV)

        points, deviation, mesh = self._drawn()
        return deviation_picture(points, deviation, mesh, name=Path(mesh.source).stem).png()

    def _write_report(self, path: Path) -> None:
        from scancell.evaluation.deviation import UnseenSurface  # noqa: PLC0415  (imports planning)
        from scancell.output.deviation_report import DeviationReport  # noqa: PLC0415

        points, deviation, mesh = self._reported()
        samples, covered, _ = covered_surface(points, mesh, _COVERAGE_TOLERANCE)
        unseen = UnseenSurface.without_reason(
            samples, covered, float(mesh.areas.sum()), _COVERAGE_TOLERANCE, "a cloud alone does not show the reason"
        )
        about = {
            "alignment": self.align,
            "nominal": Path(mesh.source).name,
            "cloud": str(self.source.get("format", "")),
        }
        DeviationReport(
            Path(mesh.source).stem,
            points,
            deviation,
            mesh,
            unseen,
            (float(covered.mean()), "surface"),
            {self._row_title: self.rows()},
            notes=self.warnings,
            about=about,
        ).write(path)


@dataclass(frozen=True, eq=False, repr=False)
class MeshEvaluation(Evaluation):
    """Comparison of n points with a mesh.

    Attributes
    ----------
    points_in_part
        (n, 3) aligned points, m.
    part_from_cloud
        (4, 4) alignment.
    distance, face
        (n,) distance, m, positive outside (absolute for an open mesh), and nearest face.
    statistics, by_region
        Statistics of all points, and of those nearest to each of the largest regions.
    coverage, region_coverage
        Share of the surface, and (k,) of each region, with a point within `tolerance` (m).
    align, is_signed
        What was done before; whether the mesh is closed, so that distances have a sign.
    datum
        Numbers of the datum regions in order of precedence.
    warnings
        What is doubtful about mesh, cloud and alignment.
    source
        Format of the cloud's file, its records, and those without a usable point by reason.

    Examples
    --------
    >>> part = scancell.load_part("part.stl")
    >>> evaluation = scancell.evaluate(part.vertices + [0, 0, 1e-4], mesh=part, align="best-fit")
    >>> evaluation
    MeshEvaluation(... compared, mean ... um, RMS ... um, ...)
    >>> round(float(evaluation.part_from_cloud[2, 3]), 6)
    -0.0001
    """

    points_in_part: Array
    part_from_cloud: Array
    align: Align
    mesh: Mesh
    distance: Array
    face: NDArray[np.int32]
    statistics: DeviationFigures
    regions: Regions
    by_region: dict[int, DeviationFigures]
    coverage: float
    region_coverage: Array
    tolerance: float
    is_signed: bool
    datum: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    source: Mapping[str, Any] = field(default_factory=dict)

    _row_title = "Regions"

    def _drawn(self) -> tuple[Array, Deviation, Mesh]:
        """Contents of the picture: all points, their deviations, and the mesh."""
        deviation = Deviation(self.distance, self.face, self.statistics, {}, {}, self.is_signed)
        return self.points_in_part, deviation, self.mesh

    @property
    def figures(self) -> dict[str, Any]:
        """Alignment, statistics and rows, as in ``evaluation.json``."""
        return {
            "mesh": self.mesh.source,
            "what": "distance from each point to the nearest point of the part, "
            + ("positive outside" if self.is_signed else "unsigned because the mesh is not closed"),
            "cloud": dict(self.source),
            "alignment": alignment_json(self.align, self.part_from_cloud, self.datum),
            "all": self.statistics.as_um(),
            "coverage": {"fraction": self.coverage, "tolerance_mm": 1e3 * self.tolerance},
            "regions": self.rows(),
        }

    def summary(self) -> str:
        """Statistics, coverage, datum regions, and the largest regions with their frames, as lines of text."""
        lines = [
            self.statistics.text(),
            f"  {100 * self.coverage:.1f} % of the surface covered, {len(self.regions)} regions",
            *(f"  datum face: region {number}: {region_text(self.regions, number)}" for number in self.datum),
        ]
        shown = list(self.by_region.items())[:_SHOWN]
        for number, of_region in shown:
            text = region_text(self.regions, number)
            lines.append(f"  region {number}: {text}: {of_region.count} points, RMS {1e6 * of_region.rms:.1f} um")
        if len(self.by_region) > len(shown):
            lines.append(f"  … {len(self.by_region) - len(shown)} more in evaluation.csv")
        return "\n".join(lines)

    def rows(self) -> list[dict[str, Any]]:
        """One row of figures for each listed region, for JSON and CSV."""
        return [
            {
                "region": number,
                "plane": bool(self.regions.is_plane[number]),
                **self._frame(number),
                "area_mm2": 1e6 * float(self.regions.areas[number]),
                "coverage": float(self.region_coverage[number]) if self.region_coverage[number] >= 0 else None,
                **figures.as_um(),
            }
            for number, figures in self.by_region.items()
        ]

    def _frame(self, number: int) -> dict[str, float | None]:
        """Centre of a region, and the normal of a plane one."""
        is_plane, normal = self.regions.is_plane[number], self.regions.normals[number]
        return {
            **{f"normal_{axis}": float(v) if is_plane else None for axis, v in zip("xyz", normal, strict=True)},
            **{f"centre_{a}_mm": 1e3 * float(v) for a, v in zip("xyz", self.regions.centres[number], strict=True)},
        }


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

    Raises `DescriptionError` if `align` is unknown, or there are no points; `FitError` if the points do not determine
    the alignment.

    Parameters
    ----------
    datum
        Numbers of three plane regions in order of precedence, for ``align="datum"``; by default the three of which most
        was measured, of three directions.
    tolerance
        Distance within which a point covers the surface, m.
    """
    check_request(points, align)
    surface, regions = PartSurface(mesh), smooth_regions(mesh)
    moved, chosen, warnings = _alignment(points, mesh, surface, regions, align, datum, threads)
    aligned = points if align == "none" else pose.transform_points(moved, points)
    distance, face = surface.distances(aligned, threads)
    of_point = regions.of_face[face]
    listed = figures_by_label(distance, of_point)
    covered, region_coverage = _coverage(aligned, mesh, regions, tolerance)
    return MeshEvaluation(
        points_in_part=aligned,
        part_from_cloud=moved,
        align=align,
        mesh=mesh,
        distance=distance,
        face=face.astype(np.int32),
        statistics=DeviationFigures.of(distance),
        regions=regions,
        by_region={number: listed[number] for number in sorted(listed)[:_LISTED]},
        coverage=covered,
        region_coverage=region_coverage,
        tolerance=tolerance,
        is_signed=surface.is_signed,
        datum=chosen,
        warnings=(*mesh.warnings, *_size_warnings(points, mesh), *warnings),
    )


def alignment_json(align: Align, part_from_cloud: Array, datum: Sequence[int | str]) -> dict[str, Any]:
    """Alignment as plain data."""
    return {
        "method": align,
        "datum": list(datum),
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
) -> tuple[Array, tuple[int, ...], list[str]]:
    """Pose (4, 4) that moves the points, the datum regions used, and warnings."""
    if align == "none":
        return np.eye(4), (), []
    start, warnings = best_fit_of_starts(points, lambda at: surface.nearest(at, threads), mesh.bounds)
    if align == "best-fit":
        return start, (), warnings
    moved = pose.transform_points(start, points)
    signed, face = surface.distances(moved, threads)
    near = np.abs(signed) < _DATUM_REACH
    faces = _DatumFaces(mesh, regions, moved[near], regions.of_face[face[near]], threads)
    if datum:
        planes = faces.named(datum)
        return datum_fit(list(planes.values())) @ start, tuple(planes), warnings
    planes = faces.chosen()
    if len(planes) < 3:
        text = ", ".join(f"region {number} ({region_text(regions, number)})" for number in planes)
        warnings.append(
            f"datum: the measured plane faces have {len(planes)} of three directions: {text}; the best fit "
            "determines the remaining degrees of freedom"
        )
    return datum_fit(list(planes.values()), least=1) @ start, tuple(planes), warnings


@dataclass(frozen=True)
class _DatumFaces:
    """Plane regions of a mesh and the points (n, 3) near the region of each, (n,), as datum faces."""

    mesh: Mesh
    regions: Regions
    points: Array
    of_point: NDArray[np.int64]
    threads: int

    def named(self, numbers: Sequence[int]) -> dict[int, tuple[DatumPlane, Array]]:
        """The planes that the user names, and their points."""
        planes = {}
        for number in numbers:
            if not 0 <= number < len(self.regions) or not self.regions.is_plane[number]:
                raise FitError(f"region {number} of {self.mesh.source} is not one of its plane regions", key="datum")
            planes[number] = self._plane(number)
            if measured_area(planes[number][1]) < _DATUM_AREA:
                measured = ", ".join(self._text(n) for n in self._measured()[:_NAMED])
                raise FitError(
                    f"{self._text(number)} of {self.mesh.source} was not measured: {len(planes[number][1])} "
                    f"points lie on it; measured: {measured or 'no plane region'}",
                    key="datum",
                )
        return planes

    def chosen(self) -> dict[int, tuple[DatumPlane, Array]]:
        """The planes of up to three directions of which most was measured, and their points."""
        planes: dict[int, tuple[DatumPlane, Array]] = {}
        for number in self._measured():
            if np.linalg.svd(self.regions.normals[[*planes, number]], compute_uv=False)[-1] < _DIRECTIONS:
                continue
            plane = self._plane(number)
            if len(plane[1]) >= _DATUM_POINTS and measured_area(plane[1]) >= _DATUM_AREA:
                planes[number] = plane
            if len(planes) == 3:
                break
        if not planes:
            raise FitError(f"no plane face of {self.mesh.source} was measured; use best-fit", key="datum")
        return planes

    def _measured(self) -> list[int]:
        """Plane regions with enough points, by falling measured area."""
        count = np.bincount(self.of_point, minlength=len(self.regions))
        numbers = np.flatnonzero(self.regions.is_plane & (count >= _DATUM_POINTS))
        area = {int(n): min(measured_area(self.points[self.of_point == n]), self.regions.areas[n]) for n in numbers}
        return sorted((n for n in area if area[n] >= _DATUM_AREA), key=lambda n: -area[n])

    def _plane(self, number: int) -> tuple[DatumPlane, Array]:
        """Nominal plane of a region, and the points on it, away from other regions."""
        own = self.regions.of_face == number
        points = self.points[self.of_point == number]
        if not own.all():
            others = MeshSurface(self.mesh.vertices, self.mesh.faces[~own])
            points = points[np.abs(others.signed_distances(points, self.threads)[0]) > _DATUM_EDGE]
        return DatumPlane(self.regions.centres[number], self.regions.normals[number]), points

    def _text(self, number: int) -> str:
        return f"region {number} ({region_text(self.regions, number)})"


def region_text(regions: Regions, number: int) -> str:
    """Normal of a plane region and centre of any, as text."""
    centre = ", ".join(f"{1e3 * value:.1f}" for value in regions.centres[number])
    normal = ", ".join(f"{value + 0.0:.2f}" for value in regions.normals[number])
    return (f"plane, normal ({normal}), " if regions.is_plane[number] else "") + f"centre ({centre}) mm"


def measured_area(points: Array) -> float:
    """Area (m²) of a rectangle with the in-plane standard deviations of points (n, 3) near a plane; 0 for a line."""
    if len(points) < 3:
        return 0.0
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False) / np.sqrt(len(points))
    return float(12 * spread[0] * spread[1])


def _size_warnings(points: Array, mesh: Mesh) -> list[str]:
    """A warning if cloud and mesh differ in size by more than views and surroundings explain."""
    cloud, part = (float(np.ptp(corners, axis=0).max()) for corners in (points, mesh.bounds))
    if max(cloud, part) < _SIZES_DIFFER * min(cloud, part):
        return []
    ratios = {f"{one} and {other}": METRES_PER_UNIT[one] / METRES_PER_UNIT[other] for one, other in _UNIT_PAIRS}
    explained = min(ratios, key=lambda pair: abs(np.log(cloud / part / ratios[pair])))
    same = abs(np.log(cloud / part / ratios[explained])) < np.log(_SAME_SIZE)
    return [
        f"{mesh.source}: the largest extent of the mesh is {1e3 * part:.3g} mm, that of the cloud {1e3 * cloud:.3g} mm"
        + (f", which differ as {explained} do" if same else "")
        + ": are the unit of the mesh (`unit`) and that of the cloud (`cloud_unit`) right?"
    ]


def _coverage(points: Array, mesh: Mesh, regions: Regions, tolerance: float) -> tuple[float, Array]:
    """Share of the surface, and of each region (k,), that has a point within the tolerance; NaN without samples."""
    _, covered, face = covered_surface(points, mesh, tolerance)
    region = regions.of_face[face]
    count = np.bincount(region, minlength=len(regions))
    share = np.bincount(region, covered, minlength=len(regions)) / np.where(count, count, np.nan)
    return float(covered.mean()), share


def covered_surface(
    points: Array, mesh: Mesh, tolerance: float
) -> tuple[Array, NDArray[np.bool_], NDArray[np.integer[Any]]]:
    """Samples (n, 3) of the surface, whether each has a point within the tolerance (m), and their faces (n,)."""
    samples, face = sample_surface(mesh, _COVERAGE_SAMPLES, 0)
    return samples, sensor_rt.covered_samples(samples, mesh.normals[face], points, None, tolerance, 0.5), face
