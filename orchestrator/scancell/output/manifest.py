"""Provenance of a result: versions, seed, checksums of all inputs."""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as package_version
from pathlib import Path
from typing import Any

from scancell.config.files import file_entries, plain_data, toml_text
from scancell.config.loading import Setup
from scancell.output.build import build_version

_PACKAGES = (
    "numpy",
    "scipy",
    "fmpy",
    "python-fcl",
    "opencv-python-headless",
    "trimesh",
    "pydantic",
)


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
    return {"versions": versions(), **run, "inputs": {str(path): sha256(path) for path in files}}


def named_files(setup: Setup) -> list[str]:
    """Paths of the meshes and other files named by the cell description."""
    return [table[key] for table, key, _ in file_entries(plain_data(setup.cell))]


def resolved_toml(setup: Setup, run: Mapping[str, Any]) -> str:
    """Descriptions with overrides and defaults applied, and the other inputs `run`, as TOML for `load_resolved`."""
    return toml_text({"run": run, **{name: getattr(setup, name).model_dump() for name in ("cell", "sensor", "scan")}})
