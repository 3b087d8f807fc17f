"""Robot files and cells from URDF files: Denavit-Hartenberg parameters, axes, table, and meshes of what they move."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.config.cell import MAX_FURTHER_AXES, CellDescription, is_reserved_axis
from scancell.config.description import validate
from scancell.config.devices import RESERVED_NAMES
from scancell.config.files import toml_text
from scancell.config.robot import RobotDescription
from scancell.config.urdf import UrdfJoint, UrdfLink, UrdfTree, read_urdf
from scancell.errors import DescriptionError, MeshError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.arm import Chain, dh_from_axes
from scancell.geometry.mesh import MassProperties, load_mesh
from scancell.geometry.mesh_files import write_stl
from scancell.geometry.tree import WORLD
from scancell.nominal.parts import tool_matrix

RAMP_TIME = 0.25  # s: to full speed, because a URDF file contains no accelerations
_DIGITS = 10  # decimal places of lengths in mm and angles in deg
_ALONG = 1e-6  # rad: between directions that count as equal
_GAP = 1e-3  # m: between a table's top and its meshes that is worth a remark
_SAME = 1e-9  # m, and elements of a rotation matrix: poses that differ by less are equal

_Meshes = list[tuple[Array, NDArray[np.int64]]]


@dataclass(frozen=True)
class ConvertedRobot:
    """A robot file that was written, and the cell around it.

    Attributes
    ----------
    description
        What the robot file holds.
    cell
        What the file of the cell holds; None if none was asked for.
    files
        Robot file, file of the cell, and meshes.
    flange_from_tip
        (4, 4), m: what four parameters cannot express of the tip's pose, to be put before the tool, as the cell does;
        identity for a tip whose z is the last axis.
    warnings
        What was assumed, left out or is not plausible, as sentences.
    """

    description: RobotDescription
    cell: CellDescription | None
    files: tuple[Path, ...]
    flange_from_tip: Array
    warnings: tuple[str, ...]


@checked_arguments
def robot_from_urdf(
    urdf: str | Path,
    tip: str,
    out: str | Path,
    home_deg: Sequence[float] = (),
    hold: Sequence[int] = (),
    *,
    cell: str | Path | None = None,
    base: str | None = None,
    table: str | None = None,
) -> ConvertedRobot:
    """Write the arm that ends in the `tip` link of a URDF file as a robot file, and what is around it as a cell.

    Without `cell`, all that is fixed to the root is the base of the arm. In a cell, only the link before its first
    joint is, with what is fixed to it; joints before the arm and before the table are axes, and all other links without
    joints of their own are obstacles in the world or on an axis. Tool and sensor are those of the shipped default cell,
    and so is the table unless `table` names one.

    Raises `DescriptionError` if the URDF file is wrong, see `read_urdf`, or holds more axes than a cell can have.

    Parameters
    ----------
    out
        TOML file of the arm to write; the meshes, in mm, go into the folder of the same name without suffix.
    home_deg
        Joint angles of the home position; default: 0, or the nearest that the limits allow.
    hold
        Numbers of the joints, from 1, that inverse kinematics holds: one for each beyond six.
    cell
        TOML file of the cell to write, with meshes like those of `out`; required where joints move the arm's base.
    base
        Link on which the arm stands; default: that before the first joint behind the last prismatic one.
    table
        Link that a joint turns as a table. The top of its meshes, or its origin if that is higher, is the table's top.
    """
    whole = None if cell is None else Path(cell)
    return _Conversion(Path(urdf), Path(out), whole, read_urdf(urdf, tip, base, table, home_deg)).write(
        tip, home_deg, hold
    )


@dataclass
class _Conversion:
    urdf: Path
    out: Path
    cell: Path | None
    tree: UrdfTree
    warnings: list[str] = field(default_factory=list)
    meshes: dict[Path, _Meshes] = field(default_factory=dict)

    def write(self, tip: str, home_deg: Sequence[float], hold: Sequence[int]) -> ConvertedRobot:
        """Make both descriptions before the first file is written."""
        self._check()
        robot, flange_from_tip = self._robot(home_deg, hold)
        description = validate(RobotDescription, robot, str(self.urdf))
        whole = None if self.cell is None else self._cell(self.cell.with_suffix(""), tip, robot, flange_from_tip)
        overwritten = self.tree.meshes & {file.resolve() for file in self.meshes}
        if overwritten:
            raise DescriptionError(
                "would overwrite a mesh of the URDF file", file=min(overwritten), expected="another name of the output"
            )
        for file, meshes in self.meshes.items():
            _write_mesh(file, meshes)
        description.to_toml(self.out)
        files = [self.out, *self.meshes]
        if self.cell is not None and whole is not None:
            self._write_cell(self.cell, whole)
            files.insert(1, self.cell)
        warnings = (*self.tree.warnings, *self.warnings)
        return ConvertedRobot(description, whole, tuple(files), flange_from_tip, warnings)

    def _check(self) -> None:
        tree = self.tree
        if self.cell is None:
            if tree.table is not None:
                raise DescriptionError(
                    "a table needs a cell", key="table", value=tree.table_link, expected="`cell`, too"
                )
            if tree.axes:
                joints = ", ".join(f"'{tree.joint(k).name}'" for k in tree.axes)
                raise DescriptionError(
                    f"the joints {joints} move the base of the arm, which is no part of a robot file",
                    file=self.urdf,
                    expected="`cell`, the file of a cell in which they are axes",
                )
        elif self.cell.resolve() == self.out.resolve():
            raise DescriptionError(key="cell", value=str(self.cell), expected="another file than that of the robot")
        if len(tree.axes) > MAX_FURTHER_AXES:
            joints = ", ".join(f"'{tree.joint(k).name}'" for k in tree.axes)
            raise DescriptionError(
                f"the joints {joints} are {len(tree.axes)} axes beside arm and table",
                file=self.urdf,
                expected=f"at most {MAX_FURTHER_AXES}",
            )

    @cached_property
    def _frames(self) -> dict[int, Array]:
        """``root_from_frame`` (4, 4) of the world and of the axes, with all axes at 0."""
        return {0: np.eye(4)} | {k: _axis_frame(self.tree.joint(k))[0] for k in self.tree.axes}

    @cached_property
    def _names(self) -> dict[int, str]:
        """Names of the world and of the axes."""
        names = {0: WORLD}
        for k in self.tree.axes:
            joint = self.tree.joint(k).name
            name = re.sub(r"[^a-z0-9]+", "_", joint.lower()).strip("_")
            name = name if name[:1].isalpha() else f"axis_{name}".strip("_")
            name = f"{name}_axis" if is_reserved_axis(name) else name
            names[k] = _unused(name, names.values())
            if names[k] != joint:
                self.warnings.append(f"joint '{joint}' is the axis '{names[k]}'")
        return names

    @cached_property
    def _owners(self) -> dict[str, str]:
        """Name of the body of the cell of each link that the world or an axis carries: base, table_base, or empty.

        It is that of the nearest link above on which arm or table stand; only itself, if that is the root.
        """
        tree = self.tree
        stands = {} if tree.table is None else {self._below_table: "table_base"}
        stands[tree.base] = "base"
        owners: dict[str, str] = {}
        for k in self._frames:
            for link in tree.bodies[k].links.values():
                carrier = tree.bodies[k].links.get(link.parent)
                above = owners[carrier.name] if carrier is not None and carrier.parent else ""
                owners[link.name] = stands.get(link.name, above)
        return owners

    @property
    def _below_table(self) -> str:
        """The link on which the table turns."""
        assert self.tree.table is not None
        return next(iter(self.tree.bodies[self.tree.table].links.values())).parent

    def _robot(self, home_deg: Sequence[float], hold: Sequence[int]) -> tuple[dict[str, Any], Array]:
        tree = self.tree
        carrier = tree.bodies[tree.arm[0]].carrier
        to_carrier = pose.inverse(self._frames[carrier])
        joints = [tree.joint(k) for k in tree.arm]
        chain, last_from_tip = dh_from_axes(
            pose.transform_points(to_carrier, np.array([joint.point for joint in joints])),
            np.array([joint.direction for joint in joints]) @ to_carrier[:3, :3].T,
            to_carrier @ tree.tip,
        )
        rows = [(1e3 * one.a, 1e3 * one.d, *np.degrees([one.alpha, one.beta, one.theta])) for one in chain.joints]
        keys = ("a_mm", "d_mm", "alpha_deg", "beta_deg", "theta_deg")
        described: list[dict[str, Any]] = [dict(zip(keys, _rounded(row), strict=True)) for row in rows]
        for row, joint in zip(described, joints, strict=True):
            low, high, speed = np.degrees([joint.lower, joint.upper, joint.max_speed]).round(6).tolist()
            row |= {"min_deg": low, "max_deg": high, "max_speed_deg_s": speed}
            row["max_acceleration_deg_s2"] = _rounded([speed / RAMP_TIME])[0]
        data: dict[str, Any] = {"name": tree.name, "base": _pose_data(chain.world_from_base), "joint": described}
        data["home_deg"] = list(home_deg) or [min(max(0.0, row["min_deg"]), row["max_deg"]) for row in described]
        data["held"] = [{"joint": number} for number in hold]
        self._add_bodies(data, chain, carrier)
        return data, last_from_tip

    def _add_bodies(self, data: dict[str, Any], chain: Chain, carrier: int) -> None:
        """Masses of the links, and the meshes of the base and of them, in their frames."""
        tree = self.tree
        folder = self.out.with_suffix("")
        for k, carrier_from_link in enumerate(chain.link_poses(np.zeros(len(tree.arm)))):
            link_from_root = pose.inverse(self._frames[carrier] @ carrier_from_link)
            links = list(tree.bodies[carrier if k == 0 else tree.arm[k - 1]].links.values())
            if k == 0 and self.cell is not None:
                links = [link for link in links if self._owners[link.name] == "base"]
            row = data if k == 0 else data["joint"][k - 1]
            masses = [mass.seen_from(link_from_root) for link in links for mass in link.masses]
            if k > 0 and masses:
                row["inertia"] = _inertia_data(masses)
            name, file = ("base_mesh", "base.stl") if k == 0 else ("mesh", f"link{k}.stl")
            self._add_mesh(row, name, folder / file, link_from_root, links)

    def _add_mesh(
        self, row: dict[str, Any], key: str, file: Path, frame_from_root: Array, links: Sequence[UrdfLink]
    ) -> None:
        """Name the mesh of some links in a frame under a key of a table, if they have one that a cell can load."""
        meshes = _seen_from(frame_from_root, links)
        if not meshes:
            return
        with tempfile.TemporaryDirectory() as folder:
            checked = Path(folder) / file.name
            _write_mesh(checked, meshes)
            try:
                load_mesh(checked)
            except MeshError as error:
                names = ", ".join(f"'{link.name}'" for link in links if link.meshes)
                fault = str(error).removeprefix(f"{checked}: ")
                self.warnings.append(f"left out the mesh of link {names}, which no cell can load: {fault}")
                return
        self.meshes[file] = meshes
        row[key] = str(file.resolve())

    def _cell(self, folder: Path, tip: str, robot: dict[str, Any], flange_from_tip: Array) -> CellDescription:
        tree, default = self.tree, CellDescription.default()
        data: dict[str, Any] = {"name": tree.name, "robot": robot}
        data["robot_moves_with"] = self._names[tree.bodies[tree.arm[0]].carrier]
        data["sensor_mesh"] = default.sensor_mesh
        data["tool"] = default.tool.model_dump(exclude_defaults=True)
        if np.abs(flange_from_tip - np.eye(4)).max() > _SAME:
            sensor = flange_from_tip @ tool_matrix(default.tool)
            data["tool"] = {"flange_from_sensor": _pose_data(sensor)}
        self.warnings.append(f"the sensor and its pose on link '{tip}' are those of the default cell (tool)")
        data["axis"] = [self._axis(k) for k in tree.axes]
        if tree.table is None:
            data["table"] = default.table.model_dump(exclude_defaults=True)
            self.warnings.append("no link is named as table: that of the default cell is taken, at table.pose")
        else:
            data["table"] = self._table(folder, tree.table, default)
        data["obstacle"] = self._obstacles(folder)
        return validate(CellDescription, data, str(self.urdf))

    def _axis(self, number: int) -> dict[str, Any]:
        joint, carrier = self.tree.joint(number), self.tree.bodies[number].carrier
        frame, along = _axis_frame(joint)
        unit, scale = ("deg", np.degrees(1.0)) if joint.kind == "revolute" else ("mm", 1e3)
        low, high, speed = (round(scale * value, 6) for value in (joint.lower, joint.upper, joint.max_speed))
        return {
            "name": self._names[number],
            "kind": joint.kind,
            "moves_with": self._names[carrier],
            "pose": _pose_data(pose.inverse(self._frames[carrier]) @ frame),
            "along": along,
            f"min_{unit}": low,
            f"max_{unit}": high,
            f"start_{unit}": min(max(0.0, low), high),
            f"max_speed_{unit}_s": speed,
            f"max_acceleration_{unit}_s2": _rounded([speed / RAMP_TIME])[0],
        }

    def _table(self, folder: Path, number: int, default: CellDescription) -> dict[str, Any]:
        tree = self.tree
        joint, body = tree.joint(number), tree.bodies[number]
        root_from_table = self._table_frame(joint, body.links[tree.table_link])
        data: dict[str, Any] = {"moves_with": self._names[body.carrier]}
        links = list(body.links.values())
        meshes = _seen_from(pose.inverse(root_from_table), links)
        if meshes:
            corners = np.concatenate([vertices[np.unique(faces)] for vertices, faces in meshes])
            highest = float(corners[:, 2].max())
            top = max(0.0, highest)
            if highest > _SAME:
                root_from_table = root_from_table @ pose.translation((0.0, 0.0, top))
                self.warnings.append(
                    f"the top of the table is that of the meshes of link '{tree.table_link}', {1e3 * top:.3f} mm above"
                    " its origin"
                )
            elif highest < -_GAP:
                self.warnings.append(
                    f"the top of the table is the origin of link '{tree.table_link}', {-1e3 * highest:.3f} mm above the"
                    " meshes that turn"
                )
            data["radius_mm"] = _rounded([1e3 * np.hypot(*corners[:, :2].T).max()])[0]
            data["thickness_mm"] = max(_rounded([1e3 * (top - corners[:, 2].min())])[0], 0.001)
            self._add_mesh(data, "platter_mesh", folder / "table.stl", pose.inverse(root_from_table), links)
        else:
            data["radius_mm"], data["thickness_mm"] = default.table.radius_mm, default.table.thickness_mm
            self.warnings.append(f"link '{tree.table_link}' has no mesh: radius and thickness of the table are assumed")
        data["pose"] = _pose_data(pose.inverse(self._frames[body.carrier]) @ root_from_table)
        under = [link for link in tree.bodies[body.carrier].links.values() if self._owners[link.name] == "table_base"]
        self._add_mesh(data, "base_mesh", folder / "table_base.stl", pose.inverse(root_from_table), under)
        speed = round(np.degrees(joint.max_speed), 6)
        data |= {"max_speed_deg_s": speed, "max_acceleration_deg_s2": _rounded([speed / RAMP_TIME])[0]}
        low, high = np.degrees([joint.lower, joint.upper])
        if (low, high) != (-360.0, 360.0):
            self.warnings.append(
                f"the table turns without limits; joint '{joint.name}' has those from {low:.6g} to {high:.6g} deg"
            )
        return data

    def _table_frame(self, joint: UrdfJoint, link: UrdfLink) -> Array:
        """``root_from_table`` (4, 4): z along the joint, like z of the link or else upwards, x like x of the link."""
        axis, frame = joint.direction, link.root_from_link
        is_along = np.linalg.norm(np.cross(frame[:3, 2], axis)) < _ALONG
        z = axis if (frame[:3, 2] @ axis if is_along else axis[2] + _ALONG) > 0 else -axis
        across = [column - (column @ z) * z for column in frame[:3, :2].T]
        x = max(across, key=lambda column: round(float(np.linalg.norm(column)), 6))
        x = x / np.linalg.norm(x)
        origin = joint.point + ((frame[:3, 3] - joint.point) @ axis) * axis
        made = pose.from_rotation(np.column_stack([x, np.cross(z, x), z]), origin)
        if not is_along or np.linalg.norm(origin - frame[:3, 3]) > _SAME:
            shown = _pose_data(pose.inverse(frame) @ made)
            text = ", ".join(f"{key} = {value:g}" for key, value in shown.items())
            self.warnings.append(f"the axis of the table is not z of link '{link.name}': its frame in it is {text}")
        if z @ axis < 0:
            self.warnings.append(f"angles of the table are those of joint '{joint.name}' with the other sign")
        return np.asarray(made)

    def _obstacles(self, folder: Path) -> list[dict[str, Any]]:
        """The links that neither arm nor table stands on, each in its own frame."""
        obstacles: list[dict[str, Any]] = []
        taken = {name.lower() for name in RESERVED_NAMES}
        links = [(k, link) for k in self._frames for link in self.tree.bodies[k].links.values()]
        for k, link in links:
            if self._owners[link.name]:
                continue
            plain = re.sub(r"[^A-Za-z0-9_-]", "_", link.name)
            name = _unused(plain if plain[:1].isalpha() else f"link_{plain}", taken)
            frame = pose.inverse(self._frames[k]) @ link.root_from_link
            row: dict[str, Any] = {"name": name, "moves_with": self._names[k], "pose": _pose_data(frame)}
            self._add_mesh(row, "mesh", folder / f"{name}.stl", pose.inverse(link.root_from_link), [link])
            if "mesh" in row:
                taken.add(name.lower())
                obstacles.append(row)
        return obstacles

    def _write_cell(self, file: Path, cell: CellDescription) -> None:
        """Write the cell, which names the robot by its file."""
        folder, robot = file.parent.resolve(), self.out.resolve()
        data = cell.model_dump(exclude_defaults=True)
        data["robot"] = str(robot.relative_to(folder) if robot.is_relative_to(folder) else robot)
        with atomic_write(file) as temporary:
            temporary.write_text(toml_text(data, folder), encoding="utf-8")


def _axis_frame(joint: UrdfJoint) -> tuple[Array, str]:
    """``root_from_frame`` (4, 4) of what a joint moves at 0, and the coordinate axis of it along which the joint is.

    That is the frame of the file where the joint is along one of its coordinate axes.
    """
    for along, direction in zip("xyz", np.eye(3), strict=True):
        if np.array_equal(joint.axis, direction):
            return joint.root_from_joint, along
    least = np.eye(3)[np.abs(joint.axis).argmin()]
    x = np.cross(least, joint.axis)
    x /= np.linalg.norm(x)
    turned = pose.from_rotation(np.column_stack([x, np.cross(joint.axis, x), joint.axis]))
    return np.asarray(joint.root_from_joint @ turned), "z"


def _unused(name: str, taken: Collection[str]) -> str:
    """The name, or with a number what is not taken, whatever its case."""
    number, found = 1, name
    while found.lower() in taken:
        number += 1
        found = f"{name}_{number}"
    return found


def _seen_from(frame_from_root: Array, links: Sequence[UrdfLink]) -> _Meshes:
    """The meshes of some links in a frame."""
    meshes = [mesh for link in links for mesh in link.meshes]
    return [(pose.transform_points(frame_from_root, vertices), faces) for vertices, faces in meshes]


def _inertia_data(masses: Sequence[MassProperties]) -> dict[str, Any]:
    """Mass, centre of mass and inertia about it of all links of a body together."""
    whole = reduce(MassProperties.joined_with, masses)
    return {
        "mass_kg": whole.mass,
        "centre_of_mass_mm": _rounded(1e3 * whole.centre_of_mass),
        "inertia_kg_m2": _rounded(np.diag(whole.inertia)),
        "products_kg_m2": _rounded(whole.inertia[[0, 0, 1], [1, 2, 2]]),
    }


def _write_mesh(file: Path, meshes: _Meshes) -> None:
    """All meshes of a body as one binary STL file in mm."""
    corners = np.concatenate([vertices[faces].reshape(-1, 3) for vertices, faces in meshes]) * 1e3
    with atomic_write(file) as temporary:
        write_stl(temporary, corners, np.arange(len(corners)).reshape(-1, 3))


def _pose_data(target_from_source: Array) -> dict[str, float]:
    angles = np.degrees(pose.euler_xyz_from_rotation(target_from_source[:3, :3]))
    values = [*_rounded(1e3 * target_from_source[:3, 3]), *_rounded(angles)]
    keys = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    return {key: value for key, value in zip(keys, values, strict=True) if value != 0.0}


def _rounded(values: Any) -> list[float]:
    return [float(value) + 0.0 for value in np.round(np.asarray(values, float), _DIGITS)]
