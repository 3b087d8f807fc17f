"""What made a result: versions, seed, checksums of every input."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as package_version
from pathlib import Path
from typing import Any

from orchestrator.config.loading import FILE_KEYS, Setup
from orchestrator.config.toml_text import to_toml
from orchestrator.evaluation.build import build_version

_PACKAGES = (
    "numpy",
    "scipy",
    "fmpy",
    "python-fcl",
    "coal",
    "opencv-python-headless",
    "trimesh",
    "pydantic",
)


def versions() -> dict[str, str]:
    """Which build of scancell, and the versions of Python and of the packages that take part in a result."""
    packages = {name: _version_of(name) for name in _PACKAGES}
    return {"scancell": build_version(), "python": platform.python_version(), **packages}


def _version_of(package: str) -> str:
    try:
        return package_version(package)
    except PackageNotFoundError:
        return "not installed"


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def manifest(setup: Setup, inputs: Sequence[Path], run: Mapping[str, Any]) -> dict[str, Any]:
    """Versions, `run` (seed, engine, command line, FMU token …) and the checksum of every input file.

    Meshes that the descriptions name count as inputs.
    """
    files = sorted({*inputs, *map(Path, named_files(setup))})
    return {"versions": versions(), **run, "inputs": {str(path): sha256(path) for path in files}}


def named_files(setup: Setup) -> list[str]:
    """Paths of the meshes and other files that the cell description names."""
    return _files_in(setup.cell.model_dump())


def _files_in(node: Any) -> list[str]:
    if isinstance(node, Mapping):
        own = [value for key, value in node.items() if key in FILE_KEYS and isinstance(value, str)]
        return own + [path for value in node.values() for path in _files_in(value)]
    if isinstance(node, list | tuple):
        return [path for value in node for path in _files_in(value)]
    return []


def resolved_toml(setup: Setup, run: Mapping[str, Any]) -> str:
    """All descriptions after overrides and defaults, and how the command was called, as TOML."""
    sections = {"run": dict(run), **{name: getattr(setup, name).model_dump() for name in ("cell", "sensor", "scan")}}
    return to_toml(sections)
