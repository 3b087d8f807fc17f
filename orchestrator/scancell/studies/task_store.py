"""Results of named tasks on disk, each written atomically with the digest of its request.

A task's files are written to a hidden folder, which is then renamed. Nothing is flushed to the disk (fsync): by the
checksums in `DONE` a result that a power failure has damaged is detected.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import socket
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from scancell.errors import DescriptionError, OutputError
from scancell.files import read_json
from scancell.output.manifest import sha256

DONE = "done.json"
_PARTIAL = ".partial"
_HOST = socket.gethostname().replace(".", "-")
# Errors of a full or write-protected disk, which are no failure of the task.
_DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO})


def digest_of(*content: Any) -> str:
    """SHA-256 of plain data; the order of keys does not matter."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def disk_error(error: BaseException | None) -> OSError | None:
    """The disk error that `error` is or was caused by."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _DISK_ERRORS:
            return error
        error = error.__cause__ or error.__context__
    return None


class TaskStore:
    """A folder with one folder of files per finished task."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, name: str) -> Path:
        """Folder with the files of a finished task."""
        return self._folder / name

    def holds(self, name: str, digest: str) -> bool:
        """Whether the task `name` is finished for the request `digest`, with every file as it was written."""
        folder = self.path(name)
        try:
            done = read_json(folder / DONE)
            return bool(
                done["digest"] == digest
                and all(sha256(folder / file) == checksum for file, checksum in done["files"].items())
            )
        except (OSError, DescriptionError, KeyError, TypeError, AttributeError):
            return False

    @contextmanager
    def publish(self, name: str, digest: str) -> Iterator[Path]:
        """Yield an empty folder to write into; it becomes the task's if the block ends without an error.

        If another process has published the same result meanwhile, that one stays and this one is dropped.

        Raises
        ------
        OutputError
            If the disk is full or the folder cannot be written; nothing of the task is left behind.
        """
        partial = self._partial(name)
        try:
            partial.mkdir(parents=True)
            yield partial
            files = sorted(file for file in partial.rglob("*") if file.is_file())
            checksums = {str(file.relative_to(partial)): sha256(file) for file in files}
            (partial / DONE).write_text(json.dumps({"digest": digest, "files": checksums}, indent=1) + "\n")
            self._rename(partial, name, digest)
        except Exception as error:
            fault = disk_error(error)
            if fault is None:
                raise
            raise OutputError(f"cannot be written: {fault.strerror}", file=self.path(name)) from error
        finally:
            shutil.rmtree(partial, ignore_errors=True)

    def _partial(self, name: str) -> Path:
        return self._folder / f".{name}.{_HOST}.{os.getpid()}.{uuid.uuid4().hex[:8]}{_PARTIAL}"

    def _rename(self, partial: Path, name: str, digest: str) -> None:
        if self.holds(name, digest):
            return
        self.discard(name)
        try:
            partial.rename(self.path(name))
        except OSError as error:
            if error.errno not in {errno.ENOTEMPTY, errno.EEXIST} or not self.holds(name, digest):
                raise

    def discard(self, name: str) -> None:
        """Remove a task's folder, if it exists; it is renamed first, so that it disappears at once."""
        renamed = self._partial(name)
        with suppress(FileNotFoundError):
            self.path(name).rename(renamed)
            shutil.rmtree(renamed, ignore_errors=True)

    def sweep(self) -> None:
        """Remove unfinished folders of killed processes of this machine."""
        for partial in self._folder.glob(f".*{_PARTIAL}"):
            host, pid = partial.name.removesuffix(_PARTIAL).rsplit(".", 3)[-3:-1]
            if host == _HOST and not is_running(int(pid)):
                shutil.rmtree(partial, ignore_errors=True)


def is_running(pid: int) -> bool:
    """Whether the process exists on this machine."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
