"""Cloud against an artefact of exact shape: alignment, points of each face, figures, outliers, missing points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.choices import Align
from scancell.errors import FitError
from scancell.evaluation.alignment import (
    MOST_POINTS,
    DatumPlane,
    best_fit,
    best_fit_of_starts,
    check_request,
    datum_fit,
)
from scancell.evaluation.characteristics import (
    Characteristic,
    Face,
    FittedFace,
    assign,
    characteristics,
    faces_of,
    fitted_face,
)
from scancell.evaluation.deviation import Deviation, DeviationFigures
from scancell.evaluation.mesh_evaluation import Evaluation, alignment_json
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, sample_surface
from scancell.geometry.shapes import PartSurface, ShapeGroup

REACH = 2e-3  # m: largest distance of a point from the face that it belongs to
GUARD = 1e-3  # m
_SHOWN = 40  # characteristics in the summary
_LEAST_POINTS = 20  # of a face with figures of its own
_SAMPLES = 20_000  # of the artefact's surface, for missing points
_TOLERANCE = 1e-3  # m: a sample with no point within is missing
_COARSE = 100e-6  # m: chord error of the surface that is sampled


@dataclass(frozen=True, eq=False, repr=False)
class ArtefactEvaluation(Evaluation):
    """Comparison of n points with an artefact.

    Attributes
    ----------
    points_in_artefact
        (n, 3) aligned points, m.
    artefact_from_cloud, align
        (4, 4) alignment, and what was done.
    face, distance
        (n,) number of the measured face, -1 for none, and distance from the nominal artefact, m, positive outside.
    faces
        Faces with enough points, and their fits.
    unfitted
        Faces with points that do not determine them, and why.
    statistics
        Statistics of the signed distances of the points that belong to a face.
    outlier_rate
        Share of the points that lie farther than the reach from every shape.
    reach, guard
        Distance from a shape up to which points belong to it, and from its edges within which they do not, m.
    missing_rate
        Share of each face (by name) without a point within 1 mm, away from edges.
    datum
        Names of the datum faces.
    warnings
        What is doubtful about the cloud and the alignment.
    source
        Format of the cloud's file, its records, and those without a usable point by reason.

    Examples
    --------
    >>> sphere = scancell.assets_dir() / "artefacts" / "sphere.toml"
    >>> result = scancell.scan(sphere, engine="geometric", settings={"scan.max_profiles": 100})
    >>> evaluation = scancell.evaluate(result, artefact=sphere)
    >>> size = evaluation.characteristics[0]
    >>> size.name, abs(size.error) < 2e-6
    ('probing size', True)
    """

    artefact: ShapeGroup
    points_in_artefact: Array
    artefact_from_cloud: Array
    align: Align
    face: NDArray[np.int64]
    distance: Array
    faces: tuple[FittedFace, ...]
    unfitted: dict[str, str]
    characteristics: tuple[Characteristic, ...]
    statistics: DeviationFigures
    outlier_rate: float
    missing_rate: dict[str, float]
    reach: float
    guard: float
    datum: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    source: Mapping[str, Any] = field(default_factory=dict)

    _row_title = "Characteristics"

    def _drawn(self) -> tuple[Array, Deviation, Mesh]:
        """Contents of the picture: points on measured faces, their deviations, and the artefact as a mesh."""
        mesh, shown = self.artefact.mesh(), np.flatnonzero(self.face >= 0)
        points = self.points_in_artefact[shown]
        face = PartSurface(mesh).distances(points)[1].astype(np.int32)
        return points, Deviation(self.distance[shown], face, self.statistics, {}, {}), mesh

    def _reported(self) -> tuple[Array, Deviation, Mesh]:
        """All points, also those on no face, their deviations with the figures of the faces, and the mesh."""
        deviation = Deviation(self.distance, self.face.astype(np.int32), self.statistics, {}, {})
        return self.points_in_artefact, deviation, self.artefact.mesh()

    @property
    def figures(self) -> dict[str, Any]:
        """Alignment, statistics and rows, as in ``evaluation.json``."""
        return {
            "artefact": self.artefact.source,
            "what": "figures in the style of VDI/VDE 2634-2 and -3, ISO 10360-8 and -13; least-squares elements; "
            "standard uncertainties from the covariance of the fits",
            "cloud": dict(self.source),
            "alignment": alignment_json(self.align, self.artefact_from_cloud, self.datum),
            "reach_mm": 1e3 * self.reach,
            "edge_guard_mm": 1e3 * self.guard,
            "all": self.statistics.as_um(),
            "outlier_rate": self.outlier_rate,
            "missing_rate": {name: rate if rate >= 0 else None for name, rate in self.missing_rate.items()},
            "unfitted": self.unfitted,
            "points": {one.face.name: len(one.points) for one in self.faces},
            "characteristics": self.rows(),
        }

    def summary(self) -> str:
        """Statistics, datum faces and characteristics as lines of text."""
        lines = [self.statistics.text()]
        if self.datum:
            lines.append(f"  datum faces: {', '.join(self.datum)}")
        lines += [_line(one.as_row()) for one in self.characteristics[:_SHOWN]]
        if len(self.characteristics) > _SHOWN:
            lines.append(f"  … {len(self.characteristics) - _SHOWN} more in evaluation.csv")
        return "\n".join(lines)

    def rows(self) -> list[dict[str, Any]]:
        """One row for each characteristic, for JSON and CSV."""
        return [one.as_row() for one in self.characteristics]


def evaluate_against_artefact(
    points: Array,
    artefact: ShapeGroup,
    align: Align = "none",
    datum: Sequence[str] = (),
    *,
    guard: float = GUARD,
) -> ArtefactEvaluation:
    """Align points (n, 3), m, to an artefact, and measure it from them.

    Raises `DescriptionError` if `align` is unknown, or there are no points; `FitError` if no face has enough points, or
    they do not determine the alignment.

    Parameters
    ----------
    datum
        For ``align="datum"``: three plane faces in order of precedence, or any faces to which alone the points are
        fitted; by default all measured faces.
    guard
        Points nearer to an edge do not count, m.
    """
    check_request(points, align)
    faces = faces_of(artefact)
    moved, used, warnings = _alignment(points, artefact, faces, align, datum, guard)
    aligned = points if align == "none" else pose.transform_points(moved, points)
    assigned = assign(aligned, artefact, faces, REACH, guard)
    counts = np.bincount(assigned.face + 1, minlength=len(faces) + 1)[1:]
    measured, unfitted = [], {}
    for number, face in enumerate(faces):
        if counts[number] >= _LEAST_POINTS:
            try:
                measured.append(fitted_face(face, aligned[assigned.face == number]))
            except FitError as error:
                unfitted[face.name] = str(error)
    if not measured:
        raise FitError(
            f"no face has {_LEAST_POINTS} points within {1e3 * REACH:g} mm; is the cloud in the frame of the artefact?",
            file=artefact.source,
        )
    distance = artefact.nearest(aligned)[0]
    return ArtefactEvaluation(
        artefact=artefact,
        points_in_artefact=aligned,
        artefact_from_cloud=moved,
        align=align,
        face=assigned.face,
        distance=distance,
        faces=tuple(measured),
        unfitted=unfitted,
        characteristics=tuple(characteristics(measured)),
        statistics=DeviationFigures.of(np.concatenate([one.signed for one in measured])),
        outlier_rate=float(assigned.outlier.mean()),
        missing_rate=_missing(aligned, artefact, faces, measured, guard),
        reach=REACH,
        guard=guard,
        datum=used,
        warnings=tuple(warnings),
    )


def _alignment(
    points: Array,
    artefact: ShapeGroup,
    faces: list[Face],
    align: Align,
    datum: Sequence[str],
    guard: float,
) -> tuple[Array, tuple[str, ...], list[str]]:
    """Pose (4, 4) that moves the points, the datum faces used, and warnings."""
    if align == "none":
        return np.eye(4), (), []
    known = [face.name for face in faces]
    unknown = [name for name in datum if name not in known]
    if unknown:
        raise FitError(f"{artefact.source} has no face {unknown[0]}", key="datum", expected=", ".join(known))
    bounds = artefact.mesh(_COARSE).bounds
    start, warnings = best_fit_of_starts(points, lambda at: artefact.nearest(at)[:2], bounds)
    if align == "best-fit":
        return start, (), warnings
    chosen = [known.index(name) for name in (datum or known)]
    assigned = assign(pose.transform_points(start, points), artefact, faces, REACH, guard).face
    counts = {known[k]: int((assigned == k).sum()) for k in chosen}
    missing = [name for name in datum if counts[name] < _LEAST_POINTS]
    if missing:
        measured = [face.name for number, face in enumerate(faces) if (assigned == number).sum() >= _LEAST_POINTS]
        raise FitError(
            f"{counts[missing[0]]} points lie on {missing[0]} of {artefact.source}; measured: "
            f"{', '.join(measured) or 'no face'}",
            key="datum",
        )
    used = tuple(name for name in (known[k] for k in chosen) if counts[name])
    if len(chosen) == 3 and all(faces[number].kind == "plane" for number in chosen):
        planes = [(DatumPlane(faces[k].point, faces[k].axis), points[assigned == k]) for k in chosen]
        return datum_fit(planes), used, warnings
    rows = np.flatnonzero(np.isin(assigned, chosen))
    numbers = assigned[rows]

    def distances(at: Array) -> tuple[Array, Array]:
        signed, normal = np.zeros(len(at)), np.zeros_like(at)
        for number in chosen:
            own = numbers == number
            signed[own], normal[own] = faces[number].distances(at[own])[:2]
        return signed, normal

    # As many as `best_fit` uses, so that it leaves none out.
    step = max(1, len(rows) // MOST_POINTS)
    rows, numbers = rows[::step], numbers[::step]
    return best_fit(pose.transform_points(start, points[rows]), distances) @ start, used, warnings


def _missing(
    points: Array, artefact: ShapeGroup, faces: list[Face], measured: Sequence[FittedFace], guard: float
) -> dict[str, float]:
    """Share of the samples of each measured face without a point near them; those near edges are left out."""
    from scipy.spatial import cKDTree  # noqa: PLC0415

    samples, _ = sample_surface(artefact.mesh(_COARSE), _SAMPLES, 0)
    samples = samples[artefact.nearest(samples)[0] > -2 * _COARSE]  # the others lie inside another shape
    owner = assign(samples, artefact, faces, 2 * _COARSE, guard).face
    far = cKDTree(points).query(samples, distance_upper_bound=_TOLERANCE)[0] > _TOLERANCE
    names = [face.name for face in faces]
    rates = {}
    for one in measured:
        own = owner == names.index(one.face.name)
        rates[one.face.name] = float(far[own].mean()) if own.any() else float("nan")
    return rates


def _line(row: dict[str, Any]) -> str:
    """A characteristic with its error and uncertainty; a form deviation has no error beside its value."""
    shown = {name: value for name, value in row.items() if name not in ("of", "name") and value is not None}
    if not any(value for name, value in shown.items() if name.startswith("nominal_")):
        shown = {name: value for name, value in shown.items() if not name.startswith(("nominal_", "error_"))}
    words = [name.split("_") for name in shown]
    parts = [
        f"{what} {value:.{3 if unit == 'um' else 5}f} {unit}"
        for (what, unit), value in zip(words, shown.values(), strict=True)
    ]
    return f"  {row['of']}: {row['name']}: {', '.join(parts)}"
