"""Point cloud of a scan in the part frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import Shape, checked_arguments, checked_fields
from scancell.arrays import Array
from scancell.config.choices import Reconstruction
from scancell.errors import DescriptionError, FitError, MeshError, require
from scancell.files import atomic_write
from scancell.geometry.mesh import FORMATS, Mesh
from scancell.values import Value

_VECTORS = Shape((None, 3), finite=False)
_NUMBERS, _INTEGERS, _BOOLEANS = Shape((None,), finite=False), Shape((None,), int), Shape((None,), bool)

_LEAST_POINTS = 100
_DETAILS = 250  # along the extent, by default
_SPARSE = 1.5  # levels of the octree below the typical density from which on the surface is cut off
_DEPTHS = (5, 11)
_MARGIN = 1.1  # size of the octree, of the extent (Open3D's default)
_BALLS = (1.0, 2.0, 4.0)  # radii, of the spacing
_SMALL = 0.01  # pieces with less of the area are left out
_MM = 1e3


@checked_fields
@dataclass(frozen=True, eq=False, repr=False)
class Cloud(Value):
    """Point cloud of n points in the part frame (the coordinate system of the mesh file), m and s.

    Attributes
    ----------
    points_in_part, normals
        (n, 3); unit normals point out of the surface, towards the sensor. NaN without neighbours near enough.
    sigma
        (n,) standard deviation along the direction of largest uncertainty, m.
    intensity
        (n,) amplitude of the stripe in the image, digital numbers.
    quality
        (n,) 0 … 1, see `reconstruct.quality_of`.
    camera
        (n,) index of the camera.
    column
        (n,) image column, px; the nearest one for points at a fractional column.
    profile, segment, time
        (n,) index, segment and mid-exposure time (s) of the trigger.
    saturated
        (n,) whether the stripe was saturated, so that its centre is that of its flanks; see `docs/light.md`.
    sensor
        (n,) number of the sensor, from 1: that of the tool; by default of all points.

    Examples
    --------
    >>> cloud = scancell.scan("part.stl", engine="geometric", settings={"scan.max_profiles": 40}).cloud
    >>> sure = cloud[(cloud.sigma < 2e-6) & ~cloud.saturated]
    >>> path = sure.save("cloud.npz")
    >>> len(scancell.Cloud.load(path)) == len(sure)
    True
    """

    points_in_part: Annotated[Array, _VECTORS]
    normals: Annotated[Array, _VECTORS]
    sigma: Annotated[NDArray[np.floating[Any]], _NUMBERS]
    intensity: Annotated[NDArray[np.floating[Any]], _NUMBERS]
    quality: Annotated[NDArray[np.floating[Any]], _NUMBERS]
    camera: Annotated[NDArray[np.int32], _INTEGERS]
    column: Annotated[NDArray[np.int32], _INTEGERS]
    profile: Annotated[NDArray[np.int32], _INTEGERS]
    segment: Annotated[NDArray[np.int32], _INTEGERS]
    time: Annotated[Array, _NUMBERS]
    saturated: Annotated[NDArray[np.bool_], _BOOLEANS]
    sensor: Annotated[NDArray[np.uint8], _INTEGERS] = field(default_factory=lambda: np.zeros(0, np.uint8))

    def __post_init__(self) -> None:
        """Make points without a sensor those of the first, and refuse columns of different lengths.

        Raises
        ------
        DescriptionError
            Naming the column and its length.
        """
        if not len(self.sensor):
            object.__setattr__(self, "sensor", np.ones(len(self), np.uint8))
        for column in fields(self):
            length = len(getattr(self, column.name))
            if length != len(self):
                raise DescriptionError(f"{length} rows", key=column.name, expected=f"{len(self)}, one for each point")

    def __repr__(self) -> str:
        return f"Cloud({len(self)} points of {len(np.unique(self.profile))} profiles)"

    def __len__(self) -> int:
        return len(self.points_in_part)

    def __getitem__(self, chosen: NDArray[Any] | Sequence[int] | Sequence[bool] | slice) -> Self:
        """The cloud of the points selected by a mask, indices or a slice.

        Raises
        ------
        DescriptionError
            If it is the index of a single point.
        """
        if np.ndim(chosen) == 0 and not isinstance(chosen, slice):  # type: ignore[arg-type]
            raise DescriptionError(f"cloud[{chosen!r}]: expected a mask, a list of indices or a slice")
        return type(self)(**{column.name: getattr(self, column.name)[chosen] for column in fields(self)})

    @checked_arguments
    def save(self, path: str | Path) -> Path:
        """Write the cloud, mm, in the format that the suffix of `path` names: ply, npz, laz, e57, pcd, xyz.

        Raises
        ------
        DescriptionError
            If there is no such format.
        OutputError
            If the file cannot be written.
        """
        from scancell.reconstruction.cloud_files import write_cloud  # noqa: PLC0415  (imports this module)

        write_cloud(Path(path), self)
        return Path(path)

    @staticmethod
    @checked_arguments
    def load(path: str | Path) -> Cloud:
        """The cloud of the PLY or NPZ file `path` that `save` or a scan has written.

        Files hold mm, so positions may differ in the last digit; PLY rounds all values but positions and times. In
        files of earlier versions no point is marked as saturated.

        Raises
        ------
        MeshError
            If the file is missing or not a cloud of scancell.
        """
        from scancell.reconstruction.cloud_files import read_cloud  # noqa: PLC0415  (imports this module)

        return read_cloud(Path(path))

    @classmethod
    @checked_arguments
    def concatenate(cls, clouds: Sequence[Cloud]) -> Self:
        """Concatenation of several clouds."""
        if not clouds:
            raise DescriptionError(key="clouds", expected="at least one")
        names = [column.name for column in fields(cls)]
        return cls(**{name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names})


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
