"""`scancell calibrate`: find the deviations of a cell, or of a sensor, from its description."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, cast

import typer

import scancell
from scancell.cli.common import (
    AsBuiltOption,
    EngineOption,
    Options,
    Outcome,
    SeedOption,
    SensorOption,
    SetOption,
    ThreadsOption,
    command,
    show_progress,
)
from scancell.config.choices import CalibrationTarget, FlangeConvention, SensorTarget
from scancell.errors import DescriptionError

SensorArgument = Annotated[
    Path | None, typer.Argument(metavar="[SENSOR]", help="sensor description (TOML); the shipped one by default")
]
AlsoOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME", help="further deviation to find: dh[3].theta, sensor.camera[1].distortion[2]; repeatable"
    ),
]
ConventionOption = Annotated[
    FlangeConvention | None, "convention of the columns flange_orientation_1 … of flange poses"
]
CalibrationOutOption = Annotated[Path, "folder for the calibrated description, figures and points"]
PoseWord = Literal["described", "unknown"]


@dataclass(frozen=True)
class CellCalibrationOptions(Options):
    """Options of the calibration of a cell by scans of an artefact."""

    description: Annotated[
        Path | None, typer.Argument(metavar="[CELL]", help="cell description (TOML); the shipped one by default")
    ] = None
    artefact: Annotated[
        Path | None, "artefact description (TOML), or the mesh of any part; default: a sphere, or a ball plate"
    ] = None
    from_points: Annotated[Path | None, "points and joints or flange poses of a real cell (CSV, Parquet, YAML)"] = None
    flange: Annotated[Path | None, "flange poses of the exposures of --from-points, if its table holds none"] = None
    convention: ConventionOption = None
    table_format: Annotated[
        str | None,
        "format of profiles of a sensor in --from-points: a shipped one or a TOML file"
        " (docs/how_to/own_profiles.md); default: by the content",
    ] = None
    out: CalibrationOutOption = Path("out/calibration")
    also: AlsoOption = None
    poses: Annotated[int | None, typer.Option(min=0, help="exposures at rest; default 24")] = None
    passes: Annotated[
        int | None, typer.Option(min=0, help="passes over the artefact in motion; default 8 for latency")
    ] = None
    axis_positions: Annotated[
        int, typer.Option(min=1, max=100, help="positions of further axes at which their deviations are measured")
    ] = 4
    pose: Annotated[PoseWord | None, "pose of the artefact: taken from the description, or found"] = None
    unknown_size: Annotated[bool, "also find the sizes of the shapes of the artefact"] = False
    random_poses: Annotated[bool, "draw poses at random instead of minimizing the expected covariance"] = False
    robot_noise: Annotated[
        Literal["none", "joints", "flange"], "random errors of the robot that the covariance includes"
    ] = "flange"
    further_sensor: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="name of a further sensor, to calibrate in place of the main one"),
    ] = None
    engine: EngineOption = "geometric"
    sensor: SensorOption = None
    settings: SetOption = None
    as_built: AsBuiltOption = None
    seed: SeedOption = 0
    threads: ThreadsOption = 0

    def calibrate(self, what: CalibrationTarget, *, wobble: bool = False) -> Outcome:
        """Calibrate `what`, and write the results."""
        request = scancell.CalibrationRequest(
            what=what,
            also=tuple(self.also or ()),
            wobble=wobble,
            poses=self.poses,
            passes=self.passes,
            is_pose_known=None if self.pose is None else self.pose == "described",
            is_size_known=not self.unknown_size,
            designed=not self.random_poses,
            robot_noise=self.robot_noise,
            pose_seed=self.seed,
            further_sensor=self.further_sensor,
            axis_positions=self.axis_positions,
        )
        with show_progress(self.as_json) as progress:
            report = scancell.calibrate(
                request,
                self.artefact,
                cell=self.description,
                sensor=self.sensor,
                settings=self.settings or (),
                threads=self.threads,
                engine=self.engine,
                as_built=self.as_built or (),
                seed=self.seed,
                from_points=self.from_points,
                flange=self.flange,
                convention=self.convention,
                table_format=self.table_format,
                progress=progress,
            )
        return _saved(report, self.out, "cell  ")


@dataclass(frozen=True)
class TableCalibrationOptions(CellCalibrationOptions):
    """Options of the calibration of a cell whose table turns."""

    wobble: Annotated[bool, "also find the wobble of the table axis"] = False


@command("calibrate tool", CellCalibrationOptions)
def calibrate_tool(options: CellCalibrationOptions) -> Outcome:
    """Find the pose of the sensor on the flange or on its post from scans of an artefact; write a calibrated cell."""
    return options.calibrate("tool")


@command("calibrate grasp", CellCalibrationOptions)
def calibrate_grasp(options: CellCalibrationOptions) -> Outcome:
    """Find the pose of a part on the flange from scans of it, and write a calibrated cell."""
    return options.calibrate("grasp")


@command("calibrate table", TableCalibrationOptions)
def calibrate_table(options: TableCalibrationOptions) -> Outcome:
    """Find the axis of the table from scans of an artefact, and write a calibrated cell."""
    return options.calibrate("table", wobble=options.wobble)


@command("calibrate belt", CellCalibrationOptions)
def calibrate_belt(options: CellCalibrationOptions) -> Outcome:
    """Find direction and encoder scale of a belt from a part that passes the sensor, and write a calibrated cell."""
    return options.calibrate("belt")


@command("calibrate latency", CellCalibrationOptions)
def calibrate_latency(options: CellCalibrationOptions) -> Outcome:
    """Find the delay of the exposures from scans of an artefact, and write a calibrated cell."""
    return options.calibrate("latency")


@command("calibrate all", TableCalibrationOptions)
def calibrate_all(options: TableCalibrationOptions) -> Outcome:
    """Find tool, table and latency together from scans of an artefact, and write a calibrated cell."""
    return options.calibrate("all", wobble=options.wobble)


@command("calibrate sensor")
def calibrate_sensor(
    sensor: SensorArgument = None,
    targets: Annotated[
        list[str] | None,
        typer.Option("--target", help="target of the simulated sensor: ball (default), step, checkered; repeatable"),
    ] = None,
    from_points: Annotated[Path | None, "peaks of a real sensor (CSV, Parquet, YAML)"] = None,
    out: CalibrationOutOption = Path("out/calibration"),
    also: AlsoOption = None,
    pose: Annotated[PoseWord | None, "pose of the stage of the target: taken from the description, or found"] = None,
    unknown_size: Annotated[bool, "also find the sizes of the shapes of the target"] = False,
    settings: SetOption = None,
    as_built: AsBuiltOption = None,
    seed: SeedOption = 0,
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Find cameras and laser sheet from a target of known shape, simulated or real, and write a calibrated sensor."""
    if from_points is not None:
        for key, given in (("targets", targets), ("pose", pose), ("as_built", as_built)):
            if given:
                raise DescriptionError("does not apply to calibrate sensor --from-points", key=key)
    request = scancell.SensorCalibrationRequest(
        targets=cast("tuple[SensorTarget, ...]", tuple(targets or ("ball",))),
        from_points=from_points,
        is_pose_known=pose != "unknown",
        is_size_known=not unknown_size,
        also=tuple(also or ()),
    )
    with show_progress(as_json) as progress:
        report = scancell.calibrate_sensor(
            request,
            sensor=sensor,
            settings=settings or (),
            threads=threads,
            as_built=as_built or (),
            seed=seed,
            progress=progress,
        )
    return _saved(report, out, "sensor")


@command("calibrate board")
def calibrate_board(
    from_images: Annotated[
        Path,
        typer.Option(
            help="images of a chessboard with the stripe on it, by one camera on a robot, with a table of flange poses"
        ),
    ],
    board: Annotated[str, typer.Option(metavar="COLUMNSxROWSxMM", help="inner corners, side of a square: 7x6x10")],
    sensor: SensorArgument = None,
    convention: ConventionOption = None,
    out: CalibrationOutOption = Path("out/calibration"),
    settings: SetOption = None,
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Find camera, laser sheet and pose on the flange from images of a chessboard, and write a calibrated sensor."""
    with show_progress(as_json) as progress:
        report = scancell.calibrate_from_images(
            from_images,
            board,
            sensor=sensor,
            settings=settings or (),
            convention=convention,
            threads=threads,
            progress=progress,
        )
    return _saved(report, out, "sensor")


def _saved(
    report: scancell.CalibrationReport | scancell.SensorCalibrationReport | scancell.BoardCalibrationReport,
    out: Path,
    kind: str,
) -> Outcome:
    """The outcome of a calibration of that `kind` of description, whose files are written into `out`."""
    files = report.save(out)
    written = next((file for file in files if file.name.startswith("calibrated")), out / "calibration.json")
    lines = [report.summary(), f"  calibrated {kind}  {written}"]
    return Outcome(lines, report.figures, [str(file) for file in files], report.warnings)
