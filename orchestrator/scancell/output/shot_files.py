"""Files of a single exposure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.output.frames import FrameFiles, draw_stripes
from scancell.output.run_folder import RunFolder
from scancell.output.tables import write_profile_csv
from scancell.reconstruction.reconstruct import ProfilePoints
from scancell.scanning.sense import ExposureImages


def write_shot(
    folder: RunFolder,
    profile: ProfilePoints,
    rows: NDArray[np.float64],
    points_in_part: NDArray[np.float64],
    images: ExposureImages | None,
    sensor: sensor_rt.Sensor,
) -> None:
    """Write ``profile.csv`` and, with images, one PNG per camera and ``stripes.png``.

    `rows` (n,) are the image rows of the points, px, and `points_in_part` (n, 3) the points in the part frame, m.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    write_profile_csv(folder.path("profile.csv"), profile, rows, points_in_part)
    if images is None:
        return
    files = FrameFiles(folder, "", [camera.name for camera in sensor.cameras])
    files.add("image", images.images)
    if images.background is not None:
        files.add("image", images.background, "off", "laser_off")
    files.finish()
    draw_stripes(images.images, sensor, folder.path("stripes.png"), "shot", images.background)
