"""The scan description in SI, as planning uses it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.cell.poses import pose_matrix
from orchestrator.config.scan import ScanDescription
from orchestrator.config.units import to_si

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SweepOptions:
    """Turns of the table under a standing sensor (metres, radians, rad/s)."""

    elevations: tuple[float, ...]
    azimuth: float
    standoff: float
    height_step: float
    angle_step: float
    speed: float


@dataclass(frozen=True)
class RasterOptions:
    """Straight passes over the top (metres, m/s)."""

    standoff: float
    pitch: float
    overlap: float
    speed: float


@dataclass(frozen=True)
class ScanOptions:
    """What to plan. `poses` (n, 4, 4) is ``part_from_sensor`` of single exposures; when given, nothing else is done."""

    dynamic: bool
    max_profiles: int
    settle: float
    clearance: float
    sweep: SweepOptions | None
    raster: RasterOptions | None
    poses: Array


def scan_options(scan: ScanDescription) -> ScanOptions:
    """Convert a checked description."""
    si = to_si(scan.model_dump())
    sweep, raster = si["sweep"], si["raster"]
    poses = np.array([pose_matrix(p) for p in scan.pose]).reshape(-1, 4, 4)
    return ScanOptions(
        dynamic=scan.mode == "dynamic",
        max_profiles=scan.max_profiles,
        settle=si["settle"],
        clearance=si["clearance"],
        sweep=SweepOptions(
            tuple(sweep["elevations"]),
            sweep["azimuth"],
            sweep["standoff"],
            sweep["height_step"],
            sweep["angle_step"],
            sweep["speed"],
        )
        if scan.sweep.enabled
        else None,
        raster=RasterOptions(sweep["standoff"], raster["pitch"], raster["overlap"], raster["speed"])
        if scan.raster.enabled
        else None,
        poses=poses,
    )
