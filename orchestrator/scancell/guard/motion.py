"""Measured states of a robot, and hypotheses of its motion in manual operation."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MeasuredState:
    """Measured joints (joints,) and table angle, rad, at `time` (s) by the controller's clock."""

    time: float
    joints: Array
    table: float

    @property
    def axes(self) -> Array:
        """Joints and table angle, (axes,), rad."""
        return np.append(self.joints, self.table)


class Path(Enum):
    """How a motion by hand continues."""

    JOINT = "joint-interpolated"  # the rates of the joints stay (Eq. 9)
    BASE = "Cartesian in the base frame"  # the tool's velocity and angular velocity in the base frame stay (Eq. 10)
    TOOL = "Cartesian in the tool frame"  # those in the tool's own frame stay: its origin follows a helix


class Kind(Enum):
    """The simplest kind of motion that is consistent with measured states.

    One of several joints cannot be distinguished from one that combines translation and rotation in a few states: both
    are `COMBINED`.
    """

    REST = "at rest"
    TABLE = "table"
    SINGLE_JOINT = "single joint"
    TRANSLATION = "translation"
    ROTATION = "rotation"
    COMBINED = "combined"


@dataclass(frozen=True)
class Hypothesis:
    """A motion by hand that is possible from the last measured state on.

    Attributes
    ----------
    path
        How it continues.
    state
        Last measured state.
    rates
        Of joints and table, (axes,), rad/s.
    rate_error
        Bound on the error of each rate, (axes,), rad/s.
    rate_age
        Time from which the rates are, before that of the state, s.
    """

    path: Path
    state: MeasuredState
    rates: Array
    rate_error: Array
    rate_age: float


@dataclass(frozen=True)
class Identification:
    """The simplest motion that is consistent with the measured states, and all possible ones."""

    kind: Kind
    hypotheses: tuple[Hypothesis, ...]
