"""Atomic writing of files, tables for them, and names for files."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from scancell.errors import OutputError

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import NDArray


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Context manager: yields a temporary path in the folder of `path`, renamed to `path` when the block succeeds.

    Missing folders are created. The temporary name keeps the suffix, from which many writers choose the format. If the
    block raises (keyboard interrupts included), the temporary file is removed and an older file at `path` remains.

    Raises `OutputError` if the file cannot be written.
    """
    path = Path(path)
    if not path.name:
        raise OutputError(file=path, expected="the name of a file")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
    finally:
        with suppress(OSError):  # the folder may not exist
            temporary.unlink(missing_ok=True)


def arrow_table(columns: Mapping[str, NDArray[Any]]) -> pa.Table:
    """Table of columns (n,) of numbers.

    `pa.array` imports pandas where it is installed, which takes 0.4 s; the buffers of the arrays hold the same values.
    """
    import numpy as np  # noqa: PLC0415  (the command line's help needs neither)
    import pyarrow as pa  # noqa: PLC0415

    def column(values: NDArray[Any]) -> pa.Array:
        buffer = pa.py_buffer(np.ascontiguousarray(values))
        return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [None, buffer])

    return pa.table({name: column(values) for name, values in columns.items()})


def png_bytes(write: Callable[[Path], object]) -> bytes:
    """The picture (PNG) that `write` writes into the file of the path that it receives."""
    with TemporaryDirectory(prefix="scancell-") as folder:
        path = Path(folder) / "picture.png"
        write(path)
        return path.read_bytes()


def name_for_file(text: str) -> str:
    """File name made from text: other characters than letters, digits and ``_.+-`` become ``-``; may be empty."""
    return re.sub(r"[^\w.+-]+", "-", text).strip(".-")


def first_free(folder: Path, pattern: str) -> Path:
    """The first of the paths of a pattern, ``scan_{}``, with 1, 2, ... that does not exist."""
    return next(path for number in count(1) if not (path := folder / pattern.format(number)).exists())
