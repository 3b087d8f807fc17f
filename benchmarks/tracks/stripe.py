"""Track `stripe`: rows of a laser stripe in images, of which the row in every column is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.stripe_images import mean_bound, stripe
from benchmarks.track import Array, Case, Outcome, ResultError, Table, Track

WIDTH, HEIGHT, FRAMES = 512, 128, 2
BITS, GAIN, READ_E, FULL_WELL_E, BLACK_DN = 8, 0.0225, 5.0, 11_000.0, 4.0
FLOOR_E2 = READ_E**2 + 1 / (12 * GAIN**2)  # variance by read noise and quantisation
PEAK_E = 10_000.0
_WRONG = 1.0  # px: error of a row that is none of the stripe's; also that of a column which is missing
_USUAL = 0.6827  # quantile of absolute errors that is the standard deviation of normal ones


@dataclass(frozen=True)
class Condition:
    """A stripe: standard deviation across it (px), height (electrons), share of a second one, and its distance (px)."""

    name: str
    sigma: float
    peak: float = PEAK_E
    ghost: float = 0.0
    away: float = 0.0


CONDITIONS = (
    Condition("narrow", 0.8),
    Condition("usual", 1.5),
    Condition("wide", 3.0),
    Condition("weak", 1.5, peak=1000.0),
    Condition("saturated", 1.5, peak=2.7 * PEAK_E),
    Condition("overlapping ghost", 1.5, ghost=0.25, away=6.0),
    Condition("separate ghost", 1.5, ghost=0.6, away=20.0),
)


def image(rng: np.random.Generator, condition: Condition) -> tuple[Array, Array]:
    """Image (HEIGHT, WIDTH) in digital numbers, and rows (WIDTH,) of the stripe, NaN where there is none."""
    at = np.arange(WIDTH)
    bend = rng.uniform(2.0, 6.0) * np.sin(2 * np.pi * (at / WIDTH * rng.uniform(0.5, 1.5) + rng.uniform()))
    rows = rng.uniform(50.0, 70.0) + rng.uniform(-0.02, 0.02) * at + bend
    peak = np.full(WIDTH, condition.peak)
    gap = int(rng.integers(60, WIDTH - 120))
    peak[gap : gap + 60] = 0.0
    electrons = stripe(rows, condition.sigma, peak, HEIGHT)
    side = rng.choice([-1.0, 1.0])
    electrons += stripe(rows + side * condition.away, condition.sigma, condition.ghost * peak, HEIGHT)
    electrons = np.minimum(rng.poisson(electrons), FULL_WELL_E) + READ_E * rng.normal(size=electrons.shape)
    grey = np.clip(np.round(BLACK_DN + GAIN * electrons), 0, 2**BITS - 1)
    return grey, np.where(peak > 0, rows, np.nan)


def cases(seed: int, number: int) -> list[Case]:
    """Conditions in turn."""
    found = []
    for index in range(number):
        rng = np.random.default_rng([seed, index])
        condition = CONDITIONS[index % len(CONDITIONS)]
        made = [image(rng, condition) for _ in range(FRAMES)]
        camera = {
            "bit_depth": BITS,
            "gain_dn_per_e": GAIN,
            "read_noise_e": READ_E,
            "full_well_e": FULL_WELL_E,
            "black_level_dn": BLACK_DN,
        }
        inputs = {"images": np.stack([grey for grey, _ in made]).astype(np.uint8), "camera": camera}
        truth = {"rows": np.stack([rows for _, rows in made]), "condition": condition}
        found.append(Case(f"{index:04d}", inputs, truth))
    return found


def check(case: Case, table: Table) -> None:
    """Frames and columns are those of the images, and none occurs twice."""
    place = np.column_stack([table["frame"], table["column"]])
    frames, columns = case.truth["rows"].shape
    if ((place != np.round(place)) | (place < 0) | (place >= [frames, columns])).any():
        raise ResultError(f"frame, column: expected integers from 0, below {frames} and {columns}")
    if len(np.unique(place, axis=0)) < len(place):
        raise ResultError("expected at most one row for each frame and column")


def bound(condition: Condition) -> float:
    """Cramér-Rao bound (px), mean square over the positions between two pixels, of the stripe alone, not saturated."""
    return mean_bound(condition.sigma, condition.peak, FLOOR_E2)


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """The usual error over the bound, of all conditions and of each; shares of columns in per cent."""
    errors: dict[Condition, list[Array]] = {}
    false: list[Array] = []
    for case, table in outcomes:
        rows = np.full(case.truth["rows"].shape, np.nan)
        if table is not None:
            rows[table["frame"].astype(int), table["column"].astype(int)] = table["row"]
        lit = np.isfinite(case.truth["rows"])
        errors.setdefault(case.truth["condition"], []).append((rows - case.truth["rows"])[lit])
        false.append(np.isfinite(rows[~lit]))
    ratios = {}
    for condition, parts in errors.items():
        absolute = np.nan_to_num(np.abs(np.concatenate(parts)), nan=_WRONG)
        ratios[condition.name] = float(np.quantile(np.minimum(absolute, _WRONG), _USUAL)) / bound(condition)
    every = np.concatenate([part for parts in errors.values() for part in parts])
    found = np.isfinite(every)
    return {
        "mean": float(np.mean(list(ratios.values()))),
        **ratios,
        "found %": 100 * float(found.mean()),
        "wrong %": 100 * float(np.mean(np.abs(every[found]) > _WRONG)) if found.any() else np.nan,
        "false %": 100 * float(np.concatenate(false).mean()),
    }


TRACK = Track("stripe", ("frame", "column", "row"), (), cases, check, summary, default_cases=4 * len(CONDITIONS))
