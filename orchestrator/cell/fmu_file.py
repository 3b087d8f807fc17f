"""Packs the native robot cell and a cell description into an FMU."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import orchestrator.cell
from orchestrator.cell.arm_dynamics import dynamics_json
from orchestrator.cell.fmu_package.contents import FmiVersion, FmuOptions, fmu_contents, write_archive
from orchestrator.cell.gripper import start_width
from orchestrator.cell.nominal import FurtherPart, NominalCell
from orchestrator.cell.poses import pose_json, pose_matrix
from orchestrator.cell.sensing import sensing_json
from orchestrator.config.cell import CellDescription, PartDescription
from orchestrator.config.contact import ContactDescription
from orchestrator.config.devices import ConveyorDescription, FurtherPartDescription
from orchestrator.config.gripper import GripperDescription
from orchestrator.config.units import to_si
from orchestrator.errors import CellError
from orchestrator.files import atomic_write
from orchestrator.geometry.mesh import Mesh, mass_properties

Array = NDArray[np.float64]


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
    robot = [to_si(joint.model_dump(exclude={"mesh", "drive", "inertia"})) for joint in cell.robot.joint]
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
        "robot": {
            "world_from_base": pose_json(nominal.arm.world_from_base),
            "joints": robot,
            "motion": to_si(cell.robot.motion.model_dump()),
            "dynamics": dynamics_json(cell) if cell.robot.drive == "dynamic" else None,
        },
        "tool": {"flange_from_sensor": pose_json(nominal.flange_from_sensor)},
        "table": {"world_from_table": pose_json(nominal.world_from_table), "start": 0.0, **table},
        "conveyors": [_conveyor_json(conveyor) for conveyor in cell.conveyor],
        "parts": [
            {"name": "part", **_scanned_part_json(cell.part, nominal)},
            *(_further_part_json(part) for part in nominal.further_parts),
        ],
        "gripper": None if cell.gripper is None else _gripper_json(cell.gripper),
        "contact": _contact_json(cell.contact),
        **sensing_json(cell, nominal),
    }


def _part_json(part: PartDescription | FurtherPartDescription, mesh: Mesh, support_from_part: Array) -> dict[str, Any]:
    hull = mesh.hull
    properties = mass_properties(mesh, part.density_kg_m3)
    return {
        "fixture": part.fixture,
        "support_from_part": pose_json(support_from_part),
        "mass": properties.mass,
        "friction": part.friction,
        "soft": None if part.soft is None else to_si(part.soft.model_dump()),
        "hull": {"vertices": hull.vertices.tolist(), "faces": hull.faces.tolist()},
        "centre_of_mass": properties.centre_of_mass.tolist(),
        "inertia": properties.inertia.tolist(),
    }


def _scanned_part_json(part: PartDescription, nominal: NominalCell) -> dict[str, Any]:
    if part.arrival is None:
        return {"stands_on": "table", **_part_json(part, nominal.part, nominal.table_from_part)}
    place = pose_matrix(part.arrival.pose)
    return {"stands_on": part.arrival.stands_on, **_part_json(part, nominal.part, place)}


def _further_part_json(part: FurtherPart) -> dict[str, Any]:
    described = part.description
    placed = _part_json(described, part.mesh, pose_matrix(described.pose))
    return {"name": described.name, "stands_on": described.stands_on, **placed}


def _conveyor_json(conveyor: ConveyorDescription) -> dict[str, Any]:
    si = to_si(conveyor.model_dump(exclude={"pose", "reflectance", "material"}))
    return {"world_from_belt": pose_json(pose_matrix(conveyor.pose)), **si}


def _gripper_json(gripper: GripperDescription) -> dict[str, Any]:
    drawn = {"pose", "start_mm", "housing_mm", "housing_mesh", "finger_mesh", "reflectance", "material"}
    return {
        "flange_from_gripper": pose_json(pose_matrix(gripper.pose)),
        "start": start_width(gripper),
        **to_si(gripper.model_dump(exclude=drawn)),
    }


def _contact_json(contact: ContactDescription) -> dict[str, Any]:
    pairs = [{"bodies": list(pair.bodies), "points": pair.points} for pair in contact.pair]
    return {"solver": contact.solver, "points": contact.points, "pairs": pairs}


def build_fmu(
    description: Mapping[str, Any], path: Path, version: FmiVersion, options: FmuOptions | None = None
) -> None:
    """Write the FMU of a cell (`cell_json`) to `path`; it appears whole or not at all.

    Raises
    ------
    CellError
        If the native part is missing or refuses the description, or the cell cannot make its reference trajectory.
    OutputError
        If the file cannot be written.
    """
    options = options or FmuOptions()
    # Lines are for people, and make writing ten times as slow.
    text = json.dumps(description, indent=1 if options.documents else None)
    contents = fmu_contents(runtime_dir(), text, version, options)
    with atomic_write(path) as temporary:
        write_archive(temporary, contents, compressed=options.compressed)
