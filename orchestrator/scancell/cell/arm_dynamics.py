"""Masses and drives of an arm with dynamic drives, as the FMU reads them."""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.config.cell import CellDescription
from scancell.config.description import to_si
from scancell.config.robot import DriveDescription, InertiaDescription
from scancell.geometry.mesh import Mesh, load_mesh, mass_properties
from scancell.nominal.gripper import housing_mesh, pose_matrix, tool_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigidBody:
    """Mass (kg), centre of mass (3,) in metres, and inertia (3, 3) about it, in kg m²; all in one frame."""

    mass: float
    centre_of_mass: Array
    inertia: Array

    def seen_from(self, frame_from_body: Array) -> RigidBody:
        """The same body in another frame."""
        rotation = frame_from_body[:3, :3]
        centre = rotation @ self.centre_of_mass + frame_from_body[:3, 3]
        return RigidBody(self.mass, centre, rotation @ self.inertia @ rotation.T)

    def joined_with(self, other: RigidBody) -> RigidBody:
        """Both as one rigid body; Huygens and Steiner's theorem moves the inertias to the common centre of mass."""
        mass = self.mass + other.mass
        centre = (self.mass * self.centre_of_mass + other.mass * other.centre_of_mass) / mass
        return RigidBody(mass, centre, self._inertia_about(centre) + other._inertia_about(centre))

    def _inertia_about(self, point: Array) -> Array:
        arm = self.centre_of_mass - point
        return np.asarray(self.inertia + self.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm)))

    def json(self) -> dict[str, Any]:
        """As the FMU reads it."""
        return {
            "mass": self.mass,
            "centre_of_mass": self.centre_of_mass.tolist(),
            "inertia": self.inertia.tolist(),
        }


def dynamics_json(cell: CellDescription) -> dict[str, Any]:
    """Links and drives of a cell whose robot has dynamic drives; the last link carries sensor and gripper.

    Raises
    ------
    MeshError
        If a mesh that defines masses cannot be used.
    """
    robot = cell.robot
    links = [_body(joint.inertia, _mesh(joint.mesh), robot.link_density_kg_m3) for joint in robot.joint]
    for load in _loads(cell):
        if links[-1] is not None:
            links[-1] = links[-1].joined_with(load)
    drives = [joint.drive for joint in robot.joint]
    return {
        "links": [link.json() for link in links if link is not None],
        "drives": [to_si(drive.model_dump()) for drive in drives if isinstance(drive, DriveDescription)],
    }


def _loads(cell: CellDescription) -> list[RigidBody]:
    """What is fixed to the flange, in its frame; the gripper's fingers are bodies of their own."""
    density = cell.robot.link_density_kg_m3
    sensor = _body(cell.tool.inertia, _mesh(cell.sensor_mesh), density)
    loads = [] if sensor is None else [sensor.seen_from(tool_matrix(cell.tool))]
    housing = None if cell.gripper is None else housing_mesh(cell.gripper)
    if cell.gripper is not None and housing is not None:
        loads.append(_of_mesh(housing, density).seen_from(pose_matrix(cell.gripper.pose)))
    return loads


def _mesh(path: str | None) -> Mesh | None:
    return None if path is None else load_mesh(Path(path))


def _body(inertia: InertiaDescription | None, mesh: Mesh | None, density: float) -> RigidBody | None:
    """By its description, else by its mesh; None where neither is known."""
    if inertia is not None:
        si = to_si(inertia.model_dump())
        xy, xz, yz = si["products"]
        tensor = np.diag(si["inertia"]) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
        return RigidBody(si["mass"], np.array(si["centre_of_mass"]), tensor)
    return None if mesh is None else _of_mesh(mesh, density)


def _of_mesh(mesh: Mesh, density: float) -> RigidBody:
    properties = mass_properties(mesh, density)
    return RigidBody(properties.mass, properties.centre_of_mass, properties.inertia)


def mesh_json(vertices: ArrayLike, faces: ArrayLike) -> dict[str, str]:
    """Vertices (n, 3), metres, as little-endian 64-bit floats, and faces (m, 3) as little-endian 32-bit integers."""
    return {
        "vertices": b64encode(np.ascontiguousarray(vertices, "<f8").tobytes()).decode(),
        "faces": b64encode(np.ascontiguousarray(faces, "<i4").tobytes()).decode(),
    }


def read_mesh_json(mesh: Mapping[str, str]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices (n, 3) and faces (m, 3) that `mesh_json` wrote."""
    vertices = np.frombuffer(b64decode(mesh["vertices"]), "<f8").reshape(-1, 3)
    return vertices, np.frombuffer(b64decode(mesh["faces"]), "<i4").reshape(-1, 3)
