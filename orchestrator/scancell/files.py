"""Reading of files of unknown content, versions of formats, atomic writing, tables for files, names for files."""

from __future__ import annotations

import json
import re
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scancell.errors import DescriptionError, OutputError, ScancellError

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import NDArray

MAX_FILE_BYTES = 4 << 30  # of a file that a library reads by its name
MAX_TEXT_BYTES = 256 << 20  # of a text that is read at once

CAD_FORMATS = (".step", ".stp", ".iges", ".igs", ".brep", ".brp")  # see `scancell.geometry.cad`
_CAD_SOLIDS = re.compile(rf"(.+(?:{'|'.join(map(re.escape, CAD_FORMATS))}))#(.+)", re.IGNORECASE | re.DOTALL)

# Versions that are written, and the newest ones that are read: a version rises when earlier readers would misread it.
PLAN_VERSION = 1
RECORDING_VERSION = 1
MANIFEST_VERSION = 1


def split_solids(path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """File, and the solids of a CAD file that ``FILE#SOLID#SOLID`` names; none names all of them."""
    found = _CAD_SOLIDS.fullmatch(str(path))
    return (Path(found[1]), tuple(found[2].split("#"))) if found else (Path(path), ())


def require_file(path: str | Path, raises: type[ScancellError] = DescriptionError) -> Path:
    """The path of a regular file that is neither empty nor larger than `MAX_FILE_BYTES`.

    A device or a named pipe may never end, and a file of the kernel, whose size is 0, may never begin.

    Raises `raises` naming the file.
    """
    path = Path(path)
    if _regular_size(path, raises, MAX_FILE_BYTES) == 0:
        raise raises("the file is empty", file=path)
    return path


def read_file(
    path: str | Path, raises: type[ScancellError] = DescriptionError, most_bytes: int = MAX_TEXT_BYTES
) -> bytes:
    """Content of a regular file of at most `most_bytes`; raises `raises` naming the file."""
    path = Path(path)
    size = _regular_size(path, raises, most_bytes)
    if size == 0:
        return b""
    try:
        with path.open("rb") as stream:
            return stream.read(size)
    except OSError as error:
        raise raises(f"cannot be read: {error.strerror}", file=path) from None


def read_text(path: str | Path, raises: type[ScancellError] = DescriptionError) -> str:
    """Text of a regular file in UTF-8 of limited size; raises `raises` naming the file."""
    try:
        return read_file(path, raises).decode("utf-8")
    except UnicodeDecodeError as error:
        raise raises(f"is not text in UTF-8: {error}", file=path) from None


def read_json(path: str | Path) -> Any:
    """Content of a regular JSON file of limited size and depth; raises `DescriptionError` naming the file."""
    text = read_text(path)
    try:
        return json.loads(text)
    except ValueError as error:
        raise DescriptionError(f"cannot be read as JSON: {error}", file=path) from None
    except (RecursionError, MemoryError):
        raise DescriptionError("cannot be read as JSON: it is nested too deeply, or too large", file=path) from None


def require_format_version(version: Any, newest: int, path: str | Path) -> None:
    """Refuse a file whose `format_version` is not known; None: it has none, because it is older than the key.

    Raises `DescriptionError` naming the file.
    """
    if version is None:
        return
    if type(version) is not int or version < 1:
        raise DescriptionError(
            file=path, key="format_version", value=version, expected=f"an integer from 1 to {newest}"
        )
    if version > newest:
        raise DescriptionError(
            f"is of a newer version of scancell, this one reads up to {newest}: update scancell",
            file=path,
            key="format_version",
            value=version,
        )


def _regular_size(path: Path, raises: type[ScancellError], most_bytes: int) -> int:
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):  # the last one: a zero byte in the name
        raise raises("no such file", file=path) from None
    except OSError as error:
        raise raises(f"cannot be read: {error.strerror}", file=path) from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device, a pipe or a socket"
        raise raises(f"is {kind}", file=path, expected="a regular file")
    if status.st_size > most_bytes:
        size, most = (f"{number / 1e6:.0f} MB" for number in (status.st_size, most_bytes))
        raise raises(f"the file has {size}", file=path, expected=f"at most {most}")
    return status.st_size


def file_state(path: Path) -> tuple[str, int, int]:
    """Path, size and time of modification (ns) of a file, which a change of it changes; zeros if there is none."""
    try:
        status = split_solids(path)[0].stat()
    except OSError:
        return str(path.absolute()), 0, 0
    return str(path.absolute()), status.st_size, status.st_mtime_ns


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
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
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


def name_for_file(text: str) -> str:
    """File name made from text: other characters than letters, digits and ``_.+-`` become ``-``; may be empty."""
    return re.sub(r"[^\w.+-]+", "-", text).strip(".-")


def first_free(folder: Path, pattern: str) -> Path:
    """The first of the paths of a pattern, ``scan_{}``, with 1, 2, ... that does not exist."""
    return next(path for number in count(1) if not (path := folder / pattern.format(number)).exists())
