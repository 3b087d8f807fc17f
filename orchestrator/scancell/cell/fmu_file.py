"""Packs the native robot cell and a cell description into an FMU."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import scancell.cell
from scancell.arguments import checked_arguments
from scancell.cell.arm_dynamics import dynamics_json, mesh_json
from scancell.cell.as_built import parse_as_built
from scancell.cell.fmu_package.contents import (
    FmiVersion,
    FmuOptions,
    fmu_contents,
    sequencer_contents,
    write_archive,
    write_unpacked,
)
from scancell.cell.instance import CellInstance
from scancell.cell.sensing import sensing_json
from scancell.closing import Closing
from scancell.config.cell import CellDescription, PartDescription
from scancell.config.description import si_value, to_si
from scancell.config.devices import RESERVED_NAMES, ConveyorDescription, FurtherPartDescription, GripperDescription
from scancell.errors import CellError, DescriptionError, OutputError, ScancellError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, mass_properties
from scancell.nominal.cell import NominalCell, fmu_frame
from scancell.nominal.gripper import pose_json, pose_matrix, start_width

Array = NDArray[np.float64]

# Bodies that get contact shapes from their meshes; table, belts, parts and fingers have contact shapes of their own.
_CELL_BODIES = RESERVED_NAMES - {"table", "part", "finger1", "finger2"}
_FLOOR_SIZE = (200.0, 200.0, 1.0)  # m


def runtime_dir() -> Path:
    """Folder with the native library, its closure and the description printer.

    Raises
    ------
    CellError
        If the native part was not built.
    """
    for folder in scancell.cell.__path__:
        candidate = Path(folder) / "runtime"
        if (candidate / "robotcell-describe").is_file():
            return candidate
    raise CellError("the native robot cell is not installed; run `make setup`")


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
        Of the noise of encoders and sensors.
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
    nominal.require_simulated()
    robot = [to_si(joint.model_dump(exclude={"mesh", "drive", "inertia"})) for joint in cell.robot.joint]
    for joint, start in zip(robot, nominal.home, strict=True):
        joint["start"] = float(start)
        if joint["beta"] == 0.0:  # as in most arms
            del joint["beta"]
    table = to_si(cell.table.model_dump(exclude={"pose", "reflectance", "material", "platter_mesh", "base_mesh"}))
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
            "dynamics": dynamics_json(cell) if cell.robot.drive == "dynamic" else None,
        },
        "tool": {"flange_from_sensor": pose_json(nominal.flange_from_sensor)},
        "table": {"world_from_table": pose_json(nominal.world_from_table), "start": 0.0, **table},
        "conveyors": [_conveyor_json(conveyor) for conveyor in cell.conveyor],
        "parts": _parts_json(cell, nominal),
        "gripper": None if cell.gripper is None else _gripper_json(cell.gripper),
        "contact": _contact_json(cell, nominal),
        **sensing_json(cell, nominal, collision_outputs=collision_outputs),
    }


def _contacts_occur(cell: CellDescription) -> bool:
    """Whether anything that moves by forces can touch another body; if not, contact shapes are left out."""
    fixtures = (cell.part.fixture, *(part.fixture for part in cell.further_part))
    return "free" in fixtures or cell.robot.drive == "dynamic"


def _parts_json(cell: CellDescription, nominal: NominalCell) -> list[dict[str, Any]]:
    """The scanned part first."""
    further = [(part.description, part.mesh) for part in nominal.further_parts]
    hulls = _contacts_occur(cell)
    arrival = cell.part.arrival
    support_from_part = nominal.table_from_part if arrival is None else pose_matrix(arrival.pose)
    scanned = {"name": "part", "stands_on": "table" if arrival is None else arrival.stands_on}
    return [
        {**scanned, **_part_json(cell.part, nominal.part, support_from_part, hull=hulls)},
        *(
            {
                "name": described.name,
                "stands_on": described.stands_on,
                **_part_json(described, mesh, pose_matrix(described.pose), hull=hulls),
            }
            for described, mesh in further
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
        "inertial": _inertial_json(mesh, part.density_kg_m3) if part.fixture == "free" else None,
        "hull": mesh_json(mesh.hull.vertices, mesh.hull.faces) if hull else None,
    }


def _inertial_json(mesh: Mesh, density: float) -> dict[str, Any]:
    properties = mass_properties(mesh, density)
    return {
        "mass": properties.mass,
        "centre_of_mass": properties.centre_of_mass.tolist(),
        "inertia": properties.inertia.tolist(),
    }


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
    solid = _CELL_BODIES | {item.name for item in cell.obstacle}
    bodies = [(body.name, fmu_frame(body.moves_with), body.mesh.hull) for body in nominal.bodies if body.name in solid]
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
        Of the cell, as `cell_json` makes it.
    path
        File of the FMU.
    version
        Of FMI: 2 or 3.
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
        Of the cell, as `cell_json` makes it.
    path
        File of the FMU.
    version
        Of FMI: 2 or 3.

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


@checked_arguments
def make_temporary_fmu(description: Mapping[str, Any], folder: str | Path, version: FmiVersion = 2) -> Path:
    """Write the unpacked FMU of a cell, for a `CellInstance` on this machine; the folder.

    It holds what an instance, a session and a guard need and no documentation; its libraries are a link to those of
    this installation.

    Parameters
    ----------
    description
        Of the cell, as `cell_json` makes it.
    folder
        New folder of the FMU.
    version
        Of FMI: 2 or 3.

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
