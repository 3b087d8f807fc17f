"""Seeded random motions by hand with known truth, as a robot controller jogs: for the tests of the guard."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from scancell.config.cell import CellDescription
from scancell.config.description import si_value
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry.mesh import box_mesh
from scancell.geometry.pose import translation
from scancell.guard.parts import Tool
from scancell.guard.stopping import Kind, MeasuredState, Path, braking_time
from scancell.nominal.cell import NominalCell, nominal_cell

POLL = 0.032  # s
POLLS = POLL * np.arange(3)
NOISE = np.radians(0.005)
CELLS = {"six_axis": "default", "offset_wrist": "offset_wrist", "seven_axis": "seven_axis"}
WITH_AXES = {"track": "track", "tilt_turn": "tilt_turn"}  # cells with an axis beyond the table
KINDS = ("rest", "table", "single joint", "joints", "translation", "rotation", "base", "tool")
AXIS = "further axis"
KIND_OF = {
    AXIS: Kind.FURTHER_AXES,
    "rest": Kind.REST,
    "table": Kind.TABLE,
    "single joint": Kind.SINGLE_JOINT,
    "joints": Kind.COMBINED,
    "translation": Kind.TRANSLATION,
    "rotation": Kind.ROTATION,
    "base": Kind.COMBINED,
    "tool": Kind.COMBINED,
}
_STEP = 0.004  # s, of the integration


@dataclass(frozen=True)
class Jog:
    """Speeds of jogging at full deflection: rad/s or m/s of the axes, m/s and rad/s of the tool."""

    axes: np.ndarray
    line: float
    turn: float


@dataclass(frozen=True)
class Motion:
    """A motion by hand: `name` of KINDS, how it continues, and true positions (k, axes) at `times` (k,), s."""

    name: str
    path: Path
    times: np.ndarray
    axes: np.ndarray

    def states(self, rng: np.random.Generator, noise: ArrayLike = NOISE) -> list[MeasuredState]:
        """As measured at the first three times."""
        measured = self.axes[:3] + noise * rng.standard_normal(self.axes[:3].shape)
        return [MeasuredState(float(t), row) for t, row in zip(self.times[:3], measured, strict=True)]


@cache
def cell_of(arm: str) -> tuple[NominalCell, Jog]:
    """The shipped cell of an arm, or with an axis, with a block on the table, and its jog speeds."""
    block = box_mesh((0.06, 0.04, 0.05)).transformed(translation((0.02, 0.0, 0.025)))
    description = described_cell(arm)
    nominal, motion = nominal_cell(description, block), description.robot.motion
    share = motion.jog_joint_share
    axes = share * nominal.axis_max_speed
    return nominal, Jog(axes, si_value(motion, "jog_speed_mm_s"), si_value(motion, "jog_turn_speed_deg_s"))


def described_cell(arm: str) -> CellDescription:
    return load_setup(assets_dir() / "cells" / f"{(CELLS | WITH_AXES)[arm]}.toml").cell


def with_others(nominal: NominalCell, q: np.ndarray) -> np.ndarray:
    """Positions (k, axes) with joints (k, joints) and the other axes where they start."""
    return np.hstack([q, np.tile(nominal.start[len(nominal.home) :], (len(q), 1))])


def random_start(nominal: NominalCell, rng: np.random.Generator) -> np.ndarray:
    """Positions (axes,), well inside the limits and away from singular positions."""
    lower, upper = nominal.arm.limits
    tool = Tool(nominal)
    while True:
        q = np.where([j in tool.active for j in range(len(lower))], rng.uniform(lower, upper) * 0.9, nominal.home)
        _, jacobian = tool.poses(with_others(nominal, q[None]))
        if np.linalg.svd(jacobian[0][:, tool.active], compute_uv=False)[-1] > 0.04:
            table = rng.uniform(-np.pi, np.pi)
            return np.array([*q, table, *(rng.uniform(axis.min, axis.max) for axis in nominal.further_axes)])


def random_motion(
    arm: str, name: str, rng: np.random.Generator, times: np.ndarray = POLLS, start: np.ndarray | None = None
) -> Motion:
    """A motion of kind `name` at 0.1 to 1 of the jog speeds, at increasing `times`; the table turns in some.

    In some of those of joints, axes beyond the table move, too.
    """
    nominal, jog = cell_of(arm)
    joints = len(nominal.home)
    axes = np.tile(random_start(nominal, rng) if start is None else start, (len(times), 1))
    if name == "table" or (name != "rest" and rng.random() < 0.3):
        axes[:, joints] += times * jog.axes[joints] * deflection(rng)
    for number in range(joints + 1, len(nominal.axes)):
        if name == AXIS or (name in ("single joint", "joints") and rng.random() < 0.5):
            axes[:, number] += times * jog.axes[number] * deflection(rng)
    if name in ("single joint", "joints"):
        axes[:, :joints] += times[:, None] * joint_rates(nominal, jog, name, axes[0, :joints], rng)
    elif name not in ("rest", "table", AXIS):
        axes[:, :joints] = cartesian(nominal, twist_of(jog, name, rng), name == "tool", axes[0, :joints], times)
    path = {"base": Path.BASE, "translation": Path.BASE, "rotation": Path.BASE, "tool": Path.TOOL}.get(name, Path.JOINT)
    return Motion(name, path, times, axes)


def deflection(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.1, 1.0) * rng.choice([-1.0, 1.0]))


def joint_rates(nominal: NominalCell, jog: Jog, name: str, q: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    joints = len(q)
    count = 1 if name == "single joint" else int(rng.integers(2, joints + 1))
    rates = np.zeros(joints)
    for joint in rng.choice(joints, count, replace=False):
        rates[joint] = deflection(rng) * jog.axes[joint]
    _, jacobian = Tool(nominal).poses(with_others(nominal, q[None]))
    return rates * min(1.0, jog.line / max(np.linalg.norm(jacobian[0, :3] @ rates), 1e-12))


def twist_of(jog: Jog, name: str, rng: np.random.Generator) -> np.ndarray:
    """Along and about one axis of a frame, or any direction."""
    directions = [np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else unit(rng) for _ in range(2)]
    line, turn = deflection(rng) * jog.line * directions[0], deflection(rng) * jog.turn * directions[1]
    return np.concatenate([line * (name != "rotation"), turn * (name != "translation")])


def unit(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def cartesian(
    nominal: NominalCell, twist: np.ndarray, in_tool: bool, start: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Joints (k, joints) at `times` of motion with a constant twist (6,) in base or tool, by a Runge-Kutta method."""
    tool = Tool(nominal)

    def rates(q: np.ndarray) -> np.ndarray:
        pose, jacobian = tool.poses(with_others(nominal, q[None]))
        turned = (pose[0, :3, :3] @ twist.reshape(2, 3).T).T.ravel() if in_tool else twist
        return tool.rates(jacobian, turned[None])[0]

    found, q, now = [], start, 0.0
    for time in times:
        steps = int(np.ceil((time - now) / _STEP - 1e-9))
        for _ in range(steps):
            h = (time - now) / steps
            a = rates(q)
            b = rates(q + h / 2 * a)
            c = rates(q + h / 2 * b)
            q = q + h / 6 * (a + 2 * b + 2 * c + rates(q + h * c))
        now = time
        found.append(q)
    return np.array(found)


def stopping_motion(rates: ArrayLike, reaction: float, deceleration: ArrayLike, times: ArrayLike) -> np.ndarray:
    """Travel (n, axes), rad, at `times` (n,) after the measured state, braking from `reaction` on; s, rad/s, rad/s²."""
    rates, times = np.asarray(rates, float), np.asarray(times, float)
    braking = braking_time(rates, deceleration)
    since = np.clip(times - reaction, 0.0, braking)
    lost = since**2 / (2 * braking) if braking > 0 else 0.0
    return np.asarray((np.minimum(times, reaction) + since - lost)[:, None] * rates)


def stopping_travel(rates: ArrayLike, reaction: float, deceleration: ArrayLike) -> np.ndarray:
    """Travel (axes,), rad, until axes of `rates` (axes,), rad/s, stand: reaction in s, deceleration in rad/s²."""
    return np.asarray(np.asarray(rates, float) * (reaction + braking_time(rates, deceleration) / 2))
