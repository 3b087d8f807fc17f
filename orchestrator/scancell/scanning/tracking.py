"""Motions of a tool relative to a belt that runs: from rest onto the belt, along with it, and to rest.

The belt runs at a constant speed, so that its frame is known ahead. In each part of the motion a share that rises with
continuous speed and acceleration, ``10 s³ - 15 s⁴ + 6 s⁵``, leads from one pose to the next; the poses move with the
belt, except the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scancell.arrays import Array
from scancell.cell.program import Program, Segment
from scancell.config.robot import MotionDescription
from scancell.errors import CommandError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.planning.motion.trajectory import Limits, cycle_times, limit_fractions

_SHORTEST = 0.2  # s: of a part of the motion
_LONGER = 1.15  # factor by which parts last longer until the limits are kept
_MARGIN = 0.9  # of the limits of the axes, between whose set-points the controller interpolates
_PEAK_SPEED, _PEAK_ACCELERATION = 1.875, 5.7735  # of the share, per duration and its square
_JUMP = 0.2  # rad between set-points, from which joints do not move continuously


@dataclass(frozen=True)
class BeltMotion:
    """A motion relative to a belt.

    Attributes
    ----------
    program
        One segment, from rest to rest.
    reached
        (n,) times after its start at which the tool is at each pose, s.
    """

    program: Program
    reached: Array


@dataclass(frozen=True)
class BeltTracking:
    """Planner of motions relative to a belt.

    Attributes
    ----------
    nominal, motion, cycle
        The cell, the limits of the tool on straight lines, and the controller's cycle, s.
    velocity
        (3,) of the belt in the world, m/s.
    flange_from_tool
        (4, 4) of the tool that moves.
    speed
        Share of the limits of joints and of the tool.
    """

    nominal: NominalCell
    motion: MotionDescription
    cycle: float
    velocity: Array
    flange_from_tool: Array
    speed: float

    def plan(self, start: Array, poses: Sequence[Array], dwell: float) -> BeltMotion:
        """The motion through poses, at each of which the tool rests relative to the belt.

        Raises `CommandError` if the arm does not reach a pose while the belt carries it, or cannot follow the belt
        within its limits.

        Parameters
        ----------
        start
            Positions (axes,) of all axes, rad or m.
        poses
            ``world_from_tool`` (4, 4) each, where the belt has them when the motion starts.
        dwell
            Time at each, s.
        """
        flange = self.nominal.world_from(self.nominal.arm.flange, start)
        first = flange @ self.flange_from_tool
        durations = np.array([self._shortest(one, other) for one, other in zip([first, *poses], poses, strict=False)])
        braking = max(_SHORTEST, _PEAK_SPEED * float(np.linalg.norm(self.velocity)) / self._limits("acceleration")[0])
        no_jerk = np.full(len(start), np.inf)
        limits = Limits(self.nominal.axis_max_speed, self.nominal.axis_max_acceleration, no_jerk)
        limits, needed = limits.scaled(_MARGIN * self.speed), ""
        while True:
            reached = np.cumsum(durations) + dwell * np.arange(len(poses))
            times = cycle_times(float(reached[-1]) + dwell + braking, self.cycle)
            world_from_tool = self._path(times, first, poses, durations, reached, dwell, braking)
            axes = self._axes(start, world_from_tool, needed)
            over = limit_fractions(axes, limits, self.cycle)[:2]
            if over.max() <= 1.0:
                break
            kind, axis = np.unravel_index(int(over.argmax()), over.shape)
            needed = (
                f"; a shorter motion needs {over.max():.0%} of the {('speed', 'acceleration')[kind]} that "
                f"{self.nominal.axes[axis]} may have: the belt is too fast"
            )
            durations, braking = _LONGER * durations, _LONGER * braking
        count = len(self.nominal.home) + 1
        return BeltMotion(Program((Segment(1, times, axes[:, :count], name="belt", further=axes[:, count:]),)), reached)

    def _limits(self, what: str) -> tuple[float, float]:
        """Largest linear and angular speed or acceleration of the tool, m and rad."""
        linear, angular = (
            getattr(self.motion, f"{kind}_{what}_{unit}{'2' * (what == 'acceleration')}")
            for kind, unit in (("line", "mm_s"), ("turn", "deg_s"))
        )
        return self.speed * 1e-3 * linear, self.speed * float(np.radians(angular))

    def _shortest(self, one: Array, other: Array) -> float:
        """Shortest duration, s, of the way between poses (4, 4) by the limits of the tool."""
        turn = pose.log_rotation(one[:3, :3].T @ other[:3, :3])
        ways, found = [float(np.linalg.norm(way)) for way in (other[:3, 3] - one[:3, 3], turn)], [_SHORTEST]
        for length, speed, acceleration in zip(ways, self._limits("speed"), self._limits("acceleration"), strict=True):
            found += [_PEAK_SPEED * length / speed, float(np.sqrt(_PEAK_ACCELERATION * length / acceleration))]
        return float(max(found))

    def _path(
        self,
        times: Array,
        first: Array,
        poses: Sequence[Array],
        durations: Array,
        reached: Array,
        dwell: float,
        braking: float,
    ) -> Array:
        """Poses (n, 4, 4) of the tool in the world at times (n,), s."""
        relative, share = np.broadcast_to(first, (len(times), 4, 4)).copy(), np.ones(len(times))
        before = first
        for number, (after, duration, end) in enumerate(zip(poses, durations, reached, strict=True)):
            passed = np.clip((times - end) / duration + 1.0, 0.0, 1.0)
            rows = passed > 0.0
            part = _share(passed[rows])
            relative[rows] = pose.interpolate_straight(before, after, part)
            if number == 0:
                share = _share(passed)  # of the belt's motion
            before = after
        # From the end on, what is left of the belt's speed falls from all of it to none.
        end = float(reached[-1]) + dwell
        late = np.clip((times - end) / braking, 0.0, 1.0)
        travel = np.minimum(times, end) + braking * (late - _integral(late))
        relative[:, :3, 3] += (share * travel)[:, None] * self.velocity
        return relative

    def _axes(self, start: Array, world_from_tool: Array, needed: str) -> Array:
        """Positions (n, axes) of all axes from `start` (axes,) on that bring the tool to poses (n, 4, 4).

        `needed` states in messages why the motion does not end earlier.
        """
        carrier = self.nominal.world_from(self.nominal.arm_on, start)
        targets = pose.inverse(carrier) @ world_from_tool @ pose.inverse(self.flange_from_tool)
        count = len(self.nominal.home)
        branches = self.nominal.arm.ik_along(targets[None], start[:count])[0]
        own = int(np.nanargmin(np.nan_to_num(np.abs(branches[0] - start[:count]).max(-1), nan=np.inf)))
        joints = branches[:, own]
        lost = np.flatnonzero(~np.isfinite(joints).all(-1))
        if not len(lost) and len(joints) > 1:
            lost = np.flatnonzero(np.abs(np.diff(joints, axis=0)).max(-1) > _JUMP) + 1
        if len(lost):
            place = ", ".join(f"{1e3 * x:.1f}" for x in world_from_tool[lost[0], :3, 3])
            raise CommandError(
                f"the belt carries the tool to ({place}) mm, where it cannot be brought within joint limits{needed}"
            )
        axes = np.broadcast_to(start, (len(joints), len(start))).copy()
        axes[:, :count] = joints
        return axes


def _share(s: Array) -> Array:
    """Share (n,) of the way at shares (n,) of the time."""
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def _integral(s: Array) -> Array:
    """Integral of `_share` from 0, 1/2 at s = 1."""
    return np.asarray(s**4 * (2.5 - 3.0 * s + s**2))
