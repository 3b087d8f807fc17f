"""Sensors, collision outputs and the bodies that they see, as the FMU reads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

from scancell.cell.arm_dynamics import mesh_json
from scancell.config.cell import CellDescription
from scancell.config.description import si_value, to_si
from scancell.config.devices import CellSensorDescription
from scancell.errors import CellError
from scancell.geometry.mesh import Mesh, decimated, deviation
from scancell.nominal.cell import NominalCell, fmu_frame
from scancell.nominal.gripper import pose_json, pose_matrix
from scancell.proximity.scene import cell_scene

# Keys of the cell's description that list sensors; the FMU reads each from a key in the plural.
SENSOR_KEYS = tuple(
    name
    for name, field in CellDescription.model_fields.items()
    if any(isinstance(item, type) and issubclass(item, CellSensorDescription) for item in get_args(field.annotation))
)


@dataclass(frozen=True)
class Simplified:
    """A body whose mesh was simplified for the FMU: triangles before and after, largest deviation in metres."""

    body: str
    faces: int
    kept: int
    deviation: float

    def line(self) -> str:
        """Text of one line."""
        off = f"{self.deviation * 1e6:.1f} µm"
        return f"{self.body}: {self.faces} triangles simplified to {self.kept}, off by at most {off}"


def collision_meshes(cell: CellDescription, nominal: NominalCell) -> dict[str, Mesh]:
    """Mesh of each body with no more triangles than the description allows.

    Raises
    ------
    MeshError
        If a mesh cannot be simplified.
    """
    return {body.name: decimated(body.mesh, cell.collision.max_faces) for body in nominal.bodies}


def simplified(cell: CellDescription, nominal: NominalCell) -> list[Simplified]:
    """Bodies whose meshes were simplified."""
    light = collision_meshes(cell, nominal)
    return [
        Simplified(body.name, len(body.mesh.faces), len(light[body.name].faces), deviation(body.mesh, light[body.name]))
        for body in nominal.bodies
        if light[body.name] is not body.mesh
    ]


def sensing_json(cell: CellDescription, nominal: NominalCell, *, collision_outputs: bool = True) -> dict[str, Any]:
    """The keys ``bodies``, ``collision`` and those of the sensors in the FMU's description.

    `collision_outputs` False leaves these outputs out, even if the cell describes them.

    Raises
    ------
    CellError
        If a sensor's period does not fit the time step.
    MeshError
        If a mesh cannot be simplified.
    """
    collision_outputs = collision_outputs and cell.collision.outputs
    sensors = {f"{key}s": [_sensor_json(cell, sensor) for sensor in getattr(cell, key)] for key in SENSOR_KEYS}
    needed = collision_outputs or any(sensors.values())
    meshes = collision_meshes(cell, nominal) if needed else {}
    pairs = _watched(cell, nominal, meshes) if collision_outputs else ()
    return {
        "bodies": [
            {
                "name": body.name,
                "frame": fmu_frame(body.moves_with),
                "mesh": mesh_json(meshes[body.name].vertices, meshes[body.name].faces),
            }
            for body in nominal.bodies
            if body.name in meshes
        ],
        **sensors,
        "collision": {
            "outputs": collision_outputs,
            "stops_arm": collision_outputs and cell.collision.stops_arm,
            "swept": cell.collision.swept,
            "range": si_value(cell.collision, "range_mm"),
            "pairs": [list(pair) for pair in pairs],
        },
    }


def _watched(cell: CellDescription, nominal: NominalCell, meshes: dict[str, Mesh]) -> list[tuple[str, str]]:
    """Pairs of bodies to monitor: all that move relative to each other, but those that are meant to touch.

    These are fingers with parts, and the platter and belts with parts that a gripper or a belt puts there.
    """
    loose = _loose_frames(cell, nominal)
    frame = {body.name: body.moves_with for body in nominal.bodies}
    supports = {"table", *(belt.name for belt in cell.conveyor)}

    def are_meant_to_touch(a: str, b: str) -> bool:
        fingers_and_part = {frame[name].partition("[")[0] for name in (a, b)} == {"finger", "part"}
        return fingers_and_part or any(
            frame[part].startswith("part") and frame[part] in loose and other in supports
            for part, other in ((a, b), (b, a))
        )

    return [pair for pair in cell_scene(nominal, meshes, loose).pairs if not are_meant_to_touch(*pair)]


def _loose_frames(cell: CellDescription, nominal: NominalCell) -> set[str]:
    """Frames that neither joints nor table move: fingers, and free parts that a gripper or a belt carries."""
    has_gripper, frames = cell.gripper is not None, set[str]()
    if has_gripper:
        frames |= {"finger[1]", "finger[2]"}
    if cell.part.fixture == "free" and (has_gripper or nominal.belt is not None):
        frames.add("part")
    for number, part in enumerate(nominal.further_parts, start=2):
        if part.description.fixture == "free" and (has_gripper or part.carrier != "table"):
            frames.add(f"part[{number}]")
    return frames


def _sensor_json(cell: CellDescription, sensor: CellSensorDescription) -> dict[str, Any]:
    """The mount, and all other keys of a sensor in SI units."""
    period_us = round(sensor.period_ms * 1e3)
    if period_us <= 0 or period_us % cell.world.time_step_us or abs(sensor.period_ms * 1e3 - period_us) > 1e-6:
        raise CellError(
            file=sensor.name,
            key="period_ms",
            value=sensor.period_ms,
            expected=f"a multiple of world.time_step_us ({cell.world.time_step_us})",
        )
    return {
        "name": sensor.name,
        "frame": sensor.moves_with,
        "frame_from_sensor": pose_json(pose_matrix(sensor.pose)),
        "period_us": period_us,
        **to_si(sensor.model_dump(exclude=set(CellSensorDescription.model_fields))),
    }
