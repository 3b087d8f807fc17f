"""First contact of a motion, and proof that a stop comes before it.

Both are certified queries along the predicted motion.  A pair of bodies that does not approach raises no warning, and
it needs no room for a stop as long as the motion never brings it nearer than it is: moving away is always allowed.
Positions, rates and accelerations of an axis are in rad, rad/s and rad/s², those of a prismatic one in m, m/s and m/s².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from scancell.arrays import Array, Flags
from scancell.guard.parts import STILL, FreePath, JogLimits, NearPairs, Section, ShownPath, Tool, UnseenApproach, almost
from scancell.guard.stopping import Hypothesis, Path, Predictor, Stop, WorstCase, braking_time, latest_stop
from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_check import Budget, MotionBounds, MotionCheck, MotionClash
from scancell.proximity.scene import ProximityScene

_PIECES = 4  # straight in the axes, of a predicted motion
_PARTS = 64  # of a motion in which the contact is looked for
_RATE_STEP = 1e-3  # s: step of the difference that gives the rate of a distance
_SURELY = 5e-3  # m/s: faster pairs approach whatever the noise of the rates, and are warned of
_FINEST = 2e-4  # rad, and m of prismatic axes: finest intervals, a fraction of a millimetre of motion
_FINE = 1e-4  # rad and m: those of the proof that a pair does not come nearer
_FARTHEST_ASTRAY = 0.2  # rad and m: links of an arm are too close to each other for stops that may deviate more
# Comparisons of faces or their bounding volumes (about 0.08 µs each) for all hypotheses of an answer.
_WORK = 70_000
_BENDING = 1.5  # of the measured curvature between its samples

# Comparisons of faces or their bounding volumes (about 0.08 µs each): the path is not proved beyond.
_JOG_WORK = 70_000
_JOG_PIECES = 2, 64  # pieces in which slow jogs stop, and the parts of each that are distinguished
_COARSE = 4  # parts of the other pieces
_LEAST = 0.002  # smallest permitted share of the full speed above 0
_SLOW = 0.25  # share up to which stops leave the path so little that they are checked on their own
_LARGER = 1.5  # of the largest error of the angles, for which the permitted share leaves room
# Reaction times for which the permitted share s leaves room: near a body s falls by the factor e in this time, so that
# the share that was permitted a reaction time before is safe as well, also where answers arrive 0.1 s late.
_JOG_SHARE = 2.5
_RAMP = 1.1  # of the time that the controller takes to slow down, for which the permitted share leaves room

_FINER = 4  # parts of a piece of the path that are distinguished
_PATH_WORK = 150_000  # comparisons of faces or their bounding volumes: the path is not proved beyond
_PATH_BRAKING = 1.5  # braking time on a path, of that on a straight line
_TARGETS = np.linspace(0.0, 1.0, 51)
_RATE_CHANGE = 2.0  # 1/s: change of the rate for which the monitor speed leaves room
_REST = 0.02  # s of path clock that are left when the robot waits

# Of the controller: the rate follows the monitor speed no faster, 1/s, but for the start of a path, where it is that of
# the monitor speed at once.
RATE_SLOPE = 4.0


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
        ends = np.stack([motion.now, motion.now + _RATE_STEP * motion.rates])
        key = ends.tobytes()
        if self._known[0] != key:  # hypotheses of one state have mostly the same rates
            self._known = key, {}
        known = self._known[1]
        wanted = pairs.copy()
        wanted[list(known)] = False
        distance, soon = self._motions.distances(ends, wanted, budget)
        rate = (soon - distance) / _RATE_STEP
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
        approaching = ~near & violated & (rate < surely - STILL / _RATE_STEP)
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
        travel = self._tool.length(np.vstack([axes[: piece + 1], reached]))
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
        Axes from which it continues, (axes,).
    rates, rate_error
        There, and a bound on their error, (axes,).
    stop, way
        The latest stop, and where it leads.
    axes, times
        Predicted axes of the motion if it continues, (n, axes), at equally spaced times (n,), s.
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
    """Straight motions of stops, each from a start to an end, (n, axes).

    Attributes
    ----------
    near
        A few near which every stop stays, but for its deviation.
    bend
        How near, (axes,).
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


@dataclass(frozen=True)
class JogVerdict:
    """Result of the check of a jog.

    Attributes
    ----------
    clash
        What limits the speed; None: nothing on the path that is shown.
    distance
        Present distance of its bodies, m; infinite if there is no clash.
    permitted
        Largest share of the full speed from which the robot slows down in time, 0 to 1.
    stop_is_proved
        Whether the robot can react and then stop in the worst case, free of contact.
    """

    clash: MotionClash | None
    distance: float
    permitted: float
    stop_is_proved: bool


class JogCheck:
    """Checks jogs that a controller shows.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    free_path
        The search for the free part of a path.
    reaction
        Time from the measured state to the beginning of braking in the worst case, s.
    deceleration
        That every axis attains, (axes,).
    limits
        Accelerations of jogs: those at which the controller follows a lower permitted speed.
    """

    def __init__(
        self, nominal: NominalCell, free_path: FreePath, reaction: float, deceleration: Array, limits: JogLimits
    ) -> None:
        self._free_path, self._reaction, self._deceleration, self._limits = free_path, reaction, deceleration, limits
        self._max_speed = nominal.axis_max_speed
        self._tool = Tool(nominal)

    def check(self, axes: Array, points: Array, spacing: float, in_force: float, exact: bool = True) -> JogVerdict:
        """Verdict on a jog.

        Parameters
        ----------
        axes
            Measured positions, (axes,).
        points
            Path of the jog at full speed from the state on, (n, axes), `spacing` apart.
        spacing
            s.
        in_force
            Largest share of the full speed that the robot may have until the answer arrives.
        exact
            Whether the first of the `points` is a set-point.
        """
        if len(points) < 4:
            return JogVerdict(None, np.inf, 0.0, False)
        jog = self._jog(points, spacing, exact)
        error = np.abs(points[0] - axes) + self._free_path.angle_error
        # The errors of the next state differ: the speed is reduced for larger ones.
        larger = np.maximum(error, _LARGER * self._free_path.angle_error)
        budget, shown = Budget(_JOG_WORK), spacing * (len(points) - 1)
        permitted, clash, free_at = 0.0, None, {}
        for most in (1.0, _SLOW) if in_force > _SLOW else (_SLOW, 1.0):  # one of them is mostly enough
            free_at[most], found = self._search(jog, larger, most, self._room(jog, most), budget.share(2))
            permitted = max(permitted, min(most, self._permitted(jog, free_at[most])))
            clash = found or clash
            if (permitted >= _SLOW) == (most == 1.0):
                break
        share = max(in_force, permitted)
        needed = share * self._reaction + share**2 * jog.longest / 2  # path clock of the reaction and the stop, s
        proved = needed <= shown and any(share <= most and needed <= free for most, free in free_at.items())
        if needed <= shown and not proved:
            # For the proof, unlike the permitted share, stops that begin after the reaction time do not matter.
            soon = replace(jog, braking=np.minimum(jog.braking, jog.longest))
            proved = self._search(soon, error, share, needed, budget)[0] >= needed
        distance = np.inf if clash is None else self._free_path.distance(points[0], (clash.body_a, clash.body_b))
        return JogVerdict(clash, distance, permitted, proved)

    def _jog(self, points: Array, spacing: float, exact: bool) -> _Jog:
        rates = np.gradient(points, spacing, axis=0, edge_order=2)
        rates = np.clip(rates, -self._max_speed, self._max_speed)
        braking = (np.abs(rates) / self._deceleration).max(1)
        until = int(np.ceil(self._reaction / spacing)) + 1  # braking begins no later, at any share
        longest = float(braking[:until].max())
        ramp = max(longest, _RAMP * self._ramp(points[0], rates[0]))
        return _Jog(points, rates, spacing, braking, longest, ramp, self._deceleration, exact)

    def _search(
        self, jog: _Jog, error: Array, share: float, clock: float, budget: Budget
    ) -> tuple[float, MotionClash | None]:
        """Path clock that is proved free, s, at up to a `share` of the full speed; infinite: at least `clock`.

        The path beyond what is shown counts as free where all of that is. It ends where stops may be far from it.
        """
        wanted = int(np.ceil(clock / jog.spacing - 1e-9))
        path = jog.path(error, share)
        astray = path.deviation.max(1) > _FARTHEST_ASTRAY
        known = int(np.argmax(astray)) if astray.any() else len(path.ends)
        end = min(wanted, known)
        fine, parts = _JOG_PIECES
        sections = [Section(0, min(fine, end), parts), Section(min(fine, end), end, _COARSE)]
        free, clash = self._free_path.search(path, sections, budget)
        if clash is None and (end == wanted or not astray.any()):
            return np.inf, None
        return free * jog.spacing, clash

    def _room(self, jog: _Jog, share: float) -> float:
        """Path clock from which on a share is permitted, s."""
        return _JOG_SHARE * share * self._reaction + share**2 * jog.ramp / 2

    def _permitted(self, jog: _Jog, free: float) -> float:
        """The share with the room `free`, s of path clock; 0 if it is too small."""
        if free == np.inf:
            return 1.0
        easy = _JOG_SHARE * self._reaction
        share = 2 * free / (easy + np.sqrt(easy**2 + 2 * jog.ramp * free))
        return float(share) if share >= _LEAST else 0.0

    def _ramp(self, axes: Array, rates: Array) -> float:
        """Time in which the controller slows a jog of `rates` (axes,) down to rest, s."""
        twist = self._tool.twist(axes, rates)
        line, turn = float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:]))
        return max(braking_time(rates, self._limits.axes), line / self._limits.line, turn / self._limits.turn)


@dataclass(frozen=True)
class _Jog:
    """A jog at full speed: set-points (n, axes), `spacing` (s) apart, and their rates.

    `braking` (n,), s, is the time of a stop from each of them, `longest` that of the longest stop within the reaction
    time, and `ramp` the time in which the controller slows the jog down. `exact`: the first one is no measured one.
    """

    points: Array
    rates: Array
    spacing: float
    braking: Array
    longest: float
    ramp: float
    deceleration: Array
    exact: bool

    def path(self, error: Array, share: float) -> ShownPath:
        """The path at a share of the full speed, with the stops that leave it along its tangents.

        Braking takes at most half its time of path clock and half a cycle; until then the path bends away by half the
        curvature times the squared time. What accelerates more than the axes can, the controller does not follow: it
        brakes.
        """
        reach = share * (share * self.braking + self.spacing) / 2 / self.spacing  # pieces
        covered = int(np.ceil(reach.max()))
        bend = np.abs(np.diff(self.points, n=2, axis=0))
        bend = np.vstack([bend[:1], bend, bend[-1:]])  # at each point
        curved = np.minimum(_BENDING * bend, self.deceleration * (self.spacing / share) ** 2)
        aside = reach[:, None] ** 2 / 2 * _largest(curved, -1, covered + 1)
        deviation = error + _largest(bend, 0, 1)[:-1] / 4 + _largest(aside, -covered, 1)[:-1]
        ends = self.points[:-1] + self.spacing * (1 + reach[:-1, None]) * self.rates[:-1]
        return ShownPath(self.points, deviation, ends, np.zeros(len(error)), self.exact)


def _largest(rows: Array, first: int, last: int) -> Array:
    """Largest of the rows (n, m) from each number plus `first` to that plus `last`, (n, m)."""
    padded = np.pad(rows, ((max(-first, 0), max(last, 0)), (0, 0)), mode="edge")
    return np.asarray(sliding_window_view(padded, last - first + 1, axis=0).max(-1)[: len(rows)], np.float64)


@dataclass(frozen=True)
class PathVerdict:
    """Result of the proof of a path.

    Attributes
    ----------
    free
        Path clock for which the motion from the measured state on is proved free, s.
    clash
        What is not proved behind it; None: all that is known of the path is free.
    monitor_speed
        Largest at which the robot slows down in time, 0 to 1.
    stop_is_proved
        Whether the robot can react and then stop on the path before that, in the worst case.
    """

    free: float
    clash: MotionClash | None
    monitor_speed: float
    stop_is_proved: bool


class PathCheck:
    """Checks paths ahead.

    Parameters
    ----------
    free_path
        The search for the free part of a path.
    reaction
        Time from the measured state to the beginning of braking in the worst case, s.
    deceleration
        That every axis attains, (axes,).
    """

    def __init__(self, free_path: FreePath, reaction: float, deceleration: Array) -> None:
        self._free_path, self._reaction, self._deceleration = free_path, reaction, deceleration

    def check(
        self, axes: Array, points: Array, spacing: float, rate: float, allowed: float, exact: bool = True
    ) -> PathVerdict:
        """Verdict on a path.

        Parameters
        ----------
        axes
            Measured positions, (axes,).
        points
            Path from the measured state on, (n, axes), `spacing` apart.
        spacing
            s of path clock.
        rate
            Rate of the path clock in the state. A path on which the clock stands still may be at its start.
        allowed
            Largest monitor speed that may be in force until the answer arrives.
        exact
            Whether the first of the `points` is a set-point; else it is the measured one.
        """
        # Path clock that braking from full speed takes, s; from the rate r it takes r times that.
        speed = np.abs(np.diff(points, axis=0)).max(0) / spacing
        braking = float(_PATH_BRAKING * (speed / self._deceleration).max())
        needed = self._advance(rate or allowed, max(allowed, rate), braking)
        # Axes that are farther from their set-points than the errors of their angles explain stay that far behind.
        error = np.maximum(np.abs(points[0] - axes), self._free_path.angle_error)
        free, clash = self._free(points, error, spacing, needed, exact)
        if clash is None and (points[-1] == points[-2]).all():
            free = np.inf  # the motion ends within what is known
        room = _REST + 2 * self._reaction * _TARGETS + _TARGETS**2 * (1 / (2 * _RATE_CHANGE) + braking / 2)
        monitor_speed = float(_TARGETS[room <= free].max(initial=0.0))
        return PathVerdict(free, clash, monitor_speed, needed <= free)

    def _free(
        self, points: Array, error: Array, spacing: float, needed: float, exact: bool
    ) -> tuple[float, MotionClash | None]:
        """Path clock that is proved free, s, and the clash beyond it; the part `needed` for a stop is proved first."""
        bend = np.abs(np.diff(points, n=2, axis=0)).max(0, initial=0.0) / 4 + error
        moving = np.flatnonzero((np.diff(points, axis=0) != 0).any(1))
        last = int(moving[-1]) + 1 if len(moving) else 0
        of_stop = min(int(np.ceil(needed / spacing)), last)
        deviation = np.broadcast_to(bend, points[1:].shape)
        path = ShownPath(points, deviation, points[1:], _bend_aside(points), exact)
        sections = [Section(0, of_stop, _FINER), Section(of_stop, last, _FINER)]
        free, clash = self._free_path.search(path, sections, Budget(_PATH_WORK))
        return spacing * (free if clash else len(points) - 1), clash

    def _advance(self, rate: float, allowed: float, braking: float) -> float:
        """Path clock until standstill in the worst case: the rate grows to `allowed` during the reaction time."""
        growing = min((allowed - rate) / RATE_SLOPE, self._reaction)
        last = min(allowed, rate + RATE_SLOPE * self._reaction)
        return (rate + last) / 2 * growing + last * (self._reaction - growing) + last**2 * braking / 2


def _bend_aside(points: Array) -> Array:
    """Bound (axes,) on how far the motion through set-points leaves the straight lines sideways."""
    change, along = np.diff(points, n=2, axis=0), points[2:] - points[:-2]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    unit = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    aside = change - unit * (change * unit).sum(1, keepdims=True)
    return np.asarray(np.abs(aside).max(0, initial=0.0) / 4)
