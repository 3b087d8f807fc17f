"""Further arms in millimetres: links with offsets instead of a spherical wrist, seven links as a URDF file, and links
that Denavit-Hartenberg rows of an arm with a spherical wrist determine.

The offset arm is drawn in its Denavit-Hartenberg frames: upper arm and forearm lie in planes beside each other, so that
the elbow folds past. The seven-axis arm is drawn in the frames of its URDF file: frames of even links have y upwards
with the arm stretched up, the others z.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import Manifold
from shapes import block, drum, hull, ring_of, union

DENSITY = 2000.0  # kg/m³ inside the links of the URDF file, motors and cavities included


def offset_base() -> Manifold:
    """Foot and column in the base frame."""
    bolts = ring_of(drum(6, 10, 22, at=(78, 0, 0), chamfer=1, segments=24), 4, start_deg=45)
    return union([drum(92, 0, 16, chamfer=2), drum(66, 10, 78, chamfer=4), *bolts])


def offset_link1(height: float = 160.0) -> Manifold:
    """Shoulder: turns about y, `height` above the base; the upper arm turns about z."""
    column = drum(62, 76 - height, -30, axis="y", chamfer=3)
    housing = hull(drum(58, -60, 60, chamfer=8), drum(60, -60, -30, axis="y", chamfer=4))
    return union([column, housing])


def offset_link2(from_x: float = -400.0) -> Manifold:
    """Upper arm from the shoulder at x = `from_x` to the elbow at the origin, in the plane z = 110."""
    shoulder = (from_x, 0.0, 0.0)
    tube = hull(drum(44, 70, 150, at=shoulder, chamfer=12), drum(40, 70, 150, chamfer=12))
    return union([tube, drum(57, 58, 158, at=shoulder, chamfer=8), drum(48, 64, 158, chamfer=8)])


def offset_link3(from_x: float = -380.0) -> Manifold:
    """Forearm from the elbow at x = `from_x` to the first wrist axis at the origin, in the plane z = 20."""
    elbow = (from_x, 0.0, 0.0)
    tube = hull(drum(38, -16, 56, at=elbow, chamfer=12), drum(33, -14, 54, chamfer=12))
    return union([tube, drum(47, -24, 66, at=elbow, chamfer=7), drum(38, -22, 62, chamfer=6)])


def offset_link4(offset: float = 130.0) -> Manifold:
    """First wrist link: turns about y, `offset` behind, carries the axis z."""
    return union([drum(37, 60 - offset, 34, axis="y", chamfer=5), drum(36, -40, 46, chamfer=5)])


def offset_link5(offset: float = 95.0) -> Manifold:
    """Second wrist link: turns about y, `offset` after the first one, carries the axis z."""
    return union([drum(36, -38, offset - 45, axis="y", chamfer=5), drum(35, -38, 44, chamfer=5)])


def offset_link6(offset: float = 90.0) -> Manifold:
    """Flange after ISO 9409-1-50: face at z = 0, `offset` after the wrist, four threads on a 50 mm circle."""
    body = union([drum(33, 42 - offset, -12, chamfer=2), drum(31.5, -20, 0, chamfer=1)])
    return body - union(ring_of(drum(3, -10, 1, at=(25, 0, 0), chamfer=0, segments=20), 4, start_deg=45))


def _upright(length: float) -> Manifold:
    """Link that turns about z and carries a joint about y at height `length`, on its side of y < -6."""
    column = drum(60, -8, length - 82, chamfer=4)
    cheek = hull(drum(56, -64, -8, axis="y", at=(0, 0, length), chamfer=6), block((-50, -58, 0), (50, -8, length - 90)))
    return union(
        [
            column,
            cheek,
            hull(drum(58, length - 110, length - 84, chamfer=4), block((-50, -58, 20), (50, -8, length - 70))),
        ]
    )


def _lying(length: float) -> Manifold:
    """The same upside down: turns about y on the side of y > -6, and carries a joint about z at height `length`."""
    hub = drum(56, -8, 60, axis="y", chamfer=6)
    neck = hull(drum(50, -4, 54, axis="y", chamfer=6), drum(54, 84, length - 10, chamfer=4))
    # Into the frame of the URDF file, which has y upwards and z ahead of x and y.
    return union([hub, neck, drum(57, length - 40, length - 7, chamfer=3)]).rotate((-90, 0, 0))


def seven_base() -> Manifold:
    """Foot, in the root frame."""
    return union([drum(100, 0, 20, chamfer=3), drum(70, 10, 153, chamfer=6)])


def seven_link1() -> Manifold:
    """Shoulder, joint 2 at z = 180."""
    return _upright(180.0)


def seven_link2() -> Manifold:
    """Lower half of the upper arm, joint 3 at 210."""
    return _lying(210.0)


def seven_link3() -> Manifold:
    """Upper half of the upper arm, joint 4 at z = 190."""
    return _upright(190.0)


def seven_link4() -> Manifold:
    """Lower half of the forearm, joint 5 at 210."""
    return _lying(210.0)


def seven_link5() -> Manifold:
    """Upper half of the forearm, joint 6 at z = 190."""
    return _upright(190.0)


def seven_link6() -> Manifold:
    """Wrist, joint 7 at 80."""
    hub = drum(50, -8, 52, axis="y", chamfer=6)
    neck = hull(drum(44, -4, 46, axis="y", chamfer=6), drum(42, 40, 72, chamfer=4))
    return union([hub, neck]).rotate((-90, 0, 0))


def seven_link7() -> Manifold:
    """Flange after ISO 9409-1-50: face at z = 45."""
    body = union([drum(38, -10, 30, chamfer=3), drum(31.5, 20, 45, chamfer=1)])
    return body - union(ring_of(drum(3, 35, 46, at=(25, 0, 0), chamfer=0, segments=20), 4, start_deg=45))


# Joint: origin in the frame before (mm and rad), limit (deg), speed (deg/s). All turn about their z.
_ASIDE = 1.5707963267948966
SEVEN_JOINTS = (
    ((0, 0, 160), 0.0, 170, 98),
    ((0, 0, 180), _ASIDE, 120, 98),
    ((0, 210, 0), -_ASIDE, 170, 100),
    ((0, 0, 190), _ASIDE, 120, 130),
    ((0, 210, 0), -_ASIDE, 170, 140),
    ((0, 0, 190), _ASIDE, 120, 180),
    ((0, 80, 0), -_ASIDE, 175, 180),
)


def seven_axis_urdf(meshes: Path) -> str:
    """URDF of the seven-axis arm; masses and inertias are those of the meshes, link0.stl to link7.stl in mm."""
    lines = ['<?xml version="1.0"?>', '<robot name="seven_axis">']
    for k in range(len(SEVEN_JOINTS) + 1):
        lines += _link(k, trimesh.load(meshes / f"link{k}.stl"))
    for k, ((x, y, z), roll, limit, speed) in enumerate(SEVEN_JOINTS, 1):
        low, high, velocity = np.radians([-limit, limit, speed])
        lines += [
            f'  <joint name="joint{k}" type="revolute">',
            f'    <origin xyz="{x / 1e3:g} {y / 1e3:g} {z / 1e3:g}" rpy="{roll!r} 0 0"/>',
            f'    <parent link="link{k - 1}"/>',
            f'    <child link="link{k}"/>',
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="{low:.12g}" upper="{high:.12g}" velocity="{velocity:.12g}" effort="200"/>',
            "  </joint>",
        ]
    lines += [
        '  <link name="flange"/>',
        '  <joint name="flange_joint" type="fixed">',
        '    <origin xyz="0 0 0.045" rpy="0 0 0"/>',
        '    <parent link="link7"/>',
        '    <child link="flange"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _link(number: int, mesh: trimesh.Trimesh) -> list[str]:
    mesh.apply_scale(1e-3)
    mesh.density = DENSITY
    centre = " ".join(f"{value:.6f}" for value in mesh.center_mass.round(6) + 0.0)
    tensor = {
        f"i{a}{b}": mesh.moment_inertia["xyz".index(a), "xyz".index(b)] for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
    }
    inertia = " ".join(f'{key}="{round(value, 8) + 0.0:.8f}"' for key, value in tensor.items())
    return [
        f'  <link name="link{number}">',
        "    <inertial>",
        f'      <origin xyz="{centre}" rpy="0 0 0"/>',
        f'      <mass value="{mesh.mass:.6f}"/>',
        f"      <inertia {inertia}/>",
        "    </inertial>",
        "    <visual>",
        "      <geometry>",
        f'        <mesh filename="package://seven_axis_urdf/meshes/link{number}.stl" scale="0.001 0.001 0.001"/>',
        "      </geometry>",
        "    </visual>",
        "  </link>",
    ]


Row = tuple[float, float, float]  # a (mm), d (mm), alpha (deg)


def ball_wrist_base(rows: Sequence[Row]) -> Manifold:
    """Foot and column in the base frame, on the side of z where joint 2 is."""
    height = abs(rows[0][1])
    column = union([drum(92, 0, 16, chamfer=2), drum(74, 10, 0.45 * height, chamfer=4)])
    return column if rows[0][1] > 0 else column.mirror((0, 0, 1))


def ball_wrist_link(number: int, rows: Sequence[Row]) -> Manifold:
    """Link of an arm with a spherical wrist, in its frame, between its two axes by the Denavit-Hartenberg rows."""
    a, d, alpha = rows[number - 1]
    turn = np.radians(alpha)
    axis = np.array([0.0, np.sin(turn), np.cos(turn)])  # of the link's joint
    near, start, end = np.array([-a, 0.0, 0.0]), np.array([-a, 0.0, 0.0]) - d * axis, np.zeros(3)
    if number == 1:
        return union([_capsule(70, start + 0.6 * d * axis, near), _capsule(66, near, end)])
    if number == 2:
        return _capsule(56, near, end)
    if number == 3:
        root = np.array([0.0, 0.0, np.copysign(90.0, rows[3][1])])
        return union([_capsule(52, near, end), _capsule(44, end, root)])
    if number == 4:
        return _capsule(34, start + np.copysign(125.0, d) * axis, end)
    if number == 5:
        seat = np.array([0.0, 0.0, rows[5][1] - np.copysign(52.0, rows[5][1])])
        return union([_capsule(36, end, end), _capsule(25, end, seat)])
    body = union([drum(27, -30, -10, chamfer=2), drum(25, -14, 0, chamfer=1)])
    return body - union(ring_of(drum(3, -10, 1, at=(20, 0, 0), chamfer=0, segments=20), 4, start_deg=45))


def _capsule(radius: float, start: np.ndarray, end: np.ndarray) -> Manifold:
    ball = Manifold.sphere(radius, 48)
    return hull(ball.translate(tuple(start.tolist())), ball.translate(tuple(end.tolist())))
