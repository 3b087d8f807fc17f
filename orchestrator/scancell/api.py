"""Functions for single calls: each opens what it needs, does one piece of work, and closes it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scancell.config.cell import CellDescription
from scancell.config.keys import Assignments, assignments
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.geometry.mesh import Mesh
from scancell.planning.plan import Plan
from scancell.planning.setups import SetUps
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.results import ScanResult, ShotResult
from scancell.scanner import Scanner
from scancell.scanning.survey import SurveyResult

if TYPE_CHECKING:
    from scancell.output.run_folder import RunReport
    from scancell.studies.report import StudyReport

Cell = str | Path | CellDescription | None
Sensor = str | Path | SensorDescription | None
Scan = str | Path | ScanDescription | None


def scan(
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: int = 0,
    **options: Any,
) -> ScanResult:
    """Scan a part once; `options` are those of `Scanner.scan`, the other parameters those of `Scanner`."""
    with Scanner(cell, sensor, scan, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.scan(part, **options)


def shot(
    part: str | Path | Mesh,
    pose: Sequence[float],
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: int = 0,
    **options: Any,
) -> ShotResult:
    """Expose once from a pose; `options` are those of `Scanner.shot`."""
    with Scanner(cell, sensor, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.shot(part, pose, **options)


def render(
    recording: str | Path,
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: int = 0,
    **options: Any,
) -> ScanResult:
    """Images and a cloud from a recording; `options` are those of `Scanner.render`."""
    with Scanner(cell, sensor, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.render(recording, part, **options)


def plan(
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    unit: str = "mm",
) -> Plan:
    """The checked program of the scan of a part, see `Scanner.plan`."""
    with Scanner(cell, sensor, scan, settings=settings) as scanner:
        return scanner.plan(part, unit=unit)


def place(
    part: str | Path | Mesh,
    share: float = 0.99,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    unit: str = "mm",
) -> SetUps:
    """How a free part is best set up for scanning, see `Scanner.place`."""
    with Scanner(cell, sensor, scan, settings=settings) as scanner:
        return scanner.place(part, share, unit=unit)


def survey(
    part: str | Path | Mesh,
    *,
    cell: Cell = None,
    sensor: Sensor = None,
    scan: Scan = None,
    settings: Assignments = (),
    ideal: bool = False,
    threads: int = 0,
    **options: Any,
) -> SurveyResult:
    """Find what stands around the table; `options` are those of `Scanner.survey`, the other parameters `Scanner`'s."""
    with Scanner(cell, sensor, scan, settings=settings, ideal=ideal, threads=threads) as scanner:
        return scanner.survey(part, **options)


def extract(
    images: Sequence[str | Path],
    out: str | Path,
    *,
    sensor: Sensor = None,
    settings: Assignments = (),
    laser_off: Sequence[str | Path] = (),
    sheet_um: float | None = None,
    peaks: bool = False,
    threads: int = 0,
) -> RunReport:
    """Measure the stripe in images of a sensor, real or simulated, and write profiles into the folder `out`.

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
    """
    from scancell.config.loading import load_setup  # noqa: PLC0415
    from scancell.output.extract_images import ExtractionRequest, extract_to_folder  # noqa: PLC0415

    setup = load_setup(None, sensor, None, assignments(settings))
    files, background = ([Path(item) for item in items] for items in (images, laser_off))
    request = ExtractionRequest(files, setup.sensor, peaks, threads, background, sheet_um)
    return extract_to_folder(request, Path(out))


def study(
    file: str | Path,
    out: str | Path,
    *,
    settings: Assignments = (),
    workers: int = 0,
    progress: Progress | ProgressCallback | None = None,
) -> StudyReport:
    """Run the trials of a study that `out` does not hold yet, and write its report there.

    Parameters
    ----------
    file
        Study description (TOML).
    workers
        Worker processes; 0 for one per core.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.
    """
    from scancell.studies.report import write_report  # noqa: PLC0415
    from scancell.studies.run_record import DESCRIPTION  # noqa: PLC0415
    from scancell.studies.study import open_study  # noqa: PLC0415
    from scancell.studies.task import ExecutionTarget  # noqa: PLC0415

    opened, folder = open_study(Path(file), assignments(settings)), Path(out)
    if not (folder / DESCRIPTION).exists():
        opened.check()
        opened.begin(folder)
    opened.check_same(folder)
    made = opened.run(folder, ExecutionTarget(workers=workers), as_progress(progress))
    return write_report(opened, folder, made.failed)


def batch(
    parts: Sequence[str | Path],
    out: str | Path,
    *,
    config: str | Path | None = None,
    variants: int | None = None,
    workers: int = 0,
    progress: Progress | ProgressCallback | None = None,
    **options: Any,
) -> list[dict[str, Any]]:
    """Scan many parts in many variants and return a row per scan, as the index holds it.

    Parameters
    ----------
    parts
        Mesh files, or folders of them.
    config
        Batch description (TOML).
    options
        Keys of the batch description: engine, formats, images, truth, seed, unit, cell, sensor, scan, ideal.

    Raises
    ------
    ScancellError
        Naming what is wrong and what was expected.
    """
    from scancell.config.batch import load_batch  # noqa: PLC0415
    from scancell.studies.batch import open_batch, write_index  # noqa: PLC0415
    from scancell.studies.task import ExecutionTarget  # noqa: PLC0415

    file, folder = None if config is None else Path(config), Path(out)
    opened = open_batch(load_batch(file, options, variants), file, [Path(part) for part in parts], folder)
    opened.check()
    opened.begin(folder)
    opened.check_same(folder)
    made = opened.run(folder, ExecutionTarget(workers=workers), as_progress(progress))
    return write_index(opened, folder, made.failed).rows
