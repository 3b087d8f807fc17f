"""Scan options for planning, in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.config.path import PathDescription
from scancell.config.scan import ScanDescription
from scancell.config.units import si_value, to_si
from scancell.errors import DescriptionError
from scancell.nominal.cell import NominalCell
from scancell.nominal.poses import pose_matrix

Array = NDArray[np.float64]

_DEFAULT_AZIMUTH = float(np.radians(105.0))  # when the scan has no sweeps


@dataclass(frozen=True)
class Spacing:
    """Distance between exposures: of the table in sweeps (rad), of the sensor in passes (m)."""

    angle: float
    pitch: float


@dataclass(frozen=True)
class SweepOptions:
    """Full turns of the table under a stationary sensor (m, rad, rad/s)."""

    elevations: tuple[float, ...]
    azimuth: float
    standoff: float
    height_step: float
    angle_step: float
    speed: float


@dataclass(frozen=True)
class RasterOptions:
    """Straight passes over the top of the part (m, m/s)."""

    standoff: float
    pitch: float
    overlap: float
    speed: float


@dataclass(frozen=True)
class CoverageOptions:
    """Choice of views by coverage: requested share of the measurable surface, and the budget (s)."""

    share: float
    max_views: int
    max_time: float


@dataclass(frozen=True)
class ScanOptions:
    """Options of a scan: m, rad, s.

    `poses` (n, 4, 4) is ``part_from_sensor`` of single exposures; when not empty, sweeps and passes are ignored.
    `paths` are scanned after sweeps and passes.
    """

    dynamic: bool
    max_profiles: int
    settle: float
    clearance: float
    sweep: SweepOptions | None
    raster: RasterOptions | None
    poses: Array
    verify: bool = True
    paths: tuple[PathDescription, ...] = ()
    coverage: CoverageOptions | None = None
    max_lost_share: float = 0.2

    @property
    def spacing(self) -> Spacing:
        """Requested spacing of exposures."""
        return Spacing(self.sweep.angle_step if self.sweep else np.inf, self.raster.pitch if self.raster else np.inf)

    @property
    def azimuth(self) -> float:
        """Preferred azimuth of the sensor, rad."""
        return self.sweep.azimuth if self.sweep else _DEFAULT_AZIMUTH


def pair_clearances(scan: ScanDescription, nominal: NominalCell) -> dict[frozenset[str], float]:
    """Clearances (m) of the described pairs of bodies.

    Raises `DescriptionError` if a pair names a body that the cell does not have, or one twice.
    """
    names = [body.name for body in nominal.bodies]
    for number, pair in enumerate(scan.pair_clearance, start=1):
        if not set(pair.bodies) <= set(names) or len(set(pair.bodies)) < 2:
            raise DescriptionError(
                key=f"scan.pair_clearance[{number}].bodies",
                value=list(pair.bodies),
                expected=f"two of {', '.join(names)}",
            )
    return {frozenset(pair.bodies): si_value(pair, "clearance_mm") for pair in scan.pair_clearance}


def scan_options(scan: ScanDescription) -> ScanOptions:
    """Options of a validated description, converted to SI units."""
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
        verify=scan.verify,
        paths=scan.path,
        max_lost_share=scan.max_lost_share,
        coverage=CoverageOptions(scan.coverage.share, scan.coverage.max_views, scan.coverage.max_time_s)
        if scan.coverage.enabled
        else None,
    )
