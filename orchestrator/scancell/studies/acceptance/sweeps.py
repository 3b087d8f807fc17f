"""Signed bias and standard deviation of the sensor against range, angles, reflectance and speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scancell.config.choices import Engine
from scancell.config.loading import Setup
from scancell.evaluation.plane_trial import Linearity, PlaneTarget, linearity, measure_plane
from scancell.progress import Progress
from scancell.studies.acceptance.measure import Programme

_SWEEP_RANGE_MARGIN = 0.02  # of the measuring range, left free at both ends
_STEEPEST = np.radians(60.0)
_REFLECTANCES = (0.02, 0.95)
_SLOPE = np.radians(30.0)  # of the moving target: motion along a level one changes nothing
_FASTEST = 4.0  # times the speed of the passes


@dataclass(frozen=True)
class Sweep:
    """Figures of a matt plane while one quantity changes; `values` in `unit`, and a row of figures for each."""

    name: str
    unit: str
    values: tuple[float, ...]
    rows: tuple[dict[str, Any], ...]

    def as_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "name": self.name,
            "unit": self.unit,
            "rows": [{"value": value, **row} for value, row in zip(self.values, self.rows, strict=True)],
        }


@dataclass(frozen=True)
class SensorSweeps:
    """All sweeps, and the linearity over the range."""

    sweeps: tuple[Sweep, ...]
    linearity: Linearity


def sensor_sweeps(
    setup: Setup,
    as_built: Sequence[str],
    programme: Programme,
    engine: Engine,
    seed: int,
    threads: int,
    progress: Progress,
) -> SensorSweeps:
    """Expose a matt plane at rest, or moving, in front of the sensor alone.

    Raises
    ------
    ScancellError
        If the sensor is wrong.
    """
    listed = _targets(setup, programme.steps)
    progress.stage("sensor", sum(len(values) for _, _, values, _ in listed), "targets")
    found, over_range = [], Linearity(float("nan"), float("nan"))
    for name, unit, values, target in listed:
        readings = []
        for value in values:
            progress.advance(1)
            at, exposures = target(value), programme.exposures
            readings.append(
                measure_plane(setup.sensor, at, exposures, engine, as_built=as_built, seed=seed, threads=threads)
            )
        rows = tuple(one.figures().as_row() for one in readings)
        found.append(Sweep(name, unit, tuple(values), rows))
        seen = [one for one in readings if len(one.signed)]
        if name == "range" and len(seen) > 2:
            over_range = linearity(seen)
    return SensorSweeps(tuple(found), over_range)


def _targets(setup: Setup, steps: int) -> list[tuple[str, str, list[float], Callable[[float], PlaneTarget]]]:
    """Name, unit, values and target of each sweep."""
    near, far = setup.sensor.range.near_mm, setup.sensor.range.far_mm
    free, middle = _SWEEP_RANGE_MARGIN * (far - near), 0.5e-3 * (near + far)
    steepest = float(np.degrees(_STEEPEST))
    angles = np.linspace(-steepest, steepest, steps).tolist()
    fastest = _FASTEST * setup.scan.raster.speed_mm_s
    return [
        ("range", "mm", np.linspace(near + free, far - free, steps).tolist(), lambda z: PlaneTarget(1e-3 * z)),
        ("in-plane angle", "deg", angles, lambda angle: PlaneTarget(middle, in_plane=np.radians(angle))),
        ("out-of-plane angle", "deg", angles, lambda angle: PlaneTarget(middle, out_of_plane=np.radians(angle))),
        (
            "reflectance",
            "1",
            np.geomspace(*_REFLECTANCES, steps).tolist(),
            lambda share: PlaneTarget(middle, reflectance=share),
        ),
        (
            "speed",
            "mm/s",
            np.linspace(0.0, fastest, steps).tolist(),
            lambda speed: PlaneTarget(middle, out_of_plane=_SLOPE, speed=1e-3 * speed),
        ),
    ]
