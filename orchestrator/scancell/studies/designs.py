"""Designs of experiments: points in the unit cube. Equal descriptions and seeds give equal points."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from scancell.config.variation import DesignDescription
from scancell.errors import DescriptionError
from scancell.extras import require

Array = NDArray[np.float64]
_DRAWS = 1
_TRIALS = 2
_MOST_TRIALS = 2_000_000


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
