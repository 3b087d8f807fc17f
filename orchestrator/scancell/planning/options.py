"""Options of a scan for planning: its description with the values that follow from the sensor, and pairs of bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from scancell.config.description import si_value
from scancell.config.loading import with_standoffs
from scancell.config.scan import PairClearanceDescription, PairQualityDescription, ScanDescription, SweepDescription
from scancell.config.sensor import SensorDescription, profile_time
from scancell.errors import DescriptionError
from scancell.nominal.cell import NominalCell

_Pair = TypeVar("_Pair", PairClearanceDescription, PairQualityDescription)


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
class ScanOptions:
    """Description of a scan in which numbers replace all words "sensor", and the requested spacing of exposures."""

    scan: ScanDescription
    spacing: Spacing

    @property
    def clearance(self) -> float:
        """Minimum distance between bodies, m."""
        return si_value(self.scan, "clearance_mm")

    @property
    def standoff(self) -> float:
        """Distance along sensor Z to the nearest surface of the part in sweeps and passes, m."""
        return si_value(self.scan.sweep, "standoff_mm")

    @property
    def azimuth(self) -> float:
        """Preferred azimuth of the sensor, rad; that of the default sweeps where the scan has none."""
        sweep = self.scan.sweep if self.scan.sweep.enabled else SweepDescription()
        return si_value(sweep, "azimuth_deg")


def scan_options(scan: ScanDescription, sensor: SensorDescription, period: float | None = None) -> ScanOptions:
    """Options of a validated description; `sensor` sets stand-offs by its range.

    The shortest time from a profile to the next one, `period` (s), sets spacings: by default the sensor's
    `profile_time`.
    """
    period = profile_time(sensor) if period is None else period
    scan = with_standoffs(scan, sensor)
    sweep, raster = scan.sweep, scan.raster
    is_least_angle, is_least_pitch = sweep.angle_step_deg == "sensor", raster.pitch_mm == "sensor"
    spacing = Spacing(
        si_value(sweep, "speed_deg_s") * period if is_least_angle else si_value(sweep, "angle_step_deg"),
        si_value(raster, "speed_mm_s") * period if is_least_pitch else si_value(raster, "pitch_mm"),
        is_least_angle,
        is_least_pitch,
    )
    paths = [
        path.model_copy(update={"pitch_mm": path.speed_mm_s * period}) if path.pitch_mm == "sensor" else path
        for path in scan.path
    ]
    return ScanOptions(scan.model_copy(update={"path": tuple(paths)}), spacing)


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
