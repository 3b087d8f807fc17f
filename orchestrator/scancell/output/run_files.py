"""Files that scans and reconstructions have in common: profiles, covariances and JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell.files import arrow_table
from scancell.reconstruction.cloud_files import FORMATS
from scancell.reconstruction.reconstruct import ProfilePoints

# Files that scans and reconstructions write into the folder of their run, each some of them.
OPTIONAL_FILES = (
    *(f"cloud.{suffix}" for suffix in FORMATS),
    *("profiles.parquet", "recording.parquet", "points.parquet", "covariance.parquet"),
    *("plan.json", "deviation.json", "deviation.png", "deviation.html", "reconstruction.json", "images", "laser_off"),
)
_ROWS = 1 << 18  # of a table written at a time, which bounds the memory


def write_profiles(
    profiles: ProfilePoints,
    index: NDArray[np.int64],
    cameras: Sequence[str],
    path: Path,
    covariance: NDArray[np.float64] | None = None,
) -> None:
    """Write all points in the sensor frame as Parquet: lengths in mm; `profile` is the trigger index of (n,) `index`.

    With `covariance` (m, 3, 3), m², also its columns, see `covariance_columns`.
    """
    import pyarrow.parquet  # noqa: PLC0415  (takes 0.1 s to import)

    index = index.astype(np.int32)
    few_values = ["profile", "camera", "x_mm", "flags", "time_offset_s"]
    writer = None
    try:
        for start in range(0, max(len(profiles.frame), 1), _ROWS):
            rows = slice(start, start + _ROWS)
            points = 1e3 * np.asarray(profiles.points_in_sensor[rows], float)
            columns = {
                "profile": index[profiles.frame[rows]],
                "camera": np.asarray(profiles.camera[rows], np.uint8),
                "column": np.asarray(profiles.column[rows], np.int32),
                **{f"{axis}_mm": np.ascontiguousarray(points[:, i]) for i, axis in enumerate("xyz")},
                "sigma_mm": 1e3 * np.asarray(profiles.sigma[rows], np.float32),
                "intensity_dn": np.asarray(profiles.intensity[rows], np.float32),
                "flags": np.asarray(profiles.flags[rows], np.uint32),
                "time_offset_s": np.asarray(profiles.time_offset[rows], np.float32),
                **({} if covariance is None else covariance_columns(covariance[rows])),
            }
            table = arrow_table(columns)
            table = table.replace_schema_metadata({"frame": "sensor", "cameras": ",".join(cameras)})
            writer = writer or pyarrow.parquet.ParquetWriter(
                path, table.schema, compression="none", use_dictionary=few_values, write_statistics=False
            )
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def covariance_columns(covariance: NDArray[np.float64], name: str = "covariance") -> dict[str, NDArray[np.float64]]:
    """Columns ``covariance_xx_mm2`` … of covariances (m, 3, 3), m²; `name` is their first word."""
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    return {f"{name}_{'xyz'[i]}{'xyz'[j]}_mm2": np.ascontiguousarray(1e6 * covariance[:, i, j]) for i, j in pairs}


def write_json(path: Path, content: Any) -> None:
    """Write plain data as JSON, indented up to 100 000 characters."""
    text = json.dumps(content, indent=1)
    path.write_text((text if len(text) < 100_000 else json.dumps(content)) + "\n")
