"""Structured array with one record per point, the common basis of the file formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.errors import MeshError
from scancell.reconstruction.cloud import Cloud

MM = 1e3
_LARGEST_MM, _LATEST = 1e9, 1e10  # of a position, mm, and a time, s
UNITS = "x y z sigma in mm, time in s; normals towards the sensor"

# Positions in double precision: far from the origin single precision would lose micrometres.
RECORD = np.dtype(
    [
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
        ("nx", "<f4"),
        ("ny", "<f4"),
        ("nz", "<f4"),
        ("sigma", "<f4"),
        ("intensity", "<f4"),
        ("quality", "<f4"),
        ("camera", "u1"),
        ("column", "<i4"),
        ("segment", "<i4"),
        ("profile", "<i4"),
        ("time", "<f8"),
        ("saturated", "u1"),
    ]
)
# Of files by earlier versions.
WITHOUT_SATURATED = np.dtype([(name, RECORD[name].str) for name in (RECORD.names or ())[:-1]])
_SAME = ("intensity", "quality", "camera", "column", "segment", "profile", "time", "saturated")


def record_of(cloud: Cloud) -> NDArray[Any]:
    """Records (n,) of type `RECORD` of a cloud, mm and s."""
    record = np.zeros(len(cloud), RECORD)
    for axis, name in enumerate("xyz"):
        record[name] = cloud.points_in_part[:, axis] * MM
        record[f"n{name}"] = cloud.normals[:, axis]
    record["sigma"] = cloud.sigma * MM
    for name in _SAME:
        record[name] = getattr(cloud, name)
    return record


def require_bounded(cloud: Cloud, path: Path) -> Cloud:
    """The cloud of a file, whose positions and times are finite and bounded; else raises `MeshError`."""
    for name, values, largest in (("x, y, z", cloud.points_in_part * MM, _LARGEST_MM), ("time", cloud.time, _LATEST)):
        wrong = np.flatnonzero(~(np.abs(values.reshape(len(values), -1)) <= largest).all(1))
        if len(wrong):
            row = int(wrong[0])
            expected = f"finite numbers from {-largest:g} to {largest:g}"
            raise MeshError(file=path, key=f"{name} of point {row + 1}", value=values[row].tolist(), expected=expected)
    return cloud


def cloud_of_record(record: NDArray[Any]) -> Cloud:
    """Cloud of records (n,), see `record_of`; of type `WITHOUT_SATURATED`, no point is saturated."""
    names = record.dtype.names or ()
    return Cloud(
        points_in_part=np.stack([record[name] for name in "xyz"], -1) / MM,
        normals=np.stack([record[f"n{name}"] for name in "xyz"], -1).astype(float),
        sigma=record["sigma"] / MM,
        intensity=record["intensity"].astype(float),
        quality=record["quality"].astype(float),
        camera=record["camera"].astype(np.int32),
        column=record["column"].astype(np.int32),
        profile=record["profile"].astype(np.int64),
        segment=record["segment"].astype(np.int32),
        time=record["time"].astype(float),
        saturated=record["saturated"].astype(bool) if "saturated" in names else np.zeros(len(record), bool),
    )
