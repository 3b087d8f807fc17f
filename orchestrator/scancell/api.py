"""Functions for single calls: each opens the objects that it needs, does one task, and closes them.

Parameters of the same name mean the same everywhere: `Scanner` and `Scanner.scan` state them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypedDict, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import (
    Count,
    Length,
    Points,
    Pose,
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
from scancell.config.cell import CellDescription, EstimatedDescription
from scancell.config.choices import (
    Align,
    CalibrationTarget,
    Engine,
    FlangeConvention,
    LengthUnit,
    Reconstruction,
    SensorTarget,
)
from scancell.config.files import Assignments, assignments
from scancell.config.inspection import InspectionDescription
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.config.study import CloudFormat
from scancell.errors import DescriptionError, MeshError, require
from scancell.geometry.cad import CadMesh
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeGroup
from scancell.nominal.parts import cad_part, load_artefact, load_part
from scancell.output.run_folder import SavedResult
from scancell.planning.layout import Layouts, Plans, Ranges, Samples
from scancell.planning.plan import Plan
from scancell.planning.setups import SetUps
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files.read import CloudFile
from scancell.reconstruction.reconstruct import cloud_of, points_of
from scancell.results import ScanResult, ShotResult
from scancell.scanner import Scanner
from scancell.scanning.pipeline import PreScanHook
from scancell.scanning.sense import OnImages
from scancell.scanning.survey import SurveyResult

if TYPE_CHECKING:
    from scancell.evaluation.artefact import ArtefactEvaluation
    from scancell.evaluation.mesh_evaluation import MeshEvaluation
    from scancell.inspection.inspection import Inspection
    from scancell.studies.acceptance.report import AcceptanceReport
    from scancell.studies.batch import BatchResult
    from scancell.studies.capability import Capability
    from scancell.studies.report import StudyReport

P = ParamSpec("P")
R = TypeVar("R")


class SensorOptions(TypedDict, total=False):
    """Options of a `Scanner` whose cell does not matter."""

    sensor: str | Path | SensorDescription | None
    settings: Assignments
    ideal: bool
    threads: Threads


class CellOptions(SensorOptions, total=False):
    """Options of a `Scanner` that follows no scan description."""

    cell: str | Path | CellDescription | None


class ScannerOptions(CellOptions, total=False):
    """Options of a `Scanner`."""

    scan: str | Path | ScanDescription | None


class PlanOptions(ScannerOptions, total=False):
    """Options of `plan`, `place` and `layout`."""

    unit: str
    progress: Progress | ProgressCallback | None


class ShotOptions(CellOptions, total=False):
    """Options of `shot`."""

    unit: str
    as_built: Assignments
    seed: Seed
    engine: Engine


class RenderOptions(ShotOptions, total=False):
    """Options of `render`."""

    estimated: EstimatedDescription | None
    estimated_sensor: SensorDescription | None
    on_images: OnImages | None
    progress: Progress | ProgressCallback | None


class ScanOptions(RenderOptions, total=False):
    """Options of `scan`."""

    scan: str | Path | ScanDescription | None
    plan: Plan | str | Path | None
    normals: bool
    samples: bool
    hook: PreScanHook | None


class SurveyOptions(PlanOptions, total=False):
    """Options of `survey`."""

    radius: Length | None
    height: Length
    voxel: Length
    pitch: Length
    inflation: float
    as_built: Assignments
    seed: Seed


class CalibrateOptions(PlanOptions, total=False):
    """Options of `calibrate`."""

    engine: Engine
    as_built: Assignments
    seed: Seed
    from_points: str | Path | None
    flange: str | Path | None
    convention: FlangeConvention | None
    table_format: str | Path | None


class CalibrateSensorOptions(SensorOptions, total=False):
    """Options of `calibrate_sensor`."""

    as_built: Assignments
    seed: Seed
    progress: Progress | ProgressCallback | None


class BatchOptions(TypedDict, total=False):
    """Keys of a batch description (docs/batch.md)."""

    cell: str | Path
    sensor: str | Path
    scan: str | Path
    ideal: bool
    unit: str
    engine: Engine
    seed: Seed
    formats: tuple[CloudFormat, ...] | list[CloudFormat]
    images: bool
    truth: bool


def _single_call(method: Callable[..., object], options: type) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator: check the arguments; the signature shows the options, those of `Scanner` and its `method`."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        called, own_signature = checked_arguments(function), signature(function)
        known = {**signature(Scanner).parameters, **signature(method).parameters}
        own = list(own_signature.parameters.values())[:-1]
        shown = [known[name].replace(kind=Parameter.KEYWORD_ONLY) for name in options.__annotations__]
        called.__signature__ = own_signature.replace(parameters=[*own, *shown])  # type: ignore[attr-defined]
        return called

    return decorate


def _once(method: Callable[..., R], *given: object, **options: Any) -> R:
    """The result of a method of a new scanner; the options of both are given together."""
    own = {name: options.pop(name) for name in ScannerOptions.__optional_keys__ & options.keys()}
    with Scanner(**own) as scanner:
        return method(scanner, *given, **options)


@_single_call(Scanner.scan, ScanOptions)
def scan(part: str | Path | Mesh, **options: Unpack[ScanOptions]) -> ScanResult:
    """Scan a part once; parameters as of `Scanner` and `Scanner.scan`.

    Examples
    --------
    >>> scancell.scan("part.stl", engine="geometric", as_built={"tool.x_mm": 0.1}, seed=3)
    ScanResult('part.stl', engine='geometric', seed=3: ... profiles, ... points)
    """
    return _once(Scanner.scan, part, **options)


@_single_call(Scanner.shot, ShotOptions)
def shot(part: str | Path | Mesh, part_from_sensor: Pose, **options: Unpack[ShotOptions]) -> ShotResult:
    """Expose once from a pose of the sensor in the part frame; parameters as of `Scanner` and `Scanner.shot`.

    Examples
    --------
    >>> above = scancell.location(0, 0, 0.1, rx=180 * scancell.deg)  # looks down, 100 mm above the origin of the part
    >>> shot = scancell.shot("part.stl", above)
    >>> shot.images.images.shape
    (2, 1024, 1280)
    """
    return _once(Scanner.shot, part, part_from_sensor, **options)


@_single_call(Scanner.render, RenderOptions)
def render(recording: str | Path, part: str | Path | Mesh, **options: Unpack[RenderOptions]) -> ScanResult:
    """Images and a cloud from a recording; parameters as of `Scanner` and `Scanner.render`.

    Examples
    --------
    >>> coarse = {"scan.max_profiles": 20}
    >>> files = scancell.scan("part.stl", settings=coarse, engine="geometric").save("run")
    >>> scancell.render("run/recording.parquet", "part.stl", engine="geometric")
    ScanResult('part.stl', engine='geometric', seed=0: ... profiles, ... points)
    """
    return _once(Scanner.render, recording, part, **options)


@_single_call(Scanner.plan, PlanOptions)
def plan(part: str | Path | Mesh, **options: Unpack[PlanOptions]) -> Plan:
    """Plan and check the scan of a part; parameters as of `Scanner` and `Scanner.plan`.

    Examples
    --------
    >>> plan = scancell.plan("part.stl", settings={"scan.mode": "stop-and-look", "scan.max_profiles": 40})
    >>> plan.axes.shape == (len(plan.segment), 7)
    True
    """
    return _once(Scanner.plan, part, **options)


@_single_call(Scanner.place, PlanOptions)
def place(part: str | Path | Mesh, share: Share = 0.99, **options: Unpack[PlanOptions]) -> SetUps:
    """Propose set-ups of a free part for scanning; parameters as of `Scanner` and `Scanner.place`.

    Examples
    --------
    >>> set_ups = scancell.place(scancell.box_mesh((0.06, 0.04, 0.02)), 0.8)
    >>> print(set_ups)
    6 stable resting poses; 100.0 % of the surface is measurable in one of them
      one set-up scans ... % of that
    """
    return _once(Scanner.place, part, share, **options)


@_single_call(Scanner.layout, PlanOptions)
def layout(
    parts: str | Path | Mesh | Sequence[str | Path | Mesh],
    vary: Ranges = (),
    samples: Samples = 128,
    plans: Plans = 4,
    seed: Seed = 0,
    **options: Unpack[PlanOptions],
) -> Layouts:
    """Propose where table, base of the arm and sensor should stand; parameters as of `Scanner` and `Scanner.layout`.

    Examples
    --------
    >>> fast = {"scan.raster.enabled": False, "scan.coverage.share": 0.5}
    >>> part = scancell.box_mesh((0.05, 0.03, 0.02))
    >>> layouts = scancell.layout(part, {"table.pose.x_mm": (400, 500)}, samples=8, plans=1, settings=fast)
    >>> 400 <= layouts.chosen[0].values["table.pose.x_mm"] <= 500
    True
    """
    return _once(Scanner.layout, parts, vary, samples=samples, plans=plans, seed=seed, **options)


@_single_call(Scanner.calibrate, CalibrateOptions)
def calibrate(
    request: CalibrationRequest | CalibrationTarget = "all",
    artefact: str | Path | Mesh | None = None,
    **options: Unpack[CalibrateOptions],
) -> CalibrationReport:
    """Find the deviations of a cell; parameters as of `Scanner` and `Scanner.calibrate`.

    Examples
    --------
    >>> report = scancell.calibrate("tool", as_built={"tool.x_mm": 1.0})
    >>> round(report.estimated.tool.x_mm, 1)
    1.0
    """
    return _once(Scanner.calibrate, request, artefact, **options)


@_single_call(Scanner.calibrate_sensor, CalibrateSensorOptions)
def calibrate_sensor(
    request: SensorCalibrationRequest | SensorTarget = "ball", **options: Unpack[CalibrateSensorOptions]
) -> SensorCalibrationReport:
    """Find the deviations of a sensor; parameters as of `Scanner` and `Scanner.calibrate_sensor`.

    Examples
    --------
    >>> report = scancell.calibrate_sensor("ball", as_built={"sensor.camera[1].tilt_deg": 29.4})
    >>> round(report.sensor.camera[0].tilt_deg, 1)
    29.4
    """
    return _once(Scanner.calibrate_sensor, request, **options)


@_single_call(Scanner.survey, SurveyOptions)
def survey(part: str | Path | Mesh, **options: Unpack[SurveyOptions]) -> SurveyResult:
    """Find occupied and unseen space around the table; parameters as of `Scanner` and `Scanner.survey`.

    Examples
    --------
    >>> survey = scancell.survey("part.stl", radius=0.05, height=0.1)
    >>> survey.exposures > 0
    True
    """
    return _once(Scanner.survey, part, **options)


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
def inspect(
    cloud: str | Path | ScanResult | Cloud | Points,
    part: str | Path | CadMesh,
    characteristics: str | Path | InspectionDescription | None = None,
    *,
    align: Align = "best-fit",
    capability: str | Path | SavedResult | None = None,
    calibration: str | Path | None = None,
    out: str | Path | None = None,
    cloud_unit: LengthUnit | None = None,
    threads: Threads = 0,
) -> Inspection:
    """Decide for each toleranced characteristic of a CAD part whether it conforms (ISO 14253-1).

    Parameters
    ----------
    cloud
        As of `evaluate`. The noise of its points is that of their changes from point to point and, in clouds of
        scancell, from profile to profile.
    part
        CAD file, or such a part as `load_part` reads it.
    characteristics
        What is inspected: a description (TOML, docs/inspection.md); by default the annotations of the CAD file.
    align
        How points find their faces: by the best fit; or none, for points in the frame of the part.
    capability
        Result of `scancell.capability`, or its ``capability.json``: what the errors of the cell do to each
        characteristic. Without it, uncertainties are those by noise.
    calibration
        Results of `scancell calibrate` with a covariance: what their uncertainty does to each characteristic. The cloud
        is then a run folder with the measured joints.
    out
        Folder for ``inspection.json``, ``.csv``, ``.qif`` and ``.html``.
    cloud_unit, threads
        As of `evaluate`.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> part = scancell.load_part("block.step")  # doctest: +SKIP
    >>> inspection = scancell.inspect("out/scan", part, "block.toml")  # doctest: +SKIP
    >>> inspection.decisions[0].verdict  # doctest: +SKIP
    'conforms'
    """
    from scancell.inspection.inspection import inspect_part, loaded_description  # noqa: PLC0415
    from scancell.studies.capability import read_effects  # noqa: PLC0415

    nominal = cad_part(part)
    description, file, left = loaded_description(characteristics, nominal)
    calibrated = None
    if calibration is None:
        source, profile = _with_profiles(cloud, cloud_unit)
    else:
        from scancell.recorded.calibrated_run import calibrated_run  # noqa: PLC0415

        if not isinstance(cloud, str | Path):
            raise DescriptionError(key="cloud", value=cloud, expected="with a calibration: a run folder")
        run = calibrated_run(Path(cloud), Path(calibration), nominal, threads)
        source, profile, calibrated = run.source, run.cloud.profile, run.displacements
    points = checked_value("cloud", source.points, Points)
    if not len(points):
        raise DescriptionError("cloud: holds no points; expected at least one")
    effects = None if capability is None else read_effects(capability)
    found = inspect_part(
        nominal,
        points,
        description,
        profile=profile,
        align=align,
        effects=effects,
        calibrated=calibrated,
        source=file,
        threads=threads,
    )
    found = replace(found, source=source.figures, warnings=(*source.warnings, *left, *found.warnings))
    if out is not None:
        found.save(out)
    return found


def _with_profiles(
    cloud: str | Path | ScanResult | Cloud | Points, unit: LengthUnit | None
) -> tuple[CloudFile, NDArray[Any] | None]:
    """Points, and the number of the profile of each, which clouds of other programs do not state."""
    if not isinstance(cloud, np.ndarray) and (unit is None or (isinstance(cloud, str | Path) and unit == "mm")):
        with suppress(MeshError):
            own = cloud_of(cloud)
            return CloudFile(own.points_in_part, "cloud of scancell", len(own.points_in_part)), own.profile
    return points_of(cloud, unit), None


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
    sensor: str | Path | SensorDescription | None = None,
    *,
    cell: str | Path | CellDescription | None = None,
    scan: str | Path | ScanDescription | None = None,
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
def capability(
    part: str | Path | CadMesh,
    characteristics: str | Path | InspectionDescription | None = None,
    *,
    cell: str | Path | CellDescription | None = None,
    sensor: str | Path | SensorDescription | None = None,
    scan: str | Path | ScanDescription | None = None,
    settings: Assignments = (),
    factors: str | Path | None = None,
    draws: Repeats = 20,
    clampings: Repeats = 1,
    repeats: Repeats = 1,
    engine: Engine = "geometric",
    as_built: Assignments = (),
    seed: Seed = 0,
    out: str | Path | None = None,
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> Capability:
    """Find which characteristics of a part a cell can decide, by simulated measurements (virtual instrument).

    The other parameters are those of `Scanner`, `Scanner.scan` and `inspect`.

    Parameters
    ----------
    factors
        Study description (TOML) whose factors are drawn for each measurement: what is uncertain about the cell after
        its calibration. Without it, noise alone counts.
    draws
        Number of draws, each a cell that was calibrated anew.
    clampings, repeats
        Of each draw: number of clampings, for which factors of the part's place are drawn anew; and of measurements of
        each clamping. Two or more make the table of gauge repeatability and reproducibility.
    out
        Folder for ``capability.json``, which `inspect` takes, and ``capability.csv``.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.

    Examples
    --------
    >>> capability = scancell.capability("block.step", "block.toml", draws=10)  # doctest: +SKIP
    >>> capability.rows[0].answer  # doctest: +SKIP
    'can be decided'
    """
    from scancell.inspection.inspection import loaded_description  # noqa: PLC0415
    from scancell.studies.capability import run_capability  # noqa: PLC0415

    nominal = cad_part(part)
    description, file, _ = loaded_description(characteristics, nominal)
    with Scanner(cell, sensor, scan, settings=settings, threads=threads) as scanner:
        found = run_capability(
            scanner,
            nominal,
            description,
            factors=None if factors is None else Path(factors),
            draws=draws,
            clampings=clampings,
            repeats=repeats,
            seed=seed,
            engine=engine,
            as_built=assignments(as_built),
            progress=as_progress(progress),
            source=file,
        )
    if out is not None:
        found.save(out)
    return found


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
