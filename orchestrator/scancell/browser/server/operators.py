"""Which of several browsers controls the cell."""

from __future__ import annotations

from threading import Lock


class Operators:
    """The browsers that are open, by the numbers of their connections; one of them is the operator.

    The first to come is the operator; another one takes control when it asks for it, or when it comes after the
    operator left. Any thread may call.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._present: set[int] = set()
        self._operator: int | None = None

    @property
    def operator(self) -> int | None:
        """The one in control; None where it has left."""
        return self._operator

    def join(self, client: int) -> None:
        """A browser has come."""
        with self._lock:
            self._present.add(client)
            if self._operator is None:
                self._operator = client

    def leave(self, client: int) -> None:
        """A browser has gone."""
        with self._lock:
            self._present.discard(client)
            if self._operator == client:
                self._operator = None

    def take(self, client: int) -> None:
        """A browser takes control."""
        with self._lock:
            if client in self._present:
                self._operator = client
