"""Camera images on disk: as the cameras gave them, and with the found stripe drawn in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.errors import OutputError
from orchestrator.evaluation.frame_index import INDEX, Frame, Laser, write_index
from orchestrator.evaluation.run_folder import RunFolder
from orchestrator.evaluation.stripe_picture import stripe_picture


class FrameFiles:
    """Camera images in a subfolder of a run (empty: none), and the index that tells them from other files there."""

    def __init__(self, folder: RunFolder, subfolder: str, sensor: sensor_rt.Sensor) -> None:
        self._folder = folder
        self._prefix = f"{subfolder}/" if subfolder else ""
        self._sensor = sensor
        self._frames: list[Frame] = []

    def add(self, exposure: str, images: NDArray[np.uint16], laser: Laser = "on", name: str | None = None) -> None:
        """One PNG per camera of the images (cameras, H, W), 8 bits deep where all values fit, else 16.

        Files are called `name`, the name of the exposure unless given, and the camera.

        Raises
        ------
        OutputError
            If a file cannot be written.
        """
        for camera, image in zip(self._sensor.cameras, images, strict=True):
            file = f"{name or exposure}_{camera.name}.png"
            path = self._folder.path(self._prefix + file)
            plane = image.astype(np.uint8) if image.max(initial=0) < 256 else image
            if not cv2.imwrite(str(path), plane):
                raise OutputError(f"{self._folder.target / self._prefix / file}: cannot be written")
            self._frames.append(Frame(exposure, camera.name, laser, file))

    def finish(self) -> None:
        """Write the index, if there are images."""
        if self._frames:
            write_index(self._frames, self._folder.path(self._prefix + INDEX))


def draw_stripes(
    images: NDArray[np.uint16],
    sensor: sensor_rt.Sensor,
    path: Path,
    title: str,
    unlit: NDArray[np.uint16] | None = None,
) -> None:
    """One picture of the images (cameras, H, W) of an exposure with the stripe that was found in them.

    `unlit` are the images with the laser off that the search takes away, where the sensor takes such.
    """
    peaks = sensor_rt.extract(images[None], sensor, unlit=None if unlit is None else unlit[None])
    found = [
        (np.asarray(peaks.column)[peaks.camera == k], np.asarray(peaks.row)[peaks.camera == k])
        for k in range(len(sensor.cameras))
    ]
    stripe_picture(path, list(images), found, names=[camera.name for camera in sensor.cameras], title=title)
