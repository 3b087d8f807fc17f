"""What decides the results in a folder, kept beside them, so that nobody goes on with another question there.

A newer version may know keys that the folder was begun without. Its results go on counting where every key that both
know has the same value and every new one is at its default; finished tasks are told by the words in the folder.

A file is what it holds, wherever it lies: of two paths the checksums are compared, and only of files whose checksum an
older record lacks the paths themselves.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from orchestrator.config.description import Description
from orchestrator.errors import DescriptionError
from orchestrator.evaluation.build import build_version
from orchestrator.evaluation.manifest import sha256, versions
from orchestrator.files import atomic_write

DESCRIPTION = "description.json"
FILES = "files"
_VERSIONS = "versions"
_TOLD = 5


@dataclass
class Comparison:
    """How what is asked for now compares with what the results in a folder were made for.

    `differences` forbid going on, for people; `new_keys` are at their defaults; what `unchecked` files held then is not
    known; `versions` says of each package that is another one now which it was and is.
    """

    record: Path
    differences: list[str] = field(default_factory=list)
    new_keys: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)
    versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    def __str__(self) -> str:
        more = len(self.differences) - _TOLD
        return "; ".join(self.differences[:_TOLD]) + (f"; and {more} more" if more > 0 else "")

    @property
    def warnings(self) -> list[str]:
        """What a person should know who goes on."""
        said = []
        if self.new_keys:
            said.append(f"{self.record} does not know {', '.join(self.new_keys)}: taken at their defaults")
        if self.unchecked:
            said.append(f"{self.record} does not know what {', '.join(self.unchecked)} held: taken to be the same")
        if self.versions:
            changed = ", ".join(f"{name} {before} (now {now})" for name, (before, now) in self.versions.items())
            said.append(f"begun with {changed}: {self.record.parent} may hold results of both")
        return said


def checksums(files: Iterable[str | Path]) -> dict[str, str]:
    """What each file holds, by its path: the value of `FILES` in what is asked for.

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
            raise DescriptionError(f"{file}: cannot be read: {error.strerror}") from None
    return found


def told_builds(builds: Iterable[str | None]) -> list[str]:
    """Warnings about results of other builds of scancell than the one that runs; of an old result it is not known."""
    made = Counter(build for build in builds if build is not None)
    if set(made) <= {build_version()}:
        return []
    told = ", ".join(f"{count} by {build}" for build, count in sorted(made.items()))
    return [f"made by other builds of scancell than this one ({build_version()}): {told}"]


def plain_terms(asked: Mapping[str, Any], apart: Set[str]) -> dict[str, Any]:
    """Descriptions and other data by name as plain data, without the keys of `apart` (``study.set``)."""
    plain: dict[str, Any] = to_jsonable_python(asked)
    for path in apart:
        *tables, key = path.split(".")
        node = plain
        for name in tables:
            node = node[name]
        node.pop(key)
    return plain


def write_record(terms: Mapping[str, Any], out: Path) -> None:
    """Keep `terms`, and the versions of what will answer them, in the folder `out`.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    with atomic_write(out / DESCRIPTION) as temporary:
        temporary.write_text(json.dumps({_VERSIONS: versions(), **terms}, indent=1) + "\n")


def recorded_terms(out: Path) -> dict[str, Any]:
    """What `write_record` kept, without the versions.

    Raises
    ------
    FileNotFoundError
        If nothing was begun in `out`.
    DescriptionError
        If the record there cannot be read.
    """
    return {key: value for key, value in _read(out / DESCRIPTION).items() if key != _VERSIONS}


def compare_with_record(asked: Mapping[str, Any], apart: Set[str], out: Path) -> Comparison:
    """Hold `asked` (see `plain_terms`) against the record in `out`.

    Raises
    ------
    FileNotFoundError, DescriptionError
        As `recorded_terms`.
    """
    found, record = Comparison(out / DESCRIPTION), _read(out / DESCRIPTION)
    versions_before, files_before = record.pop(_VERSIONS, {}), _files_of(record)
    terms = {key: value for key, value in asked.items() if key != FILES}
    _Comparer(apart, files_before, asked[FILES], found).compare(record, terms, "")
    for name, now in versions().items():
        if name in versions_before and versions_before[name] != now:
            found.versions[name] = (versions_before[name], now)
    return found


def _read(record: Path) -> dict[str, Any]:
    try:
        content = json.loads(record.read_text())
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise DescriptionError(f"{record}: cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise DescriptionError(f"{record}: cannot be read: expected a table")
    return content


def _files_of(record: dict[str, Any]) -> dict[str, str]:
    """Take the checksums by path out of a record; one that was begun without them has that of the part alone."""
    if "part_sha256" in record:
        return {record.get("part", ""): record.pop("part_sha256")}
    files: dict[str, str] = record.pop(FILES, {})
    return files


@dataclass(frozen=True)
class _Comparer:
    """Adds to `found` what is not the same; `before` and `now` have checksums of files by path."""

    apart: Set[str]
    before: Mapping[str, str]
    now: Mapping[str, str]
    found: Comparison

    def compare(self, before: Any, now: Any, path: str) -> None:
        """Go through what was and what is asked for at `path`."""
        if isinstance(now, Description | Mapping) and isinstance(before, dict):
            self._compare_tables(before, now, path)
        elif isinstance(now, list | tuple) and isinstance(before, list) and len(before) == len(now):
            for number, (old, new) in enumerate(zip(before, now, strict=True), 1):
                self.compare(old, new, f"{path}[{number}]")
        elif isinstance(before, str) and isinstance(now, str) and before in self.before and now in self.now:
            if self.before[before] != self.now[now]:
                self.found.differences.append(f"{path}: {now} does not hold what {before} held then")
        elif before != to_jsonable_python(now):
            self.found.differences.append(f"{path} was {_short(before)}, is {_short(now)}")
        elif isinstance(now, str) and now in self.now:
            self.found.unchecked.append(now)

    def _compare_tables(self, before: dict[str, Any], now: Description | Mapping[str, Any], path: str) -> None:
        keys = type(now).model_fields if isinstance(now, Description) else now
        for key in keys:
            inside = f"{path}.{key}".lstrip(".")
            value = getattr(now, key) if isinstance(now, Description) else now[key]
            if inside in self.apart:
                continue
            if key in before:
                self.compare(before[key], value, inside)
            elif _at_default(now, key, value):
                self.found.new_keys.append(inside)
            else:
                self.found.differences.append(f"{inside} was not known then and is {_short(value)}, not its default")
        gone = [key for key in before if key not in keys and f"{path}.{key}" not in self.apart]
        self.found.differences.extend(
            f"{path}.{key}".lstrip(".") + f" was {_short(before[key])}, is not known any more" for key in gone
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
