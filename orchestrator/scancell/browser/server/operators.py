"""Selection of the browser that controls the cell."""

from __future__ import annotations

from threading import Lock


class Operators:
    """The open browsers, by the numbers of their connections; one of them is the operator.

    The first one is the operator. Another one becomes the operator on request, or when it connects after the operator
    has left. All methods are thread-safe.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._present: set[int] = set()
        self._operator: int | None = None

    @property
    def operator(self) -> int | None:
        """The browser in control; None after it has left."""
        return self._operator

    def join(self, client: int) -> None:
        """Add a browser."""
        with self._lock:
            self._present.add(client)
            if self._operator is None:
                self._operator = client

    def leave(self, client: int) -> None:
        """Remove a browser."""
        with self._lock:
            self._present.discard(client)
            if self._operator == client:
                self._operator = None

    def take(self, client: int) -> None:
        """Make a browser the operator."""
        with self._lock:
            if client in self._present:
                self._operator = client
