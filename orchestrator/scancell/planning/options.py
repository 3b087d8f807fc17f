"""Scan options for planning, in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from scancell.config.description import si_value, to_si
from scancell.config.scan import PairClearanceDescription, PairQualityDescription, PathDescription, ScanDescription
from scancell.config.sensor import SensorDescription, profile_time
from scancell.errors import DescriptionError
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import pose_matrix

Array = NDArray[np.float64]
_Pair = TypeVar("_Pair", PairClearanceDescription, PairQualityDescription)

_DEFAULT_AZIMUTH = float(np.radians(105.0))  # when the scan has no sweeps


@dataclass(frozen=True)
class Spacing:
    """Distance between exposures: of the table in sweeps (rad), of the sensor in passes (m).

    It is the largest that is wanted, or, where it follows from the sensor's profile rate, the smallest possible.
    """

    angle: float
    pitch: float
    is_least_angle: bool = False
    is_least_pitch: bool = False


@dataclass(frozen=True)
class SweepOptions:
    """Full turns of the table under a stationary sensor (m, rad, rad/s)."""

    elevations: tuple[float, ...]
    azimuth: float
    standoff: float
    height_step: float
    angle_step: float
    speed: float
    is_least_step: bool = False


@dataclass(frozen=True)
class RasterOptions:
    """Straight passes over the top of the part (m, m/s)."""

    standoff: float
    pitch: float
    overlap: float
    speed: float
    is_least_pitch: bool = False


@dataclass(frozen=True)
class CoverageOptions:
    """Choice of views by coverage: requested share of the measurable surface, and the budget (s)."""

    share: float
    max_views: int
    max_time: float


@dataclass(frozen=True)
class BeltOptions:
    """Scan of a part on a moving belt: pose (4, 4) of the sensor, travel between exposures (m), speed (m/s, signed)."""

    belt_from_sensor: Array
    pitch: float
    speed: float


@dataclass(frozen=True)
class ScanOptions:
    """Options of a scan: m, rad, s.

    `poses` (n, 4, 4) is ``part_from_sensor`` of single exposures; when not empty, sweeps and passes are ignored.
    `paths` are scanned after sweeps and passes. With `belt` nothing else is scanned.
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
    belt: BeltOptions | None = None

    @property
    def spacing(self) -> Spacing:
        """Requested spacing of exposures."""
        sweep, raster = self.sweep, self.raster
        return Spacing(
            sweep.angle_step if sweep else np.inf,
            raster.pitch if raster else np.inf,
            sweep is not None and sweep.is_least_step,
            raster is not None and raster.is_least_pitch,
        )

    @property
    def azimuth(self) -> float:
        """Preferred azimuth of the sensor, rad."""
        return self.sweep.azimuth if self.sweep else _DEFAULT_AZIMUTH


def pair_clearances(scan: ScanDescription, nominal: NominalCell) -> dict[frozenset[str], float]:
    """Clearances (m) of the described pairs of bodies.

    Raises `DescriptionError` if a pair names a body that the cell does not have, or one twice.
    """
    own = by_pair(scan.pair_clearance, "scan.pair_clearance", nominal)
    return {bodies: si_value(pair, "clearance_mm") for bodies, pair in own.items()}


def by_pair(pairs: Sequence[_Pair], key: str, nominal: NominalCell) -> dict[frozenset[str], _Pair]:
    """Described pairs of bodies by their names; `key` is that of the description.

    Raises `DescriptionError` if a pair names a body that the cell does not have, or one twice.
    """
    names = [body.name for body in nominal.bodies]
    for number, pair in enumerate(pairs, start=1):
        if not set(pair.bodies) <= set(names) or len(set(pair.bodies)) < 2:
            raise DescriptionError(
                key=f"{key}[{number}].bodies", value=list(pair.bodies), expected=f"two of {', '.join(names)}"
            )
    return {frozenset(pair.bodies): pair for pair in pairs}


def scan_options(scan: ScanDescription, sensor: SensorDescription) -> ScanOptions:
    """Options of a validated description, converted to SI units; `sensor` sets spacings by its `profile_time`."""
    period = profile_time(sensor)
    si = to_si(scan.model_dump())
    sweep, raster = si["sweep"], si["raster"]
    is_least_step, is_least_pitch = sweep["angle_step"] == "sensor", raster["pitch"] == "sensor"
    standoff = 1e-3 * sensor.range.standoff_mm(scan.sweep.standoff_mm)
    paths = [
        path.model_copy(
            update={
                "pitch_mm": path.speed_mm_s * period if path.pitch_mm == "sensor" else path.pitch_mm,
                "standoff_mm": sensor.range.standoff_mm(path.standoff_mm),
            }
        )
        for path in scan.path
    ]
    poses = np.array([pose_matrix(p) for p in scan.pose]).reshape(-1, 4, 4)
    return ScanOptions(
        dynamic=scan.mode == "dynamic",
        max_profiles=scan.max_profiles,
        settle=si["settle"],
        clearance=si["clearance"],
        sweep=SweepOptions(
            tuple(sweep["elevations"]),
            sweep["azimuth"],
            standoff,
            sweep["height_step"],
            sweep["speed"] * period if is_least_step else sweep["angle_step"],
            sweep["speed"],
            is_least_step,
        )
        if scan.sweep.enabled
        else None,
        raster=RasterOptions(
            standoff,
            raster["speed"] * period if is_least_pitch else raster["pitch"],
            raster["overlap"],
            raster["speed"],
            is_least_pitch,
        )
        if scan.raster.enabled
        else None,
        poses=poses,
        verify=scan.verify,
        paths=tuple(paths),
        max_lost_share=scan.max_lost_share,
        coverage=CoverageOptions(scan.coverage.share, scan.coverage.max_views, scan.coverage.max_time_s)
        if scan.coverage.enabled
        else None,
        belt=None
        if scan.belt is None
        else BeltOptions(
            pose_matrix(scan.belt.pose), si_value(scan.belt, "pitch_mm"), si_value(scan.belt, "speed_mm_s")
        ),
    )
