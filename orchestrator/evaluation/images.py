"""Camera images on disk: as the cameras gave them, and with the found stripe drawn in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.errors import OutputError
from orchestrator.evaluation.run_folder import RunFolder
from orchestrator.evaluation.stripe_picture import stripe_picture


def write_raw_images(images: NDArray[np.uint16], sensor: sensor_rt.Sensor, folder: RunFolder, name: str) -> None:
    """One PNG per camera, 8 bits deep where all values fit, else 16.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    for camera, image in zip(sensor.cameras, images, strict=True):
        path = folder.path(f"{name}_{camera.name}.png")
        plane = image.astype(np.uint8) if image.max(initial=0) < 256 else image
        if not cv2.imwrite(str(path), plane):
            raise OutputError(f"{folder.target / path.name}: cannot be written")


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
