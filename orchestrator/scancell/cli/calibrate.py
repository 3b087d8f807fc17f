"""`scancell calibrate`: find the deviations of a cell, or of a sensor, from its description."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

from scancell.cli.common import (
    AsBuiltOption,
    EngineOption,
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

if TYPE_CHECKING:
    from scancell.calibration.board.report import BoardCalibrationReport
    from scancell.calibration.cell.report import CalibrationReport
    from scancell.calibration.sensor.report import SensorCalibrationReport
    from scancell.progress import Progress

# Parameters of the calibration of a cell alone, and of simulated targets alone.
_OF_CELL = (
    "artefact",
    "flange",
    "convention",
    "table_format",
    "wobble",
    "poses",
    "passes",
    "random_poses",
    "robot_noise",
    "engine",
    "sensor",
)
_NOT_OF_IMAGES = (*(name for name in _OF_CELL if name != "convention"), "from_points", "also", "unknown_size", "seed")
_OF_SIMULATION = ("target", "pose", "as_built")


@command("calibrate")
def calibrate(
    context: typer.Context,
    what: Annotated[
        Literal["tool", "table", "latency", "all", "sensor"],
        typer.Argument(
            help="pose of the sensor on the flange, axis of the table, delay of the exposures, or all;"
            " or cameras and laser sheet of the sensor"
        ),
    ],
    description: Annotated[
        Path | None,
        typer.Argument(metavar="[CELL|SENSOR]", help="cell or sensor description (TOML); the shipped one by default"),
    ] = None,
    artefact: Annotated[
        Path | None,
        typer.Option(
            "--artefact",
            help="artefact description (TOML), or the mesh of any part; default: a sphere, or a ball plate",
        ),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option("--target", help="target of the simulated sensor: ball (default), step, checkered; repeatable"),
    ] = None,
    from_points: Annotated[
        Path | None,
        typer.Option(
            "--from-points",
            help="points and joints or flange poses of a real cell, or peaks of a real sensor (CSV, Parquet, YAML)",
        ),
    ] = None,
    flange: Annotated[
        Path | None,
        typer.Option("--flange", help="flange poses of the exposures of --from-points, if its table holds none"),
    ] = None,
    convention: Annotated[
        FlangeConvention | None,
        typer.Option("--convention", help="convention of the columns flange_orientation_1 … of flange poses"),
    ] = None,
    table_format: Annotated[
        str | None,
        typer.Option(
            "--table-format",
            help="format of profiles of a sensor in --from-points: a shipped one or a TOML file"
            " (docs/how_to/own_profiles.md); default: by the content",
        ),
    ] = None,
    from_images: Annotated[
        Path | None,
        typer.Option(
            "--from-images",
            help="images of a chessboard with the stripe on it, by one camera on a robot, with a table of flange poses",
        ),
    ] = None,
    board: Annotated[
        str | None,
        typer.Option("--board", metavar="COLUMNSxROWSxMM", help="inner corners, side of a square: 7x6x10"),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", help="folder for the calibrated description, figures and points")
    ] = Path("out/calibration"),
    also: Annotated[
        list[str] | None,
        typer.Option(
            "--also",
            metavar="NAME",
            help="further deviation to find: dh[3].theta, sensor.camera[1].distortion[2]; repeatable",
        ),
    ] = None,
    wobble: Annotated[bool, typer.Option("--wobble", help="also find the wobble of the table axis")] = False,
    poses: Annotated[int | None, typer.Option("--poses", min=0, help="exposures at rest; default 24")] = None,
    passes: Annotated[
        int | None, typer.Option("--passes", min=0, help="passes over the artefact in motion; default 8 for latency")
    ] = None,
    pose: Annotated[
        Literal["described", "unknown"] | None,
        typer.Option(
            "--pose", help="pose of the artefact, or of the stage of the target: taken from the description, or found"
        ),
    ] = None,
    unknown_size: Annotated[
        bool, typer.Option("--unknown-size", help="also find the sizes of the shapes of artefact or target")
    ] = False,
    random_poses: Annotated[
        bool, typer.Option("--random-poses", help="draw poses at random instead of minimizing the expected covariance")
    ] = False,
    robot_noise: Annotated[
        Literal["none", "joints", "flange"],
        typer.Option("--robot-noise", help="random errors of the robot that the covariance includes"),
    ] = "flange",
    engine: EngineOption = "geometric",
    sensor: SensorOption = None,
    set_: SetOption = None,
    as_built: AsBuiltOption = None,
    seed: SeedOption = 0,
    threads: ThreadsOption = 0,
    as_json: bool = False,
) -> Outcome:
    """Scan an artefact, find the deviations of the cell, and write a calibrated cell; or the same for a sensor."""
    from scancell.config.loading import load_setup  # noqa: PLC0415
    from scancell.scanner import Scanner  # noqa: PLC0415

    def cell_report(progress: Progress) -> CalibrationReport:
        from scancell.calibration.cell.scan import CalibrationRequest  # noqa: PLC0415

        _refuse(context, what, ("target", "from_images", "board"))
        request = CalibrationRequest(
            what=cast(CalibrationTarget, what),
            also=tuple(also or ()),
            wobble=wobble,
            poses=poses,
            passes=passes,
            is_pose_known=None if pose is None else pose == "described",
            is_size_known=not unknown_size,
            designed=not random_poses,
            robot_noise=robot_noise,
            pose_seed=seed,
        )
        with Scanner(setup=load_setup(description, sensor, None, set_ or []), threads=threads) as scanner:
            return scanner.calibrate(
                request,
                artefact,
                engine=engine,
                as_built=as_built or (),
                seed=seed,
                from_points=from_points,
                flange=flange,
                convention=convention,
                table_format=table_format,
                progress=progress,
            )

    def image_report(folder: Path, progress: Progress) -> BoardCalibrationReport:
        from scancell.api import calibrate_from_images  # noqa: PLC0415

        _refuse(context, "sensor --from-images", (*_NOT_OF_IMAGES, *_OF_SIMULATION))
        if board is None:
            raise DescriptionError(
                "is missing", key="board", expected="inner corners and side in mm, for example 7x6x10"
            )
        return calibrate_from_images(
            folder,
            board,
            sensor=description,
            settings=set_ or [],
            convention=convention,
            threads=threads,
            progress=progress,
        )

    def sensor_report(progress: Progress) -> SensorCalibrationReport:
        from scancell.calibration.sensor.report import SensorCalibrationRequest  # noqa: PLC0415

        _refuse(context, what, (*_OF_CELL, "board"))
        if from_points is not None:
            _refuse(context, "sensor --from-points", _OF_SIMULATION)
        request = SensorCalibrationRequest(
            targets=cast("tuple[SensorTarget, ...]", tuple(target or ("ball",))),
            from_points=from_points,
            is_pose_known=pose != "unknown",
            is_size_known=not unknown_size,
            also=tuple(also or ()),
        )
        with Scanner(setup=load_setup(None, description, None, set_ or []), threads=threads) as scanner:
            return scanner.calibrate_sensor(request, as_built=as_built or (), seed=seed, progress=progress)

    with show_progress(as_json) as progress:
        report: CalibrationReport | SensorCalibrationReport | BoardCalibrationReport
        if what != "sensor":
            report = cell_report(progress)
        elif from_images is not None:
            report = image_report(from_images, progress)
        else:
            report = sensor_report(progress)
    files = report.save(out)
    written = next((file for file in files if file.name.startswith("calibrated")), out / "calibration.json")
    lines = [report.summary(), f"  calibrated {'sensor' if what == 'sensor' else 'cell  '}  {written}"]
    return Outcome(lines, report.figures, [str(file) for file in files], report.warnings)


def _refuse(context: typer.Context, what: str, names: Sequence[str]) -> None:
    """Refuse options that do not apply."""
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise DescriptionError(f"does not apply to calibrate {what}", key=name)
