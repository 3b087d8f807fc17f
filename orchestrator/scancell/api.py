"""Functions for single calls: each opens the objects that it needs, does one task, and closes them.

Parameters of the same name mean the same everywhere: `Scanner` and `Scanner.scan` state them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from scancell.arguments import (
    Count,
    LatencyMs,
    Length,
    Points,
    Pose,
    QuarterTurns,
    Repeats,
    Seed,
    Share,
    Threads,
    checked_arguments,
    checked_value,
)
from scancell.calibration.cell.report import CalibrationReport
from scancell.calibration.cell.scan import CalibrationRequest
from scancell.calibration.sensor.report import SensorCalibrationReport, SensorCalibrationRequest
from scancell.config.cell import CellDescription
from scancell.config.choices import (
    Align,
    CalibrationTarget,
    Engine,
    FlangeConvention,
    LatencyWord,
    LengthUnit,
    Reconstruction,
    SensorTarget,
)
from scancell.config.files import Assignments, assignments
from scancell.config.loading import load_setup
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError, require
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeGroup
from scancell.nominal.parts import load_artefact, load_part
from scancell.options import (
    BatchOptions,
    CalibrateOptions,
    CalibrateSensorOptions,
    RenderOptions,
    ScanOptions,
    ShotOptions,
    SurveyOptions,
)
from scancell.planning.plan import Plan
from scancell.planning.setups import SetUps
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.sources import cloud_of, points_of
from scancell.results import ScanResult, ShotResult
from scancell.scanner import Scanner
from scancell.scanning.survey import SurveyResult

if TYPE_CHECKING:
    from scancell.calibration.board.report import BoardCalibrationReport
    from scancell.evaluation.artefact import ArtefactEvaluation
    from scancell.evaluation.mesh_evaluation import MeshEvaluation
    from scancell.output.run_folder import RunReport
    from scancell.recorded.compare import ComparisonResult
    from scancell.recorded.result import ReconstructionResult
    from scancell.studies.acceptance.report import AcceptanceReport
    from scancell.studies.batch import BatchResult
    from scancell.studies.report import StudyReport

Cell = str | Path | CellDescription | None
Sensor = str | Path | SensorDescription | None
Scan = str | Path | ScanDescription | None


@checked_arguments
def scan(
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: Threads = 0,
    **options: Unpack[ScanOptions],
) -> ScanResult:
    """Scan a part once; parameters as of `Scanner` and `Scanner.scan`.

    Examples
    --------
    >>> scancell.scan("part.stl", engine="geometric", as_built={"tool.x_mm": 0.1}, seed=3)
    ScanResult('part.stl', engine='geometric', seed=3: ... profiles, ... points)
    """
    with Scanner(cell, sensor, scan, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.scan(part, **options)


@checked_arguments
def shot(
    part: str | Path | Mesh,
    part_from_sensor: Pose,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: Threads = 0,
    **options: Unpack[ShotOptions],
) -> ShotResult:
    """Expose once from a pose of the sensor in the part frame; parameters as of `Scanner` and `Scanner.shot`.

    Examples
    --------
    >>> above = scancell.location(0, 0, 0.1, rx=180 * scancell.deg)  # looks down, 100 mm above the origin of the part
    >>> shot = scancell.shot("part.stl", above)
    >>> shot.images.images.shape
    (2, 1024, 1280)
    """
    with Scanner(cell, sensor, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.shot(part, part_from_sensor, **options)


@checked_arguments
def render(
    recording: str | Path,
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: Threads = 0,
    **options: Unpack[RenderOptions],
) -> ScanResult:
    """Images and a cloud from a recording; parameters as of `Scanner` and `Scanner.render`.

    Examples
    --------
    >>> coarse = {"scan.max_profiles": 20}
    >>> files = scancell.scan("part.stl", settings=coarse, engine="geometric").save("run")
    >>> scancell.render("run/recording.parquet", "part.stl", engine="geometric")
    ScanResult('part.stl', engine='geometric', seed=0: ... profiles, ... points)
    """
    with Scanner(cell, sensor, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.render(recording, part, **options)


@checked_arguments
def plan(
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    unit: str = "mm",
    progress: Progress | ProgressCallback | None = None,
) -> Plan:
    """Plan and check the scan of a part; parameters as of `Scanner` and `Scanner.plan`.

    Examples
    --------
    >>> plan = scancell.plan("part.stl", settings={"scan.mode": "stop-and-look", "scan.max_profiles": 40})
    >>> plan.axes.shape == (len(plan.segment), 7)
    True
    """
    with Scanner(cell, sensor, scan, settings=settings) as scanner:
        return scanner.plan(part, unit=unit, progress=progress)


@checked_arguments
def place(
    part: str | Path | Mesh,
    share: Share = 0.99,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    unit: str = "mm",
    progress: Progress | ProgressCallback | None = None,
) -> SetUps:
    """Propose set-ups of a free part for scanning; parameters as of `Scanner` and `Scanner.place`.

    Examples
    --------
    >>> set_ups = scancell.place(scancell.box_mesh((0.06, 0.04, 0.02)), 0.8)
    >>> print(set_ups)
    6 stable resting poses; 100.0 % of the surface is measurable in one of them
      one set-up scans ... % of that
    """
    with Scanner(cell, sensor, scan, settings=settings) as scanner:
        return scanner.place(part, share, unit=unit, progress=progress)


@checked_arguments
def calibrate(
    request: CalibrationRequest | CalibrationTarget = "all",
    artefact: str | Path | Mesh | None = None,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: Threads = 0,
    **options: Unpack[CalibrateOptions],
) -> CalibrationReport:
    """Find the deviations of a cell; parameters as of `Scanner` and `Scanner.calibrate`.

    Examples
    --------
    >>> report = scancell.calibrate("tool", as_built={"tool.x_mm": 1.0})
    >>> round(report.estimated.tool.x_mm, 1)
    1.0
    """
    with Scanner(cell, sensor, scan, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.calibrate(request, artefact, **options)


@checked_arguments
def calibrate_sensor(
    request: SensorCalibrationRequest | SensorTarget = "ball",
    *,
    sensor: Sensor = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: Threads = 0,
    **options: Unpack[CalibrateSensorOptions],
) -> SensorCalibrationReport:
    """Find the deviations of a sensor; parameters as of `Scanner` and `Scanner.calibrate_sensor`.

    Examples
    --------
    >>> report = scancell.calibrate_sensor("ball", as_built={"sensor.camera[1].tilt_deg": 29.4})
    >>> round(report.sensor.camera[0].tilt_deg, 1)
    29.4
    """
    with Scanner(sensor=sensor, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.calibrate_sensor(request, **options)


@checked_arguments
def calibrate_from_images(
    folder: str | Path,
    board: str,
    *,
    sensor: Sensor = None,
    settings: Assignments = (),
    convention: FlangeConvention | None = None,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> BoardCalibrationReport:
    """Calibrate a camera with a laser line on a robot, from images of a chessboard with the stripe on it.

    Intrinsics, laser sheet, pose of the camera on the flange and pose of the board are found together. The other
    parameters are those of `Scanner` and `Scanner.scan`.

    Parameters
    ----------
    folder
        Images, and a table of the flange's poses with a row for each (docs/calibration_sensor.md).
    board
        Inner corners in a row and in a column of the chessboard, and the side of a square in mm: ``7x6x10``.
    sensor
        Description whose detector, laser and extraction are kept; the first camera is the one to calibrate.
    convention
        Of orientations whose columns do not state it.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected; `CalibrationError` where the images do not determine the unknowns,
        or flange poses disagree with them.

    Examples
    --------
    >>> try:
    ...     scancell.calibrate_from_images("recorded", "7x7x10")
    ... except scancell.DescriptionError as error:
    ...     print(error.expected)
    an odd and an even number of corners
    """
    from scancell.calibration.board.report import calibrate_board  # noqa: PLC0415  (its solvers take 0.4 s to import)
    from scancell.calibration.board.views import Board  # noqa: PLC0415

    setup = load_setup(None, sensor, None, assignments(settings))
    return calibrate_board(setup, Path(folder), Board.parse(board), convention, threads, as_progress(progress))


@checked_arguments
def survey(
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: Threads = 0,
    **options: Unpack[SurveyOptions],
) -> SurveyResult:
    """Find occupied and unseen space around the table; parameters as of `Scanner` and `Scanner.survey`.

    Examples
    --------
    >>> survey = scancell.survey("part.stl", radius=0.05, height=0.1)
    >>> survey.exposures > 0
    True
    """
    with Scanner(cell, sensor, scan, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.survey(part, **options)


@checked_arguments
def extract(
    images: Sequence[str | Path],
    out: str | Path,
    *,
    sensor: Sensor = None,
    settings: Assignments = (),
    laser_off: Sequence[str | Path] = (),
    sheet_um: Length | None = None,
    peaks: bool = False,
    threads: Threads = 0,
) -> RunReport:
    """Measure the stripe in images of a sensor, real or simulated, and write profiles into the folder `out`.

    The other parameters are those of `Scanner`.

    Parameters
    ----------
    images, laser_off
        Image files or folders, and laser-off (background) frames to subtract.
    sheet_um
        Flag points that, by two cameras, are farther than this off the laser sheet.
    peaks
        Also write every peak that was found.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> shot = scancell.shot("part.stl", scancell.location(0, 0, 0.1, rx=180 * scancell.deg))
    >>> files = shot.save("shot")
    >>> report = scancell.extract(["shot/image_plus.png", "shot/image_minus.png"], "profiles")
    >>> report.figures["exposures"]
    1
    """
    from scancell.config.loading import load_setup  # noqa: PLC0415
    from scancell.output.extract_images import ExtractionRequest, extract_to_folder  # noqa: PLC0415

    if not images:
        raise DescriptionError("images: expected at least one image file or folder")
    setup = load_setup(None, sensor, None, assignments(settings))
    files, background = ([Path(item) for item in items] for items in (images, laser_off))
    request = ExtractionRequest(files, setup.sensor, peaks, threads, background, sheet_um)
    return extract_to_folder(request, Path(out))


@checked_arguments
def reconstruct(
    data: str | Path,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    settings: Assignments = (),
    part: str | Path | Mesh | None = None,
    unit: str = "mm",
    cloud_unit: LengthUnit | None = None,
    calibration: str | Path | None = None,
    flange: str | Path | None = None,
    table_format: str | Path | None = None,
    convention: FlangeConvention | None = None,
    laser_off: str | Path | None = None,
    quarter_turns: QuarterTurns | None = None,
    latency_ms: LatencyMs | LatencyWord | None = None,
    keep_all: bool = False,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> ReconstructionResult:
    """Make a cloud with covariance from measurements of a real sensor on a robot (docs/measurements.md).

    The other parameters are those of `Scanner` and `Scanner.scan`.

    Parameters
    ----------
    data
        Table of profile points, profiles as a sensor writes them, or folder of images with a table of poses; with
        joints or poses of the flange. Or a cloud, surface or profiles without poses, whose frame is taken as that of
        the robot's base.
    part
        Nominal part, in whose frame the cloud is; without it the cloud is in the frame of the robot's base.
    cloud_unit
        Unit of a cloud: mm, m or inch; by default what the file states, or else mm.
    calibration
        Folder of results of a calibration: its cell, its sensor, and the pose of the sensor on the flange.
    flange
        Table of the flange poses of the exposures, if they are not in that of the points; or a program or list of a
        robot controller, whose poses are those of exposures 1, 2 and so on.
    table_format
        Format of the profiles: the name of a shipped one, or a file; by default by the content.
    convention
        Of orientations whose columns do not state it.
    laser_off
        Folder of background images to subtract.
    quarter_turns
        Counter-clockwise, from the images to those of the described camera; by default those of the calibration.
    latency_ms
        Delay of the exposures after the joints, or ``estimate`` to find it from the part; by default that of the cell.
    keep_all
        With a part: keep points of the table and of its neighbours.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected; `CalibrationError` where the measurements disagree with the part or
        do not determine the delay, `EmptyScanError` where no point is left.

    Examples
    --------
    >>> try:
    ...     result = scancell.reconstruct("profiles.csv", part="part.stl")
    ... except scancell.DescriptionError as error:
    ...     print(error)
    profiles.csv: no such file
    """
    from scancell.recorded.result import ReconstructRequest, reconstruct_request  # noqa: PLC0415

    def path(item: str | Path | None) -> Path | None:
        return None if item is None else Path(item)

    request = ReconstructRequest(
        Path(data),
        part if isinstance(part, Mesh) else path(part),
        unit,
        cloud_unit,
        path(calibration),
        path(flange),
        table_format,
        convention,
        path(laser_off),
        quarter_turns,
        latency_ms,
        keep_all,
        threads,
    )
    return reconstruct_request(request, cell, sensor, assignments(settings), as_progress(progress))


@checked_arguments
def compare(
    run: str | Path,
    *,
    part: str | Path | Mesh | None = None,
    unit: str = "mm",
    out: str | Path | None = None,
    seed: Seed = 0,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> ComparisonResult:
    """Compare real measurements of a part with those of the ray-traced sensor at the same poses.

    The other parameters are those of `Scanner` and `Scanner.scan`.

    Parameters
    ----------
    run
        Run folder of `reconstruct`, or of a scan.
    part
        What was measured, a mesh or an artefact; by default the part of the run.
    out
        Folder for figures (JSON) and a picture, which may be that of the run.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> try:
    ...     print(scancell.compare("measured"))
    ... except scancell.DescriptionError as error:
    ...     print(error)
    measured: expected a run folder
    """
    from scancell.recorded.compare import compare_run  # noqa: PLC0415

    chosen = part if part is None or isinstance(part, Mesh) else Path(part)
    found = compare_run(Path(run), chosen, unit, seed, threads, as_progress(progress))
    if out is not None:
        found.save(out)
    return found


@checked_arguments
def evaluate(
    cloud: str | Path | ScanResult | Cloud | Points,
    *,
    mesh: str | Path | Mesh | None = None,
    artefact: str | Path | ShapeGroup | None = None,
    align: Align = "none",
    datum: Sequence[str | int] = (),
    out: str | Path | None = None,
    unit: str = "mm",
    cloud_unit: LengthUnit | None = None,
    threads: Threads = 0,
) -> MeshEvaluation | ArtefactEvaluation:
    """Compare a cloud with a mesh or with an artefact of exact shape.

    Parameters
    ----------
    cloud
        A scan, cloud file, run folder, `Cloud` or points (n, 3), m, in the frame of the part. Records of a file that
        hold no usable point are left out and counted.
    mesh, artefact
        What to compare with; one of them. A mesh file in `unit`; an artefact description (TOML). By default the part
        of the scan.
    align
        What is done before: nothing, the best fit (least squares), or the fit to datum planes.
    datum
        Datum faces of the artefact, or numbers of plane regions of the mesh, in order of precedence.
    out
        Folder for figures (JSON, CSV), a picture and a report (HTML).
    cloud_unit
        Unit of the cloud file: mm, m or inch; by default what the file states, or else mm.
    threads
        Threads of the distance queries; 0 uses all cores.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> result = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 40})
    >>> evaluation = scancell.evaluate(result, align="best-fit")
    >>> evaluation.statistics.rms < 2e-6
    True
    """
    from scancell.evaluation.artefact import evaluate_against_artefact  # noqa: PLC0415
    from scancell.evaluation.mesh_evaluation import evaluate_against_mesh  # noqa: PLC0415

    if mesh is artefact is None and isinstance(cloud, ScanResult):
        mesh = cloud.nominal.part
    if (mesh is None) == (artefact is None):
        raise DescriptionError("evaluate: expected either a mesh or an artefact to compare with")
    source = points_of(cloud, cloud_unit)
    points = checked_value("cloud", source.points, Points)
    if not len(points):
        raise DescriptionError("cloud: holds no points; expected at least one")
    found: MeshEvaluation | ArtefactEvaluation
    if mesh is not None:
        part = mesh.usable if isinstance(mesh, Mesh) else load_part(mesh, unit)
        found = evaluate_against_mesh(points, part, align, _region_numbers(datum), threads=threads)
    else:
        assert artefact is not None
        group = artefact if isinstance(artefact, ShapeGroup) else load_artefact(artefact)
        found = evaluate_against_artefact(points, group, align, [str(name) for name in datum])
    found = replace(found, source=source.figures, warnings=(*source.warnings, *found.warnings))
    if out is not None:
        found.save(out)
    return found


@checked_arguments
def mesh(
    run: str | Path | ScanResult | Cloud,
    out: str | Path | None = None,
    *,
    method: Reconstruction = "poisson",
    spacing_mm: Length | None = None,
) -> Mesh:
    """Reconstruct the surface of a scan with Open3D; needs the extra ``mesh``.

    Parameters
    ----------
    run
        A scan, run folder, cloud file of scancell (PLY, NPZ), or a `Cloud` with normals.
    out
        STL, PLY or OBJ file, mm, which `scan` accepts as a part.
    method
        Screened Poisson reconstruction, without the surface where points are sparse; or ball pivoting.
    spacing_mm
        Size of the smallest details; by default 1/250 of the extent.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> result = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 100})
    >>> scancell.mesh(result, "surface.stl", spacing_mm=2)
    Mesh(vertices=<float64 (..., 3)>, faces=<int64 (..., 3)>, source='surface', ...)
    """
    from scancell.reconstruction.cloud import reconstruct_surface, write_surface  # noqa: PLC0415

    surface = reconstruct_surface(cloud_of(run), method, None if spacing_mm is None else 1e-3 * spacing_mm)
    if out is not None:
        write_surface(surface, Path(out))
    return surface


def _region_numbers(words: Sequence[str | int]) -> list[int]:
    if not all(str(word).isdecimal() for word in words):
        raise DescriptionError(f"datum: {', '.join(map(str, words))}: expected numbers of plane regions of the mesh")
    return [int(word) for word in words]


@checked_arguments
def acceptance(
    sensor: Sensor = None,
    *,
    cell: Cell = None,
    scan: Scan = None,
    settings: Assignments = (),
    as_built: Assignments = (),
    engine: Engine = "geometric",
    seed: Seed = 0,
    quick: bool = False,
    repeats: Repeats | None = None,
    factors: str | Path | None = None,
    limits: Mapping[str, float] | Sequence[str] = (),
    out: str | Path | None = None,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> AcceptanceReport:
    """Acceptance test of a sensor in the simulated cell: artefacts over its measuring range, in both scan modes.

    The other parameters are those of `Scanner` and `Scanner.scan`.

    Parameters
    ----------
    scan
        Speeds, spacing and settling time; the views are those of the test.
    quick
        Fewer positions, repeats and points.
    repeats
        Scans of each artefact at each position in each mode; 20 unless given.
    factors
        Study description (TOML) whose factors are drawn anew for each repeat (JCGM 101).
    limits
        Largest permitted errors by name of the figure, in its unit: ``{"probing size": 5}`` or ``["probing size=5"]``.
        The report begins with what meets them.
    out
        Folder for ``acceptance.json``, ``.csv`` and ``.html``; the page needs the extra ``studies``.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> report = scancell.acceptance(quick=True, repeats=1)
    >>> max(row["mean"] for row in report.rows if row["name"] == "flatness") < 30  # um
    True
    """
    from scancell.studies.acceptance.measure import QUICK, Programme  # noqa: PLC0415
    from scancell.studies.acceptance.report import AcceptanceRequest, limits_of, run_acceptance  # noqa: PLC0415

    if out is not None:
        for module in ("matplotlib", "jinja2"):
            require(module, "studies")  # before the work
    file = None if factors is None else Path(factors)
    programme = QUICK if quick else Programme()
    if repeats is not None:
        programme = replace(programme, repeats=repeats)
    request = AcceptanceRequest(programme, engine, tuple(assignments(as_built)), seed, file, limits_of(limits))
    with Scanner(cell, sensor, scan, settings=settings, threads=threads) as scanner:
        report = run_acceptance(scanner, request, as_progress(progress))
    if out is not None:
        report.save(out)
    return report


@checked_arguments
def study(
    file: str | Path,
    out: str | Path,
    *,
    settings: Assignments = (),
    workers: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> StudyReport:
    """Run the trials of a study that are not finished in `out`, and write its report there.

    Parameters
    ----------
    file
        Study description (TOML).
    out
        Folder of the study; trials that it holds are kept.
    settings
        Changes of the description, ``{"design.trials": 20}``.
    workers
        Worker processes; 0 for one per core.
    progress
        Receives (stage, done, total); returning False cancels, and `out` keeps what is finished.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> study = '''
    ... name = "tool_x"
    ... part = "part.stl"
    ... set = ["scan.max_profiles=20"]
    ... engine = "geometric"
    ... design = { kind = "latin_hypercube", trials = 4 }
    ... factor = [{ path = "as_built.tool.x_mm", distribution = { kind = "normal", std = 0.05 } }]
    ... '''
    >>> with open("study.toml", "w") as file:
    ...     _ = file.write(study)
    >>> scancell.study("study.toml", "trials", workers=1).figures["trials"]
    4
    """
    from scancell.studies.report import write_report  # noqa: PLC0415
    from scancell.studies.study import open_study  # noqa: PLC0415

    opened, folder = open_study(Path(file), assignments(settings)), Path(out)
    return write_report(opened, folder, opened.complete(folder, workers, as_progress(progress)))


@checked_arguments
def batch(
    parts: Sequence[str | Path],
    out: str | Path,
    *,
    config: str | Path | None = None,
    variants: Count | None = None,
    workers: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
    **options: Unpack[BatchOptions],
) -> BatchResult:
    """Scan many parts in many variants.

    Parameters
    ----------
    parts
        Mesh files, folders of them, or artefact files.
    out
        Folder of the batch; scans that it holds are kept.
    config
        Batch description (TOML).
    variants
        Scans of each part, in place of the number in the description.
    workers, progress
        As of `study`.
    options
        Keys of the batch description in place of those of `config`.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> scancell.ScanDescription(max_profiles=40).to_toml("coarse.toml")
    >>> result = scancell.batch(["part.stl"], "clouds", scan="coarse.toml", engine="geometric", workers=1)
    >>> result.figures["scans"]
    1
    """
    from scancell.config.study import load_batch  # noqa: PLC0415
    from scancell.studies.batch import open_batch, write_index  # noqa: PLC0415

    file, folder = None if config is None else Path(config), Path(out)
    opened = open_batch(load_batch(file, options, variants), file, [Path(part) for part in parts], folder)
    return write_index(opened, folder, opened.complete(folder, workers, as_progress(progress)))
