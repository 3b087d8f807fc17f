"""How often intervals of variance budgets contain the truth: ``PYTHONPATH=tests python -m bench.study_intervals``.

Random linear models: 1 to 8 factors with normal, uniform, skewed and two-valued distributions, some without effect,
some correlated in pairs; noise from 1 % of the signal to five times it; 6 to 30 trials per factor.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import gamma

from scancell.studies.budget import Terms, variance_budget

Array = NDArray[np.float64]

MIDDLES = (np.arange(20_000) + 0.5) / 20_000
QUANTILES = {
    "normal": ndtri,
    "uniform": lambda p: 5.0 + p,
    "skewed": gamma(4.0).ppf,
    "two-valued": lambda p: np.where(p < 0.7, -1.0, 2.0),
}
POPULATIONS = {kind: quantiles(MIDDLES) for kind, quantiles in QUANTILES.items()}
CLASSES = ((-1.0, 0.0), (0.0, 0.01), (0.01, 0.1), (0.1, 0.5), (0.5, 1.0))


@dataclass(frozen=True)
class Model:
    """A linear model: trials (n, k) of its factors, outputs (n,), and what the factors truly contribute.

    `shares` (k,) and `uncertainties` (k,) are those of Lindeman, Merenda & Gold, `kinds` the factors' distributions.
    """

    values: Array
    outputs: Array
    kinds: list[str]
    correlation: Array
    shares: Array
    uncertainties: Array


def random_model(rng: np.random.Generator) -> Model:
    """A model with factors that are independent but for one pair in some models."""
    count = int(rng.integers(1, 9))
    trials = int(count * rng.uniform(6, 30)) + 4
    kinds = [str(kind) for kind in rng.choice(list(QUANTILES), count)]
    correlation = np.eye(count)
    if count > 2 and rng.random() < 0.3:
        kinds[:2] = ["normal", "normal"]
        correlation[0, 1] = correlation[1, 0] = rng.uniform(-0.95, 0.95)
    values = np.column_stack([QUANTILES[kind](rng.random(trials)) for kind in kinds])
    values[:, :2] = values[:, :2] @ np.linalg.cholesky(correlation[:2, :2]).T
    effects = rng.standard_normal(count) * (rng.random(count) < 0.7)
    noise = float(10 ** rng.uniform(-2.0, 0.7))
    std = np.array([POPULATIONS[kind].std() for kind in kinds])
    outputs = values @ (effects / std) + noise * rng.standard_normal(trials)
    variances = effects**2
    if count > 1:
        r, (a, b) = correlation[0, 1], effects[:2]
        alone = (a + r * b) ** 2, (b + r * a) ** 2
        both = a**2 + b**2 + 2 * r * a * b
        variances[:2] = (alone[0] + both - alone[1]) / 2, (alone[1] + both - alone[0]) / 2
    shares = variances / (variances.sum() + noise**2)
    return Model(values, outputs, kinds, correlation, shares, np.sqrt(variances))


def contained(model: Model, seed: int, probability: float = 0.95) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether the intervals contain the true shares (k,) and the true uncertainties (k,)."""
    columns = zip(model.values.T, model.kinds, strict=True)
    terms = [Terms.of(values.tolist(), POPULATIONS[kind]) for values, kind in columns]
    found = variance_budget(terms, model.outputs, probability, seed, correlation=model.correlation)["budget"]
    inside = []
    for key, true in (("share", model.shares), ("uncertainty", model.uncertainties)):
        low, high = np.array([row[f"{key}_interval"] for row in found]).T
        inside.append((low <= true + 1e-12) & (true <= high + 1e-12))
    return inside[0], inside[1]


def coverage(models: int, first: int = 0) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """True shares (f,) of all factors of all models, and whether the intervals contain share and uncertainty (f,)."""
    rows = []
    for seed in range(first, first + models):
        model = random_model(np.random.default_rng(seed))
        rows.append((model.shares, *contained(model, seed)))
    true, shares, uncertainties = (np.concatenate(column) for column in zip(*rows, strict=True))
    return true, shares, uncertainties


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=int, default=1000)
    true, shares, uncertainties = coverage(parser.parse_args().models)
    print("| true share | factors | share in its interval | uncertainty in its interval |\n|---|---|---|---|")
    for low, high in (*CLASSES, (-1.0, 1.0)):
        own = (true > low) & (true <= high)
        title = "all" if high - low > 1.5 else "0" if high == 0 else f"{low:g} to {high:g}"
        print(f"| {title} | {own.sum()} | {shares[own].mean():.1%} | {uncertainties[own].mean():.1%} |")


if __name__ == "__main__":
    main()
