"""`reconstruct`: from user input to the measurements, the descriptions and the cloud."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scancell.calibration.board.views import TABLES
from scancell.config.cell import CellDescription
from scancell.config.choices import FlangeConvention, LatencyWord
from scancell.config.loading import Setup, load_setup
from scancell.config.sensor import SensorDescription
from scancell.config.table_format import read_format, recognised_format
from scancell.errors import DescriptionError
from scancell.geometry.mesh import Mesh
from scancell.nominal.parts import load_part
from scancell.progress import Progress
from scancell.reconstruction.cloud_files.read import holds_cloud
from scancell.recorded.calibrated import read_calibration, with_sensor_at
from scancell.recorded.measurements import Measurements, read_cloud_of, read_measurements
from scancell.recorded.reconstruct import MeasuredCell, reconstruct_measurements
from scancell.recorded.result import ReconstructionResult
from scancell.recorded.uncertainty import ValueCovariance

Cell = str | Path | CellDescription | None
Sensor = str | Path | SensorDescription | None


@dataclass(frozen=True)
class ReconstructRequest:
    """Measurements to reconstruct, and how; see `scancell.reconstruct` for the attributes."""

    data: Path
    part: Path | Mesh | None = None
    unit: str = "mm"
    cloud_unit: str | None = None
    calibration: Path | None = None
    flange: Path | None = None
    table_format: str | Path | None = None
    convention: FlangeConvention | None = None
    laser_off: Path | None = None
    quarter_turns: int | None = None
    latency_ms: float | LatencyWord | None = None
    keep_all: bool = False
    threads: int = 0


def calibrated_setup(
    cell: Cell, sensor: Sensor, calibration: Path | None, settings: list[str]
) -> tuple[Setup, int, tuple[ValueCovariance, ...], list[Path]]:
    """Descriptions with what a calibration has found, quarter turns, uncertainty, and the files that were read.

    Raises `DescriptionError` if a file is wrong, or cell or sensor are given and calibrated.
    """
    if calibration is None:
        return load_setup(cell, sensor, None, settings), 0, (), _files(cell, sensor)
    found = read_calibration(calibration)
    for key, given, own in (("cell", cell, found.cell), ("sensor", sensor, found.sensor)):
        if given is not None and own is not None:
            raise DescriptionError(
                f"conflicts with {own} of the calibration", key=key, value=str(given), expected="one of them"
            )
    setup = load_setup(cell or found.cell, sensor or found.sensor, None, settings)
    if found.flange_from_sensor is not None:
        setup = Setup(with_sensor_at(setup.cell, found.flange_from_sensor), setup.sensor, setup.scan)
    file = calibration / "calibration.json" if calibration.is_dir() else calibration
    files = [*_files(cell or found.cell, sensor or found.sensor), file]
    return setup, found.quarter_turns, found.uncertainty, files


def _files(*given: object) -> list[Path]:
    return [Path(item) for item in given if isinstance(item, str | Path)]


def _measurements(
    request: ReconstructRequest, setup: Setup, mesh: Mesh | None, turns: int, progress: Progress
) -> Measurements:
    """Measurements of a table, of profiles in a format of a sensor, a folder of images, or a cloud without poses."""
    form = None if request.table_format is None else read_format(request.table_format)
    is_cloud = form is None and request.data.is_file() and holds_cloud(request.data)
    has_poses = any((request.data / name).is_file() for name in TABLES)  # of images
    if form is None and not is_cloud and not has_poses and request.data.exists():
        form = recognised_format(request.data)
    if is_cloud or (form is not None and request.flange is None):
        for key in ("flange", "convention", "laser_off", "quarter_turns"):
            if getattr(request, key) is not None:
                raise DescriptionError(
                    "does not apply to a cloud without poses", key=key, value=str(getattr(request, key))
                )
        if form is not None and request.cloud_unit is not None:
            raise DescriptionError("applies to a cloud; the format states its units", key="cloud_unit")
        flange_from_sensor = MeasuredCell.of(setup, mesh).cell.flange_from_sensor
        return read_cloud_of(request.data, request.cloud_unit, flange_from_sensor, form)
    if request.cloud_unit is not None:
        raise DescriptionError(
            "applies to a cloud; the names of columns of a table state their units",
            key="cloud_unit",
            value=request.cloud_unit,
        )
    return read_measurements(
        request.data,
        setup.sensor,
        len(setup.cell.robot.joint),
        flange=request.flange,
        convention=request.convention,
        laser_off=request.laser_off,
        quarter_turns=(turns if request.data.is_dir() and form is None else 0)
        if request.quarter_turns is None
        else request.quarter_turns,
        threads=request.threads,
        progress=progress,
        form=form,
    )


def reconstruct_request(
    request: ReconstructRequest, cell: Cell, sensor: Sensor, settings: list[str], progress: Progress
) -> ReconstructionResult:
    """Reconstruct measurements, see `scancell.reconstruct`.

    Raises `ScancellError` naming what is wrong and what was expected.
    """
    setup, turns, uncertainty, inputs = calibrated_setup(cell, sensor, request.calibration, settings)
    part = request.part
    mesh = part.usable if isinstance(part, Mesh) else None if part is None else load_part(part, request.unit)
    found = _measurements(request, setup, mesh, turns, progress)
    progress.stage("reconstructing", 1, "cloud")
    latency = request.latency_ms
    made = reconstruct_measurements(
        found,
        setup,
        mesh,
        latency if latency is None or isinstance(latency, str) else 1e-3 * latency,
        request.keep_all,
        request.threads,
        uncertainty,
    )
    progress.advance(1)
    file = None if part is None or isinstance(part, Mesh) else part
    run = {
        "part": str(file.absolute()) if file is not None else "" if mesh is None else mesh.source,
        "unit": request.unit,
        "measured": str(request.data.absolute()),
        "latency_ms": 1e3 * made.latency.value,
        "keep_all": request.keep_all,
    }
    names = tuple(camera.name for camera in setup.sensor.camera)
    files = [*inputs, *found.files, *([] if file is None else [file])]
    return ReconstructionResult(made, setup, mesh, tuple(files), run, names, request.threads)
