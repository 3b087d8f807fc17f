"""Inspection of a CAD part: value, uncertainty and decision of each characteristic (ISO 14253-1)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from scancell.arrays import Array
from scancell.config.choices import Align
from scancell.config.inspection import CharacteristicDescription, InspectionDescription
from scancell.errors import DescriptionError, FitError, MeshError
from scancell.evaluation.alignment import best_fit_of_starts
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh, find_faces
from scancell.geometry.shapes import PartSurface
from scancell.inspection.annotations import annotated
from scancell.inspection.features import DatumSystem, Feature, MeasuredPart
from scancell.inspection.measure import LEAST_POINTS, Measured, measure
from scancell.output.run_folder import RunFolder, SavedResult, write_json
from scancell.output.tables import columns_of, write_csv

Verdict = Literal["conforms", "does not conform", "cannot be decided", "not evaluated"]

_REFERENCE = 20.0  # °C (ISO 1)
_EXPANDED = 0.95  # probability of the stated intervals
_LEAST_SCALE = 1e-12
_SCALE = 1e-5  # of a part: step of the derivative by its temperature
_MOST_ON_FACE = 50_000  # points by which errors of a calibration count; fewer lose the extremes of zones

Displacements = Callable[[NDArray[np.intp]], Array]
"""Displacements (k, r, 3) of points, by their rows (r,), by k independent errors of one standard deviation each."""


@dataclass(frozen=True)
class Effect:
    """Effect of what the noise of the points does not show, by simulated measurements: `bias` and `deviation`.

    Both in m or rad: mean error, and standard deviation of it.
    """

    bias: float = 0.0
    deviation: float = 0.0

    @property
    def of_zone(self) -> Effect:
        """On a zone, whose mean error on a perfect part tells how far errors reach, and not what to subtract.

        The same errors hide a deviation of the part in one measurement and add to it in another.
        """
        return Effect(0.0, float(np.hypot(self.bias, self.deviation)))


@dataclass(frozen=True)
class Decision:
    """Verdict on a characteristic.

    Attributes
    ----------
    description
        The characteristic.
    measured
        Its value; None if it cannot be evaluated for the reason `reason`.
    low, high
        Limits, m or rad; infinite where there is none.
    effect
        Further effects on the value, which is corrected for their bias.
    temperature
        Standard uncertainty by the temperature of the part.
    calibration
        Standard uncertainty by a calibration; 0 without.
    probability
        Probability of conformance; NaN if not evaluated.
    verdict
        What follows from it.
    """

    description: CharacteristicDescription
    measured: Measured | None
    low: float
    high: float
    effect: Effect = Effect()
    temperature: float = 0.0
    calibration: float = 0.0
    probability: float = float("nan")
    verdict: Verdict = "not evaluated"
    reason: str = ""

    @property
    def value(self) -> float:
        """Value, m or rad, without known biases; not below 0."""
        if self.measured is None:
            return float("nan")
        return max(self.measured.value - self.effect.bias, 0.0)

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty, m or rad."""
        if self.measured is None:
            return float("nan")
        systematic = (self.effect.deviation, self.calibration, self.temperature)
        return float(np.linalg.norm([self.measured.random, *systematic]))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the value, m or rad; it begins at 0 at least."""
        half = float(ndtri(0.5 + _EXPANDED / 2)) * self.uncertainty
        return max(self.value - half, 0.0), self.value + half

    def row(self) -> dict[str, Any]:
        """Plain data: lengths in mm with uncertainties in µm, angles in degrees; None for what is unknown."""
        unit, scale = ("deg", 180 / np.pi) if self.description.kind == "angle" else ("mm", 1e3)
        fine, fine_scale = ("deg", scale) if unit == "deg" else ("um", 1e6)
        one, m = self.description, self.measured
        values = {
            f"nominal_{unit}": None if m is None or not one.is_size else scale * self.nominal,
            f"low_{unit}": scale * self.low if one.is_size else None,
            f"high_{unit}": scale * self.high,
            f"value_{unit}": scale * self.value,
            f"interval_low_{unit}": scale * self.interval[0],
            f"interval_high_{unit}": scale * self.interval[1],
            f"uncertainty_{fine}": fine_scale * self.uncertainty,
            f"by_noise_{fine}": None if m is None else fine_scale * m.random,
            f"by_cell_{fine}": fine_scale * self.effect.deviation,
            f"by_calibration_{fine}": fine_scale * self.calibration,
            f"by_temperature_{fine}": fine_scale * self.temperature,
            f"correction_{fine}": None if m is None else fine_scale * (m.value - self.effect.bias - m.raw),
            "probability": self.probability,
        }
        return {
            "name": one.name,
            "kind": one.kind,
            "verdict": self.verdict,
            **{key: float(v) if v is not None and np.isfinite(v) else None for key, v in values.items()},
            "faces": " ".join(map(str, one.faces)) + (" to " + " ".join(map(str, one.to)) if one.to else ""),
            "datums": " | ".join(one.datums),
            "points": 0 if m is None else m.points,
            "method": self.reason if m is None else m.method,
        }

    @property
    def nominal(self) -> float:
        """Nominal value, m or rad: the described one, or that of the CAD part."""
        return _nominal(self.description, self.measured)


@dataclass(frozen=True, eq=False, repr=False)
class Inspection(SavedResult):
    """Verdicts on the characteristics of a part; `save` writes ``inspection.json``, ``.csv``, ``.qif`` and ``.html``.

    Attributes
    ----------
    description
        What was inspected.
    decisions
        One for each characteristic, in its order.
    part
        The CAD part.
    part_from_cloud
        (4, 4) alignment of the cloud, by which its points were allotted to faces.
    align
        How points found their faces.
    warnings
        What is doubtful.
    source
        Format of the cloud, and its records.

    Examples
    --------
    >>> inspection = scancell.inspect("run", "part.step", "characteristics.toml")  # doctest: +SKIP
    >>> inspection.decisions[0].verdict  # doctest: +SKIP
    'conforms'
    """

    description: InspectionDescription
    decisions: tuple[Decision, ...]
    part: CadMesh
    part_from_cloud: Array
    align: Align
    warnings: tuple[str, ...] = ()
    source: Mapping[str, Any] = field(default_factory=dict)

    @property
    def counts(self) -> dict[Verdict, int]:
        """Number of characteristics by verdict, those that occur."""
        order: tuple[Verdict, ...] = ("does not conform", "cannot be decided", "not evaluated", "conforms")
        found = [one.verdict for one in self.decisions]
        return {verdict: found.count(verdict) for verdict in order if verdict in found}

    @property
    def figures(self) -> dict[str, Any]:
        """Rule, alignment and rows, as in ``inspection.json``."""
        rule = self.description
        return {
            "part": self.part.source,
            "cloud": dict(self.source),
            "rule": rule.decision,
            "probability": rule.probability,
            "alignment": {"part_from_cloud_m": self.part_from_cloud.tolist(), "method": self.align},
            "filter_mm": rule.filter_mm,
            "reach_mm": rule.reach_mm,
            "edge_mm": rule.edge_mm,
            "temperature": rule.temperature.model_dump(),
            "verdicts": dict(self.counts),
            "characteristics": [one.row() for one in self.decisions],
        }

    def faces(self, one: Decision) -> tuple[list[int], list[int]]:
        """Numbers, from 0, of the faces of a characteristic, and of its datums."""
        numbers, datums = _Faces(self.part, self.description, ""), {d.name: d.faces for d in self.description.datum}
        own = numbers.numbers((*one.description.faces, *one.description.to))
        return own, [number for name in one.description.datums for number in numbers.numbers(datums[name])]

    def summary(self) -> str:
        """Verdicts, values and uncertainties as lines of text."""
        counts = ", ".join(f"{count} {verdict}" for verdict, count in self.counts.items())
        lines = [f"{Path(self.part.source).name}: {counts}"]
        width = max(len(one.description.name) for one in self.decisions)
        for one in self.decisions:
            about = f"{one.description.name:{width}}  {one.description.kind:17}  {one.verdict:17}"
            lines.append(f"  {about}  {value_text(one)}; {limits_text(one)}")
        return "\n".join(lines)

    def picture(self) -> bytes:
        """The part, its faces in the colours of their verdicts, as PNG."""
        from scancell.inspection.report import part_picture  # noqa: PLC0415  (imports OpenCV)

        return part_picture(self).png()

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        from scancell.inspection.qif import write_qif  # noqa: PLC0415  (imports this module)
        from scancell.inspection.report import write_report  # noqa: PLC0415  (imports OpenCV)

        write_json(folder.path("inspection.json"), {**self.figures, "command_line": command_line})
        write_csv(folder.path("inspection.csv"), columns_of([one.row() for one in self.decisions]))
        write_qif(self, folder.path("inspection.qif"))
        write_report(self, folder.path("inspection.html"))


def _unit(one: Decision) -> tuple[str, float, str, float]:
    """Unit and factor of values, and of uncertainties."""
    if one.description.kind == "angle":
        return "\N{DEGREE SIGN}", 180 / np.pi, "\N{DEGREE SIGN}", 180 / np.pi
    return " mm", 1e3, " um", 1e6


def value_text(one: Decision) -> str:
    """Value with its expanded uncertainty (coverage factor 2), or why there is none."""
    if one.measured is None:
        return one.reason
    unit, scale, fine, fine_scale = _unit(one)
    return f"{scale * one.value:.4f}{unit} ± {2 * fine_scale * one.uncertainty:.2g}{fine}"


def limits_text(one: Decision) -> str:
    """Limits of a size, or the tolerance."""
    unit, scale, _, _ = _unit(one)
    low, high = (f"{scale * limit:.10g}{unit}" for limit in (one.low, one.high))
    if not np.isfinite(one.low):
        return f"at most {high}" if np.isfinite(one.high) else ""
    return f"{low} to {high}" if np.isfinite(one.high) else f"at least {low}"


def loaded_description(
    characteristics: str | Path | InspectionDescription | None, part: CadMesh
) -> tuple[InspectionDescription, str, list[str]]:
    """Description of an inspection, by default that of the annotations of the part; its file; and what is left out.

    Raises `DescriptionError` naming what is wrong.
    """
    if isinstance(characteristics, InspectionDescription):
        return characteristics, "", []
    if characteristics is not None:
        return InspectionDescription.from_toml(characteristics), str(characteristics), []
    described, left = annotated(part)
    left = [f"not inspected: {text}" for text in left]
    if described is None:
        reason = f": {'; '.join(left)}" if left else ""
        raise DescriptionError(
            f"{part.source} states no tolerance that can be inspected{reason}",
            key="characteristics",
            expected="a description (TOML)",
        )
    return described, part.source, left


def inspect_part(
    part: CadMesh,
    points: Array,
    description: InspectionDescription,
    *,
    profile: NDArray[Any] | None = None,
    align: Align = "best-fit",
    effects: Mapping[str, Effect] | None = None,
    calibrated: Displacements | None = None,
    source: str = "",
    threads: int = 0,
) -> Inspection:
    """Verdict on each characteristic of a part by points (n, 3), m.

    Raises `DescriptionError` if a face is not one of the part; `FitError` if the points cannot be aligned.

    Parameters
    ----------
    profile
        (n,) number of the profile of each point, whose points share errors; None: unknown.
    align
        ``best-fit``, by which the points are allotted to faces; or ``none``, for points in the frame of the part.
        Values follow from the datums and not from this alignment.
    effects
        Further effects by name of the characteristic, see `scancell.capability`.
    calibrated
        Displacements of points by the independent errors of a calibration.
    source
        File of the description, for messages.
    """
    found = _Faces(part, description, source)
    warnings = list(part.warnings)
    moved = np.eye(4)
    if align == "best-fit":
        surface = PartSurface(part)
        moved, more = best_fit_of_starts(points, lambda at: surface.nearest(at, threads), part.bounds)
        warnings += more
    elif align != "none":
        raise DescriptionError(
            key="align", value=align, expected="best-fit or none; datums follow from the description"
        )
    temperature = description.temperature
    shrink = 1 / (1 + 1e-6 * temperature.expansion_ppm_k * (temperature.part_c - _REFERENCE))
    cold = pose.transform_points(moved, points) * shrink
    reach, edge = 1e-3 * description.reach_mm, 1e-3 * description.edge_mm
    measured = MeasuredPart.of(part, cold, profile, reach, threads)
    if effects is None and calibrated is None:
        warnings.append("uncertainties are those by noise alone: errors of the cell need a capability or calibration")
    decisions = []
    scale = float(
        np.hypot(
            1e-6 * temperature.expansion_ppm_k * temperature.part_uncertainty_k,
            1e-6 * temperature.expansion_uncertainty_ppm_k * (temperature.part_c - _REFERENCE),
        )
    )
    by_calibration: dict[str, float] = {}
    if calibrated is not None:
        by_calibration = _by_calibration(
            found, measured, edge, threads, lambda rows: shrink * calibrated(rows) @ moved[:3, :3].T
        )
    features = _Features(found, measured, edge, threads)
    larger = _Features(found, measured.scaled(1 + _SCALE), edge, threads)
    for one in description.characteristic:
        effect = (effects or {}).get(one.name, Effect())
        nesting = _nesting(description, one)
        try:
            value = features.measure(one, nesting)
        except FitError as error:
            decisions.append(Decision(one, None, *_limits(one, None), reason=str(error)))
            continue
        by_temperature = 0.0
        if scale > _LEAST_SCALE:
            by_temperature = abs(larger.measure(one, nesting).raw - value.raw) / _SCALE * scale
        of_calibration = by_calibration.get(one.name, 0.0)
        decisions.append(_decided(one, value, effect, by_temperature, of_calibration, description))
    names = [one.name for one in description.characteristic]
    if unknown := sorted((effects or {}).keys() - {*names}):
        warnings.append(f"effects of characteristics that are not inspected: {', '.join(unknown)}")
    if effects and (missing := [name for name in names if name not in effects]):
        warnings.append(
            f"uncertainty without errors of the cell, of which there is no capability: {', '.join(missing)}"
        )
    return Inspection(description, tuple(decisions), part, moved, align, tuple(warnings))


@dataclass(frozen=True)
class _Faces:
    """Numbers of the faces that a description names."""

    part: CadMesh
    description: InspectionDescription
    source: str

    def __post_init__(self) -> None:
        """Refuse faces that the part does not have, before the work."""
        for number, datum in enumerate(self.description.datum, 1):
            self.numbers(datum.faces, f"datum[{number}].faces")
        for number, one in enumerate(self.description.characteristic, 1):
            own = self.numbers(one.faces, f"characteristic[{number}].faces")
            key = f"characteristic[{number}].to"
            if common := sorted({*own} & {*self.numbers(one.to, key)}):
                raise DescriptionError(
                    file=self.source or None, key=key, value=common[0], expected="another feature than that of faces"
                )

    def numbers(self, words: Sequence[int | str], key: str = "faces") -> list[int]:
        """Numbers of faces, from 0."""
        try:
            return find_faces(self.part, words)
        except MeshError as error:
            raise DescriptionError(str(error), file=self.source or None, key=key) from None


class _Features:
    """Features of a measured part, each made once."""

    def __init__(self, faces: _Faces, measured: MeasuredPart, edge: float, threads: int) -> None:
        self._faces, self._measured, self._edge, self._threads = faces, measured, edge, threads
        self._made: dict[tuple[int | str, ...], Feature] = {}

    def measure(self, one: CharacteristicDescription, nesting: float) -> Measured:
        """Value of a characteristic; raises `FitError` as `measure` does."""
        datums = {datum.name: datum for datum in self._faces.description.datum}
        system = [self._feature(name, datums[name].faces) for name in one.datums]
        for feature in system:
            if feature.kind not in ("plane", "cylinder", "cone", "sphere"):
                raise FitError(f"datum '{feature.name}' is a {feature.kind}; planes, axes and centres are datums")
            if len(feature.points) < LEAST_POINTS:
                count = len(feature.points)
                raise FitError(f"datum '{feature.name}' has {count} points; at least {LEAST_POINTS} are needed")
        other = self._feature(one.name, one.to) if one.to else None
        feature = self._feature(one.name, one.faces)
        return measure(one, feature, other, DatumSystem(tuple(system)) if system else None, nesting)

    def _feature(self, name: str, words: Sequence[int | str]) -> Feature:
        key = (name, *words)
        if key not in self._made:
            numbers = self._faces.numbers(words)
            self._made[key] = self._measured.feature(name, numbers, self._edge, self._threads)
        return self._made[key]


def _nesting(description: InspectionDescription, one: CharacteristicDescription) -> float:
    return 1e-3 * (description.filter_mm if one.filter_mm is None else one.filter_mm)


def _by_calibration(
    faces: _Faces, measured: MeasuredPart, edge: float, threads: int, displacements: Displacements
) -> dict[str, float]:
    """Standard uncertainty of each characteristic by independent errors that displace all points at once.

    The points of each face are thinned: such errors vary slowly over a face. The characteristic is measured again with
    each error of either sign. Where the value is linear in the error, the root mean square change is the derivative;
    zones, whose widths change with either sign, have their root mean square error.
    """
    order = np.argsort(measured.face, kind="stable")
    ends = np.searchsorted(measured.face[order], np.arange(len(measured.part.cad_faces) + 1))
    kept = [order[a:b][:: max(1, -((a - b) // _MOST_ON_FACE))] for a, b in pairwise(ends)]
    rows = np.sort(np.concatenate(kept))
    part = replace(measured, points=measured.points[rows], profile=measured.profile[rows], face=measured.face[rows])
    changed = [
        _Features(faces, replace(part, points=part.points + sign * one), edge, threads)
        for one in displacements(rows)
        for sign in (1, -1)
    ]
    plain, found = _Features(faces, part, edge, threads), {}
    for one in faces.description.characteristic:
        nesting = _nesting(faces.description, one)
        with suppress(FitError):  # the reason is that of the measurement with all points
            value = plain.measure(one, nesting).raw
            squares = [(each.measure(one, nesting).raw - value) ** 2 for each in changed]
            found[one.name] = float(np.sqrt(sum(squares) / 2))
    return found


def _limits(one: CharacteristicDescription, measured: Measured | None) -> tuple[float, float]:
    """Limits, m or rad."""
    if not one.is_size:
        assert one.tolerance_mm is not None
        return -np.inf, 1e-3 * one.tolerance_mm
    unit, scale = ("deg", np.pi / 180) if one.kind == "angle" else ("mm", 1e-3)
    lower, upper = getattr(one, f"lower_{unit}"), getattr(one, f"upper_{unit}")
    nominal = _nominal(one, measured)
    return (
        -np.inf if lower is None else nominal + scale * lower,
        np.inf if upper is None else nominal + scale * upper,
    )


def _nominal(one: CharacteristicDescription, measured: Measured | None) -> float:
    given = one.nominal_deg if one.kind == "angle" else one.nominal_mm
    if given is not None:
        return given * (np.pi / 180 if one.kind == "angle" else 1e-3)
    return float("nan") if measured is None else measured.nominal


def _decided(
    one: CharacteristicDescription,
    measured: Measured,
    effect: Effect,
    by_temperature: float,
    by_calibration: float,
    rule: InspectionDescription,
) -> Decision:
    """Verdict by probabilities of a normal distribution about the value (ISO 14253-1, JCGM 106).

    Nonconformance is that beyond one of the limits: a value much less certain than the tolerance proves none.
    """
    if one.kind == "angle" and one.nominal_deg is not None:
        # Drawings state the angle of either side.
        given, other = np.radians(one.nominal_deg), np.pi - measured.nominal
        if abs(other - given) < abs(measured.nominal - given):
            measured = replace(measured, value=np.pi - measured.value, raw=np.pi - measured.raw, nominal=other)
    low, high = _limits(one, measured)
    effect = effect if one.is_size else effect.of_zone
    plain = Decision(one, measured, low, high, effect, by_temperature, by_calibration)
    value, deviation = plain.value, plain.uncertainty
    if rule.decision == "simple" or deviation == 0.0:
        inside = low <= value <= high
        probability = float(inside) if deviation == 0.0 else _probability(value, deviation, low, high)
        verdict: Verdict = "conforms" if inside else "does not conform"
    else:
        probability = _probability(value, deviation, low, high)
        verdict = "cannot be decided"
        if probability >= rule.probability:
            verdict = "conforms"
        elif max(ndtr((low - value) / deviation), ndtr((value - high) / deviation)) >= rule.probability:
            verdict = "does not conform"
    return replace(plain, probability=probability, verdict=verdict)


def _probability(value: float, deviation: float, low: float, high: float) -> float:
    return float(ndtr((high - value) / deviation) - ndtr((low - value) / deviation))
