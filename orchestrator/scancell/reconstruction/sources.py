"""Clouds and points from user input: a file of any format, a run folder, or the data."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from scancell.arrays import Array
from scancell.errors import DescriptionError
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files import read_cloud
from scancell.reconstruction.cloud_files.read import CloudFile, read_cloud_file


class HasCloud(Protocol):
    """Something with a cloud, such as a `ScanResult`."""

    @property
    def cloud(self) -> Cloud: ...


def points_of(cloud: str | Path | HasCloud | Cloud | Array, unit: str | None = None) -> CloudFile:
    """Points of a scan, a cloud, a cloud file, or a run folder, with what became of the records of a file.

    Raises `DescriptionError` if the file is missing, of another kind, broken or without points; or a `unit` is given
    with points that are no file.
    """
    if isinstance(cloud, str | Path):
        return read_cloud_file(_file(Path(cloud)), unit)
    if unit is not None:
        raise DescriptionError("applies to a file; points are in m", key="cloud_unit", value=unit)
    points = np.asarray(cloud, float) if isinstance(cloud, np.ndarray) else cloud_of(cloud).points_in_part
    return CloudFile(points, "points", len(points))


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
