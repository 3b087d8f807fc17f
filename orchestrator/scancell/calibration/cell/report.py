"""Report of a calibration: deviations with uncertainty, the calibrated cell, files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.checks import implausible, shift_text, wrong_sizes
from scancell.calibration.cell.kinematics import TOOL, written_unit
from scancell.calibration.cell.points import write_points
from scancell.calibration.cell.problem import CalibrationResult
from scancell.calibration.cell.scan import Calibration
from scancell.calibration.report import SavedCalibration, comparison_text
from scancell.config.cell import CellDescription
from scancell.config.estimated import EstimatedDescription
from scancell.config.loading import Setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.output.manifest import resolved_toml
from scancell.output.residual_picture import residual_picture
from scancell.output.run_files import write_json
from scancell.output.run_folder import RunFolder
from scancell.planning.plan import plan_json

_DOUBTFUL = 3.0  # times the stated noise of points, from which a warning is given
# Pose errors from exposure to exposure from which a warning is given: of a position (m) and an orientation (rad).
_DOUBTFUL_POSE = (0.2e-3, np.radians(0.03))


@dataclass(frozen=True)
class Row:
    """A calibrated deviation in `unit`: value, half width of its interval, and where known the true value."""

    name: str
    unit: str
    value: float
    half_width: float
    true: float | None = None

    @property
    def error(self) -> float | None:
        """Value minus true value."""
        return None if self.true is None else self.value - self.true


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationReport(SavedCalibration):
    """A calibration of a described cell; `save` writes ``calibrated.toml`` and ``calibration.json`` as well.

    Attributes
    ----------
    calibration
        Observations, unknowns and solution.
    setup, artefact
        With the description that the calibration started from, and the artefact's mesh.
    true
        True deviations by name, SI, where the cell is simulated.
    inputs, run
        Files and settings for the manifest.
    probability
        Of the intervals.

    Examples
    --------
    >>> report = scancell.calibrate("latency", as_built={"trigger.latency_ms": 0.5})
    >>> for row in report.rows:
    ...     print(row.name, round(row.value, 2), row.unit)
    trigger.latency 0.5 ms
    >>> files = report.save("calibration")
    >>> coarse = {"scan.max_profiles": 100}
    >>> result = scancell.scan("part.stl", cell="calibration/calibrated.toml", settings=coarse, engine="geometric")
    """

    calibration: Calibration
    setup: Setup
    artefact: Mesh
    inputs: Sequence[Path]
    run: Mapping[str, Any]
    true: Mapping[str, float] | None = None
    probability: float = 0.95

    @property
    def result(self) -> CalibrationResult:
        """The solution."""
        return self.calibration.result

    @property
    def estimated(self) -> EstimatedDescription:
        """The estimated deviations as a section of the cell's description."""
        return EstimatedDescription.of(self.result.deviations, len(self.setup.cell.robot.joint))

    @property
    def cell(self) -> CellDescription:
        """The calibrated cell."""
        return self.setup.cell.model_copy(update={"estimated": self.estimated})

    @property
    def flange_from_sensor(self) -> NDArray[np.float64]:
        """Calibrated pose (4, 4) of the sensor on the flange, m."""
        found = self.result.deviations
        values = np.array([found.get(name, 0.0) for name in TOOL])
        nominal = self.calibration.problem.kinematics.flange_from_sensor
        return np.asarray(nominal @ pose.from_euler_xyz(values[:3], values[3:]))

    @property
    def rows(self) -> list[Row]:
        """The deviations that were found."""
        found = zip(self.result.names, self.result.values, self.result.half_widths(self.probability), strict=True)
        rows = []
        for name, value, half in found:
            unit, scale = written_unit(name)
            true = None if self.true is None else self.true.get(name, 0.0) / scale
            rows.append(Row(name, unit, float(value / scale), float(half / scale), true))
        return rows

    @cached_property
    def _wrong_sizes(self) -> str:
        return wrong_sizes(self.calibration.problem, self.artefact)

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result."""
        plan = self.calibration.plan
        found = list(plan.warnings) if plan is not None else []
        found += filter(None, [shift_text(self.calibration.shift), self._wrong_sizes])
        found += implausible(self.result)
        if self.result.noise_of_points > _DOUBTFUL:
            found.append(
                f"points scatter {self.result.noise_of_points:.1f} times as much as their stated sigma: is the artefact"
                " the described one, and does the cell have other deviations than those to find?"
            )
        errors = self.result.noise_of_robot  # none, of the joints, or of position and orientation
        if any(error > limit for error, limit in zip(errors[::-1], _DOUBTFUL_POSE[::-1], strict=False)):
            position = f"{1e3 * errors[0]:.3f} mm and " if len(errors) > 1 else ""
            found.append(
                f"exposures differ by random pose errors of {position}{np.degrees(errors[-1]):.3f} deg: is the sensor"
                " calibrated, and does the cell have other deviations than those to find?"
            )
        return found

    @property
    def figures(self) -> dict[str, Any]:
        """Plain figures, in the units that their names state."""
        result = self.result
        return {
            "deviations": [{**asdict(row), "error": row.error} for row in self.rows],
            "probability": self.probability,
            "covariance_si": result.covariance.tolist(),
            "observability": [
                {"direction": one.text(result.names), "standard_deviation_mm_mrad_ms": one.standard_deviation}
                for one in result.directions
            ],
            "degrees_of_freedom": result.degrees_of_freedom.tolist(),
            "exposures": len(np.unique(result.frame)),
            "points": self.calibration.measured,
            "points_on_artefact": result.points,
            "points_used": len(result.residuals),
            "rms_um": 1e6 * result.rms,
            "noise_of_points": result.noise_of_points,
            "noise_of_robot_si": list(result.noise_of_robot),
            "flange_from_sensor_m": self.flange_from_sensor.tolist(),
            "artefact_position_mm": (1e3 * result.platter_from_artefact[:3, 3]).tolist(),
            "artefact_shift_mm": (1e3 * self.calibration.shift).tolist(),
            "size_errors_um": (1e6 * result.sizes).tolist(),
        }

    def summary(self) -> str:
        """The figures as lines of text."""
        result = self.result
        percent = f"{100 * self.probability:g} %"
        exposures = len(np.unique(result.frame))
        lines = [
            f"{len(result.residuals)} of {self.calibration.measured} points of {exposures} exposures, "
            f"RMS {1e6 * result.rms:.2f} um",
            f"  {'deviation':24} {'estimate':>10}   {percent + ' interval':>14}"
            + ("" if self.true is None else f" {'true':>10} {'error':>10}"),
        ]
        lines.insert(1, f"  origin of the artefact's coordinates on the table: {_mm(result.platter_from_artefact)}")
        for row in self.rows:
            text = f"  {row.name + ' ' + row.unit:24} {row.value:10.5f} +- {row.half_width:12.5f} "
            lines.append(text + comparison_text(row.true, row.value, row.half_width))
        if set(TOOL) & set(result.names):
            found = self.flange_from_sensor
            angles = ", ".join(f"{value:.4f}" for value in np.degrees(pose.euler_xyz_from_rotation(found[:3, :3])))
            lines.append(f"  sensor on the flange: {_mm(found)}, XYZ' ({angles}) deg")
        return "\n".join(lines)

    @property
    def _distances(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        return self.result.residuals, self.result.frame

    def _write(self, folder: RunFolder) -> None:
        if self.calibration.plan is not None:
            write_json(folder.path("plan.json"), plan_json(self.calibration.plan))
        self.cell.to_toml(folder.path("calibrated.toml"))
        write_json(folder.path("calibration.json"), self.figures)
        write_points(self.calibration.problem.observations, folder.path("points.parquet"))
        residual_picture(folder.path("residuals.png"), *self._distances)
        folder.path("resolved.toml").write_text(resolved_toml(self.setup, self.run))


def _mm(found: NDArray[np.float64]) -> str:
    """Position of a pose (4, 4) as text."""
    return "(" + ", ".join(f"{1e3 * value:.3f}" for value in found[:3, 3]) + ") mm"
