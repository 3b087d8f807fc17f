"""Descriptions of studies and batches: the factors that vary, the design of the trials, and the figures to evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from scancell.config.choices import CalibrationTarget, Engine
from scancell.config.description import Coordinate, Description, Fraction, Number, Size, refuse_twins, validate
from scancell.config.loading import override, read_toml
from scancell.errors import DescriptionError

VariationMode = Literal["additive", "relative", "absolute"]
_Count = Annotated[int, Field(ge=1, le=1_000_000)]
_Deviation = Annotated[float, Field(ge=1e-15, le=1e15)]
_WholeNumber = Annotated[int, Field(ge=-(10**15), le=10**15)]
_Levels = Annotated[int, Field(ge=2, le=1000)]
_MODE: Any = Field(
    default="additive",
    description="additive: nominal + x; relative: nominal * (1 + x); absolute: x replaces the nominal value",
)

_NAMED = "factors, blocks and spheres"
# Designs whose number of points follows from the factors.
_COUNTED = ("full_factorial", "one_at_a_time")
CloudFormat = Literal["ply", "npz", "laz", "e57", "pcd", "xyz"]


class NormalDescription(Description):
    """Normal distribution, in the unit of the factor's path."""

    kind: Literal["normal"] = Field(description="type of distribution")
    mean: Number = Field(default=0.0, description="mean, in the unit of the path")
    std: _Deviation = Field(description="standard deviation")


class UniformDescription(Description):
    """Uniform distribution between two bounds, in the unit of the factor's path."""

    kind: Literal["uniform"] = Field(description="type of distribution")
    low: Number = Field(description="lower bound")
    high: Number = Field(description="upper bound")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low ({self.low:g}) must be below high ({self.high:g})")
        return self


class TruncatedNormalDescription(UniformDescription):
    """Normal distribution truncated at low and high; mean and std are those before truncation."""

    kind: Literal["truncated_normal"] = Field(description="type of distribution")  # type: ignore[assignment]
    mean: Number = Field(default=0.0, description="mean before truncation")
    std: _Deviation = Field(description="standard deviation before truncation")


class DiscreteDescription(Description):
    """One of several values; equally likely unless weights are given."""

    kind: Literal["discrete"] = Field(description="type of distribution")
    values: Annotated[
        tuple[bool | _WholeNumber | Number | str, ...], Field(min_length=1, description="possible values")
    ]
    weights: tuple[Annotated[float, Field(ge=0.0, le=1e15)], ...] | None = Field(
        default=None, description="relative probabilities of the values"
    )

    @model_validator(mode="after")
    def _matching(self) -> Self:
        if self.weights is not None and (len(self.weights) != len(self.values) or sum(self.weights) <= 0):
            raise ValueError(f"weights: expected {len(self.values)} weights with a sum above 0")
        return self


DistributionDescription = Annotated[
    NormalDescription | UniformDescription | TruncatedNormalDescription | DiscreteDescription,
    Field(discriminator="kind"),
]


class FactorDescription(Description):
    """A quantity that varies: a key of cell, sensor or scan, or a deviation ``as_built.*`` of the true cell."""

    path: str = Field(description="like --set and --as-built: cell.part.reflectance, as_built.tool.x_mm")
    name: str | None = Field(default=None, description="label in tables and reports; the path unless given")
    mode: VariationMode = _MODE
    distribution: DistributionDescription = Field(description="distribution of x, see mode")

    @model_validator(mode="after")
    def _numbers_add(self) -> Self:
        values = getattr(self.distribution, "values", ())
        odd = [value for value in values if isinstance(value, bool | str)]
        if odd and self.mode != "absolute":
            raise ValueError(f'values: {odd[0]!r} is not a number; only mode = "absolute" accepts it')
        return self

    @property
    def label(self) -> str:
        """Label in tables and reports."""
        return self.name or self.path


class BlockDescription(Description):
    """Correlated normally distributed factors: give covariance, or std and correlation."""

    paths: Annotated[tuple[str, ...], Field(min_length=2, description="paths as in [[factor]]")]
    mode: VariationMode = _MODE
    mean: tuple[Number, ...] | None = Field(default=None, description="means; 0 unless given")
    covariance: tuple[tuple[Number, ...], ...] | None = Field(default=None, description="covariance matrix, row by row")
    std: tuple[_Deviation, ...] | None = Field(default=None, description="standard deviations")
    correlation: tuple[tuple[Number, ...], ...] | None = Field(
        default=None, description="correlation matrix, row by row"
    )

    @model_validator(mode="after")
    def _a_covariance(self) -> Self:
        size = len(self.paths)
        if (self.covariance is None) == (self.std is None or self.correlation is None):
            raise ValueError("give either covariance, or std and correlation")
        if self.covariance is not None and (self.std is not None or self.correlation is not None):
            raise ValueError("give either covariance, or std and correlation")
        for name in ("mean", "std"):
            values = getattr(self, name)
            if values is not None and len(values) != size:
                raise ValueError(f"{name}: expected {size} numbers, one per path, got {len(values)}")
        name = "correlation" if self.covariance is None else "covariance"
        rows = getattr(self, name)
        if len(rows) != size or any(len(row) != size for row in rows):
            raise ValueError(f"{name}: expected {size} rows of {size} numbers")
        matrix = np.array(rows)
        if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix).min() < -1e-9 * np.abs(matrix).max():
            raise ValueError(f"{name}: expected a symmetric matrix without negative eigenvalues")
        if np.diag(matrix).min() <= 0 or (name == "correlation" and not np.allclose(np.diag(matrix), 1)):
            raise ValueError(
                f"{name}: expected {'ones' if name == 'correlation' else 'variances above 0'} on the diagonal"
            )
        return self

    @property
    def covariance_matrix(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Covariance matrix (paths, paths)."""
        if self.covariance is not None:
            return np.array(self.covariance)
        std = np.array(self.std)
        return np.asarray(np.array(self.correlation) * np.outer(std, std))


class DesignDescription(Description):
    """Design of experiments: the points that the trials evaluate.

    `trials` is the number of draws of monte_carlo and latin_hypercube, of base samples of sobol (a power of 2; each has
    factors + 2 trials) and of trajectories of morris (each has factors + 1). `levels` applies to full_factorial,
    one_at_a_time and morris, which place the levels of a factor at equal steps of its probability between the two
    `quantiles`.
    """

    kind: Literal["monte_carlo", "latin_hypercube", "sobol", "full_factorial", "one_at_a_time", "morris"] = Field(
        description="type of the design"
    )
    trials: _Count = Field(default=100, description="number of draws, base samples or trajectories")
    levels: _Levels = Field(default=4, description="levels of each factor")
    quantiles: tuple[Fraction, Fraction] = Field(
        default=(0.025, 0.975), description="probabilities of the lowest and the highest level"
    )

    @model_validator(mode="after")
    def _suits_the_kind(self) -> Self:
        low, high = self.quantiles
        if not 0.0 < low < high < 1.0:
            raise ValueError(f"quantiles ({low:g}, {high:g}): expected two rising numbers between 0 and 1")
        if self.kind == "sobol" and self.trials & (self.trials - 1):
            raise ValueError(f"trials ({self.trials}): the Sobol' sequence is balanced for powers of 2 only")
        if self.kind == "morris" and self.levels % 2:
            raise ValueError(
                f"levels ({self.levels}): Morris's method steps by half of the levels: an even number is needed"
            )
        return self


class VaryingScansDescription(Description):
    """Common inputs of many scans, and what varies between them. Paths of files are relative to this description."""

    unit: Literal["mm", "m", "inch"] = Field(default="mm", description="unit of the mesh files")
    cell: str | None = Field(default=None, description="cell description; the shipped default unless given")
    sensor: str | None = Field(default=None, description="sensor description; the shipped default unless given")
    scan: str | None = Field(default=None, description="scan description; the shipped default unless given")
    set: tuple[str, ...] = Field(default=(), description="changes of the nominal descriptions, as for --set")
    as_built: tuple[str, ...] = Field(
        default=(), description="deviations of the true cell in all scans, as for --as-built"
    )
    ideal: bool = Field(default=False, description="switch off all noise but speckle")
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = Field(default=0, description="random seed")
    design: DesignDescription = Field(description="design of experiments")
    factor: tuple[FactorDescription, ...] = Field(default=(), description="independent factors")
    block: tuple[BlockDescription, ...] = Field(default=(), description="correlated factors")

    @property
    def labels(self) -> list[str]:
        """Labels of all factors."""
        return [factor.label for factor in self.factor] + [path for block in self.block for path in block.paths]

    @model_validator(mode="after")
    def _factors_suit_the_design(self) -> Self:
        refuse_twins(self.labels, _NAMED)
        if self.block and self.design.kind not in {"monte_carlo", "latin_hypercube"}:
            raise ValueError(f"design {self.design.kind} needs independent factors; a [[block]] is correlated")
        return self


class FittedSphereDescription(Description):
    """A sphere of the part whose fitted position, size and form are figures; in the coordinates of the mesh file."""

    name: str = Field(default="sphere", description="prefix of the figures")
    centre_mm: tuple[Coordinate, Coordinate, Coordinate] = Field(description="nominal centre")
    radius_mm: Size = Field(description="nominal radius")
    reach_mm: Size = Field(default=1.0, description="largest distance of used points from the nominal surface")
    above_mm: Coordinate | None = Field(default=None, description="smallest z of used points; all unless given")


class CalibrateDescription(Description):
    """Calibration of every trial's cell before its scan; the scan is reconstructed with the result."""

    what: CalibrationTarget = Field(
        default="all", description="what is calibrated: tool, grasp, table, belt, latency, or all"
    )
    artefact: str | None = Field(
        default=None, description="file of the artefact (TOML) or of the mesh of any part; default: a shipped one"
    )
    also: tuple[str, ...] = Field(default=(), description="further deviations to estimate, such as dh[3].theta")
    wobble: bool = Field(default=False, description="whether the wobble of the table axis is also estimated")
    poses: Annotated[int, Field(ge=0, le=10_000)] | None = Field(
        default=None, description="exposures at rest; default 24, none for latency"
    )
    passes: Annotated[int, Field(ge=0, le=1000)] | None = Field(
        default=None, description="passes in motion; default 8 for latency and all, else none"
    )
    axis_positions: Annotated[int, Field(ge=1, le=100)] = Field(
        default=4, description='positions of further axes at which their deviations (also = ["axis.NAME"]) are measured'
    )
    pose: Literal["described", "unknown"] | None = Field(
        default=None,
        description="whether the pose of the artefact is taken from the cell or estimated; default as in the command",
    )


class StudyDescription(VaryingScansDescription):
    """A study of one part. Paths of files are relative to the study's own."""

    name: str = Field(description="title of the report, and name of the default folder of the results")
    part: str = Field(description="mesh file of the part")
    engine: Engine = Field(
        default="geometric", description="ray-traced: rendered camera images; geometric: ray intersections"
    )
    ray_traced_trials: Annotated[int, Field(ge=0, le=10_000_000)] = Field(
        default=0, description="number of first trials of a geometric study to repeat with rendered images"
    )
    noise: Literal["per_trial", "common"] = Field(
        default="per_trial", description="common: the noise of sensor and encoders is the same in all trials"
    )
    trials_per_task: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=1, description="trials per task and file of results"
    )
    coverage_samples: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=4000, description="surface samples for coverage; 0 disables"
    )
    probability: Annotated[float, Field(gt=0.0, lt=1.0)] = Field(
        default=0.95, description="coverage probability of all intervals"
    )
    calibrate: CalibrateDescription | None = Field(
        default=None, description="calibration of the cell in every trial, before the scan"
    )
    sphere: tuple[FittedSphereDescription, ...] = Field(default=(), description="spheres to fit")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.labels:
            raise ValueError("nothing varies: add at least one [[factor]] or [[block]]")
        refuse_twins([*self.labels, *(sphere.name for sphere in self.sphere)], _NAMED)
        if self.ray_traced_trials and self.engine == "ray-traced":
            raise ValueError('ray_traced_trials repeats trials of engine = "geometric"; here all trials are ray-traced')
        return self


def load_study(path: Path, settings: Sequence[str] = ()) -> StudyDescription:
    """Read and check a study; `settings` are words like ``design.trials=20``.

    Raises `DescriptionError` naming file, key, value and what was expected.
    """
    raw = read_toml(path)
    origins = [override(raw, word, "settings") for word in settings]
    study = validate(StudyDescription, raw, str(path), origins)
    if study.calibrate is None or study.calibrate.artefact is None:
        return study
    artefact = (path.parent / study.calibrate.artefact).resolve()
    if not artefact.is_file():
        raise DescriptionError(
            f"no such file ({artefact})", file=path, key="calibrate.artefact", value=study.calibrate.artefact
        )
    return study.replace({"calibrate.artefact": str(artefact)})


class BatchDescription(VaryingScansDescription):
    """A batch of parts. Without factors, the variants of a part differ only in their noise."""

    engine: Engine = Field(
        default="ray-traced", description="ray-traced: rendered camera images; geometric: ray intersections"
    )
    design: DesignDescription = Field(
        default=DesignDescription(kind="monte_carlo", trials=1), description="variants of every part"
    )
    formats: Annotated[tuple[CloudFormat, ...], Field(min_length=1)] = Field(
        default=("ply",), description="file formats of the clouds"
    )
    images: bool = Field(default=False, description="keep the images of all cameras; ray-traced engine only")
    truth: bool = Field(default=True, description="write the ground truth of points, pixels and poses")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.images and self.engine != "ray-traced":
            raise ValueError(f'images: engine = "{self.engine}" renders none; use "ray-traced"')
        if not self.labels and self.design.kind != "monte_carlo":
            raise ValueError(f"design {self.design.kind} needs at least one [[factor]]; otherwise use monte_carlo")
        return self


def load_batch(path: Path | None, changes: Mapping[str, Any], variants: int | None = None) -> BatchDescription:
    """Read and check a batch, or take all defaults; `changes` replace keys, `variants` the trials of its design.

    Raises `DescriptionError` naming file, key, value and what was expected.
    """
    source = "batch" if path is None else str(path)
    raw = {**({} if path is None else read_toml(path)), **changes}
    design = raw.setdefault("design", {"kind": "monte_carlo", "trials": 1})
    if variants is not None and isinstance(design, dict):
        if design.get("kind") in _COUNTED:
            raise DescriptionError(
                f"{source}: a {design['kind']} design fixes their number", key="variants", value=variants
            )
        design["trials"] = variants
    return validate(BatchDescription, raw, source)
