"""Strata of a campaign: operation, speed, network fault and unguarded outcome of each run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scancell.cell.controller import Operation
from scancell.config.channel import ChannelDescription, LinkDescription

THIRDS = ("collision", "near miss", "ordinary")
DECADES = ("0.1-1 %", "1-10 %", "10-100 %")  # of the full speed
BLOCK = len(THIRDS) * len(Operation) * len(DECADES)  # runs with one cell, part and fault
_SLOWEST = 1e-3
_SILENT = 8  # blocks per block with a controller that does not show its jogs
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
        Of the run, and of the block of `BLOCK` runs that it belongs to.
    third
        Outcome of the unguarded twin: one of `THIRDS`.
    operation
        Manual or automatic.
    decade
        Number of the decade of speed.
    fault
        Of the network: a key of `FAULTS`.
    silent
        Whether the controller does not show a jog to the guard before it moves.
    """

    number: int
    block: int
    third: str
    operation: Operation
    decade: int
    fault: str
    silent: bool

    def random_speed(self, rng: np.random.Generator) -> float:
        """Share of the full speed, log-uniform in the decade."""
        return float(_SLOWEST * 10.0 ** (self.decade + rng.random()))


def stratum_of(number: int) -> Stratum:
    """Stratum of a run: all combinations have equal counts after 180 runs, silent controllers after 1440."""
    within, block = number % BLOCK, number // BLOCK
    third, operation, decade = within % 3, within // 3 % 2, within // 6
    fault = list(FAULTS)[block % len(FAULTS)]
    silent = (block + block // len(FAULTS)) % _SILENT == _SILENT - 1
    return Stratum(number, block, THIRDS[third], Operation(operation), decade, fault, silent)


def random_network(fault: str, duration: float, rng: np.random.Generator) -> tuple[LinkDescription, int]:
    """Faults of a run of `duration` s, and their seed."""
    description, seed = FAULTS[fault], int(rng.integers(2**32))
    if fault == "dead":
        dead = description.to_cell.model_copy(update={"dead_from_s": float(rng.uniform(0.1, 0.8) * duration)})
        description = description.model_copy(update={"to_cell": dead})
    return description, seed
