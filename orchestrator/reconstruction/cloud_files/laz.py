"""Clouds as LAZ (LAS 1.4, compressed): millimetres, what LAS has no field for in extra dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import laspy
import numpy as np

from orchestrator.reconstruction.cloud import Cloud
from orchestrator.reconstruction.cloud_files.record import RECORD, UNITS, record_of

_STEP_MM = 1e-5  # 32-bit multiples of it reach 21 m either way
_TIMES = 6  # the simplest point format of LAS 1.4; it has a time
_INTENSITIES = 65535
# Extra dimensions, with a text of at most 31 letters each.
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
}


def write_laz(path: Path, cloud: Cloud, comments: Sequence[str]) -> None:
    """Positions in steps of 10 nm; ``intensity`` is rounded as LAS demands, ``amplitude`` is not."""
    record = record_of(cloud)
    header = laspy.LasHeader(point_format=_TIMES, version="1.4")
    header.creation_date = None  # equal clouds make equal bytes
    header.generating_software = "scancell"
    header.scales = np.full(3, _STEP_MM)
    header.offsets = np.rint(cloud.points_in_part.mean(0) * 1e3) if len(cloud) else np.zeros(3)
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, RECORD[_source(name)].str, text) for name, text in _EXTRA.items()]
    )
    text = "\n".join([UNITS, *comments]).encode()
    header.vlrs.append(laspy.VLR(user_id="scancell", record_id=1, description="units and origin", record_data=text))
    las = laspy.LasData(header)
    las.x, las.y, las.z = record["x"], record["y"], record["z"]
    las.gps_time = record["time"]
    las.intensity = np.clip(np.rint(record["intensity"]), 0, _INTENSITIES).astype(np.uint16)
    las.return_number[:] = 1
    las.number_of_returns[:] = 1
    for name in _EXTRA:
        las[name] = record[_source(name)]
    with path.open("wb") as stream:
        las.write(stream, do_compress=True)


def _source(name: str) -> str:
    return "intensity" if name == "amplitude" else name
