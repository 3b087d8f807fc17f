"""A whole scan as one job: plan, drive, sense, reconstruct, evaluate, and a folder with what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.cell.nominal import NominalCell, nominal_cell
from orchestrator.cell.recording import Recording, read_recording
from orchestrator.config.loading import Setup
from orchestrator.config.units import to_si
from orchestrator.evaluation.images import write_raw_images
from orchestrator.evaluation.report import ReportInputs, write_report
from orchestrator.evaluation.request import ScanReport, ScanRequest
from orchestrator.evaluation.run_folder import RunFolder
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.geometry.mesh import load_mesh
from orchestrator.progress import Progress
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.reconstruct import Envelope, reconstruct
from orchestrator.scanning.drive import Before, drive
from orchestrator.scanning.exposures import visible_bodies
from orchestrator.scanning.prepare import make_plan
from orchestrator.scanning.sense import OnImages, Sensors, make_sensors, sense

# Points this far outside the table's rim, or above the highest reach of the sensor, are none of the part's.
_ENVELOPE_HEIGHT = 0.5


def scan_to_folder(request: ScanRequest, out: Path, progress: Progress, before: Before | None = None) -> ScanReport:
    """Scan the part and leave the results in `out`, whole or not at all; `before` commands the cell first.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """
    watch = Stopwatch()
    with RunFolder(out) as folder:
        with watch.measure("load"):
            nominal = _load(request)
            sensors = make_sensors(request.setup.sensor, request.as_built, request.seed)
        with watch.measure("plan"):
            progress.stage("planning", 1, "plan")
            plan = make_plan(nominal, sensors.believed, request.setup)
            progress.advance(1)
        with watch.measure("drive"):
            driven = drive(request.setup, nominal, plan.program, request.as_built, request.seed, progress, before)
        report = _finish(
            request, nominal, sensors, driven.recording, folder, watch, progress, {"fmu_token": driven.fmu_token}
        )
        report.warnings[:0] = plan.warnings
    report.files = [str(out / name) for name in folder.names]
    return report


def render_to_folder(request: ScanRequest, recording_path: Path, out: Path, progress: Progress) -> ScanReport:
    """Images and cloud from a recording made by any FMI tool; results as `scan_to_folder` leaves them.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """
    watch = Stopwatch()
    with RunFolder(out) as folder:
        with watch.measure("load"):
            recording = read_recording(recording_path)
            nominal = _load(request)
            sensors = make_sensors(request.setup.sensor, request.as_built, request.seed)
        run = {"recording": str(recording_path)}
        report = _finish(request, nominal, sensors, recording, folder, watch, progress, run, [recording_path])
    report.files = [str(out / name) for name in folder.names]
    return report


def _load(request: ScanRequest) -> NominalCell:
    return nominal_cell(request.setup.cell, load_mesh(request.part, request.unit))


def _finish(
    request: ScanRequest,
    nominal: NominalCell,
    sensors: Sensors,
    recording: Recording,
    folder: RunFolder,
    watch: Stopwatch,
    progress: Progress,
    run: dict[str, Any],
    inputs: Sequence[Path] = (),
) -> ScanReport:
    """Everything after the recording."""
    bodies = visible_bodies(nominal)

    def keep_in(subfolder: str) -> OnImages | None:
        def keep(trigger: int, images: NDArray[np.uint16]) -> None:
            write_raw_images(images, sensors.believed, folder, f"{subfolder}/raw_{trigger:05d}")

        return keep if request.images else None

    with watch.measure("sense"):
        sensed = sense(
            recording,
            bodies,
            sensors.believed,
            request.engine,
            request.threads,
            progress,
            keep_in("images"),
            sensors.as_built,
            on_unlit=keep_in("laser_off"),
        )
    with watch.measure("reconstruct"):
        cloud = cloud_of(nominal, recording, sensed.points, request.setup)
    progress.stage("evaluating", 1, "report")
    figures, warnings, lines = write_report(
        ReportInputs(request, nominal, bodies, sensors, recording, cloud, sensed.timings, run, inputs), folder, watch
    )
    progress.advance(1)
    return ScanReport(figures, [], warnings, dict(watch.seconds), lines)


def cloud_of(nominal: NominalCell, recording: Recording, points: Any, setup: Setup, normals: bool = True) -> Cloud:
    """Reconstruct from measured joints and nominal geometry alone; normals take most of the time."""
    margin = to_si({"m_mm": setup.scan.table_margin_mm})["m"]
    return reconstruct(
        points,
        recording.measured,
        nominal.part_from_sensor,
        nominal.table_from_part,
        Envelope(lowest=margin, highest=_ENVELOPE_HEIGHT, radius=nominal.table_radius),
        normals,
    )
