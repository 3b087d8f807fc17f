"""Which scancell runs: its version, and what it was built of.

Two builds of one version may give other results, so the version alone would not tell nodes of a cluster apart. The
fingerprint is that of what runs: the Python sources, the ray tracer, and the cell with what it is bundled with. It is
the same wherever the same wheel is installed.
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

import orchestrator
import sensor_rt
import sensor_rt._core
from orchestrator.cell.fmu_file import runtime_dir
from orchestrator.errors import CellError

_DIGITS = 12
# Of the cell's runtime folder; the list of the bundle names the libraries and their versions.
_NATIVE_CELL = ("RobotCell.so", "robotcell-describe", "bundle.json")


@cache
def build_version() -> str:
    """Version and fingerprint of the scancell that runs, as ``0.1.0+1f0c…``."""
    return f"{_release(Path(orchestrator.__path__[0]))}+{fingerprint(_parts())}"


def fingerprint(parts: Iterable[tuple[str, Path]]) -> str:
    """Digits that stand for the names and contents of files, wherever these lie."""
    whole = hashlib.sha256()
    for name, path in sorted(parts):
        whole.update(f"{name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return whole.hexdigest()[:_DIGITS]


def sources(package: ModuleType) -> list[tuple[str, Path]]:
    """Python files of an imported package, under names that do not depend on where it is installed."""
    return [
        (f"{package.__name__}/{path.relative_to(folder).as_posix()}", path)
        for folder in package.__path__
        for path in Path(folder).rglob("*.py")
    ]


def _parts() -> list[tuple[str, Path]]:
    core = Path(str(sensor_rt._core.__file__))
    parts = [*sources(orchestrator), *sources(sensor_rt), ("sensor_rt/_core", core)]
    try:
        runtime = runtime_dir()
    except CellError:  # whoever needs the native cell will be told
        return parts
    return parts + [(name, runtime / name) for name in _NATIVE_CELL]


def _release(package: Path) -> str:
    """Version of a checkout by its project file, of an installation by what the installer noted."""
    project = package.parent / "pyproject.toml"
    if project.is_file():
        return str(tomllib.loads(project.read_text())["project"]["version"])
    try:
        return package_version("scancell")
    except PackageNotFoundError:
        return "unknown"
