"""Columns of points that are kept in a file instead of memory while a scan grows."""

from __future__ import annotations

import tempfile
from dataclasses import fields
from typing import IO, Any, Generic, TypeVar

import numpy as np

from scancell.errors import OutputError

T = TypeVar("T")


class StoredColumns(Generic[T]):
    """Joins dataclasses of arrays, whose rows are points, in temporary files that vanish with the arrays.

    Parameters
    ----------
    kind
        The dataclass.
    """

    def __init__(self, kind: type[T]) -> None:
        self._kind = kind
        self._files: dict[str, IO[bytes]] = {}
        self._shapes: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}

    def append(self, part: T) -> None:
        """Append rows.

        Raises
        ------
        OutputError
            If they cannot be written.
        """
        try:
            self._append(part)
        except OSError as error:
            raise OutputError(
                f"points of the scan cannot be stored: {error.strerror or error}", file=tempfile.gettempdir()
            ) from error

    def _append(self, part: T) -> None:
        for field in fields(self._kind):  # type: ignore[arg-type]
            values = np.ascontiguousarray(getattr(part, field.name))
            if field.name not in self._files:
                self._files[field.name] = tempfile.TemporaryFile(prefix="scancell-")  # noqa: SIM115
                self._shapes[field.name] = values.dtype, values.shape[1:]
            self._files[field.name].write(values.data)

    def joined(self) -> T:
        """All rows, read from the files where they are used; nothing may be appended afterwards."""
        return self._kind(**{name: self._column(name) for name in self._files})

    def _column(self, name: str) -> np.ndarray[Any, Any]:
        file, (dtype, shape) = self._files[name], self._shapes[name]
        file.flush()
        size = dtype.itemsize * int(np.prod(shape))
        rows = file.tell() // size
        if rows == 0:  # nothing to map
            return np.zeros((0, *shape), dtype)
        # Private: what is changed is not written.
        return np.asarray(np.memmap(file, dtype, "c", shape=(rows, *shape)))
