"""Dynamic scans against stop-and-look over speed and latency: ``PYTHONPATH=tests python -m bench.scan_modes``.

Prints the table of ``docs/scan_modes.md`` and draws ``docs/pictures/scan_modes.png``. The latency is calibrated in the
simulator, by passes over a sphere.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt

import scancell
from scancell.config.cell import EstimatedDescription
from scancell.config.choices import Engine
from scancell.config.loading import assets_dir

PICTURE = Path(__file__).parents[2] / "docs" / "pictures" / "scan_modes.png"
PART = assets_dir() / "parts" / "free_form.stl"
SPEEDS = (12.5, 25.0, 50.0, 100.0)  # mm/s of the passes; the table turns at as many deg/s
CASES = {
    "no latency": {},
    "0.5 ms": {"trigger.latency_ms": 0.5},
    "2 ms": {"trigger.latency_ms": 2.0},
    "5 ms": {"trigger.latency_ms": 5.0},
    "2 ms, jitter 0.2 ms": {"trigger.latency_ms": 2.0, "trigger.jitter_ms": 0.2},
}
PROFILES = 400


@dataclass(frozen=True)
class Outcome:
    """Duration of a scan, s, and RMS deviations of its cloud, um, without and with a calibrated latency."""

    duration: float
    rms: float
    calibrated_rms: float


def settings(mode: str, speed: float) -> dict[str, float | str]:
    """Of a scan: the speed of the sensor in passes (mm/s) and of the table (deg/s)."""
    return {
        "scan.mode": mode,
        "scan.max_profiles": PROFILES,
        "scan.raster.speed_mm_s": speed,
        "scan.sweep.speed_deg_s": speed,
    }


def calibrations(engine: Engine, cases: Mapping[str, Mapping[str, float]] = CASES) -> dict[str, EstimatedDescription]:
    """What a calibration of the latency finds in each case."""
    with scancell.Scanner() as scanner:
        return {
            name: scanner.calibrate("latency", as_built=dict(as_built), seed=7, engine=engine).estimated
            for name, as_built in cases.items()
        }


def scans(
    mode: str, speed: float, found: dict[str, EstimatedDescription], engine: Engine
) -> Iterator[tuple[str, Outcome]]:
    """Outcome of each case."""
    with scancell.Scanner(settings=settings(mode, speed)) as scanner:
        for name, estimated in found.items():
            options = {"engine": engine, "as_built": CASES[name], "seed": 3, "normals": False, "samples": False}
            plain = scanner.scan(PART, **options)
            calibrated = scanner.scan(PART, **options, estimated=estimated)
            duration = float(plain.recording.measured.time[-1])
            yield name, Outcome(duration, 1e6 * plain.deviation.figures.rms, 1e6 * calibrated.deviation.figures.rms)


def draw(outcomes: dict[tuple[str, float], dict[str, Outcome]]) -> None:
    """Draw the deviation against the speed."""
    plt.style.use("scancell.plots")
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True)
    colours = dict(zip(CASES, ("#2a9d8f", "#6aa5d8", "#2f6db5", "#c2582b", "#8d3b72"), strict=True))
    still = next(values for (mode, _), values in outcomes.items() if mode == "stop-and-look")
    for axis, title in zip(axes, ("before calibration of the latency", "after"), strict=True):
        for name, colour in colours.items():
            moving = {speed: values[name] for (mode, speed), values in outcomes.items() if mode == "dynamic"}
            rms = [one.calibrated_rms if title == "after" else one.rms for one in moving.values()]
            axis.loglog(list(moving), rms, "-o", color=colour, label=f"dynamic, {name}")
        at_rest = max(one.rms for one in still.values())
        axis.axhline(at_rest, color="#222831", linestyle="--", label="stop-and-look, all cases")
        axis.set(title=title, xlabel="speed (mm/s; table: deg/s)")
        axis.set_xticks(SPEEDS, [f"{speed:g}" for speed in SPEEDS])
        axis.minorticks_off()
        axis.grid()
    axes[0].set_ylabel("RMS deviation from the mesh (um)")
    axes[1].legend(loc="upper left")
    figure.savefig(PICTURE)
    plt.close(figure)


def rows(engine: Engine) -> Iterator[str]:
    """Lines of the table."""
    found = calibrations(engine)
    outcomes = {("stop-and-look", 0.0): dict(scans("stop-and-look", SPEEDS[1], found, engine))}
    for speed in SPEEDS:
        outcomes["dynamic", speed] = dict(scans("dynamic", speed, found, engine))
    yield "| mode | speed | duration | " + " | ".join(CASES) + " |"
    yield "|---|---|---|" + "---|" * len(CASES)
    for (mode, speed), values in outcomes.items():
        cells = [f"{one.rms:.2f} / {one.calibrated_rms:.2f}" for one in values.values()]
        duration = next(iter(values.values())).duration
        said = f"{speed:g} mm/s" if speed else "at rest"
        yield f"| {mode} | {said} | {duration:.0f} s | {' | '.join(cells)} |"
    draw(outcomes)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", choices=("geometric", "ray-traced"), default="geometric")
    for row in rows(parser.parse_args().engine):
        print(row, flush=True)


if __name__ == "__main__":
    main()
