"""The project's real line for a test: descriptions, plan, FMU, sensor, reconstruction, evaluation; nothing replaced."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import sensor_rt
from orchestrator.cell.nominal import NominalCell, nominal_cell
from orchestrator.cell.recording import Recording
from orchestrator.config.loading import Setup, assets_dir, load_setup
from orchestrator.config.resolved import sensor_json
from orchestrator.evaluation.coverage import Coverage, SensorView
from orchestrator.evaluation.deviation import DeviationFigures, deviation_from_mesh
from orchestrator.evaluation.job import cloud_of
from orchestrator.evaluation.report import surface_coverage
from orchestrator.geometry.mesh import load_mesh
from orchestrator.planning.planner import Plan
from orchestrator.progress import Silent
from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.cloud_files import write_ply
from orchestrator.reconstruction.reconstruct import ProfilePoints
from orchestrator.scanning.drive import drive
from orchestrator.scanning.exposures import visible_bodies
from orchestrator.scanning.prepare import make_plan
from orchestrator.scanning.sense import make_sensor, sense

PARTS = assets_dir() / "parts"
OFF_AXIS = "cell.part.x_mm=20"


@dataclass
class Line:
    """One part in one cell, planned once; `drive` and `sense` may be repeated with other perturbations and engines."""

    setup: Setup
    nominal: NominalCell
    sensor: sensor_rt.Sensor
    plan: Plan
    seed: int = 0
    _drives: dict[tuple[str, ...], Recording] = field(default_factory=dict)

    def drive(self, *as_built: str) -> Recording:
        """Recording of the planned program on a cell that is perturbed so; the same request is driven once."""
        if as_built not in self._drives:
            driven = drive(self.setup, self.nominal, self.plan.program, as_built, self.seed, Silent())
            self._drives[as_built] = driven.recording
        return self._drives[as_built]

    def sense(self, recording: Recording, engine: str, threads: int = 0) -> ProfilePoints:
        return sense(recording, visible_bodies(self.nominal), self.sensor, engine, threads, Silent()).points

    def cloud(self, recording: Recording, points: ProfilePoints) -> Cloud:
        return cloud_of(self.nominal, recording, points, self.setup)

    def scan(self, engine: str, *as_built: str) -> Cloud:
        recording = self.drive(*as_built)
        return self.cloud(recording, self.sense(recording, engine))

    def signed(self, cloud: Cloud) -> np.ndarray:
        """Signed distance (n,) of every point of the cloud to the mesh, m."""
        return deviation_from_mesh(cloud, self.nominal.part, sensor_rt.closest_points).signed

    def coverage(self, cloud: Cloud) -> Coverage:
        view = SensorView.from_resolved(sensor_json(self.setup.sensor, self.seed))
        return surface_coverage(self.nominal, self.drive(), cloud, view)


def make_line(part: str | Path, *overrides: str, ideal: bool = True, seed: int = 0) -> Line:
    """The line for a part of the assets (by name) or a mesh file in mm."""
    setup = load_setup(overrides=overrides, ideal=ideal)
    path = part if isinstance(part, Path) else PARTS / f"{part}.stl"
    nominal = nominal_cell(setup.cell, load_mesh(path))
    sensor = make_sensor(setup.sensor, seed)
    return Line(setup, nominal, sensor, make_plan(nominal, sensor, setup), seed)


def figures_um(signed: np.ndarray) -> dict[str, float]:
    """Mean, RMS, D99.9 and largest of signed distances (n,), in µm."""
    found = DeviationFigures.of(signed)
    return {
        "mean": 1e6 * found.mean,
        "rms": 1e6 * found.rms,
        "d99_9": 1e6 * found.d99_9,
        "max": 1e6 * found.max_abs,
    }


def ply_sha256(cloud: Cloud, folder: Path) -> str:
    """Checksum of the cloud's file."""
    path = folder / "cloud.ply"
    write_ply(path, cloud)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def rows(recording: Recording, chosen: Sequence[int] | slice) -> Recording:
    """The same recording with some of its exposures only."""
    return Recording({name: values[chosen] for name, values in recording.columns.items()})
