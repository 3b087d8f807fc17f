"""How a sensor that is fitted to half of the recorded profiles of a ball predicts the other half.

The poses of the ball are those of its circles in the profiles; ``scancell.reconstruct`` and ``scancell.compare`` do the
rest, as for measurements of a robot.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import scancell
from bench.ball_profiles import BALL_RADIUS, FoundBall, write_ball_artefact
from scancell.calibration.measured_table import write_measured_table
from scancell.calibration.pose_files import flange_columns
from scancell.geometry import pose
from scancell.nominal.cell import nominal_cell
from scancell.recorded.compare import ComparisonResult, Residuals

Array = NDArray[np.float64]

SENSOR = Path(__file__).with_name("ball_sensor.toml")
# In the recordings z is towards the sensor: a point lies at _SENSOR_Z - z of the sensor frame, and at
# _CENTRE_OF_PROJECTION - z before the point where the lines of sight of all columns meet, with a pitch of this share.
_SENSOR_Z = 488.7e-3
_CENTRE_OF_PROJECTION = 553.3e-3
_PITCH_PER_DEPTH = 2.7254e-4
_ABOVE_TABLE = 0.12  # m, of the ball, as that before what is behind it in the recordings
_NEAR = 0.1e-3  # m, of points of the ball from its circle
CONTRAST = 0.2  # of the search for a better one


@dataclass(frozen=True)
class Poses:
    """Repeated poses of the ball, and for each on which side of its centre the laser sheet is: 1 or -1 (n,).

    A circle does not tell the side.
    """

    groups: Sequence[Sequence[FoundBall]]
    side: NDArray[np.int64]

    def every_other(self, first: int) -> Poses:
        """Half of them."""
        return Poses(self.groups[first::2], self.side[first::2])

    def once(self) -> Poses:
        """Each of them without its repeats."""
        return Poses([group[:1] for group in self.groups], self.side)


def with_sides(groups: Sequence[Sequence[FoundBall]]) -> Poses:
    """The side of each pose on which the simulated camera sees about as many points of the ball as the real one."""
    missing = []
    for side in (1, -1):
        found = compare_with_simulation(Poses(groups, np.full(len(groups), side)).once(), CONTRAST, 0)
        real, simulated = (np.bincount(one.exposure, minlength=len(groups)) for one in (found.real, found.simulated))
        missing.append(np.abs(real - simulated))
    return Poses(groups, np.where(missing[0] < missing[1], 1, -1))


def compare_with_simulation(poses: Poses, contrast: float, seed: int) -> ComparisonResult:
    """Real against simulated profiles of the ball, with a contrast of speckle."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        ball = write_ball_artefact(folder, BALL_RADIUS)
        write_measured_table(folder / "points.csv", _table(poses))
        settings = [f"sensor.speckle.contrast={contrast}", f"cell.part.z_mm={1e3 * _ABOVE_TABLE}"]
        found = scancell.reconstruct(folder / "points.csv", sensor=SENSOR, settings=settings, part=ball, latency_ms=0.0)
        found.save(folder / "run")
        return scancell.compare(folder / "run", seed=seed)


def _table(poses: Poses) -> dict[str, Array]:
    """Points and poses of the flange: all repeats of a pose have that of their mean circle."""
    cell = nominal_cell(scancell.load_setup().cell, None)
    base_from_table = pose.inverse(cell.arm.world_from_base) @ cell.world_from("table")
    sensor_from_flange = pose.inverse(cell.flange_from_sensor)
    flange, rows, points, columns = [], [], [], []
    for group, side in zip(poses.groups, poses.side, strict=True):
        x, z, radius = np.mean([one.circle.values for one in group], axis=0)
        beside = side * np.sqrt(max(BALL_RADIUS**2 - radius**2, 0.0))
        sensor_from_ball = np.array([beside, x, _SENSOR_Z - z])
        down = np.diag([1.0, -1.0, -1.0])
        table_from_sensor = pose.from_rotation(down, [0.0, 0.0, BALL_RADIUS + _ABOVE_TABLE] - down @ sensor_from_ball)
        for one in group:
            x_z = one.profile.points
            away = np.abs(np.linalg.norm(x_z - [x, z], axis=1) - radius)
            x_z = x_z[away < _NEAR]
            points.append(np.column_stack([np.zeros(len(x_z)), x_z[:, 0], _SENSOR_Z - x_z[:, 1]]))
            columns.append(np.round(x_z[:, 0] / (_PITCH_PER_DEPTH * (_CENTRE_OF_PROJECTION - x_z[:, 1]))))
            rows.append(np.full(len(x_z), len(flange)))
            flange.append(base_from_table @ table_from_sensor @ sensor_from_flange)
    row, every, column = np.concatenate(rows), 1e3 * np.concatenate(points), np.concatenate(columns)
    return {
        "exposure": row + 1.0,
        **{name: values[row] for name, values in flange_columns(np.array(flange)).items()},
        **{f"{axis}_mm": every[:, i] for i, axis in enumerate("xyz")},
        "column_px": column - column.min(),
    }


def fitted_contrast(poses: Poses) -> float:
    """The contrast of speckle at which simulated and real noise agree; the noise is about proportional to it."""
    contrast = CONTRAST
    for _ in range(2):
        real, simulated = _pair(compare_with_simulation(poses.once(), contrast, 0), _noise)
        contrast *= real / simulated
    return contrast


def prediction_lines(groups: Sequence[Sequence[FoundBall]]) -> Iterator[str]:
    """Table of what each half of the poses predicts of the other."""
    poses = with_sides(groups)
    halves = [poses.every_other(first) for first in (0, 1)]
    contrast = [fitted_contrast(half) for half in halves]
    found = [compare_with_simulation(half, contrast[1 - i], 1 + i) for i, half in enumerate(halves)]
    repeated = [_repeatability(one) for one in found]
    motion = [np.sqrt(max(real**2 - simulated**2, 0.0)) for real, simulated in repeated]
    yield f"| {' | '.join(_columns(poses, contrast))} |"
    yield "|---|---|---|"
    tables = [_figures(found[i], np.hypot(repeated[i][1], motion[1 - i])) for i in (1, 0)]
    for figure, cells in tables[0].items():
        yield f"| {figure} | {cells} | {tables[1].get(figure, '')} |"


def _columns(poses: Poses, contrast: Sequence[float]) -> list[str]:
    counts = [len(poses.every_other(first).groups) for first in (0, 1)]
    return [
        "real, simulated; ratio",
        *(f"fitted: {counts[i]} poses, contrast {contrast[i]:.3f}; predicted: {counts[1 - i]}" for i in (0, 1)),
    ]


def _figures(found: ComparisonResult, repeatability: float) -> dict[str, str]:
    """Figures of real and simulated profiles, µm; ranges are fifths of the points of one half."""
    real, simulated = _repeatability(found)
    cells = {"noise": _cell(*_pair(found, _noise))}
    for one in found.noise_by_angle:
        if one.real is not None and one.simulated is not None:
            low, high = np.degrees([one.low, one.high])
            cells[f"noise, {low:.0f}° to {high:.0f}°"] = _cell(one.real, one.simulated)
    for number, one in enumerate(found.noise_by_range, 1):
        if one.real is not None and one.simulated is not None:
            span = f"{1e3 * one.low:.0f} to {1e3 * one.high:.0f} mm: "
            cells[f"noise, fifth {number} of the range"] = span + _cell(one.real, one.simulated)
    cells["repeatability; simulated: of the sensor"] = _cell(real, simulated)
    cells["repeatability; simulated: with the motion between repeats of the fitted half"] = _cell(real, repeatability)
    cells["RMS distance from the ball"] = _cell(
        *_pair(found, lambda one: 1e6 * float(np.sqrt(np.mean(one.distance**2))))
    )
    return cells


def _pair(found: ComparisonResult, statistic: Callable[[Residuals], float]) -> tuple[float, float]:
    """A statistic of real and of simulated points."""
    return statistic(found.real), statistic(found.simulated)


def _noise(points: Residuals) -> float:
    """Noise from point to point, µm."""
    return 1e6 * points.noise(np.ones(len(points.distance), bool))[0]


def _repeatability(found: ComparisonResult) -> tuple[float, float]:
    """Of real and simulated profiles, µm; NaN where no pose repeats."""
    repeated = found.repeatability
    if repeated is None or repeated.real is None or repeated.simulated is None:
        return float("nan"), float("nan")
    return repeated.real, repeated.simulated


def _cell(real: float, simulated: float) -> str:
    return f"{real:.1f}, {simulated:.1f}; {simulated / real:.2f}"
