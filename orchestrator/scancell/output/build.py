"""Version and build fingerprint of the running scancell.

Builds of the same version may give different results, for example on the nodes of a cluster. The fingerprint covers
the Python sources, the ray tracer, and the FMU binary with its bundled libraries. It does not depend on the folder of
the installation.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as package_version
from pathlib import Path
from types import ModuleType

import scancell
from scancell.cell.fmu_file import runtime_dir
from scancell.errors import CellError
from scancell.proximity import _native as proximity_native
from scancell.sensor import _native as sensor_native

_DIGITS = 12
# Files of the FMU runtime; bundle.json lists the bundled libraries and their versions.
_NATIVE_CELL = ("RobotCell.so", "robotcell-describe", "bundle.json")


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
