"""Robot files from URDF files: Denavit-Hartenberg parameters of the joint axes, meshes in the frames of the links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.description import validate
from scancell.config.robot import MAX_JOINTS, RobotDescription
from scancell.config.urdf import UrdfArm, UrdfBody, read_urdf
from scancell.errors import DescriptionError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.geometry.chain import Chain
from scancell.geometry.denavit_hartenberg import dh_from_axes

Array = NDArray[np.float64]

RAMP_TIME = 0.25  # s: to full speed, for a URDF file knows no accelerations
_DIGITS = 10  # of lengths in mm and angles in deg that are kept behind the point


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
    unused
        Joints of the URDF file beside the chain.
    """

    description: RobotDescription
    files: tuple[Path, ...]
    flange_from_tip: Array
    unused: tuple[str, ...]


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
    rows = [(1e3 * one.a, 1e3 * one.d, np.degrees(one.alpha), np.degrees(one.theta)) for one in chain.joints]
    keys = ("a_mm", "d_mm", "alpha_deg", "theta_deg")
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
    return ConvertedRobot(description, (out, *names.values()), last_from_tip, arm.unused)


def _bodies(urdf: UrdfArm, chain: Chain) -> list[UrdfBody]:
    """The bodies in the frames of their links."""
    moved = []
    for body, root_from_link in zip(urdf.bodies, chain.link_poses(np.zeros(len(urdf.joints))), strict=True):
        link_from_root = pose.inverse(root_from_link)
        turn = link_from_root[:3, :3]
        meshes = [(pose.transform_points(link_from_root, vertices), faces) for vertices, faces in body.meshes]
        masses = [
            (mass, turn @ centre + link_from_root[:3, 3], turn @ inertia @ turn.T)
            for mass, centre, inertia in body.masses
        ]
        moved.append(UrdfBody(meshes, masses))
    return moved


def _inertia_data(body: UrdfBody) -> dict[str, Any]:
    """Mass, centre of mass and inertia about it of all links of a body, by Huygens and Steiner's theorem."""
    mass = sum(part[0] for part in body.masses)
    centre = np.sum([part[0] * part[1] for part in body.masses], axis=0) / mass
    total = np.zeros((3, 3))
    for own, place, inertia in body.masses:
        lever = place - centre
        total += inertia + own * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    return {
        "mass_kg": mass,
        "centre_of_mass_mm": _rounded(1e3 * centre),
        "inertia_kg_m2": _rounded(np.diag(total)),
        "products_kg_m2": _rounded([total[0, 1], total[0, 2], total[1, 2]]),
    }


def _write_mesh(file: Path, body: UrdfBody) -> None:
    """All meshes of a body as one binary STL file in mm, without a date or a name."""
    corners = np.concatenate([vertices[faces] for vertices, faces in body.meshes]) * 1e3
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = corners
    with atomic_write(file) as temporary:
        temporary.write_bytes(bytes(80) + np.uint32(len(record)).tobytes() + record.tobytes())


def _pose_data(target_from_source: Array) -> dict[str, float]:
    angles = np.degrees(pose.euler_xyz_from_rotation(target_from_source[:3, :3]))
    values = [*_rounded(1e3 * target_from_source[:3, 3]), *_rounded(angles)]
    keys = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    return {key: value for key, value in zip(keys, values, strict=True) if value != 0.0}


def _rounded(values: Any) -> list[float]:
    return [float(value) + 0.0 for value in np.round(np.asarray(values, float), _DIGITS)]
