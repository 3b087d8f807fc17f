"""The two ends of the connection between cell and guard, independent of the transport.

They decide which packets are accepted.  The cell numbers its sessions, the guard its service of each of them; both
numbers are random.  A restarted guard has no session until the cell opens a new one, which requires a reset by an
operator (docs/guard_protocol.md).
"""

from __future__ import annotations

import secrets
from collections import Counter, deque
from enum import StrEnum
from typing import Protocol, TypeVar, runtime_checkable

from scancell.errors import MessageError
from scancell.guard.messages import CellState, GuardMessage, Packet, decode

SILENCE = 0.5  # s after which another cell may open a session
LEAST_PERIOD = 1e-4  # s between the times of two states
_REMEMBERED_STATES = 256
_REMEMBERED_SESSIONS = 64

_Message = TypeVar("_Message", CellState, GuardMessage)


class Outcome(StrEnum):
    """Result of the checks of a packet."""

    ACCEPTED = "accepted"
    MALFORMED = "malformed"
    WRONG_KIND = "wrong kind"
    OTHER_SESSION = "other session"
    BUSY = "busy with another cell"
    DUPLICATE = "duplicate"
    OLD = "old"
    TIME_NOT_LATER = "time not later"
    UNKNOWN_STATE = "answer to an unknown state"
    STALE = "stale"


SUPERSEDED = "superseded"  # accepted, but a newer state came before the guard was free
REJECTED = "rejected by the guard"  # accepted, but not a state of the guard's cell
FAILED = "not answered: error of the guard"  # accepted, but the guard raised an exception


@runtime_checkable
class Answerer(Protocol):
    """A guard."""

    def answer(self, state: CellState) -> GuardMessage:
        """Answer a state; a `MessageError` means that the state is not one of this guard's robot."""
        ...

    def reset(self) -> None:
        """Forget all states: a session begins."""
        ...


class Order:
    """Order of the messages of a session: sequence numbers modulo 2**32 must increase."""

    def __init__(self) -> None:
        self._last: int | None = None

    def check(self, sequence: int) -> Outcome:
        """Whether a number is ahead of the last one, by less than half of all numbers."""
        if self._last is None:
            return Outcome.ACCEPTED
        ahead = (sequence - self._last) % 2**32
        if ahead == 0:
            return Outcome.DUPLICATE
        return Outcome.ACCEPTED if ahead < 2**31 else Outcome.OLD

    def advance(self, sequence: int) -> None:
        """Record an accepted message."""
        self._last = sequence


def _decoded(packet: bytes, kind: type[_Message], counts: Counter[str]) -> tuple[Packet, _Message] | None:
    """The packet and its message of a kind; None, and counted, if it is malformed or of another kind."""
    try:
        received = decode(packet)
    except MessageError:
        counts[Outcome.MALFORMED] += 1
        return None
    message = received.message
    if not isinstance(message, kind):
        counts[Outcome.WRONG_KIND] += 1
        return None
    return received, message


class CellEndpoint:
    """The cell's end.

    Parameters
    ----------
    age_limit
        Answers to states older than that are refused, s.

    Attributes
    ----------
    counts
        Packets received, by `Outcome`.
    """

    def __init__(self, age_limit: float) -> None:
        self.counts: Counter[str] = Counter()
        self._age_limit = age_limit
        self.reset()

    def reset(self) -> None:
        """Open a new session; answers to earlier packets are rejected."""
        self._session = _random_number()
        self._guard = self._version = 0
        self._order = Order()
        self._sent: dict[int, float] = {}
        self._last: GuardMessage | None = None

    def packet(self, state: CellState) -> bytes:
        """The packet to send."""
        self._sent[state.sequence], self._version = state.time, state.version
        if len(self._sent) > _REMEMBERED_STATES:
            del self._sent[next(iter(self._sent))]
        return state.encode(self._session, self._guard)

    def receive(self, packet: bytes, now: float) -> GuardMessage | None:
        """The answer in a packet, if it is accepted; `now` by the clock that stamps the states, s."""
        found = _decoded(packet, GuardMessage, self.counts)
        if found is None:
            return None
        received, answer = found
        outcome = self._check(received, answer, now)
        self.counts[outcome] += 1
        if outcome is not Outcome.ACCEPTED:
            return None
        self._order.advance(answer.sequence)
        self._guard, self._last = received.guard, answer
        return answer

    def age(self, now: float) -> float:
        """Age of the state that the last accepted message answers, s; infinite before the first."""
        return now - self._last.state_time if self._last else float("inf")

    def _check(self, received: Packet, answer: GuardMessage, now: float) -> Outcome:
        ours = (received.version, received.session) == (self._version, self._session) and received.guard != 0
        if not ours or self._guard not in (0, received.guard):
            return Outcome.OTHER_SESSION
        if (outcome := self._order.check(answer.sequence)) is not Outcome.ACCEPTED:
            return outcome
        if self._sent.get(answer.state_sequence) != answer.state_time:
            return Outcome.UNKNOWN_STATE
        return Outcome.ACCEPTED if now - answer.state_time <= self._age_limit else Outcome.STALE


class GuardEndpoint:
    """The guard's end: serves one cell at a time.

    Parameters
    ----------
    answerer
        The guard.

    Attributes
    ----------
    counts
        Packets received, by `Outcome`; `SUPERSEDED` and `REJECTED` of those accepted.
    """

    def __init__(self, answerer: Answerer) -> None:
        self.counts: Counter[str] = Counter()
        self._answerer = answerer
        self._session = self._guard = self._version = 0
        self._ended: deque[int] = deque(maxlen=_REMEMBERED_SESSIONS)
        self._heard = -float("inf")
        self._order = Order()
        self._last_time = -float("inf")
        self._pending: CellState | None = None

    def receive(self, packet: bytes, now: float) -> bool:
        """Whether a packet is accepted: its state is answered next; `now` by the guard's clock, s."""
        found = _decoded(packet, CellState, self.counts)
        if found is None:
            return False
        received, state = found
        outcome = self._check(received, state, now)
        self.counts[outcome] += 1
        if outcome is not Outcome.ACCEPTED:
            return False
        self._order.advance(state.sequence)
        self._last_time, self._heard = state.time, now
        if self._pending is not None:
            self.counts[SUPERSEDED] += 1
        self._pending = state
        return True

    def answer(self) -> bytes | None:
        """Packet of the answer to the last state; None if it was answered, or the guard rejects it."""
        if self._pending is None:
            return None
        state, self._pending = self._pending, None
        try:
            message = self._answerer.answer(state)
        except MessageError:
            self.counts[REJECTED] += 1
            return None
        return message.encode(self._session, self._guard, state.version)

    def _check(self, received: Packet, state: CellState, now: float) -> Outcome:
        if received.session != self._session:
            if received.guard != 0 or received.session in self._ended:
                return Outcome.OTHER_SESSION
            if now - self._heard < SILENCE:
                return Outcome.BUSY
            self._open(received)
        elif received.version != self._version or received.guard not in (0, self._guard):
            return Outcome.OTHER_SESSION
        if (outcome := self._order.check(state.sequence)) is not Outcome.ACCEPTED:
            return outcome
        return Outcome.ACCEPTED if state.time >= self._last_time + LEAST_PERIOD else Outcome.TIME_NOT_LATER

    def _open(self, opening: Packet) -> None:
        self._ended.append(self._session)
        self._version, self._session, self._guard = opening.version, opening.session, _random_number()
        self._order, self._last_time, self._pending = Order(), -float("inf"), None
        self._answerer.reset()


def _random_number() -> int:
    return secrets.randbelow(2**64 - 1) + 1
