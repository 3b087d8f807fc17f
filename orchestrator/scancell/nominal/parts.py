"""Meshes, poses and bodies from descriptions: parts and artefacts, their patches and placement, gripper and tool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.config.artefact import ArtefactDescription
from scancell.config.cell import (
    CellDescription,
    FixtureDescription,
    MaterialRegionDescription,
    PartDescription,
    TableDescription,
    ToolDescription,
    sensor_frame,
)
from scancell.config.description import PoseDescription, si_value, to_si
from scancell.config.devices import FurtherPartDescription, GripperDescription
from scancell.config.material import Material, MaterialDescription
from scancell.config.robot import InertiaDescription
from scancell.errors import CellError, MeshError
from scancell.files import CAD_FORMATS, file_state, require_file, split_solids
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh
from scancell.geometry.mesh import (
    FORMATS,
    METRES_PER_UNIT,
    MassProperties,
    Mesh,
    box_mesh,
    is_stable_pose,
    joined,
    load_mesh,
    mass_properties,
)
from scancell.geometry.shapes import Box, Cone, Cylinder, PlacedShape, Plane, Ring, Shape, ShapeGroup, ShapeMesh, Sphere
from scancell.values import Value

PART_FORMATS = (*FORMATS, *CAD_FORMATS, ".toml")

_MOST_KEPT = 2
_MOST_MESHES = 32  # of files that are kept
_SIDES = 96  # of a platter without a mesh: 0.05 % beyond its radius at the corners

_SHAPES: dict[str, Callable[[dict[str, Any]], Shape]] = {
    "sphere": lambda si: Sphere(si["diameter"] / 2),
    "plane": lambda si: Plane(*si["size"]),
    "box": lambda si: Box(*si["size"]),
    "cylinder": lambda si: Cylinder(si["diameter"] / 2, si["height"]),
    "cone": lambda si: Cone(si["bottom_diameter"] / 2, si["top_diameter"] / 2, si["height"]),
    "ring": lambda si: Ring(si["inner_diameter"] / 2, si["outer_diameter"] / 2, si["height"]),
}


def start_width(gripper: GripperDescription) -> float:
    """Distance between the pads at the start, m."""
    return si_value(gripper, "stroke_mm" if gripper.start_mm is None else "start_mm")


def gripper_from_finger(width: float) -> Array:
    """Frames (2, 4, 4) of the fingers with the pads `width` (m) apart."""
    first = pose.translation((width / 2, 0.0, 0.0))
    return np.stack([first, pose.from_rotation(pose.rotation_about(2, np.pi)) @ first])


def finger_mesh(gripper: GripperDescription) -> Mesh:
    """A finger in its own frame, metres.

    Raises `MeshError` if a described mesh cannot be used.
    """
    if gripper.finger_mesh is not None:
        return load_mesh(Path(gripper.finger_mesh))
    si = to_si(gripper.model_dump(include={"finger_thickness_mm", "finger_width_mm", "finger_length_mm"}))
    size = (si["finger_thickness"], si["finger_width"], si["finger_length"])
    return box_mesh(size, "finger").transformed(pose.translation((size[0] / 2, 0.0, size[2] / 2)))


def finger_travel_mesh(gripper: GripperDescription, finger: Mesh) -> Mesh:
    """Convex hull of a `finger` at all widths, in its frame at the start width, metres."""
    start, stroke = start_width(gripper), si_value(gripper, "stroke_mm")
    ends = [finger.transformed(pose.translation(((width - start) / 2, 0.0, 0.0))) for width in (0.0, stroke)]
    return joined(ends, finger.source).hull


def housing_mesh(gripper: GripperDescription) -> Mesh | None:
    """Housing that carries the fingers, in the gripper's frame, metres; None if not described.

    Raises `MeshError` if a described mesh cannot be used.
    """
    if gripper.housing_mesh is not None:
        return load_mesh(Path(gripper.housing_mesh))
    if gripper.housing_mm is None:
        return None
    size = to_si({"housing_mm": gripper.housing_mm})["housing"]
    return box_mesh(size, "gripper").transformed(pose.translation((0.0, 0.0, -size[2] / 2)))


def described_mesh(path: str | None, world_from_mesh: PoseDescription | None = None) -> Mesh | None:
    """Mesh of a file; that of a standing body is drawn in the frame in which it stands, and moved to the world."""
    mesh = None if path is None else _file_mesh(path, file_state(Path(path)))
    return mesh if mesh is None or world_from_mesh is None else mesh.transformed(pose_matrix(world_from_mesh))


@lru_cache(_MOST_MESHES)
def _file_mesh(path: str, _state: tuple[str, int, int]) -> Mesh:
    """Mesh of a file in a state; many cells of one arm, as of a search or a study, read it once."""
    return load_mesh(Path(path))


def platter_cylinder(table: TableDescription) -> Mesh:
    """The least prism of `_SIDES` sides around the cylinder of a platter."""
    radius, thickness = si_value(table, "radius_mm"), si_value(table, "thickness_mm")
    i = np.arange(_SIDES)
    corners = radius / np.cos(np.pi / _SIDES) * np.exp(2j * np.pi * i / _SIDES)
    top = np.column_stack([corners.real, corners.imag, np.zeros(_SIDES)])
    j, k = (i + 1) % _SIDES, i[1:-1]
    lids = [np.column_stack([0 * k, k, k + 1]), _SIDES + np.column_stack([0 * k, k + 1, k])]
    sides = [np.column_stack([i, _SIDES + i, _SIDES + j]), np.column_stack([i, _SIDES + j, j])]
    return Mesh(np.vstack([top, top - (0.0, 0.0, thickness)]), np.concatenate([*lids, *sides]), "table")


def pose_matrix(description: PoseDescription) -> Array:
    """(4, 4) of a described pose."""
    si = to_si(description.model_dump())
    position = (si["x"], si["y"], si["z"])
    if si["yaw"] is not None:
        return pose.from_rotation(pose.rotation_from_euler_zyz((si["yaw"], si["pitch"], si["roll"])), position)
    return pose.from_euler_xyz(position, (si["rx"], si["ry"], si["rz"]))


def tool_matrix(tool: ToolDescription) -> Array:
    """Pose (4, 4) of the sensor on what carries it, given directly or from the dimensions of the fixture."""
    described = tool.pose if tool.flange_from_sensor is None else tool.flange_from_sensor
    if described is not None:
        return pose_matrix(described)
    assert isinstance(tool.fixture, FixtureDescription)  # the description has exactly one of the three
    si = to_si(tool.fixture.model_dump())
    return np.asarray(
        pose.from_rotation(pose.rotation_about(2, si["rotation"]))
        @ pose.translation((si["offset"], 0.0, si["plate"] + si["reach"]))
        @ pose.from_rotation(pose.rotation_about(1, si["tilt"]))
    )


def lay_down(part: Mesh, description: PartDescription) -> Array:
    """``table_from_part`` (4, 4): bounding box centred on the axis, lowest point on the table, then displaced."""
    si = to_si(description.model_dump())
    rotation = pose.rotation_from_euler_xyz((si["rx"], si["ry"], si["rz"]))
    vertices = part.vertices @ rotation.T
    low, high = vertices.min(0), vertices.max(0)
    centre = (low + high) / 2
    return pose.from_rotation(rotation, (si["x"] - centre[0], si["y"] - centre[1], si["z"] - low[2]))


def refuse_unstable(part: Mesh, table_from_part: Array, description: PartDescription) -> None:
    """Raise `CellError` for a free part that would roll, tip over or fall."""
    hint = 'turn it with part.rx_deg, part.ry_deg, part.rz_deg, or clamp it (part.fixture = "clamped")'
    if description.z_mm != 0.0:
        raise CellError(f"a free part must touch the table (0); {hint}", key="part.z_mm", value=description.z_mm)
    if not is_stable_pose(part, table_from_part):
        raise CellError(f"is not stable in this pose; {hint}", file=part.source)


def rigid_body(inertia: InertiaDescription | None, mesh_file: str | None, density: float) -> MassProperties | None:
    """Mass properties by their description, else by a mesh and its density, kg/m³; None where neither is known.

    Raises `MeshError` if the mesh cannot be used.
    """
    if inertia is not None:
        si = to_si(inertia.model_dump())
        xy, xz, yz = si["products"]
        tensor = np.diag(si["inertia"]) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
        return MassProperties(si["mass"], np.array(si["centre_of_mass"]), tensor)
    return None if mesh_file is None else mass_properties(load_mesh(Path(mesh_file)), density)


def flange_loads(cell: CellDescription, part: Mesh | None) -> dict[str, MassProperties]:
    """Mass properties, in the frame of the flange, of what the arm always carries.

    These are ``sensor`` and ``sensor[2]`` …, if they are there, ``gripper`` (its housing), ``finger1`` and ``finger2``
    with the pads as they start, and ``part``, the `part` of a cell whose description puts it there; where a mass is
    known.

    Raises `MeshError` if a mesh cannot be used.
    """
    loads: dict[str, MassProperties] = {}
    density = cell.robot.link_density_kg_m3
    sensor = rigid_body(cell.tool.inertia, cell.sensor_mesh, density)
    if sensor is not None and cell.tool.moves_with == "flange":
        loads["sensor"] = sensor.seen_from(tool_matrix(cell.tool))
    for number, further in enumerate(cell.further_sensor, 2):
        body = rigid_body(further.inertia, further.mesh, density)
        if further.moves_with == f"link[{len(cell.robot.joint)}]" and body is not None:
            loads[sensor_frame(number)] = body.seen_from(pose_matrix(further.pose))
    if cell.gripper is not None:
        flange_from_gripper, housing = pose_matrix(cell.gripper.pose), housing_mesh(cell.gripper)
        if housing is not None:
            loads["gripper"] = mass_properties(housing, density).seen_from(flange_from_gripper)
        # The FMU takes the fingers for boxes, whatever their meshes.
        si = to_si(cell.gripper.model_dump())
        size, mass = np.array([si[f"finger_{key}"] for key in ("thickness", "width", "length")]), si["finger_mass"]
        finger = MassProperties(
            mass, np.array([size[0] / 2, 0.0, size[2] / 2]), np.diag(mass / 12 * (size @ size - size**2))
        )
        placed = flange_from_gripper @ gripper_from_finger(start_width(cell.gripper))
        loads |= {f"finger{i}": finger.seen_from(at) for i, at in enumerate(placed, 1)}
    if part is not None and cell.part.moves_with == "flange":
        loads["part"] = mass_properties(part, cell.part.density_kg_m3).seen_from(lay_down(part, cell.part))
    return loads


def pose_json(target_from_source: Array) -> dict[str, Any]:
    """Position (m) and quaternion (w, x, y, z) of a (4, 4) matrix."""
    quaternion = pose.quaternion_from_rotation(target_from_source[:3, :3])
    return {"position": target_from_source[:3, 3].tolist(), "quaternion": quaternion.tolist()}


def shape_group(artefact: ArtefactDescription, source: str | None = None) -> ShapeGroup:
    """The shapes of an artefact in the part frame, m; `source` is its file, by default its name."""
    shapes = [
        PlacedShape(one.name, _SHAPES[one.kind](to_si(one.model_dump())), pose_matrix(one.pose), one.role)
        for one in artefact.shape
    ]
    return ShapeGroup(tuple(shapes), source or artefact.name)


@checked_arguments
def load_part(path: str | Path, unit: str = "mm") -> Mesh:
    """Read a part.

    Parameters
    ----------
    path
        An STL, OBJ or PLY file, a CAD file (STEP, IGES, BREP; ``FILE#SOLID``: one of its solids), or an artefact
        (TOML).
    unit
        Unit of the coordinates in a mesh file: ``mm``, ``m`` or ``inch``. The keys of an artefact have units of their
        own.

    Returns
    -------
    Mesh
        In metres. That of an artefact is a tessellation that holds the exact shapes.

    Raises
    ------
    MeshError
        With the file and the fault, see `load_mesh`.
    DescriptionError
        Naming the file of an artefact, key, value and what was expected.

    Examples
    --------
    >>> part = scancell.load_part("part.stl", unit="mm")
    >>> print(np.ptp(part.bounds, axis=0).round(4))
    [0.09  0.05  0.027]
    >>> scancell.load_part("prat.stl")
    Traceback (most recent call last):
        ...
    scancell.errors.MeshError: prat.stl: no such file
    """
    path = Path(path)
    if split_solids(path)[0].suffix.lower() != ".toml":
        return load_mesh(path, unit)
    if unit not in METRES_PER_UNIT:
        raise MeshError(key="unit", value=unit, expected=f"one of {', '.join(METRES_PER_UNIT)}")
    return load_artefact(path).mesh()


def cad_part(part: str | Path | Mesh) -> CadMesh:
    """A CAD part, or that of a file.

    Raises `MeshError` if it is missing, broken, or not from a CAD file.
    """
    found = part.usable if isinstance(part, Mesh) else load_part(part)
    if not isinstance(found, CadMesh):
        raise MeshError(
            "has no CAD faces",
            file=found.source,
            expected=f"a CAD file ({', '.join(CAD_FORMATS)}), whose faces are exact",
        )
    return found


@checked_arguments
def load_artefact(path: str | Path) -> ShapeGroup:
    """Read the shapes of an artefact from the TOML file `path`; they are in the part frame, m.

    Raises
    ------
    DescriptionError
        Naming file, key, value and what was expected.

    Examples
    --------
    >>> artefact = scancell.load_artefact(scancell.assets_dir() / "artefacts" / "sphere.toml")
    >>> [(shape.name, shape.role) for shape in artefact.shapes]
    [('ball', 'measured'), ('stem', 'support'), ('foot', 'support')]
    """
    return shape_group(ArtefactDescription.from_toml(Path(path)), str(path))


class PartCache:
    """Parts from files; the two used last are kept."""

    def __init__(self) -> None:
        self._load = lru_cache(_MOST_KEPT)(lambda path, unit, _state: load_part(path, unit))

    def part(self, part: str | Path | Mesh, unit: str) -> Mesh:
        """The part of a file, see `load_part`, or the mesh itself; a file is read again only when it has changed.

        Raises `ScancellError` if the file is missing, unreadable, empty or broken.
        """
        if isinstance(part, Mesh):
            return part.usable
        path = Path(part)
        return self._load(path, unit, file_state(path)) if split_solids(path)[0].is_file() else load_part(path, unit)

    def clear(self) -> None:
        """Forget all parts."""
        self._load.cache_clear()


@dataclass(frozen=True)
class Patch:
    """Faces (n,) of a mesh that have a material of their own."""

    faces: NDArray[np.int64]
    material: Material


def part_patches(part: Mesh, description: PartDescription) -> tuple[Patch, ...]:
    """Patches of the part, none of them empty or overlapping.

    Raises `CellError` if the file of face materials cannot be read or does not fit the mesh, or the part has no faces.
    """
    regions = description.material_region
    if isinstance(part, ShapeMesh):
        if regions or description.face_materials is not None:
            raise CellError(
                "an artefact has one material, that of the part", file=part.source, key="part.material_region"
            )
        return ()
    number = np.zeros(len(part.faces), np.int64)
    middle_mm = part.vertices[part.faces].mean(axis=1) * 1e3
    for i, region in enumerate(regions, 1):
        if region.min_mm is not None or region.max_mm is not None:
            number[_inside(middle_mm, region)] = i
    if description.face_materials is not None:
        listed = _read_numbers(Path(description.face_materials), len(part.faces), len(regions))
        number = np.where(listed > 0, listed, number)
    patches = [Patch(np.flatnonzero(number == i), region.material.resolved()) for i, region in enumerate(regions, 1)]
    return tuple(patch for patch in patches if len(patch.faces))


def _inside(middle_mm: NDArray[np.float64], region: MaterialRegionDescription) -> NDArray[np.bool_]:
    low = np.full(3, -np.inf) if region.min_mm is None else np.array(region.min_mm)
    high = np.full(3, np.inf) if region.max_mm is None else np.array(region.max_mm)
    return np.asarray(((middle_mm >= low) & (middle_mm <= high)).all(axis=1))


def _read_numbers(path: Path, faces: int, regions: int) -> NDArray[np.int64]:
    try:
        require_file(path, CellError)
        values = np.load(path) if path.suffix == ".npy" else np.loadtxt(path, delimiter=",", ndmin=1)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise CellError(f"cannot be read as numbers: {error}", file=path, key="part.face_materials") from None
    if values.shape != (faces,):
        raise CellError(f"{values.size} numbers for a mesh of {faces} faces", file=path, key="part.face_materials")
    if not np.isin(values, np.arange(regions + 1)).all():
        raise CellError(
            file=path, key="part.face_materials", expected=f"0 or the number of a material_region, 1 to {regions}"
        )
    return values.astype(np.int64)


@dataclass(frozen=True, eq=False, repr=False)
class Body(Value):
    """A rigid body that can occlude, be lit, or collide.

    `moves_with` names the frame that carries it: ``world``, ``link[1]`` …, ``sensor``, ``table``, ``part`` and, for
    further sensors and parts, ``sensor[2]`` … and ``part[2]`` …, for a gripper ``finger[1]`` and ``finger[2]``; the
    mesh is given in that frame, metres. Faces of `patches` have materials of their own. `clearance` (m) replaces that
    of the scan.
    """

    name: str
    moves_with: str
    mesh: Mesh
    material: Material
    patches: tuple[Patch, ...] = ()
    clearance: float | None = None

    @property
    def materials(self) -> tuple[Material, ...]:
        """All that its faces have."""
        return (self.material, *(patch.material for patch in self.patches))


@dataclass(frozen=True)
class FurtherPart:
    """A part beside the one that is scanned, and its mesh, m."""

    description: FurtherPartDescription
    mesh: Mesh


def cell_bodies(cell: CellDescription, part: Mesh, further: tuple[FurtherPart, ...]) -> tuple[Body, ...]:
    """The bodies of arm, sensors, table and part, of conveyors and further parts, of the gripper, and known obstacles.

    Raises `MeshError` if a mesh that the description names cannot be used.
    """
    table = cell.table
    robot_material = _material(cell.robot_material, cell.robot_reflectance)
    table_material = _material(table.material, table.reflectance)
    meshes = [
        ("base", cell.robot_moves_with, described_mesh(cell.robot.base_mesh, cell.robot.base), robot_material),
        *(
            (f"link{i}", f"link[{i}]", described_mesh(joint.mesh), robot_material)
            for i, joint in enumerate(cell.robot.joint, 1)
        ),
        ("sensor", "sensor", described_mesh(cell.sensor_mesh), robot_material),
        *(
            (one.name, sensor_frame(number), described_mesh(one.mesh), _material(one.material, one.reflectance))
            for number, one in enumerate(cell.further_sensor, 2)
        ),
        ("table", "table", described_mesh(table.platter_mesh) or platter_cylinder(table), table_material),
        ("table_base", table.moves_with, described_mesh(table.base_mesh, table.pose), table_material),
    ]
    bodies = [Body(name, frame, mesh, material) for name, frame, mesh, material in meshes if mesh is not None]
    material = _material(cell.part.material, cell.part.reflectance)
    bodies.append(Body("part", "part", part, material, part_patches(part, cell.part)))
    return (*bodies, *_device_bodies(cell, further), *_gripper_bodies(cell), *obstacle_bodies(cell, known=True))


def obstacle_bodies(cell: CellDescription, *, known: bool) -> tuple[Body, ...]:
    """The obstacles that planning and reconstruction know, or those that the description hides from them.

    Raises `MeshError` if the mesh of an obstacle cannot be used.
    """
    return tuple(
        Body(
            item.name,
            f"link[{len(cell.robot.joint)}]" if item.moves_with == "flange" else item.moves_with,
            load_part(item.mesh, item.unit).transformed(pose_matrix(item.pose)),
            _material(item.material, item.reflectance),
            clearance=None if item.clearance_mm is None else si_value(item, "clearance_mm"),
        )
        for item in cell.obstacle
        if item.known == known
    )


def _device_bodies(cell: CellDescription, further: tuple[FurtherPart, ...]) -> tuple[Body, ...]:
    belts = [
        Body(
            belt.name,
            "world",
            box_mesh((si["length"], si["width"], si["thickness"]), belt.name).transformed(
                pose_matrix(belt.pose) @ pose.translation((0.0, 0.0, -si["thickness"] / 2))
            ),
            _material(belt.material, belt.reflectance),
        )
        for belt in cell.conveyor
        for si in [to_si(belt.model_dump(include={"length_mm", "width_mm", "thickness_mm"}))]
    ]
    parts = [
        Body(
            part.description.name,
            f"part[{number}]",
            part.mesh,
            _material(part.description.material, part.description.reflectance),
        )
        for number, part in enumerate(further, start=2)
    ]
    return (*belts, *parts)


def _gripper_bodies(cell: CellDescription) -> tuple[Body, ...]:
    gripper = cell.gripper
    if gripper is None:
        return ()
    material = _material(gripper.material, gripper.reflectance)
    housing, finger = housing_mesh(gripper), finger_mesh(gripper)
    bodies = [Body(f"finger{i}", f"finger[{i}]", finger, material) for i in (1, 2)]
    if housing is None:
        return tuple(bodies)
    flange = f"link[{len(cell.robot.joint)}]"
    return (Body("gripper", flange, housing.transformed(pose_matrix(gripper.pose)), material), *bodies)


def _material(description: MaterialDescription | None, reflectance: float) -> Material:
    return Material(reflectance) if description is None else description.resolved()
