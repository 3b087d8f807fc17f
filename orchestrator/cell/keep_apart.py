"""Which bodies of the cell must not touch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orchestrator.cell.nominal import NominalCell
from orchestrator.geometry.mesh import Mesh
from orchestrator.proximity.pairs import always_touching, cell_pairs
from orchestrator.proximity.scene import ProximityScene

_ON_ARM = ("link", "sensor", "finger")


def arm_chain(nominal: NominalCell) -> list[str]:
    """Names of the arm's bodies, base first, tools last."""
    return [b.name for b in nominal.bodies if b.name == "base" or b.moves_with.startswith(_ON_ARM)]


def keep_apart(nominal: NominalCell, meshes: Mapping[str, Mesh]) -> ProximityScene:
    """Pairs of bodies that a motion must keep apart, without those that intersect whatever the arm does.

    Parameters
    ----------
    meshes
        Name of each of the cell's bodies → mesh in the body's frame, metres.
    """
    chain = arm_chain(nominal)
    around = [body.name for body in nominal.bodies if body.name not in chain]
    everything = ProximityScene({body.name: meshes[body.name] for body in nominal.bodies}, cell_pairs(chain, around))
    lower, upper = nominal.arm.limits
    q = np.random.default_rng(0).uniform(lower, upper, (100, len(lower)))
    touching = always_touching(everything, nominal.body_poses(q, np.zeros(len(q))))
    return everything.without(touching) if touching else everything
