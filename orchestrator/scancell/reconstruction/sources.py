"""Clouds and points from user input: a file of any format, a run folder, or the data."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scancell.errors import DescriptionError
from scancell.extras import require
from scancell.files import require_file
from scancell.geometry.mesh_files import read_ply_points
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import read_cloud
from scancell.reconstruction.cloud_files.record import MM

Array = NDArray[np.float64]

_PCD_HEADER = 4096  # bytes: more than `write_pcd` needs for names and comments


class HasCloud(Protocol):
    """Something with a cloud, such as a `ScanResult`."""

    @property
    def cloud(self) -> Cloud: ...


def points_of(cloud: str | Path | HasCloud | Cloud | Array) -> Array:
    """Points (n, 3), m, of a scan, a cloud, a cloud file in mm, or a run folder.

    Raises `DescriptionError` if the file is missing, of another kind, broken or without points.
    """
    if isinstance(cloud, np.ndarray):
        return np.asarray(cloud, float)
    if isinstance(cloud, str | Path):
        return read_points(_file(Path(cloud)))
    return cloud_of(cloud).points_in_part


def cloud_of(run: str | Path | HasCloud | Cloud) -> Cloud:
    """Cloud of a scan, of a run folder, or of a PLY file that scancell has written.

    Raises `MeshError` if the file is missing or not a cloud of scancell; `DescriptionError` if the folder holds no
    ``cloud.ply``.
    """
    if isinstance(run, str | Path):
        return read_cloud(_file(Path(run)))
    return run if isinstance(run, Cloud) else run.cloud


def _file(path: Path) -> Path:
    if not path.is_dir():
        return path
    if not (path / "cloud.ply").is_file():
        raise DescriptionError("holds no cloud.ply", file=path, expected="a run folder with one, or a cloud file")
    return path / "cloud.ply"


def read_points(path: Path) -> Array:
    """Points (n, 3), m, of a file that is named as one of `scancell.reconstruction.cloud_files.FORMATS`.

    Other programs' PLY files with x, y, z in millimetres are read, too.

    Raises `DescriptionError` if the file is missing, of another kind, broken, without points, or a point is not finite;
    `MissingExtraError` if the package that reads the format is not installed.
    """
    kind = path.suffix.lower()
    if kind not in _READERS:
        raise DescriptionError(file=path, expected=f"a point cloud: {', '.join(_READERS)}")
    require_file(path)
    try:
        points = np.asarray(_READERS[kind](path), float)
    except (OSError, ValueError, KeyError, IndexError, RuntimeError, EOFError, MemoryError) as error:
        raise DescriptionError(f"not a point cloud that can be read: {error}", file=path) from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise DescriptionError("holds no points", file=path)
    wrong = ~np.isfinite(points).all(1)
    if wrong.any():
        raise DescriptionError(
            f"point {int(np.argmax(wrong)) + 1} is not finite: {points[np.argmax(wrong)]}", file=path
        )
    return points


def _ply(path: Path) -> Array:
    return np.asarray(read_ply_points(path)[0], float) / MM


def _npz(path: Path) -> Array:
    with np.load(path) as arrays:
        if "points_in_part_mm" not in arrays:
            raise ValueError(f"expected an array points_in_part_mm; found {', '.join(arrays)}")
        return np.asarray(arrays["points_in_part_mm"]) / MM


def _xyz(path: Path) -> Array:
    return np.loadtxt(path, usecols=(0, 1, 2), ndmin=2) / MM


def _pcd(path: Path) -> Array:
    data = path.read_bytes()
    head, mark, _ = data[:_PCD_HEADER].partition(b"DATA binary\n")
    words = dict(line.split(" ", 1) for line in head.decode().splitlines() if " " in line and line[0] != "#")
    if not mark or not words["FIELDS"].startswith("x y z "):
        raise ValueError("expected binary PCD with x, y, z first")
    sizes = [int(size) for size in words["SIZE"].split()]
    record = np.dtype({"names": ["xyz"], "formats": ["(3,)<f4"], "offsets": [0], "itemsize": sum(sizes)})
    return np.asarray(np.frombuffer(data, record, int(words["POINTS"]), len(head) + len(mark))["xyz"], float) / MM


def _laz(path: Path) -> Array:
    return np.asarray(require("laspy", "formats").read(path).xyz) / MM


def _e57(path: Path) -> Array:
    scans = require("pye57", "formats").E57(str(path))
    read = [scans.read_scan(i, ignore_missing_fields=True) for i in range(scans.scan_count)]
    return np.concatenate([np.stack([one[f"cartesian{axis}"] for axis in "XYZ"], -1) for one in read])


_READERS = {".ply": _ply, ".npz": _npz, ".xyz": _xyz, ".pcd": _pcd, ".laz": _laz, ".e57": _e57}
