"""Stripe extraction on recorded images: ``PYTHONPATH=tests python -m bench.real_stripes --data FOLDER``.

FOLDER holds a checkout of openlmd/etna (docs/reality.md). The stripe on a flat plate is a smooth curve in the image;
detectors are compared by the distances of their points from it. The table goes to docs/extraction.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, maximum_filter1d, median_filter, uniform_filter1d
from scipy.optimize import nnls

from bench import reality
from bench.table import replace_paragraphs
from scancell import sensor as sensor_rt
from scancell.config.loading import load_setup
from scancell.config.sensor import ExtractionDescription
from scancell.scanning.world import make_sensor

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extraction.md"
DETECTORS: tuple[str, ...] = get_args(ExtractionDescription.model_fields["detector"].annotation)
CLASSES = ("halo below 10 %", "halo above 10 %", "other light in the column", "near a step, or not saturated")
WRONG_PX = 3.0  # distance from the curve of the stripe
_FULL = 255
_NORMAL = 1.4826  # standard deviation by the median of absolute values
_LEAST = 100  # columns of a stripe
_DEGREE = 3  # of the curve: lens distortion, and bending of the plate
_ON_PLATE = 4.0  # px, from the curve; a stripe beyond the edge of the plate is farther away
_REACH = 40  # rows to either side of the curve that can belong to the stripe and its halo
_HALO = (6, 20)  # rows beyond the half of the full scale
_STRONG_HALO = 0.1  # of the full scale, above the median of the image
_NEAR_STEP = 6  # columns
_STEP = 0.3  # relative change of the width at half of the full scale
_AVERAGED = 15  # columns whose aligned signals give the shape of the stripe
_BLOCK = 16  # px
_LEVELS = 6.0  # DN
_LEAST_BLOCKS = 1000
_HALF_WINDOW = 24  # px, about the brightest pixel of a column
_BLUR = 6.0  # px
# The widest limits of a peak's shape that a description accepts.
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
RowsOf = Callable[[Grey], Array]


def ours(detector: str, peak: str = "brightest") -> RowsOf:
    """Rows of the stripe in the columns of an image by a detector, NaN without a peak."""
    shipped = load_setup().sensor.replace({**_OPEN, "extraction.detector": detector, "extraction.peak": peak})

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


def centre_of_half(image: Grey) -> Array:
    """Plain NumPy: centre of gravity of what is above half the largest value of a column."""
    top = np.clip(image.argmax(0) - _HALF_WINDOW, 0, image.shape[0] - 2 * _HALF_WINDOW - 1)
    rows = top + np.arange(2 * _HALF_WINDOW + 1)[:, None]
    grey = np.take_along_axis(image, rows, 0).astype(float)
    weight = np.maximum(grey - grey.max(0) / 2, 0.0)
    return np.asarray((weight * rows).sum(0) / weight.sum(0))


def smoothed_maximum(image: Grey) -> Array:
    """Plain OpenCV: largest value after a Gaussian filter across the stripe, by a parabola through three rows."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (1, 0), sigmaX=_BLUR, sigmaY=_BLUR)
    top = np.clip(smooth.argmax(0), 1, image.shape[0] - 2)
    below, at, above = (np.take_along_axis(smooth, (top + k)[None], 0)[0].astype(float) for k in (-1, 0, 1))
    curvature = below - 2 * at + above
    return np.asarray(top + (below - above) / (2 * np.where(curvature < 0, curvature, np.nan)))


def methods() -> dict[str, RowsOf]:
    """Our detectors and choices of a peak, and two plain methods."""
    peaks = ("continuity", "first", "last")
    return {
        **{f"`{name}`": ours(name) for name in DETECTORS},
        **{f'`gaussian`, `peak = "{peak}"`': ours("gaussian", peak) for peak in peaks},
        "NumPy, centre of gravity above half of the maximum": centre_of_half,
        "OpenCV, maximum after a Gaussian filter, parabola": smoothed_maximum,
    }


@dataclass(frozen=True)
class Stripe:
    """An image whose stripe runs along the columns, and what is known of it without a detector.

    `columns` (n,) show the stripe on the plate; `curve` (n,) is the row of the smooth curve through it, px; `kind` (n,)
    indexes CLASSES; `bound` (n,) is the Cramér-Rao bound of the row, px.
    """

    image: Grey
    columns: NDArray[np.intp]
    curve: Array
    kind: NDArray[np.intp]
    bound: Array


def stripe_of(image: Grey, points: Array, noise: Polynomial) -> Stripe | None:
    """The stripe of an image near the pixels (m, 2) of a line on the plate; None if too few columns show it.

    `noise` is the variance of a pixel, DN², as a function of its grey value.
    """
    along = np.ptp(points, axis=0)
    if along[1] > along[0]:
        points = np.column_stack([points[:, 1], image.shape[1] - 1 - points[:, 0]])
        image = np.ascontiguousarray(np.rot90(image))
    columns = np.arange(int(np.ceil(points[:, 0].min())), int(points[:, 0].max()) + 1)
    line = Polynomial.fit(points[:, 0], points[:, 1], 1)(columns)
    inside = (line > _REACH) & (line < image.shape[0] - 1 - _REACH)
    columns, line = columns[inside], line[inside]
    if len(columns) < _LEAST:
        return None
    middle = _middle_of_bright(image, columns, line)
    curve, on_plate = _smooth_curve(columns, middle)
    if on_plate.sum() < _LEAST:
        return None
    aligned = _aligned(image, columns, curve)
    kind = _classes(image, columns, curve, aligned)
    bound = _bound(aligned, noise)
    return Stripe(image, columns[on_plate], curve[on_plate], kind[on_plate], bound[on_plate])


def _middle_of_bright(image: Grey, columns: NDArray[np.intp], line: Array) -> Array:
    """Middle (n,) of the rows near the line that exceed half of the full scale; NaN without any.

    Independent of all detectors, and far above the halo.
    """
    rows = np.rint(line).astype(int) + np.arange(-_REACH, _REACH + 1)[:, None]
    bright = image[rows, columns] > _FULL / 2
    count = bright.sum(0)
    return np.where(count > 0, (bright * rows).sum(0) / np.maximum(count, 1), np.nan)


def _smooth_curve(columns: NDArray[np.intp], middle: Array) -> tuple[Array, Mask]:
    """Rows (n,) of the polynomial through most of the middles (n,), and which are near it."""
    near = np.isfinite(middle)
    fitted = Polynomial.fit(columns[near], middle[near], 1)
    for degree in [1] * 10 + [_DEGREE] * 10:
        away = np.abs(middle - fitted(columns))
        near = away < max(_ON_PLATE, 4 * _NORMAL * float(np.nanmedian(away))) if degree == 1 else away < _ON_PLATE
        if near.sum() < _LEAST:
            return fitted(columns), near
        fitted = Polynomial.fit(columns[near], middle[near], degree)
    return fitted(columns), np.abs(middle - fitted(columns)) < _ON_PLATE


def _aligned(image: Grey, columns: NDArray[np.intp], curve: Array) -> Array:
    """Grey values (2 * reach + 1, n) at whole distances from the curve, by linear interpolation."""
    rows = curve + np.arange(-_REACH, _REACH + 1)[:, None]
    return np.asarray(map_coordinates(image.astype(float), [rows, np.broadcast_to(columns, rows.shape)], order=1))


def _classes(image: Grey, columns: NDArray[np.intp], curve: Array, aligned: Array) -> NDArray[np.intp]:
    """Index (n,) of the class of each column in CLASSES."""
    width = (aligned > _FULL / 2).sum(0).astype(float)
    flat = (aligned > _FULL - 1).sum(0)
    usual = median_filter(width, 101, mode="nearest")
    changed = np.abs(width - usual) > _STEP * usual
    near_step = maximum_filter1d(changed.astype(np.uint8), 2 * _NEAR_STEP + 1) > 0
    distance = np.abs(np.arange(-_REACH, _REACH + 1))[:, None] - width / 2
    in_halo = (distance > _HALO[0]) & (distance < _HALO[1])
    halo = (aligned * in_halo).sum(0) / np.maximum(in_halo.sum(0), 1) - np.median(image)
    far = np.abs(np.arange(image.shape[0])[:, None] - curve) > _REACH
    other = ((image[:, columns] > _FULL / 2) & far).any(0)
    kind = np.where(halo < _STRONG_HALO * _FULL, 0, 1)
    return np.asarray(np.select([other, near_step | (flat == 0)], [2, 3], kind))


def _bound(aligned: Array, noise: Polynomial) -> Array:
    """Cramér-Rao bound (n,), px, of the row of a symmetric stripe of known or unknown width, height and background.

    The information of a pixel is the squared derivative of its mean over its variance; saturated ones have none. The
    derivative with respect to the row is odd about the centre, those to the other parameters are even: the row is
    estimated as well as if they were known. The mean is that of neighbouring columns, aligned.
    """
    mean = uniform_filter1d(aligned, _AVERAGED, axis=1, mode="nearest")
    slope = np.gradient(mean, axis=0)
    information = np.where(mean < _FULL - 1, slope**2 / noise(mean), 0.0).sum(0)
    return np.asarray(1.0 / np.sqrt(information))


def pixel_noise(images: Sequence[Grey]) -> Polynomial:
    """Variance of a pixel, DN², as a linear function of its grey value: photon transfer on the evenly lit parts.

    The difference of a pixel from the mean of its two neighbours has 3/2 of its variance. The tenth part of the blocks
    of a grey value with the least variance shows neither edges nor speckle.
    """
    blocks = [_blocks(image) for image in images]
    level, variance = np.concatenate(blocks, axis=1)
    bins = [(level >= low) & (level < low + _LEVELS) for low in np.arange(0.0, _FULL, _LEVELS)]
    used = [one for one in bins if one.sum() >= _LEAST_BLOCKS]
    grey = np.array([level[one].mean() for one in used])
    least = np.array([np.quantile(variance[one], 0.1) for one in used])
    floor, gain = nnls(np.column_stack([np.ones(len(used)), grey]) / least[:, None], np.ones(len(used)))[0]
    return Polynomial([floor, gain])


def _blocks(image: Grey) -> Array:
    """Mean and variance from pixel to pixel (2, n) of square blocks of an image."""
    grey = image.astype(float)
    middle = grey[:, 1:-1]
    high = (middle - (grey[:, :-2] + grey[:, 2:]) / 2) ** 2 / 1.5
    height, width = (n // _BLOCK * _BLOCK for n in middle.shape)
    shape = (height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK)
    return np.stack([part[:height, :width].reshape(shape).mean((1, 3)).ravel() for part in (middle, high)])


@dataclass(frozen=True)
class Judged:
    """Points of a detector in the columns of one class of all images.

    Share of columns that are found, and of found points that are wrong; standard deviation of the others from the
    curve, and from column to column, px, both by the median.
    """

    found: float
    wrong: float
    deviation: float
    noise: float


def judge(stripes: Sequence[Stripe], rows: Sequence[Array], kind: int) -> Judged:
    """Compare the rows (width,) of a detector in each image with the curves, in the columns of a class.

    Errors that neighbouring columns share (of the plate, of wide grains of speckle) are not in the noise, which is that
    of second differences.
    """
    away, bends = list[Array](), list[Array]()
    for stripe, found in zip(stripes, rows, strict=True):
        distance = (found[stripe.columns] - stripe.curve)[stripe.kind == kind]
        distance = np.where(np.abs(distance) < WRONG_PX, distance, np.where(np.isnan(distance), np.nan, np.inf))
        neighbours = np.diff(stripe.columns[stripe.kind == kind], 2) == 0
        away.append(distance)
        if len(distance) > 2:
            with np.errstate(invalid="ignore"):
                bends.append(np.diff(distance, 2)[neighbours])
    every = np.concatenate(away)
    near, found_share = every[np.isfinite(every)], float(np.mean(~np.isnan(every)))
    bend = np.concatenate(bends)
    wrong = 1.0 - len(near) / max(1, (~np.isnan(every)).sum())
    return Judged(found_share, wrong, _robust_deviation(near), _robust_deviation(bend) / np.sqrt(6.0))


def _robust_deviation(values: Array) -> float:
    """Standard deviation of normal values by their median distance from the median; NaN without finite ones."""
    finite = values[np.isfinite(values)]
    return _NORMAL * float(np.median(np.abs(finite - np.median(finite)))) if len(finite) else float("nan")


def read_stripes(data: Path) -> list[Stripe]:
    """The stripes of all images that show the board."""
    found = list[Stripe]()
    for folder in reality.FOLDERS:
        views = [view for view in reality.etna_views(data, folder).views if len(view.stripe)]
        files = [str(data / folder / view.name) for view in views]
        images = [np.asarray(cv2.imread(file, cv2.IMREAD_GRAYSCALE), np.uint8) for file in files]
        noise = pixel_noise(images)
        made = (stripe_of(image, view.stripe, noise) for image, view in zip(images, views, strict=True))
        found += [stripe for stripe in made if stripe is not None]
    return found


def table(stripes: Sequence[Stripe]) -> Iterator[str]:
    """A line for each detector: found and wrong; deviation from the curve; noise and its ratio to the bound."""
    kinds = range(len(CLASSES))
    counts = [sum(int((one.kind == k).sum()) for one in stripes) for k in kinds]
    yield "| stripes | " + " | ".join(f"{name} ({n})" for name, n in zip(CLASSES, counts, strict=True)) + " |"
    yield "|---" * (len(CLASSES) + 1) + "|"
    bounds = [float(np.median(np.concatenate([one.bound[one.kind == k] for one in stripes]))) for k in kinds]
    yield "| Cramér-Rao bound | " + " | ".join(f"{bound:.3f}" for bound in bounds) + " |"
    for name, rows_of in methods().items():
        rows = [rows_of(stripe.image) for stripe in stripes]
        cells = [_cell(judge(stripes, rows, k), bounds[k]) for k in kinds]
        yield f"| {name} | {' | '.join(cells)} |"


def _cell(one: Judged, bound: float) -> str:
    shares = f"{100 * one.found:.1f} %, {100 * one.wrong:.1f} %"
    if np.isnan(one.deviation):
        return shares
    return f"{shares}; {one.deviation:.2f}; {one.noise:.3f} ({one.noise / bound:.1f})"


def main() -> None:
    """Judge the detectors and write the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.real_stripes", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder with a checkout of openlmd/etna")
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    data = reality.below(given.data, "etna_calib/data")
    if data is None:
        parser.error(f"no checkout with etna_calib/data in {given.data}")
    lines = list(table(read_stripes(data)))
    print("\n".join(lines))
    replace_paragraphs(given.page, {"| stripes |": lines})


if __name__ == "__main__":
    main()
