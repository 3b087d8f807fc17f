"""How much of the visible laser lines has points, worked out without any code of the project.

The sheet of an exposure cuts the mesh in lines. A place on them can be measured when the laser's light reaches it, a
camera sees it in its image and within the range, both at less than the given angle to the normal. Cutting is
trimesh's, visibility Open3D's; the sensor's dimensions are written out.
"""

from __future__ import annotations

import numpy as np
import open3d
import trimesh
from scipy.spatial import cKDTree

from scancell.results import ScanResult

BASELINE, TILT, GAMMA = 0.060, np.radians(29.3), np.radians(9.34)
ASPECT, FAN_HALF_ANGLE, NEAR, FAR = 1280 / 1024, np.radians(16.0), 0.0751, 0.165
STEP = 0.3e-3  # m between places on a line
LIFT = 10e-6  # m off the surface where sight lines start
LOWEST = 1e-3  # m over the table: below it, points are taken for the table's


def visible_places(
    part: trimesh.Trimesh,
    scene: open3d.t.geometry.RaycastingScene,
    part_from_sensor: np.ndarray,
    incidence_limit: float,
) -> np.ndarray:
    """Places (n, 3) of the part, m, on the laser line of one exposure, that can be measured."""
    normal, origin = part_from_sensor[:3, 0], part_from_sensor[:3, 3]
    segments, face = trimesh.intersections.mesh_plane(part, normal, origin, return_faces=True)
    if len(segments) == 0:
        return np.zeros((0, 3))
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    # One place per STEP of line, at a random share of its segment.
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(segments), max(1, round(length.sum() / STEP)), p=length / length.sum())
    share = rng.random(len(chosen))[:, None]
    places = segments[chosen, 0] * (1 - share) + segments[chosen, 1] * share
    normals = part.face_normals[face[chosen]]
    in_sensor = (places - origin) @ part_from_sensor[:3, :3]
    in_fan = np.abs(in_sensor[:, 1]) <= in_sensor[:, 2] * np.tan(FAN_HALF_ANGLE)
    lit = in_fan & (in_sensor[:, 2] >= NEAR) & (in_sensor[:, 2] <= FAR)
    lit &= in_sight(places, normals, origin, scene, incidence_limit)
    seen = np.zeros(len(places), bool)
    for side in (1, -1):
        centre = origin + side * BASELINE * part_from_sensor[:3, 0]
        seen |= in_image(in_sensor, side) & in_sight(places, normals, centre, scene, incidence_limit)
    return places[lit & seen]


def in_image(points: np.ndarray, side: int) -> np.ndarray:
    """Whether points (n, 3) of the sheet fall into the image of a camera."""
    s, c = np.sin(TILT), np.cos(TILT)
    x = points - [side * BASELINE, 0, 0]
    forward = -side * s * x[:, 0] + c * x[:, 2]
    down = side * c * x[:, 0] + s * x[:, 2]
    half = np.tan(GAMMA)
    return (np.abs(down) <= half * forward) & (np.abs(x[:, 1]) <= ASPECT * half * forward)


def in_sight(places, normals, viewpoint, scene: open3d.t.geometry.RaycastingScene, limit: float) -> np.ndarray:
    """Whether each place faces the viewpoint at less than `limit` and nothing stands between."""
    way = viewpoint - places
    cosine = np.einsum("ij,ij->i", way, normals) / np.linalg.norm(way, axis=1)
    good = cosine > np.cos(limit)
    rays = np.hstack([places[good] + LIFT * normals[good], way[good]]).astype(np.float32)
    good[good] = ~scene.test_occlusions(open3d.core.Tensor(rays), tnear=0.0, tfar=1.0).numpy()
    return good


def covered_share(result: ScanResult, radius: float, incidence_limit: float, exposures: int = 60) -> float:
    """Share of the visible places of some exposures that have a point of the same exposure within `radius`, m."""
    nominal, cloud = result.nominal, result.cloud
    part = trimesh.Trimesh(nominal.part.vertices, nominal.part.faces, process=False)
    table = next(body.mesh for body in nominal.bodies if body.name == "table")
    placed = trimesh.Trimesh(table.vertices, table.faces, process=False)
    placed.apply_transform(np.linalg.inv(nominal.table_from_part))
    scene = open3d.t.geometry.RaycastingScene()
    for mesh in (part, placed):
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    measured = result.recording.measured
    poses = nominal.part_from_sensor(measured.axes)
    total = covered = 0
    for row in np.unique(np.linspace(0, len(poses) - 1, exposures).round().astype(int)):
        places = visible_places(part, scene, poses[row], incidence_limit)
        height = places @ nominal.table_from_part[2, :3] + nominal.table_from_part[2, 3]
        places = places[height > LOWEST]
        own = cloud.points_in_part[cloud.profile == measured.index[row]]
        total += len(places)
        if len(own) and len(places):
            covered += int((cKDTree(own).query(places)[0] <= radius).sum())
    assert total > 1000
    return covered / total
