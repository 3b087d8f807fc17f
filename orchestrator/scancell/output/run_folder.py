"""Result folders that are written atomically."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import secrets
import shutil
import sys
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as package_version
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

import scancell
from scancell.arguments import checked_arguments
from scancell.cell.fmu_file import runtime_dir
from scancell.config.files import file_entries, plain_data, toml_text
from scancell.config.loading import Setup
from scancell.errors import CellError, DescriptionError, OutputError
from scancell.files import MANIFEST_VERSION, arrow_table, read_json, split_solids
from scancell.progress import Stopwatch
from scancell.proximity import _native as proximity_native
from scancell.reconstruction.cloud_files import FORMATS
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.sensor import _native as sensor_native
from scancell.values import Result

# Files that scans and reconstructions write into the folder of their run, each some of them.
OPTIONAL_FILES = (
    *(f"cloud.{suffix}" for suffix in FORMATS),
    *("profiles.parquet", "recording.parquet", "points.parquet", "covariance.parquet"),
    *("plan.json", "deviation.json", "deviation.png", "deviation.html", "reconstruction.json", "images", "laser_off"),
)
_ROWS = 1 << 18  # of a table written at a time, which bounds the memory


_DIGITS = 12
# Files of the FMU runtime; bundle.json lists the bundled libraries and their versions.
_NATIVE_CELL = ("RobotCell.so", "robotcell-describe", "bundle.json")

_PACKAGES = (
    "numpy",
    "scipy",
    "fmpy",
    "python-fcl",
    "opencv-python-headless",
    "trimesh",
    "pydantic",
)


MANIFEST = "manifest.json"


@dataclass(eq=False, repr=False)
class RunReport(Result):
    """Outcome of a command: figures, lines of text, warnings, files, and `timings`, the wall time (s) by step.

    Examples
    --------
    >>> report = scancell.RunReport({"exposures": 1}, ["1 exposures: 2520 points"])
    >>> report
    RunReport(1 exposures: 2520 points)
    >>> report.figures["exposures"]
    1
    """

    figures: dict[str, Any]
    lines: list[str]
    warnings: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    timings: dict[str, float] = field(default_factory=dict)

    def summary(self) -> str:
        """The lines of text."""
        return "\n".join(self.lines)


class SavedResult(Result):
    """Base of results that are saved as a folder of files, all or none."""

    def _write(self, folder: RunFolder, command_line: list[str]) -> None:
        """Write the files; a manifest keeps the words of the command line."""
        raise NotImplementedError

    @checked_arguments
    def save(self, folder: str | Path, command_line: Sequence[str] | None = None) -> list[Path]:
        """Write figures, tables, pictures and manifest, as far as the result has them, and return their paths.

        `command_line`: words that the manifest keeps; by default those of this process.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        with RunFolder(Path(folder)) as run:
            self._write(run, command_words(command_line))
        return run.paths


def run_into(out: Path, work: Callable[[RunFolder, Stopwatch], RunReport]) -> RunReport:
    """Report of `work`, completed with its files and timings; the files appear in `out` only if it succeeds.

    Raises
    ------
    OutputError
        If `out` cannot be created or written.
    """
    watch = Stopwatch()
    with RunFolder(out) as folder:
        report = work(folder, watch)
    report.files = [str(path) for path in folder.paths]
    report.timings = dict(watch.seconds)
    return report


class RunFolder:
    """Context manager that stages files in a hidden folder beside `target` and moves them there on success.

    Files and folders of an earlier run are replaced; others in `target` remain.

    Parameters
    ----------
    target
        The folder of the run.
    optional
        Names that not every run of this kind writes: those that the manifest of an earlier run in `target` states as
        its files are removed, unless this run writes them, too. Files of others with such names remain.

    Attributes
    ----------
    names
        Names of the files and folders moved to `target`.

    Raises
    ------
    OutputError
        On entry, if `target` cannot be created or written.
    """

    def __init__(self, target: Path, optional: Sequence[str] = ()) -> None:
        self.target = target
        self._optional = optional
        self._staging = target.parent / f".{target.name}.partial-{secrets.token_hex(4)}"
        self.names: list[str] = []
        self._created: list[Path] = []

    @property
    def paths(self) -> list[Path]:
        """Paths of the files and folders moved to `target`."""
        return [self.target / name for name in self.names]

    def path(self, name: str) -> Path:
        """Staging path of the file `name`; its folder exists."""
        path = self._staging / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def __enter__(self) -> Self:
        try:
            if self.target.exists() and not self.target.is_dir():
                raise OutputError("is a file", file=self.target, expected="a folder")
            self._make_parents()
            self._staging.mkdir()
            if self.target.exists() and not os.access(self.target, os.W_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            self._clear()
            raise OutputError(f"cannot be written: {error.strerror}", file=self.target) from None
        except BaseException:  # an interrupt before the context is entered
            self._clear()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._publish()
        finally:
            self._clear()

    def _make_parents(self) -> None:
        parent = self.target.parent
        missing = [folder for folder in (parent, *parent.parents) if not folder.exists()]
        for folder in reversed(missing):
            folder.mkdir(exist_ok=True)
            self._created.append(folder)

    def _clear(self) -> None:
        """Remove the staging folder, and the parent folders created for it that are empty."""
        shutil.rmtree(self._staging, ignore_errors=True)
        for folder in reversed(self._created):
            with suppress(OSError):  # not empty
                folder.rmdir()

    def _files_of_earlier_run(self) -> set[str]:
        with suppress(DescriptionError):
            stated = read_json(self.target / MANIFEST)
            files = stated.get("files") if isinstance(stated, dict) else None
            return {name for name in files if isinstance(name, str)} if isinstance(files, list) else set()
        return set()

    def _publish(self) -> None:
        try:
            self.target.mkdir(exist_ok=True)
            written = sorted(item.name for item in self._staging.iterdir())
            former = self._files_of_earlier_run().intersection(self._optional)
            if (self._staging / MANIFEST).is_file():
                stated = {**read_json(self._staging / MANIFEST), "files": written}
                (self._staging / MANIFEST).write_text(json.dumps(stated, indent=1) + "\n")
            for name in {*written, *former}:
                if (self.target / name).is_dir():
                    shutil.rmtree(self.target / name)
                elif name not in written:
                    (self.target / name).unlink(missing_ok=True)
            for name in written:
                (self._staging / name).replace(self.target / name)
                self.names.append(name)
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", file=self.target) from None


@cache
def build_version() -> str:
    """Version and fingerprint of the running scancell, such as ``0.1.0+1f0c…``."""
    return f"{_release(Path(scancell.__path__[0]))}+{fingerprint(_parts())}"


def fingerprint(parts: Iterable[tuple[str, Path]]) -> str:
    """Hexadecimal digest of files, given as names and paths; depends on names and contents only."""
    digest = hashlib.sha256()
    for name, path in sorted(parts):
        digest.update(f"{name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()[:_DIGITS]


def sources(package: ModuleType) -> list[tuple[str, Path]]:
    """Python files of an imported package, as names relative to it and paths."""
    return [
        (f"{package.__name__}/{path.relative_to(folder).as_posix()}", path)
        for folder in package.__path__
        for path in Path(folder).rglob("*.py")
    ]


def _parts() -> list[tuple[str, Path]]:
    modules = {"scancell/proximity/_native": proximity_native, "scancell/sensor/_native": sensor_native}
    parts = [*sources(scancell), *((name, Path(str(module.__file__))) for name, module in modules.items())]
    try:
        runtime = runtime_dir()
    except CellError:  # reported when an FMU is built
        return parts
    return parts + [(name, runtime / name) for name in _NATIVE_CELL]


def _release(package: Path) -> str:
    """Version from pyproject.toml in a checkout, else from the metadata of the installed package."""
    project = package.parents[1] / "pyproject.toml"
    if project.is_file():
        return str(tomllib.loads(project.read_text())["project"]["version"])
    try:
        return package_version("scancell")
    except PackageNotFoundError:
        return "unknown"


def versions() -> dict[str, str]:
    """Versions of scancell (with build fingerprint), Python and the packages that affect results."""
    packages = {name: _version_of(name) for name in _PACKAGES}
    return {"scancell": build_version(), "python": platform.python_version(), **packages}


def _version_of(package: str) -> str:
    try:
        return package_version(package)
    except PackageNotFoundError:
        return "not installed"


def command_words(given: Sequence[str] | None) -> list[str]:
    """Arguments of the command for a manifest: those given, else the process's."""
    return list(sys.argv[1:] if given is None else given)


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, the whole one where a path names solids in it."""
    with split_solids(path)[0].open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def manifest(setup: Setup, inputs: Sequence[Path], run: Mapping[str, Any]) -> dict[str, Any]:
    """Manifest of a run: versions, the entries of `run`, and SHA-256 checksums of all input files.

    Files named by the cell description, such as meshes, are included.

    Parameters
    ----------
    inputs
        Further input files.
    run
        Seed, engine, command line, FMU token, …
    """
    files = sorted({*inputs, *map(Path, named_files(setup))})
    return {
        "format_version": MANIFEST_VERSION,
        "versions": versions(),
        **run,
        "inputs": {str(path): sha256(path) for path in files},
    }


def named_files(setup: Setup) -> list[str]:
    """Paths of the meshes and other files named by the cell description."""
    return [table[key] for table, key, _ in file_entries(plain_data(setup.cell))]


def resolved_toml(setup: Setup, run: Mapping[str, Any]) -> str:
    """Descriptions with overrides and defaults applied, and the other inputs `run`, as TOML for `load_resolved`."""
    return toml_text({"run": run, **{name: getattr(setup, name).model_dump() for name in ("cell", "sensor", "scan")}})


def write_profiles(
    profiles: ProfilePoints,
    index: NDArray[np.int64],
    setup: Setup,
    path: Path,
    covariance: NDArray[np.float64] | None = None,
) -> None:
    """Write all points in the sensor frame as Parquet: lengths in mm; `profile` is the trigger index of (n,) `index`.

    In a cell with several sensors, a column `sensor` holds their numbers, and the names of the cameras include theirs.

    With `covariance` (m, 3, 3), m², also its columns, see `covariance_columns`.
    """
    import pyarrow.parquet  # noqa: PLC0415  (takes 0.1 s to import)

    index = index.astype(np.int32)
    few_values = ["profile", "camera", "x_mm", "flags", "time_offset_s"]
    sensors, names = setup.sensor_names, {"cameras": ",".join(setup.camera_names.values())}
    if len(sensors) > 1:
        names["sensors"] = ",".join(sensors)
        few_values.append("sensor")
    writer = None
    try:
        for start in range(0, max(len(profiles.frame), 1), _ROWS):
            rows = slice(start, start + _ROWS)
            points = 1e3 * np.asarray(profiles.points_in_sensor[rows], float)
            columns = {
                "profile": index[profiles.frame[rows]],
                **({"sensor": np.asarray(profiles.sensor[rows])} if len(sensors) > 1 else {}),
                "camera": np.asarray(profiles.camera[rows], np.uint8),
                "column": np.asarray(profiles.column[rows], np.int32),
                **{f"{axis}_mm": np.ascontiguousarray(points[:, i]) for i, axis in enumerate("xyz")},
                "sigma_mm": 1e3 * np.asarray(profiles.sigma[rows], np.float32),
                "intensity_dn": np.asarray(profiles.intensity[rows], np.float32),
                "flags": np.asarray(profiles.flags[rows], np.uint32),
                "time_offset_s": np.asarray(profiles.time_offset[rows], np.float32),
                **({} if covariance is None else covariance_columns(covariance[rows])),
            }
            table = arrow_table(columns)
            table = table.replace_schema_metadata({"frame": "sensor", **names})
            writer = writer or pyarrow.parquet.ParquetWriter(
                path, table.schema, compression="none", use_dictionary=few_values, write_statistics=False
            )
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def covariance_columns(covariance: NDArray[np.float64], name: str = "covariance") -> dict[str, NDArray[np.float64]]:
    """Columns ``covariance_xx_mm2`` … of covariances (m, 3, 3), m²; `name` is their first word."""
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    return {f"{name}_{'xyz'[i]}{'xyz'[j]}_mm2": np.ascontiguousarray(1e6 * covariance[:, i, j]) for i, j in pairs}


def write_json(path: Path, content: Any) -> None:
    """Write plain data as JSON, indented up to 100 000 characters."""
    text = json.dumps(content, indent=1)
    path.write_text((text if len(text) < 100_000 else json.dumps(content)) + "\n")
