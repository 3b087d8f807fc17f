"""`python -m bench.extraction` (in tests/): accuracy, stated deviations and time of extraction (docs/extraction.md)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from benchmarks.tracks.stripe import FLOOR_E2
from scancell.sensor import Scene, Sensor, extract, scan

from .table import cpu_model, replace_paragraphs
from .timing import measure

TESTS = Path(__file__).resolve().parents[1]
sys.path.append(str(TESTS / "sensor_rt"))

import test_accuracy  # noqa: E402
import test_edges  # noqa: E402
import test_ghosts  # noqa: E402
from scenes import moving, plane, pose  # noqa: E402
from stripe_images import OPEN, PEAK_E, accepted, images_of, make_sensor, mean_bound, stripe  # noqa: E402

Array = NDArray[np.float64]

WIDTH, HEIGHT, FRAMES = 1280, 128, 6
FULL_WELL = {"full_well_e": PEAK_E}
WEAK_E = 1000.0
# The detectors are compared without the limits that reject badly shaped stripes.
LIMITS = OPEN | {"min_sigma_px": 0.1, "max_sigma_px": 8.0}
NAMES = {
    "gaussian": "Gaussian least squares, pixel-integrated, saturation masked (`gaussian`)",
    "log_parabola": "weighted log-parabola ±4 (`log_parabola`)",
    "derivative_of_gaussian": "derivative-of-Gaussian zero crossing (`derivative_of_gaussian`)",
    "blais_rioux_4": "Blais-Rioux, four rows (`blais_rioux_4`)",
    "blais_rioux_8": "Blais-Rioux, eight rows (`blais_rioux_8`)",
    "centre_of_gravity": "centre of gravity, background removed (`centre_of_gravity`)",
    "parabola": "three-point parabola (`parabola`)",
    "steger": "Steger's ridge, over neighbouring columns too (`steger`)",
}


@dataclass(frozen=True)
class Errors:
    """Errors of row (px) of the peaks that are not rejected."""

    values: Array

    @property
    def std(self) -> float:
        return float(self.values.std()) if len(self.values) else float("nan")

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.values**2))) if len(self.values) else float("nan")

    @property
    def bias(self) -> float:
        return float(self.values.mean()) if len(self.values) else float("nan")


def rows(frame: int) -> Array:
    """Centres of a slightly slanted stripe: every position between two pixels comes up."""
    return 60.0 + 0.0137 * np.arange(WIDTH) + 0.29 * frame


def stripe_errors(sensor: Sensor, sigma: float, peak: float, ghost: float = 0.0) -> Errors:
    """Errors over some images of one stripe, with a second one of share `ghost` six rows below."""
    truth = np.stack([rows(f) for f in range(FRAMES)])
    light = np.stack([stripe(r, sigma, peak, HEIGHT) + stripe(r + 6.0, sigma, ghost * peak, HEIGHT) for r in truth])
    peaks = extract(images_of(sensor, light, FRAMES), sensor)
    return Errors((peaks.row - truth[peaks.frame, peaks.column])[accepted(peaks)])


def sensor_with(method: str, **sections: dict[str, object]) -> Sensor:
    """Sensor of the comparison."""
    return make_sensor(WIDTH, HEIGHT, extraction={"detector": method} | LIMITS, **sections)


def milliseconds(detector: str) -> float:
    """Time per 1280 × 1024 image with a stripe in every column, on one core."""
    sensor = make_sensor(extraction={"detector": detector})
    image = images_of(sensor, stripe(300.0 + 0.2 * np.arange(1280), 1.5, 8000.0, 1024))
    return 1e3 * measure(lambda: extract(image, sensor, threads=1), repeats=15).best


def detector_table() -> Iterator[str]:
    """One line per detector."""
    heads = ["detector", "σ = 0.8", "σ = 1.5", "σ = 3", "weak", "2.7 × saturated", "25 % ghost at +6 px", "ms/image"]
    yield "| " + " | ".join(heads) + " |"
    yield "|---" * len(heads) + "|"
    bounds = [mean_bound(s, p, FLOOR_E2) for s, p in ((0.8, PEAK_E), (1.5, PEAK_E), (3.0, PEAK_E), (1.5, WEAK_E))]
    yield "| Cramér-Rao bound | " + " | ".join(f"{b:.4f}" for b in bounds) + " | | | |"
    for detector, name in NAMES.items():
        sensor = sensor_with(detector)
        figures = [f"{stripe_errors(sensor, s, PEAK_E).std:.4f}" for s in (0.8, 1.5, 3.0)]
        figures.append(f"{stripe_errors(sensor, 1.5, WEAK_E).std:.4f}")
        saturated = stripe_errors(sensor_with(detector, detector=FULL_WELL), 1.5, 2.7 * PEAK_E).rms
        figures.append("none found" if np.isnan(saturated) else f"{saturated:.4f}")
        figures.append(f"{stripe_errors(sensor, 1.5, PEAK_E, ghost=0.25).bias:+.3f}")
        figures.append(f"{milliseconds(detector):.2f}")
        yield f"| {name} | " + " | ".join(figures) + " |"


def stated_ratio(detector: str, sigma: float, height: float, full_well_e: float = 11_000.0) -> float:
    """Standard deviation of the error over the stated one; height of the stripe in shares of PEAK_E."""
    sensor = sensor_with(detector, detector={"full_well_e": full_well_e})
    truth = np.stack([rows(f) for f in range(FRAMES // 2)])
    light = np.stack([stripe(r, sigma, height * PEAK_E, HEIGHT) for r in truth])
    peaks = extract(images_of(sensor, light, len(truth)), sensor)
    keep = accepted(peaks)
    if keep.sum() < WIDTH // 2:
        return float("nan")
    error, stated = (peaks.row - truth[peaks.frame, peaks.column])[keep], peaks.row_sigma[keep].astype(float)
    return float(error.std() / np.sqrt(np.mean(stated**2)))


def sigma_table() -> Iterator[str]:
    """One line per detector: the range of observed over stated standard deviations."""
    groups = {"σ = 0.6, 0.8 px": (0.6, 0.8), "σ = 1, 1.5 px": (1.0, 1.5), "σ = 3, 4 px": (3.0, 4.0)}
    heads = ["observed / stated", *groups, "2.7 × saturated, σ = 0.8 to 3 px"]
    yield "| " + " | ".join(heads) + " |"
    yield "|---" * len(heads) + "|"
    for detector in NAMES:
        cells = [
            [stated_ratio(detector, sigma, height) for sigma in widths for height in (0.133, 0.4, 0.889)]
            for widths in groups.values()
        ]
        cells.append([stated_ratio(detector, s, 2.7, full_well_e=PEAK_E) for s in (0.8, 1.0, 1.5, 2.2, 3.0)])
        ranges = ["none found" if np.isnan(c).all() else f"{np.nanmin(c):.2f} … {np.nanmax(c):.2f}" for c in cells]
        yield f"| `{detector}` | " + " | ".join(ranges) + " |"


def speckle_table() -> Iterator[str]:
    """Observed over stated standard deviations of a speckled plane that moves along the sheet's normal."""
    yield "| speckle, travel per exposure, µm | 0 | 25 | 50 | 100 | 200 | 400 |"
    yield "|---|---|---|---|---|---|---|"
    for contrast in (0.1, 0.5, 1.0):
        sensor = make_sensor(speckle={"contrast": contrast}, laser={"power": 2e-3, "fan_half_angle": 0.28}, cameras=2)
        ratios = []
        for travel in (0.0, 25e-6, 50e-6, 100e-6, 200e-6, 400e-6):
            poses = [pose((0.013 + s * travel, -0.021, 0.12)) for s in (-0.5, 0.5)]
            points = scan(plane(), sensor, moving([[place] for place in poses], [np.eye(4)] * 2)).profiles
            error = points.points_in_sensor[:, 2] - 0.12
            ratios.append(error.std() / np.sqrt(np.mean(points.sigma.astype(float) ** 2)))
        yield f"| contrast {contrast:g} | " + " | ".join(f"{ratio:.2f}" for ratio in ratios) + " |"


def step_deviation() -> float:
    """Largest relative departure from the closed form of the pull that a step of reflectance has."""
    sigma, centre = 2.0, 64.0 + np.linspace(-0.5, 0.5, WIDTH)
    z = ((np.arange(HEIGHT * 64) + 0.5) / 64 - 0.5)[:, None] - centre
    options = {"detector": "centre_of_gravity", "max_asymmetry": 10.0}
    deep = {"bit_depth": 16, "gain_dn_per_e": 5.0}
    sensor = make_sensor(WIDTH, HEIGHT, render={"noise": False}, detector=deep, extraction=options)
    worst = 0.0
    for edge in (-2.0, -1.0, 0.0, 1.5):
        for ratio in (0.3, 0.6):
            light = 8000.0 * np.exp(-0.5 * (z / sigma) ** 2) * np.where(z > edge, ratio, 1.0)
            peaks = extract(images_of(sensor, light.reshape(HEIGHT, 64, WIDTH).mean(axis=1)), sensor)
            e = edge / sigma
            predicted = -sigma * (1 - ratio) * norm.pdf(e) / (norm.cdf(e) + ratio * norm.sf(e))
            worst = max(worst, abs(float(np.mean(peaks.row - centre)) / predicted - 1.0))
    return worst


def stripe_requirements() -> Iterator[tuple[str, str, str]]:
    """What, measured, wanted."""
    quiet = make_sensor(WIDTH, HEIGHT, render={"noise": False})
    bias = max(stripe_errors(quiet, s, PEAK_E).rms for s in (0.8, 1.5, 3.0))
    yield "bias without noise, RMS, σ = 0.8 … 3", f"{bias:.4f} px", "≤ 0.003 px"
    noisy = make_sensor(WIDTH, HEIGHT)
    widths, peaks = (0.8, 1.0, 1.5, 2.2, 3.0), (PEAK_E, 2500.0)
    ratio = max(stripe_errors(noisy, s, p).std / mean_bound(s, p, FLOOR_E2) for s in widths for p in peaks)
    yield "standard deviation over Cramér-Rao bound, σ = 0.8 … 3", f"≤ {ratio:.3f}", "≤ 1.2"
    full = make_sensor(WIDTH, HEIGHT, detector=FULL_WELL)
    saturated = {s: stripe_errors(full, s, 2.7 * PEAK_E).rms for s in widths}
    text = ", ".join(f"{v:.4f}" for v in saturated.values())
    yield f"RMS error at 2.7 × saturation, σ = {', '.join(map(str, widths))}", f"{text} px", "≤ 0.01 px"
    yield "pull of a reflectance step on the centre of gravity", f"within {100 * step_deviation():.2f} %", "2 %"
    yield "time per image, `gaussian`, one core", f"{milliseconds('gaussian'):.2f} ms", "≤ 2 ms"


def shape_requirements() -> Iterator[tuple[str, str, str]]:
    """RMS of rendered shapes without noise."""
    for z in (0.090, 0.125, 0.160):
        scene, centre = Scene(), np.array([0.0005, 0.0003, z])
        scene.add_sphere("sphere", [0.0, 0.0, 0.0], 0.0125, 0.5)
        points, flagged = test_accuracy.measure(scene, pose(centre))
        yield _shape(
            f"sphere of 25 mm around z = {1e3 * z:g} mm", np.linalg.norm(points - centre, axis=1) - 0.0125, flagged
        )
    for z in (0.078, 0.120, 0.161):
        scene, place = Scene(), pose([0.0, 0.0, z], [0.08, 0.1, 0.0])
        scene.add_plane("plane", np.eye(4), [0.2, 0.2], 0.5)
        points, flagged = test_accuracy.measure(scene, place)
        yield _shape(f"tilted plane around z = {1e3 * z:g} mm", (points - place[:3, 3]) @ place[:3, 2], flagged)


def _shape(name: str, deviation: Array, flagged: float) -> tuple[str, str, str]:
    rms, largest = 1e6 * np.sqrt(np.mean(deviation**2)), 1e6 * np.abs(deviation).max()
    measured = f"RMS {rms:.2f} µm, largest {largest:.1f} µm, {100 * flagged:.1f} % flagged"
    return name, measured, "RMS ≤ 3 µm, ≤ 5 % flagged"


def ghost_requirements() -> Iterator[tuple[str, str, str]]:
    """Reflections on polished grooves and steps."""
    for peak in ("brightest", "continuity", "agreement"):
        total = sum((test_ghosts.count(walls, peak, 1) for walls in test_ghosts.SCENES), test_ghosts.Count())
        rejected, lost = 1.0 - total.accepted / total.ghosts, total.lost / total.good
        measured = f"{100 * rejected:.2f} % of {total.ghosts} rejected, {100 * lost:.2f} % of {total.good} points lost"
        yield f'ghosts, `peak = "{peak}"`', measured, "≥ 99 % and ≤ 1 %" if peak == "agreement" else ""


def edge_requirements() -> Iterator[tuple[str, str, str]]:
    """A matt box in many poses over a plane, without noise: points near its edges that one camera sees in part."""
    kept = len(test_edges.box_errors("brightest", False))
    for peak in ("brightest", "agreement"):
        errors = 1e6 * test_edges.box_errors(peak, False)
        figures = f"RMS {np.sqrt(np.mean(errors**2)):.2f} µm, largest {errors.max():.0f} µm"
        lost = 100 * (1 - len(errors) / kept)
        measured = f"{figures}, {(errors > 20).sum()} of {len(errors)} points above 20 µm, {lost:.2f} % lost"
        yield f'box, `peak = "{peak}"`', measured, ""


def belief_requirements() -> Iterator[tuple[str, str, str]]:
    """What cameras that agree with one another make of a sheet that lies off its place, unknown to them."""
    for offset in (0.0, 10e-6, 20e-6, 50e-6):
        kept = 100 * test_edges.kept_with_sheet_off(offset)
        yield f'points kept by `peak = "agreement"`, sheet {1e6 * offset:g} µm off its place', f"{kept:.1f} %", ""


def requirement_table() -> Iterator[str]:
    """One line per figure that is asked for."""
    yield "| quantity | measured | required |"
    yield "|---|---|---|"
    for part in (stripe_requirements, shape_requirements, ghost_requirements, edge_requirements, belief_requirements):
        for what, measured, wanted in part():
            yield f"| {what} | {measured} | {wanted} |"


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(prog="python -m bench.extraction", description=__doc__)
    parser.add_argument("--sigmas", action="store_true", help="only the tables of stated standard deviations")
    parser.add_argument("--page", type=Path, default=TESTS.parent / "docs" / "extraction.md")
    arguments = parser.parse_args()
    page = arguments.page
    command = "Written by `PYTHONPATH=tests python -m bench.extraction`."
    tables = {"| observed / stated |": list(sigma_table()), "| speckle, travel": list(speckle_table())}
    if not arguments.sigmas:
        tables |= {"| detector |": list(detector_table()), "| quantity |": list(requirement_table())}
        tables |= {command: [f"{command} CPU: {cpu_model()}."]}
    replace_paragraphs(page, tables)
    print("\n".join(line for table in tables.values() for line in table))


if __name__ == "__main__":
    main()
