"""Video files: WebM with VP9, by the FFmpeg inside OpenCV."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scancell.errors import DescriptionError, OutputError
from scancell.files import atomic_write

Image = NDArray[np.uint8]

_CODEC = "VP90"


@contextmanager
def webm_writer(path: str | Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    """Context manager: yields a function that adds a frame (height, width, 3), RGB; the file appears when all is done.

    Parameters
    ----------
    size
        Width and height, px; even numbers, as the colour planes of the format need.

    Raises
    ------
    DescriptionError
        If the file name does not end in .webm, or the size is odd.
    OutputError
        If the installed OpenCV cannot encode VP9, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".webm":
        raise DescriptionError(f"--out {path}: expected a file name that ends in .webm")
    if size[0] % 2 or size[1] % 2:
        raise DescriptionError(f"--size {size[0]}x{size[1]}: expected even numbers for a video")
    with atomic_write(path) as temporary:
        temporary.touch()  # OpenCV does not say why a file cannot be written
        with _without_native_messages():
            writer = cv2.VideoWriter(str(temporary), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*_CODEC), fps, size)
        if not writer.isOpened():
            raise OutputError(
                f"{path}: the installed OpenCV cannot encode VP9; expected one with FFmpeg, such as that of"
                " pip install opencv-python-headless"
            )
        count = 0

        def add(frame: Image) -> None:
            nonlocal count
            if frame.shape != (size[1], size[0], 3):
                raise ValueError(f"frame {frame.shape}: expected ({size[1]}, {size[0]}, 3)")
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
            count += 1

        try:
            yield add
        finally:
            writer.release()
        if not count or not temporary.stat().st_size:
            raise OutputError(f"{path}: no frame could be written; is the disk full?")


@contextmanager
def _without_native_messages() -> Iterator[None]:
    """OpenCV writes to the process's standard error that WebM knows no tag for VP9, and goes on; nothing is wrong."""
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
