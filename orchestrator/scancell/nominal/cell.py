"""The nominal cell, from its description: the data that planning and reconstruction may use."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.config.cell import AxisDescription, CellDescription, sensor_frame
from scancell.config.description import si_value, to_si
from scancell.config.devices import ConveyorDescription, LightDescription
from scancell.config.robot import RobotDescription
from scancell.errors import CommandError, DescriptionError
from scancell.geometry import pose
from scancell.geometry.arm import Arm, HeldJoint
from scancell.geometry.arm import Joint as ArmJoint
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.geometry.tree import WORLD, Joint, Tree, z_along
from scancell.nominal.parts import (
    Body,
    FurtherPart,
    cell_bodies,
    gripper_from_finger,
    lay_down,
    load_part,
    obstacle_bodies,
    pose_matrix,
    refuse_unstable,
    start_width,
    tool_matrix,
)
from scancell.values import Value

# Shares of the friction that turning and speeding up may each take at the part's farthest point: together half of it,
# because the pressure under the part is not even.
_OF_SPEED, _OF_ACCELERATION = 0.4, 0.3


_PLACEHOLDER = box_mesh((0.01, 0.01, 0.01), "no part")

OCCUPIED = "occupied["  # begins the names of bodies that are measured space; no description can have such a name

_DH = ("theta", "d", "a", "alpha", "beta")
_POSE = ("x", "y", "z", "rx", "ry", "rz")
WOBBLE = ("rx_cos", "rx_sin", "ry_cos", "ry_sin")


def table_limits(cell: CellDescription, part: Mesh, table_from_part: NDArray[np.float64]) -> tuple[float, float]:
    """Speed (rad/s) and acceleration (rad/s²) of the table: its limits, or lower ones at which friction holds the part.

    At a distance R from the axis, friction μ holds what turns at ω and speeds up by α while
    ``sqrt((ω² R)² + (α R)²) < μ g``.
    """
    speed, acceleration = np.radians([cell.table.max_speed_deg_s, cell.table.max_acceleration_deg_s2]).tolist()
    if cell.part.fixture != "free":
        return speed, acceleration
    used = part.vertices[np.unique(part.faces)]
    radius = float(np.hypot(*pose.transform_points(table_from_part, used)[:, :2].T).max())
    held = min(cell.part.friction, cell.table.friction) * cell.world.gravity_m_s2
    return min(speed, float(np.sqrt(_OF_SPEED * held / radius))), min(acceleration, _OF_ACCELERATION * held / radius)


def with_table(q: ArrayLike, table: ArrayLike) -> Array:
    """Positions (n, axes), rad, of joints (joints,) or (n, joints) and table angles () or (n,)."""
    return np.stack(np.broadcast_arrays(*np.atleast_2d(q).T, table), -1)


def fmu_frame(frame: str) -> str:
    """Name of a frame in the FMU and its recordings, which number the part that is scanned among the others."""
    if frame == "part":
        return "part[1]"
    return frame if re.fullmatch(r"world|table|sensor|\w+\[\d+\]", frame) else f"axis_frame.{frame}"


@dataclass(frozen=True)
class Lamp:
    """An external light, W and metres, at a pose (4, 4) in the frame that `moves_with` names.

    Either `in_band` or `spectrum` (wavelength, full width at half maximum) determines the share that filters pass.
    """

    name: str
    moves_with: str
    kind: Literal["point", "rectangle", "disc"]
    frame_from_lamp: Array
    size: tuple[float, float]
    power: float
    in_band: float | None
    spectrum: tuple[float, float] | None


@dataclass(frozen=True)
class Axis:
    """An axis beside joints and table: its joint, its limits and its position at the start, rad or m."""

    joint: Joint
    start: float
    min: float
    max: float
    max_speed: float
    max_acceleration: float
    max_jerk: float

    @property
    def name(self) -> str:
        """Name of the axis, and of the frame that it carries."""
        return self.joint.axis

    @property
    def unit(self) -> str:
        """Unit of its positions in texts."""
        return "mm" if self.joint.kind == "prismatic" else "deg"

    @property
    def per_unit(self) -> float:
        """SI value of one `unit`."""
        return 1e-3 if self.joint.kind == "prismatic" else float(np.pi / 180)

    def in_words(self, position: float) -> str:
        """A position, rad or m, with its unit."""
        return f"{position / self.per_unit:.1f} {self.unit}"


@dataclass(frozen=True)
class Belt:
    """The belt on which the scanned part arrives.

    Attributes
    ----------
    conveyor, description
        Number of the conveyor, from 1, and its description.
    world_from_belt, belt_from_part
        Poses (4, 4) of the belt's frame and of the part on it, both at travel 0.
    """

    conveyor: int
    description: ConveyorDescription
    world_from_belt: Array
    belt_from_part: Array


@dataclass(frozen=True, eq=False, repr=False)
class NominalCell(Value):
    """Nominal geometry of arm, tool, table and part, made by `nominal_cell`.

    Poses are (4, 4) ``target_from_source``, metres.

    Attributes
    ----------
    arm
        Kinematics of the arm: forward (``arm.fk``), inverse (``arm.ik``), and the limits of its joints.
    sensor
        The sensor of the tool as a fixed joint, on the flange or on a post: in the world, or on a further axis.
    world_from_table
        Pose (4, 4) of the table at angle 0; it turns about its z.
    table_from_part
        Pose (4, 4) of the part on the table, or on the flange that holds it.
    home
        Joint angles (joints,) of the home position, rad.
    table_radius
        Radius of the platter, m.
    table_max_speed, table_max_acceleration, table_max_jerk
        Limits of the table, rad/s, rad/s², rad/s³.
    table_turns
        Whether the table turns, or is fixed as a bench.
    part
        Mesh of the part, in its own frame; a small box where there is none.
    bodies
        What can occlude, be lit, or be hit: each has a ``name``, a ``mesh`` (m), and ``moves_with``, the name of the
        frame of this mesh (see `frame_poses`).
    lamps
        External lights.
    further_parts
        Parts beside the one that is scanned.
    flange_from_finger
        Poses (2, 4, 4) of the gripper's fingers as they start; None without a gripper.
    flange_from_tcp
        Poses (4, 4) of the named tools on the flange, by name.
    user_frames
        User frames by name, as fixed joints.
    eccentricity
        Eccentricity of the platter (x, y), m, in an estimated cell.
    wobble
        Wobble of the table's axis (rx_cos, rx_sin, ry_cos, ry_sin), rad, in an estimated cell.
    trigger_latency
        Time by which exposures are later than the angles that are latched for them, s, in an estimated cell.
    belt
        On which the part arrives; None: it does not.
    world_from_conveyors
        Poses (4, 4) of the belts at travel 0.
    belt_scales
        Relative scale errors of the encoders of the belts, which read the travel times 1 + scale, in an estimated cell.
    support
        Frame that carries the part in the scan: ``table``, ``conveyor[1]`` … of its belt, or the last link.
    arm_on, table_on
        Frames that carry the arm and the table: ``world``, or that of a further axis.
    further_axes
        Axes beside joints, table and conveyors, after what carries them.
    further_sensors
        Sensors beside that of the tool, as fixed joints.
    held_at
        Positions, rad or m, of axes beside joints and table that were held, see `with_axes_held`.

    Examples
    --------
    >>> setup = scancell.load_setup()
    >>> nominal = scancell.nominal_cell(setup.cell, scancell.load_part("part.stl"))
    >>> print(nominal.world_from_sensor(nominal.home)[:3, 3].round(3))
    [0.412 0.289 0.313]
    >>> nominal.tree.axes
    ('joint[1]', 'joint[2]', 'joint[3]', 'joint[4]', 'joint[5]', 'joint[6]', 'table')
    >>> nominal.part_from_sensor([*nominal.home, np.pi / 2]).shape
    (4, 4)
    """

    arm: Arm
    sensor: Joint
    world_from_table: Array
    table_from_part: Array
    home: Array
    table_radius: float
    table_max_speed: float
    table_max_acceleration: float
    table_max_jerk: float
    part: Mesh
    bodies: tuple[Body, ...]
    table_turns: bool = True
    lamps: tuple[Lamp, ...] = ()
    further_parts: tuple[FurtherPart, ...] = ()
    flange_from_finger: Array | None = None
    flange_from_tcp: Mapping[str, Array] = field(default_factory=dict)
    user_frames: Mapping[str, Joint] = field(default_factory=dict)
    eccentricity: tuple[float, ...] = (0.0, 0.0)
    wobble: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    trigger_latency: float = 0.0
    belt: Belt | None = None
    world_from_conveyors: tuple[Array, ...] = ()
    belt_scales: tuple[float, ...] = ()
    support: str = "table"
    arm_on: str = WORLD
    table_on: str = WORLD
    further_axes: tuple[Axis, ...] = ()
    further_sensors: tuple[Joint, ...] = ()
    held_at: tuple[float, ...] = ()

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that the controller moves, the first ones of the `tree`: joints, table, further axes."""
        return self.tree.axes[: len(self.arm.joints) + 1 + len(self.further_axes)]

    @property
    def prismatic(self) -> NDArray[np.bool_]:
        """Whether each of the axes is prismatic, (axes,): its positions are in m."""
        further = (axis.joint.kind == "prismatic" for axis in self.further_axes)
        return np.array([False] * (len(self.arm.joints) + 1) + list(further), bool)

    @property
    def start(self) -> Array:
        """Positions of the axes at the start, (axes,), rad or m: the home joints, the table at 0."""
        return np.array([*self.home, 0.0, *(axis.start for axis in self.further_axes)])

    def with_further_axes(self, axes: ArrayLike) -> Array:
        """Positions (..., axes) of all axes: joints and table as given (..., joints + 1), the others at their start."""
        given = np.asarray(axes, float)
        further = self.start[given.shape[-1] :]
        return np.concatenate([given, np.broadcast_to(further, (*given.shape[:-1], len(further)))], -1)

    @property
    def axis_max_speed(self) -> Array:
        """Speed limits of the axes, (axes,), rad/s or m/s."""
        return np.array([*self.arm.max_speed, self.table_max_speed, *(axis.max_speed for axis in self.further_axes)])

    @property
    def axis_max_acceleration(self) -> Array:
        """Acceleration limits of the axes, (axes,), rad/s² or m/s²."""
        further = (axis.max_acceleration for axis in self.further_axes)
        return np.array([*self.arm.max_acceleration, self.table_max_acceleration, *further])

    def with_axes_held(self, positions: ArrayLike | None = None) -> NominalCell:
        """The cell in which joints and table are the only axes, and all further ones rest.

        Parameters
        ----------
        positions
            Positions (k,) of the further axes, rad or m; default: those at the start.
        """
        if not self.further_axes:
            return self
        first = len(self.arm.joints) + 1
        at = self.start
        at[first:] = at[first:] if positions is None else positions
        frames = [axis.name for axis in self.further_axes]
        placed = self.tree.place(at, [WORLD, *frames])

        def body(one: Body) -> Body:
            if one.moves_with not in frames:
                return one
            return replace(one, moves_with=WORLD, mesh=one.mesh.transformed(placed[one.moves_with]))

        def mounted(one: Joint) -> Joint:
            if one.parent not in frames:
                return one
            return replace(one, parent=WORLD, parent_from_joint=placed[one.parent] @ one.parent_from_joint)

        return replace(
            self,
            arm=replace(self.arm, world_from_base=placed[self.arm_on] @ self.arm.world_from_base),
            world_from_table=placed[self.table_on] @ self.world_from_table,
            bodies=tuple(body(one) for one in self.bodies),
            sensor=mounted(self.sensor),
            further_sensors=tuple(mounted(one) for one in self.further_sensors),
            arm_on=WORLD,
            table_on=WORLD,
            further_axes=(),
            held_at=tuple(at[first:].tolist()),
        )

    @cached_property
    def tree(self) -> Tree:
        """Frames and axes of the cell, nominal or estimated.

        The axes are ``joint[1]`` …, ``table``, further ones by their names, and ``conveyor[1]`` …, in rad or m.
        """
        flange, (base, *links) = self.arm.flange, self.arm.tree.joints
        joints = [replace(base, parent=self.arm_on), *links, self.sensor]
        eccentric = pose.translation((*self.eccentricity, 0.0))
        joints.append(
            Joint(
                *("table", self.table_on, "revolute", "table"),
                parent_from_joint=self.world_from_table,
                joint_from_frame=eccentric,
                wobble=self.wobble,
            )
        )
        scales = self.belt_scales or [0.0] * len(self.world_from_conveyors)
        for number, (world_from_belt, scale) in enumerate(zip(self.world_from_conveyors, scales, strict=True), 1):
            name = f"conveyor[{number}]"
            along = z_along(0)  # a belt moves along its x
            poses = world_from_belt @ along, along.T
            joints.append(Joint(name, WORLD, "prismatic", name, 0.0, *poses, gain=1.0 / (1.0 + scale)))
        joints.append(Joint("part", self.support, parent_from_joint=self.support_from_part))
        for number, further in enumerate(self.further_parts, 2):
            placed = further.description
            joints.append(Joint(f"part[{number}]", placed.stands_on, parent_from_joint=pose_matrix(placed.pose)))
        fingers = () if self.flange_from_finger is None else self.flange_from_finger
        for number, flange_from_finger in enumerate(fingers, 1):
            joints.append(Joint(f"finger[{number}]", flange, parent_from_joint=flange_from_finger))
        further_joints = [axis.joint for axis in self.further_axes]
        axes = (*self.arm.tree.axes, "table", *(joint.axis for joint in further_joints))
        return Tree([*joints, *further_joints, *self.further_sensors], axes)

    def carrier(self, frame: str) -> str:
        """Frame that carries what moves with a frame: that of a further sensor is fixed to another one."""
        return next((one.parent for one in self.further_sensors if one.frame == frame), frame)

    def require_scanned(self) -> None:
        """Raise `DescriptionError` where nothing moves part and sensor past each other.

        The arm carries the sensor past a part on the table or on a conveyor, or holds the part before a sensor on a
        post; or a conveyor carries the part past such a sensor.
        """
        if self.holds_part == self.carries_sensor and (self.holds_part or self.support_kind != "belt"):
            raise DescriptionError(
                f"the arm carries {'both part and' if self.holds_part else 'neither part nor'} sensor",
                key="cell.part.moves_with",
                value="flange" if self.holds_part else "table",
                expected='"table" where cell.tool.moves_with is "flange", and "flange" otherwise',
            )

    @property
    def carries_sensor(self) -> bool:
        """Whether the sensor is on the flange."""
        return self.sensor.parent == self.arm.flange

    @property
    def holds_part(self) -> bool:
        """Whether the part is on the flange."""
        return self.support == self.arm.flange

    @property
    def arm_rests(self) -> bool:
        """Whether table and further axes alone move the part past the sensor, which the arm does not carry."""
        return self.support == "table" and not self.carries_sensor

    @property
    def support_kind(self) -> Literal["table", "belt", "flange"]:
        """Kind of carrier of the part in the scan."""
        return "flange" if self.holds_part else "table" if self.support == "table" else "belt"

    @property
    def flange_from_sensor(self) -> Array:
        """Pose (4, 4) of the sensor on the flange; `DescriptionError` where the flange does not carry it."""
        if not self.carries_sensor:
            key, carrier = "cell.tool.moves_with", self.sensor.parent
            raise DescriptionError("the sensor is not on the flange", key=key, value=carrier, expected="flange")
        return self.sensor.parent_from_joint

    def world_from_flange(self, frame_from_sensor: Array, axes: ArrayLike = (), frame: str = "part") -> Array:
        """Pose (..., 4, 4) of the flange that brings sensor and part together.

        Parameters
        ----------
        frame_from_sensor
            Poses (..., 4, 4) of the sensor in a frame of the part, or of what carries it.
        axes
            Positions (..., k) of the `axes`, of which those of the joints do not matter, rad or m.
        frame
            Name of the frame.
        """
        if not self.holds_part:
            return np.asarray(self.world_from(frame, axes) @ frame_from_sensor @ pose.inverse(self.flange_from_sensor))
        _, flange_from_frame = self.tree.carrier_of(frame, self.axes)
        sensor_from_flange = pose.inverse(np.asarray(flange_from_frame @ frame_from_sensor))
        return np.asarray(self.world_from_sensor(axes) @ sensor_from_flange)

    def world_from(self, frame: str, axes: ArrayLike = ()) -> Array:
        """Pose (..., 4, 4) of a frame of the `tree` at positions (..., k) of the `axes`; those not stated are at 0."""
        return self.tree.place(axes, [frame])[frame]

    def world_from_sensor(self, axes: ArrayLike) -> Array:
        """Pose (..., 4, 4) of the sensor at positions (..., k) of the `axes`, rad or m."""
        return self.world_from("sensor", axes)

    def part_from_sensor(self, axes: ArrayLike, number: int = 1) -> Array:
        """Pose (..., 4, 4) of a sensor, by its number, in the frame of the part at positions (..., k) of the `axes`."""
        sensor = sensor_frame(number)
        placed = self.tree.place(axes, ["part", sensor])
        return np.asarray(pose.inverse(placed["part"]) @ placed[sensor])

    @property
    def scanned_part(self) -> Mesh | None:
        """Mesh of the part; None where there is none."""
        return self.part if any(body.moves_with == "part" for body in self.bodies) else None

    @property
    def support_from_part(self) -> Array:
        """Pose (4, 4) of the part in the frame of what carries it."""
        return self.required_belt().belt_from_part if self.support_kind == "belt" else self.table_from_part

    def with_part_at(self, support_from_part: Array) -> NominalCell:
        """The cell with the part at the pose `support_from_part` (4, 4) in the frame of what carries it."""
        if self.support_kind == "belt":
            return replace(self, belt=replace(self.required_belt(), belt_from_part=support_from_part))
        return replace(self, table_from_part=support_from_part)

    def on_belt(self) -> NominalCell:
        """The cell in which the part is scanned while its belt carries it.

        Raises `DescriptionError` if the part does not arrive on a conveyor.
        """
        return replace(self, support=f"conveyor[{self.required_belt().conveyor}]")

    def required_belt(self) -> Belt:
        """`belt`; `DescriptionError` if the part does not arrive on a conveyor."""
        if self.belt is None:
            raise DescriptionError(
                "a scan on a belt (scan.belt) needs a part that starts on a conveyor",
                key="cell.part.arrival",
                expected='stands_on = "conveyor[1]"',
            )
        return self.belt

    def frame_poses(self, axes: ArrayLike = ()) -> dict[str, Array]:
        """Poses ``world_from_frame`` (..., 4, 4) by name of every frame that a body can move with.

        At positions (..., k) of the `axes` of the `tree`; those not stated are at 0. The frames are ``world``,
        ``link[1]`` …, ``sensor``, ``table``, ``part``, ``part[2]`` … of further parts, ``finger[1]`` and ``finger[2]``.
        """
        names = [joint.frame for joint in self.tree.joints if not joint.frame.startswith(("base", "conveyor["))]
        return self.tree.place(axes, [WORLD, *names])

    def body_poses(self, axes: ArrayLike) -> Array:
        """Poses (..., bodies, 4, 4) in the world, in the order of `bodies`, at positions of the `axes`."""
        frames = self.tree.place(axes, [body.moves_with for body in self.bodies])
        return np.stack([frames[body.moves_with] for body in self.bodies], -3)


@checked_arguments
def nominal_cell(cell: CellDescription, part: Mesh | None) -> NominalCell:
    """Assemble the nominal cell around a part.

    Parameters
    ----------
    cell
        Description of the cell (`load_setup`).
    part
        Mesh in its own frame, m (`load_part`); None: the table is empty; where a mesh is required, a small box
        replaces the part.

    Raises
    ------
    MeshError
        If a mesh that the description names cannot be used.
    CellError
        If the part is free and would not rest stably.

    Examples
    --------
    >>> nominal = scancell.nominal_cell(scancell.load_setup().cell, scancell.load_part("part.stl"))
    >>> [body.name for body in nominal.bodies][-4:]
    ['sensor', 'table', 'table_base', 'part']
    """
    robot = cell.robot
    is_empty, part = part is None, part or _PLACEHOLDER
    table_from_part = lay_down(part, cell.part)
    if cell.part.fixture == "free" and not is_empty:
        refuse_unstable(part, table_from_part, cell.part)
    further = tuple(FurtherPart(part_, load_part(part_.mesh, part_.unit)) for part_ in cell.further_part)
    table_max_speed, table_max_acceleration = table_limits(cell, part, table_from_part)
    nominal = NominalCell(
        arm=arm_of(robot),
        sensor=Joint(
            "sensor",
            f"link[{len(robot.joint)}]" if cell.tool.moves_with == "flange" else cell.tool.moves_with,
            parent_from_joint=tool_matrix(cell.tool),
        ),
        world_from_table=pose_matrix(cell.table.pose),
        table_from_part=table_from_part,
        home=np.radians(robot.home_deg),
        table_radius=si_value(cell.table, "radius_mm"),
        table_max_speed=table_max_speed,
        table_max_acceleration=table_max_acceleration,
        table_max_jerk=si_value(cell.table, "max_jerk_deg_s3"),
        table_turns=cell.table.turns,
        part=part,
        lamps=tuple(_lamp(f"light[{i}]", light) for i, light in enumerate(cell.light, 1)),
        bodies=cell_bodies(cell, part, further),
        flange_from_finger=None
        if cell.gripper is None
        else pose_matrix(cell.gripper.pose) @ gripper_from_finger(start_width(cell.gripper)),
        flange_from_tcp={tcp.name: pose_matrix(tcp.flange_from_tcp) for tcp in cell.tcp},
        user_frames={
            frame.name: Joint(frame.name, frame.moves_with, parent_from_joint=pose_matrix(frame.pose))
            for frame in cell.frame
        },
        further_parts=further,
        belt=_belt(cell),
        support="table" if cell.part.moves_with == "table" else f"link[{len(robot.joint)}]",
        arm_on=cell.robot_moves_with,
        table_on=cell.table.moves_with,
        further_axes=further_axes(cell),
        further_sensors=tuple(
            Joint(sensor_frame(number), sensor.moves_with, parent_from_joint=pose_matrix(sensor.pose))
            for number, sensor in enumerate(cell.further_sensor, 2)
        ),
        world_from_conveyors=tuple(pose_matrix(belt.pose) for belt in cell.conveyor),
    )
    return without_bodies(nominal, ["part"]) if is_empty else nominal


def without_bodies(nominal: NominalCell, moves_with: Collection[str]) -> NominalCell:
    """The cell without the bodies that move with some frames, such as ``part``."""
    return replace(nominal, bodies=tuple(body for body in nominal.bodies if body.moves_with not in moves_with))


def with_unknown_obstacles(nominal: NominalCell, cell: CellDescription) -> NominalCell:
    """The cell with the obstacles that its description hides from planning and reconstruction.

    For the FMU and the ray tracer only.

    Raises `MeshError` if the mesh of an obstacle cannot be used.
    """
    return replace(nominal, bodies=(*nominal.bodies, *obstacle_bodies(cell, known=False)))


def arm_of(robot: RobotDescription) -> Arm:
    """Kinematics of a described arm; joints that are held without values are held at their home angles."""
    names = [item.name for item in fields(ArmJoint)]
    joints = [ArmJoint(**{name: si[name] for name in names}) for si in to_si([j.model_dump() for j in robot.joint])]
    held = [
        HeldJoint(one.joint - 1, tuple(np.radians(one.values_deg or (robot.home_deg[one.joint - 1],)).tolist()))
        for one in robot.held
    ]
    return Arm(joints, pose_matrix(robot.base), tuple(held))


def further_axes(cell: CellDescription) -> tuple[Axis, ...]:
    """The described axes beside joints, table and conveyors."""
    return tuple(_further_axis(axis) for axis in cell.axis)


def _further_axis(axis: AxisDescription) -> Axis:
    si = to_si(axis.model_dump())
    limits = {key: si[key] for key in ("start", "min", "max", "max_speed", "max_acceleration", "max_jerk")}
    along = z_along("xyz".index(axis.along))
    joint = Joint(
        *(axis.name, axis.moves_with, axis.kind, axis.name),
        parent_from_joint=pose_matrix(axis.pose) @ along,
        joint_from_frame=along.T,
    )
    return Axis(joint, **limits)


def _belt(cell: CellDescription) -> Belt | None:
    arrival = cell.part.arrival
    if arrival is None or arrival.conveyor is None:
        return None
    conveyor = cell.conveyor[arrival.conveyor - 1]
    return Belt(arrival.conveyor, conveyor, pose_matrix(conveyor.pose), pose_matrix(arrival.pose))


def _lamp(name: str, light: LightDescription) -> Lamp:
    si = to_si(light.model_dump(exclude={"pose"}))
    size = {"point": (0.0, 0.0), "rectangle": (si["width"], si["height"]), "disc": (si["diameter"], si["diameter"])}
    spectrum = None if si["wavelength"] is None else (si["wavelength"], si["bandwidth"])
    place = pose_matrix(light.pose)
    return Lamp(name, light.frame, light.kind, place, size[light.kind], si["power"], si["in_band"], spectrum)


def as_estimated(nominal: NominalCell, cell: CellDescription) -> NominalCell:
    """The nominal cell with the deviations that its description states as estimated, if it does."""
    return nominal if cell.estimated is None else estimated_cell(nominal, cell.estimated.deviations())


def estimated_cell(nominal: NominalCell, deviations: Mapping[str, float]) -> NominalCell:
    """The nominal cell with deviations by the names of as-built parameters, SI; those not given are 0."""

    def values(group: str, *keys: str) -> list[float]:
        return [deviations.get(f"{group}.{key}", 0.0) for key in keys]

    def delta(group: str) -> NDArray[np.float64]:
        found = values(group, *_POSE)
        return pose.from_euler_xyz(found[:3], found[3:])

    sensor, grasp = nominal.sensor, any(values("grasp", *_POSE))

    def displaced(axis: Axis) -> Axis:
        joint = axis.joint
        at_0 = joint.parent_from_joint @ joint.joint_from_frame @ delta(f"axis.{axis.name}")
        return replace(axis, joint=replace(joint, parent_from_joint=at_0 @ pose.inverse(joint.joint_from_frame)))

    belts = [f"conveyor[{number}]" for number in range(1, len(nominal.world_from_conveyors) + 1)]
    turned = tuple(at @ delta(belt) for at, belt in zip(nominal.world_from_conveyors, belts, strict=True))
    joints = [
        replace(joint, **{key: getattr(joint, key) + deviations.get(f"dh[{number}].{key}", 0.0) for key in _DH})
        for number, joint in enumerate(nominal.arm.joints, 1)
    ]
    return replace(
        nominal,
        arm=replace(nominal.arm, joints=joints),
        sensor=replace(sensor, parent_from_joint=sensor.parent_from_joint @ delta("tool")),
        table_from_part=nominal.table_from_part @ delta("grasp") if grasp else nominal.table_from_part,
        world_from_table=nominal.world_from_table @ delta("table"),
        further_axes=tuple(displaced(axis) for axis in nominal.further_axes),
        world_from_conveyors=turned,
        belt_scales=tuple(values(belt, "encoder_scale")[0] for belt in belts),
        belt=None if nominal.belt is None else replace(nominal.belt, world_from_belt=turned[nominal.belt.conveyor - 1]),
        eccentricity=(*values("platter", "x", "y"),),
        wobble=(*values("table", *(f"wobble_{key}" for key in WOBBLE)),),
        trigger_latency=deviations.get("trigger.latency", 0.0),
        further_sensors=tuple(
            replace(one, parent_from_joint=one.parent_from_joint @ delta(one.frame)) for one in nominal.further_sensors
        ),
    )


def tool_names(nominal: NominalCell) -> tuple[str, ...]:
    """``sensor``, or ``flange`` where this does not carry it, ``gripper`` if there is one, and the described tools."""
    gripper = () if nominal.flange_from_finger is None else ("gripper",)
    return ("sensor" if nominal.carries_sensor else "flange", *gripper, *nominal.flange_from_tcp)


def frame_names(nominal: NominalCell) -> tuple[str, ...]:
    """``base``, ``table``, and the user frames of the description."""
    return ("base", "table", *nominal.user_frames)


def flange_from_tool(nominal: NominalCell, tool: str | None = None) -> Array:
    """Pose (4, 4) of a tool on the flange, by default the first one of `tool_names`.

    The origin of ``gripper`` lies between its pads.

    Raises
    ------
    CommandError
        If `tool` is ``gripper`` and the cell has none.
    DescriptionError
        If the cell has no such tool.
    """
    tool = tool_names(nominal)[0] if tool is None else tool
    if tool == "sensor" and nominal.carries_sensor:
        return nominal.flange_from_sensor
    if tool == "flange" and not nominal.carries_sensor:
        return np.eye(4)
    if tool in nominal.flange_from_tcp:
        return nominal.flange_from_tcp[tool]
    if tool != "gripper":
        raise DescriptionError(key="tool", value=tool, expected=_listed(tool_names(nominal)))
    fingers = nominal.flange_from_finger
    if fingers is None:
        raise CommandError("the cell has no gripper")
    flange_from_gripper = fingers[0].copy()
    flange_from_gripper[:3, 3] = fingers[:, :3, 3].mean(0)
    return np.asarray(flange_from_gripper)


def world_from_tool(nominal: NominalCell, axes: ArrayLike) -> Array:
    """Pose (4, 4) of the tool that motions in space move unless they name another one, see `tool_names`."""
    return np.asarray(nominal.world_from(nominal.arm.flange, axes) @ flange_from_tool(nominal))


def world_from_frame(nominal: NominalCell, frame: str, axes: ArrayLike) -> Array:
    """Pose (4, 4) of ``base``, ``table`` or a user frame at positions of the axes.

    Raises
    ------
    DescriptionError
        If the cell has no such frame.
    """
    if frame in ("base", "table"):
        return nominal.world_from(frame, axes)
    if frame not in nominal.user_frames:
        raise DescriptionError(key="frame", value=frame, expected=_listed(frame_names(nominal)))
    found = nominal.user_frames[frame]
    return np.asarray(nominal.world_from(found.parent, axes) @ found.parent_from_joint)


def _listed(names: Collection[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
