"""Camera image files of a run: raw images with their index, and pictures with the extracted stripe."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.errors import OutputError
from scancell.output.frame_index import INDEX, ImageEntry, Laser, write_index
from scancell.output.run_folder import RunFolder
from scancell.output.stripe_picture import stripe_picture
from scancell.scanning.sense import ExposureImages


class FrameFiles:
    """Writer of camera images and their index into a subfolder of a run.

    Parameters
    ----------
    subfolder
        Name of the subfolder; empty for the run folder itself.
    cameras
        Names of the cameras.
    """

    def __init__(self, folder: RunFolder, subfolder: str, cameras: Sequence[str]) -> None:
        self._folder = folder
        self._prefix = f"{subfolder}/" if subfolder else ""
        self._cameras = cameras
        self._frames: list[ImageEntry] = []

    def add(self, exposure: str, images: NDArray[np.uint16], laser: Laser = "on", name: str | None = None) -> None:
        """Write one PNG per camera of images (cameras, H, W): 8 bits if all values fit, else 16 bits.

        Files are named after `name` (by default `exposure`) and the camera.

        Raises
        ------
        OutputError
            If a file cannot be written.
        """
        for camera, image in zip(self._cameras, images, strict=True):
            file = f"{name or exposure}_{camera}.png"
            path = self._folder.path(self._prefix + file)
            plane = image.astype(np.uint8) if image.max(initial=0) < 256 else image
            if not cv2.imwrite(str(path), plane):
                raise OutputError("cannot be written", file=self._folder.target / self._prefix / file)
            self._frames.append(ImageEntry(exposure, camera, laser, file))

    def finish(self) -> None:
        """Write the index, if any image was added."""
        if self._frames:
            write_index(self._frames, self._folder.path(self._prefix + INDEX))


class ImageWriter:
    """Callback that writes the images of every exposure into ``images/`` and ``laser_off/`` of a run folder."""

    def __init__(self, folder: RunFolder, cameras: Sequence[str]) -> None:
        self._images = FrameFiles(folder, "images", cameras)
        self._background = FrameFiles(folder, "laser_off", cameras)

    def __call__(self, images: ExposureImages) -> None:
        name = f"raw_{images.trigger:05d}"
        self._images.add(name, images.images, "on")
        if images.background is not None:
            self._background.add(name, images.background, "off")

    def finish(self) -> None:
        """Write the index of each folder."""
        self._images.finish()
        self._background.finish()


def draw_stripes(
    images: NDArray[np.uint16],
    sensor: sensor_rt.Sensor,
    path: Path,
    title: str,
    background: NDArray[np.uint16] | None = None,
) -> None:
    """Draw the images (cameras, H, W) of an exposure with the extracted stripe into one picture.

    `background` are laser-off images of the same shape to subtract before extraction.
    """
    peaks = sensor_rt.extract(images[None], sensor, background=None if background is None else background[None])
    found = [
        (np.asarray(peaks.column)[peaks.camera == k], np.asarray(peaks.row)[peaks.camera == k])
        for k in range(len(sensor.cameras))
    ]
    stripe_picture(path, list(images), found, names=[camera.name for camera in sensor.cameras], title=title)
