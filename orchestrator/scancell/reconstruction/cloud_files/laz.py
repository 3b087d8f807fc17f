"""LAZ files (compressed LAS 1.4): millimetres; extra dimensions for fields that LAS lacks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scancell.errors import require
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.cloud_files.formats import UNITS, record_of

laspy = require("laspy", "formats")
require("lazrs", "formats")

_STEP_MM = 1e-5  # resolution; the range of 32-bit integers is then ±21 m
_POINT_FORMAT = 6  # the simplest of LAS 1.4 with a time
_MAX_INTENSITY = 65535
# Extra dimensions and their descriptions, at most 31 characters.
_EXTRA = {
    "nx": "normal, unit vector",
    "ny": "normal, unit vector",
    "nz": "normal, unit vector",
    "sigma": "standard deviation, mm",
    "amplitude": "intensity, not rounded",
    "quality": "0 to 1",
    "camera": "number, from 0",
    "column": "pixel column",
    "segment": "of the program",
    "profile": "index of the exposure",
    "saturated": "1: saturated stripe",
    "sensor": "number, from 1",
}


def write_laz(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Write a LAZ file; positions in steps of 10 nm, ``intensity`` as an integer, ``amplitude`` not rounded."""
    record = record_of(cloud)
    header = laspy.LasHeader(point_format=_POINT_FORMAT, version="1.4")
    header.creation_date = None  # files of equal clouds are identical
    header.generating_software = "scancell"
    header.scales = np.full(3, _STEP_MM)
    header.offsets = np.rint(cloud.points_in_part.mean(0) * 1e3) if len(cloud) else np.zeros(3)
    kind = record.dtype
    extra = {name: text for name, text in _EXTRA.items() if _source(name) in (kind.names or ())}
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind[_source(name)].str, text) for name, text in extra.items()])
    text = "\n".join([UNITS, *comments]).encode()
    header.vlrs.append(laspy.VLR(user_id="scancell", record_id=1, description="units and origin", record_data=text))
    las = laspy.LasData(header)
    las.x, las.y, las.z = record["x"], record["y"], record["z"]
    las.gps_time = record["time"]
    las.intensity = np.clip(np.rint(record["intensity"]), 0, _MAX_INTENSITY).astype(np.uint16)
    las.return_number[:] = 1
    las.number_of_returns[:] = 1
    for name in extra:
        las[name] = record[_source(name)]
    with path.open("wb") as stream:
        las.write(stream, do_compress=True)


def _source(name: str) -> str:
    return "intensity" if name == "amplitude" else name
