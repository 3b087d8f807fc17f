"""A whole scan as one job: plan, drive, sense, reconstruct, evaluate, and a folder with what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.cell.nominal import Body, Lamp, NominalCell, nominal_cell
from orchestrator.cell.recording import Recording, read_recording
from orchestrator.config.loading import Setup
from orchestrator.config.units import si_value
from orchestrator.evaluation.frame_index import Laser
from orchestrator.evaluation.images import FrameFiles
from orchestrator.evaluation.report import ReportInputs, write_report
from orchestrator.evaluation.request import ScanReport, ScanRequest
from orchestrator.evaluation.run_folder import RunFolder, run_into
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.geometry.mesh import load_mesh
from orchestrator.progress import Progress
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.reconstruct import Envelope, reconstruct
from orchestrator.scanning.drive import Before, drive
from orchestrator.scanning.exposures import visible_bodies
from orchestrator.scanning.prepare import make_plan
from orchestrator.scanning.sense import OnImages, Sensed, Sensors, make_sensors, sense

# Points this far outside the table's rim, or above the highest reach of the sensor, are none of the part's.
_ENVELOPE_HEIGHT = 0.5


def scan_to_folder(request: ScanRequest, out: Path, progress: Progress, before: Before | None = None) -> ScanReport:
    """Scan the part and leave the results in `out`, whole or not at all; `before` commands the cell first.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """

    def work(folder: RunFolder, watch: Stopwatch) -> ScanReport:
        line = _load(request, folder, watch)
        with watch.measure("plan"):
            progress.stage("planning", 1, "plan")
            plan = make_plan(line.nominal, line.sensors.believed, request.setup)
            progress.advance(1)
        with watch.measure("drive"):
            driven = drive(request.setup, line.nominal, plan.program, request.as_built, request.seed, progress, before)
        report = _finish(line, driven.recording, progress, {"fmu_token": driven.fmu_token})
        report.warnings[:0] = plan.warnings
        return report

    return run_into(out, work)


def render_to_folder(request: ScanRequest, recording_path: Path, out: Path, progress: Progress) -> ScanReport:
    """Images and cloud from a recording made by any FMI tool; results as `scan_to_folder` leaves them.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """

    def work(folder: RunFolder, watch: Stopwatch) -> ScanReport:
        with watch.measure("load"):
            recording = read_recording(recording_path)
        run = {"recording": str(recording_path)}
        return _finish(_load(request, folder, watch), recording, progress, run, [recording_path])

    return run_into(out, work)


@dataclass(frozen=True)
class _Line:
    """What a job works with from beginning to end."""

    request: ScanRequest
    nominal: NominalCell
    sensors: Sensors
    folder: RunFolder
    watch: Stopwatch


def _load(request: ScanRequest, folder: RunFolder, watch: Stopwatch) -> _Line:
    with watch.measure("load"):
        nominal = nominal_cell(request.setup.cell, load_mesh(request.part, request.unit))
        sensors = make_sensors(request.setup.sensor, request.as_built, request.seed)
    return _Line(request, nominal, sensors, folder, watch)


def _finish(
    line: _Line, recording: Recording, progress: Progress, run: dict[str, Any], inputs: Sequence[Path] = ()
) -> ScanReport:
    """Everything after the recording."""
    request, bodies = line.request, visible_bodies(line.nominal)
    with line.watch.measure("sense"):
        sensed = _sense(line, recording, bodies, progress)
    with line.watch.measure("reconstruct"):
        cloud = cloud_of(line.nominal, recording, sensed.points, request.setup)
    progress.stage("evaluating", 1, "report")
    made = ReportInputs(request, line.nominal, bodies, line.sensors, recording, cloud, sensed.timings, run, inputs)
    report = write_report(made, line.folder, line.watch)
    progress.advance(1)
    return report


def _sense(line: _Line, recording: Recording, bodies: tuple[Body | Lamp, ...], progress: Progress) -> Sensed:
    """Profiles of all exposures; images are kept where they are asked for."""
    request, sensors = line.request, line.sensors
    lit, unlit = (FrameFiles(line.folder, name, sensors.believed) for name in ("images", "laser_off"))

    def keep_in(files: FrameFiles, laser: Laser) -> OnImages | None:
        return (lambda trigger, images: files.add(f"raw_{trigger:05d}", images, laser)) if request.images else None

    sensed = sense(
        recording,
        bodies,
        sensors.believed,
        request.engine,
        request.threads,
        progress,
        keep_in(lit, "on"),
        sensors.as_built,
        on_unlit=keep_in(unlit, "off"),
    )
    lit.finish()
    unlit.finish()
    return sensed


def cloud_of(nominal: NominalCell, recording: Recording, points: Any, setup: Setup, normals: bool = True) -> Cloud:
    """Reconstruct from measured joints and nominal geometry alone; normals take most of the time."""
    return reconstruct(
        points,
        recording.measured,
        nominal.part_from_sensor,
        nominal.table_from_part,
        Envelope(lowest=si_value(setup.scan, "table_margin_mm"), highest=_ENVELOPE_HEIGHT, radius=nominal.table_radius),
        normals,
    )
