"""Log of variables of a running cell at every communication step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.cell.instance import CellInstance

Array = NDArray[np.float64]


class SignalLog:
    """Values of variables from now on, at every communication step.

    Parameters
    ----------
    cell
        Running instance (`CellSession.cell`).
    reals
        Names of real variables.
    booleans
        Names of Boolean variables, which count 0 and 1.

    Raises
    ------
    CellError
        If the cell has no such variable.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     log = scancell.SignalLog(session.cell, ["measured.table"], ["controller.moving"])
    ...     session.turn_table(0.5)
    >>> log["measured.table"][[0, -1]].round(3)
    array([0. , 0.5])
    >>> bool(np.all(np.diff(log["measured.table"]) >= 0)), int(log["controller.moving"].max())
    (True, 1)
    """

    @checked_arguments
    def __init__(self, cell: CellInstance, reals: Sequence[str], booleans: Sequence[str] = ()) -> None:
        self._cell = cell
        self._reals, self._booleans = tuple(reals), tuple(booleans)
        self._group = cell.real_group(self._reals)
        self._rows: list[Array] = []
        self._listen()
        cell.on_step(self._listen)

    def _listen(self) -> None:
        seen = [float(self._cell.get_boolean(name)) for name in self._booleans]
        self._rows.append(np.concatenate([[self._cell.time_us * 1e-6], self._cell.get(self._group), seen]))

    @property
    def time(self) -> Array:
        """Instants (n,) in s, the present one at the beginning first."""
        return np.array([row[0] for row in self._rows])

    def __getitem__(self, name: str) -> Array:
        """Values (n,) of the variable `name` at the instants of `time`, SI; `KeyError` where it is not logged."""
        names = (*self._reals, *self._booleans)
        if name not in names:
            raise KeyError(name)
        column = 1 + names.index(name)
        return np.array([row[column] for row in self._rows])
