"""E57 files (ASTM E2807): metres, organised by exposure and image column."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.errors import require
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files.formats import record_of

libe57 = require("pye57", "formats").libe57

_SENSORS = 256  # more than any cell has
_NORMALS = ("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
_OURS = ("scancell", "urn:scancell:e57:1")  # sigma in m, quality 0 to 1, camera, segment, profile index, sensor


def write_e57(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write one E57 scan; ``rowIndex`` numbers the exposures that have points, ``columnIndex`` is the image column.

    All cameras share this grid, so that a cell may hold one point of each.

    Raises `OSError` if the file cannot be written.
    """
    fields = _fields(cloud)
    digest = hashlib.sha256(record_of(cloud).tobytes() + "\n".join(comments).encode()).digest()
    columns: dict[str, NDArray[np.float64]] = {}  # keeps the memory of the library's buffers alive
    image = libe57.ImageFile(str(path), "w")
    try:
        scans = _begin(image, digest)
        scan = _structure(image, {"guid": _guid(digest, 1), "name": "cloud", "description": "; ".join(comments)})
        for name, limits in _bounds(fields).items():
            scan.set(name, _structure(image, limits))
        prototype, buffers = libe57.StructureNode(image), libe57.VectorSourceDestBuffer()
        for name, values in fields.items():
            prototype.set(name, _prototype(image, values))
            column = columns[name] = values.astype(np.float64)  # the library does not accept 64-bit integers
            buffers.append(libe57.SourceDestBuffer(image, name, column, len(column), True, True))
        points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
        scan.set("points", points)
        scans.append(scan)
        writer = points.writer(buffers)
        writer.write(len(cloud))
        writer.close()
    except libe57.E57Exception as error:
        raise OSError(str(error)) from error
    finally:
        image.close()


def _begin(image: Any, digest: bytes) -> Any:
    """Write the file header; returns the list of scans."""
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    for prefix, uri in (_NORMALS, _OURS):
        image.extensionsAdd(prefix, uri)
    root = image.root()
    head = {
        "formatName": "ASTM E57 3D Imaging Data File",
        "guid": _guid(digest, 0),  # from the content, so that files of equal clouds are identical
        "versionMajor": libe57.E57_FORMAT_MAJOR,
        "versionMinor": libe57.E57_FORMAT_MINOR,
        "e57LibraryVersion": libe57.E57_LIBRARY_ID,
        "coordinateMetadata": "",
    }
    _fill(image, root, head)
    root.set("creationDateTime", _structure(image, {"dateTimeValue": 0.0, "isAtomicClockReferenced": 0}))
    scans = libe57.VectorNode(image, True)
    root.set("data3D", scans)
    root.set("images2D", libe57.VectorNode(image, True))
    return scans


def _fields(cloud: Cloud) -> dict[str, NDArray[Any]]:
    # A profile is that of one sensor: those of several at one exposure are rows of their own.
    several = (cloud.sensor != 1).any()
    rows = np.unique(np.int64(cloud.profile) * _SENSORS + cloud.sensor, return_inverse=True)[1]
    columns: dict[str, tuple[NDArray[Any], str]] = {
        **{f"cartesian{axis}": (cloud.points_in_part[:, i], "f8") for i, axis in enumerate("XYZ")},
        "rowIndex": (rows, "i8"),
        "columnIndex": (cloud.column, "i8"),
        "intensity": (cloud.intensity, "f4"),
        "timeStamp": (cloud.time, "f8"),
        **{f"nor:normal{axis}": (cloud.normals[:, i], "f4") for i, axis in enumerate("XYZ")},
        "scancell:sigma": (cloud.sigma, "f4"),
        "scancell:quality": (cloud.quality, "f4"),
        "scancell:camera": (cloud.camera, "i8"),
        "scancell:segment": (cloud.segment, "i8"),
        "scancell:profile": (cloud.profile, "i8"),
        "scancell:saturated": (cloud.saturated, "i8"),
        **({"scancell:sensor": (cloud.sensor, "i8")} if several else {}),
    }
    return {name: np.array(values, kind) for name, (values, kind) in columns.items()}


def _prototype(image: Any, values: NDArray[Any]) -> Any:
    """Data type and bounds of a field; its value is ignored."""
    if values.dtype.kind == "i":
        low, high = (int(values.min()), int(values.max())) if len(values) else (0, 0)
        return libe57.IntegerNode(image, low, low, high)
    return libe57.FloatNode(image, 0.0, libe57.E57_DOUBLE if values.itemsize == 8 else libe57.E57_SINGLE)


def _bounds(fields: dict[str, NDArray[Any]]) -> dict[str, dict[str, float | int]]:
    def limits(key: str, field: str) -> dict[str, float | int]:
        values = fields[field] if len(fields[field]) else np.zeros(1, fields[field].dtype)
        return {f"{key}Minimum": values.min().item(), f"{key}Maximum": values.max().item()}

    return {
        "indexBounds": {**limits("row", "rowIndex"), **limits("column", "columnIndex")},
        "intensityLimits": limits("intensity", "intensity"),
        "cartesianBounds": {k: v for axis in "xyz" for k, v in limits(axis, f"cartesian{axis.upper()}").items()},
    }


def _structure(image: Any, content: dict[str, Any]) -> Any:
    node = libe57.StructureNode(image)
    _fill(image, node, content)
    return node


def _fill(image: Any, node: Any, content: dict[str, Any]) -> None:
    kinds = {int: libe57.IntegerNode, float: libe57.FloatNode, str: libe57.StringNode}
    for name, value in content.items():
        node.set(name, kinds[type(value)](image, value))


def _guid(digest: bytes, number: int) -> str:
    return f"{{{uuid.UUID(bytes=hashlib.sha256(digest + bytes([number])).digest()[:16], version=4)}}}"
