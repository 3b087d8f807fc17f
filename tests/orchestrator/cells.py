"""The default cell with parts made for tests, and clouds of given points."""

from pathlib import Path

import numpy as np
import trimesh

from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell, SensorRange
from scancell.reconstruction.cloud import Cloud

CYCLE = 0.016
GRIPPER = [
    "cell.gripper.pose={ x_mm = 60.0, z_mm = 50.0 }", "cell.gripper.stroke_mm=50", "cell.gripper.finger_length_mm=40",
    "cell.gripper.finger_width_mm=16", "cell.gripper.housing_mm=[70, 40, 45]",
]  # fmt: skip
_A, _TILT, _GAMMA, _ASPECT = 0.060, np.radians(29.3), np.radians(9.34), 1280 / 1024
# Eq. 5, corrected, for the default probe.
RANGE = SensorRange(
    near=_A / np.tan(_TILT + _GAMMA),
    far=_A / np.tan(_TILT - _GAMMA),
    half_near=_A * _ASPECT * np.sin(_GAMMA) / np.sin(_TILT + _GAMMA),
    half_far=_A * _ASPECT * np.sin(_GAMMA) / np.sin(_TILT - _GAMMA),
    cameras=np.array([[_A, 0.0, 0.0], [-_A, 0.0, 0.0]]),
)


def mesh_of(made: trimesh.Trimesh, name: str = "part.stl") -> Mesh:
    return Mesh(np.asarray(made.vertices, float), np.asarray(made.faces, np.int64), name)


def ball(radius: float = 0.025) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(4, radius))


def block(x: float, y: float, z: float) -> Mesh:
    return mesh_of(trimesh.creation.box((x, y, z), pose.translation((0, 0, z / 2))))


def planning_cell(part: Mesh, **placement_mm_deg: float) -> PlanningCell:
    words = [f"cell.part.{key}={value}" for key, value in placement_mm_deg.items()]
    return PlanningCell(nominal_cell(load_setup(settings=words).cell, part), RANGE, CYCLE)


def cell_file(folder: Path, text: str = "") -> Path:
    """File of the default cell, continued by `text`."""
    file = folder / "cell.toml"
    file.write_text((assets_dir() / "cells" / "default.toml").read_text().replace("../", f"{assets_dir()}/") + text)
    return file


def export_mm(mesh: Mesh, file: Path) -> Path:
    """Write a mesh as it is, in millimetres."""
    trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=False).export(file)
    return file


def cloud_of(points: np.ndarray, **columns: np.ndarray) -> Cloud:
    """A cloud of one exposure; `columns` replaces any of the others."""
    n, ones, zeros = len(points), np.ones(len(points)), np.zeros(len(points), np.int32)
    given = {"normals": np.tile([0.0, 0.0, 1.0], (n, 1)), "sigma": ones, "intensity": ones, "quality": ones}
    counts = {"camera": zeros, "column": zeros, "profile": zeros.astype(np.int64), "segment": zeros + 1}
    flags = {"saturated": np.zeros(n, bool)}
    return Cloud(points, **{**given, **counts, "time": ones, **flags, **columns})
