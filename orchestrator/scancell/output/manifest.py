"""Provenance of a result: build fingerprint, versions, seed, checksums of all inputs."""

from __future__ import annotations

import hashlib
import platform
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as package_version
from pathlib import Path
from types import ModuleType
from typing import Any

import scancell
from scancell.cell.fmu_file import runtime_dir
from scancell.config.files import file_entries, plain_data, toml_text
from scancell.config.loading import Setup
from scancell.errors import CellError
from scancell.files import MANIFEST_VERSION
from scancell.proximity import _native as proximity_native
from scancell.sensor import _native as sensor_native

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
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as stream:
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
