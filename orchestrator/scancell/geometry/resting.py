"""Poses in which a part rests on a plane by gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, is_stable_pose, mass_properties

Array = NDArray[np.float64]

LEAST_TIP_ANGLE = np.radians(6.0)
"""Poses that tip over at a smaller tilt of the plane do not count: the facets of a ball."""
_SAME_PLANE = 1e-4  # m between a corner of the hull and the plane of a face in which it counts as lying


@dataclass(frozen=True)
class RestingPose:
    """A stable pose.

    Attributes
    ----------
    rotation
        (3, 3) ``table_from_part``; the part rests on its lowest points. The turn about the vertical is arbitrary.
    tip_angle
        Tilt of the plane at which the part tips over, rad.
    """

    rotation: Array
    tip_angle: float


def resting_poses(part: Mesh) -> list[RestingPose]:
    """Stable poses of the part on a plane, the most stable first.

    A part of uniform density rests on a face of its convex hull if its centre of mass is above the inside of that face.
    """
    hull, centre = part.hull, mass_properties(part, 1.0).centre_of_mass
    order = np.argsort(-hull.areas, kind="stable")
    used = np.unique(hull.faces)
    corners = hull.vertices[used]
    done = np.zeros(len(hull.faces), bool)
    result = []
    for face in order:
        if done[face] or not hull.areas[face] > 0:
            continue
        normal = hull.normals[face]
        offset = float(hull.vertices[hull.faces[face, 0]] @ normal)
        done |= (np.abs(hull.vertices[hull.faces] @ normal - offset) < _SAME_PLANE).all(1)
        feet = corners[np.abs(corners @ normal - offset) < _SAME_PLANE]
        height = offset - float(centre @ normal)
        rotation = _turned_down(normal)
        margin = _margin((feet - centre) @ rotation.T)
        tip_angle = float(np.arctan2(margin, height))
        if tip_angle < LEAST_TIP_ANGLE:
            continue
        if is_stable_pose(part, pose.from_rotation(rotation)):
            result.append(RestingPose(rotation, tip_angle))
    return sorted(result, key=lambda rest: -rest.tip_angle)


def _turned_down(normal: Array) -> Array:
    """Rotation (3, 3) by the smallest angle that turns a unit vector (3,) to -z."""
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine, cosine = float(np.linalg.norm(axis)), -float(normal[2])
    if sine < 1e-9:
        return np.asarray(pose.rotation_about(0, 0.0 if cosine > 0 else np.pi))
    return np.asarray(pose.exp_rotation(axis / sine * np.arctan2(sine, cosine)))


def _margin(feet: Array) -> float:
    """Distance from the centre, the origin, to the rim of the hull of the feet (n, 3) in the plane, m; < 0 outside."""
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415  (a third of a second)

    try:
        # Half planes of the hull: normal @ x + offset <= 0.
        return float(-ConvexHull(feet[:, :2]).equations[:, 2].max())
    except QhullError:  # all on one line, nearly
        return 0.0
