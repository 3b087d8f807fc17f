"""Descriptions of an inspection: datums, toleranced characteristics, temperature, and the rule of decision."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self, get_args

from pydantic import Field, model_validator

from scancell.config.description import Angle, Coordinate, Description, Length, refuse_twins, validate
from scancell.config.files import read_toml
from scancell.config.scan import FaceName, FeatureGoalDescription

SizeKind = Literal["diameter", "radius", "distance", "angle"]
FormKind = Literal["straightness", "flatness", "roundness", "cylindricity"]
OrientationKind = Literal["parallelism", "perpendicularity", "angularity"]
LocationKind = Literal["position", "coaxiality", "symmetry"]
RunOutKind = Literal["circular_run_out", "total_run_out"]
CharacteristicKind = Literal[SizeKind, FormKind, OrientationKind, LocationKind, RunOutKind, "surface_profile"]
Criterion = Literal["least squares", "minimum zone", "minimum circumscribed", "maximum inscribed"]

_SHARE_OF_ZONE = 0.9  # of the faces of a zone, which views should see
_NEEDS_DATUM = (*get_args(OrientationKind), *get_args(LocationKind), *get_args(RunOutKind))
_Faces = Annotated[tuple[FaceName, ...], Field(min_length=1)]


class DatumDescription(Description):
    """Datum: the least-squares plane, axis or centre of faces of the part (ISO 5459).

    Examples
    --------
    >>> scancell.DatumDescription(name="A", faces=(4,)).faces
    (4,)
    """

    name: Annotated[str, Field(min_length=1)] = Field(description="letter of the datum")
    faces: _Faces = Field(description="faces by number, from 0, or by label")


class CharacteristicDescription(Description):
    """A toleranced characteristic of one feature, or of two.

    Sizes have deviations `upper` and `lower` from the nominal value, of which one may be missing; form, orientation,
    location, run-out and profile have a `tolerance_mm`.

    Examples
    --------
    >>> scancell.CharacteristicDescription(name="top", kind="flatness", faces=(4,), tolerance_mm=0.01).needs_datums
    False
    """

    name: Annotated[str, Field(min_length=1)] = Field(description="name in the report")
    kind: CharacteristicKind = Field(description="kind of characteristic (ISO 14405, ISO 1101)")
    faces: _Faces = Field(description="faces of the feature by number, from 0, or by label")
    to: tuple[FaceName, ...] = Field(
        default=(), description="faces of the second feature, of a distance, an angle or a symmetry"
    )
    datums: tuple[str, ...] = Field(default=(), description="names of datums in order of precedence, three at most")
    tolerance_mm: Annotated[float, Field(gt=0.0, le=100_000.0)] | None = Field(
        default=None, description="width or diameter of the tolerance zone, mm"
    )
    nominal_mm: Length | None = Field(default=None, description="nominal size, mm; that of the CAD part unless given")
    upper_mm: Coordinate | None = Field(default=None, description="upper limit deviation, mm")
    lower_mm: Coordinate | None = Field(default=None, description="lower limit deviation, mm")
    nominal_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = Field(
        default=None, description="nominal angle, deg; that of the CAD part unless given"
    )
    upper_deg: Angle | None = Field(default=None, description="upper limit deviation, deg")
    lower_deg: Angle | None = Field(default=None, description="lower limit deviation, deg")
    criterion: Criterion = Field(
        default="least squares", description="association of a diameter or radius with the points"
    )
    filter_mm: Length | None = Field(
        default=None, description="nesting index of the Gaussian filter, mm; that of the inspection unless given"
    )

    @property
    def is_size(self) -> bool:
        """Whether it has limits on both sides of a nominal value."""
        return self.kind in get_args(SizeKind)

    @property
    def needs_datums(self) -> bool:
        """Whether the kind is defined by datums; a profile may have none."""
        return self.kind in _NEEDS_DATUM

    @model_validator(mode="after")
    def _limits_suit_the_kind(self) -> Self:
        unit = "deg" if self.kind == "angle" else "mm"
        own = ("nominal", "upper", "lower")
        wrong = [f"{name}_{other}" for other in {"mm", "deg"} - {unit} for name in own]
        wrong += [f"{name}_{unit}" for name in own] if not self.is_size else ["tolerance_mm"]
        for key in wrong:
            if getattr(self, key) is not None:
                raise ValueError(f"{self.kind} has no {key}")
        if not self.is_size:
            if self.tolerance_mm is None:
                raise ValueError(f"{self.kind} needs tolerance_mm")
            return self
        upper, lower = getattr(self, f"upper_{unit}"), getattr(self, f"lower_{unit}")
        if upper is None and lower is None:
            raise ValueError(f"{self.kind} needs upper_{unit}, lower_{unit} or both")
        if upper is not None and lower is not None and lower >= upper:
            raise ValueError(f"lower_{unit} ({lower:g}) must be below upper_{unit} ({upper:g})")
        return self

    @model_validator(mode="after")
    def _features_suit_the_kind(self) -> Self:
        if self.kind in ("distance", "angle", "symmetry"):
            if not self.to:
                raise ValueError(f"{self.kind} needs the faces of a second feature: to")
        elif self.to:
            raise ValueError(f"{self.kind} has one feature; to is for distance, angle and symmetry")
        if self.criterion != "least squares" and self.kind not in ("diameter", "radius"):
            raise ValueError(f"{self.kind} has no criterion; it is for diameter and radius")
        if self.datums and (self.is_size or self.kind in get_args(FormKind)):
            raise ValueError(f"{self.kind} has no datums")
        if not self.datums and self.needs_datums:
            raise ValueError(f"{self.kind} needs datums")
        if len(self.datums) > 3 or len(set(self.datums)) < len(self.datums):
            raise ValueError("datums: at most three, each once")
        return self


class TemperatureDescription(Description):
    """Temperature of the part during the scan; sizes are stated at 20 °C (ISO 1).

    The sensor is assumed to measure true lengths: what temperature does to it belongs to its calibration.
    """

    part_c: Annotated[float, Field(ge=-100.0, le=500.0)] = Field(default=20.0, description="temperature, °C")
    part_uncertainty_k: Annotated[float, Field(ge=0.0, le=100.0)] = Field(
        default=0.0, description="standard uncertainty of the temperature, K"
    )
    expansion_ppm_k: Annotated[float, Field(ge=-100.0, le=1000.0)] = Field(
        default=11.5, description="coefficient of linear expansion, 1e-6/K; steel unless given"
    )
    expansion_uncertainty_ppm_k: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=0.0, description="standard uncertainty of the coefficient, 1e-6/K"
    )


class InspectionDescription(Description):
    """Characteristics and datums of a CAD part to inspect, and the rule of decision.

    Examples
    --------
    >>> bore = scancell.CharacteristicDescription(
    ...     name="bore", kind="diameter", faces=("bore",), upper_mm=0.05, lower_mm=-0.05
    ... )
    >>> scancell.InspectionDescription(characteristic=(bore,)).decision
    'ISO 14253-1'
    """

    decision: Literal["ISO 14253-1", "simple"] = Field(
        default="ISO 14253-1",
        description="ISO 14253-1: a guard band keeps the risk of a wrong verdict; simple: the measured value alone",
    )
    probability: Annotated[float, Field(ge=0.5, lt=1.0)] = Field(
        default=0.95, description="least probability of a verdict by ISO 14253-1"
    )
    filter_mm: Length = Field(
        default=0.8, description="nesting index of the Gaussian filter of zones (ISO 16610), mm; 0: no filter"
    )
    reach_mm: Annotated[float, Field(ge=0.001, le=1000.0)] = Field(
        default=0.5, description="largest distance of used points from their nominal face, mm"
    )
    edge_mm: Length = Field(default=0.3, description="distance from other faces within which points are not used, mm")
    temperature: TemperatureDescription = Field(
        default_factory=TemperatureDescription, description="temperature of the part"
    )
    datum: tuple[DatumDescription, ...] = Field(default=(), description="datums that characteristics name")
    characteristic: Annotated[tuple[CharacteristicDescription, ...], Field(min_length=1, description="characteristics")]

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read and check a file.

        Raises `DescriptionError` naming file, key, value and what was expected.
        """
        return validate(cls, read_toml(Path(path)), str(path))

    def feature_goals(self, share: float = 0.1) -> tuple[FeatureGoalDescription, ...]:
        """Goals of the views for each feature, for ``scan.coverage.feature``.

        Sizes, places and datums: the predicted expanded uncertainty by noise (coverage factor 2) is at most `share` of
        the tolerance. Forms, profiles, orientations and run-outs, whose zones need points everywhere, angles, and
        characteristics with one limit: 90 % of their faces are seen.

        Examples
        --------
        >>> bore = scancell.CharacteristicDescription(
        ...     name="bore", kind="diameter", faces=("bore",), upper_mm=0.05, lower_mm=-0.05
        ... )
        >>> scancell.InspectionDescription(characteristic=(bore,)).feature_goals()[0].deviation_um
        2.5
        """
        datums = {datum.name: datum.faces for datum in self.datum}
        found: dict[tuple[tuple[int | str, ...], str], FeatureGoalDescription] = {}

        def want(
            faces: tuple[int | str, ...],
            deviation: float | None,
            least: float = 0.0,
            of: Literal["place", "size"] = "place",
        ) -> None:
            """Keep the narrower goal."""
            known = found.get((faces, of), FeatureGoalDescription(faces=faces, of=of))
            narrow = min((one for one in (deviation, known.deviation_um) if one is not None), default=None)
            found[faces, of] = known.replace({"deviation_um": narrow, "share": max(least, known.share)})

        for one in self.characteristic:
            tolerance = one.tolerance_mm
            if one.upper_mm is not None and one.lower_mm is not None:
                tolerance = one.upper_mm - one.lower_mm
            features = [one.faces, *([one.to] if one.to else []), *(datums[name] for name in one.datums)]
            if tolerance is None:
                for faces in features:
                    want(faces, None, _SHARE_OF_ZONE)
                continue
            # Uncertainties of the features add up by squares; sizes across a feature count twice.
            across = 2.0 if one.kind in ("diameter", *get_args(LocationKind)) else 1.0
            each = 1e3 * share * tolerance / 2 / across / len(features) ** 0.5
            is_element = one.kind in (*get_args(SizeKind), *get_args(LocationKind))
            for faces in features:
                own = faces in (one.faces, one.to) and not is_element
                of: Literal["place", "size"] = "size" if one.kind in ("diameter", "radius") else "place"
                want(faces, None if own else each, _SHARE_OF_ZONE if own else 0.0, of)
        return tuple(found.values())

    @model_validator(mode="after")
    def _names_are_known_and_differ(self) -> Self:
        letters = [datum.name for datum in self.datum]
        for names, what in ((letters, "datums"), ([one.name for one in self.characteristic], "characteristics")):
            refuse_twins(names, what)
        for number, one in enumerate(self.characteristic, 1):
            for name in one.datums:
                if name not in letters:
                    known = f"one of the datums: {', '.join(letters)}" if letters else "a [[datum]] of this name"
                    raise ValueError(f"characteristic[{number}].datums = '{name}': expected {known}")
        return self
