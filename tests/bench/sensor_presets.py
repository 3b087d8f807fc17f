"""`PYTHONPATH=tests python -m bench.sensor_presets`: sensor presets against the figures of their classes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scancell.config.choices import Engine
from scancell.config.loading import assets_dir, load_setup
from scancell.evaluation.plane_trial import PlaneReading, PlaneTarget, linearity, measure_plane

_MARGIN = 0.02  # of the measuring range, left free at both ends


@dataclass(frozen=True)
class ClassFigures:
    """Figures of a class of probes; docs/sensor_presets.md compares them with published ones.

    Attributes
    ----------
    near, far
        Measuring range, mm.
    line
        Length of the profile at its start, middle and end, mm.
    points
        Per profile and camera.
    noise
        Standard deviation of single points at the middle of the range, um.
    repeatability
        Standard deviation of the mean height of repeated profiles, um.
    linearity
        Largest deviation from the best line, in % of the measuring range.
    """

    near: float
    far: float
    line: tuple[float, float, float]
    points: int
    noise: float
    repeatability: float
    linearity: float


CLASSES = {
    "short_range_8": ClassFigures(52.5, 60.5, (9.4, 10.0, 10.7), 1280, 1.0, 0.2, 0.1),
    "short_range_25": ClassFigures(53.5, 78.5, (23.4, 26.0, 29.1), 1280, 2.0, 0.4, 0.1),
    "medium_range_50": ClassFigures(70.0, 120.0, (42.0, 50.0, 58.0), 1280, 4.0, 0.5, 0.1),
    "medium_range_80": ClassFigures(90.0, 170.0, (47.0, 66.0, 85.0), 1280, 10.0, 0.8, 0.05),
    "long_range_400": ClassFigures(300.0, 700.0, (158.0, 260.0, 365.0), 1280, 40.0, 2.0, 0.1),
}
"""By the name of the preset."""

FOLDERS = ("", "realistic/")


@dataclass(frozen=True)
class Simulated:
    """The same figures as `ClassFigures`, from exposures of a matt white plane.

    `noise` is that at the start, in the middle and at the end of the range; `linearity` is over the laser line,
    `linearity_of_mean` that of the mean heights.
    """

    line: tuple[float, ...]
    points: int
    noise: tuple[float, ...]
    repeatability: float
    linearity: float
    linearity_of_mean: float


def preset_file(name: str) -> Path:
    """Description of a preset; ``realistic/...`` of one with a real lens."""
    return assets_dir() / "sensors" / f"{name}.toml"


def simulate(name: str, engine: Engine, exposures: int, positions: int = 5, seed: int = 0) -> Simulated:
    """Figures of a preset from exposures at an odd number of positions over its range."""
    noisy = load_setup(sensor=preset_file(name)).sensor
    near, far = noisy.range.near_mm, noisy.range.far_mm
    free = _MARGIN * (far - near)
    distances = 1e-3 * np.linspace(near + free, far - free, positions)
    readings = [measure_plane(noisy, PlaneTarget(z), exposures, engine, seed=seed) for z in distances]
    figures = [one.figures() for one in readings]
    three = (0, positions // 2, positions - 1)
    off = linearity(readings)
    percent = 1e5 / (far - near)
    return Simulated(
        line=tuple(_line(readings, 1e-3 * at) for at in (near, (near + far) / 2, far)),
        points=figures[three[1]].points // (exposures * len(noisy.camera)),
        noise=tuple(1e6 * figures[k].noise for k in three),
        repeatability=max(1e6 * one.repeatability_of_mean for one in figures),
        linearity=percent * off.of_field,
        linearity_of_mean=percent * off.of_mean,
    )


def _line(readings: Sequence[PlaneReading], distance: float) -> float:
    """Length of the laser line, mm, at a distance, m, on the straight line through those of the readings."""
    lengths = [1e3 * (one.line[1] - one.line[0]) for one in readings]
    return float(np.polyval(np.polyfit([one.target.z for one in readings], lengths, 1), distance))


def main() -> None:
    """Print the table of docs/sensor_presets.md."""
    parser = argparse.ArgumentParser(prog="python -m bench.sensor_presets", description=__doc__)
    parser.add_argument("--engine", choices=("ray-traced", "geometric"), default="ray-traced")
    parser.add_argument("--exposures", type=int, default=20)
    parser.add_argument("--positions", type=int, default=11)
    given = parser.parse_args()
    print("| preset | line, mm | points | noise, um | repeatability, um | linearity, % | of the mean, % |")
    print("|---|---|---|---|---|---|---|")
    for name, wanted in ((f"{folder}{name}", wanted) for folder in FOLDERS for name, wanted in CLASSES.items()):
        found = simulate(name, given.engine, given.exposures, given.positions)
        line = ", ".join(f"{simulated:.1f} ({said:g})" for simulated, said in zip(found.line, wanted.line, strict=True))
        noise = ", ".join(f"{value:.2g}" for value in found.noise)
        print(
            f"| `{name}` | {line} | {found.points} ({wanted.points}) | {noise} ({wanted.noise:g})"
            f" | {found.repeatability:.2g} (≤ {wanted.repeatability:g})"
            f" | {found.linearity:.3f} (≤ {wanted.linearity:g}) | {found.linearity_of_mean:.4f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
