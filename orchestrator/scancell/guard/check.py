"""First contact of a motion, and proof that a stop comes before it.

Both are certified queries along the predicted motion.  A pair of bodies that does not approach raises no warning, and
it needs no room for a stop as long as the motion never brings it nearer than it is: moving away is always allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.guard.motion import Hypothesis, Path
from scancell.guard.near import STILL, NearPairs, almost
from scancell.guard.predict import Predictor
from scancell.guard.stopping import Stop, WorstCase, braking_time, latest_stop
from scancell.guard.tool import Tool
from scancell.guard.unseen import UnseenApproach
from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_bounds import MotionBounds
from scancell.proximity.motion_check import Budget, MotionCheck
from scancell.proximity.scene import ProximityScene

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_PIECES = 4  # straight in the axes, of a predicted motion
_PARTS = 64  # of a motion in which the contact is looked for
_SOON = 1e-3  # s in which the distance changes, for its rate
_SURELY = 5e-3  # m/s: faster pairs approach whatever the noise of the rates, and are warned of
_FINEST = 2e-4  # rad: finest intervals, a fraction of a millimetre of motion
_FINE = 1e-4  # rad: those of the proof that a pair does not come nearer
_FARTHEST_ASTRAY = 0.2  # rad: links of an arm are too close to each other for stops that may deviate more
# Comparisons of faces or their bounding volumes (about 0.08 µs each) for all hypotheses of an answer.
_WORK = 70_000
_BENDING = 1.5  # of the measured curvature between its samples


@dataclass(frozen=True)
class Approach:
    """A pair of bodies at `distance` (m) that changes at `rate` (m/s); below 0 they approach."""

    body_a: str
    body_b: str
    distance: float
    rate: float


@dataclass(frozen=True)
class Contact:
    """Predicted contact of an approaching pair if the motion continues.

    Attributes
    ----------
    approach
        The pair, now.
    path
        Continuation of the motion.
    free_until, contact_by
        Times between which the first contact is, s from the measured state; before, the motion is proved free.
    travel
        Length of the tool's path until `free_until`, m.
    """

    approach: Approach
    path: Path
    free_until: float
    contact_by: float
    travel: float


@dataclass(frozen=True)
class Verdict:
    """Contacts and stops of all possible motions.

    Attributes
    ----------
    contacts
        The first of each motion that leads to one, the next first.
    without_stop
        A pair of each motion for which no stop is proved.
    astray
        Whether a motion bends or may change so much that its stop cannot be predicted.
    """

    contacts: tuple[Contact, ...]
    without_stop: tuple[Approach, ...]
    astray: bool

    @property
    def stop_is_proved(self) -> bool:
        """Whether the robot can move on for one more period and then stop in the worst case, free of contact."""
        return not self.without_stop and not self.astray


class ManualCheck:
    """Checks motions by hand.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    scene
        Pairs of these bodies.
    near
        Distances that count as contact, at least the errors of the meshes, and the pairs within them.
    worst
        Worst case for which a stop must be proved.
    horizon
        Time for which a motion is predicted, s.
    """

    def __init__(
        self,
        nominal: NominalCell,
        scene: ProximityScene,
        near: NearPairs,
        worst: WorstCase,
        horizon: float = 0.5,
    ) -> None:
        self._scene, self._near, self._clearance = scene, near, near.clearance
        self._motions = MotionCheck(nominal, scene, self._clearance, 1, _FINEST)
        self._number = {pair: i for i, pair in enumerate(scene.pairs)}
        self._predictor, self._tool = Predictor(nominal), Tool(nominal)
        self._unseen = None if worst.unseen is None else UnseenApproach(nominal, scene.pairs, worst.unseen)
        self._bounds = MotionBounds(nominal, scene.pairs)
        self._worst, self._horizon = worst, horizon
        self._known: tuple[bytes, dict[int, Approach]] = b"", {}

    def check(self, hypotheses: Sequence[Hypothesis], only_stop: bool = False, begins: bool = False) -> Verdict:
        """Contacts ahead of each hypothesis of a robot that moves, and whether its stop is proved.

        With `only_stop` contacts are not looked for, nor further pairs, as soon as a stop is not proved. Where the
        motion `begins`, from rest in the states that it was identified by, its speed exceeds no noise yet: then a pair
        moves apart that does so by the rates as they are.
        """
        if not hypotheses:
            return Verdict((), (), True)
        ends = [self._worst.reaction] * len(hypotheses) + [self._horizon] * len(hypotheses)
        times = np.linspace(0.0, ends, _PIECES + 1).T
        axes = self._predictor.axes([*hypotheses, *hypotheses], times)
        motions = []
        for i, hypothesis in enumerate(hypotheses):
            later = i + len(hypotheses)
            stop = latest_stop(hypothesis, self._worst)
            way = _stop_way(axes[i], times[i], stop, self._worst, hypothesis.path is Path.JOINT)
            now, rates = hypothesis.state.axes, hypothesis.rates
            error = np.zeros_like(rates) if begins else hypothesis.rate_error
            motions.append(_Motion(hypothesis.path, now, rates, error, stop, way, axes[later], times[later]))
        return self._verdict(motions, only_stop)

    def _verdict(self, motions: Sequence[_Motion], only_stop: bool) -> Verdict:
        without_stop, contacts, astray = [], [], False
        budget = Budget(_WORK)
        for i, motion in enumerate(motions):
            if (motion.stop.deviation + motion.way.bend).max() > _FARTHEST_ASTRAY:
                astray = True
                continue
            if blocked := self._unstoppable(motion, budget.share(len(motions) - i)):
                without_stop.append(blocked)
                if only_stop:
                    break
        if not (only_stop and (without_stop or astray)):
            for i, motion in enumerate(motions):
                if contact := self._contact(motion, budget.share(len(motions) - i)):
                    contacts.append(contact)
        contacts.sort(key=lambda contact: contact.free_until)
        return Verdict(tuple(contacts), tuple(without_stop), astray)

    def _approaches(self, motion: _Motion, pairs: Flags, budget: Budget) -> list[Approach]:
        """Distance of some `pairs` (pairs,) of the scene, and its rate as the motion begins; the nearest one first."""
        ends = np.stack([motion.now, motion.now + _SOON * motion.rates])
        key = ends.tobytes()
        if self._known[0] != key:  # hypotheses of one state have mostly the same rates
            self._known = key, {}
        known = self._known[1]
        wanted = pairs.copy()
        wanted[list(known)] = False
        distance, soon = self._motions.distances(ends, wanted, budget)
        rate = (soon - distance) / _SOON
        for i in np.flatnonzero(wanted):
            known[int(i)] = Approach(*self._scene.pairs[i], float(distance[i]), float(rate[i]))
        return sorted((known[int(i)] for i in np.flatnonzero(pairs)), key=lambda approach: approach.distance)

    def _unstoppable(self, motion: _Motion, budget: Budget) -> Approach | None:
        """A pair for which the stop is not proved.

        A pair that does not approach for any error of the rates needs no distance for a stop, but must not come much
        nearer during the stop; one within its clearance must not come nearer at all.
        """
        clearance, way = self._clearance, motion.way
        if self._unseen is not None:
            clearance = clearance + self._unseen.bound(motion.now, motion.stop.unseen)
        violated = self._motions.violations(*way.near, motion.stop.deviation + way.bend, clearance, budget)
        if not violated.any():
            self._near.release()
            return None
        if budget.left <= 0:  # one of them is enough to name
            violated &= np.cumsum(violated) == 1
            return self._approaches(motion, violated, budget)[0]
        found = self._approaches(motion, violated, budget)
        distance, rate = np.full(len(self._clearance), np.nan), np.zeros(len(self._clearance))
        for one in found:
            number = self._number[one.body_a, one.body_b]
            distance[number], rate[number] = one.distance, one.rate
        near, kept = self._near.update(motion.now, distance, exact=False)
        of_axes = self._bounds.pairs(motion.now[None], np.diag(motion.rate_error)[:, None])[:, 0]
        surely = np.sqrt((of_axes**2).sum(0))  # the errors of the axes are independent
        approaching = ~near & violated & (rate < surely - STILL / _SOON)
        if approaching.any():
            return next(one for one in found if approaching[self._number[one.body_a, one.body_b]])
        kept = np.where(violated & ~near, almost(distance, self._clearance), kept)
        nearer_later = self._motions.violations(*way.predicted, clearance=kept, budget=budget, finest=_FINE)
        return next((one for one in found if nearer_later[self._number[one.body_a, one.body_b]]), None)

    def _contact(self, motion: _Motion, budget: Budget) -> Contact | None:
        """The first contact of an approaching pair."""
        axes, times = motion.axes, motion.times
        clearance = self._clearance.copy()
        while True:
            first = self._motions.first_violations(
                axes[:-1], axes[1:], motion.finer, clearance=clearance, budget=budget
            )
            touching = np.isfinite(first)
            if not touching.any() or budget.left <= 0:
                return None
            found = next((one for one in self._approaches(motion, touching, budget) if one.rate < -_SURELY), None)
            if found is not None:
                break
            clearance[touching] = -np.inf
        begin = float(first[touching].min())
        piece, step = int(begin), times[1] - times[0]
        reached = axes[piece] + (begin - piece) * (axes[piece + 1] - axes[piece])
        travel = self._tool.length(np.vstack([axes[: piece + 1], reached])[:, :-1])
        until = float(times[0] + begin * step)
        return Contact(found, motion.path, until, float(until + step / motion.finer), travel)


@dataclass(frozen=True)
class _Motion:
    """A possible motion.

    Attributes
    ----------
    path
        Its continuation.
    now
        Axes from which it continues, (axes,), rad.
    rates, rate_error
        There, and a bound on their error, (axes,), rad/s.
    stop, way
        The latest stop, and where it leads.
    axes, times
        Predicted axes of the motion if it continues, (n, axes), rad, at equally spaced times (n,), s.
    """

    path: Path
    now: Array
    rates: Array
    rate_error: Array
    stop: Stop
    way: _Way
    axes: Array
    times: Array

    @property
    def finer(self) -> int:
        """Number of parts of a piece that are searched for a contact, a power of 2."""
        return max(1, _PARTS >> int(np.ceil(np.log2(len(self.times) - 1))))


@dataclass(frozen=True)
class _Way:
    """Straight motions of stops, each from a start to an end, (n, axes), rad.

    Attributes
    ----------
    near
        A few near which every stop stays, but for its deviation.
    bend
        How near, (axes,), rad.
    predicted
        Stops from the points of the predicted motion, and the motion from each to the next.
    """

    near: tuple[Array, Array]
    bend: Array
    predicted: tuple[Array, Array]


def _stop_way(axes: Array, times: Array, stop: Stop, worst: WorstCase, is_line: bool) -> _Way:
    """Way of all stops from the predicted motion through `axes` (n, axes) at equally spaced `times` (n,).

    Until braking begins the axes follow the path, then its tangent, as far as in half the braking time. All stops are
    near the tangents at every second point, longer by the path from the point before and to the next: where braking
    begins between those, the path bends away from the tangent by half the curvature times the squared time to the
    point, and so does its direction. What accelerates more than the axes can, as near a singular position, the
    controller does not follow: it brakes.
    """
    step = times[1] - times[0]
    most = np.asarray(worst.deceleration, float)
    rates = np.gradient(axes, step, axis=0, edge_order=2)
    rates = np.clip(rates, rates[0] - times[:, None] * most, rates[0] + times[:, None] * most)
    curvature = np.minimum(_BENDING * np.abs(np.diff(axes, n=2, axis=0)).max(0) / step**2, most)
    longer = braking_time(np.abs(rates).max(0) - np.abs(rates[0]), worst.deceleration)
    half = (stop.braking_time + longer) / 2
    bend = curvature * (step**2 / 2 + step * half)
    if is_line:  # all tangents are one
        line = axes[:1], axes[-1:] + half * rates[-1:]
        return _Way(line, bend, line)
    middle = slice(1, None, 2)
    near = axes[middle] - step * rates[middle], axes[middle] + (step + half) * rates[middle]
    reach = np.append(np.full(len(axes) - 1, step), 0.0) + half
    return _Way(near, bend, (axes, axes + reach[:, None] * rates))
