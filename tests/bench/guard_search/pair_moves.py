"""Moves whose first contact is that of a given pair of bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scancell.cell.controller import Mode, Operation
from scancell.studies.guard.scenario import Command, Scenario
from scancell.studies.guard.simulation import Simulation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_STARTS = 100  # random axes from which a contact is looked for
_DESCENTS = 60  # steps towards it
_STEP = 0.1  # rad, at most
_DIFFERENCE = 1e-4  # rad
_FROM = 24  # starts of a move that are tried for a contact
_LENGTH = 0.8  # rad, of a move
_DEEPER = 0.1  # rad by which it goes further
_SAMPLES = 200  # of a move
_APART = 0.01  # m: other pairs stay apart
_FREE = 0.015  # m: clearance of all pairs at the start
_BEGIN = 0.1  # s


class PairMoves:
    """Finds moves in joints.

    Parameters
    ----------
    simulation
        The cell.
    seed
        Of the random axes.
    """

    def __init__(self, simulation: Simulation, seed: int) -> None:
        self._simulation, self._seed = simulation, seed
        lower, upper = simulation.nominal.arm.limits
        self._lower, self._upper = np.append(lower, -np.pi), np.append(upper, np.pi)
        held = [joint.index for joint in simulation.nominal.arm.held]
        self._free = np.setdiff1d(np.arange(len(self._lower)), held)

    def moves(self, pair: Flags, duration: float) -> Iterator[Scenario]:
        """Moves into contacts of a `pair` (pairs,), and of no other; none, if none is found."""
        rng = np.random.default_rng([self._seed, int(np.argmax(pair))])
        for _ in range(_STARTS):
            contact = self._contact(pair, rng)
            if contact is not None and (start := self._start(*contact, pair, rng)) is not None:
                end = contact[0] + _DEEPER * (contact[0] - start) / np.linalg.norm(contact[0] - start)
                end = np.clip(end, self._lower, self._upper)
                yield Scenario(Operation.AUTOMATIC, start, (Command(_BEGIN, Mode.JOINT_MOVE, end),), duration)

    def _contact(self, pair: Flags, rng: np.random.Generator) -> tuple[Array, Array] | None:
        """Axes at which a pair is in contact, and the direction in which it approaches there."""
        nominal = self._simulation.nominal
        axes = np.append(nominal.home, 0.0)
        axes[self._free] = rng.uniform(self._lower, self._upper)[self._free]
        steps = _DIFFERENCE * np.eye(len(axes))[self._free]
        down = np.zeros_like(axes)
        for _ in range(_DESCENTS):
            found = self._simulation.distances_of(pair, np.vstack([axes, axes + steps]))
            if found[0] == 0.0:
                return (axes, down) if down.any() else None
            slope = (found[1:] - found[0]) / _DIFFERENCE
            size = float(np.linalg.norm(slope))
            if size < 1e-3:
                return None
            down = np.zeros_like(axes)
            down[self._free] = -slope / size
            stepped = np.clip(axes + min(_STEP, 1.01 * found[0] / size + 1e-3) * down, self._lower, self._upper)
            if np.abs(stepped - axes).max() < 1e-4:
                return None
            axes = stepped
        return None

    def _start(self, contact: Array, down: Array, pair: Flags, rng: np.random.Generator) -> Array | None:
        """Axes from which a straight move to `contact` meets nothing else."""
        for spread in np.linspace(0.0, 1.0, _FROM):
            way = down.copy()
            way[self._free] += spread * rng.normal(size=len(self._free)) / np.sqrt(len(self._free))
            start = contact - _LENGTH * way / np.linalg.norm(way)
            if (start < self._lower).any() or (start > self._upper).any():
                continue
            axes = np.linspace(start, contact, _SAMPLES)
            bound = np.where(pair, _FREE, _APART)
            near = self._simulation.clearances(axes, bound)
            if (near[:, ~pair] >= _APART).all() and (near[0] >= bound).all():
                return start
        return None
