"""Factors: from drawn numbers to the descriptions and deviations of one scan.

A factor's path is that of ``--set`` (``cell.``, ``sensor.``, ``scan.``: the nominal description, known to planning and
reconstruction) or begins with ``as_built.`` (only the true cell).
"""

from __future__ import annotations

import copy
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from scancell.arrays import Array
from scancell.cell.fmu_file import parse_as_built
from scancell.config.cell import CellDescription
from scancell.config.description import Description, validate
from scancell.config.loading import (
    FILE_KEYS,
    Setup,
    as_built_delay,
    as_built_sensors,
    load_setup,
    parse_assignment,
    sensor_words,
    split_path,
)
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.config.study import (
    DesignDescription,
    DiscreteDescription,
    DistributionDescription,
    FactorDescription,
    NormalDescription,
    TruncatedNormalDescription,
    UniformDescription,
    VariationMode,
    VaryingScansDescription,
)
from scancell.errors import DescriptionError, require

_DRAWS = 1
_TRIALS = 2
_MOST_TRIALS = 2_000_000

# Probabilities of exactly 0 or 1 have no finite quantile under a normal distribution.
_SMALLEST = 2.0**-53
Value = bool | int | float | str

_QUANTILES = 20_000  # the variance of a normal distribution is 1e-4 too small by these

Units = Mapping[str, str | None]

_AS_BUILT = "as_built."
_SECTIONS: dict[str, type[Description]] = {
    "cell": CellDescription,
    "sensor": SensorDescription,
    "scan": ScanDescription,
}
# Keys of `VaryingScansDescription` that take effect only through the nominal setup.
SETUP_KEYS = (*_SECTIONS, "set", "ideal")


def hashed(seed: int, stream: int, number: int) -> int:
    """64 bits that depend only on the three numbers: the counter-based generator of trials."""
    return int.from_bytes(hashlib.sha256(f"scancell {seed} {stream} {number}".encode()).digest()[:8], "big")


def trial_seed(seed: int, trial: int) -> int:
    """Seed (31 bits) of the random numbers of one trial's sensor and encoders."""
    return hashed(seed, _TRIALS, trial) >> 33


def design(description: DesignDescription, levels_of: Sequence[Array | None], seed: int) -> Array:
    """Probabilities (n, k) of k factors in n trials.

    Parameters
    ----------
    levels_of
        Per factor, the probabilities in the middle of each of its listed values; None for a continuous distribution.

    The rows of ``sobol`` are Saltelli's scheme: for each base sample A, then A with column j taken from B for each j,
    then B; those of ``morris`` its trajectories; the first of ``one_at_a_time`` has all factors at their median.

    Raises `DescriptionError` for more trials than memory holds.
    """
    if (count := _count(description, levels_of)) > _MOST_TRIALS:
        key = "levels" if description.kind == "full_factorial" else "trials"
        raise DescriptionError(
            f"{count} trials of {len(levels_of)} factors",
            key=f"design.{key}",
            value=getattr(description, key),
            expected=f"a design of at most {_MOST_TRIALS} trials",
        )
    match description.kind:
        case "monte_carlo":
            return _monte_carlo(description.trials, len(levels_of), seed)
        case "latin_hypercube":
            return _latin_hypercube(description.trials, len(levels_of), seed)
        case "sobol":
            return _saltelli(description.trials, len(levels_of), seed)
        case "full_factorial":
            return np.array(list(product(*(_levels(description, listed) for listed in levels_of))))
        case "one_at_a_time":
            return _one_at_a_time(description, levels_of)
        case "morris":
            return _morris(description, len(levels_of), seed)


def _count(description: DesignDescription, levels_of: Sequence[Array | None]) -> int:
    """Number of trials."""
    factors, trials = len(levels_of), description.trials
    levels = [description.levels if listed is None else len(listed) for listed in levels_of]
    return {
        "sobol": trials * (factors + 2),
        "morris": trials * (factors + 1),
        "full_factorial": math.prod(levels),
        "one_at_a_time": 1 + sum(levels),
    }.get(description.kind, trials)


def _levels(description: DesignDescription, listed: Array | None) -> Array:
    """Probabilities of a factor's levels: equal steps between the quantiles, or those of its listed values."""
    return np.linspace(*description.quantiles, description.levels) if listed is None else listed


def _monte_carlo(trials: int, factors: int, seed: int) -> Array:
    """Each row has its own counter, so that a longer study begins with the trials of a shorter one."""
    source = np.random.Philox(key=0)
    generator, state = np.random.Generator(source), source.state
    rows = np.empty((trials, factors))
    for n in range(trials):
        # As of a new generator with this key, whose making takes ten times as long.
        state["state"]["key"][0] = hashed(seed, _DRAWS, n)
        source.state = state
        rows[n] = generator.random(factors)
    return rows


def _latin_hypercube(trials: int, factors: int, seed: int) -> Array:
    from scipy.stats import qmc  # noqa: PLC0415  (takes two seconds to import)

    return np.asarray(qmc.LatinHypercube(factors, rng=_generator(seed)).random(trials))


def _saltelli(base: int, factors: int, seed: int) -> Array:
    from scipy.stats import qmc  # noqa: PLC0415

    both = qmc.Sobol(2 * factors, scramble=True, rng=_generator(seed)).random(base)
    a, b = both[:, :factors], both[:, factors:]
    blocks = [a]
    for j in range(factors):
        mixed = a.copy()
        mixed[:, j] = b[:, j]
        blocks.append(mixed)
    return np.stack([*blocks, b], 1).reshape(-1, factors)


def _one_at_a_time(description: DesignDescription, levels_of: Sequence[Array | None]) -> Array:
    centre = np.full(len(levels_of), 0.5)
    rows = [centre]
    for j, listed in enumerate(levels_of):
        for level in _levels(description, listed):
            row = centre.copy()
            row[j] = level
            rows.append(row)
    return np.array(rows)


def _morris(description: DesignDescription, factors: int, seed: int) -> Array:
    """Trajectories on the unit grid, scaled to the range between the quantiles."""
    morris = require("SALib.sample.morris", "studies")
    grid = morris.sample(morris_problem(factors), description.trials, description.levels, seed=hashed(seed, 1, 0) >> 32)
    low, high = description.quantiles
    return np.asarray(low + grid * (high - low))


def morris_problem(factors: int) -> dict[str, object]:
    """The unit cube as a problem of SALib."""
    return {"num_vars": factors, "names": [f"x{j}" for j in range(factors)], "bounds": [[0.0, 1.0]] * factors}


def _generator(seed: int) -> np.random.Generator:
    return np.random.default_rng(hashed(seed, _DRAWS, 0))


def quantiles(distribution: DistributionDescription, probability: ArrayLike) -> NDArray[np.generic]:
    """Values (n,) at cumulative probabilities (n,) in [0, 1]; for a discrete distribution, indices of its values."""
    p = np.clip(np.asarray(probability, float), _SMALLEST, 1 - _SMALLEST)
    match distribution:
        case TruncatedNormalDescription():
            a, b = ndtr((np.array([distribution.low, distribution.high]) - distribution.mean) / distribution.std)
            values = distribution.mean + distribution.std * ndtri(a + p * (b - a))
            return np.asarray(np.clip(values, distribution.low, distribution.high))
        case UniformDescription():
            return np.asarray(distribution.low + p * (distribution.high - distribution.low))
        case NormalDescription():
            return np.asarray(distribution.mean + distribution.std * ndtri(p))
        case DiscreteDescription():
            weights = distribution.weights or (1.0,) * len(distribution.values)
            edges = np.cumsum(weights) / np.sum(weights)
            return np.asarray(np.minimum(np.searchsorted(edges, p, side="right"), len(weights) - 1))


def middles(distribution: DistributionDescription) -> Array | None:
    """Probabilities in the middle of each value of a discrete distribution with a weight above 0; else None."""
    if not isinstance(distribution, DiscreteDescription):
        return None
    weights = np.array(distribution.weights or (1.0,) * len(distribution.values))
    share = weights / weights.sum()
    return np.asarray((np.cumsum(share) - share / 2)[share > 0])


def extremes(distribution: DistributionDescription) -> list[bool | int | float | str]:
    """Bounds of a bounded distribution, all values of a discrete one, the mean of an unbounded one."""
    match distribution:
        case DiscreteDescription():
            return list(distribution.values)
        case UniformDescription():  # includes the truncated normal
            return [distribution.low, distribution.high]
        case _:
            return [distribution.mean]


def correlated_normal(probability: Array, mean: Array, covariance: Array) -> Array:
    """Values (n, k) of a multivariate normal distribution from independent probabilities (n, k).

    Uses the symmetric root of the covariance, which exists for singular matrices too.
    """
    scores = ndtri(np.clip(probability, _SMALLEST, 1 - _SMALLEST))
    size, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.clip(size, 0, None))) @ vectors.T
    return np.asarray(mean + scores @ root)


@dataclass(frozen=True)
class Population:
    """Equally probable values of each factor, and the correlation (factors, factors) of normally distributed ones."""

    values: Sequence[NDArray[np.generic]]
    correlation: Array


def population_of(study: VaryingScansDescription) -> Population:
    """The population of a study's factors, blocks last; of a full factorial design its points."""
    middle = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    probabilities = np.tile(middle[:, None], len(study.labels))
    if study.design.kind == "full_factorial":
        probabilities = design(study.design, [middles(factor.distribution) for factor in study.factor], study.seed)
    values = [np.array(values_at(factor, probabilities[:, j])) for j, factor in enumerate(study.factor)]
    correlations = [np.eye(len(study.factor))]
    for block in study.block:
        std = np.sqrt(np.diag(block.covariance_matrix))
        correlations.append(block.covariance_matrix / np.outer(std, std))
        for mean, deviation in zip(block.mean or np.zeros(len(std)), std, strict=True):
            normal = NormalDescription(kind="normal", mean=float(mean), std=float(deviation))
            values.append(quantiles(normal, middle))
    return Population(values, block_diag(*correlations))


def values_at(factor: FactorDescription, probabilities: Array) -> list[Value]:
    """Values (n,) of a factor at cumulative probabilities (n,)."""
    drawn = quantiles(factor.distribution, probabilities).tolist()
    if isinstance(factor.distribution, DiscreteDescription):
        return [factor.distribution.values[position] for position in drawn]
    return list(drawn)


@dataclass(frozen=True)
class Inputs:
    """Inputs of one scan: nominal descriptions, and deviations of the true cell as ``key=value`` words."""

    setup: Setup
    as_built: tuple[str, ...]


def checked_sections(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Descriptions of plain data by section.

    Raises
    ------
    DescriptionError
        Naming section, key, value and what was expected.
    """
    return {name: validate(_SECTIONS[name], table, name) for name, table in raw.items()}


def nominal_setup(described: VaryingScansDescription, folder: Path, source: str) -> Setup:
    """The nominal descriptions that a description of many scans names, by paths relative to `folder`.

    Raises
    ------
    DescriptionError
        Naming `source`, file, key, value and what was expected.
    """
    names = {kind: getattr(described, kind) for kind in _SECTIONS}
    found = {kind: folder / name if name is not None else None for kind, name in names.items()}
    try:
        return load_setup(**found, settings=described.set, ideal=described.ideal)
    except DescriptionError as error:
        raise error.within(source) from None


class Factors:
    """Variation around the nominal descriptions; `source` names the description in messages."""

    def __init__(self, study: VaryingScansDescription, setup: Setup, source: str) -> None:
        self._study = study
        self._setup = setup
        self._source = source
        self._raw = {name: getattr(setup, name).model_dump(mode="json") for name in _SECTIONS}
        singles = [(factor.path, factor.mode) for factor in study.factor]
        blocks = [(path, block.mode) for block in study.block for path in block.paths]
        self.labels = study.labels
        self._paths: list[tuple[str, VariationMode]] = singles + blocks
        self._nominals = [self._nominal(path) for path, _ in self._paths]

    @property
    def files(self) -> list[str]:
        """Files that factors may put in place of those of the cell description."""
        return [
            str(value)
            for factor in self._study.factor
            if split_path(factor.path)[-1] in FILE_KEYS and isinstance(factor.distribution, DiscreteDescription)
            for value in factor.distribution.values
        ]

    def draw(self) -> list[tuple[Value, ...]]:
        """Values of all factors in every trial of the design."""
        study = self._study
        blocks = [block.covariance_matrix for block in study.block]
        listed = [middles(factor.distribution) for factor in study.factor] + [None] * sum(len(b) for b in blocks)
        cube = design(study.design, listed, study.seed)
        columns: list[list[Value]] = [values_at(factor, cube[:, j]) for j, factor in enumerate(study.factor)]
        start = len(columns)
        for block, covariance in zip(study.block, blocks, strict=True):
            mean = np.array(block.mean or np.zeros(len(covariance)))
            drawn = correlated_normal(cube[:, start : start + len(mean)], mean, covariance)
            columns.extend(drawn.T.tolist())
            start += len(mean)
        return list(zip(*columns, strict=True)) if columns else [()] * len(cube)

    def inputs(self, values: Sequence[Value]) -> Inputs:
        """Descriptions and deviations of a trial.

        Raises
        ------
        DescriptionError
            If a value is out of bounds.
        """
        raw, words = dict(self._raw), list(self._study.as_built)
        for (path, mode), nominal, value in zip(self._paths, self._nominals, values, strict=True):
            result = value if mode == "absolute" else _changed(nominal, mode, value)
            if path.startswith(_AS_BUILT):
                words.append(f"{path.removeprefix(_AS_BUILT)}={_toml(result)}")
            else:
                section, *keys = split_path(path)
                raw[str(section)] = _with(raw[str(section)], keys, result, path)
        return Inputs(self._checked(raw), tuple(words))

    def check(self, units: Units) -> None:
        """Refuse factors that cannot work; `units` are those of the FMU's ``as_built.*`` parameters.

        Raises
        ------
        DescriptionError
            Naming the file, the factor, the value and what was expected.
        """
        parse_as_built(self._study.as_built, units)
        as_built_sensors(self._setup, self._study.as_built)
        described = self._study.factor
        for j, ((path, mode), nominal) in enumerate(zip(self._paths, self._nominals, strict=True)):
            try:
                if mode != "absolute":
                    # Its message about an unknown key is better than one about the nominal value.
                    self._check_result(path, 0.0 if nominal is None else nominal, units)
                self._check_nominal(mode, nominal, j)
                for value in extremes(described[j].distribution) if j < len(described) else [0.0]:
                    result = value if mode == "absolute" else _changed(nominal, mode, value)
                    self._check_result(path, result, units)
            except DescriptionError as error:
                raise error.within(f"{self._source}: factor {path}") from None

    def _check_nominal(self, mode: VariationMode, nominal: Any, j: int) -> None:
        if mode == "absolute":
            return
        if isinstance(nominal, bool) or not isinstance(nominal, int | float):
            raise DescriptionError(f'its nominal value {nominal!r} is not a number; use mode = "absolute"')
        if mode == "relative" and nominal == 0:
            raise DescriptionError('its nominal value is 0, so a relative change has no effect; use mode = "additive"')
        whole = j < len(self._study.factor) and isinstance(self._study.factor[j].distribution, DiscreteDescription)
        if isinstance(nominal, int) and not whole:
            raise DescriptionError(f"its nominal value {nominal} must stay a whole number; use a discrete distribution")

    def _check_result(self, path: str, result: Value, units: Units) -> None:
        """Check one factor at this value, all others at nominal."""
        if path.startswith(_AS_BUILT):
            word = f"{path.removeprefix(_AS_BUILT)}={_toml(result)}"
            as_built_sensors(self._setup, [word])
            parse_as_built([word], units)
        else:
            section, *keys = split_path(path)
            name = str(section)
            self._checked({**self._raw, name: _with(self._raw[name], keys, result, path)})

    def _nominal(self, path: str) -> Any:
        own = path.removeprefix(_AS_BUILT)
        if path.startswith(_AS_BUILT) and sensor_words([f"{own}=0"]):
            keys = split_path(own)[1:]
            number = int(keys.pop(0)) + 1 if keys and isinstance(keys[0], int) else 1
            if keys == ["delay_ms"] and 2 <= number <= len(self._setup.sensor_names):
                further = self._setup.cell.further_sensor[number - 2]
                return 1e3 * as_built_delay(further, self._study.as_built, number)
            true = as_built_sensors(self._setup, self._study.as_built)
            return _value_at(true[number - 1].model_dump(mode="json"), keys) if number <= len(true) else None
        if path.startswith(_AS_BUILT):
            given = dict(parse_assignment(word) for word in self._study.as_built)
            key = path.removeprefix(_AS_BUILT)
            return given.get(key, given.get(path, 0.0))
        section, *keys = split_path(path)
        if section not in _SECTIONS or not keys:
            raise DescriptionError(
                file=self._source,
                key=f"factor {path}",
                expected="a path that begins with cell., sensor., scan. or as_built.",
            )
        return _value_at(self._raw[str(section)], keys)

    def _checked(self, raw: Mapping[str, Any]) -> Setup:
        changed = {name: table for name, table in raw.items() if table is not self._raw[name]}
        return Setup(**{**vars(self._setup), **checked_sections(changed)})


def _changed(nominal: Any, mode: VariationMode, value: Any) -> Value:
    result: Value = nominal + value if mode == "additive" else nominal * (1 + value)
    return result


def _toml(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _value_at(node: Any, keys: Sequence[str | int]) -> Any:
    """The value at the path, or None where there is none; validation reports unknown keys."""
    for key in keys:
        there = key in node if isinstance(node, dict) else isinstance(node, list) and key in range(len(node))
        if not there:
            return None
        node = node[key]
    return node


def _with(section: dict[str, Any], keys: Sequence[str | int], value: Value, path: str) -> dict[str, Any]:
    """A copy of a section with one value changed; missing tables are added."""
    changed = copy.deepcopy(section)
    node: Any = changed
    for key in keys[:-1]:
        if isinstance(key, str) and isinstance(node, dict) and node.get(key) is None:
            node[key] = {}
        node = _step(node, key, path)
    _step(node, keys[-1], path, missing=True)
    node[keys[-1]] = value
    return changed


def _step(node: Any, key: str | int, path: str, missing: bool = False) -> Any:
    if isinstance(node, list) and isinstance(key, int):
        if key >= len(node):
            raise DescriptionError(f"index [{key + 1}] does not exist, there are {len(node)}", key=path)
        return node[key]
    if isinstance(node, dict) and isinstance(key, str):
        return None if missing else node[key]
    raise DescriptionError(f"'{key}' is not inside a table", key=path)
