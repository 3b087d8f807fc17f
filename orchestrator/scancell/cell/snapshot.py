"""The present poses of a running cell as a recording of one exposure, for a profile or images at any time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.cell.instance import CellInstance
from scancell.cell.recording import INTEGER_COLUMNS, Recording, RecordLayout

_OF_EXPOSURE = ("trigger.time", "trigger.exposure")
_RECORD = "trigger."
# Beyond every trigger index, which are 32 bits wide: the index seeds the noise of an image.
_FIRST_INDEX = 1 << 31


def snapshot(cell: CellInstance, exposure: float, number: int = 0) -> Recording:
    """One row: axes, poses and twists at the present instant, as of an exposure whose middle is now.

    The cell is not stepped, and its trigger records are not touched; as-built latency and jitter of the trigger do not
    apply.

    Parameters
    ----------
    exposure
        Duration of the exposure, s.
    number
        Number of the snapshot, from 0; another number gives other image noise.
    """
    layout = RecordLayout.of(cell.names)
    latched = (*layout.measured, *layout.truth)
    present = [name for name in latched if name not in _OF_EXPOSURE]
    values = cell.get(cell.real_group([name.removeprefix(_RECORD) for name in present]))
    columns: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
        name: np.array([index], np.int64)
        for name, index in zip(INTEGER_COLUMNS, (_FIRST_INDEX + number, 0), strict=True)
    }
    columns |= {"trigger.time": np.array([cell.time_us * 1e-6]), "trigger.exposure": np.array([exposure])}
    columns |= {name: np.array([value]) for name, value in zip(present, values, strict=True)}
    return Recording(columns)
