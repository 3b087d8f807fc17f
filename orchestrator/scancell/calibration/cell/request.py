"""`calibrate`: a calibration by name, in the simulated cell or from measured points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Self

import numpy as np

from scancell.arguments import Seed, checked_fields
from scancell.calibration.cell.kinematics import LATENCY, PLATTER, TABLE, TOOL, WOBBLE
from scancell.calibration.cell.points import read_points
from scancell.calibration.cell.report import CalibrationReport
from scancell.calibration.cell.scan import Calibration, CalibrationOptions, CalibrationScan
from scancell.calibration.measured_table import MeasuredTable
from scancell.calibration.profile_table import read_profiles
from scancell.cell.as_built import parse_as_built
from scancell.config.choices import CalibrationTarget, Engine
from scancell.config.loading import Setup
from scancell.config.study import CalibrateDescription
from scancell.config.table_format import read_format, recognised_format
from scancell.progress import Progress
from scancell.scanning.world import World

_PASSES = 8


@checked_fields
@dataclass(frozen=True)
class CalibrationRequest:
    """Quantities and options of a calibration; None selects the default for `what`.

    Attributes
    ----------
    what
        tool: pose of the sensor on the flange, with the table at rest. table: its axis, and the eccentricity of the
        platter if the artefact's pose is known, by the tool as it is. latency: of the trigger. all: these together.
    also
        Further deviations to find, such as ``dh[3].theta``, by the names of as-built parameters.
    poses, passes
        Number of exposures at rest, and of passes in motion.
    is_pose_known, is_size_known
        Whether pose and size of the artefact are exact; else they are found, too.
    designed
        Whether poses are chosen for the information that they give; else at random.
    robot_noise
        Where random errors of the robot are expected: none, joints, or flange.
    wobble
        Whether to find the wobble of the table axis, too.
    pose_seed
        Random seed of the views among which poses are chosen.

    Examples
    --------
    >>> request = scancell.CalibrationRequest("tool", also=("dh[3].theta",))
    >>> report = scancell.calibrate(request, as_built={"dh[3].theta_deg": 0.05})
    >>> [row.name for row in report.rows][-1]
    'dh[3].theta'
    """

    what: CalibrationTarget = "all"
    also: tuple[str, ...] = ()
    wobble: bool = False
    poses: int | None = None
    passes: int | None = None
    is_pose_known: bool | None = None
    is_size_known: bool = True
    designed: bool = True
    robot_noise: Literal["none", "joints", "flange"] = "flange"
    pose_seed: Seed = 0

    @classmethod
    def of(cls, described: CalibrateDescription) -> Self:
        """The request that a study has `described`."""
        plain = described.model_dump(exclude={"artefact", "pose"})
        return cls(**plain, is_pose_known=None if described.pose is None else described.pose == "described")

    @property
    def artefact(self) -> str:
        """Default artefact, a shipped one: a tilt of the table axis needs spheres at different distances from it."""
        return "artefacts/ball_plate.toml" if self.what in {"table", "all"} else "artefacts/sphere.toml"

    @property
    def options(self) -> CalibrationOptions:
        """Complete options."""
        known = self.what in {"table", "all"} if self.is_pose_known is None else self.is_pose_known
        table = TABLE + (PLATTER if known else ()) + (WOBBLE if self.wobble else ())
        free = {"tool": TOOL, "table": table, "latency": (LATENCY,), "all": (*TOOL, *table, LATENCY)}[self.what]
        moving, still = self.what in {"latency", "all"}, self.what != "latency"
        return CalibrationOptions(
            free=tuple(dict.fromkeys((*free, *self.also))),
            poses=(24 if still else 0) if self.poses is None else self.poses,
            passes=(_PASSES if moving else 0) if self.passes is None else self.passes,
            turn_table=self.what in {"table", "all"},
            is_pose_known=known,
            is_size_known=self.is_size_known,
            designed=self.designed,
            robot_noise=self.robot_noise,
            pose_seed=self.pose_seed,
        )


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
    return _report(made, world, request, true_deviations(parse_as_built(world.as_built, units)))


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
    measured = read_points(points, len(world.setup.cell.robot.joint), flange, convention, table)
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


def true_deviations(as_built: dict[str, float]) -> dict[str, float]:
    """As-built parameters of the FMU (SI) by the names of calibration: without prefix, the wobble by its components."""
    found = {name.removeprefix("as_built."): value for name, value in as_built.items()}
    amplitude, phase, direction = (found.pop(f"table.wobble_{key}", 0.0) for key in ("amplitude", "phase", "direction"))
    if amplitude:
        for axis, share in (("rx", np.cos(direction)), ("ry", np.sin(direction))):
            found[f"table.wobble_{axis}_cos"] = float(amplitude * share * np.cos(phase))
            found[f"table.wobble_{axis}_sin"] = float(-amplitude * share * np.sin(phase))
    return found
