"""Moves whose first contact is that of a given pair of bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scancell.studies.guard.draws import Draws
from scancell.studies.guard.scenario import Kind, Motion, Scenario
from scancell.studies.guard.simulation import Simulation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_STARTS = 100  # random axes from which a contact is looked for
_FROM = 24  # starts of a move that are tried for a contact
_LENGTH = 0.8  # rad and m, of a move
_DEEPER = 0.1  # rad and m by which it goes further
_SAMPLES = 200  # of a move
_APART = 0.01  # m: other pairs stay apart
_FREE = 0.015  # m: clearance of all pairs at the start


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
        self._world, self._seed = simulation.world, seed
        self._draws = Draws(simulation.world, simulation.cycle)
        nominal = self._world.nominal
        (lower, upper), further = nominal.arm.limits, nominal.further_axes
        self._lower = np.array([*lower, -np.pi, *(axis.min for axis in further)])
        self._upper = np.array([*upper, np.pi, *(axis.max for axis in further)])
        held = [joint.index for joint in self._world.nominal.arm.held]
        self._free = np.setdiff1d(np.arange(len(self._lower)), held)

    def moves(self, pair: Flags, duration: float) -> Iterator[Scenario]:
        """Moves into contacts of a `pair` (pairs,), and of no other; none, if none is found."""
        number = int(np.argmax(pair))
        rng = np.random.default_rng([self._seed, number])
        nominal = self._world.nominal
        for _ in range(_STARTS):
            axes = nominal.start
            axes[self._free] = rng.uniform(self._lower, self._upper)[self._free]
            contact = self._draws.contact(nominal, self._world.scene, axes, number)
            if contact is not None and (start := self._start(*contact, pair, rng)) is not None:
                end = contact[0] + _DEEPER * (contact[0] - start) / np.linalg.norm(contact[0] - start)
                by = np.clip(end, self._lower, self._upper) - start
                yield Scenario(start, (Motion(Kind.JOINT_MOVE, by, 1.0, length=_LENGTH),), duration)

    def _start(self, contact: Array, down: Array, pair: Flags, rng: np.random.Generator) -> Array | None:
        """Axes from which a straight move to `contact` meets nothing else."""
        for spread in np.linspace(0.0, 1.0, _FROM):
            way = down / np.linalg.norm(down)
            way[self._free] += spread * rng.normal(size=len(self._free)) / np.sqrt(len(self._free))
            start = contact - _LENGTH * way / np.linalg.norm(way)
            if (start < self._lower).any() or (start > self._upper).any():
                continue
            axes = np.linspace(start, contact, _SAMPLES)
            bound = np.where(pair, _FREE, _APART)
            near = self._world.scene.distances(self._world.nominal.body_poses(axes), bound, 1)
            if (near[:, ~pair] >= _APART).all() and (near[0] >= bound).all():
                return np.asarray(start)
        return None
