"""Trigger records for tests of reconstruction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Triggers:
    """Records of n exposures, see `scancell.reconstruction.reconstruct.Triggers`."""

    index: np.ndarray
    segment: np.ndarray
    time: np.ndarray
    q: np.ndarray
    table: np.ndarray
    qd: np.ndarray
    table_rate: np.ndarray
