"""Video files: WebM with VP9, by the FFmpeg inside OpenCV, and animated pictures in WebP by Pillow."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from PIL import Image as Picture

from scancell.arrays import Image
from scancell.errors import DescriptionError, OutputError
from scancell.files import atomic_write

_CODEC = "VP90"
_QUALITY = 65  # of WebP, 0 to 100
_MOST_BYTES = 1_000_000_000  # of frames in memory


@contextmanager
def video_writer(path: str | Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    """Context manager: yields a function that adds a frame (height, width, 3), RGB; the file appears when all is done.

    Parameters
    ----------
    path
        ``.webm``: VP9. ``.webp``: an animated picture, which repeats, for pages that show no videos; its frames are
        kept in memory until it is written.
    size
        Width and height, px; even numbers for WebM, as the colour planes of the format need.

    Raises
    ------
    DescriptionError
        If the file name ends otherwise, or the size is odd.
    OutputError
        If the installed OpenCV cannot encode VP9, the file cannot be written, or the frames of an animated picture
        would take more than 1 GB.
    """
    path = Path(path)
    writers = {".webm": _webm_writer, ".webp": _webp_writer}
    if path.suffix.lower() not in writers:
        raise DescriptionError(key="out", value=str(path), expected="a file name that ends in .webm or .webp")
    if path.suffix.lower() == ".webm" and (size[0] % 2 or size[1] % 2):
        raise DescriptionError(key="size", value=f"{size[0]}x{size[1]}", expected="even numbers for a video")
    with atomic_write(path) as temporary:
        temporary.touch()  # OpenCV does not say why a file cannot be written
        count = 0
        with writers[path.suffix.lower()](path, temporary, size, fps) as write:

            def add(frame: Image) -> None:
                nonlocal count
                if frame.shape != (size[1], size[0], 3):
                    raise ValueError(f"frame {frame.shape}: expected ({size[1]}, {size[0]}, 3)")
                write(frame)
                count += 1

            yield add
        if not count or not temporary.stat().st_size:
            raise OutputError("no frame could be written; is the disk full?", file=path)


@contextmanager
def _webm_writer(path: Path, temporary: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    with _without_native_messages():
        writer = cv2.VideoWriter(str(temporary), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*_CODEC), fps, size)
    if not writer.isOpened():
        raise OutputError(
            "the installed OpenCV cannot encode VP9",
            file=path,
            expected="one with FFmpeg, such as that of pip install opencv-python-headless",
        )
    try:
        yield lambda frame: writer.write(np.ascontiguousarray(frame[..., ::-1]))
    finally:
        writer.release()


@contextmanager
def _webp_writer(path: Path, temporary: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    frames: list[Picture.Image] = []

    def write(frame: Image) -> None:
        if (len(frames) + 1) * frame.nbytes > _MOST_BYTES:
            raise OutputError(
                "more than 1 GB of frames: choose a smaller `size`, `fps` or `seconds`, or WebM", file=path
            )
        frames.append(Picture.fromarray(frame))

    yield write
    if frames:
        options = {"duration": round(1e3 / fps), "loop": 0, "quality": _QUALITY, "method": 4}
        frames[0].save(temporary, "WEBP", save_all=True, append_images=frames[1:], **options)


@contextmanager
def _without_native_messages() -> Iterator[None]:
    """Suppress a harmless message of OpenCV on the process's standard error: WebM has no tag for VP9."""
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
