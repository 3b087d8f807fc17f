"""The cell's connection to its guard."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import replace
from typing import Annotated

import numpy as np

from scancell.arguments import Within, checked_arguments
from scancell.config.channel import LinkDescription
from scancell.guard.channel import Channel
from scancell.guard.endpoints import CellEndpoint
from scancell.guard.messages import CellState, GuardMessage
from scancell.guard.transport import FaultyTransport, Transport


class CellFaults:
    """Faults of a controller: a wrong clock, and queries that answer with old states.

    An old state has the number of the new one and the time at which it was measured.
    """

    def __init__(self, description: LinkDescription, seed: int | np.random.SeedSequence) -> None:
        self._description = description
        self._rng = np.random.default_rng(seed)
        self._measured: deque[CellState] = deque(maxlen=description.stale_polls + 1)

    def clock(self, time: float) -> float:
        """Reading of the controller's clock at `time`, s."""
        return 1e-3 * self._description.clock_offset_ms + time * (1 + 1e-6 * self._description.clock_drift_ppm)

    def queried(self, state: CellState) -> CellState:
        """The state to send in place of one with true times."""
        self._measured.append(state)
        is_stale = self._rng.random() < self._description.stale
        sent = self._measured[0] if is_stale else state
        path_time = self.clock(sent.path_time) if sent.spacing else 0.0
        return replace(sent, sequence=state.sequence, time=self.clock(sent.time), path_time=path_time)


class Link:
    """Sends states of the cell to its guard and receives the answers, without waiting.

    Times are those of the controller's clock in s, simulated or not; they do not decrease.

    Parameters
    ----------
    transport
        Carries the packets: `InProcess`, `UdpTransport` or `TcpTransport`.
    age_limit
        Answers to states older than that are refused, s.
    faults
        Of the controller; then the times are true ones. None: no faults.

    Examples
    --------
    >>> guard = scancell.guard_of()
    >>> link = scancell.Link(scancell.InProcess(guard, compute_time=0.003), guard.settings.max_age)
    >>> with scancell.Scanner() as scanner, scanner.session() as session:
    ...     guarded = scancell.GuardedCell(session.cell, 16_000, link, guard.settings.max_age)
    ...     guarded.attach()
    ...     session.wait(0.8)
    ...     print(f"{link.counts['accepted']} answers, the last one to a state {link.age(session.time):.3f} s old")
    25 answers, the last one to a state 0.032 s old
    """

    @checked_arguments
    def __init__(self, transport: Transport, age_limit: float, faults: CellFaults | None = None) -> None:
        self._transport, self._faults = transport, faults
        self._endpoint = CellEndpoint(age_limit)

    @property
    def counts(self) -> Counter[str]:
        """Numbers of packets received, by result: ``accepted``, ``stale``, ``duplicate`` …"""
        return self._endpoint.counts

    def send(self, state: CellState, time: float) -> None:
        """Send a `state` of the cell (`GuardedCell.state`) at `time`, s."""
        sent = self._faults.queried(state) if self._faults else state
        self._transport.send(self._endpoint.packet(sent), time)

    def poll(self, time: float) -> list[GuardMessage]:
        """New answers at `time`, s, in the order of their numbers; the last one applies.

        Each has ``monitor_speed`` (0 to 1), ``emergency_stop``, ``text`` and ``beep`` for the pendant, and the time
        ``state_time``, s, of the state that it answers.
        """
        received = [
            self._endpoint.receive(arrival.packet, self._clock(time)) for arrival in self._transport.receive(time)
        ]
        return [answer for answer in received if answer is not None]

    def age(self, time: float) -> float:
        """Age at `time`, s, of the state that the last accepted answer is about; infinite before the first."""
        return self._endpoint.age(self._clock(time))

    def reset(self) -> None:
        """Open a new session, also with a restarted guard; only after a reset by an operator.

        Raises
        ------
        LinkError
            If the transport needs a connection and there is no server.
        """
        self._transport.reset()
        self._endpoint.reset()

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()

    def _clock(self, time: float) -> float:
        return self._faults.clock(time) if self._faults else time


@checked_arguments
def faulty_link(
    transport: Transport,
    description: LinkDescription,
    age_limit: float,
    seed: Annotated[int, Within(0)],
    kind: type[Link] = Link,
) -> Link:
    """Make a link with faults, which are the same for the same seed.

    Parameters
    ----------
    transport, age_limit
        As of `Link`.
    description
        The faults.
    seed
        Of the random numbers.
    kind
        Class of the link.

    Examples
    --------
    >>> faults = scancell.LinkDescription(to_cell=scancell.ChannelDescription(delay_ms=2, loss=0.5))
    >>> guard = scancell.guard_of()
    >>> link = scancell.faulty_link(scancell.InProcess(guard), faults, guard.settings.max_age, seed=1)
    >>> with scancell.Scanner() as scanner, scanner.session() as session:
    ...     scancell.GuardedCell(session.cell, 16_000, link, guard.settings.max_age).attach()
    ...     session.wait(0.8)
    ...     link.counts["accepted"] < 25
    True
    """
    to_guard, to_cell, of_cell = np.random.SeedSequence(seed).spawn(3)
    channels = Channel(description.to_guard, to_guard), Channel(description.to_cell, to_cell)
    return kind(FaultyTransport(transport, *channels), age_limit, CellFaults(description, of_cell))
