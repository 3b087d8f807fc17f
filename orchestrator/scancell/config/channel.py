"""Descriptions of a bad network between cell and guard."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from scancell.config.description import Description, Fraction

_Delay = Annotated[float, Field(ge=0.0, le=1e7)]  # ms


class ChannelDescription(Description):
    """One direction of a network; by default a perfect one.

    See the example of `faulty_link`.
    """

    delay_ms: _Delay = Field(default=0.0, description="minimum delay of a packet, ms")
    jitter_ms: _Delay = Field(
        default=0.0, description="mean of the exponentially distributed extra delay, ms; packets overtake each other"
    )
    loss: Fraction = Field(default=0.0, description="probability that a packet is lost outside bursts")
    burst: Fraction = Field(default=0.0, description="probability per packet that a burst of losses begins with it")
    burst_packets: float = Field(default=10.0, ge=1.0, le=1e6, description="mean length of a burst, in packets")
    burst_loss: Fraction = Field(default=1.0, description="probability that a packet is lost in a burst")
    duplication: Fraction = Field(
        default=0.0, description="probability that a packet is delivered twice, with independent delays"
    )
    replay: Fraction = Field(default=0.0, description="probability that a packet is delivered again after replay_ms")
    replay_ms: _Delay = Field(default=1000.0, description="time after which packets are delivered again, ms")
    dead_from_s: Annotated[float, Field(ge=0.0, le=1e9)] | None = Field(
        default=None, description="time from which on nothing is sent or delivered, s"
    )
    dead_until_s: Annotated[float, Field(ge=0.0, le=1e9)] | None = Field(
        default=None, description="time at which the link recovers, s"
    )


class LinkDescription(Description):
    """Faults of the connection between a cell and its guard; by default none.

    See the example of `faulty_link`.
    """

    to_guard: ChannelDescription = Field(default=ChannelDescription(), description="network from cell to guard")
    to_cell: ChannelDescription = Field(default=ChannelDescription(), description="network from guard to cell")
    clock_offset_ms: Annotated[float, Field(ge=-1e11, le=1e11)] = Field(
        default=0.0, description="time of the controller's clock at time 0, ms"
    )
    clock_drift_ppm: Annotated[float, Field(ge=-100_000.0, le=100_000.0)] = Field(
        default=0.0, description="relative error of the rate of the controller's clock, ppm"
    )
    stale: Fraction = Field(default=0.0, description="probability that an old state is sent instead of the new one")
    stale_polls: int = Field(default=1, ge=1, le=1000, description="age of an old state, in polls")
