"""Track `sensor`: points on the laser sheet at pixels of a camera, calibrated from views of a board with the stripe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.board_views import draw_truth, moved, observe, project
from benchmarks.track import Array, Case, Outcome, ResultError, Table, Track, coverage, median_error

_AXES = ("x_mm", "y_mm", "z_mm")


def cases(seed: int, number: int) -> list[Case]:
    """A random camera and sheet in each case; the pixels see the sheet over its range."""
    found = []
    y, z = np.meshgrid(np.linspace(-0.03, 0.03, 7), np.linspace(0.22, 0.28, 7))
    on_sheet = np.column_stack([np.zeros(y.size), y.ravel(), z.ravel()])
    for index in range(number):
        rng = np.random.default_rng([seed, index])
        truth = draw_truth(rng)
        points = moved(truth.camera_from_sheet, on_sheet)
        pixels = project(truth, points)
        query = {"column_px": pixels[:, 0].astype(float), "row_px": pixels[:, 1].astype(float)}
        found.append(Case(f"{index:04d}", {**observe(rng, truth), "query": query}, {"points": 1e3 * points}))
    return found


def check(case: Case, table: Table) -> None:
    """A point for each pixel."""
    if len(table["x_mm"]) != len(case.truth["points"]):
        raise ResultError(
            f"{len(table['x_mm'])} points, expected {len(case.truth['points'])}: one for each row of query"
        )


def errors_of(case: Case, table: Table) -> Array:
    """Errors (n, 3) of the points, mm."""
    return np.asarray(np.column_stack([table[axis] for axis in _AXES]) - case.truth["points"])


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Medians over the cases, a failed one counting as infinite; coverage of the intervals of z in per cent.

    RMS distance of the points from the true ones; of their shape, after the best rigid displacement, which a hand-eye
    calibration with the same camera takes up.
    """
    rms, shape, inside = [], [], []
    for case, table in outcomes:
        if table is None:
            rms.append(np.inf)
            shape.append(np.inf)
            continue
        away = errors_of(case, table)
        rms.append(1e3 * float(np.sqrt(np.mean(np.sum(away**2, axis=1)))))
        centred = [points - points.mean(0) for points in (case.truth["points"] + away, case.truth["points"])]
        rest = Rotation.align_vectors(*centred)[1] / np.sqrt(len(away))
        shape.append(1e3 * float(rest))
        if "half_width_z_mm" in table:
            inside.append(np.abs(errors_of(case, table)[:, 2]) <= table["half_width_z_mm"])
    return {
        "shape RMS µm": median_error(shape),
        "RMS µm": median_error(rms),
        "in 95 % intervals, %": coverage(inside),
    }


TRACK = Track("sensor", _AXES, ("half_width_z_mm",), cases, check, summary, default_cases=20)
