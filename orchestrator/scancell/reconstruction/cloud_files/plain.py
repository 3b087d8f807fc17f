"""Clouds as NumPy archives, PCD files (Point Cloud Library) and text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from scancell.errors import DescriptionError, MeshError
from scancell.files import require_file
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files.laz import MM, RECORD, UNITS, record_of, require_bounded

_PCD_TYPES = {"f": "F", "i": "I", "u": "U"}
_PCD_NAMES = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}
_DECIMALS = {"x": "%.6f", "y": "%.6f", "z": "%.6f", "time": "%.9f"}


_SAME = ("normals", "intensity", "quality", "camera", "column", "segment", "profile")


def write_npz(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write a compressed archive: ``points_in_part_mm``, ``normals`` (n, 3), ``sigma_mm`` (n,), …, ``comments``."""
    np.savez_compressed(
        path,
        points_in_part_mm=cloud.points_in_part * MM,
        sigma_mm=cloud.sigma * MM,
        time_s=cloud.time,
        saturated=cloud.saturated,
        comments=np.array([UNITS, *comments]),
        **{name: getattr(cloud, name) for name in _SAME},
    )


def read_npz(path: Path) -> Cloud:
    """The cloud of an archive of `write_npz`.

    Raises `MeshError` if the file is missing or no such archive.
    """
    require_file(path, MeshError)
    try:
        with np.load(path) as archive:
            cloud = Cloud(
                points_in_part=archive["points_in_part_mm"] / MM,
                sigma=archive["sigma_mm"] / MM,
                time=archive["time_s"],
                saturated=archive["saturated"] if "saturated" in archive else np.zeros(len(archive["time_s"]), bool),
                **{name: archive[name] for name in _SAME},
            )
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        EOFError,
        MemoryError,
        BadZipFile,
        DescriptionError,
    ) as error:
        raise MeshError(f"{path}: not a cloud of scancell: {error}") from None
    return require_bounded(cloud, path)


def write_pcd(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write binary PCD 0.7; positions in single precision, because other programs accept no double x, y, z."""
    record = record_of(cloud)
    single = np.dtype([(name, "<f4" if name in "xyz" else RECORD[name].str) for name in RECORD.names or ()])
    kinds = [single[name] for name in single.names or ()]
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {' '.join(note.split())}" for note in (UNITS, *comments)),
        "VERSION 0.7",
        f"FIELDS {' '.join(_PCD_NAMES.get(name, name) for name in single.names or ())}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(_PCD_TYPES[kind.kind] for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {len(record)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(record)}",
        "DATA binary",
    ]
    with path.open("wb") as stream:
        stream.write(("\n".join(lines) + "\n").encode())
        stream.write(record.astype(single).tobytes())  # `tofile` hides the cause of write errors


def write_xyz(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write text, one line per point; header lines with the names of the columns, the units and the comments."""
    names = RECORD.names or ()
    head = "\n".join([" ".join(names), UNITS, *(" ".join(note.split()) for note in comments)])
    floats = {name: _DECIMALS.get(name, "%.7g") for name in names}
    layout = [floats[name] if RECORD[name].kind == "f" else "%d" for name in names]
    np.savetxt(path, record_of(cloud), layout, header=head, encoding="utf-8")
