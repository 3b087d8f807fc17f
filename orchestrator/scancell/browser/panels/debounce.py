"""Debounce of inputs."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic


class Debounce:
    """Reports a change of a value after the value has not changed for `delay` seconds."""

    def __init__(self, clock: Callable[[], float] = monotonic, delay: float = 0.2) -> None:
        self._clock, self._delay = clock, delay
        self._changed: float | None = None

    @property
    def is_pending(self) -> bool:
        """Whether a change is pending."""
        return self._changed is not None

    def change(self) -> None:
        """Note that the value changes now."""
        self._changed = self._clock()

    def take(self) -> bool:
        """Whether a change is due; clears it if so."""
        if self._changed is None or self._clock() - self._changed < self._delay:
            return False
        self._changed = None
        return True
