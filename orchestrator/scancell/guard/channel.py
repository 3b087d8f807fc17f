"""Seeded model of a bad network, in simulated time."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from scancell.config.channel import ChannelDescription


@dataclass(frozen=True, order=True)
class Arrival:
    """A packet at the time of its arrival, s; `number` orders those of the same time."""

    time: float
    number: int
    packet: bytes


class Channel:
    """One direction of a network.

    Losses follow the model of Gilbert (1960) and Elliott (1963): a chain of two states, inside and outside bursts,
    steps with every packet.  Every packet draws the same number of random numbers, so that two descriptions can be
    compared with the same luck.

    Parameters
    ----------
    description
        Faults.
    seed
        Random seed.

    Attributes
    ----------
    counts
        Packets sent, and how many of them were lost, delivered twice, and replayed.
    """

    def __init__(self, description: ChannelDescription, seed: int | np.random.SeedSequence) -> None:
        self._description = description
        self._rng = np.random.default_rng(seed)
        self._in_burst = False
        self._arrivals: list[Arrival] = []
        self._number = 0
        self.counts: Counter[str] = Counter()

    def send(self, packet: bytes, time: float) -> None:
        """Send a packet at `time`, s; times do not decrease."""
        change, loss, delay, duplication, delay_of_copy, replay = self._rng.random(6)
        described = self._description
        self._in_burst = change >= 1 / described.burst_packets if self._in_burst else change < described.burst
        self.counts["sent"] += 1
        if self._is_dead(time) or loss < (described.burst_loss if self._in_burst else described.loss):
            self.counts["lost"] += 1
            return
        arrival = time + self._delay(delay)
        self._deliver(packet, arrival)
        if duplication < described.duplication:
            self.counts["duplicated"] += 1
            self._deliver(packet, time + self._delay(delay_of_copy))
        if replay < described.replay:
            self.counts["replayed"] += 1
            self._deliver(packet, arrival + 1e-3 * described.replay_ms)

    def receive(self, time: float) -> list[Arrival]:
        """What has arrived until `time`, s, and was not received before, in the order of arrival."""
        arrived = []
        while self._arrivals and self._arrivals[0].time <= time:
            arrived.append(heapq.heappop(self._arrivals))
        return arrived

    def _delay(self, draw: float) -> float:
        return 1e-3 * (self._description.delay_ms - self._description.jitter_ms * math.log1p(-draw))

    def _deliver(self, packet: bytes, time: float) -> None:
        if self._is_dead(time):
            self.counts["lost"] += 1
            return
        heapq.heappush(self._arrivals, Arrival(time, self._number, packet))
        self._number += 1

    def _is_dead(self, time: float) -> bool:
        start, end = self._description.dead_from_s, self._description.dead_until_s
        return start is not None and time >= start and (end is None or time < end)
