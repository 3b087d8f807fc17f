"""Writes what a scan produced: cloud, figures, pictures, recording, and the inputs that made them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.cell.nominal import Body, Lamp, NominalCell
from orchestrator.cell.recording import Recording, write_recording
from orchestrator.config.resolved import sensor_json
from orchestrator.evaluation.coverage import COVERAGE_SAMPLES, Coverage, SensorView, coverage
from orchestrator.evaluation.deviation import Deviation, deviation_from_mesh
from orchestrator.evaluation.images import draw_stripes
from orchestrator.evaluation.manifest import manifest, resolved_toml
from orchestrator.evaluation.pictures import deviation_picture
from orchestrator.evaluation.request import ScanReport, ScanRequest
from orchestrator.evaluation.run_folder import RunFolder
from orchestrator.evaluation.stopwatch import Stopwatch
from orchestrator.geometry import pose
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.cloud_files import write_cloud
from orchestrator.scanning.exposures import build_scene, exposures_from_truth, readout_time
from orchestrator.scanning.sense import Sensors, sample_rows

_SAMPLE_IMAGES = 4
Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReportInputs:
    """Everything that a report is made of."""

    request: ScanRequest
    nominal: NominalCell
    bodies: tuple[Body | Lamp, ...]
    sensors: Sensors
    recording: Recording
    cloud: Cloud
    stations: dict[str, float]
    run: dict[str, Any]
    inputs: Sequence[Path]


def write_report(given: ReportInputs, folder: RunFolder, watch: Stopwatch) -> ScanReport:
    """Fill the run folder."""
    with watch.measure("evaluate"):
        deviation = deviation_from_mesh(given.cloud, given.nominal.part, sensor_rt.closest_points)
        covered = surface_coverage(given.nominal, given.recording, given.cloud, _view(given))
    figures = _figures(given, deviation, covered)
    with watch.measure("write"):
        run = _run(given)
        for suffix in given.request.formats:
            write_cloud(folder.path(f"cloud.{suffix}"), given.cloud, (f"scancell scan of {given.request.part.name}",))
        write_recording(given.recording, folder.path("recording.parquet"))
        _write_json(folder.path("deviation.json"), {**deviation.as_json(), "coverage": covered.as_json()})
        folder.path("resolved.toml").write_text(resolved_toml(given.request.setup, run))
        inputs = [given.request.part, *given.inputs]
        _write_json(folder.path("manifest.json"), manifest(given.request.setup, inputs, {**run, **given.run}))
    with watch.measure("draw"):
        name = given.request.part.name
        deviation_picture(
            folder.path("deviation.png"),
            given.cloud,
            deviation,
            given.nominal.part,
            name=name,
            coverage_fraction=covered.fraction,
        )
        if given.request.engine == "ray-traced":
            _draw_samples(given, folder)
    warnings = [] if len(given.cloud) else ["no point of the part was found"]
    return ScanReport(figures, _lines(given, deviation, covered, folder, figures["points_without_normal"]), warnings)


def surface_coverage(
    nominal: NominalCell,
    recording: Recording,
    cloud: Cloud,
    view: SensorView,
    samples: int = COVERAGE_SAMPLES,
    threads: int = 0,
) -> Coverage:
    """Share of the visible surface that the cloud covers, seen from nominal poses at measured joints."""
    measured = recording.measured
    poses = nominal.part_from_sensor(measured.q, measured.table)
    spacing = profile_spacing(nominal, poses, measured.segment)
    table = next((body.mesh for body in nominal.bodies if body.name == "table"), None)
    obstacles = [table.transformed(pose.inverse(nominal.table_from_part))] if table is not None else []
    return coverage(
        nominal.part,
        cloud.points_in_part,
        poses,
        view,
        spacing=spacing,
        obstacles=obstacles,
        samples=samples,
        threads=threads,
    )


def profile_spacing(nominal: NominalCell, part_from_sensor: Array, segment: NDArray[np.int64]) -> float:
    """Largest distance (m) by which the laser sheet moves over the part's hull between neighbouring exposures.

    A segment with a single exposure (given poses, stop-and-look) counts with its neighbour in time.
    """
    hull = nominal.part.hull.vertices
    chosen = sample_rows(len(part_from_sensor) - 1, 200) if len(part_from_sensor) > 1 else []
    across = [
        pose.transform_points(pose.inverse(part_from_sensor[row]), hull)[:, 0]
        - pose.transform_points(pose.inverse(part_from_sensor[row + 1]), hull)[:, 0]
        for row in chosen
    ]
    steps = np.array([np.abs(shift).max() for shift in across])
    same = np.array([segment[row] == segment[row + 1] for row in chosen], bool)
    typical = steps[same] if same.any() else steps
    # The median forgets the jumps between views of stop-and-look programs.
    return float(np.median(typical)) if len(typical) else 1e-3


def _view(given: ReportInputs) -> SensorView:
    return SensorView.from_resolved(sensor_json(given.request.setup.sensor, given.request.seed))


def _run(given: ReportInputs) -> dict[str, Any]:
    request = given.request
    return {
        "part": str(request.part),
        "unit": request.unit,
        "engine": request.engine,
        "as_built": list(request.as_built),
        "seed": request.seed,
        "command_line": list(request.command_line),
    }


def _figures(given: ReportInputs, deviation: Deviation, covered: Coverage) -> dict[str, Any]:
    return {
        "profiles": len(given.recording),
        "points": len(given.cloud),
        "points_without_normal": int(np.isnan(given.cloud.normals[:, 0]).sum()),
        "deviation": deviation.figures.as_um(),
        "coverage": None if np.isnan(covered.fraction) else covered.fraction,
        "stations_s": given.stations,
    }


def _lines(given: ReportInputs, deviation: Deviation, covered: Coverage, folder: RunFolder, bare: int) -> list[str]:
    """For people; `bare` points have no normal."""
    figures = deviation.figures
    return [
        f"{given.request.part.name}: {len(given.recording)} profiles, {len(given.cloud)} points"
        + (f", {bare} of them without a normal: they stand alone or edge-on" if bare else ""),
        f"  deviation  mean {figures.mean * 1e6:+.2f} um, RMS {figures.rms * 1e6:.2f} um, "
        f"D95 {figures.d95 * 1e6:.1f} um, D99.9 {figures.d99_9 * 1e6:.1f} um, max {figures.max_abs * 1e6:.1f} um",
        f"  coverage   {covered.fraction:.1%} of the visible surface",
        f"  results    {folder.target}",
    ]


def _draw_samples(given: ReportInputs, folder: RunFolder) -> None:
    rows = sample_rows(len(given.recording), _SAMPLE_IMAGES)
    truth = given.recording.truth_for_rows(readout_time(given.sensors.as_built))
    index = given.recording.measured.index
    scene = build_scene(given.bodies)
    for row in rows:
        exposure = exposures_from_truth(truth, index, given.bodies, slice(row, row + 1))
        lit, *unlit = (
            sensor_rt.render(scene, given.sensors.as_built, exposure, given.request.threads, laser_on=on)[0]
            for on in ((True, False) if given.sensors.believed.laser_off_frame else (True,))
        )
        draw_stripes(
            lit,
            given.sensors.believed,
            folder.path(f"images/profile_{index[row]:05d}.png"),
            f"profile {index[row]}",
            *unlit,
        )


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n")
