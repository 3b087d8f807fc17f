"""The record of a results folder: all inputs that determine its results, so that only equal requests continue there.

A newer version may know keys that the folder was begun without. The results stay valid where every key that both know
has the same value and every new one is at its default; finished tasks carry the digest of the record in the folder.

Files are compared by their checksums, wherever they lie.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from scancell.config.description import Description
from scancell.errors import DescriptionError
from scancell.files import atomic_write, read_json
from scancell.output.run_folder import build_version, sha256, versions

DESCRIPTION = "description.json"
FILES = "files"
_VERSIONS = "versions"
MAX_LISTED = 5


@dataclass
class Comparison:
    """A request compared with the record of a folder.

    `differences` forbid to continue, as text; `new_keys` are unknown to the record and at their defaults; `versions`
    has the recorded and the present version of each package that changed.
    """

    record: Path
    differences: list[str] = field(default_factory=list)
    new_keys: list[str] = field(default_factory=list)
    versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    def __str__(self) -> str:
        more = len(self.differences) - MAX_LISTED
        return "; ".join(self.differences[:MAX_LISTED]) + (f"; and {more} more" if more > 0 else "")

    @property
    def warnings(self) -> list[str]:
        """Warnings for a user who continues."""
        warnings = []
        if self.new_keys:
            warnings.append(f"{self.record} does not contain {', '.join(self.new_keys)}: their defaults are assumed")
        if self.versions:
            changed = ", ".join(f"{name} {before} (now {now})" for name, (before, now) in self.versions.items())
            warnings.append(f"begun with {changed}: {self.record.parent} may contain results of both")
        return warnings


def checksums(files: Iterable[str | Path]) -> dict[str, str]:
    """SHA-256 of each file by its path: the value of `FILES` in a request.

    Raises
    ------
    DescriptionError
        Naming a file that cannot be read.
    """
    found = {}
    for file in sorted({str(file) for file in files}):
        try:
            found[file] = sha256(Path(file))
        except OSError as error:
            raise DescriptionError(f"cannot be read: {error.strerror}", file=file) from None
    return found


def mixed_build_warnings(builds: Iterable[str | None]) -> list[str]:
    """Warnings about results made by other builds of scancell than the running one; None: unknown build."""
    made = Counter(build for build in builds if build is not None)
    if set(made) <= {build_version()}:
        return []
    counts = ", ".join(f"{count} by {build}" for build, count in sorted(made.items()))
    return [f"made by other builds of scancell than this one ({build_version()}): {counts}"]


def plain_terms(request: Mapping[str, Any], ignored_keys: Set[str]) -> dict[str, Any]:
    """Descriptions and other data by name as plain data, without the ignored keys (``study.set``)."""
    plain: dict[str, Any] = to_jsonable_python(request)
    for path in ignored_keys:
        *tables, key = path.split(".")
        node = plain
        for name in tables:
            node = node[name]
        node.pop(key)
    return plain


def write_record(terms: Mapping[str, Any], out: Path) -> None:
    """Write `terms` and the versions of all packages that decide the results into the folder `out`.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    with atomic_write(out / DESCRIPTION) as temporary:
        temporary.write_text(json.dumps({_VERSIONS: versions(), **terms}, indent=1) + "\n")


def recorded_terms(out: Path) -> dict[str, Any]:
    """The terms that `write_record` wrote, without the versions.

    Raises
    ------
    FileNotFoundError
        If nothing was begun in `out`.
    DescriptionError
        If the record there cannot be read.
    """
    return {key: value for key, value in _read(out / DESCRIPTION).items() if key != _VERSIONS}


def compare_with_record(request: Mapping[str, Any], ignored_keys: Set[str], out: Path) -> Comparison:
    """Compare `request` (see `plain_terms`) with the record in `out`.

    Raises
    ------
    FileNotFoundError, DescriptionError
        As `recorded_terms`.
    """
    found, record = Comparison(out / DESCRIPTION), _read(out / DESCRIPTION)
    versions_before, files_before = record.pop(_VERSIONS, {}), record.pop(FILES, {})
    terms = {key: value for key, value in request.items() if key != FILES}
    _Comparer(ignored_keys, files_before, request[FILES], found).compare(record, terms, "")
    for name, now in versions().items():
        if name in versions_before and versions_before[name] != now:
            found.versions[name] = (versions_before[name], now)
    return found


def _read(record: Path) -> dict[str, Any]:
    if not record.exists():
        raise FileNotFoundError(record)
    content = read_json(record)
    if not isinstance(content, dict):
        raise DescriptionError("cannot be read", file=record, expected="a table")
    return content


@dataclass(frozen=True)
class _Comparer:
    """Adds all differences to `found`; `before` and `now` are checksums of files by path."""

    ignored_keys: Set[str]
    before: Mapping[str, str]
    now: Mapping[str, str]
    found: Comparison

    def compare(self, before: Any, now: Any, path: str) -> None:
        """Compare the recorded and the requested value at `path`."""
        if isinstance(now, Description | Mapping) and isinstance(before, dict):
            self._compare_tables(before, now, path)
        elif isinstance(now, list | tuple) and isinstance(before, list) and len(before) == len(now):
            for number, (old, new) in enumerate(zip(before, now, strict=True), 1):
                self.compare(old, new, f"{path}[{number}]")
        elif isinstance(before, str) and isinstance(now, str) and before in self.before and now in self.now:
            if self.before[before] != self.now[now]:
                self.found.differences.append(f"{path}: {now} differs from {before} as it was then")
        elif before != to_jsonable_python(now):
            self.found.differences.append(f"{path} was {_short(before)}, is {_short(now)}")

    def _compare_tables(self, before: dict[str, Any], now: Description | Mapping[str, Any], path: str) -> None:
        keys = type(now).model_fields if isinstance(now, Description) else now
        for key in keys:
            inside = f"{path}.{key}".lstrip(".")
            value = getattr(now, key) if isinstance(now, Description) else now[key]
            if inside in self.ignored_keys:
                continue
            if key in before:
                self.compare(before[key], value, inside)
            elif _at_default(now, key, value):
                self.found.new_keys.append(inside)
            else:
                self.found.differences.append(f"{inside} was unknown then and is {_short(value)}, not its default")
        gone = [key for key in before if key not in keys and f"{path}.{key}" not in self.ignored_keys]
        self.found.differences.extend(
            f"{path}.{key}".lstrip(".") + f" was {_short(before[key])}, is unknown now" for key in gone
        )


def _at_default(table: Any, key: str, value: Any) -> bool:
    if not isinstance(table, Description):
        return False
    field_info = type(table).model_fields[key]
    if field_info.is_required():
        return False
    return bool(to_jsonable_python(value) == to_jsonable_python(field_info.get_default(call_default_factory=True)))


def _short(value: Any, limit: int = 80) -> str:
    text = repr(to_jsonable_python(value))
    # Paths differ at their ends.
    half = (limit - 3) // 2
    return text if len(text) <= limit else f"{text[:half]} … {text[-half:]}"
