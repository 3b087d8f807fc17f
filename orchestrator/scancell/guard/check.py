"""Which contact a motion leads to, and whether a stop is proved to come before it.

Both are certified queries along the predicted motion.  A pair of bodies that does not approach raises no warning, and
it needs no room for a stop as long as the motion never brings it nearer than it is: moving away is always allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.guard.motion import Hypothesis, Path
from scancell.guard.predict import Predictor
from scancell.guard.stopping import Stop, WorstCase, braking_time, latest_stop
from scancell.guard.tool import Tool
from scancell.guard.unseen import UnseenApproach
from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_check import MotionCheck, MotionClash
from scancell.proximity.scene import ProximityScene

Array = NDArray[np.float64]
Clashes = Sequence[MotionClash | None]

_PIECES = 4  # straight in the axes, of a predicted motion
_FINER = 16  # parts of a piece in which the contact is looked for
_SOON = 1e-3  # s in which the distance changes, for its rate
_STILL = 1e-6  # m/s: slower pairs do not approach
_NEARER = 0.2e-3  # m by which a pair may come nearer that is said not to
_FINEST = 2e-4  # rad: finest intervals, a fraction of a millimetre of motion
_FARTHEST_ASTRAY = 0.2  # rad: links of an arm are too close to each other for stops that may deviate more
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
    """Contact of an approaching pair that a motion leads to, if it goes on.

    Attributes
    ----------
    approach
        The pair, now.
    path
        How the motion goes on.
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
    """What lies ahead of all possible motions.

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
    clearance
        Distance that counts as contact, one for all pairs or (pairs,), m: at least the error of the meshes.
    worst
        What a stop must be proved for.
    horizon
        Time for which a motion is predicted, s.
    threads
        Threads of the distance queries; 0 uses all cores.
    """

    def __init__(
        self,
        nominal: NominalCell,
        scene: ProximityScene,
        clearance: ArrayLike,
        worst: WorstCase,
        horizon: float = 0.5,
        threads: int = 1,
    ) -> None:
        self._nominal, self._scene, self._threads = nominal, scene, threads
        self._clearance = np.broadcast_to(np.asarray(clearance, float), (len(scene.pairs),))
        self._motions = MotionCheck(nominal, scene, self._clearance, threads, _FINEST)
        self._fine_motions = MotionCheck(nominal, scene, self._clearance, threads)
        self._number = {pair: i for i, pair in enumerate(scene.pairs)}
        self._predictor, self._tool = Predictor(nominal), Tool(nominal)
        self._unseen = None if worst.unseen is None else UnseenApproach(nominal, scene.pairs, worst.unseen)
        self._worst, self._horizon = worst, horizon

    def check(self, hypotheses: Sequence[Hypothesis]) -> Verdict:
        """Contacts ahead of each hypothesis, and whether its stop is proved; an arm at rest needs none."""
        moving = [hypothesis for hypothesis in hypotheses if hypothesis.rates.any()]
        if not moving:
            return Verdict((), (), False)
        stops = [latest_stop(hypothesis, self._worst) for hypothesis in moving]
        ends = [self._worst.reaction] * len(moving) + [self._horizon] * len(moving)
        times = np.linspace(0.0, ends, _PIECES + 1).T
        axes = self._predictor.axes([*moving, *moving], times)
        without_stop, contacts, astray = [], [], False
        for row, (hypothesis, stop) in enumerate(zip(moving, stops, strict=True)):
            way, deviation = _stop_way(axes[row], times[row], stop, self._worst)
            clearance = self._clearance.copy()
            if self._unseen is not None:
                clearance += self._unseen.bound(axes[row, 0], stop.unseen)
            if deviation.max() > _FARTHEST_ASTRAY:
                astray = True
            elif blocked := self._unstoppable(hypothesis, way, deviation, clearance):
                without_stop.append(blocked)
            ahead = row + len(moving)
            if contact := self._contact(hypothesis, axes[ahead], times[ahead]):
                contacts.append(contact)
        contacts.sort(key=lambda contact: contact.free_until)
        return Verdict(tuple(contacts), tuple(without_stop), astray)

    def approach(self, hypothesis: Hypothesis, pair: tuple[str, str]) -> Approach:
        """Distance of a pair of the scene, and its rate as the motion begins."""
        now = hypothesis.state.axes
        axes = np.stack([now, now + _SOON * hypothesis.rates])
        bound = np.zeros(len(self._clearance))
        number = self._number[pair]
        bound[number] = np.inf
        poses = self._nominal.body_poses(axes[:, :-1], axes[:, -1])
        distance, soon = self._scene.distances(poses, bound, self._threads)[:, number]
        return Approach(*pair, float(distance), float((soon - distance) / _SOON))

    def _unstoppable(self, hypothesis: Hypothesis, axes: Array, deviation: Array, required: Array) -> Approach | None:
        """A pair for which the stop along `axes` (n, joints + 1) with the `required` clearances is not proved."""
        clearance = required.copy()
        clashes: Clashes = self._motions.first_clashes(axes[:-1], axes[1:], deviation, clearance)
        while clash := _first(clashes):
            found = self.approach(hypothesis, (clash.body_a, clash.body_b))
            if found.rate < -_STILL or not self._never_nearer(found, axes):
                return found
            clearance[self._number[found.body_a, found.body_b]] = -np.inf
            clashes = self._motions.first_clashes(axes[:-1], axes[1:], deviation, clearance)
        return None

    def _never_nearer(self, found: Approach, axes: Array) -> bool:
        clearance = np.full(len(self._clearance), -np.inf)
        clearance[self._number[found.body_a, found.body_b]] = found.distance - min(_NEARER, found.distance / 2)
        return _first(self._fine_motions.first_clashes(axes[:-1], axes[1:], clearance=clearance)) is None

    def _contact(self, hypothesis: Hypothesis, axes: Array, times: Array) -> Contact | None:
        """The first contact of an approaching pair along `axes` (n, joints + 1) at `times` (n,)."""
        clearance = self._clearance.copy()
        clashes: Clashes = self._motions.first_clashes(axes[:-1], axes[1:], clearance=clearance)
        while clash := _first(clashes):
            piece = clashes.index(clash)
            share = np.linspace(0.0, 1.0, _FINER + 1)
            finer = axes[piece] + share[:, None] * (axes[piece + 1] - axes[piece])
            parts = self._motions.first_clashes(finer[:-1], finer[1:], clearance=clearance)
            first = _first(parts)
            if first is None:  # proved after all: the finest intervals of the piece were not fine enough
                clashes = [None if one is clash else one for one in clashes]
                continue
            found = self.approach(hypothesis, (first.body_a, first.body_b))
            if found.rate < -_STILL:
                part, step = parts.index(first), (times[piece + 1] - times[piece]) / _FINER
                until = float(times[piece] + part * step)
                travel = self._tool.length(np.vstack([axes[: piece + 1], finer[part]])[:, :-1])
                return Contact(found, hypothesis.path, until, float(until + step), travel)
            clearance[self._number[found.body_a, found.body_b]] = -np.inf
            clashes = self._motions.first_clashes(axes[:-1], axes[1:], clearance=clearance)
        return None


def _first(clashes: Clashes) -> MotionClash | None:
    return next((clash for clash in clashes if clash is not None), None)


def _stop_way(axes: Array, times: Array, stop: Stop, worst: WorstCase) -> tuple[Array, Array]:
    """Points (m, joints + 1), rad, of a way near which every stop stays, and a bound (joints + 1,), rad, on how near.

    Until braking begins the axes follow the path through `axes` (n, joints + 1) at equally spaced `times` (n,), then
    its tangent, as far as in half the braking time. The way goes along the tangents at all points of the path, each
    longer by the path to the next point: where braking begins between two points, the path bends away from the tangent
    by half the curvature times the squared time to the point before, and so does its direction. What accelerates more
    than the axes can, as near a singular position, the controller does not follow: it brakes.
    """
    step = times[1] - times[0]
    most = np.asarray(worst.deceleration, float)
    rates = np.gradient(axes, step, axis=0, edge_order=2)
    rates = np.clip(rates, rates[0] - times[:, None] * most, rates[0] + times[:, None] * most)
    curvature = np.minimum(_BENDING * np.abs(np.diff(axes, n=2, axis=0)).max(0) / step**2, most)
    longer = braking_time(np.abs(rates).max(0) - np.abs(rates[0]), worst.deceleration)
    half = (stop.braking_time + longer) / 2
    reach = np.append(np.full(len(axes) - 1, step), 0.0) + half
    way = np.stack([axes, axes + reach[:, None] * rates], 1).reshape(-1, axes.shape[1])
    return way, np.asarray(stop.deviation + curvature * (step**2 / 2 + step * half))
