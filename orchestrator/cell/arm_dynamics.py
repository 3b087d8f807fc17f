"""Masses and drives of an arm with dynamic drives, as the FMU reads them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.cell.nominal import tool_matrix
from orchestrator.config.cell import CellDescription
from orchestrator.config.drives import DriveDescription, InertiaDescription
from orchestrator.config.units import to_si
from orchestrator.geometry.mesh import load_mesh, mass_properties

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
    """Links and drives of a cell whose robot has dynamic drives; the last link carries the sensor."""
    robot = cell.robot
    links = [_body(joint.inertia, joint.mesh, robot.link_density_kg_m3) for joint in robot.joint]
    sensor = _body(cell.tool.inertia, cell.sensor_mesh, robot.link_density_kg_m3)
    if sensor is not None and links[-1] is not None:
        links[-1] = links[-1].joined_with(sensor.seen_from(tool_matrix(cell.tool)))
    drives = [joint.drive for joint in robot.joint]
    return {
        "links": [link.json() for link in links if link is not None],
        "drives": [to_si(drive.model_dump()) for drive in drives if isinstance(drive, DriveDescription)],
    }


def _body(inertia: InertiaDescription | None, mesh: str | None, density: float) -> RigidBody | None:
    """By its description, else by its mesh; None where neither is known."""
    if inertia is not None:
        si = to_si(inertia.model_dump())
        return RigidBody(si["mass"], np.array(si["centre_of_mass"]), np.diag(si["inertia"]))
    if mesh is None:
        return None
    properties = mass_properties(load_mesh(Path(mesh)), density)
    return RigidBody(properties.mass, properties.centre_of_mass, properties.inertia)
