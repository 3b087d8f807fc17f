"""The FMU of a cell: its description in SI units, perturbations of the cell as built, and the file itself."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from base64 import b64encode
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

import scancell.cell
from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.cell.fmu_package import (
    FmiVersion,
    FmuOptions,
    fmu_contents,
    sensor_contents,
    sequencer_contents,
    write_archive,
    write_unpacked,
)
from scancell.cell.instance import CellInstance
from scancell.config.cell import CellDescription, PartDescription
from scancell.config.description import si_value, split_unit, to_si
from scancell.config.devices import (
    RESERVED_NAMES,
    CellSensorDescription,
    FurtherPartDescription,
    GripperDescription,
)
from scancell.config.loading import parse_assignment, sensor_words
from scancell.config.robot import DriveDescription
from scancell.errors import CellError, DescriptionError, OutputError, ScancellError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.mesh import MassProperties, Mesh, box_mesh, decimated, deviation, mass_properties
from scancell.geometry.tree import WORLD
from scancell.nominal.cell import NominalCell, fmu_frame
from scancell.nominal.parts import flange_loads, pose_json, pose_matrix, rigid_body, start_width
from scancell.proximity.scene import cell_scene
from scancell.values import Closing

# Keys of the cell's description that list sensors; the FMU reads each from a key in the plural.
SENSOR_KEYS = tuple(
    name
    for name, field in CellDescription.model_fields.items()
    if any(isinstance(item, type) and issubclass(item, CellSensorDescription) for item in get_args(field.annotation))
)

_SUFFIXES_OF_UNIT = {"m": ("_mm", "_um"), "rad": ("_deg", "_mrad"), "s": ("_ms",), "Hz": ("_hz",)}
_PREFIX = "as_built."

# Bodies that get contact shapes from their meshes; table, belts, parts and fingers have contact shapes of their own.
_CELL_BODIES = RESERVED_NAMES - {"table", "part", "finger1", "finger2"}
_FLOOR_SIZE = (200.0, 200.0, 1.0)  # m


def dynamics_json(cell: CellDescription, part: Mesh | None = None, *, fingers: bool = False) -> dict[str, Any]:
    """Links and drives of a cell whose robot has dynamic drives; the last link has the mass of what it carries, too.

    Parameters
    ----------
    part
        The part, whose mass counts where it is on the flange.
    fingers
        Whether the fingers of a gripper count; in the FMU they are bodies of their own.

    Raises
    ------
    MeshError
        If a mesh that defines masses cannot be used.
    """
    robot = cell.robot
    links = [rigid_body(joint.inertia, joint.mesh, robot.link_density_kg_m3) for joint in robot.joint]
    for name, load in flange_loads(cell, part).items():
        if links[-1] is not None and (fingers or not name.startswith("finger")):
            links[-1] = links[-1].joined_with(load)
    for further in cell.further_sensor:
        number = int(further.moves_with[5:-1]) if further.moves_with.startswith("link[") else len(links)
        body, link = rigid_body(further.inertia, further.mesh, robot.link_density_kg_m3), links[number - 1]
        if number < len(links) and body is not None and link is not None:
            links[number - 1] = link.joined_with(body.seen_from(pose_matrix(further.pose)))
    drives = [joint.drive for joint in robot.joint]
    return {
        "links": [_inertial_json(link) for link in links if link is not None],
        "drives": [to_si(drive.model_dump()) for drive in drives if isinstance(drive, DriveDescription)],
    }


def _inertial_json(body: MassProperties) -> dict[str, Any]:
    return {"mass": body.mass, "centre_of_mass": body.centre_of_mass.tolist(), "inertia": body.inertia.tolist()}


def mesh_json(vertices: ArrayLike, faces: ArrayLike) -> dict[str, str]:
    """Vertices (n, 3), metres, as little-endian 64-bit floats, and faces (m, 3) as little-endian 32-bit integers."""
    return {
        "vertices": b64encode(np.ascontiguousarray(vertices, "<f8").tobytes()).decode(),
        "faces": b64encode(np.ascontiguousarray(faces, "<i4").tobytes()).decode(),
    }


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
                "frame": _frame(nominal, body.moves_with),
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
        if part.description.fixture == "free" and (has_gripper or part.description.stands_on != "table"):
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


def parse_as_built(words: Sequence[str], units: Mapping[str, str | None]) -> dict[str, float]:
    """FMU parameters (SI) from ``key=value`` words. Words that begin with ``sensor.`` are none of the FMU's.

    Parameters
    ----------
    units
        Unit of every ``as_built.*`` parameter of the FMU, from its model description.

    Raises
    ------
    DescriptionError
        If a key is unknown, wears the wrong unit, or its value is not a finite number.
    """
    return dict(_parse(word, units) for word in words if word not in sensor_words(words))


def _parse(word: str, units: Mapping[str, str | None]) -> tuple[str, float]:
    key, value = parse_assignment(word)
    name, scale = split_unit(key.removeprefix(_PREFIX))
    variable = _PREFIX + name
    if variable not in units:
        known = ", ".join(sorted(expected_keys(units)))
        raise DescriptionError(
            f"unknown perturbation '{key}'; known: {known}, and keys of the sensor: sensor.*",
            key="as_built",
            value=word,
        )
    suffixes = _SUFFIXES_OF_UNIT.get(units[variable] or "", ("",))
    if not any(suffix and key.endswith(suffix) for suffix in suffixes) and suffixes != ("",):
        raise DescriptionError(
            key="as_built", value=word, expected=f"a unit in the key: {' or '.join(name + s for s in suffixes)}"
        )
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise DescriptionError(key="as_built", value=word, expected=f"a finite number, got {value!r}")
    return variable, float(value) * scale


def expected_keys(units: Mapping[str, str | None]) -> list[str]:
    """Keys of all perturbations of the FMU, with units."""
    return [
        variable.removeprefix(_PREFIX) + _SUFFIXES_OF_UNIT.get(unit or "", ("",))[0]
        for variable, unit in units.items()
        if variable.startswith(_PREFIX)
    ]


def runtime_dir() -> Path:
    """Folder with the native library, its closure and the description printer.

    Raises
    ------
    CellError
        If the native part was not built.
    """
    return _runtime_of("cell", "robotcell-describe")


def _runtime_of(package: str, printer: str) -> Path:
    """Folder ``runtime`` of a package, with a description printer; see `runtime_dir`."""
    for folder in scancell.__path__:
        candidate = Path(folder) / package / "runtime"
        if (candidate / printer).is_file():
            return candidate
    raise CellError(f"the native {package} is not installed; run `make setup`")


@checked_arguments
def cell_json(
    cell: CellDescription, nominal: NominalCell, seed: int, *, collision_outputs: bool = True
) -> dict[str, Any]:
    """Complete SI description of the cell as the FMU reads it.

    Parameters
    ----------
    cell
        Description of the cell (`load_setup`).
    nominal
        Its geometry with the part (`nominal_cell`). Only its bodies are in the FMU: obstacles with ``known = false``
        have to be added (`ScanSession.true`).
    seed
        Random seed of the noise of encoders and sensors.
    collision_outputs
        False leaves out the outputs of collisions and clearances even where the cell describes them: nothing in a scan
        reads them, and their meshes and distance queries cost most of a run.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> description = scancell.cell_json(setup.cell, nominal, seed=0)
    >>> len(description["robot"]["joints"]), description["controller_cycle_us"]
    (6, 16000)
    """
    robot = [to_si(joint.model_dump(exclude={"mesh", "drive", "inertia"})) for joint in cell.robot.joint]
    for joint, start in zip(robot, nominal.home, strict=True):
        joint["start"] = float(start)
        if joint["beta"] == 0.0:  # as in most arms
            del joint["beta"]
    without = {"pose", "moves_with", "reflectance", "material", "platter_mesh", "base_mesh"}
    table = to_si(cell.table.model_dump(exclude=without | ({"turns"} if cell.table.turns else set())))
    axes = [
        {
            **to_si(described.model_dump(exclude={"pose", "kind", "along"})),
            "slides": axis.joint.kind == "prismatic",
            "moves_with": _frame(nominal, axis.joint.parent),
            "parent_from_joint": pose_json(axis.joint.parent_from_joint),
            "joint_from_frame": pose_json(axis.joint.joint_from_frame),
        }
        for described, axis in zip(cell.axis, nominal.further_axes, strict=True)
    ]
    further = [
        {"moves_with": _frame(nominal, one.parent), "parent_from_sensor": pose_json(one.parent_from_joint)}
        for one in nominal.further_sensors
    ]
    return {
        "format": 2,
        "name": cell.name,
        "time_step_us": cell.world.time_step_us,
        "controller_cycle_us": cell.world.controller_cycle_us,
        "gravity": [0.0, 0.0, -cell.world.gravity_m_s2],
        "seed": seed,
        "robot": {
            "world_from_base": pose_json(nominal.arm.world_from_base),
            "joints": robot,
            "held_joints": [held.joint for held in cell.robot.held],
            "motion": to_si(cell.robot.motion.model_dump()),
            "dynamics": dynamics_json(cell, nominal.scanned_part) if cell.robot.drive == "dynamic" else None,
            **_carried(nominal, nominal.arm_on),
        },
        **({"axes": axes} if axes else {}),
        "tool": _tool_json(nominal),
        **({"further_sensors": further} if further else {}),
        "table": {
            "world_from_table": pose_json(nominal.world_from_table),
            "start": 0.0,
            **table,
            **_carried(nominal, nominal.table_on),
        },
        "conveyors": [
            {
                "world_from_belt": pose_json(pose_matrix(belt.pose)),
                **to_si(belt.model_dump(exclude={"pose", "reflectance", "material"})),
            }
            for belt in cell.conveyor
        ],
        "parts": _parts_json(cell, nominal),
        "gripper": None if cell.gripper is None else _gripper_json(cell.gripper),
        "contact": _contact_json(cell, nominal),
        **sensing_json(cell, nominal, collision_outputs=collision_outputs),
    }


def _tool_json(nominal: NominalCell) -> dict[str, Any]:
    """The sensor on the flange, or on what carries it instead."""
    if nominal.carries_sensor:
        return {"flange_from_sensor": pose_json(nominal.flange_from_sensor)}
    sensor = nominal.sensor
    return {"moves_with": _frame(nominal, sensor.parent), "carrier_from_sensor": pose_json(sensor.parent_from_joint)}


def _carried(nominal: NominalCell, frame: str) -> dict[str, str]:
    """The key of what carries arm or table, which may be left out for the world."""
    return {} if frame == WORLD else {"moves_with": _frame(nominal, frame)}


def _frame(nominal: NominalCell, frame: str) -> str:
    """Name of a frame in the description for the FMU, where further axes are numbered."""
    names = [axis.name for axis in nominal.further_axes]
    return f"axis[{names.index(frame) + 1}]" if frame in names else fmu_frame(frame)


def _contacts_occur(cell: CellDescription) -> bool:
    """Whether anything that moves by forces can touch another body; if not, contact shapes are left out."""
    fixtures = (cell.part.fixture, *(part.fixture for part in cell.further_part))
    return "free" in fixtures or cell.robot.drive == "dynamic"


def _parts_json(cell: CellDescription, nominal: NominalCell) -> list[dict[str, Any]]:
    """The scanned part first."""
    hulls = _contacts_occur(cell)
    arrival = cell.part.arrival
    support_from_part = nominal.table_from_part if arrival is None else pose_matrix(arrival.pose)
    start = nominal.support if nominal.holds_part else "table"
    scanned = {"name": "part", "stands_on": start if arrival is None else arrival.stands_on}
    return [
        {**scanned, **_part_json(cell.part, nominal.part, support_from_part, hull=hulls)},
        *(
            {
                "name": part.description.name,
                "stands_on": part.description.stands_on,
                **_part_json(part.description, part.mesh, pose_matrix(part.description.pose), hull=hulls),
            }
            for part in nominal.further_parts
        ),
    ]


def _part_json(
    part: PartDescription | FurtherPartDescription, mesh: Mesh, support_from_part: Array, *, hull: bool
) -> dict[str, Any]:
    return {
        "fixture": part.fixture,
        "support_from_part": pose_json(support_from_part),
        "friction": part.friction,
        "soft": None if part.soft is None else to_si(part.soft.model_dump()),
        "inertial": _inertial_json(mass_properties(mesh, part.density_kg_m3)) if part.fixture == "free" else None,
        "hull": mesh_json(mesh.hull.vertices, mesh.hull.faces) if hull else None,
    }


def _gripper_json(gripper: GripperDescription) -> dict[str, Any]:
    drawn = {"pose", "start_mm", "housing_mm", "housing_mesh", "finger_mesh", "reflectance", "material"}
    return {
        "flange_from_gripper": pose_json(pose_matrix(gripper.pose)),
        "start": start_width(gripper),
        **to_si(gripper.model_dump(exclude=drawn)),
    }


def _contact_json(cell: CellDescription, nominal: NominalCell) -> dict[str, Any]:
    contact = cell.contact
    occurs = _contacts_occur(cell)
    unused = frozenset() if occurs else _CELL_BODIES | {"floor"}
    return {
        "solver": contact.solver,
        "points": contact.points,
        "stick": contact.stick,
        "friction": contact.friction,
        "bodies": _contact_bodies_json(cell, nominal) if occurs and contact.cell_bodies else [],
        "pairs": [
            {"bodies": list(pair.bodies), "points": pair.points or contact.points, "response": pair.response}
            for pair in contact.pair
            if unused.isdisjoint(pair.bodies)
        ],
    }


def _contact_bodies_json(cell: CellDescription, nominal: NominalCell) -> list[dict[str, Any]]:
    """Convex hulls of the cell's bodies and obstacles, and the floor."""
    solid = _CELL_BODIES | {item.name for item in cell.obstacle} | {item.name for item in cell.further_sensor}
    bodies = [
        (body.name, _frame(nominal, body.moves_with), body.mesh.hull) for body in nominal.bodies if body.name in solid
    ]
    below = pose.translation((0.0, 0.0, si_value(cell.world, "floor_z_mm") - _FLOOR_SIZE[2] / 2))
    bodies.append(("floor", "world", box_mesh(_FLOOR_SIZE, "floor").transformed(below)))
    return [
        {"name": name, "frame": frame, "hull": mesh_json(hull.vertices, hull.faces)} for name, frame, hull in bodies
    ]


def description_text(description: Mapping[str, Any], indent: int | None = None) -> str:
    """JSON of a description that `cell_json` made."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.generic | np.ndarray):
            return value.tolist()
        raise DescriptionError(
            key="description", value=value, expected="numbers, text, lists and mappings, as `cell_json` makes them"
        )

    return json.dumps(description, indent=indent, default=plain)


@checked_arguments
def build_fmu(
    description: Mapping[str, Any], path: str | Path, version: FmiVersion, options: FmuOptions | None = None
) -> None:
    """Write the FMU of a cell to `path` atomically.

    Parameters
    ----------
    description
        Description of the cell, as `cell_json` makes it.
    path
        File of the FMU.
    version
        Version of FMI: 2 or 3.
    options
        Variants of the model description (`FmuOptions`); None: none of them.

    Raises
    ------
    CellError
        If the native part is missing or refuses the description, or the cell cannot make its reference trajectory.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> scancell.build_fmu(scancell.cell_json(setup.cell, nominal, seed=0), "cell.fmu", version=3)
    >>> with scancell.CellInstance("cell.fmu") as cell:
    ...     cell.step_to(1000)
    """
    contents = fmu_contents(runtime_dir(), description_text(description, indent=1), version, options or FmuOptions())
    with atomic_write(Path(path)) as temporary:
        write_archive(temporary, contents)


def build_sequencer_fmu(description: Mapping[str, Any], path: Path, version: FmiVersion) -> None:
    """Write the FMU of the sequencer of a cell, which commands it step by step, to `path` atomically.

    Parameters
    ----------
    description
        Description of the cell, as `cell_json` makes it.
    path
        File of the FMU.
    version
        Version of FMI: 2 or 3.

    Raises
    ------
    CellError
        If the native part is missing or refuses the description.
    OutputError
        If the file cannot be written.
    """
    contents = sequencer_contents(runtime_dir(), description_text(description, indent=1), version)
    with atomic_write(path) as temporary:
        write_archive(temporary, contents)


def build_sensor_fmu(description: Mapping[str, Any], path: Path) -> None:
    """Write the FMU (FMI 3) of a sensor in a cell, which sees what that of the cell moves, to `path` atomically.

    Parameters
    ----------
    description
        Description of the sensor and of what it sees, as `World.for_sensor_fmu` makes it.
    path
        File of the FMU.

    Raises
    ------
    CellError
        If the native part is missing or refuses the description.
    OutputError
        If the file cannot be written.
    """
    runtime = _runtime_of("sensor", "profile-sensor-describe")
    contents = sensor_contents(runtime, description_text(description))
    with atomic_write(path) as temporary:
        write_archive(temporary, contents)


@checked_arguments
def make_temporary_fmu(description: Mapping[str, Any], folder: str | Path, version: FmiVersion = 2) -> Path:
    """Write the unpacked FMU of a cell, for a `CellInstance` on this machine; the folder.

    It holds what an instance, a session and a guard need and no documentation; its libraries are a link to those of
    this installation.

    Parameters
    ----------
    description
        Description of the cell, as `cell_json` makes it.
    folder
        New folder of the FMU.
    version
        Version of FMI: 2 or 3.

    Raises
    ------
    CellError
        If the native part is missing or refuses the description.
    OutputError
        If the folder cannot be written.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> fmu = scancell.make_temporary_fmu(scancell.cell_json(setup.cell, nominal, seed=0), "fmu")
    >>> with scancell.CellInstance(fmu) as cell:
    ...     cell.get(cell.real_group(["truth.table.position[3]"])).round(3)
    array([...])
    """
    contents, folder = description_text(description), Path(folder)
    try:
        write_unpacked(folder, runtime_dir(), contents, version, FmuOptions(ahead=True))
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
    return folder


class ReusableCell(Closing):
    """Keeps an FMU instance from one `start` to the next and resets it where the new cell has the same variables.

    Use it as a context manager. Its files lie in a new folder in `folder`, or where the system keeps temporary files.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="scancell-cell-", dir=folder))
        self._instance: CellInstance | None = None
        self._built = 0

    def start(self, description: Mapping[str, Any], as_built: Sequence[str] = ()) -> CellInstance:
        """The instance at time 0, of the cell of a description (`cell_json`) with perturbations (``key=value``).

        The instance belongs to this object: it is valid until the next `start`, `discard` or `close`.

        Raises
        ------
        DescriptionError
            If a perturbation is unknown.
        CellError
            If the FMU cannot be built or refuses the cell.
        """
        if self._instance is not None:
            file = self._folder / "cell.json"
            file.write_text(json.dumps(description))
            try:
                self._instance.reset(file, parse_as_built(as_built, self._instance.units()))
            except ScancellError:  # its variables are others, or a new FMU refuses the cell, too
                self.discard()
            except BaseException:
                self.discard()
                raise
            else:
                return self._instance
        fmu = make_temporary_fmu(description, self._folder / f"fmu{self._built}")
        self._built += 1
        self._instance = CellInstance(fmu, parameters=lambda units: parse_as_built(as_built, units))
        return self._instance

    def discard(self) -> None:
        """Free the instance, which may be unusable after an error; the next `start` makes another."""
        instance, self._instance = self._instance, None
        if instance is not None:
            with suppress(Exception):
                instance.close()

    def close(self) -> None:
        """Free the instance and its files."""
        self.discard()
        shutil.rmtree(self._folder, ignore_errors=True)
