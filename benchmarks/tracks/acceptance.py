"""Track `acceptance`: size, spacing and form of an artefact of two balls and a plate from a cloud."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.artefact_scan import CENTRES, NOISE, PLATE, RADIUS, STEM_RADIUS, draw, measured, trace, truth
from benchmarks.track import Array, Case, Outcome, Table, Track, coverage, median_error, named_values

NAMES = ("ball1.size_um", "ball2.size_um", "spacing_um", "ball1.form_um", "ball2.form_um", "plate.form_um")
_GROUPS = {"size µm": slice(0, 2), "spacing µm": slice(2, 3), "form µm": slice(3, 6)}


def cases(seed: int, number: int) -> list[Case]:
    """Another artefact in each case."""
    found = []
    for index in range(number):
        rng = np.random.default_rng([seed, index])
        scan = trace(draw(rng))
        x, y, z = measured(scan, rng).T
        inputs = {
            "points": {"profile": scan.profile.astype(float), "x_mm": x, "y_mm": y, "z_mm": z},
            "centres_mm": CENTRES.tolist(),
            "radius_mm": RADIUS,
            "stem_radius_mm": STEM_RADIUS,
            "plate_mm": list(PLATE),
            "noise_mm": NOISE,
        }
        found.append(Case(f"{index:04d}", inputs, {"values": truth(scan)}))
    return found


def check(case: Case, table: Table) -> None:
    """All values are there."""
    named_values(table, NAMES, "value")


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Medians of the RMS errors of a case, which if it failed is infinite; coverage of the intervals of lengths."""
    errors: dict[str, list[float]] = {"lengths µm": [], **{name: [] for name in _GROUPS}}
    inside: list[Array] = []
    lengths = slice(0, 3)
    for case, table in outcomes:
        error = np.full(len(NAMES), np.inf)
        if table is not None:
            error = named_values(table, NAMES, "value") - case.truth["values"]
            if "half_width" in table:
                inside.append(np.abs(error)[lengths] <= named_values(table, NAMES, "half_width")[lengths])
        for name, rows in {"lengths µm": lengths, **_GROUPS}.items():
            errors[name].append(float(np.sqrt(np.mean(error[rows] ** 2))))
    return {
        **{name: median_error(values) for name, values in errors.items()},
        "in 95 % intervals, %": coverage(inside),
    }


TRACK = Track("acceptance", ("name", "value"), ("half_width",), cases, check, summary, default_cases=20)
