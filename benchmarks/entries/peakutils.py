"""PeakUtils (pip install peakutils): least squares of a Gaussian by SciPy in every column."""

from __future__ import annotations

from typing import Any

import numpy as np
import peakutils

_HALF = 8  # rows about the brightest pixel


def stripe(case: dict[str, Any]) -> dict[str, Any]:
    """``peakutils.indexes`` finds the peaks of a column, ``peakutils.gaussian_fit`` the centre of the brightest one."""
    camera = case["camera"]
    dark = np.hypot(camera["gain_dn_per_e"] * camera["read_noise_e"], 12**-0.5)
    found: dict[str, list[float]] = {"frame": [], "column": [], "row": []}
    for frame, image in enumerate(case["images"].astype(float) - camera["black_level_dn"]):
        for column in range(image.shape[1]):
            values = image[:, column]
            tops = peakutils.indexes(values, thres=6.0 * dark, min_dist=5, thres_abs=True)
            if len(tops) == 0:
                continue
            top = int(tops[values[tops].argmax()])
            rows = np.arange(max(0, top - _HALF), min(len(values), top + _HALF + 1))
            try:
                row = peakutils.gaussian_fit(rows, values[rows])
            except RuntimeError:  # the fit did not converge
                continue
            if np.isfinite(row) and rows[0] <= row <= rows[-1]:
                found["frame"].append(frame)
                found["column"].append(column)
                found["row"].append(row)
    return found
