"""Cells of a campaign: described, with parts that extend beyond the table, and with posts in the way of these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.cell.fmu_file import SENSOR_KEYS
from scancell.config.cell import CellDescription
from scancell.config.files import assets_dir
from scancell.config.loading import load_setup
from scancell.config.material import Material
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, decimated, joined
from scancell.guard.guard import Guard, GuardSettings
from scancell.guard.parts import movable_parts
from scancell.nominal.cell import NominalCell, flange_from_tool, nominal_cell, with_table
from scancell.nominal.parts import Body, gripper_from_finger, pose_matrix
from scancell.proximity.judge import Judge
from scancell.proximity.scene import ProximityScene, arm_chain
from scancell.scanning.session import settings_of, touching, with_finger_travel

_FOOT = (0.32, 0.05, 0.006)  # m: bounding boxes are centred on the table's axis
_SEGMENTS = 14  # of the ring
_FEW_FACES = 400
_DESCRIBED = 0.25  # share of the worlds with the meshes and encoders of the description
_RANDOM, _NEARLY = 40, 3e-3  # random axes, and m, within which bodies are always nearly in contact
_GRIPPED = box_mesh((0.04, 0.04, 0.03), "box").transformed(pose.translation((0.0, 0.0, 0.015)))
_GRIPS = 0.2  # share of the worlds in which the gripper holds a part: their runs take ten times as long
_GRIPPED_AT = 123.0, (0.370, -0.312, 0.149)  # mm on the belt, and the gripper, m: fingers around the part

POSTS = {  # m: fixed bodies by part, in its frame at the angle 0 of the table: post, and hook in an opening
    "plate": ((0.012, 0.012, 0.16), (0.155, 0.0, 0.08), 1.1),
    "post": ((0.012, 0.012, 0.25), (0.155, 0.0, 0.125), 1.1),
    "ring": ((0.012, 0.012, 0.25), (0.072, 0.0, 0.14), 0.5),
    "bracket": ((0.012, 0.012, 0.12), (0.09, 0.0, 0.10), 0.0),
}


def standing_parts() -> dict[str, Mesh]:
    """Parts by name, m, each on a foot that is longer than the table: a plate, a post, a segment of a ring, a C."""
    plate = _box((0.004, 0.16, 0.15), (0.155, 0.0, 0.075))
    post = _box((0.01, 0.01, 0.22), (0.15, 0.0, 0.11))
    angles = np.radians(np.linspace(-30.0, 210.0, _SEGMENTS))
    ring = [
        _box((0.012, 0.035, 0.012), (0.06, 0.07 * np.cos(angle), 0.09 + 0.07 * np.sin(angle)), float(angle))
        for angle in angles
    ]
    # The ring's plane is across the foot: the table moves it along its axis and across.
    legs = [_box((0.012, 0.012, 0.06), (0.06, side * 0.0606, 0.03)) for side in (-1, 1)]
    around = np.radians(np.linspace(45.0, 315.0, _SEGMENTS))
    bracket = [
        box_mesh((0.012, 0.048, 0.1)).transformed(
            pose.from_rotation(pose.rotation_about(2, a), (0.09 * np.cos(a), 0.09 * np.sin(a), 0.056))
        )
        for a in around
    ]
    found = {"plate": [plate], "post": [post], "ring": [*ring, *legs], "bracket": bracket}
    return {name: joined([box_mesh(_FOOT), *boxes], name) for name, boxes in found.items()}


def _box(size: tuple[float, float, float], centre: tuple[float, float, float], angle: float = 0.0) -> Mesh:
    """A box at `centre`, m, turned about x by `angle`, rad."""
    return box_mesh(size).transformed(pose.from_rotation(pose.rotation_about(0, angle), centre))


def described_cells(cell: str | None) -> dict[str, CellDescription]:
    """The cell of a file, or all shipped ones, with motors and gears and with four joints in addition, by name.

    The shipped arm of seven joints is one of a URDF.
    """
    if cell is not None:
        return {Path(cell).stem: load_setup(cell).cell}
    found = {path.stem: load_setup(path).cell for path in sorted((assets_dir() / "cells").glob("*.toml"))}
    default = found["default"]
    # Nothing pushes the arm: contact shapes are convex hulls, which meet before the surfaces that guard and judge know.
    found["default with motors"] = default.replace({"robot.drive": "dynamic", "contact.cell_bodies": False})
    robot = default.robot.model_copy(update={"joint": default.robot.joint[:4], "home_deg": default.robot.home_deg[:4]})
    found["four joints"] = default.model_copy(update={"robot": robot})
    return found


def with_encoders(described: CellDescription, rng: np.random.Generator) -> CellDescription:
    """The cell with encoders whose noise and steps together are those of the guard's settings, or as described."""
    if rng.random() < _DESCRIBED:
        return described
    table = len(described.robot.joint)
    sigma = np.broadcast_to(settings_of(described).noise, (table + 1 + len(described.axis),))
    steps = float(rng.choice([0.0, 0.5, 0.9]))

    def keys(noise: float, unit: str) -> dict[str, float]:
        # Just below: the settings that follow from it stay.
        return {
            f"encoder_noise{unit}": 0.9999 * noise * float(np.sqrt(1 - steps**2)),
            f"encoder_resolution{unit}": 0.9999 * noise * steps * float(np.sqrt(12)),
        }

    turning = keys(float(np.degrees(sigma[0])), "_deg")
    joints = tuple(joint.model_copy(update=turning) for joint in described.robot.joint)
    robot = described.robot.model_copy(update={"joint": joints})
    further = tuple(
        axis.model_copy(update=turning if axis.kind == "revolute" else keys(1e3 * float(noise), axis.unit))
        for axis, noise in zip(described.axis, sigma[table + 1 :], strict=True)
    )
    platter = described.table.model_copy(update=turning)
    return described.model_copy(update={"robot": robot, "table": platter, "axis": further})


@dataclass(frozen=True)
class World:
    """A cell as the guard knows it; the true bodies deviate from it by their stated errors.

    Attributes
    ----------
    described
        Description.
    nominal
        Geometry of all bodies with the part, which the judge uses.
    settings
        Settings of the guard.
    grips
        Whether the robot has a gripper around a free part at the start.
    """

    described: CellDescription
    nominal: NominalCell
    settings: GuardSettings
    grips: bool = False

    def guard(self) -> Guard:
        """A new guard of this cell, as `guard_of` makes it."""
        return self._first_guard.renewed()

    @cached_property
    def _first_guard(self) -> Guard:
        described = self.described
        known = with_finger_travel(self.nominal, described)
        return Guard(known, described.robot, self.settings, touching(known, described), movable_parts(described))

    @cached_property
    def _touching(self) -> tuple[tuple[str, str], ...]:
        """Fingers and what they may grip."""
        fingers = [body.name for body in self.nominal.bodies if body.moves_with.startswith("finger[")]
        return tuple((finger, "part") for finger in fingers)

    @cached_property
    def names(self) -> list[str]:
        """Bodies in the order of their poses."""
        return [body.name for body in self.nominal.bodies]

    @cached_property
    def pairs(self) -> list[tuple[str, str]]:
        """Pairs of bodies that are judged: all whose relative pose can change.

        Nothing of this list comes from that of the guard. Excepted are bodies on both sides of one joint, pairs that
        are in contact or nearly so at all axes, fingers and what they may grip, and a free part and what it may stand
        on.
        """
        frames = {body.name: self._carrier(body) for body in self.nominal.bodies}
        arm = ["base", *(f"link{i}" for i in range(1, len(self.nominal.arm.joints) + 1))]
        joined_pairs = {frozenset(pair) for pair in pairwise(arm)} | {frozenset(("table", "table_base"))}
        joined_pairs |= {frozenset(pair) for pair in self._touching}
        joined_pairs |= {frozenset(pair) for pair in combinations(("gripper", "finger1", "finger2"), 2)}
        if self.grips:
            supports = ("table", *(belt.name for belt in self.described.conveyor))
            joined_pairs |= {frozenset((support, "part")) for support in supports}
        pairs = [(a, b) for a, b in combinations(frames, 2) if frames[a] != frames[b] and {a, b} not in joined_pairs]
        lower, upper = self.nominal.arm.limits
        rng = np.random.default_rng(0)
        q, table = rng.uniform(lower, upper, (_RANDOM, len(lower))), rng.uniform(-3.0, 3.0, _RANDOM)
        scene = ProximityScene({body.name: body.mesh for body in self.nominal.bodies}, pairs)
        further = [rng.uniform(axis.min, axis.max, _RANDOM) for axis in self.nominal.further_axes]
        axes = np.column_stack([with_table(q, table), *further])
        farthest = scene.distances(self.nominal.body_poses(axes), _NEARLY, 1).max(0)
        return [pair for pair, distance in zip(pairs, farthest, strict=True) if distance >= _NEARLY]

    def _carrier(self, body: Body) -> str:
        moves_with = self.nominal.carrier(body.moves_with)
        if moves_with == "part" and not self.grips:
            return self.nominal.support
        return self.nominal.sensor.parent if moves_with == "sensor" else moves_with

    @cached_property
    def scene(self) -> ProximityScene:
        """Distances of the judged pairs."""
        return ProximityScene({body.name: body.mesh for body in self.nominal.bodies}, self.pairs)

    @cached_property
    def judge(self) -> Judge:
        """Contacts of the judged pairs by python-fcl."""
        meshes, kept = {body.name: body.mesh for body in self.nominal.bodies}, {frozenset(pair) for pair in self.pairs}
        others = [frozenset(pair) for pair in combinations(self.names, 2) if frozenset(pair) not in kept]
        return Judge(meshes, self.names, self.nominal.body_poses(self.nominal.start), others)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """Judged pairs that are two bodies of the arm, or its gripper and what it grips."""
        arm = {*arm_chain(self.nominal), *(("part",) if self.grips else ())}
        return np.array([a in arm and b in arm for a, b in self.pairs])

    @cached_property
    def start(self) -> Array:
        """Axes (axes,), rad or m, with the fingers around the part."""
        down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        flange = pose.from_rotation(down, _GRIPPED_AT[1]) @ pose.inverse(flange_from_tool(self.nominal, "gripper"))
        branches = self.nominal.arm.ik(pose.inverse(self._world_from_carrier) @ flange, self.nominal.home)[0]
        joints = branches[np.nanargmin(np.abs(branches - self.nominal.home).max(-1))]
        return self.nominal.with_further_axes(np.append(joints, 0.0))

    @property
    def _world_from_carrier(self) -> Array:
        """Pose (4, 4) of what carries the arm at the start."""
        return self.nominal.world_from(self.nominal.arm_on, self.nominal.start)

    def carrying(self, held: bool) -> NominalCell:
        """The geometry with the free part in the gripper, as at `start`, or where it lies on the belt."""
        assert self.nominal.belt is not None
        placed, frame = self.nominal.belt.world_from_belt @ self.nominal.belt.belt_from_part, "world"
        if held:
            flange = self._world_from_carrier @ self.nominal.arm.fk(self.start[: len(self.nominal.home)])
            placed = pose.inverse(flange) @ placed
            frame = f"link[{len(self.nominal.arm.joints)}]"
        bodies = [
            replace(body, moves_with=frame, mesh=body.mesh.transformed(placed), patches=())
            if body.name == "part"
            else body
            for body in self.nominal.bodies
        ]
        return replace(self.nominal, bodies=tuple(bodies))

    def opened(self, width: float) -> NominalCell:
        """The geometry with the pads of the gripper `width` (m) apart."""
        gripper = self.described.gripper
        assert gripper is not None
        return replace(self.nominal, flange_from_finger=pose_matrix(gripper.pose) @ gripper_from_finger(width))


def world_of(described: CellDescription, part: Mesh, name: str, rng: np.random.Generator) -> World:
    """A described cell without sensors and with a part, named `name`: clamped on its table, or in its gripper.

    Half of the parts that extend beyond the table have a post or hook in their way. One world in four has the meshes
    of the description, the others simplified ones, for which the guard has no margin.
    """
    grips = described.gripper is not None and bool(described.conveyor) and rng.random() < _GRIPS
    if grips:
        part, placed = _GRIPPED, {"x_mm": _GRIPPED_AT[0], "y_mm": 0.0}
        arrival = described.part.arrival
        assert arrival is not None
        arrival = arrival.model_copy(update={"pose": arrival.pose.model_copy(update=placed)})
        piece = described.part.model_copy(update={"arrival": arrival})
    else:
        piece = described.part.model_copy(update={"fixture": "clamped", "arrival": None})
    gripper = described.gripper
    if gripper is not None and not grips:
        gripper = gripper.model_copy(update={"start_mm": float(rng.choice([0.1, 0.5, 1.0])) * gripper.stroke_mm})
    cell = described.model_copy(update={"part": piece, "gripper": gripper, **dict.fromkeys(SENSOR_KEYS, ())})
    nominal = nominal_cell(cell, part)
    bodies = list(nominal.bodies)
    if not grips and name in POSTS and rng.random() < 0.5:
        size, centre, angle = POSTS[name]
        turned = nominal.with_further_axes([*nominal.home, angle * rng.choice([-1.0, 1.0])])
        placed_at = nominal.world_from("part", turned) @ pose.translation(centre)
        bodies.append(Body("fixed_post", "world", box_mesh(size).transformed(placed_at), Material(0.5)))
    if rng.random() >= _DESCRIBED:
        bodies = [replace(body, mesh=decimated(body.mesh, _FEW_FACES), patches=()) for body in bodies]
    return World(with_encoders(cell, rng), replace(nominal, bodies=tuple(bodies)), settings_of(cell), grips)
