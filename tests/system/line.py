"""Scans for tests: one `Scanner` per part, planned once, driven and sensed with other perturbations and engines."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np

import scancell
from scancell import sensor as sensor_rt
from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.config.loading import Setup, assets_dir, load_setup
from scancell.evaluation.deviation import DeviationFigures, deviation_from_mesh
from scancell.nominal.cell import NominalCell
from scancell.planning.plan import Plan
from scancell.progress import NullProgress
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import write_ply
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.world import World

PARTS = assets_dir() / "parts"
OFF_AXIS = "cell.part.x_mm=20"


@dataclass
class Line:
    """One part in one cell; `drive` and `sense` may be repeated with other perturbations and engines."""

    scanner: scancell.Scanner
    world: World
    plan: Plan
    _drives: dict[tuple[str, ...], Recording] = field(default_factory=dict)

    @property
    def setup(self) -> Setup:
        return self.scanner.setup

    @property
    def nominal(self) -> NominalCell:
        return self.world.nominal

    @property
    def seed(self) -> int:
        return self.world.seed

    @property
    def sensor(self) -> sensor_rt.Sensor:
        return self.world.sensor

    def drive(self, *as_built: str) -> Recording:
        """Recording of the planned program on a perturbed cell; the same request is driven once."""
        if as_built not in self._drives:
            world = replace(self.world, as_built=as_built)
            self._drives[as_built] = self.scanner.pipeline.drive(world, self.plan, NullProgress())
        return self._drives[as_built]

    def sense(self, recording: Recording, engine: str, threads: int = 0, world: World | None = None) -> ProfilePoints:
        world = world or self.world
        self.scanner.pipeline.threads = threads
        return world.sense(recording, cast(Engine, engine), NullProgress(), threads=threads).points

    def cloud(self, recording: Recording, points: ProfilePoints, normals: bool = True) -> Cloud:
        return self.scanner.pipeline.reconstruct(self.nominal, recording, points, self.setup, normals)[0]

    def scan(self, engine: str, *as_built: str) -> Cloud:
        recording = self.drive(*as_built)
        return self.cloud(recording, self.sense(recording, engine))

    def signed(self, cloud: Cloud) -> np.ndarray:
        """Signed distance (n,) of every point of the cloud to the mesh, m."""
        return deviation_from_mesh(cloud, self.nominal.part).distance


def make_line(part: str | Path, *overrides: str, ideal: bool = True, seed: int = 0) -> Line:
    """The line for a part of the assets (by name) or a mesh file in mm."""
    scanner = scancell.Scanner(setup=load_setup(settings=overrides, ideal=ideal))
    path = part if isinstance(part, Path) else PARTS / f"{part}.stl"
    world = scanner.pipeline.load(scanner.setup, scanner.load_part(path), seed=seed)
    return Line(scanner, world, scanner.pipeline.plan(world))


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
