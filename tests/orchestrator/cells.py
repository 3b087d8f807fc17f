"""The default cell with parts made for tests."""

import numpy as np
import trimesh

from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import nominal_cell
from scancell.planning.model import PlanningCell, SensorRange

CYCLE = 0.016
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
