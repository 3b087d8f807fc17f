"""True contacts of a running cell."""

from __future__ import annotations

from collections.abc import Sequence

from scancell.cell.instance import CellInstance

_OUTPUTS = ("truth.collision.pairs", "truth.collision.body_a", "truth.collision.body_b")


class ContactWatch:
    """Notes the pairs of bodies that come into contact, from now on until `end`.

    Parameters
    ----------
    bodies
        Names of the cell's bodies, in the order of its description for the FMU.

    Attributes
    ----------
    pairs
        ``a - b`` in the order of their first contact; of several contacts at once, the deepest.
    end
        Ends the watch.
    """

    def __init__(self, cell: CellInstance, bodies: Sequence[str]) -> None:
        self._cell, self._bodies = cell, bodies
        self.pairs: list[str] = []
        self.end = cell.on_step(self._look)

    def _look(self) -> None:
        pairs, first, second = self._cell.get_integers(_OUTPUTS)
        if pairs == 0:
            return
        pair = f"{self._bodies[first - 1]} - {self._bodies[second - 1]}"
        if pair not in self.pairs:
            self.pairs.append(pair)
