"""Descriptions of what varies from scan to scan: factors, their distributions, and the designs that draw them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from orchestrator.config.description import Description, Finite, NonNegative, Positive

Mode = Literal["additive", "relative", "absolute"]
_Count = Annotated[int, Field(ge=1, le=10_000_000)]
_Levels = Annotated[int, Field(ge=2, le=1000)]
_MODE: Any = Field(
    default="additive",
    description="additive: nominal + x; relative: nominal * (1 + x); absolute: x takes the nominal's place",
)


class NormalDescription(Description):
    """Normal distribution, in the unit of the factor's path."""

    kind: Literal["normal"]
    mean: Finite = 0.0
    std: Positive


class UniformDescription(Description):
    """Uniform distribution between two bounds, in the unit of the factor's path."""

    kind: Literal["uniform"]
    low: Finite
    high: Finite

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low ({self.low:g}) must be below high ({self.high:g})")
        return self


class TruncatedNormalDescription(UniformDescription):
    """Normal distribution of mean and std before it is cut off at low and high."""

    kind: Literal["truncated_normal"]  # type: ignore[assignment]
    mean: Finite = 0.0
    std: Positive


class DiscreteDescription(Description):
    """One of several values; equally likely unless weights are given."""

    kind: Literal["discrete"]
    values: Annotated[tuple[bool | int | float | str, ...], Field(min_length=1)]
    weights: tuple[NonNegative, ...] | None = None

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
    """One thing that varies: a field of cell, sensor or scan, or a deviation ``as_built.*`` of the true cell."""

    path: str = Field(description="like --set and --as-built: cell.part.reflectance, as_built.tool.x_mm")
    name: str | None = Field(default=None, description="what tables call it; the path unless given")
    mode: Mode = _MODE
    distribution: DistributionDescription

    @model_validator(mode="after")
    def _numbers_add(self) -> Self:
        values = getattr(self.distribution, "values", ())
        odd = [value for value in values if isinstance(value, bool | str)]
        if odd and self.mode != "absolute":
            raise ValueError(f'values: {odd[0]!r} is no number; mode = "absolute" takes values as they are')
        return self

    @property
    def label(self) -> str:
        """What tables call it."""
        return self.name or self.path


class BlockDescription(Description):
    """Several normally distributed factors that vary together; covariance, or std and correlation."""

    paths: Annotated[tuple[str, ...], Field(min_length=2)]
    mode: Mode = _MODE
    mean: tuple[Finite, ...] | None = None
    covariance: tuple[tuple[Finite, ...], ...] | None = None
    std: tuple[Positive, ...] | None = None
    correlation: tuple[tuple[Finite, ...], ...] | None = None

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
        """(paths, paths) whichever way it was given."""
        if self.covariance is not None:
            return np.array(self.covariance)
        std = np.array(self.std)
        return np.asarray(np.array(self.correlation) * np.outer(std, std))


class DesignDescription(Description):
    """Which trials are made.

    `trials` counts the draws of monte_carlo and latin_hypercube, the base samples of sobol (a power of 2; base samples
    times factors + 2 are run) and the trajectories of morris (times factors + 1). `levels` is for full_factorial,
    one_at_a_time and morris, which place a factor's levels at equal steps of its probability between the two
    `quantiles`.
    """

    kind: Literal["monte_carlo", "latin_hypercube", "sobol", "full_factorial", "one_at_a_time", "morris"]
    trials: _Count = 100
    levels: _Levels = 4
    quantiles: tuple[float, float] = Field(default=(0.025, 0.975), description="reach of the levels")

    @model_validator(mode="after")
    def _suits_the_kind(self) -> Self:
        low, high = self.quantiles
        if not 0.0 < low < high < 1.0:
            raise ValueError(f"quantiles ({low:g}, {high:g}): expected two numbers between 0 and 1, rising")
        if self.kind == "sobol" and self.trials & (self.trials - 1):
            raise ValueError(f"trials ({self.trials}): the Sobol' sequence is balanced for powers of 2 only")
        if self.kind == "morris" and self.levels % 2:
            raise ValueError(f"levels ({self.levels}): Morris's method steps by half the levels, so an even number")
        return self


class VaryingScansDescription(Description):
    """What many scans share, and what varies among them. Paths of files are relative to the description's own."""

    unit: Literal["mm", "m", "inch"] = Field(default="mm", description="of the mesh files")
    cell: str | None = None
    sensor: str | None = None
    scan: str | None = None
    set: tuple[str, ...] = Field(default=(), description="changes of the nominal description, as --set takes them")
    as_built: tuple[str, ...] = Field(default=(), description="deviations of the true cell common to all scans")
    ideal: bool = Field(default=False, description="switch off all noise")
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 0
    design: DesignDescription
    factor: tuple[FactorDescription, ...] = ()
    block: tuple[BlockDescription, ...] = ()

    @property
    def labels(self) -> list[str]:
        """What tables call the things that vary."""
        return [factor.label for factor in self.factor] + [path for block in self.block for path in block.paths]

    @model_validator(mode="after")
    def _factors_suit_the_design(self) -> Self:
        refuse_twins(self.labels)
        if self.block and self.design.kind not in {"monte_carlo", "latin_hypercube"}:
            raise ValueError(f"design {self.design.kind} needs independent factors; a [[block]] is correlated")
        return self


def refuse_twins(names: Sequence[str]) -> None:
    """Raise ValueError for a name that is there twice."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"'{twice[0]}' is there twice; names of factors, blocks and spheres must differ")
