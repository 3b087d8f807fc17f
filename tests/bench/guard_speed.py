"""Processor time of the guard's answers: ``PYTHONPATH=tests python -m bench.guard_speed [--answers N] [--seed S]``.

Seeded random jogs, predicted by the controller or not, and random paths, half of them from starts near obstacles, with
all shipped arms.  States are 32 ms apart and measured with noise; the robot obeys the answers, as in a run.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import count, cycle, islice

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from guard_motions import CELLS, KINDS, NOISE, POLL, cell_of, random_motion, random_start, stopping_motion
from scancell.cell.driver import Mode, Operation
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry.mesh import reduced
from scancell.guard.check import RATE_SLOPE
from scancell.guard.guard import Guard
from scancell.guard.messages import MAX_AHEAD, CellState, GuardMessage
from scancell.guard.stopping import braking_time
from scancell.nominal.cell import NominalCell
from scancell.proximity.scene import arm_chain, cell_scene

from .table import Row, cpu_model

Array = NDArray[np.float64]

ANSWERS = 6000  # of each kind of operation
MEDIAN_LIMIT_MS, LAST_LIMIT_MS = 2.0, 8.0
_OF_TABLE = 3000  # answers in `make bench`
_SHARES = (50.0, 90.0, 99.0, 99.9, 100.0)
_POLLS = 12  # of a jog
_CYCLE = POLL / 2
_SLOPE = 3.2  # 1/s: change of the speed of a predicted jog
_AHEAD = 32  # points of the path
_NEAR = (0.002, 0.06)  # m: least distance at a start near an obstacle
_CLEAR = 0.002  # m: that of links to each other
_TRIED = 64  # starts at a time


class _Session:
    """The guard of one cell, timed."""

    def __init__(self, arm: str, rng: np.random.Generator) -> None:
        self.arm, self.rng = arm, rng
        self.nominal, _ = cell_of(arm)
        robot = load_setup(assets_dir() / "cells" / f"{CELLS[arm]}.toml").cell.robot
        self._guard = Guard(self.nominal, robot)
        self.deceleration = np.append(self.nominal.arm.max_acceleration, self.nominal.table_max_acceleration)
        self._starts = _starts(self.nominal, rng)
        self._sequence = count()

    def start(self) -> Array:
        """Axes (joints + 1,), rad: near an obstacle every second time."""
        return next(self._starts)

    def reset(self) -> None:
        """A motion begins."""
        self._guard.reset()

    def answer(
        self,
        operation: Operation,
        poll: int,
        axes: Array,
        ahead: Array | tuple[()] = (),
        rate: float = 1.0,
        spacing: float = POLL,
    ) -> tuple[GuardMessage, float]:
        """The answer to a state measured with noise, and the processor time that it took, s."""
        measured = axes + NOISE * self.rng.standard_normal(axes.shape)
        mode = Mode.CARTESIAN_JOG if operation is Operation.MANUAL else Mode.JOINT_MOVE
        spacing = spacing if len(ahead) else 0.0
        state = CellState(
            next(self._sequence), poll * POLL, operation, mode, True, measured, rate, ahead, spacing, limits_jogs=True
        )
        began = time.process_time()
        message = self._guard.answer(state)
        return message, time.process_time() - began


def _starts(nominal: NominalCell, rng: np.random.Generator) -> Iterator[Array]:
    scene = cell_scene(nominal, {body.name: reduced(body.mesh, 400, 1e-3).mesh for body in nominal.bodies})
    chain = set(arm_chain(nominal))
    inner = np.array([a in chain and b in chain for a, b in scene.pairs])
    near: list[Array] = []
    anywhere: list[Array] = []
    while True:
        while not near or not anywhere:
            axes = np.array([random_start(nominal, rng) for _ in range(_TRIED)])
            distance = scene.distances(nominal.body_poses(axes), 2 * _NEAR[1], 1)
            least, clear = distance[:, ~inner].min(1), distance[:, inner].min(1) > _CLEAR
            near += list(axes[clear & (least > _NEAR[0]) & (least < _NEAR[1])])
            anywhere += list(axes[clear & (least > _NEAR[0])])
        yield near.pop()
        yield anywhere.pop()


def manual_times(session: _Session) -> Iterator[float]:
    """Processor times, s, of the answers to random jogs, but for the first one of each, which knows no motion."""
    times = POLL * np.arange(_POLLS)
    for name in cycle(KINDS):
        axes = random_motion(session.arm, name, session.rng, times, session.start()).axes
        if not np.isfinite(axes).all() or not session.nominal.arm.within_limits(axes[:, :-1]).all():
            continue
        session.reset()
        poll = 0
        while poll < len(axes):
            message, took = session.answer(Operation.MANUAL, poll, axes[poll])
            poll += 1
            if poll > 1:
                yield took
            if poll > 1 and message.emergency_stop and len(axes) == _POLLS:  # the jog brakes one poll later
                rates = (axes[poll - 1] - axes[poll - 2]) / POLL
                braking = braking_time(rates, session.deceleration)
                braked = stopping_motion(rates, POLL, session.deceleration, np.arange(POLL, POLL + braking, POLL))
                axes = np.vstack([axes[:poll], axes[poll - 1] + braked])


def predicted_times(session: _Session) -> Iterator[float]:
    """Processor times, s, of the answers to random jogs that begin at rest and follow the permitted speed."""
    shown = _CYCLE * np.arange(1, MAX_AHEAD + 1)
    clocks = _CYCLE * np.arange(2 * _POLLS + MAX_AHEAD + 1)
    for name in cycle(KINDS[1:]):
        path = random_motion(session.arm, name, session.rng, clocks, session.start()).axes
        if not np.isfinite(path).all() or not session.nominal.arm.within_limits(path[:, :-1]).all():
            continue
        course = CubicSpline(clocks, path)
        session.reset()
        clock = rate = 0.0
        for poll in range(_POLLS):
            ahead = course(clock + shown)
            message, took = session.answer(Operation.MANUAL, poll, course(clock), ahead, rate, _CYCLE)
            yield took
            if message.emergency_stop:
                break
            rate += float(np.clip(message.monitor_speed - rate, -_SLOPE * POLL, _SLOPE * POLL))
            clock += rate * POLL


def automatic_times(session: _Session) -> Iterator[float]:
    """Processor times, s, of the answers on random joint-interpolated paths, which are slowed down as answered."""
    while True:
        start, rng = session.start(), session.rng
        end = start + rng.choice([0.3, 1.0, 3.0]) * rng.uniform(-1.0, 1.0, len(start))
        end[:-1] = np.clip(end[:-1], *session.nominal.arm.limits)
        yield from _along(session, start, end - start)


def _along(session: _Session, start: Array, travel: Array) -> Iterator[float]:
    nominal = session.nominal
    speed = np.append(nominal.arm.max_speed, nominal.table_max_speed)
    # Cosine profile: largest speed pi / 2 and largest acceleration pi² / 2 times travel over duration (squared).
    needed = np.pi / 2 * np.abs(travel) / speed, np.pi * np.sqrt(np.abs(travel) / session.deceleration / 2)
    duration = float(np.max(needed)) / session.rng.uniform(0.1, 1.0)

    def path(clock: Array) -> Array:
        share = (1.0 - np.cos(np.pi * np.clip(clock / duration, 0.0, 1.0))) / 2
        return np.asarray(start + share[..., None] * travel)

    session.reset()
    clock, rate, waits = 0.0, 1.0, 0
    for poll in count():
        ahead = path(clock + POLL * np.arange(1, _AHEAD + 1))
        message, took = session.answer(Operation.AUTOMATIC, poll, path(np.array(clock)), ahead, rate)
        yield took
        waits += rate == 0.0
        if message.emergency_stop or clock >= duration or waits > 2:
            return
        rate += float(np.clip(message.monitor_speed - rate, -RATE_SLOPE * POLL, RATE_SLOPE * POLL))
        clock += rate * POLL


def answer_times(arm: str, answers: int, seed: int) -> dict[str, Array]:
    """Processor times of answers, ms, by operation."""
    drawn = {"manual": manual_times, "predicted": predicted_times, "automatic": automatic_times}
    found = {}
    for number, (name, times) in enumerate(drawn.items()):
        session = _Session(arm, np.random.default_rng([seed, number]))
        next(times(session))  # what the first call loads
        found[name] = 1e3 * np.fromiter(islice(times(session), answers), float)
    return found


def guard_rows() -> Iterator[Row]:
    """Median and 99.9 % of the processor time of an answer, all arms together."""
    found = [answer_times(arm, _OF_TABLE // len(CELLS), 1) for arm in CELLS]
    for name in found[0]:
        times = np.concatenate([each[name] for each in found])
        for share, limit in ((50.0, MEDIAN_LIMIT_MS), (99.9, LAST_LIMIT_MS)):
            value = float(np.percentile(times, share))
            what = f"guard: answer, {name}, {share:g} %"
            yield Row(what, value, "ms", "limit, 1 thread", limit, wanted="at most", clock="processor")


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(prog="python -m bench.guard_speed", description=__doc__)
    parser.add_argument("--answers", type=int, default=ANSWERS, help="of each kind of operation, all arms together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--arm", choices=list(CELLS), help="this one only")
    options = parser.parse_args()
    print(f"CPU: {cpu_model()}; processor time of an answer in ms")
    print(f"{'':<26}{'answers':>8}{'median':>8}{'90 %':>8}{'99 %':>8}{'99.9 %':>8}{'max':>8}{'over 8':>8}")
    arms = [options.arm] if options.arm else list(CELLS)
    found = {arm: answer_times(arm, options.answers // len(arms), options.seed) for arm in arms}
    for name in ("manual", "predicted", "automatic"):
        each = {f"{name}, {arm}": times[name] for arm, times in found.items()}
        for label, times in (*each.items(), (f"{name}, all", np.concatenate(list(each.values())))):
            shares = "".join(f"{value:8.2f}" for value in np.percentile(times, _SHARES))
            print(f"{label:<26}{len(times):>8}{shares}{(times > LAST_LIMIT_MS).sum():>8}")


if __name__ == "__main__":
    main()
