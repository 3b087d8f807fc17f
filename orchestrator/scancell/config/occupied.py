"""Description of measured occupied space."""

from __future__ import annotations

from pydantic import Field

from scancell.config.choices import CloudFrame
from scancell.config.description import Description, NonNegative, Positive


class OccupiedDescription(Description):
    """Space that planning keeps clear of, from a file: voxels of `scancell survey`, or a point cloud."""

    file: str = Field(description="voxels (NPZ) of `scancell survey`, or a point cloud (ply, npz, xyz, pcd, laz, e57)")
    frame: CloudFrame = Field(
        default="part",
        description="frame of the points of a cloud, as --frame of the scan that made it; points in the frames of part"
        " and table turn with the table",
    )
    voxel_mm: Positive = Field(default=5.0, description="edge of the voxels that a cloud becomes, mm")
    inflate_mm: NonNegative = Field(
        default=0.0, description="distance from points or voxels up to which space counts as occupied, mm"
    )
