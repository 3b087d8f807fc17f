"""Reading of URDF files: the arm, the axes before it and before a table, and what is fixed to each of them.

Angles of origins count as a multiple of 90 degrees where they are that multiple in the decimal places that the file
gives, and within 1e-5 rad, because files often round pi.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.robot import MAX_JOINTS
from scancell.errors import DescriptionError
from scancell.files import read_file
from scancell.geometry import pose
from scancell.geometry.mesh import MassProperties
from scancell.geometry.mesh_files import FORMATS, read_mesh

_ROUNDED, _EXACT = 1e-5, 1e-12  # rad: rounding of pi to decimal places, and that of computed angles
_UNIT = 1e-3  # by which the length of a quaternion may differ from 1
_NO_INERTIA = 1e-3  # relative: by which moments of inertia may be negative, or one exceed the sum of the others

# What a file does not state: rad/s, m/s.
_ASSUMED_SPEED = {"revolute": np.pi / 2, "prismatic": 0.5}
# What is larger, m, rad, rad/s and m/s, is probably in mm and degrees.
_MOST_REACH, _MOST_MESH = 10.0, 10.0
_MOST_POSITION, _MOST_SPEED = {"revolute": 20.0, "prismatic": 100.0}, 20.0
_LARGEST = 1e9  # in any unit
_NEAREST = 4  # folders above a file in which packages are looked for
_TURNING = ("revolute", "continuous")
_MOVING = (*_TURNING, "prismatic")


@dataclass(frozen=True)
class UrdfJoint:
    """A joint that an axis of the cell moves; limits in rad and rad/s, or m and m/s.

    `root_from_joint` (4, 4) and `axis` (3,), a unit vector of that frame, are those with every joint at 0.
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    lower: float
    upper: float
    max_speed: float
    root_from_joint: Array
    axis: Array

    @property
    def point(self) -> Array:
        """A point on its axis, (3,), frame of the root link."""
        return np.asarray(self.root_from_joint[:3, 3])

    @property
    def direction(self) -> Array:
        """Direction of its axis, (3,), frame of the root link."""
        return np.asarray(self.root_from_joint[:3, :3] @ self.axis)


@dataclass
class UrdfLink:
    """A link in the frame of the root link with every joint at 0 (m, kg).

    `parent` is the link that carries it. `vertices` and `faces` of each visual mesh; mass properties, if it has any.
    """

    name: str
    parent: str
    root_from_link: Array
    meshes: list[tuple[Array, NDArray[np.int64]]] = field(default_factory=list)
    masses: list[MassProperties] = field(default_factory=list)


@dataclass
class UrdfBody:
    """Links that are fixed to each other, the joint that moves them, and the number of the body that carries it."""

    joint: UrdfJoint | None = None
    carrier: int = 0
    links: dict[str, UrdfLink] = field(default_factory=dict)


@dataclass(frozen=True)
class UrdfTree:
    """Content of a URDF file from which a cell is made, in the frame of the root link with every joint at 0, m.

    Attributes
    ----------
    bodies
        What is fixed to the root, then what each joint moves, after what carries it.
    axes, arm, table
        Numbers of the bodies that the axes before arm and table move, that the joints of the arm move, from its base
        on, and that the table turns, if there is one.
    base, table_link
        Names of the links from which the arm and the table begin.
    tip
        (4, 4) ``root_from_tip``.
    meshes
        Files that were read.
    warnings
        What was assumed, left out or is not plausible, as sentences.
    """

    name: str
    bodies: tuple[UrdfBody, ...]
    axes: tuple[int, ...]
    arm: tuple[int, ...]
    table: int | None
    base: str
    table_link: str
    tip: Array
    meshes: frozenset[Path]
    warnings: tuple[str, ...]

    def joint(self, number: int) -> UrdfJoint:
        """The joint that moves a body."""
        joint = self.bodies[number].joint
        assert joint is not None  # only what is fixed to the root has none
        return joint


def read_urdf(
    path: str | Path, tip: str, base: str | None = None, table: str | None = None, home_deg: Sequence[float] = ()
) -> UrdfTree:
    """Read the chains from the root of a URDF file to its link `tip` and to its link `table`.

    The arm consists of the joints behind the last prismatic one, or behind the link `base`; those before are axes. The
    last joint before `table` turns it; those before are axes, too. Joints that follow one of these (``<mimic>``) rest
    at the value that belongs to its start. What the specification makes optional has its defaults: a limit of 0, a mass
    of 0 where none is stated.

    Raises `DescriptionError` naming the file, the link or joint and what was expected: not URDF, no such link, equal
    names, a joint of another kind, missing limits, no arm of 4 to 8 joints, no joint that turns the table, a mesh that
    does not exist or cannot be read.

    Parameters
    ----------
    home_deg
        Joint angles of the arm at the start; default: 0, or the nearest that the limits allow.
    """
    return _Reader(Path(path)).tree(tip, base, table, home_deg)


class _Reader:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._warnings: list[str] = []
        self._meshes: set[Path] = set()
        content = read_file(path)
        try:
            root = ET.fromstring(content)
        except (ET.ParseError, ValueError, LookupError) as error:  # the last two: an encoding that is not known
            raise DescriptionError(f"not readable as URDF: {error}", file=path) from None
        if root.tag != "robot":
            raise DescriptionError(f"<{root.tag}>", file=path, expected="<robot>, as in a URDF file")
        if any(element.tag.startswith("{") and "xacro" in element.tag for element in root.iter()):
            raise DescriptionError(
                "is a xacro file, which other files complete", file=path, expected="what `xacro` makes of it"
            )
        self._name = root.get("name", path.stem)
        self._links = {str(link.get("name")): link for link in root.findall("link")}
        self._joints = list(root.findall("joint"))
        for kind in ("link", "joint"):
            names = [str(element.get("name")) for element in root.findall(kind)]
            repeated = next((name for name in names if names.count(name) > 1), None)
            if repeated is not None:
                raise DescriptionError(
                    f"{names.count(repeated)} of this name", file=path, key=f"{kind} '{repeated}'", expected="one"
                )
        self._named = {str(joint.get("name")): joint for joint in self._joints}
        self._above: dict[str, ET.Element] = {}
        self._below: dict[str, list[ET.Element]] = {}
        for joint in self._joints:
            child = self._end(joint, "child")
            if child in self._above:
                other = self._above[child].get("name")
                raise self._fault(joint, f"carries link '{child}' like joint '{other}'; expected one joint per link")
            self._above[child] = joint
            self._below.setdefault(self._end(joint, "parent"), []).append(joint)

    def tree(self, tip: str, base: str | None, table: str | None, home_deg: Sequence[float]) -> UrdfTree:
        chain = self._chain(tip, "tip")
        root = self._end(chain[0], "parent") if chain else tip
        before, arm = self._split(chain, tip, base)
        branch = self._branch(table, root, before, arm)
        driven = {str(joint.get("name")): joint for joint in (*before, *branch, *arm)}
        limits = {name: self._limits(joint) for name, joint in driven.items()}
        starts = {name: min(max(0.0, lower), upper) for name, (lower, upper, _) in limits.items()}
        starts |= dict(zip((str(joint.get("name")) for joint in arm), np.radians(home_deg).tolist(), strict=False))
        if branch:
            starts[str(branch[-1].get("name"))] = 0.0
        bodies, numbers = self._bodies(root, driven, limits, starts)
        self._name_unconnected(root)
        in_table, in_arm = ([numbers[str(joint.get("name"))] for joint in joints] for joints in (branch, arm))
        axes = {*(numbers[str(joint.get("name"))] for joint in before), *in_table[:-1]}
        tip_body = in_arm[-1]
        pose_of_tip = bodies[tip_body].links[tip].root_from_link
        begin = base or self._end(arm[0], "parent")
        start = bodies[bodies[in_arm[0]].carrier].links[begin].root_from_link[:3, 3] if axes else np.zeros(3)
        points = [body.joint.point for body in (bodies[k] for k in in_arm) if body.joint is not None]
        reach = sum(float(np.linalg.norm(b - a)) for a, b in pairwise([start, *points, pose_of_tip[:3, 3]]))
        if reach > _MOST_REACH:
            self._warnings.append(
                f"the joints and '{tip}' are {reach:.4g} m apart along the arm: are the lengths in mm?"
            )
        return UrdfTree(
            self._name,
            tuple(bodies),
            tuple(sorted(axes)),
            tuple(in_arm),
            in_table[-1] if branch else None,
            begin,
            table or "",
            pose_of_tip,
            frozenset(self._meshes),
            tuple(dict.fromkeys(self._warnings)),
        )

    def _bodies(
        self,
        root: str,
        driven: Mapping[str, ET.Element],
        limits: Mapping[str, tuple[float, float, float]],
        starts: Mapping[str, float],
    ) -> tuple[list[UrdfBody], dict[str, int]]:
        """Bodies, and their numbers by the names of the joints that move them."""
        bodies, numbers = [UrdfBody()], dict[str, int]()
        placed = [("", root, np.eye(4), 0)]
        for parent, name, frame, number in placed:
            bodies[number].links[name] = self._link(name, parent, frame)
            for joint in self._below.get(name, ()):
                key, kind, carried = str(joint.get("name")), joint.get("type"), number
                at = frame @ self._origin(_name(joint), joint)
                if key in driven:
                    carried = numbers[key] = len(bodies)
                    moves: Literal["prismatic", "revolute"] = "prismatic" if kind == "prismatic" else "revolute"
                    bodies.append(UrdfBody(UrdfJoint(key, moves, *limits[key], at, self._axis(joint)), number))
                elif kind != "fixed":
                    value = self._held(joint, starts)
                    if value is None:
                        self._name_left_out(joint)
                        continue
                    at = at @ self._motion(joint, value)
                placed.append((name, self._end(joint, "child"), at, carried))
        return bodies, numbers

    def _chain(self, link: str, end: str) -> list[ET.Element]:
        """The joints from the root to a link, the `end` of an arm or of a branch."""
        if link not in self._links:
            expected = f"one of {', '.join(self._links)}"
            raise DescriptionError(f"no link '{link}'", file=self._path, expected=expected)
        chain: list[ET.Element] = []
        while link in self._above:
            joint = self._above[link]
            if joint in chain:
                raise self._fault(joint, "is part of a loop; expected a tree")
            chain.append(joint)
            link = self._end(joint, "parent")
        chain.reverse()
        for joint in chain:
            kind = joint.get("type")
            if kind not in (*_MOVING, "fixed"):
                expected = "revolute, continuous, prismatic or fixed"
                raise self._fault(joint, f"type '{kind}' between root and {end}; expected {expected}")
            mimic = joint.find("mimic")
            if mimic is not None:
                leader, expected = mimic.get("joint"), "a joint of its own"
                raise self._fault(
                    joint, f"follows joint '{leader}' (<mimic>) between root and {end}; expected {expected}"
                )
        return chain

    def _split(
        self, chain: Sequence[ET.Element], tip: str, base: str | None
    ) -> tuple[list[ET.Element], list[ET.Element]]:
        """The joints before the arm, and those of the arm."""
        begin = 1 + max((i for i, joint in enumerate(chain) if joint.get("type") == "prismatic"), default=-1)
        if base is not None:
            links = [self._end(joint, "parent") for joint in chain]
            if base not in links:
                expected = f"one of {', '.join(links) or 'no links'}, between the root and '{tip}'"
                raise DescriptionError(f"no link '{base}' before the arm", file=self._path, expected=expected)
            if links.index(base) < begin:
                fault = f"type 'prismatic' between base '{base}' and tip; expected revolute, continuous or fixed"
                raise self._fault(chain[begin - 1], fault)
            begin = links.index(base)
        before, arm = ([j for j in part if j.get("type") in _MOVING] for part in (chain[:begin], chain[begin:]))
        if not 4 <= len(arm) <= MAX_JOINTS:
            if before and base is None:
                expected = f"4 to {MAX_JOINTS} that turn"
                raise self._fault(
                    before[-1], f"type 'prismatic', with {len(arm)} joints behind it up to '{tip}'; expected {expected}"
                )
            expected = f"4 to {MAX_JOINTS}" + (
                ": name the link on which the arm stands (`base`)" if len(arm) > MAX_JOINTS else ""
            )
            origin = "the root" if base is None else f"link '{base}'"
            raise DescriptionError(f"{len(arm)} joints from {origin} to '{tip}'", file=self._path, expected=expected)
        return before, arm

    def _branch(
        self, table: str | None, root: str, before: Sequence[ET.Element], arm: Sequence[ET.Element]
    ) -> list[ET.Element]:
        """The joints from the root to the table, of which the last one turns it; none without a table."""
        if table is None:
            return []
        chain = self._chain(table, "table")
        key = f"link '{table}'"
        if (self._end(chain[0], "parent") if chain else table) != root:
            raise DescriptionError(
                "the table is not connected to the arm", file=self._path, key=key, expected=f"a branch of '{root}'"
            )
        branch = [joint for joint in chain if joint.get("type") in _MOVING]
        shared = next((joint for joint in branch if joint in arm or (joint is branch[-1] and joint in before)), None)
        if shared is not None:
            fault = f"the table and the arm both move with joint '{shared.get('name')}'"
            raise DescriptionError(fault, file=self._path, key=key, expected="a joint of the table's own")
        if not branch or branch[-1].get("type") == "prismatic":
            fault = "no joint moves the table" if not branch else f"joint '{branch[-1].get('name')}' slides the table"
            raise DescriptionError(fault, file=self._path, key=key, expected="a revolute or continuous joint before it")
        return branch

    def _held(self, joint: ET.Element, starts: Mapping[str, float]) -> float | None:
        """Position of a joint that follows one of those that start somewhere (<mimic>); None of any other."""
        first, factor, offset = joint, 1.0, 0.0
        followed: list[ET.Element] = []
        while (name := str(joint.get("name"))) not in starts:
            mimic = joint.find("mimic")
            if mimic is None:
                return None
            if joint in followed:
                raise self._fault(first, "follows itself (<mimic>); expected another joint")
            followed.append(joint)
            leader = self._named.get(str(mimic.get("joint")))
            if leader is None:
                fault = f"follows joint '{mimic.get('joint')}' (<mimic>); expected a joint of the file"
                raise self._fault(joint, fault)
            offset += factor * float(self._numbers(_name(joint), mimic, "offset", "0", 1)[0])
            factor *= float(self._numbers(_name(joint), mimic, "multiplier", "1", 1)[0])
            joint = leader
        if first.get("type") not in _MOVING:
            return None
        value = factor * starts[name] + offset
        shown = f"{1e3 * value:.6g} mm" if first.get("type") == "prismatic" else f"{np.degrees(value):.6g} deg"
        self._warnings.append(
            f"{_name(first)} is held at {shown}, where it is at the start: it follows joint '{name}' (<mimic>)"
        )
        return value

    def _motion(self, joint: ET.Element, value: float) -> Array:
        """Pose (4, 4) of what a joint carries in its frame, at a position."""
        axis = self._axis(joint)
        if joint.get("type") == "prismatic":
            return pose.translation(value * axis)
        return pose.from_rotation(pose.exp_rotation(value * axis))

    def _name_left_out(self, joint: ET.Element) -> None:
        """Warn of a joint beside the chains, and of all that it carries."""
        links, joints = [self._end(joint, "child")], []
        for link in links:
            for other in self._below.get(link, ()):
                links.append(self._end(other, "child"))
                if other.get("type") != "fixed":
                    joints.append(str(other.get("name")))
        further = f", and joint{'s' * (len(joints) > 1)} {_listed(joints)} between them" if joints else ""
        kind = "" if joint.get("type") in _MOVING else f" of type '{joint.get('type')}'"
        self._warnings.append(
            f"left out joint '{joint.get('name')}'{kind} and what it carries, link{'s' * (len(links) > 1)}"
            f" {_listed(links)}{further}: it is beside the chain"
        )

    def _name_unconnected(self, root: str) -> None:
        connected = [root]
        for link in connected:
            connected += [self._end(joint, "child") for joint in self._below.get(link, ())]
        reached = set(connected)
        left = [name for name in self._links if name not in reached]
        if left:
            self._warnings.append(
                f"left out link{'s' * (len(left) > 1)} {_listed(left)}, which no joint connects to '{root}'"
            )

    def _limits(self, joint: ET.Element) -> tuple[float, float, float]:
        """Lower and upper limit and speed of a joint, rad and rad/s, or m and m/s."""
        limit, name = joint.find("limit"), _name(joint)
        kind, unit, si = ("prismatic", "mm", "m") if joint.get("type") == "prismatic" else ("revolute", "deg", "rad")
        doubt = "in mm" if kind == "prismatic" else "in degrees"
        speed = float(self._numbers(name, limit, "velocity", "0", 1)[0])
        if not speed >= 0:
            raise self._fault(joint, f"velocity {speed:g} {si}/s; expected a number above 0")
        if speed == 0:
            speed = _ASSUMED_SPEED[kind]
            shown = 1e3 * speed if kind == "prismatic" else np.degrees(speed)
            self._warnings.append(f"{name} states no velocity: {shown:g} {unit}/s are assumed (max_speed_{unit}_s)")
        if speed > _MOST_SPEED:
            self._warnings.append(f"{name}: velocity {speed:g} {si}/s: is it {doubt}?")
        if joint.get("type") == "continuous":
            return -2 * np.pi, 2 * np.pi, speed
        lower, upper = (float(self._numbers(name, limit, key, "0", 1)[0]) for key in ("lower", "upper"))
        if not lower < upper:
            raise self._fault(joint, f"limits {lower:g} to {upper:g} {si}; expected lower below upper")
        if max(-lower, upper) > _MOST_POSITION[kind]:
            self._warnings.append(f"{name}: limits {lower:g} to {upper:g} {si}: are they {doubt}?")
        return lower, upper, speed

    def _axis(self, joint: ET.Element) -> Array:
        axis = self._numbers(_name(joint), joint.find("axis"), "xyz", "1 0 0", 3)
        if not np.linalg.norm(axis) > 0:
            raise self._fault(joint, "an axis of zero length has no direction")
        return np.asarray(axis / np.linalg.norm(axis))

    def _origin(self, name: str, owner: ET.Element) -> Array:
        """Pose (4, 4) of the <origin> of an element of the link or joint `name`."""
        origin = owner.find("origin")
        given = set() if origin is None else set(origin.keys())
        if given - {"xyz", "rpy", "quat_xyzw"} or {"rpy", "quat_xyzw"} <= given:
            raise DescriptionError(
                f"<origin> with {', '.join(sorted(given))}",
                file=self._path,
                key=name,
                expected="xyz, and rpy or quat_xyzw",
            )
        position = self._numbers(name, origin, "xyz", "0 0 0", 3)
        if "quat_xyzw" in given:
            quaternion = self._numbers(name, origin, "quat_xyzw", "", 4)
            length = float(np.linalg.norm(quaternion))
            if not abs(length - 1) < _UNIT:
                raise DescriptionError(
                    f"quat_xyzw of length {length:.6g}", file=self._path, key=name, expected="a unit quaternion"
                )
            # Rz(y) Ry(p) Rx(r) is the inverse of Rx(-r) Ry(-p) Rz(-y).
            rpy = -pose.euler_xyz_from_rotation(pose.rotation_from_quaternion(np.roll(quaternion, 1)).T)
        else:
            rpy = self._numbers(name, origin, "rpy", "0 0 0", 3)
        words = ["0"] if origin is None else origin.get("quat_xyzw", origin.get("rpy", "0")).split()
        unit = np.array([_last_place(word) for word in words])
        if "quat_xyzw" in given:
            unit = np.full(3, 2 * unit.min())
        right = np.round(rpy / (np.pi / 2)) * (np.pi / 2)
        # A rounded or truncated number differs by less than one unit of its last decimal place.
        rounding = np.clip(0.95 * unit, _EXACT, _ROUNDED)
        r, p, y = np.where(np.abs(rpy - right) < rounding, right, rpy)
        rotation = pose.rotation_about(2, y) @ pose.rotation_about(1, p) @ pose.rotation_about(0, r)
        return pose.from_rotation(rotation, position)

    def _link(self, name: str, parent: str, root_from_link: Array) -> UrdfLink:
        link, key = self._links[name], _name(self._links[name])
        made = UrdfLink(name, parent, root_from_link)
        if (inertial := link.find("inertial")) is not None:
            made.masses += self._mass(key, inertial, root_from_link)
        visual, collision = self._shapes(link, "visual"), self._shapes(link, "collision")
        shapes = visual or collision
        unread = [file for shape in shapes if (file := self._file_of(shape)) and not file.lower().endswith(FORMATS)]
        if unread and collision:
            self._warnings.append(f"{key}: its collision meshes are used instead of '{unread[0]}', which is not read")
            shapes = collision
        for shape in shapes:
            vertices, faces = self._geometry(name, shape)
            size = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
            if size > _MOST_MESH:
                self._warnings.append(f"{key}: its mesh is {size:.4g} m large: is it in mm, without a scale of 0.001?")
            made.meshes.append((pose.transform_points(root_from_link @ self._origin(key, shape), vertices), faces))
        return made

    def _mass(self, key: str, inertial: ET.Element, root_from_link: Array) -> list[MassProperties]:
        """Mass properties of a link; none of one without mass."""
        frame, tensor = root_from_link @ self._origin(key, inertial), inertial.find("inertia")
        mass = float(self._numbers(key, inertial.find("mass"), "value", "0", 1)[0])
        names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        xx, xy, xz, yy, yz, zz = (self._numbers(key, tensor, name, "0", 1)[0] for name in names)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if mass < 0:
            raise DescriptionError(f"mass {mass:g} kg", file=self._path, key=key, expected="at least 0")
        if mass == 0:
            return []
        if tensor is None:
            self._warnings.append(f"{key} states a mass without inertia: a point of this mass is assumed")
        low, middle, high = np.linalg.eigvalsh(inertia)
        if low < -_NO_INERTIA * abs(high) or high > (low + middle) * (1 + _NO_INERTIA):
            self._warnings.append(
                f"{key}: no body has the principal moments of inertia {low:.4g}, {middle:.4g} and {high:.4g} kg m²"
            )
        return [MassProperties(mass, np.zeros(3), inertia).seen_from(frame)]

    def _shapes(self, link: ET.Element, kind: str) -> list[ET.Element]:
        """The <visual> or <collision> elements of a link that have a shape."""
        shapes = link.findall(kind)
        filled = [shape for shape in shapes if shape.find("geometry/*") is not None]
        if len(filled) < len(shapes):
            self._warnings.append(f"{_name(link)} has a <{kind}> without a shape")
        if any(len(shape.findall("geometry/*")) > 1 for shape in filled):
            self._warnings.append(f"{_name(link)} has a <{kind}> of several shapes, of which the first is taken")
        return filled

    @staticmethod
    def _file_of(owner: ET.Element) -> str:
        """Name of the mesh of a <visual> or <collision>; empty if it has none."""
        shape = owner.find("geometry/mesh")
        return "" if shape is None else shape.get("filename", "")

    def _geometry(self, link: str, owner: ET.Element) -> tuple[Array, NDArray[np.int64]]:
        import trimesh  # noqa: PLC0415  (half a second)

        shape, key = owner.find("geometry/*"), f"link '{link}'"
        kind = "none" if shape is None else shape.tag
        if shape is not None and kind == "mesh":
            file = self._mesh_file(link, shape.get("filename", ""))
            vertices, faces, remarks = read_mesh(file)
            self._meshes.add(file.resolve())
            self._warnings += remarks
            scale = self._numbers(key, shape, "scale", "1 1 1", 3)
            # A mirrored mesh keeps its outside.
            return np.asarray(vertices, float) * scale, faces if np.prod(scale) >= 0 else faces[:, ::-1]
        if kind == "box":
            made = trimesh.creation.box(self._sizes(key, shape, "size", 3))
        elif kind == "cylinder":
            sizes = (self._sizes(key, shape, name, 1)[0] for name in ("radius", "length"))
            made = trimesh.creation.cylinder(*sizes)
        elif kind == "sphere":
            made = trimesh.creation.icosphere(3, self._sizes(key, shape, "radius", 1)[0])
        else:
            raise DescriptionError(
                f"geometry '{kind}'", file=self._path, key=key, expected="mesh, box, cylinder or sphere"
            )
        return np.asarray(made.vertices, float), np.asarray(made.faces, np.int64)

    def _mesh_file(self, link: str, name: str) -> Path:
        """The file of a mesh: beside the URDF file, or for package:// in that package around it.

        A package is a folder of that name, or one whose package.xml states it.
        """
        folders = [self._path.resolve().parent, *self._path.resolve().parent.parents]
        if name.startswith("package://"):
            package, _, rest = name.removeprefix("package://").partition("/")
            places = [folder / rest if folder.name == package else folder / package / rest for folder in folders]
            places += [folder / rest for folder in _packages(folders[:_NEAREST], package)]
        else:
            places = [folders[0] / name.removeprefix("file://")]
        key = f"link '{link}': mesh '{name}'"
        for place in places:
            if place.is_file():
                if place.suffix.lower() not in FORMATS:
                    raise DescriptionError(file=self._path, key=key, expected=f"a file of {', '.join(FORMATS)}")
                return place
        raise DescriptionError(f"no such file; tried {' and '.join(map(str, places[:4]))}", file=self._path, key=key)

    def _numbers(self, owner: str, element: ET.Element | None, key: str, default: str, count: int) -> Array:
        """Numbers of an attribute in the link or joint `owner`."""
        text = default if element is None else element.get(key, default)
        try:
            values = np.array([float(word) for word in text.replace("_", "?").split()])  # float takes 1_0 for 10
        except ValueError:
            values = np.zeros(0)
        if len(values) != count or not (np.abs(values) <= _LARGEST).all():
            raise DescriptionError(
                file=self._path,
                key=f"{owner}: {key}",
                value=text,
                expected="1 number" if count == 1 else f"{count} numbers",
            )
        return values

    def _sizes(self, owner: str, shape: ET.Element | None, key: str, count: int) -> Array:
        """Dimensions of a box, cylinder or sphere, m."""
        sizes = self._numbers(owner, shape, key, "", count)
        if shape is not None and (sizes < 0).any():
            text, expected = shape.get(key), "at least 0"
            raise DescriptionError(file=self._path, key=f"{owner}: {key}", value=text, expected=expected)
        return sizes

    def _end(self, joint: ET.Element, which: str) -> str:
        element = joint.find(which)
        link = None if element is None else element.get("link")
        if link not in self._links:
            raise self._fault(joint, f"{which} '{link}' is not a link of the file")
        return str(link)

    def _fault(self, joint: ET.Element, text: str) -> DescriptionError:
        return DescriptionError(text, file=self._path, key=_name(joint))


def _last_place(word: str) -> float:
    """One unit of the last decimal place of a number; 0 if it is not finite."""
    try:
        exponent = Decimal(word).as_tuple().exponent
    except ArithmeticError:  # of an exponent of too many digits, as in a number that is 0
        return 0.0
    return float(f"1e{exponent}") if isinstance(exponent, int) else 0.0


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _name(element: ET.Element) -> str:
    """Name of a link or joint, for messages."""
    return f"{element.tag} '{element.get('name')}'"


def _packages(folders: Sequence[Path], name: str) -> Iterator[Path]:
    """The folders, and those in them, whose package.xml states a name."""
    for folder in folders:
        for file in (folder / "package.xml", *sorted(folder.glob("*/package.xml"))):
            try:
                stated = ET.fromstring(read_file(file)).findtext("name", "")
            except (ET.ParseError, DescriptionError):
                continue
            if stated.strip() == name:
                yield file.parent
