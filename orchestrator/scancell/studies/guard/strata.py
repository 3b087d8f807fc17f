"""Strata of a campaign: kind of motion, speed, length and network fault of each run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scancell.config.cell import ChannelDescription, LinkDescription
from scancell.studies.guard.scenario import JOGGED, MOVED, Kind

DECADES = ("0.1-1 %", "1-10 %", "10-100 %")  # of the full speed
LENGTHS = ("0.01-0.1 mrad", "0.1-1 mrad", "1-10 mrad", "10-100 mrad", "100-3000 mrad")
MIXED = "mixed"  # kinds, or lengths, of a run that draws those of each motion
KINDS = (*Kind, MIXED, MIXED, MIXED)
BLOCK = len(KINDS) * len(DECADES)  # runs with one cell, part and fault
VERSIONS = (2, 2, 2, 1)  # of the protocol, which alternate
_SLOWEST = 1e-3
_SHORTEST, _LONGEST = 1e-5, 3.0  # rad
_SILENT = 8  # blocks per block with a controller that does not show its jogs
_NEAR = 3, 5  # runs of so many that start near a body
_SLOW = ChannelDescription(delay_ms=4.0, jitter_ms=2.0)


def _both(name: str, **faults: float) -> tuple[str, LinkDescription]:
    channel = _SLOW.model_copy(update=faults)
    return name, LinkDescription(to_guard=channel, to_cell=channel)


FAULTS: dict[str, LinkDescription] = dict(
    [
        _both("none", delay_ms=0.0, jitter_ms=0.0),
        _both("delay"),
        _both("jitter", jitter_ms=10.0),
        _both("loss", loss=0.05),
        _both("bursts", burst=0.01, burst_packets=4.0),
        _both("reordering", jitter_ms=20.0),
        _both("duplication", duplication=0.3, replay=0.1, replay_ms=300.0),
        ("clock", LinkDescription(to_guard=_SLOW, to_cell=_SLOW, clock_offset_ms=-700.0, clock_drift_ppm=2000.0)),
        ("stale", LinkDescription(to_guard=_SLOW, to_cell=_SLOW, stale=0.2)),
        ("dead", LinkDescription(to_guard=_SLOW, to_cell=_SLOW)),
    ]
)


@dataclass(frozen=True)
class Stratum:
    """The stratum that a run samples.

    Attributes
    ----------
    number, block
        Of the run, and of the block of `BLOCK` runs with one cell that it belongs to.
    kind
        Of its motions: a `Kind`, or `MIXED`.
    decade, length
        Numbers of the decades of speed and of length; length `len(LENGTHS)`: each motion has its own.
    near
        Whether the robot starts near a body and insists on approaching it.
    fault
        Of the network: a key of `FAULTS`.
    silent
        Whether the controller does not send the paths of jogs.
    version
        Of the controller's protocol.
    """

    number: int
    block: int
    kind: str
    decade: int
    length: int
    near: bool
    fault: str
    silent: bool
    version: int

    @property
    def lengths(self) -> str:
        """Name of the decade of length."""
        return (*LENGTHS, MIXED)[self.length]

    def random_speed(self, rng: np.random.Generator) -> float:
        """Share of the full speed, log-uniform in the decade."""
        return float(_SLOWEST * 10.0 ** (self.decade + rng.random()))

    def random_length(self, rng: np.random.Generator) -> float:
        """Largest angle (rad) by which a motion turns an axis, log-uniform in the decade or over all of them."""
        share = (self.length + rng.random()) if self.length < len(LENGTHS) else len(LENGTHS) * rng.random()
        decades = np.append(np.arange(len(LENGTHS)), np.log10(_LONGEST / _SHORTEST))
        return float(_SHORTEST * 10.0 ** np.interp(share, np.arange(len(LENGTHS) + 1), decades))

    def random_kind(self, rng: np.random.Generator) -> Kind:
        """Kind of a motion; half of the mixed ones are jogs."""
        if self.kind != MIXED:
            return Kind(self.kind)
        return Kind(rng.choice(JOGGED if rng.random() < 0.5 else MOVED))


def stratum_of(number: int) -> Stratum:
    """Stratum of a run: all kinds have equal counts at each speed in a block, and all lengths in five blocks."""
    within, block = number % BLOCK, number // BLOCK
    decade, kind = divmod(within, len(KINDS))
    length = (within + block) % len(LENGTHS) if KINDS[kind] != MIXED else len(LENGTHS)
    near = (within + 2 * block + decade) % _NEAR[1] < _NEAR[0]
    turn = block + block // len(FAULTS)
    fault = list(FAULTS)[block % len(FAULTS)]
    version = VERSIONS[block // 2 % len(VERSIONS)]
    return Stratum(number, block, KINDS[kind], decade, length, near, fault, turn % _SILENT == _SILENT - 1, version)


def random_network(fault: str, duration: float, rng: np.random.Generator) -> tuple[LinkDescription, int]:
    """Faults of a run of `duration` s, and their seed."""
    description, seed = FAULTS[fault], int(rng.integers(2**32))
    if fault == "dead":
        dead = description.to_cell.model_copy(update={"dead_from_s": float(rng.uniform(0.1, 0.8) * duration)})
        description = description.model_copy(update={"to_cell": dead})
    return description, seed
