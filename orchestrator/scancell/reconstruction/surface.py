"""Surface of a cloud as a triangle mesh, by the reconstructions of Open3D.

Poisson: M. Kazhdan and H. Hoppe, "Screened Poisson surface reconstruction", ACM Transactions on Graphics 32 (2013). It
closes every surface; where it has no points, its density is low, and it is cut off.
Ball pivoting: F. Bernardini et al., IEEE Transactions on Visualization and Computer Graphics 5 (1999). It joins points.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.choices import Reconstruction
from scancell.errors import FitError, MeshError
from scancell.extras import require
from scancell.files import atomic_write
from scancell.geometry.mesh import FORMATS, Mesh
from scancell.reconstruction.cloud import Cloud

Array = NDArray[np.float64]

_LEAST_POINTS = 100
_DETAILS = 250  # along the extent, by default
_SPARSE = 1.5  # levels of the octree below the typical density from which on the surface is cut off
_DEPTHS = (5, 11)
_MARGIN = 1.1  # size of the octree, of the extent (Open3D's default)
_BALLS = (1.0, 2.0, 4.0)  # radii, of the spacing
_SMALL = 0.01  # pieces with less of the area are left out
_MM = 1e3


def reconstruct_surface(cloud: Cloud, method: Reconstruction = "poisson", spacing: float | None = None) -> Mesh:
    """Surface of a cloud in the part frame, m; points without a normal do not take part.

    Raises `FitError` with fewer than 100 points with normals; `MissingExtraError` without Open3D.

    Parameters
    ----------
    spacing
        Size of the smallest details, m; by default 1/250 of the extent. Points are averaged in cells of half of it.
    """
    open3d = require("open3d", "mesh")
    kept = np.isfinite(cloud.normals).all(1) & (np.linalg.norm(cloud.normals, axis=1) > 0.5)
    if int(kept.sum()) < _LEAST_POINTS:
        raise FitError(f"surface: {int(kept.sum())} points with normals; at least {_LEAST_POINTS} are needed")
    points, normals = cloud.points_in_part[kept], cloud.normals[kept]
    extent = float(np.ptp(points, axis=0).max())
    size = extent / _DETAILS if spacing is None else spacing
    given = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    given.normals = open3d.utility.Vector3dVector(normals)
    if method == "poisson":
        found = _poisson(open3d, given.voxel_down_sample(size / 2), extent, size)
    else:
        given = given.voxel_down_sample(size)
        radii = open3d.utility.DoubleVector([ratio * size for ratio in _BALLS])
        found = open3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(given, radii)
    if not len(found.triangles):
        raise FitError(f"surface: no faces at a spacing of {1e3 * size:g} mm; points lie farther apart")
    return _cleaned(found)


def write_surface(surface: Mesh, path: Path) -> None:
    """Write a mesh in mm as STL, PLY or OBJ, by its suffix.

    Raises `MeshError` if the suffix is another one; `OutputError` if the file cannot be written.
    """
    import trimesh  # noqa: PLC0415  (takes a while to import)

    if path.suffix.lower() not in FORMATS:
        raise MeshError(file=path, expected=f"a file name that ends in {', '.join(FORMATS)}")
    solid = trimesh.Trimesh(_MM * surface.vertices, surface.faces, process=False)
    with atomic_write(path) as temporary:
        solid.export(temporary, file_type=path.suffix.lower().removeprefix("."))


def _poisson(open3d: Any, given: Any, extent: float, size: float) -> Any:
    depth = int(np.clip(np.ceil(np.log2(_MARGIN * extent / size)), *_DEPTHS))
    # One thread: its sums depend on the number of threads.
    found, density = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(given, depth=depth, n_threads=1)
    density = np.asarray(density)
    found.remove_vertices_by_mask(density < np.median(density) - _SPARSE)
    return found


def _cleaned(found: Any) -> Mesh:
    """The mesh without degenerate faces, small pieces and unused vertices."""
    found.remove_degenerate_triangles()
    found.remove_duplicated_triangles()
    piece, _, areas = (np.asarray(part) for part in found.cluster_connected_triangles())
    found.remove_triangles_by_mask(areas[piece] < _SMALL * areas.sum())
    found.remove_unreferenced_vertices()
    return Mesh(np.asarray(found.vertices), np.asarray(found.triangles).astype(np.int64), "surface")
