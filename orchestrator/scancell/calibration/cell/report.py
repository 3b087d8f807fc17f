"""Report of a calibration: deviations with uncertainty, the calibrated cell, files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from scancell.calibration.cell.kinematics import GRASP, TOOL, written_unit
from scancell.calibration.cell.points import (
    implausible,
    read_points,
    shift_text,
    stated_axes,
    write_points,
    wrong_sizes,
)
from scancell.calibration.cell.problem import CalibrationResult
from scancell.calibration.cell.scan import (
    Calibration,
    CalibrationRequest,
    CalibrationScan,
    kinematics_of,
    single_sphere,
)
from scancell.calibration.measured_table import MeasuredTable, read_profiles
from scancell.calibration.report import SavedCalibration, comparison_text
from scancell.cell.fmu_file import parse_as_built
from scancell.config.cell import CellDescription, EstimatedDescription, ToolDescription, sensor_frame
from scancell.config.choices import Engine
from scancell.config.description import PoseDescription
from scancell.config.loading import Setup, sensor_words
from scancell.config.table_format import read_format, recognised_format
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeMesh
from scancell.geometry.tree import WORLD
from scancell.nominal.parts import tool_matrix
from scancell.output.run_folder import RunFolder, resolved_toml, write_json
from scancell.planning.plan import plan_json
from scancell.progress import Progress
from scancell.scanning.world import World

_DOUBTFUL = 3.0  # times the stated noise of points, from which a warning is given
_MAIN_SHARE = 0.5  # of a standard deviation, from which a warning says what else than noise is in it
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
        Probability of the intervals.
    exchanged
        Where a further sensor was calibrated, with which the main one was exchanged in `setup`.

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
    exchanged: ExchangedSensor | None = None

    def _named(self, name: str) -> str:
        """Name of a deviation in the described cell."""
        return name if self.exchanged is None else self.exchanged.word(name)

    @property
    def _described(self) -> Setup:
        return self.setup if self.exchanged is None else self.exchanged.setup

    @property
    def result(self) -> CalibrationResult:
        """The solution."""
        return self.calibration.result

    @property
    def estimated(self) -> EstimatedDescription:
        """The estimated deviations as a section of the cell's description."""
        found = {self._named(name): value for name, value in self.result.deviations.items()}
        return EstimatedDescription.of(found, len(self.setup.cell.robot.joint))

    @property
    def cell(self) -> CellDescription:
        """The calibrated cell."""
        return self._described.cell.model_copy(update={"estimated": self.estimated})

    @property
    def _is_held(self) -> bool:
        """Whether the arm holds the artefact, before a sensor on a post."""
        return self.calibration.problem.kinematics.flange_from_part is not None

    @property
    def carrier_from_sensor(self) -> NDArray[np.float64]:
        """Calibrated pose (4, 4) of the sensor on what carries it: the flange, the world or a further axis, m."""
        nominal = self.calibration.problem.kinematics.carrier_from_sensor
        return np.asarray(nominal @ self._moved(TOOL))

    @property
    def flange_from_sensor(self) -> NDArray[np.float64]:
        """Calibrated pose (4, 4) of the sensor on the flange, m; `DescriptionError` if the flange does not carry it."""
        if self._carrier != "flange":
            raise DescriptionError("the sensor is not on the flange: see carrier_from_sensor", key="flange_from_sensor")
        return self.carrier_from_sensor

    @property
    def flange_from_part(self) -> NDArray[np.float64]:
        """Calibrated pose (4, 4) of a held part on the flange, m; `DescriptionError` if the arm holds none."""
        if not self._is_held:
            raise DescriptionError("the part is not on the flange", key="flange_from_part")
        return np.asarray(self.result.platter_from_artefact @ self._moved(GRASP))

    def _moved(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Deviation of a frame by six names as a pose (4, 4)."""
        found = self.result.deviations
        values = np.array([found.get(name, 0.0) for name in names])
        return pose.from_euler_xyz(values[:3], values[3:])

    @property
    def rows(self) -> list[Row]:
        """The deviations that were found."""
        found = zip(self.result.names, self.result.values, self.result.half_widths(self.probability), strict=True)
        rows = []
        for name, value, half in found:
            unit, scale = written_unit(name)
            true = None if self.true is None else self.true.get(name, 0.0) / scale
            rows.append(Row(self._named(name), unit, float(value / scale), float(half / scale), true))
        return rows

    @cached_property
    def _wrong_sizes(self) -> str:
        return wrong_sizes(self.calibration.problem, self.artefact)

    @property
    def _is_found_alone(self) -> bool:
        """Whether tool and place of the artefact came from profiles of a sphere and flange poses, and need no cell."""
        problem = self.calibration.problem
        has_poses = problem.observations.readings.flange is not None and self._carrier == "flange"
        return has_poses and single_sphere(problem, self.artefact) is not None

    @property
    def warnings(self) -> list[str]:
        """Warnings about the result."""
        found = list(dict.fromkeys(text for plan in self.calibration.plans for text in plan.warnings))
        found += filter(None, [self._wrong_sizes])
        if not self._is_found_alone:
            found += filter(None, [shift_text(self.calibration.shift)])
            found += implausible(self.result)
        if (np.abs(self.result.neglected) > _MAIN_SHARE * self.result.standard_deviations).any():
            units = [written_unit(name) for name in self.result.names]
            changes = ", ".join(
                f"{self._named(name)} {abs(change) / scale:.4f} {unit}"
                for name, change, (unit, scale) in zip(self.result.names, self.result.neglected, units, strict=True)
            )
            found.append(
                "triangulation takes the laser sheet for a plane, which it is not by its description: the intervals"
                f" contain {changes} as standard deviations for it; calibrate the sensor, or set"
                ' extraction.triangulation = "sheet"'
            )
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
                {
                    "direction": one.text([*map(self._named, result.names)]),
                    "standard_deviation_mm_mrad_ms": one.standard_deviation,
                }
                for one in result.directions
            ],
            "neglected_sheet_si": result.neglected.tolist(),
            "degrees_of_freedom": result.degrees_of_freedom.tolist(),
            "exposures": len(np.unique(result.frame)),
            "points": self.calibration.measured,
            "points_on_artefact": result.points,
            "points_used": len(result.residuals),
            "rms_um": 1e6 * result.rms,
            "noise_of_points": result.noise_of_points,
            "noise_of_robot_si": list(result.noise_of_robot),
            "noise_of_surface_um": 1e6 * result.noise_of_surface,
            "left_out": [
                {
                    "exposure": exposure + 1,
                    "displacement_y_z_um": (1e6 * moved).tolist(),
                    "half_width_y_z_um": (1e6 * half).tolist(),
                }
                for exposure, moved, half in result.left_out.rows(self.probability)
            ],
            f"{self._carrier}_from_sensor_m": self.carrier_from_sensor.tolist(),
            **({"flange_from_part_m": self.flange_from_part.tolist()} if self._is_held else {}),
            "unknowns": self._unknowns,
            "covariance_of_unknowns_si": self._covariance.tolist(),
            "artefact_centre_mm": (1e3 * self._centre).tolist(),
            **({"sphere_in_base_mm": (1e3 * self._base_from_centre[:3, 3]).tolist()} if self._is_found_alone else {}),
            "artefact_position_mm": (1e3 * result.platter_from_artefact[:3, 3]).tolist(),
            "artefact_shift_mm": (1e3 * self.calibration.shift).tolist(),
            "size_errors_um": (1e6 * result.sizes).tolist(),
        }

    @property
    def _carrier(self) -> str:
        """Carrier of the sensor: flange, world, or the name of a further axis."""
        return self.calibration.problem.kinematics.sensor_on or "flange"

    @property
    def _centre(self) -> NDArray[np.float64]:
        """(3,) of the artefact on the platter, m: that of its only shape, or the origin of its coordinates."""
        shapes = self.artefact.shapes.measured if isinstance(self.artefact, ShapeMesh) else ()
        own = shapes[0].frame_from_shape[:3, 3] if len(shapes) == 1 else np.zeros(3)
        return np.asarray(pose.transform_points(self.result.platter_from_artefact, own[None])[0])

    @property
    def _base_from_centre(self) -> NDArray[np.float64]:
        """The artefact's centre as a pose (4, 4) in the base of a robot with flange poses, by the first of them."""
        problem = self.calibration.problem
        readings = problem.observations.readings
        assert readings.flange is not None
        sensor = problem.kinematics.poses(readings, self.result.deviations).platter_from_sensor[0]
        base_from_platter = readings.flange[0] @ self.flange_from_sensor @ pose.inverse(sensor)
        return np.asarray(base_from_platter @ pose.translation(self._centre))

    @property
    def _unknowns(self) -> list[str]:
        """Names of the rows of the joint covariance."""
        result = self.result
        moved = [f"artefact.{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")]
        is_known = self.calibration.problem.artefact.is_pose_known
        return [
            *map(self._named, result.names),
            *([] if is_known else moved),
            *(f"size[{i + 1}]" for i in range(len(result.sizes))),
        ]

    @property
    def _covariance(self) -> NDArray[np.float64]:
        """Joint covariance of the unknowns, with the position of the artefact at its centre."""
        joint, first = self.result.joint_covariance, len(self.result.names)
        change = np.eye(len(joint))
        if not self.calibration.problem.artefact.is_pose_known:
            # A rotation about the platter's origin moves the centre.
            change[first : first + 3, first + 3 : first + 6] = -pose.skew(self._centre)
        return np.asarray(change @ joint @ change.T)

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
        if self._is_found_alone:
            lines.insert(1, f"  centre of the sphere in the robot's base: {_mm(self._base_from_centre)}")
        else:
            place = "flange" if self._is_held else "belt" if self.calibration.problem.kinematics.belt else "table"
            at = self.flange_from_part if self._is_held else result.platter_from_artefact
            lines.insert(1, f"  origin of the artefact's coordinates on the {place}: {_mm(at)}")
        outside = np.abs(result.left_out.displacement) > result.left_out.half_widths(self.probability)
        if len(outside):
            spread = 1e6 * np.sqrt(np.mean(result.left_out.displacement**2, axis=0))
            lines.insert(
                2,
                f"  profiles left out of the fit lie {spread[0]:.1f} um (y) and {spread[1]:.1f} um (z, RMS) from its"
                f" prediction, {(~outside).all(1).sum()} of {len(outside)} within their {percent} intervals",
            )
        for row in self.rows:
            text = f"  {row.name + ' ' + row.unit:24} {row.value:10.5f} +- {row.half_width:12.5f} "
            lines.append(text + comparison_text(row.true, row.value, row.half_width))
        if set(TOOL) & set(result.names):
            carrier = self._carrier
            place = {"world": "in the world", "flange": "on the flange"}.get(carrier, f"on axis {carrier}")
            lines.append(f"  sensor {place}: {_pose_text(self.carrier_from_sensor)}")
        if set(GRASP) & set(result.names):
            lines.append(f"  part on the flange: {_pose_text(self.flange_from_part)}")
        return "\n".join(lines)

    @property
    def _distances(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        return self.result.residuals, self.result.frame

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        super()._write(folder, command_line)
        for number, plan in enumerate(self.calibration.plans, 1):
            name = "plan.json" if number == 1 else f"plan{number}.json"
            write_json(folder.path(name), plan_json(plan))
        self.cell.to_toml(folder.path("calibrated.toml"))
        write_points(self.calibration.problem.observations, folder.path("points.parquet"))
        folder.path("resolved.toml").write_text(resolved_toml(self._described, self.run))


def _mm(found: NDArray[np.float64]) -> str:
    """Position of a pose (4, 4) as text."""
    return "(" + ", ".join(f"{1e3 * value:.3f}" for value in found[:3, 3]) + ") mm"


@dataclass(frozen=True)
class ExchangedSensor:
    """A described cell, and the number of a sensor that takes the place of the main one to be calibrated."""

    setup: Setup
    number: int

    @classmethod
    def of(cls, setup: Setup, name: str) -> Self:
        """By the name of a further sensor.

        Raises `DescriptionError` if there is none, or the table or a link before the flange carries it.
        """
        names, flange = setup.sensor_names, f"link[{len(setup.cell.robot.joint)}]"
        if name not in names[1:]:
            expected = ", ".join(names[1:]) or "none: the cell has one sensor"
            raise DescriptionError(key="further_sensor", value=name, expected=expected)
        number = names.index(name) + 1
        key, sensor = f"cell.further_sensor[{number - 1}]", setup.cell.further_sensor[number - 2]
        carriers = (flange, WORLD, *(axis.name for axis in setup.cell.axis))
        if sensor.moves_with not in carriers:
            raise DescriptionError(
                "calibrations find the pose of a sensor on the flange, in the world or on an axis",
                key=f"{key}.moves_with", value=sensor.moves_with, expected=", ".join(carriers),
            )  # fmt: skip
        return cls(setup, number)

    @property
    def exchanged(self) -> Setup:
        """The same cell with both sensors exchanged: the further one is that of the tool, and sets the triggers."""
        cell, row = self.setup.cell, self.number - 2
        sensor = cell.further_sensor[row]
        flange, carrier_from_main = f"link[{len(cell.robot.joint)}]", tool_matrix(cell.tool)
        angles = np.degrees(pose.euler_xyz_from_rotation(carrier_from_main[:3, :3]))
        values = (*(1e3 * carrier_from_main[:3, 3]), *angles)
        place = dict(zip(("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"), map(float, values), strict=True))
        main = sensor.model_copy(
            update={
                "sensor": self.setup.sensor,
                "moves_with": flange if cell.tool.moves_with == "flange" else cell.tool.moves_with,
                "pose": PoseDescription(**place),
                "delay_ms": 0.0,
                "mesh": cell.sensor_mesh,
                "inertia": cell.tool.inertia,
            }
        )
        carrier = "flange" if sensor.moves_with == flange else sensor.moves_with
        tool = ToolDescription(moves_with=carrier, pose=sensor.pose, inertia=sensor.inertia)
        others = [one.model_copy(update={"sensor": one.sensor or self.setup.sensor}) for one in cell.further_sensor]
        others[row] = main
        changes: dict[str, Any] = {"tool": tool, "sensor_mesh": sensor.mesh, "further_sensor": (*others,)}
        if cell.estimated is not None:
            found = {self.word(name): value for name, value in cell.estimated.deviations().items()}
            changes["estimated"] = EstimatedDescription.of(found, len(cell.robot.joint))
        return Setup(cell.model_copy(update=changes), sensor.sensor or self.setup.sensor, self.setup.scan)

    def word(self, word: str) -> str:
        """A deviation, or its ``key=value`` word, of the cell in the exchanged one, and the other way round."""
        own = sensor_frame(self.number)
        if word.startswith("tool."):
            return f"{own}.{word.removeprefix('tool.')}"
        if word.startswith("sensor."):
            return f"{own}.{word.removeprefix('sensor.')}"
        if not word.startswith(f"{own}."):
            return word
        of_optics = sensor_words([word if "=" in word else f"{word}=0"])
        return f"{'sensor' if of_optics else 'tool'}.{word.removeprefix(f'{own}.')}"


def _pose_text(found: NDArray[np.float64]) -> str:
    """Position and angles of a pose (4, 4) as text."""
    angles = ", ".join(f"{value:.4f}" for value in np.degrees(pose.euler_xyz_from_rotation(found[:3, :3])))
    return f"{_mm(found)}, XYZ' ({angles}) deg"


def calibrate_in_cell(
    scan: CalibrationScan, world: World, request: CalibrationRequest, engine: Engine, progress: Progress
) -> CalibrationReport:
    """Measure an artefact in the simulated cell, and calibrate.

    Raises `ScancellError` naming what is wrong and what was expected.

    Parameters
    ----------
    scan
        That of the request in the nominal cell.
    world
        The artefact in the cell with as-built deviations.
    """
    made = scan.run(world, engine, progress)
    units = scan.pipeline.runner.units(world)
    true = true_deviations(parse_as_built(world.as_built, units), len(world.setup.cell.conveyor))
    return _report(made, world, request, true)


def calibrate_from_points(
    scan: CalibrationScan,
    world: World,
    request: CalibrationRequest,
    points: Path,
    flange: Path | None = None,
    convention: str | None = None,
    table_format: str | Path | None = None,
) -> CalibrationReport:
    """Calibrate from measured points of an artefact, see `read_points`, or profiles in a sensor's format.

    Raises `ScancellError` naming what is wrong and what was expected.
    """
    form = recognised_format(points) if table_format is None else read_format(table_format)
    profiles = None if form is None else read_profiles(points, form)
    table = None if profiles is None else MeasuredTable(points, profiles.columns())
    kinematics = kinematics_of(world.nominal)
    joints, missing = len(kinematics.arm.joints), stated_axes(world.setup)[1]
    measured = read_points(points, joints, flange, convention, table, kinematics.further, missing)
    report = _report(scan.solve_measured(measured), world, request, None)
    files = (points,) if profiles is None else profiles.files
    return replace(report, inputs=(*report.inputs, *files, *([] if flange is None else [flange])))


def _report(
    made: Calibration, world: World, request: CalibrationRequest, true: dict[str, float] | None
) -> CalibrationReport:
    run = {
        "artefact": world.part,
        "what": request.what,
        "seed": world.seed,
        "as_built": list(world.as_built),
        "free": list(made.problem.free),
    }
    inputs = () if world.part_file is None else (world.part_file,)
    return CalibrationReport(made, world.setup, world.nominal.part, inputs, run, true)


def start_of(setup: Setup) -> dict[str, float]:
    """Deviations that the description of the cell already holds, SI."""
    estimated = setup.cell.estimated
    return {} if estimated is None else {name: value for name, value in estimated.deviations().items() if value}


def true_deviations(as_built: dict[str, float], belts: int = 0) -> dict[str, float]:
    """As-built parameters of the FMU (SI) by the names of calibration: without prefix, the wobble by its components."""
    found = {name.removeprefix("as_built."): value for name, value in as_built.items()}
    scale = found.pop("belt.encoder_scale", 0.0)  # of all belts
    found |= {f"conveyor[{number}].encoder_scale": scale for number in range(1, belts + 1)}
    amplitude, phase, direction = (found.pop(f"table.wobble_{key}", 0.0) for key in ("amplitude", "phase", "direction"))
    if amplitude:
        for axis, share in (("rx", np.cos(direction)), ("ry", np.sin(direction))):
            found[f"table.wobble_{axis}_cos"] = float(amplitude * share * np.cos(phase))
            found[f"table.wobble_{axis}_sin"] = float(-amplitude * share * np.sin(phase))
    return found
