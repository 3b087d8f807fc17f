"""Trajectories of limited speed, acceleration, jerk and torque: rest-to-rest moves, and runs at constant speed.

Limits are checked on a grid ten times as fine as the controller's. A motion that exceeds one lasts longer by a uniform
factor: its path and with it all clearances stay the same, the speed during exposures stays constant, and no larger
constant speed along the same joint and table angles keeps the limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import ruckig
from numpy.typing import ArrayLike

from scancell.arrays import Array
from scancell.cell.fmu_file import dynamics_json
from scancell.config.cell import CellDescription
from scancell.errors import CellError, PlanningError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, arm_of

if TYPE_CHECKING:
    from scancell.planning.model import PlanningCell

# Largest acceleration and jerk of a speed that rises as 3 s² - 2 s³ over unit time to unit speed.
_RAMP_ACCELERATION = 1.5
_RAMP_JERK = 6.0
_LEAD = 2  # cycles of constant speed around the exposures: the controller reaches a set-point one cycle late
_NO_LIMIT = 1e3  # of normalised speed and acceleration: beyond what unit jerk attains over unit travel
MAX_DURATION = 4000.0  # s of a motion, which is planned, checked and simulated set-point by set-point
MAX_SAMPLES = 2_000_000  # of a motion

FINER = 10  # points of the grid on which limits are checked in a cycle of the controller
_MARGIN = 5e-3  # relative: at another phase of the grid, peaks of jerk measure up to 1 % more
_LIMITED = ("speed", "acceleration", "jerk")
_SHARE = 0.8  # of the torque that gravity and friction leave: gears are elastic and oscillate


@dataclass(frozen=True)
class Limits:
    """Limits (axes,) of speed, rad/s, acceleration, rad/s², and jerk, rad/s³."""

    speed: Array
    acceleration: Array
    jerk: Array

    def of_axis(self, axis: int) -> tuple[float, float, float]:
        """Speed, acceleration and jerk of one axis."""
        return float(self.speed[axis]), float(self.acceleration[axis]), float(self.jerk[axis])

    def scaled(self, fraction: float) -> Limits:
        """A fraction of these limits."""
        return Limits(fraction * self.speed, fraction * self.acceleration, fraction * self.jerk)


def cycle_times(duration: float, cycle: float) -> Array:
    """Times (n,), s, n >= 2, of the set-points of a motion: every `cycle` from 0 to its end or just after it.

    Raises `PlanningError` if they are too many.
    """
    require_sample_count(duration, cycle)
    return np.asarray(np.arange(max(1, int(np.ceil(duration / cycle - 1e-9))) + 1) * cycle, np.float64)


def require_sample_count(duration: float, period: float) -> None:
    """Refuse a motion longer than `MAX_DURATION` or of more than `MAX_SAMPLES`, before memory is reserved for them.

    Raises `PlanningError` naming the keys that make it so slow.
    """
    if not (duration <= MAX_DURATION and duration / period <= MAX_SAMPLES):
        raise PlanningError(
            f"a motion takes {duration:.3g} s: {duration / period:.3g} samples every {1e3 * period:g} ms",
            expected=f"at most {MAX_DURATION:g} s and {MAX_SAMPLES} samples; raise the speed of the sweep, pass or path"
            " (speed_deg_s, speed_mm_s) or the limits of the axes (max_speed_deg_s, max_acceleration_deg_s2,"
            " max_jerk_deg_s3)",
        )


def move(start: ArrayLike, end: ArrayLike, limits: Limits, cycle: float, slowdown: float = 1.0) -> Array:
    """Positions (n, axes), n >= 2, every `cycle` seconds of the fastest straight rest-to-rest move within limits.

    The profile along the line is by Ruckig (Berscheid & Kröger, "Jerk-limited real-time trajectory generation with
    arbitrary target states", 2021). With a `slowdown` above 1 it lasts that many times as long.
    """
    start, end = np.asarray(start, float), np.asarray(end, float)
    travel = np.abs(end - start)
    if not travel.any():
        return np.stack([start, end])
    share = travel[travel > 0]
    speed, acceleration, jerk = (
        float((limit[travel > 0] / share).min()) for limit in (limits.speed, limits.acceleration, limits.jerk)
    )
    unit = jerk ** (-1 / 3)  # s: in this unit of time the jerk limit is 1
    one = ruckig.InputParameter(1)
    one.current_position, one.target_position = [0.0], [1.0]
    one.max_velocity, one.max_acceleration = [min(speed * unit, _NO_LIMIT)], [min(acceleration * unit**2, _NO_LIMIT)]
    one.max_jerk = [1.0]
    profile = ruckig.Trajectory(1)
    if ruckig.Ruckig(1).calculate(one, profile) != ruckig.Result.Working:
        raise ValueError(f"limits = {limits}: expected positive numbers")
    cycles = len(cycle_times(slowdown * profile.duration * unit, cycle)) - 1
    fraction = [profile.at_time(k / cycles * profile.duration)[0][0] for k in range(1, cycles)]
    return np.asarray(start + np.array([0.0, *fraction, 1.0])[:, None] * (end - start))


@dataclass(frozen=True)
class Run:
    """A rest-to-rest run along a path with constant speed during the exposures, between ramps of equal duration.

    Attributes
    ----------
    speed
        Speed in path units (m or rad) per s during the exposures.
    rest, ramp, cruise
        Durations, s: at rest before and after the run, of either ramp, of constant speed.
    lead
        Time from the end of the first ramp to the first exposure, s, where the path coordinate is 0.
    exposing
        Time during which triggers are enabled, s.
    """

    speed: float
    rest: float
    ramp: float
    cruise: float
    lead: float
    exposing: float

    @property
    def duration(self) -> float:
        """Duration of the run with both rests, s."""
        return 2 * (self.rest + self.ramp) + self.cruise

    @property
    def trigger_from(self) -> float:
        """When triggers are enabled and the first exposure occurs, s."""
        return self.rest + self.ramp + self.lead

    @property
    def trigger_to(self) -> float:
        """When triggers are disabled, s."""
        return self.trigger_from + self.exposing

    def at(self, time: ArrayLike) -> Array:
        """Path coordinate (...,) at times (...,), s; constant before and after."""
        since = np.asarray(time, float) - self.rest
        rising = np.clip(since / self.ramp, 0.0, 1.0)
        falling = np.clip((since - self.ramp - self.cruise) / self.ramp, 0.0, 1.0)
        travelled = (_ramp_travel(rising) + falling - _ramp_travel(falling)) * self.ramp
        travelled += np.clip(since - self.ramp, 0.0, self.cruise)
        return np.asarray(self.speed * (travelled - 0.5 * self.ramp - self.lead))

    def slowed(self, factor: float) -> Run:
        """The run that lasts `factor` times as long."""
        times = (self.rest, self.ramp, self.cruise, self.lead, self.exposing)
        return Run(self.speed / factor, *(factor * time for time in times))

    def rested(self, rest: float) -> Run:
        """The run with `rest` s at rest at both ends."""
        return replace(self, rest=rest)


def run(count: int, interval: float, speed: float, acceleration: float, cycle: float, jerk: float = np.inf) -> Run:
    """The run with `count` exposures, one every `interval` of path, with ramps within the limits along the path.

    Path units are m or rad. Ramps and the constant speed last whole cycles.
    """
    ramp = max(_RAMP_ACCELERATION * speed / acceleration, np.sqrt(_RAMP_JERK * speed / jerk))
    # Half an interval after the last exposure, so that it fires and no further one does.
    exposing = (count - 0.5) * interval / speed
    cruise = 2 * _LEAD + int(np.ceil(exposing / cycle))
    return Run(speed, 0.0, cycle * float(np.ceil(ramp / cycle)), cycle * cruise, cycle * _LEAD, exposing)


def _ramp_travel(s: Array) -> Array:
    """Integral of the ramp ``3 s² - 2 s³``, 1/2 at s = 1."""
    return np.asarray(s**3 - s**4 / 2)


def limit_fractions(positions: ArrayLike, limits: Limits, period: float) -> Array:
    """Peak speed, acceleration and jerk (3, axes) of positions (n, axes) every `period` s, as fractions of limits."""
    p = np.asarray(positions, float)
    of = (limits.speed, limits.acceleration, limits.jerk)
    peaks = [np.abs(np.diff(p, n, axis=0)).max(0, initial=0.0) / period**n for n in (1, 2, 3)]
    return np.stack([peak / limit for peak, limit in zip(peaks, of, strict=True)])


def needed_slowdown(fractions: Array) -> Array:
    """Factors (3, axes) by which a motion of these `limit_fractions` must last longer to just keep each limit."""
    return np.asarray(fractions ** np.array([1.0, 1 / 2, 1 / 3])[:, None])


@dataclass(frozen=True)
class Slowdown:
    """Factor, at least 1, by which a motion lasts longer, and the limit that requires it."""

    factor: float
    limit: str

    def __str__(self) -> str:
        return f"slowed to {100 / self.factor:.0f} % by the {self.limit}"


def slowdown(cell: PlanningCell, positions: Callable[[Array], Array], duration: float) -> Slowdown | str:
    """The slowdown that a motion from rest to rest needs; or why it is not possible at any speed.

    Parameters
    ----------
    positions
        Joints and table angle (n, axes), rad, at times (n,), s; constant before 0 and after `duration`; NaN
        where there are none.
    """
    period = cell.cycle / FINER
    require_sample_count(duration, period)
    fine = positions(np.asarray(period * np.arange(-3, int(np.ceil(duration / period)) + 4), np.float64))
    if not np.isfinite(fine).all():
        return "the path leaves the reach or the joint limits"
    needed = needed_slowdown(limit_fractions(fine, cell.axis_limits, period))
    order, axis = (int(i) for i in np.unravel_index(np.argmax(needed), needed.shape))
    factor, limit = float(needed[order, axis]), f"{_LIMITED[order]} limit of {axis_name(cell, axis)}"
    if cell.torques is not None:
        by_torque, joint = cell.torques.needed_slowdown(fine[:, : len(cell.nominal.home)], period)
        if not np.isfinite(by_torque):
            return weak_motor(joint)
        if by_torque > factor:
            factor, limit = by_torque, f"torque limit of {axis_name(cell, joint)}"
    return Slowdown(factor * (1 + _MARGIN), limit) if factor > 1 else Slowdown(1.0, "")


def weak_motor(joint: int) -> str:
    """Why an arm cannot be held: the motor of a joint, counted from 0, and its key."""
    key = f"robot.joint[{joint + 1}].drive.max_torque_n_m"
    return f"the torque limit of joint {joint + 1} is too low to hold the arm ({key})"


def axis_name(cell: PlanningCell, axis: int) -> str:
    """Name of an axis in messages: the table follows the joints, and further axes follow it."""
    joints = len(cell.nominal.arm.joints)
    if axis > joints:
        return f"the axis {cell.nominal.axes[axis]}"
    return "the table" if axis == joints else f"joint {axis + 1}"


class TorqueLimits:
    """Torque limits of an arm with dynamic drives, for planning.

    Raises errors as `arm_skeleton`.

    Parameters
    ----------
    cell
        Description; every joint must have a drive.
    nominal
        The cell in which the arm stands; it carries the part where this is on the flange.
    """

    def __init__(self, cell: CellDescription, nominal: NominalCell | None = None) -> None:
        drives = [joint.drive for joint in cell.robot.joint if joint.drive is not None]
        self._cell, self._skeleton = cell, arm_skeleton(cell, nominal)
        self._limit = np.array([drive.max_torque_n_m for drive in drives])
        self._rotor = np.array([drive.motor_inertia_kg_m2 for drive in drives])
        self._coulomb = np.array([drive.coulomb_friction_n_m for drive in drives])
        self._viscous = np.array([drive.viscous_friction_n_m_s_rad for drive in drives])

    def standing(self, nominal: NominalCell) -> TorqueLimits:
        """The limits of the same arm where it stands in another cell."""
        return TorqueLimits(self._cell, nominal)

    def needed_slowdown(self, q: Array, period: float) -> tuple[float, int]:
        """Factor by which a motion must last longer so that all motors keep their torque limits, and the joint.

        With a factor k, the torque is ``static + viscous / k + dynamic / k²``: gravity and Coulomb friction stay. The
        factor is infinite where these alone exceed the limit, and 0 for a motion without the other two.

        Parameters
        ----------
        q
            (n, axes) joints, rad, every `period` s; what follows the joints has no effect.
        """
        q = q[:, : len(self._limit)]
        rate = np.gradient(q, period, axis=0)
        acceleration = np.gradient(rate, period, axis=0)
        rest = np.zeros_like(q)
        static = joint_torques(self._skeleton, q, rest, rest)
        dynamic = joint_torques(self._skeleton, q, rate, acceleration) - static + self._rotor * acceleration
        viscous = self._viscous * rate
        left = self._limit - np.abs(static) - self._coulomb
        if (left < 0).any():
            return np.inf, int(np.argmin(left.min(0)))
        left *= _SHARE
        # left k² - |viscous| k - |dynamic| = 0; magnitudes add, which is on the safe side.
        size, speed = np.abs(dynamic), np.abs(viscous)
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = (speed + np.sqrt(speed**2 + 4 * left * size)) / (2 * left)
        factor = np.where((size == 0) & (speed == 0), 0.0, factor)
        worst = factor.max(0)
        return float(worst.max()), int(np.argmax(worst))


def joint_torques(skeleton: Any, q: Array, qd: Array, qdd: Array) -> Array:
    """Joint torques (n, joints), N m, that move the links of an arm and what its flange carries.

    Friction and the inertia of motors are not included.

    Parameters
    ----------
    skeleton
        The arm, from `arm_skeleton`.
    q, qd, qdd
        (n, joints) joints of a path, rad, their rates, rad/s, and accelerations, rad/s².
    """
    torques = np.empty_like(q)
    for row, position, rate, acceleration in zip(torques, q, qd, qdd, strict=True):
        skeleton.setPositions(position)
        skeleton.setVelocities(rate)
        skeleton.setAccelerations(acceleration)
        skeleton.computeInverseDynamics()
        row[:] = skeleton.getForces()
    return torques


def arm_skeleton(cell: CellDescription, nominal: NominalCell | None = None) -> Any:
    """The arm of a cell in DART, with a body per link in its Denavit-Hartenberg frame.

    The last link has the mass of sensor, gripper, its fingers as they start, and of a part on the flange, too. By
    default the arm stands where its description places it, with axes that carry it at 0, and has no part.

    Raises `CellError` if a link has neither an inertia nor a mesh to compute it from; `MeshError` if a mesh that
    defines masses cannot be used.
    """
    import dartpy  # noqa: PLC0415  (it loads libGL, which few machines without a screen have)

    for number, joint in enumerate(cell.robot.joint, start=1):
        if joint.inertia is None and joint.mesh is None:
            raise CellError("torques need an inertia, or a mesh to compute it from", key=f"robot.joint[{number}]")
    arm = arm_of(cell.robot) if nominal is None else nominal.with_axes_held().arm
    part = None if nominal is None else nominal.scanned_part
    frames = arm.link_poses(np.zeros(len(arm.joints)))
    skeleton = dartpy.dynamics.Skeleton(cell.robot.name)
    skeleton.setGravity(np.array([0.0, 0.0, -cell.world.gravity_m_s2]))
    body = None
    for number, link in enumerate(dynamics_json(cell, part, fingers=True)["links"], start=1):
        joint = dartpy.dynamics.RevoluteJointProperties()
        joint.mAxis = np.array([0.0, 0.0, 1.0])
        joint.mName = f"joint{number}"
        if number == 1:
            joint.mT_ParentBodyToJoint = dartpy.math.Isometry3(arm.world_from_base)
        joint_from_link = pose.inverse(frames[number - 1]) @ frames[number]
        joint.mT_ChildBodyToJoint = dartpy.math.Isometry3(pose.inverse(joint_from_link))
        _, body = skeleton.createRevoluteJointAndBodyNodePair(body, joint)
        inertia = (link["mass"], np.array(link["centre_of_mass"]), np.array(link["inertia"]))
        body.setInertia(dartpy.dynamics.Inertia(*inertia))
    return skeleton
