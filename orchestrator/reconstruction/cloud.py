"""The point cloud: what a scan measured, in the frame of the part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cloud:
    """n points in the part frame (the mesh file's own coordinate system), metres and seconds.

    Attributes
    ----------
    points_in_part, normals
        (n, 3); unit normals look out of the surface, towards the sensor. NaN where no neighbour was near enough.
    sigma
        (n,) standard deviation along the direction of largest uncertainty, m.
    intensity
        (n,) height of the stripe in the image, digital numbers; 0 from the geometric engine.
    quality
        (n,) 0 … 1, see `reconstruct.quality_of`.
    camera
        (n,) number of the camera that saw the point.
    column
        (n,) column of that camera's image, px; the nearest one where the point was not found in a column.
    profile, segment, time
        (n,) index, segment and mid-exposure time (s) of the trigger that made it.
    """

    points_in_part: Array
    normals: Array
    sigma: Array
    intensity: Array
    quality: Array
    camera: NDArray[np.int32]
    column: NDArray[np.int32]
    profile: NDArray[np.int64]
    segment: NDArray[np.int32]
    time: Array

    def __len__(self) -> int:
        return len(self.points_in_part)

    def __getitem__(self, chosen: NDArray[Any] | slice) -> Self:
        """The points that a mask, index array or slice chooses."""
        return type(self)(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    @classmethod
    def concatenate(cls, clouds: Sequence[Cloud]) -> Self:
        """Several clouds in one."""
        names = [field.name for field in fields(cls)]
        return cls(**{name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names})
