"""How long work tells how far it is."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self


class Progress(Protocol):
    """Hears of stages and of steps done in them."""

    def stage(self, name: str, total: float, unit: str) -> None:
        """A stage begins that takes `total` steps of `unit`."""

    def advance(self, steps: float) -> None:
        """`steps` more are done."""


class Silent:
    """Tells nobody."""

    def stage(self, name: str, total: float, unit: str) -> None:
        """Begin a stage."""

    def advance(self, steps: float) -> None:
        """Go on."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End."""
