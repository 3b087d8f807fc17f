"""How straight the stripe on a flat board is after its lens distortion is removed, by detector (docs/reality.md)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.calibration.board.problem import BoardView, Rig
from scancell.config.loading import load_setup
from scancell.config.sensor import ExtractionDescription
from scancell.scanning.sense import make_sensor

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

DETECTORS: tuple[str, ...] = get_args(ExtractionDescription.model_fields["detector"].annotation)
_FULL = 255
_NORMAL = 1.4826  # standard deviation by the median of absolute values
_LEAST = 20  # points of a stripe
_NEAR = 4.0  # px, of points from the line through the stripe
_HALF_WINDOW = 10  # px, about the brightest pixel of a column
_BLUR = 1.5  # px
_BINNING = 4  # the stripes are wider than any limit of the detectors
_OPEN = {
    "extraction.peak": "brightest",
    "extraction.max_sigma_px": 8.0,
    "extraction.max_asymmetry": 100.0,
    "extraction.max_residual": 100.0,
    "extraction.max_row_jump_px": 1000.0,
    "extraction.max_amplitude_jump": 1000.0,
    "extraction.max_width_jump": 1000.0,
    "extraction.min_amplitude_dn": 40.0,
    "detector.bit_depth": 8,
}


def _ours(detector: str) -> Callable[[Grey], Array]:
    """Rows of the stripe in the columns of an image by a detector, NaN without a peak."""
    shipped = load_setup().sensor.replace({**_OPEN, "extraction.detector": detector})

    def rows(image: Grey) -> Array:
        camera = shipped.camera[0].model_copy(
            update={"width_px": image.shape[1], "height_px": image.shape[0], "cx_px": None, "cy_px": None}
        )
        description = shipped.model_copy(update={"camera": (camera,)})
        peaks = sensor_rt.extract(image[None, None].astype(np.uint16), make_sensor(description, 0), 1)
        good = (np.asarray(peaks.flags) & sensor_rt.PEAK_REJECTED) == 0
        found = np.full(image.shape[1], np.nan)
        found[np.asarray(peaks.column)[good]] = np.asarray(peaks.row, float)[good]
        return found

    return rows


def _windows(image: Grey) -> tuple[NDArray[np.intp], Array]:
    """Rows (k, width) about the brightest of each column, and the grey values there."""
    top = np.clip(image.argmax(0) - _HALF_WINDOW, 0, image.shape[0] - 2 * _HALF_WINDOW - 1)
    rows = top + np.arange(2 * _HALF_WINDOW + 1)[:, None]
    return rows, np.take_along_axis(image, rows, 0).astype(float)


def centre_of_half(image: Grey) -> Array:
    """Plain NumPy: centre of gravity of what is above half the largest value of a column."""
    rows, grey = _windows(image)
    weight = np.maximum(grey - grey.max(0) / 2, 0.0)
    return np.asarray((weight * rows).sum(0) / weight.sum(0))


def smoothed_maximum(image: Grey) -> Array:
    """Plain OpenCV: largest value after a Gaussian filter across the stripe, by a parabola through three rows."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (1, 0), sigmaX=_BLUR, sigmaY=_BLUR)
    top = np.clip(smooth.argmax(0), 1, image.shape[0] - 2)
    below, at, above = (np.take_along_axis(smooth, (top + k)[None], 0)[0].astype(float) for k in (-1, 0, 1))
    curvature = below - 2 * at + above
    return np.asarray(top + (below - above) / (2 * np.where(curvature < 0, curvature, np.nan)))


PEERS: dict[str, Callable[[Grey], Array]] = {
    "NumPy, centre of gravity above half of the maximum": centre_of_half,
    "OpenCV, maximum after a Gaussian filter, parabola": smoothed_maximum,
}


def deviations(image: Grey, rig: Rig, view: BoardView, rows_of: Callable[[Grey], Array]) -> tuple[Array, Array] | None:
    """Distances (n,), px, of points of the stripe from their straight line, and whether they are saturated.

    Distances are those in an image without lens distortion. None: too few points.
    """
    along = view.stripe.max(0) - view.stripe.min(0)
    turned = along[1] > along[0]
    seen = np.rot90(image) if turned else image
    height, width = (side // _BINNING * _BINNING for side in seen.shape)
    seen = np.ascontiguousarray(seen[:height, :width])
    small = cv2.resize(seen, None, fx=1 / _BINNING, fy=1 / _BINNING, interpolation=cv2.INTER_AREA)
    row, column = (_BINNING * values + (_BINNING - 1) / 2 for values in (rows_of(small), np.arange(small.shape[1])))
    saturated = small.max(0) == _FULL
    pixels = np.column_stack([image.shape[1] - 1 - row, column] if turned else [column, row])
    coordinate = pixels[:, int(turned)]
    low, high = view.stripe[:, int(turned)].min(), view.stripe[:, int(turned)].max()
    chosen = np.isfinite(row) & (coordinate >= low) & (coordinate <= high)
    straight = rig.intrinsics[0] * rig.rays(pixels[chosen])[:, :2]
    kept = np.ones(len(straight), bool)
    away = np.zeros(len(straight))
    for _ in range(10):
        if kept.sum() < _LEAST:
            return None
        middle = straight[kept].mean(0)
        axis = np.linalg.svd(straight[kept] - middle, full_matrices=False)[2][1]
        away = (straight - middle) @ axis
        kept = np.abs(away) < _NEAR
    return away[kept], saturated[chosen][kept]


def straightness_lines(images: Sequence[tuple[Path, Rig, BoardView]]) -> Iterator[str]:
    """Table of detectors.

    Standard deviation of points from the straight line of their stripe, by the median, and their number.
    """
    yield "| detector | saturated columns, px (points) | other columns, px (points) |"
    yield "|---|---|---|"
    detectors = {**{f"`{name}`": _ours(name) for name in DETECTORS}, **PEERS}
    found: dict[str, list[tuple[Array, Array]]] = defaultdict(list)
    for file, rig, view in images:
        image = np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), np.uint8)
        for name, rows_of in detectors.items():
            if len(view.stripe) and (one := deviations(image, rig, view, rows_of)) is not None:
                found[name].append(one)
    for name in detectors:
        away = np.concatenate([one[0] for one in found[name]]) if found[name] else np.zeros(0)
        full = np.concatenate([one[1] for one in found[name]]) if found[name] else np.zeros(0, bool)
        cells = [
            f"{_NORMAL * np.median(np.abs(part)):.2f} ({len(part)})" if len(part) else "-"
            for part in (away[full], away[~full])
        ]
        yield f"| {name} | {' | '.join(cells)} |"
