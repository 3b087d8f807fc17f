"""Bounds on how far bodies of a cell move relative to each other while its axes move by bounded angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.nominal.cell import Body, NominalCell

Array = NDArray[np.float64]


class MotionBounds:
    """Motion bounds of pairs of bodies, by their bounding spheres.

    Parameters
    ----------
    nominal
        Kinematics and bodies.
    pairs
        Names of the bodies of each pair.
    """

    def __init__(self, nominal: NominalCell, pairs: Sequence[tuple[str, str]]) -> None:
        self._arm = nominal.arm
        joints = len(nominal.arm.joints)
        spheres = [_sphere(nominal, body) for body in nominal.bodies]
        self._carried = np.array([carried for carried, _, _ in spheres], np.int64)  # joints that carry each body
        self._centre = np.array([np.append(centre, 1.0) for _, centre, _ in spheres])  # in the frame of the last one
        self._radius = np.array([radius for _, _, radius in spheres])
        # Farthest that the frame after joint m can be from the axis of joint k <= m is the sum from k to m.
        length = np.append(0.0, np.cumsum([np.hypot(joint.a, joint.d) for joint in nominal.arm.joints]))
        self._farthest = np.maximum(length[self._carried][:, None] - length[None, :joints], 0.0)
        self._farthest += np.linalg.norm(self._centre[:, :3], axis=1)[:, None]
        self._carries = np.arange(joints) < self._carried[:, None]
        number = {body.name: i for i, body in enumerate(nominal.bodies)}
        index = np.array([(number[a], number[b]) for a, b in pairs], np.int64).reshape(-1, 2)
        outer_first = self._carried[index[:, 0]] > self._carried[index[:, 1]]
        inner, outer = np.where(outer_first[:, None], index[:, ::-1], index).T
        self._outer = outer
        self._between = self._carries[outer] & ~self._carries[inner]
        on_table = np.array([_radius_on_table(nominal, body) for body in nominal.bodies])[index]
        turned = np.isfinite(on_table)
        self._table_radius = np.where(turned.sum(1) == 1, np.where(turned, on_table, 0.0).max(1), 0.0)

    def pairs(self, at: Array, half_travel: Array) -> Array:
        """Bounds (..., n, pairs), m, on the motion of a body relative to the other while no axis moves by more.

        `at` is (n, joints + 1) and `half_travel` (..., n, joints + 1), rad.
        """
        reach = self._reach(at[:, :-1], half_travel[..., :-1])[..., self._outer, :]
        by_joints = (reach * (half_travel[..., None, :-1] * self._between)).sum(-1)
        return np.asarray(by_joints + half_travel[..., -1:] * self._table_radius)

    def _reach(self, q: Array, half_travel: Array) -> Array:
        """Bounds (..., n, bodies, joints), m, on the distance of a body's points from the axes that carry it."""
        frames = self._arm.link_poses(q)
        centre = np.einsum("nbij,bj->nbi", frames[:, self._carried], self._centre)[..., None, :3]
        x, y, z = np.moveaxis(centre - frames[:, None, :-1, :3, 3], -1, 0)
        u, v, w = np.moveaxis(frames[:, None, :-1, :3, 2], -1, 0)
        radius = np.sqrt((v * z - w * y) ** 2 + (w * x - u * z) ** 2 + (u * y - v * x) ** 2) + self._radius[:, None]
        # Joints beyond joint k move the body towards its axis or away from it.
        shift = half_travel[..., None, :] * np.where(self._carries, self._farthest, 0.0)
        beyond = np.cumsum(shift[..., ::-1], -1)[..., ::-1] - shift
        return np.asarray(radius + beyond)


def _sphere(nominal: NominalCell, body: Body) -> tuple[int, Array, float]:
    """Joints that carry a body, and its bounding sphere: centre in the frame of the last of them and radius, m."""
    frame, _, number = body.moves_with.partition("[")
    joints = len(nominal.arm.joints)
    vertices = body.mesh.vertices
    carried = 0
    if frame == "link":
        carried = int(number.rstrip("]"))
    elif frame in ("sensor", "finger"):
        carried = joints
        frames = nominal.frame_poses(nominal.home, np.array(0.0))
        flange_from_body = pose.inverse(frames[f"link[{joints}]"]) @ frames[body.moves_with]
        vertices = pose.transform_points(flange_from_body, vertices)
    centre = (vertices.min(0) + vertices.max(0)) / 2
    return carried, centre, float(np.linalg.norm(vertices - centre, axis=1).max())


def _radius_on_table(nominal: NominalCell, body: Body) -> float:
    """Largest distance of a body's points from the table's axis, m; infinite if it does not turn with the table."""
    here, turned = (nominal.frame_poses(nominal.home, np.array(angle)) for angle in (0.0, 1.0))
    if np.allclose(here[body.moves_with], turned[body.moves_with]):
        return float("inf")
    table_from_body = pose.inverse(here["table"]) @ here[body.moves_with]
    return float(np.linalg.norm(pose.transform_points(table_from_body, body.mesh.vertices)[:, :2], axis=1).max())
