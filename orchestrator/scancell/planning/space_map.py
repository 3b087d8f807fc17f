"""Map of the space around the table that is measured free or occupied; all other space counts as occupied.

The box of voxels lies in the frame of the table at angle 0, which is also the angle of the survey. The evidence:

- A measured point: its voxel is occupied, unless a known body explains the point. The laser's ray to it is free.
- A ray without a point: nothing lies in the measuring range along it, on three conditions. The ray enters the range
  through free space, so that nothing in front of the range blocks it; all space on it before is free; and the line to a
  camera is free, so that a surface would have been seen. What returns no light (black, mirrors) is not seen at all.
- Known bodies explain what they hide: voxels in them, or that they touch. These block lines of sight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array, Flags, Indices
from scancell.config.description import si_value
from scancell.config.material import Material
from scancell.config.scan import OccupiedDescription
from scancell.errors import DescriptionError
from scancell.files import atomic_write, require_file
from scancell.geometry.mesh import Mesh
from scancell.geometry.pose import transform_points
from scancell.geometry.voxels import VoxelGrid
from scancell.nominal.cell import OCCUPIED, NominalCell
from scancell.nominal.parts import Body
from scancell.planning.model import SensorRange
from scancell.reconstruction.cloud_files.read import read_cloud_file
from scancell.sensor import closest_points

_KIND = "scancell voxels 1"
_FRAMES = ("world", "table", "fixed")


@dataclass(frozen=True)
class Profiles:
    """Profiles of exposures with the table at angle 0, m.

    Attributes
    ----------
    table_from_sensor
        (n, 4, 4)
    points_in_sensor
        (m, 3) in the laser sheet, x = 0.
    exposure
        (m,) number of the exposure of each point.
    """

    table_from_sensor: Array
    points_in_sensor: Array
    exposure: Indices

    @property
    def points_in_table(self) -> Array:
        """(m, 3), m."""
        poses = self.table_from_sensor[self.exposure]
        return np.asarray((poses[:, :3, :3] @ self.points_in_sensor[..., None])[..., 0] + poses[:, :3, 3])


class SpaceMap:
    """Free and occupied voxels of a cylinder on the table's axis.

    Parameters
    ----------
    radius, height
        Dimensions of the cylinder that stands on the plane of the table's top, m.
    spacing
        Edge of the voxels, m.
    known
        Mesh of the known bodies, frame of the table at angle 0, m.
    tolerance
        Distance (m) from a known body up to which it explains a point.

    Attributes
    ----------
    free, occupied
        Voxels (nx, ny, nz) on a free ray, and with a point that no known body explains.
    region
        Voxels in the cylinder that are not known bodies.
    """

    def __init__(self, radius: float, height: float, spacing: float, known: Mesh, tolerance: float) -> None:
        half, layers = int(np.ceil(radius / spacing)), int(np.ceil(height / spacing))
        shape = (2 * half, 2 * half, layers)
        self.grid = VoxelGrid(np.array([-half * spacing, -half * spacing, 0.0]), spacing, np.zeros(shape, bool))
        self.free, self.occupied = np.zeros(shape, bool), np.zeros(shape, bool)
        self._known, self._tolerance = known, tolerance
        centres = self.grid.centres
        self._inside = np.linalg.norm(centres[..., :2], axis=-1) <= radius
        self.region = self._inside & ~_near(centres, known, np.sqrt(3) / 2 * spacing)

    def take_as_free(self, mesh: Mesh, distance: float) -> None:
        """Count the space within `distance` (m) of a mesh in the frame of the table as free."""
        self.free |= _near(self.grid.centres, mesh, distance)

    @property
    def unseen(self) -> Flags:
        """Voxels of the region without evidence."""
        return np.asarray(self.region & ~self.free & ~self.occupied)

    def blocked(self, inflation: float) -> VoxelGrid:
        """Voxels that are unseen, occupied or below an occupied one, and those within `inflation` (m) of one of them.

        From above, the sides of a thing are lit at grazing incidence, where they return no light: rays along them look
        empty. Below a measured point nothing counts as free.
        A ray shows a part of a voxel to be free. What reaches into it from a neighbour is kept clear of by an inflation
        of more than 0, which blocks the neighbours of unseen and occupied voxels.
        """
        below = np.maximum.accumulate(self.occupied[:, :, ::-1], axis=2)[:, :, ::-1] & self.region
        found = replace(self.grid, occupied=below | self.unseen).inflated(inflation)
        return replace(found, occupied=found.occupied & self.region)

    def add(self, profiles: Profiles, sensor: SensorRange) -> None:
        """Evidence of the profiles of several exposures."""
        points = profiles.points_in_table
        points = points[self.grid.contains(points)]
        if len(points):
            unexplained = points[~_near(points, self._known, self._tolerance)]
            self.occupied[tuple(self.grid.index(unexplained).T)] = True
        step = self.grid.spacing / 2
        slopes = _slopes(sensor, step)
        first = _first_points(profiles, slopes)
        exposure, ray = np.nonzero(np.isfinite(first))
        depth = first[exposure, ray]
        lit = self._on_ray(profiles, exposure, slopes[ray], depth)
        source = profiles.table_from_sensor[exposure, :3, 3]
        self._set_free(self._between(source, lit))
        self._add_empty(profiles, sensor, slopes, ~np.isfinite(first))

    def _add_empty(self, profiles: Profiles, sensor: SensorRange, slopes: Array, empty: Flags) -> None:
        """Evidence of rays (exposures, rays) without a point: in order of what is known to be free before."""
        depths = np.arange(sensor.near, sensor.far, self.grid.spacing / 2)
        seen = empty[:, :, None] & sensor.contains(slopes[:, None] * depths, depths)
        exposure, ray, at = np.nonzero(seen)
        targets = self._on_ray(profiles, exposure, slopes[ray], depths[at])
        voxel = self._numbers(targets)
        chosen = np.flatnonzero(~self._passable()[voxel] & (voxel < self.region.size))
        # One target for each voxel and exposure.
        _, one = np.unique(np.stack([exposure[chosen], voxel[chosen]]), axis=1, return_index=True)
        chosen = chosen[one]
        exposure, voxel, targets = exposure[chosen], voxel[chosen], targets[chosen]
        poses = profiles.table_from_sensor[exposure]
        cameras = np.einsum("nij,kj->kni", poses[:, :3, :3], sensor.cameras) + poses[:, :3, 3]
        lines = [self._between(start, targets, voxel) for start in (poses[:, :3, 3], *cameras)]
        while len(voxel):
            passable = self._passable()
            lit, *views = [passable[line].all(1) for line in lines]
            proved = lit & np.any(views, axis=0)
            if not proved.any():
                return
            self._set_free(voxel[proved])
            voxel, lines = voxel[~proved], [line[~proved] for line in lines]

    @staticmethod
    def _on_ray(profiles: Profiles, exposure: Indices, slope: Array, depth: Array) -> Array:
        """Points (n, 3) in the frame of the table on laser rays, whose slope is y / z in the sensor frame."""
        poses = profiles.table_from_sensor[exposure]
        in_sensor = np.stack([np.zeros(len(depth)), slope * depth, depth], -1)
        return np.asarray((poses[:, :3, :3] @ in_sensor[..., None])[..., 0] + poses[:, :3, 3])

    def _numbers(self, points: Array) -> Indices:
        """Numbers (...,) of the voxels of points (..., 3); that of all points outside the box follows the last."""
        index = np.clip(self.grid.index(points), 0, np.array(self.region.shape) - 1)
        number = np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), self.region.shape)
        return np.asarray(np.where(self.grid.contains(points), number, self.region.size))

    def _passable(self) -> Flags:
        """Whether light is known to pass voxels, by number: free ones, and space outside, which is as described."""
        return np.append((self.free & ~self.occupied | ~self._inside).ravel(), True)

    def _set_free(self, numbers: Indices) -> None:
        flags = np.append(self.free.ravel(), True)
        flags[numbers] = True
        self.free = flags[:-1].reshape(self.free.shape) & self.region

    def _between(self, start: Array, end: Array, own: Indices | None = None) -> Indices:
        """Numbers (n, k) of voxels between points (n, 3); those in `own` (n,) are replaced by one outside."""
        longest = np.linalg.norm(end - start, axis=1).max(initial=0.0)
        fraction = np.linspace(0.0, 1.0, int(np.ceil(longest / (self.grid.spacing / 2))) + 1)[:-1]
        number = self._numbers(start[:, None] + fraction[:, None] * (end - start)[:, None])
        return number if own is None else np.where(number == own[:, None], self.region.size, number)


def _near(points: Array, mesh: Mesh, distance: float) -> Flags:
    """Whether points (..., 3) lie within `distance` of a mesh or, if it is closed, inside."""
    flat = np.ascontiguousarray(points.reshape(-1, 3))
    signed = np.asarray(closest_points(mesh.vertices, mesh.faces.astype(np.uint32), flat)[2])
    near = (np.abs(signed) <= distance) | ((signed < 0) & mesh.is_closed)
    return np.asarray(near.reshape(points.shape[:-1]))


def _slopes(sensor: SensorRange, step: float) -> Array:
    """Slopes y / z of laser rays that are no farther than `step` (m) apart at the far end of the range."""
    largest = max(sensor.half_near / sensor.near, sensor.half_far / sensor.far)
    return np.linspace(-largest, largest, 2 * int(np.ceil(largest * sensor.far / step)) + 1)


def _first_points(profiles: Profiles, slopes: Array) -> Array:
    """Depth z (exposures, rays) of the nearest point beside each ray, m; infinite without a point."""
    y, z = profiles.points_in_sensor[:, 1:].T
    first = np.full((len(profiles.table_from_sensor), len(slopes)), np.inf)
    ray = np.round((y / z - slopes[0]) / (slopes[1] - slopes[0])).astype(np.int64)
    on_ray = (ray >= 0) & (ray < len(slopes))
    np.minimum.at(first, (profiles.exposure[on_ray], ray[on_ray]), z[on_ray])
    return first


def with_occupied_space(nominal: NominalCell, files: tuple[OccupiedDescription, ...]) -> NominalCell:
    """The cell with the occupied space of the files as bodies, which exist for planning only.

    Raises `DescriptionError` if a file is missing, of another kind, empty, or has values that are not finite.
    """
    made: list[Body] = []
    for item in files:
        made += occupied_bodies(_grids(item, nominal), nominal, first=len(made) + 1)
    return replace(nominal, bodies=(*nominal.bodies, *made)) if made else nominal


def occupied_bodies(grids: Mapping[str, VoxelGrid], nominal: NominalCell, first: int = 1) -> list[Body]:
    """Bodies of the grids by their frame, numbered from `first`: ``world``, ``table`` (turns), ``fixed``.

    ``fixed`` is the frame of the table at angle 0, which does not turn.
    """
    made: list[Body] = []
    for frame, grid in grids.items():
        if not grid.occupied.any():
            continue
        mesh = grid.surface()
        if frame == "fixed":
            mesh = mesh.transformed(nominal.world_from_table)
        made.append(
            Body(f"{OCCUPIED}{first + len(made)}]", "table" if frame == "table" else "world", mesh, Material(0.0))
        )
    return made


def _grids(item: OccupiedDescription, nominal: NominalCell) -> dict[str, VoxelGrid]:
    """Grids by frame: ``world``, ``table`` or ``fixed``."""
    path, inflation = Path(item.file), si_value(item, "inflate_mm")
    if path.suffix.lower() == ".npz" and _holds_voxels(path):
        return {frame: grid.inflated(inflation) for frame, grid in read_voxels(path).items()}
    points = read_cloud_file(path, item.unit).points
    frame, frame_from_points = {
        "world": ("world", np.eye(4)),
        "base": ("world", nominal.arm.world_from_base),
        "table": ("table", np.eye(4)),
        "part": ("table", nominal.table_from_part),
    }[item.frame]
    try:
        return {
            frame: VoxelGrid.around(transform_points(frame_from_points, points), si_value(item, "voxel_mm"), inflation)
        }
    except ValueError as error:
        raise DescriptionError(str(error), file=path) from None


def write_voxels(path: Path, grids: Mapping[str, VoxelGrid], **more: NDArray[np.generic]) -> None:
    """Write grids by frame, see `occupied_bodies`, and further arrays as NPZ, atomically.

    Raises `OutputError` if the file cannot be written.
    """
    arrays: dict[str, NDArray[np.generic]] = {"kind": np.array(_KIND), **more}
    for frame, grid in grids.items():
        arrays[f"{frame}_origin_mm"] = grid.origin * 1e3
        arrays[f"{frame}_spacing_mm"] = np.array(grid.spacing * 1e3)
        arrays[f"{frame}_occupied"] = grid.occupied
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def _holds_voxels(path: Path) -> bool:
    require_file(path)
    try:
        with np.load(path) as arrays:
            return "kind" in arrays
    except (OSError, ValueError, EOFError, MemoryError, BadZipFile) as error:
        raise DescriptionError(f"not a file of voxels or points (NPZ): {error}", file=path) from None


def read_voxels(path: Path) -> dict[str, VoxelGrid]:
    """Grids by frame from a file of `write_voxels`.

    Raises `DescriptionError` if it is of another kind, or its grids are not complete, finite and of three dimensions.
    """
    with np.load(path) as arrays:
        if str(arrays["kind"]) != _KIND:
            raise DescriptionError(file=path, key="kind", value=str(arrays["kind"]), expected=f"'{_KIND}'")
        found = [frame for frame in _FRAMES if f"{frame}_occupied" in arrays]
        if not found:
            raise DescriptionError(file=path, expected="an array world_occupied, table_occupied or fixed_occupied")
        return {frame: _grid(path, frame, arrays) for frame in found}


def _grid(path: Path, frame: str, arrays: Mapping[str, NDArray[np.generic]]) -> VoxelGrid:
    names = [f"{frame}_{key}" for key in ("origin_mm", "spacing_mm", "occupied")]
    missing = [name for name in names if name not in arrays]
    if missing:
        raise DescriptionError(f"lacks the array {missing[0]}", file=path)
    origin, spacing, occupied = (arrays[name] for name in names)
    if origin.shape != (3,) or not np.isfinite(np.asarray(origin, float)).all():
        raise DescriptionError(file=path, key=names[0], value=origin.tolist(), expected="3 finite numbers")
    if spacing.shape != () or not 0.0 < float(spacing) < np.inf:
        raise DescriptionError(file=path, key=names[1], value=spacing.tolist(), expected="a positive number")
    if occupied.ndim != 3 or occupied.dtype != np.bool_:
        shape = f"{occupied.dtype} of shape {occupied.shape}"
        raise DescriptionError(shape, file=path, key=names[2], expected="bool with three dimensions")
    return VoxelGrid(np.asarray(origin, float) / 1e3, float(spacing) / 1e3, np.asarray(occupied, bool))
