"""Image files of several cameras: which belong together, and their pixels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.errors import ImageError
from orchestrator.evaluation.frame_index import INDEX, Laser, read_index

SUFFIXES = (".png", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True)
class ImageSet:
    """Exposures in natural order: `names` (n,) and `files` (n, cameras).

    `left_aside` are images in folders whose index does not list them as such frames.
    """

    names: tuple[str, ...]
    files: tuple[tuple[Path, ...], ...]
    left_aside: tuple[Path, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def from_files(cls, given: Sequence[Path], cameras: Sequence[str], laser: Laser = "on") -> ImageSet:
        """Sort files, and the images in folders, by camera and exposure.

        Of a folder with an index (``frames.csv``) the frames are taken that it lists with the laser on, or off. Else
        the file of camera ``plus`` has the word ``plus`` in its name (``scan_007_plus.png``); what remains of the name
        tells the exposure. With a single camera the whole name tells it.

        Raises
        ------
        ImageError
            If a file is missing, belongs to no camera or to several, comes twice, or an exposure lacks a camera.
        """
        found: dict[str, dict[str, Path]] = {}
        aside: list[Path] = []
        for path, camera, exposure in _placed(given, cameras, laser, aside):
            others = found.setdefault(exposure, {})
            if camera in others:
                raise ImageError(f"{path}: exposure '{exposure}' of camera '{camera}' is {others[camera]} already")
            others[camera] = path
        names = sorted(found, key=_natural)
        for name in names:
            for camera in cameras:
                if camera not in found[name]:
                    some = next(iter(found[name].values()))
                    raise ImageError(f"{some}: exposure '{name}' has no image of camera '{camera}'")
        files = tuple(tuple(found[name][camera] for camera in cameras) for name in names)
        return cls(tuple(names), files, tuple(aside))

    def partners(self, others: ImageSet) -> ImageSet:
        """Of `others` the exposures of the same names, in the order of this set.

        Raises
        ------
        ImageError
            If one is missing.
        """
        files = dict(zip(others.names, others.files, strict=True))
        for name, (first, *_) in zip(self.names, self.files, strict=True):
            if name not in files:
                raise ImageError(f"{first}: exposure '{name}' has no image of that name with the laser off")
        return ImageSet(self.names, tuple(files[name] for name in self.names), others.left_aside)


def read_images(sets: ImageSet, rows: range, sensor: sensor_rt.Sensor, bit_depth: int) -> NDArray[np.uint16]:
    """Images (exposures, cameras, height, width) of some exposures.

    Raises
    ------
    ImageError
        If a file is no grey image of the camera's size and bit depth, or the cameras differ in size.
    """
    sizes = {(camera.height_px, camera.width_px) for camera in sensor.cameras}
    if len(sizes) > 1:
        raise ImageError(f"cameras of different sizes ({sorted(sizes)}) cannot be read together")
    (size,) = sizes
    images = np.empty((len(rows), len(sensor.cameras), *size), np.uint16)
    for i, row in enumerate(rows):
        for k, path in enumerate(sets.files[row]):
            images[i, k] = _read(path, size, sensor.cameras[k].name, bit_depth)
    return images


def _read(path: Path, size: tuple[int, int], camera: str, bit_depth: int) -> NDArray[np.uint16]:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ImageError(f"{path}: cannot be read as an image")
    if image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"{path}: expected 8 or 16 bits per pixel, found {image.dtype}")
    if image.ndim == 3:  # a palette of greys, or grey values stored as colours
        colours = image[:, :, :3]
        if (colours != colours[:, :, :1]).any():
            raise ImageError(f"{path}: expected a grey image, found colours")
        image = colours[:, :, 0]
    if image.shape != size:
        found, expected = (f"{shape[1]} x {shape[0]}" for shape in (image.shape, size))
        raise ImageError(f"{path}: is {found} pixels, camera '{camera}' has {expected}")
    highest, limit = int(image.max()), (1 << bit_depth) - 1
    if highest > limit:
        raise ImageError(f"{path}: holds the value {highest}, but detector.bit_depth = {bit_depth} ends at {limit}")
    return np.asarray(image, np.uint16)


def _placed(
    given: Sequence[Path], cameras: Sequence[str], laser: Laser, aside: list[Path]
) -> Iterator[tuple[Path, str, str]]:
    """File, camera and exposure of the files and of the images in folders; adds to `aside` what an index leaves out."""
    for path in given:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
            if (path / INDEX).exists():
                listed = list(_listed(path / INDEX, cameras, laser))
                taken = {file for file, _, _ in listed}
                aside.extend(file for file in inside if file not in taken)
                yield from listed
                continue
            if not inside:
                raise ImageError(f"{path}: holds no image ({', '.join(SUFFIXES)})")
            yield from ((file, *_place(file, cameras)) for file in inside)
        elif path.is_file():
            yield path, *_place(path, cameras)
        else:
            raise ImageError(f"{path}: no such file")


def _listed(index: Path, cameras: Sequence[str], laser: Laser) -> Iterator[tuple[Path, str, str]]:
    frames = [frame for frame in read_index(index) if frame.laser == laser]
    if not frames:
        raise ImageError(f"{index}: lists no image with the laser {laser}")
    for frame in frames:
        if frame.camera not in cameras:
            raise ImageError(f"{index}: camera '{frame.camera}' is none of the sensor's ({', '.join(cameras)})")
        file = index.parent / frame.file
        if not file.is_file():
            raise ImageError(f"{index}: lists {frame.file}: no such file")
        yield file, frame.camera, frame.exposure


def _place(path: Path, cameras: Sequence[str]) -> tuple[str, str]:
    """Camera and exposure that a file name tells."""
    if len(cameras) == 1:
        return cameras[0], path.stem
    matches = [(camera, re.search(rf"(?<![^\W_]){re.escape(camera)}(?![^\W_])", path.stem)) for camera in cameras]
    named = [(camera, match) for camera, match in matches if match]
    if len(named) != 1:
        fault = "names several cameras" if named else "names no camera"
        raise ImageError(f"{path}: {fault}; expected one of the words {', '.join(cameras)} in the name")
    camera, match = named[0]
    return camera, (path.stem[: match.start()] + path.stem[match.end() :]).strip("_-. ")


def _natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts scan_2 before scan_10."""
    return [(int(piece), "") if piece.isdigit() else (-1, piece) for piece in re.split(r"(\d+)", name)]
