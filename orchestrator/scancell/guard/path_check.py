"""Proved free length of the path ahead in automatic operation, and the permitted speed on it.

The controller scales time along its path: at the rate r of the path clock it goes on for r T in the reaction time T.
It brakes on the path, too.  There an axis of speed v and deceleration a needs v / a, but may have to wait until another
axis has braked that the path slows down itself: half as long again is assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.guard.free_path import FreePath, Section, ShownPath
from scancell.proximity.motion_check import Budget, MotionClash

Array = NDArray[np.float64]

_FINER = 4  # parts of a piece of the path that are distinguished
_PATH_WORK = 150_000  # comparisons of faces or their bounding volumes: the path is not proved beyond
_LONGER = 1.5  # braking on a path against braking straight on
_TARGETS = np.linspace(0.0, 1.0, 51)
_EASY_RATE = 2.0  # 1/s: change of the rate for which the monitor speed leaves room
_REST = 0.02  # s of path clock that are left when the robot waits

# Of the controller: the rate follows the monitor speed no faster, 1/s, but for the start of a path, where it is that of
# the monitor speed at once.
RATE_SLOPE = 4.0


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
        That every axis attains, (axes,), rad/s².
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
            Measured joints and table angle, (axes,), rad.
        points
            Path from the measured state on, (n, axes), rad, `spacing` apart.
        spacing
            s of path clock.
        rate
            Of the path clock in the state. A path on which the clock stands still may be at its start.
        allowed
            Largest monitor speed that may be in force until the answer arrives.
        exact
            Whether the first of the `points` is a set-point; else it is the measured one.
        """
        braking = self._braking(points, spacing)
        needed = self._advance(rate or allowed, max(allowed, rate), braking)
        # Axes that are farther from their set-points than the errors of their angles explain stay that far behind.
        error = np.maximum(np.abs(points[0] - axes), self._free_path.angle_error)
        free, clash = self._free(points, error, spacing, needed, exact)
        if clash is None and (points[-1] == points[-2]).all():
            free = np.inf  # the motion ends within what is known
        room = _REST + 2 * self._reaction * _TARGETS + _TARGETS**2 * (1 / (2 * _EASY_RATE) + braking / 2)
        speed = float(_TARGETS[room <= free].max(initial=0.0))
        return PathVerdict(free, clash, speed, needed <= free)

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

    def _braking(self, points: Array, spacing: float) -> float:
        """Path clock that braking from full speed takes, s; from the rate r it takes r times that."""
        speed = np.abs(np.diff(points, axis=0)).max(0) / spacing
        return float(_LONGER * (speed / self._deceleration).max())

    def _advance(self, rate: float, allowed: float, braking: float) -> float:
        """Path clock until standstill in the worst case: the rate grows to `allowed` during the reaction time."""
        growing = min((allowed - rate) / RATE_SLOPE, self._reaction)
        last = min(allowed, rate + RATE_SLOPE * self._reaction)
        return (rate + last) / 2 * growing + last * (self._reaction - growing) + last**2 * braking / 2


def _bend_aside(points: Array) -> Array:
    """Bound (axes,), rad, on how far the motion through set-points leaves the straight lines sideways."""
    change, along = np.diff(points, n=2, axis=0), points[2:] - points[:-2]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    unit = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    aside = change - unit * (change * unit).sum(1, keepdims=True)
    return np.asarray(np.abs(aside).max(0, initial=0.0) / 4)
