"""Camera image files of several cameras: index, grouping by exposure, reading and writing."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.config.loading import Setup
from scancell.config.sensor import SensorDescription
from scancell.errors import ImageError, OutputError
from scancell.files import require_file
from scancell.output.run_folder import RunFolder
from scancell.scanning.sense import ExposureImages

INDEX = "frames.csv"
Laser = Literal["on", "off"]
_LASER: dict[str, Laser] = {"on": "on", "off": "off"}

SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".webp")
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_GREEN_NM = (490.0, 580.0)  # wavelengths that a colour camera sees best in its green channel
_CLEARLY_ABOVE = 1.25  # times full scale, from which on the described gain is not that of the images


@dataclass(frozen=True)
class ImageEntry:
    """One image: exposure, camera, laser state, and file name relative to the folder of the index."""

    exposure: str
    camera: str
    laser: Laser
    file: str


def write_index(frames: Sequence[ImageEntry], path: Path) -> None:
    """Write the index as CSV."""
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [column.name for column in fields(ImageEntry)])
        writer.writeheader()
        writer.writerows(asdict(frame) for frame in frames)


def read_index(path: Path) -> list[ImageEntry]:
    """Frames of an index written by `write_index`.

    Raises
    ------
    ImageError
        If the file cannot be read or is invalid, naming line and value.
    """
    columns = [column.name for column in fields(ImageEntry)]
    require_file(path, ImageError)
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ImageError(f"cannot be read: {error}", file=path) from None
    frames = []
    for line, row in enumerate(rows, start=2):
        missing = [name for name in columns if not row.get(name)]
        if missing:
            raise ImageError(
                f"has no {missing[0]}", file=path, key=f"line {line}", expected=f"the columns {', '.join(columns)}"
            )
        laser = _LASER.get(row["laser"])
        if laser is None:
            raise ImageError(file=path, key=f"line {line}: laser", value=row["laser"], expected="on or off")
        frames.append(ImageEntry(row["exposure"], row["camera"], laser, row["file"]))
    return frames


@dataclass(frozen=True)
class ImageSet:
    """Image files grouped by exposure, in natural order.

    Attributes
    ----------
    names
        (n,) names of the exposures.
    files
        (n, cameras) image files.
    ignored_files
        Ignored images: in a folder with an index that does not list them with the requested laser state.
    """

    names: tuple[str, ...]
    files: tuple[tuple[Path, ...], ...]
    ignored_files: tuple[Path, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def from_files(cls, given: Sequence[Path], cameras: Sequence[str], laser: Laser = "on") -> ImageSet:
        """Group files, and the images in folders, by exposure and camera.

        In a folder with an index (``frames.csv``) the index decides. Otherwise the file name contains the name of the
        camera as a word (``scan_007_plus.png`` for camera ``plus``), and the rest of the name is the exposure; with a
        single camera the whole name is.

        Parameters
        ----------
        given
            Image files and folders.
        cameras
            Names of the cameras.
        laser
            Laser state of the frames to take from an index.

        Raises
        ------
        ImageError
            If a file is missing, matches no camera or several, is given twice, or an exposure lacks a camera.
        """
        found: dict[str, dict[str, Path]] = {}
        ignored: list[Path] = []
        for path, camera, exposure in _classified(given, cameras, laser, ignored):
            others = found.setdefault(exposure, {})
            if camera in others:
                raise ImageError(f"exposure '{exposure}' of camera '{camera}' is {others[camera]} already", file=path)
            others[camera] = path
        names = sorted(found, key=_natural)
        for name in names:
            for camera in cameras:
                if camera not in found[name]:
                    other = next(iter(found[name].values()))
                    raise ImageError(f"exposure '{name}' has no image of camera '{camera}'", file=other)
        files = tuple(tuple(found[name][camera] for camera in cameras) for name in names)
        return cls(tuple(names), files, tuple(ignored))

    def matching(self, others: ImageSet) -> ImageSet:
        """The exposures of `others` (laser off) with the names of this set, in its order.

        Raises
        ------
        ImageError
            If one is missing.
        """
        files = dict(zip(others.names, others.files, strict=True))
        for name, (first, *_) in zip(self.names, self.files, strict=True):
            if name not in files:
                raise ImageError(f"exposure '{name}' has no image of that name with the laser off", file=first)
        return ImageSet(self.names, tuple(files[name] for name in self.names), others.ignored_files)


def read_images(
    sets: ImageSet, rows: range, sensor: sensor_rt.Sensor, described: SensorDescription, quarter_turns: int = 0
) -> NDArray[np.uint16]:
    """Images (exposures, cameras, height, width) of the exposures `rows`, digital numbers.

    `quarter_turns` counter-clockwise (``numpy.rot90``) turn the images of the files into those of the cameras. Of a
    colour image the channel of the laser's wavelength is taken: conversions to grey hide its saturation.

    Raises
    ------
    ImageError
        If a file is no single image of the camera's size, bit depth and full scale, or the cameras differ in size.
    """
    sizes = {(camera.height_px, camera.width_px) for camera in sensor.cameras}
    if len(sizes) > 1:
        raise ImageError(f"cameras of different sizes ({sorted(sizes)}) cannot be read together")
    (size,) = sizes
    stored = size[::-1] if quarter_turns % 2 else size
    images = np.empty((len(rows), len(sensor.cameras), *size), np.uint16)
    for i, row in enumerate(rows):
        for k, path in enumerate(sets.files[row]):
            images[i, k] = np.rot90(_read(path, stored, sensor.cameras[k].name, described), quarter_turns)
    return images


def laser_channel(wavelength_nm: float) -> str:
    """Channel of a colour camera that sees the laser: red (near infrared, too), green or blue."""
    low, high = _GREEN_NM
    return "blue" if wavelength_nm < low else "green" if wavelength_nm < high else "red"


def holds_colours(path: Path) -> bool:
    """Whether the channels of an image differ."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return image is not None and image.ndim == 3 and bool((image[:, :, :3] != image[:, :, :1]).any())


def _read(path: Path, size: tuple[int, int], camera: str, described: SensorDescription) -> NDArray[np.uint16]:
    require_file(path, ImageError)
    with path.open("rb") as stream:
        is_tiff = stream.read(4) in _TIFF
    if is_tiff and (pages := cv2.imcount(str(path))) > 1:
        raise ImageError(f"holds {pages} images", file=path, expected="one: save each page as a file of its own")
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ImageError("cannot be read as an image", file=path)
    if image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"found {image.dtype}", file=path, expected="8 or 16 bits per pixel")
    if image.ndim == 3:
        channel = ("blue", "green", "red").index(laser_channel(described.laser.wavelength_nm))
        image = image[:, :, channel if image.shape[2] >= 3 else 0]
    if image.shape != size:
        found, expected = (f"{shape[1]} x {shape[0]}" for shape in (image.shape, size))
        raise ImageError(f"is {found} pixels, camera '{camera}' has {expected}", file=path, expected=expected)
    _require_range(path, int(image.max()), described)
    return np.asarray(image, np.uint16)


def _require_range(path: Path, highest: int, described: SensorDescription) -> None:
    """Refuse values beyond the bit depth, or clearly beyond full scale, above which all pixels count as saturated."""
    detector = described.detector
    limit = (1 << detector.bit_depth) - 1
    if highest > limit:
        raise ImageError(
            f"holds the value {highest}, but detector.bit_depth = {detector.bit_depth} ends at {limit}", file=path
        )
    full_scale = detector.black_level_dn + detector.full_well_e * detector.gain_dn_per_e
    if highest > _CLEARLY_ABOVE * full_scale:
        gain = (limit - detector.black_level_dn) / detector.full_well_e
        raise ImageError(
            f"holds the value {highest}; all above {full_scale:.0f} counts as saturated, which is full_well_e"
            " * gain_dn_per_e + black_level_dn",
            file=path,
            expected=f"sensor.detector.gain_dn_per_e of this camera, {gain:.3g} for {detector.bit_depth} bits (without"
            " this key the bit depth sets the full scale)",
        )


def _classified(
    given: Sequence[Path], cameras: Sequence[str], laser: Laser, ignored: list[Path]
) -> Iterator[tuple[Path, str, str]]:
    """File, camera and exposure of the files and of the images in folders; appends unlisted images to `ignored`."""
    for path in given:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
            if (path / INDEX).exists():
                frames = list(_indexed(path / INDEX, cameras, laser))
                indexed = {file for file, _, _ in frames}
                ignored.extend(file for file in inside if file not in indexed)
                yield from frames
                continue
            if not inside:
                raise ImageError(f"holds no image ({', '.join(SUFFIXES)})", file=path)
            yield from ((file, *_camera_and_exposure(file, cameras)) for file in inside)
        elif path.is_file():
            yield path, *_camera_and_exposure(path, cameras)
        else:
            raise ImageError("no such file", file=path)


def _indexed(index: Path, cameras: Sequence[str], laser: Laser) -> Iterator[tuple[Path, str, str]]:
    """File, camera and exposure of the frames in an index with the given laser state."""
    frames = [frame for frame in read_index(index) if frame.laser == laser]
    if not frames:
        raise ImageError(f"lists no image with the laser {laser}", file=index)
    for frame in frames:
        if frame.camera not in cameras:
            raise ImageError(f"camera '{frame.camera}' is not one of the sensor's ({', '.join(cameras)})", file=index)
        file = index.parent / frame.file
        if not file.is_file():
            raise ImageError(f"lists {frame.file}: no such file", file=index)
        yield file, frame.camera, frame.exposure


def _camera_and_exposure(path: Path, cameras: Sequence[str]) -> tuple[str, str]:
    """Camera and exposure by the file name."""
    if len(cameras) == 1:
        return cameras[0], path.stem
    matches = [(camera, re.search(rf"(?<![^\W_]){re.escape(camera)}(?![^\W_])", path.stem)) for camera in cameras]
    named = [(camera, match) for camera, match in matches if match]
    if len(named) != 1:
        reason = "names several cameras" if named else "names no camera"
        raise ImageError(reason, file=path, expected=f"one of the words {', '.join(cameras)} in the name")
    camera, match = named[0]
    return camera, (path.stem[: match.start()] + path.stem[match.end() :]).strip("_-. ")


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key for natural order: scan_2 before scan_10."""
    return [(int(piece), "") if piece.isdecimal() else (-1, piece) for piece in re.split(r"([0-9]+)", name)]


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
    """Callback that writes the images of every exposure into ``images/`` and ``laser_off/`` of a run folder.

    Those of further sensors come into subfolders of these with the names of the sensors.
    """

    def __init__(self, folder: RunFolder, setup: Setup) -> None:
        self._images, self._background = [], []
        for number, name in enumerate(setup.sensor_names, 1):
            cameras = [camera.name for camera in setup.seen_by(number).sensor.camera]
            place = "" if number == 1 else f"/{name}"
            self._images.append(FrameFiles(folder, f"images{place}", cameras))
            self._background.append(FrameFiles(folder, f"laser_off{place}", cameras))

    def __call__(self, images: ExposureImages) -> None:
        name, number = f"raw_{images.trigger:05d}", images.sensor - 1
        self._images[number].add(name, images.images, "on")
        if images.background is not None:
            self._background[number].add(name, images.background, "off")

    def finish(self) -> None:
        """Write the index of each folder."""
        for files in (*self._images, *self._background):
            files.finish()
