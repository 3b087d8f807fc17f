"""Robot files from URDF files: Denavit-Hartenberg parameters of the joint axes, meshes in the frames of the links.

Angles of origins count as a multiple of 90 degrees where they are that multiple in the decimal places that the file
gives, and within 1e-5 rad, because files often round pi.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.description import validate
from scancell.config.robot import MAX_JOINTS, RobotDescription
from scancell.errors import DescriptionError
from scancell.files import atomic_write, read_file
from scancell.geometry import pose
from scancell.geometry.arm import Chain, dh_from_axes
from scancell.geometry.mesh import MassProperties
from scancell.geometry.mesh_files import FORMATS, read_mesh, write_stl

_ROUNDED, _EXACT = 1e-5, 1e-12  # rad: rounding of pi to decimal places, and that of computed angles
_UNIT = 1e-3  # by which the length of a quaternion may differ from 1
_NO_INERTIA = 1e-3  # relative: by which moments of inertia may be negative, or one exceed the sum of the others

RAMP_TIME = 0.25  # s: to full speed, because a URDF file contains no accelerations
_ASSUMED_SPEED = np.pi / 2  # rad/s, where a file states none
_DIGITS = 10  # decimal places of lengths in mm and angles in deg
# What is larger, m, rad and rad/s, is probably in mm and degrees.
_MOST_REACH, _MOST_MESH, _MOST_ANGLE, _MOST_SPEED = 10.0, 10.0, 20.0, 20.0
_NEAREST = 4  # folders above a file in which packages are looked for


@dataclass(frozen=True)
class UrdfJoint:
    """A revolute joint; limits in rad and rad/s."""

    name: str
    lower: float
    upper: float
    max_speed: float


@dataclass
class UrdfBody:
    """Links that are fixed to each other, in the frame of the root link with every joint at 0 (m, kg).

    `vertices` and `faces` of each visual mesh; mass properties of each link.
    """

    meshes: list[tuple[Array, NDArray[np.int64]]] = field(default_factory=list)
    masses: list[MassProperties] = field(default_factory=list)


@dataclass(frozen=True)
class UrdfArm:
    """A serial arm in the frame of its root link with every joint at 0, m.

    Attributes
    ----------
    points, axes
        (n, 3) each: a point on the axis of each joint, and its direction.
    tip
        (4, 4) ``root_from_tip``.
    bodies
        n + 1: the fixed base, then what each joint moves.
    warnings
        What was assumed, left out or is not plausible, as sentences.
    """

    name: str
    joints: tuple[UrdfJoint, ...]
    points: Array
    axes: Array
    tip: Array
    bodies: tuple[UrdfBody, ...]
    warnings: tuple[str, ...]


def read_urdf(path: str | Path, tip: str) -> UrdfArm:
    """Read the chain from the root of a URDF file to its link `tip`.

    What the specification makes optional has its defaults: a limit of 0, a mass of 0 where none is stated.

    Raises `DescriptionError` naming the file, the link or joint and what was expected: not URDF, no such link, equal
    names, a joint that is not revolute, missing limits, a mesh that does not exist or cannot be read.
    """
    return _Reader(Path(path)).arm(tip)


class _Reader:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._warnings: list[str] = []
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
        self._above = {self._end(joint, "child"): joint for joint in self._joints}

    def arm(self, tip: str) -> UrdfArm:
        chain = self._chain(tip)
        moving = [joint for joint in chain if joint.get("type") != "fixed"]
        root = self._end(chain[0], "parent") if chain else tip
        bodies = [UrdfBody() for _ in range(len(moving) + 1)]
        points, axes = [], []
        frames = {root: np.eye(4)}
        bodies_of = {root: 0}
        for link in self._from_root(root):
            self._add_link(link, frames[link], bodies[bodies_of[link]])
            for joint in self._joints:
                if self._end(joint, "parent") != link:
                    continue
                child, number = self._end(joint, "child"), bodies_of[link]
                frame = frames[link] @ self._origin(_name(joint), joint)
                if joint in moving:
                    number += 1
                    points.append(frame[:3, 3])
                    axes.append(frame[:3, :3] @ self._axis(joint))
                elif joint.get("type") != "fixed":
                    self._warnings.append(
                        f"left out joint '{joint.get('name')}' and what it carries: it is beside the chain"
                    )
                    continue
                frames[child], bodies_of[child] = frame, number
        joints = tuple(self._joint(joint) for joint in moving)
        stations = [np.zeros(3), *points, frames[tip][:3, 3]]
        reach = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(stations))
        if reach > _MOST_REACH:
            self._warnings.append(
                f"the joints and '{tip}' are {reach:.4g} m apart along the arm: are the lengths in mm?"
            )
        warnings = tuple(dict.fromkeys(self._warnings))
        return UrdfArm(self._name, joints, np.array(points), np.array(axes), frames[tip], tuple(bodies), warnings)

    def _from_root(self, root: str) -> list[str]:
        """Links that fixed joints and those of the chain connect to the root, each after the one that carries it."""
        order = [root]
        for link in order:
            order += [
                self._end(joint, "child")
                for joint in self._joints
                if self._end(joint, "parent") == link and (joint.get("type") == "fixed" or joint in self._on_chain)
            ]
        return order

    def _chain(self, tip: str) -> list[ET.Element]:
        if tip not in self._links:
            raise DescriptionError(f"no link '{tip}'", file=self._path, expected=f"one of {', '.join(self._links)}")
        chain: list[ET.Element] = []
        link = tip
        while link in self._above:
            joint = self._above[link]
            if joint in chain:
                raise self._fault(joint, "is part of a loop; expected a tree")
            chain.insert(0, joint)
            link = self._end(joint, "parent")
        for joint in chain:
            kind = joint.get("type")
            if kind not in ("revolute", "continuous", "fixed"):
                raise self._fault(joint, f"type '{kind}' between root and tip; expected revolute, continuous or fixed")
            mimic = joint.find("mimic")
            if mimic is not None:
                raise self._fault(
                    joint,
                    f"follows joint '{mimic.get('joint')}' (<mimic>) between root and tip; expected a joint of its own",
                )
        self._on_chain = chain
        return chain

    def _joint(self, joint: ET.Element) -> UrdfJoint:
        limit, name = joint.find("limit"), _name(joint)
        speed = self._numbers(name, limit, "velocity", "0", 1)[0]
        if not speed >= 0:
            raise self._fault(joint, f"velocity {speed:g} rad/s; expected a number above 0")
        if speed == 0:
            speed = _ASSUMED_SPEED
            self._warnings.append(
                f"{name} states no velocity: {np.degrees(speed):g} deg/s are assumed (max_speed_deg_s)"
            )
        if speed > _MOST_SPEED:
            self._warnings.append(f"{name}: velocity {speed:g} rad/s: is it in degrees?")
        if joint.get("type") == "continuous":
            return UrdfJoint(str(joint.get("name")), -2 * np.pi, 2 * np.pi, float(speed))
        lower, upper = (float(self._numbers(name, limit, key, "0", 1)[0]) for key in ("lower", "upper"))
        if not lower < upper:
            raise self._fault(joint, f"limits {lower:g} to {upper:g} rad; expected lower below upper")
        if max(-lower, upper) > _MOST_ANGLE:
            self._warnings.append(f"{name}: limits {lower:g} to {upper:g} rad: are they in degrees?")
        return UrdfJoint(str(joint.get("name")), lower, upper, float(speed))

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

    def _add_link(self, name: str, root_from_link: Array, body: UrdfBody) -> None:
        link, key = self._links[name], _name(self._links[name])
        if (inertial := link.find("inertial")) is not None:
            body.masses += self._mass(key, inertial, root_from_link)
        shapes = link.findall("visual") or link.findall("collision")
        unread = [file for shape in shapes if (file := self._file_of(shape)) and not file.lower().endswith(FORMATS)]
        if unread and link.findall("collision"):
            self._warnings.append(f"{key}: its collision meshes are used instead of '{unread[0]}', which is not read")
            shapes = link.findall("collision")
        for shape in shapes:
            vertices, faces = self._geometry(name, shape)
            size = float(np.ptp(vertices, axis=0).max()) if len(vertices) else 0.0
            if size > _MOST_MESH:
                self._warnings.append(f"{key}: its mesh is {size:.4g} m large: is it in mm, without a scale of 0.001?")
            body.meshes.append((pose.transform_points(root_from_link @ self._origin(key, shape), vertices), faces))

    def _mass(self, key: str, inertial: ET.Element, root_from_link: Array) -> list[MassProperties]:
        """Mass properties of a link; none of one without mass."""
        frame, tensor = root_from_link @ self._origin(key, inertial), inertial.find("inertia")
        mass = float(self._numbers(key, inertial.find("mass"), "value", "0", 1)[0])
        names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        xx, xy, xz, yy, yz, zz = (self._numbers(key, tensor, name, "0", 1)[0] for name in names)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not (mass >= 0 and np.isfinite(mass) and np.isfinite(inertia).all()):
            raise DescriptionError(
                "<inertial>", file=self._path, key=key, expected="a mass of at least 0 and a finite inertia"
            )
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
            self._warnings += remarks
            return np.asarray(vertices, float) * self._numbers(key, shape, "scale", "1 1 1", 3), faces
        if kind == "box":
            made = trimesh.creation.box(self._numbers(key, shape, "size", "nan nan nan", 3))
        elif kind == "cylinder":
            sizes = (self._numbers(key, shape, name, "nan", 1)[0] for name in ("radius", "length"))
            made = trimesh.creation.cylinder(*sizes)
        elif kind == "sphere":
            made = trimesh.creation.icosphere(3, self._numbers(key, shape, "radius", "nan", 1)[0])
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
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.zeros(0)
        if len(values) != count:
            raise DescriptionError(
                file=self._path,
                key=f"{owner}: {key}",
                value=text,
                expected="1 number" if count == 1 else f"{count} numbers",
            )
        return values

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
    exponent = Decimal(word).as_tuple().exponent
    return float(f"1e{exponent}") if isinstance(exponent, int) else 0.0


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


@dataclass(frozen=True)
class ConvertedRobot:
    """A robot file that was written.

    Attributes
    ----------
    description
        What it holds.
    files
        It and its meshes.
    flange_from_tip
        (4, 4), m: what four parameters cannot express of the tip's pose, to be put before the tool; identity for a tip
        whose z is the last axis.
    warnings
        What was assumed, left out or is not plausible, as sentences.
    """

    description: RobotDescription
    files: tuple[Path, ...]
    flange_from_tip: Array
    warnings: tuple[str, ...]


def robot_from_urdf(
    urdf: str | Path, tip: str, out: str | Path, home_deg: Sequence[float] = (), hold: Sequence[int] = ()
) -> ConvertedRobot:
    """Write the arm between the root and the `tip` link of a URDF file as a robot file, its meshes in a folder beside.

    Raises `DescriptionError` if the URDF file is wrong, see `read_urdf`, or describes no arm of 4 to 8 joints.

    Parameters
    ----------
    out
        TOML file to write; the meshes, in mm, go into the folder of the same name without suffix.
    home_deg
        Joint angles of the home position; default: 0, or the nearest that the limits allow.
    hold
        Numbers of the joints, from 1, that inverse kinematics holds: one for each beyond six.
    """
    arm, out = read_urdf(urdf, tip), Path(out)
    if not 4 <= len(arm.joints) <= MAX_JOINTS:
        raise DescriptionError(
            f"{len(arm.joints)} joints from the root to '{tip}'", file=urdf, expected=f"4 to {MAX_JOINTS}"
        )
    chain, last_from_tip = dh_from_axes(arm.points, arm.axes, arm.tip)
    rows = [(1e3 * one.a, 1e3 * one.d, *np.degrees([one.alpha, one.beta, one.theta])) for one in chain.joints]
    keys = ("a_mm", "d_mm", "alpha_deg", "beta_deg", "theta_deg")
    joints: list[dict[str, Any]] = [dict(zip(keys, _rounded(row), strict=True)) for row in rows]
    for row, joint in zip(joints, arm.joints, strict=True):
        low, high, speed = np.degrees([joint.lower, joint.upper, joint.max_speed]).round(6).tolist()
        row |= {"min_deg": low, "max_deg": high, "max_speed_deg_s": speed}
        row["max_acceleration_deg_s2"] = _rounded([speed / RAMP_TIME])[0]
    bodies = _bodies(arm, chain)
    data: dict[str, Any] = {"name": arm.name, "base": _pose_data(chain.world_from_base), "joint": joints}
    data["home_deg"] = list(home_deg) or [min(max(0.0, row["min_deg"]), row["max_deg"]) for row in joints]
    data["held"] = [{"joint": number} for number in hold]
    for row, body in zip(joints, bodies[1:], strict=True):
        if body.masses:
            row["inertia"] = _inertia_data(body)
    names = {
        k: out.with_suffix("") / ("base.stl" if k == 0 else f"link{k}.stl") for k, b in enumerate(bodies) if b.meshes
    }
    for k, file in names.items():
        (data if k == 0 else joints[k - 1])["base_mesh" if k == 0 else "mesh"] = str(file.resolve())
    description = validate(RobotDescription, data, str(urdf))
    for k, file in names.items():
        _write_mesh(file, bodies[k])
    description.to_toml(out)
    return ConvertedRobot(description, (out, *names.values()), last_from_tip, arm.warnings)


def _bodies(urdf: UrdfArm, chain: Chain) -> list[UrdfBody]:
    """The bodies in the frames of their links."""
    moved = []
    for body, root_from_link in zip(urdf.bodies, chain.link_poses(np.zeros(len(urdf.joints))), strict=True):
        link_from_root = pose.inverse(root_from_link)
        meshes = [(pose.transform_points(link_from_root, vertices), faces) for vertices, faces in body.meshes]
        moved.append(UrdfBody(meshes, [mass.seen_from(link_from_root) for mass in body.masses]))
    return moved


def _inertia_data(body: UrdfBody) -> dict[str, Any]:
    """Mass, centre of mass and inertia about it of all links of a body together."""
    whole = reduce(MassProperties.joined_with, body.masses)
    return {
        "mass_kg": whole.mass,
        "centre_of_mass_mm": _rounded(1e3 * whole.centre_of_mass),
        "inertia_kg_m2": _rounded(np.diag(whole.inertia)),
        "products_kg_m2": _rounded(whole.inertia[[0, 0, 1], [1, 2, 2]]),
    }


def _write_mesh(file: Path, body: UrdfBody) -> None:
    """All meshes of a body as one binary STL file in mm."""
    corners = np.concatenate([vertices[faces].reshape(-1, 3) for vertices, faces in body.meshes]) * 1e3
    with atomic_write(file) as temporary:
        write_stl(temporary, corners, np.arange(len(corners)).reshape(-1, 3))


def _pose_data(target_from_source: Array) -> dict[str, float]:
    angles = np.degrees(pose.euler_xyz_from_rotation(target_from_source[:3, :3]))
    values = [*_rounded(1e3 * target_from_source[:3, 3]), *_rounded(angles)]
    keys = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    return {key: value for key, value in zip(keys, values, strict=True) if value != 0.0}


def _rounded(values: Any) -> list[float]:
    return [float(value) + 0.0 for value in np.round(np.asarray(values, float), _DIGITS)]
