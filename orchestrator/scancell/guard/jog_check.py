"""Permitted speed of a jog whose path the controller shows, and proof that it stops within the free part of the path.

A jog follows its path at any share of the full speed at which it is shown.  At the share s it goes on for s T of path
clock in the reaction time T, then brakes along the tangent: the axis of speed v and deceleration a that needs longest
sets B = v / a at full speed, and the stop takes s² B / 2 of path clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from scancell.guard.free_path import FreePath, Section, ShownPath
from scancell.guard.stopping import braking_time
from scancell.guard.tool import Tool
from scancell.guard.unseen import JogLimits
from scancell.nominal.cell import NominalCell
from scancell.proximity.motion_check import Budget, MotionClash

Array = NDArray[np.float64]

# Comparisons of faces or their bounding volumes (about 0.08 µs each): the path is not proved beyond.
_JOG_WORK = 70_000
_BENDING = 1.5  # of the measured curvature between its samples
_FARTHEST_ASTRAY = 0.2  # rad: links of an arm are too close to each other for stops that may deviate more
_JOG_PIECES = 2, 64  # pieces in which slow jogs stop, and the parts of each that are distinguished
_COARSE = 4  # parts of the other pieces
_LEAST = 0.002  # smallest permitted share of the full speed above 0
_SLOW = 0.25  # share up to which stops leave the path so little that they are checked on their own
_LARGER = 1.5  # of the largest error of the angles, for which the permitted share leaves room
# Reaction times for which the permitted share s leaves room: near a body s falls by the factor e in this time, so that
# the share that was permitted a reaction time before is safe as well, also where answers arrive 0.1 s late.
_JOG_SHARE = 2.5
_RAMP = 1.1  # of the time that the controller takes to slow down, for which the permitted share leaves room


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
        That every axis attains, (axes,), rad/s².
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
            Measured joints and table angle, (axes,), rad.
        points
            Path of the jog at full speed from the state on, (n, axes), rad, `spacing` apart.
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
        needed = self._needed(jog, share)
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

    def _needed(self, jog: _Jog, share: float) -> float:
        """Path clock of the reaction and the stop at a share of the full speed, s."""
        return share * self._reaction + share**2 * jog.longest / 2

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
        """Time in which the controller slows a jog of `rates` (axes,), rad/s, down to rest, s."""
        twist = self._tool.poses(axes[None, :-1])[1][0] @ rates[:-1]
        line, turn = float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:]))
        return max(braking_time(rates, self._limits.axes), line / self._limits.line, turn / self._limits.turn)


@dataclass(frozen=True)
class _Jog:
    """A jog at full speed: set-points (n, axes), rad, `spacing` (s) apart, and their rates, rad/s.

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
