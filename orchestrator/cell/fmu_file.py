"""Packs the native robot cell and a cell description into an FMU."""

from __future__ import annotations

import json
import os
import subprocess
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

import orchestrator.cell
from orchestrator.cell.nominal import NominalCell
from orchestrator.config.cell import CellDescription
from orchestrator.config.units import to_si
from orchestrator.errors import CellError
from orchestrator.files import atomic_write
from orchestrator.geometry import pose
from orchestrator.geometry.mesh import mass_properties

FmiVersion = Literal[2, 3]
_PLATFORM = {2: "linux64", 3: "x86_64-linux"}
# Zip entries carry a fixed date, so that the same cell gives the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)


def runtime_dir() -> Path:
    """Folder with the native library, its closure and the description printer.

    Raises
    ------
    CellError
        If the native part was not built.
    """
    for folder in orchestrator.cell.__path__:
        candidate = Path(folder) / "runtime"
        if (candidate / "robotcell-describe").is_file():
            return candidate
    raise CellError("the native robot cell is not installed; run `make setup`")


def cell_json(cell: CellDescription, nominal: NominalCell, seed: int) -> dict[str, Any]:
    """Complete SI description of the cell as the FMU reads it."""
    robot = [to_si(joint.model_dump(exclude={"mesh"})) for joint in cell.robot.joint]
    for joint, start in zip(robot, nominal.home, strict=True):
        joint["start"] = float(start)
    table = to_si(cell.table.model_dump(exclude={"pose", "reflectance", "material", "platter_mesh", "base_mesh"}))
    return {
        "format": 1,
        "name": cell.name,
        "time_step_us": cell.world.time_step_us,
        "controller_cycle_us": cell.world.controller_cycle_us,
        "gravity": [0.0, 0.0, -cell.world.gravity_m_s2],
        "seed": seed,
        "robot": {"world_from_base": _pose_json(nominal.arm.world_from_base), "joints": robot},
        "tool": {"flange_from_sensor": _pose_json(nominal.flange_from_sensor)},
        "table": {"world_from_table": _pose_json(nominal.world_from_table), "start": 0.0, **table},
        "conveyors": [],
        "parts": [_part_json(cell, nominal)],
    }


def _part_json(cell: CellDescription, nominal: NominalCell) -> dict[str, Any]:
    part = cell.part
    hull = nominal.part.hull
    properties = mass_properties(nominal.part, part.density_kg_m3)
    return {
        "name": "part",
        "fixture": part.fixture,
        "stands_on": "table",
        "support_from_part": _pose_json(nominal.table_from_part),
        "mass": properties.mass,
        "friction": part.friction,
        "hull": {"vertices": hull.vertices.tolist(), "faces": hull.faces.tolist()},
        "centre_of_mass": properties.centre_of_mass.tolist(),
        "inertia": properties.inertia.tolist(),
    }


def _pose_json(target_from_source: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    quaternion = pose.quaternion_from_rotation(target_from_source[:3, :3])
    return {"position": target_from_source[:3, 3].tolist(), "quaternion": quaternion.tolist()}


def build_fmu(description: Mapping[str, Any], path: Path, version: FmiVersion) -> None:
    """Write the FMU of a cell (`cell_json`) to `path`; it appears whole or not at all.

    Raises
    ------
    CellError
        If the native part is missing or refuses the description.
    OutputError
        If the file cannot be written.
    """
    runtime = runtime_dir()
    text = json.dumps(description, indent=1)
    with atomic_write(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        _add(archive, "modelDescription.xml", _describe(runtime, text, version).encode())
        _add(archive, "resources/cell.json", text.encode())
        for file in sorted(runtime.rglob("*")):
            if file.is_file():
                _add_runtime_file(archive, file, runtime, version)


def _add_runtime_file(archive: zipfile.ZipFile, file: Path, runtime: Path, version: FmiVersion) -> None:
    relative = file.relative_to(runtime)
    if relative.parts[0] == "licenses":
        folder = "documentation/licenses"
        _add(archive, f"{folder}/{'/'.join(relative.parts[1:])}", file.read_bytes())
    elif ".so" in file.name:
        _add(archive, f"binaries/{_PLATFORM[version]}/{file.name}", file.read_bytes(), executable=True)


def _add(archive: zipfile.ZipFile, name: str, content: bytes, executable: bool = False) -> None:
    entry = zipfile.ZipInfo(name, _EPOCH)
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = (0o755 if executable else 0o644) << 16
    archive.writestr(entry, content)


def _describe(runtime: Path, description: str, version: FmiVersion) -> str:
    """The model description, printed by the same variable table that the library answers from."""
    command = [str(runtime / "robotcell-describe"), "-", "--fmi", str(version)]
    # The printer is linked against the closure beside it.
    environment = {**os.environ, "LC_ALL": "C"}
    result = subprocess.run(command, input=description, capture_output=True, text=True, env=environment, check=False)
    if result.returncode:
        raise CellError(f"the native robot cell refuses the description: {result.stderr.strip()}")
    return result.stdout
