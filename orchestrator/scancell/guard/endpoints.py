"""The two ends of the connection between cell and guard, independent of the transport.

They decide which packets are accepted.  The cell numbers its sessions, the guard its service of each of them; both
numbers are random.  A restarted guard has no session until the cell opens a new one, which requires a reset by an
operator (docs/guard_protocol.md).
"""

from __future__ import annotations

import secrets
from collections import Counter, deque
from collections.abc import Sequence
from enum import StrEnum
from functools import cache
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.errors import MessageError
from scancell.geometry import pose
from scancell.guard.messages import CellState, GuardMessage, Packet, decode
from scancell.guard.parts import Tool
from scancell.guard.stopping import Hypothesis, Identification, Kind, MeasuredState, Path
from scancell.nominal.cell import NominalCell

SILENCE = 0.5  # s after which another cell may open a session
LEAST_PERIOD = 1e-4  # s between the times of two states
_REMEMBERED_STATES = 256
_REMEMBERED_SESSIONS = 64

_Message = TypeVar("_Message", CellState, GuardMessage)

_STATES = 3
_NOT_PLAIN = 5e-4  # chance to miss that a motion is of a plain kind
_IMPOSSIBLE = 1e-6  # chance to rule out the true path
_SIGMAS = 4.0  # of a rate's error
_JOINTS_REST = (Kind.REST, Kind.TABLE, Kind.FURTHER_AXES)


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


class Identifier:
    """Identifies motion by hand from measured states.

    Parameters
    ----------
    nominal
        Kinematics.
    noise
        Standard deviation of the measured positions, one or (axes,), rad or m.
    """

    def __init__(self, nominal: NominalCell, noise: ArrayLike) -> None:
        self._tool = Tool(nominal)
        self._joints = self._tool.joints
        self._noise = np.broadcast_to(np.asarray(noise, float), (len(nominal.axes),))
        if not (self._noise > 0).all():
            raise ValueError(f"noise = {self._noise}: expected standard deviations above 0")

    def identify(self, states: Sequence[MeasuredState]) -> Identification:
        """Motions that are consistent with the last three (or two) states.

        The true path is missing with a probability of 1e-6, near singular positions somewhat more. Rates come from a
        straight line through the states: they are those in the middle of their time.

        Raises
        ------
        ValueError
            If there are fewer than two states, or their times do not increase.
        """
        states = states[-_STATES:]
        times = np.array([state.time for state in states])
        if len(states) < 2 or not (np.diff(times) > 0).all():
            raise ValueError(f"measured states at {times.tolist()} s: expected at least two, in the order of time")
        window = _Window(self._tool, times, np.array([state.axes for state in states]), self._noise)
        kind, rates = self._plainest(window)
        paths = [Path.JOINT] if kind in _JOINTS_REST else self._paths(kind, window)
        error = np.abs(window.rates - rates) + _SIGMAS * window.rate_noise
        age = float(times[-1] - window.rate_time)
        return Identification(kind, tuple(Hypothesis(path, states[-1], rates, error, age) for path in paths))

    def _plainest(self, window: _Window) -> tuple[Kind, Array]:
        """The simplest kind of motion, and the rates (axes,) of this kind that are nearest to the measured."""
        rates = window.rates.copy()
        freedom, joints = len(window.times) - 1, slice(self._joints)
        still, of_others = np.split(window.stillness, [self._joints])
        others_rest = of_others <= _limit(freedom, _NOT_PLAIN)
        rates[self._joints :][others_rest] = 0.0
        if still.sum() <= _limit(freedom * self._joints, _NOT_PLAIN):
            rates[joints] = 0.0
            table_rests, *further_rest = others_rest.tolist()
            kind = Kind.REST if table_rests else Kind.TABLE
            return (kind if all(further_rest) else Kind.FURTHER_AXES), rates
        most = int(np.argmax(still))
        if still.sum() - still[most] <= _limit(freedom * (self._joints - 1), _NOT_PLAIN):
            rates[joints] = np.where(np.arange(self._joints) == most, rates[joints], 0.0)
            return Kind.SINGLE_JOINT, rates
        if window.moves_straight and window.held_stillness <= _limit(window.held_freedom, _NOT_PLAIN):
            for kind, kept in ((Kind.TRANSLATION, slice(3, 6)), (Kind.ROTATION, slice(0, 3))):
                if window.constancy(kept) <= _limit(3 * freedom, _NOT_PLAIN):
                    rates[joints] = window.rates_without(kept)
                    return kind, rates
        return Kind.COMBINED, rates

    def _paths(self, kind: Kind, window: _Window) -> list[Path]:
        """Paths that are possible; all, if none agrees with the states."""
        candidates = [Path.JOINT]
        if window.moves_straight:
            # Pure translations and rotations are the same in both frames.
            candidates += [Path.BASE] if kind in (Kind.TRANSLATION, Kind.ROTATION) else [Path.BASE, Path.TOOL]
        if len(window.times) < _STATES:
            return candidates
        possible = []
        for path in candidates:
            moved = self._joints if path is Path.JOINT else 6
            held = path is Path.JOINT or window.held_stillness <= _limit(window.held_freedom, _IMPOSSIBLE)
            if held and window.straightness(path) <= _limit(moved - 1, _IMPOSSIBLE):
                possible.append(path)
        return possible or candidates


@cache
def _limit(freedom: int, chance: float) -> float:
    """Value that a chi-squared variable exceeds with a probability of `chance`."""
    from scipy.special import chdtri  # noqa: PLC0415  (slow to import)

    return float(chdtri(freedom, chance)) if freedom else np.inf


class _Window:
    """Measured axes (k, axes) at `times` (k,), and tests of their constancy and straightness."""

    def __init__(self, tool: Tool, times: Array, axes: Array, noise: Array) -> None:
        self._tool, self.times = tool, times
        self._axes, self._noise = axes[:, : tool.joints], noise[: tool.joints]  # of the joints
        since = times - times.mean()
        spread = (since**2).sum()
        self.rates = since @ axes / spread
        self.rate_noise = noise / np.sqrt(spread)
        # The slope is a weighted mean of the rate in the window: this is the mean of the time with the same weights.
        self.rate_time = float(since @ times**2 / (2 * spread))
        # Cartesian motion does not move what carries the arm: its noise is none of the tool.
        placed = axes.copy()
        placed[:, tool.joints + 1 :] = axes[:, tool.joints + 1 :].mean(0)
        self._poses, self._jacobians = tool.poses(placed)
        self._jacobian = self._jacobians[len(times) // 2]
        self.moves_straight = tool.moves_straight(self._jacobian)
        self.held_freedom = len(tool.held) * (len(times) - 1)
        # Squared deviations of each axis from its mean, in units of its variance, and of those that Cartesian motion
        # holds, summed.
        self.stillness = (((axes - axes.mean(0)) / noise) ** 2).sum(0)
        self.held_stillness = float(self.stillness[tool.held].sum())

    def constancy(self, rows: slice) -> float:
        """Squared deviations of the tool's position (rows 0 to 3) or orientation (3 to 6) from their mean.

        In units of their variances, which follow from those of the joints.
        """
        if rows.start == 0:
            values = self._poses[:, :3, 3]
        else:
            middle = self._poses[len(self.times) // 2, :3, :3]
            values = pose.log_rotation(self._poses[:, :3, :3] @ middle.T)
        spread = self._jacobians[:, rows] * self._noise
        covariance = (spread @ np.swapaxes(spread, -1, -2)).mean(0)
        deviation = values - values.mean(0)
        return float(np.sum(deviation * np.linalg.solve(covariance, deviation.T).T))

    def rates_without(self, rows: slice) -> Array:
        """Rates (joints,), rad/s, of the measured motion of the tool without some of its velocities."""
        twist = self._jacobian @ self.rates[: self._tool.joints]
        twist[rows] = 0.0
        return np.asarray(self._tool.rates(self._jacobian[None], twist[None])[0])

    def straightness(self, path: Path) -> float:
        """Squared distance of the second step from the direction of both together, in units of its variance.

        Eq. 9 for joints, Eq. 10 for the tool in a frame, with a length of each step of its own.
        """
        if path is Path.JOINT:
            first, second = np.diff(self._axes, axis=0) / self._noise
        else:
            first, second = np.linalg.solve(self._deviation_of_change(), self._steps(path).T).T
        both, change = first + second, second - first
        length = float(both @ both)
        if length == 0.0:
            return float(change @ change) / 6
        across = change - both * (both @ change) / length
        unequal = float(change @ both) / length
        return float(across @ across) / (6 + 2 * unequal**2)

    def _deviation_of_change(self) -> Array:
        """Cholesky factor (6, 6) of the covariance of the change between the steps, over 6 as that of joints is."""
        spread = self._jacobians * self._noise
        covariance = spread @ np.swapaxes(spread, -1, -2)
        return np.asarray(np.linalg.cholesky((covariance[0] + 4 * covariance[1] + covariance[2]) / 6))

    def _steps(self, path: Path) -> Array:
        """Translation and rotation (2, 6) of the tool from state to state, those of a path parallel; world axes."""
        rotation, position = self._poses[:, :3, :3], self._poses[:, :3, 3]
        moved = np.diff(position, axis=0)
        before = np.swapaxes(rotation[:-1], -1, -2)
        turned = pose.log_rotation(before @ rotation[1:])  # tool frame
        if path is Path.BASE:
            return np.concatenate([moved, np.einsum("nij,nj->ni", rotation[:-1], turned)], 1)
        half_way = rotation[:-1] @ pose.exp_rotation(turned / 2)
        in_tool = np.concatenate([np.einsum("nji,nj->ni", half_way, moved), turned], 1)
        return np.asarray(in_tool.reshape(2, 2, 3) @ rotation[1].T).reshape(2, 6)
