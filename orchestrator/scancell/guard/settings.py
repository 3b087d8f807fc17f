"""Assumptions of the guard about robot, controller and network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from scancell.arguments import Length, Threads, Within, checked_fields

_Positive = Length
_NotNegative = Annotated[float, Within(0.0)]


@checked_fields
@dataclass(frozen=True)
class GuardSettings:
    """Worst case for which stops are proved.

    Attributes
    ----------
    max_age
        Age of the last answer's state at which the controller stops by itself, s. A longer one bears more loss of
        packets, and keeps the robot farther from everything.
    cycle
        Cycle of the controller, s: it notices the age, and brakes, one cycle late each.
    noise
        Standard deviation of the measured angles, rad.
    angle_error
        Largest error of the measured angles, rad, one or (axes,): of the encoders, and of the gears behind them.
    latency
        Largest age of measured angles when the controller stamps them, s.
    position_error
        Largest deviation of a body from its nominal position, m: two bodies may be nearer by twice as much.
    mesh_error
        Largest error of the simplified meshes that the guard compares, m: it adds to the distance to be kept.
    deceleration
        Share of the axes' accelerations that braking attains.
    horizon
        Time for which a motion by hand is predicted for warnings, s.
    threads
        Threads of the checks of motions before they begin; 0 uses all cores. An answer takes one.

    Raises
    ------
    DescriptionError
        If a value is negative, or 0 where there is no such worst case.

    Examples
    --------
    >>> settings = scancell.GuardSettings(max_age=0.2, position_error=0.002)
    >>> print(f"{settings.reaction:.3f} s")
    0.232 s
    >>> guard = scancell.guard_of(part="part.stl", settings=settings)
    """

    max_age: _Positive = 0.12
    cycle: _Positive = 0.016
    noise: _Positive = float(np.radians(0.005))
    angle_error: _NotNegative | tuple[_NotNegative, ...] = float(np.radians(0.025))
    latency: _NotNegative = 0.0
    position_error: _NotNegative = 1e-3
    mesh_error: _NotNegative = 0.2e-3
    deceleration: _Positive = 0.95
    horizon: _Positive = 1.0
    threads: Threads = 1

    @property
    def reaction(self) -> float:
        """Time from a measured state to the beginning of braking, if no later answer arrives, s."""
        return self.latency + self.max_age + 2 * self.cycle
