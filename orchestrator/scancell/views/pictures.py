"""Pictures and animations of a recorded run, with their caption."""

from __future__ import annotations

import html
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from os import cpu_count
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from PIL import Image as Picture

from scancell.arguments import Threads, Within, checked_arguments
from scancell.arrays import Array, Image
from scancell.config.cell import sensor_frame
from scancell.errors import DescriptionError, OutputError
from scancell.files import atomic_write
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.output.sheet import INK, Sheet, text_width
from scancell.output.web_page import packed, packed_mesh, quantised, script_data, write_filled
from scancell.progress import Progress, ProgressCallback, as_progress
from scancell.views import renderer
from scancell.views.camera import (
    AZIMUTH_DEG,
    ELEVATION_DEG,
    CameraPath,
    View,
    camera_path,
    framing,
    laser_sheet,
    points_of_bodies,
)
from scancell.views.recorded_run import RecordedRun, open_run
from scancell.views.renderer import ColourBy, ColouredCloud, PaintedBody, Renderer, coloured_by, displayed

_CODEC = "VP90"
_QUALITY = 65  # of WebP, 0 to 100
_MOST_BYTES = 1_000_000_000  # of frames in memory

Pixels = Annotated[int, Within(64, 7680)]

_SECONDS = 10.0  # of an animation, unless its length or speed is given
_ARM, _JOINT = (0.90, 0.905, 0.91), (0.80, 0.815, 0.83)
_SENSOR, _GRIPPER = (0.23, 0.26, 0.31), (0.36, 0.40, 0.45)
_TABLE, _STAND, _PART = (0.56, 0.60, 0.645), (0.42, 0.45, 0.49), (0.86, 0.85, 0.82)
_OTHER = (0.80, 0.66, 0.40)

_SAMPLES = 1200  # of the poses at most
_STEP = 0.05  # s between them at least
_TEMPLATE = Path(__file__).with_name("page.html")


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


def captioned(image: Image, name: str, time: float, cloud: ColouredCloud | None) -> Image:
    """The picture (h, w, 3) with its caption, whose size goes with the height, on a paler background."""
    facts = [f"t = {time:.2f} s"]
    if cloud is not None:
        share = cloud.measured_until(time) / max(len(cloud.time), 1)
        facts.append(f"{cloud.total * share:,.0f} points")
    return _captioned(image, name, facts, cloud)


def _captioned(image: Image, name: str, facts: Sequence[str], cloud: ColouredCloud | None = None) -> Image:
    """The picture (h, w, 3) with a name, a line of facts, and the colour scale of a cloud."""
    height, width, _ = image.shape
    size, rim = max(9.0, height / 42), height / 30
    line = "  ·  ".join([*facts, f"grid {1e3 * renderer.GRID:.0f} mm"])
    written = max(text_width(name, 1.15 * size, bold=True), text_width(line, size))
    pale = image.copy()
    _pale(pale, rim / 2, rim / 2, 1.5 * rim + written, rim + 3 * size)
    if cloud is not None:
        _pale(pale, width - 2 * rim - 256, height - 1.5 * rim - 3.2 * size, width - rim / 2, height - rim / 2)
    sheet = Sheet.of(pale)
    sheet.text(rim, rim + size, name, 1.15 * size, INK, bold=True)
    sheet.text(rim, rim + 2.5 * size, line, size, INK)
    if cloud is not None:
        _colour_bar(sheet, cloud, width - 1.25 * rim, height - rim, size)
    return sheet.pixels


def _pale(image: Image, left: float, top: float, right: float, bottom: float) -> None:
    """Blend a rectangle of an image (h, w, 3) with white, so that text on it can be read."""
    area = image[max(0, round(top)) : round(bottom), max(0, round(left)) : round(right)]
    area[:] = (0.4 * area + 0.6 * 255).astype(np.uint8)


def _colour_bar(sheet: Sheet, cloud: ColouredCloud, right: float, bottom: float, size: float) -> None:
    """The colour scale of the cloud, its lower right corner at (right, bottom)."""
    bar = np.repeat(cloud.scale[None], max(4, round(0.55 * size)), 0).astype(np.uint8)
    left, top = round(right - bar.shape[1]), round(bottom - 1.5 * size - bar.shape[0])
    sheet.image(bar, left, top)
    low, high = cloud.limits
    for x, value in ((left, low), (left + bar.shape[1] / 2, (low + high) / 2), (left + bar.shape[1], high)):
        label = f"{value:+.3g}" if low < 0 and value else f"{value:.3g}"
        sheet.text(x, bottom, label.replace("-", "\N{MINUS SIGN}"), 0.85 * size, INK, "ms")
    sheet.text(left + bar.shape[1] / 2, top - 0.5 * size, cloud.title, 0.85 * size, INK, "ms")


class RunPictures:
    """Takes pictures of a run; made by `run_pictures`.

    Parameters
    ----------
    size
        Width and height, px.
    colour
        What the colours of the cloud show.
    span
        Time of the run between pictures, s; the laser is shown where an exposure falls into it.
    """

    def __init__(
        self, run: RecordedRun, renderer: Renderer, path: CameraPath, cloud: ColouredCloud | None, span: float
    ) -> None:
        self._run, self._renderer, self._path, self._cloud, self._span = run, renderer, path, cloud, span

    def at(self, time: float, share: float = 0.0) -> Image:
        """The picture (height, width, 3) at `time` (s), when this share (0 to 1) of the pictures is taken."""
        run, camera = self._run, self._path(time, share)
        frames = run.motion.frames(time)
        lasers = []
        if run.motion.laser_on(time, self._span):
            numbers = range(1, len(run.setup.sensor_names) + 1)
            lasers = [laser_sheet(run.setup.seen_by(n).sensor, frames[sensor_frame(n)]) for n in numbers]
        poses = np.stack([frames[body.moves_with] for body in run.cell.bodies])
        rendered = self._renderer.render(camera, poses, *lasers)
        if self._cloud is not None:
            self._cloud.draw(rendered, camera, frames["part"], time)
        return captioned(displayed(rendered.light), run.name, time, self._cloud)


def run_pictures(
    run: RecordedRun, view: View, size: tuple[int, int], colour: ColourBy, threads: int, span: float = 0.0
) -> RunPictures:
    """Prepare pictures of a run; see `animate`, and `RunPictures` for `span`."""
    path = camera_path(view, run, size)
    cloud = None if run.cloud is None else coloured_by(run.cloud, run.cloud_points, run.part, colour, threads)
    return RunPictures(run, renderer_of(run.cell), path, cloud, span)


def renderer_of(cell: NominalCell) -> Renderer:
    """Renderer of the bodies of a cell, on the floor on which the lowest of them stands."""
    standing = [body.mesh.bounds[0, 2] for body in cell.bodies if body.moves_with == "world"]
    middle = (cell.arm.world_from_base[:3, 3] + cell.world_from_table[:3, 3]) / 2
    bodies = [painted(body, number) for number, body in enumerate(cell.bodies)]
    return Renderer(bodies, float(min(standing, default=0.0)), middle)


def cell_picture(
    cell: NominalCell, axes: Array, name: str, facts: Sequence[str], size: tuple[int, int] = (1280, 720)
) -> Sheet:
    """Picture of a whole cell at positions (axes,) of its axes, rad or m, with a name and a line of facts.

    `size` is its width and height, px.
    """
    frames = cell.frame_poses(cell.with_further_axes(axes))
    camera = framing(points_of_bodies(cell.bodies, frames), AZIMUTH_DEG, ELEVATION_DEG, size)
    poses = np.stack([frames[body.moves_with] for body in cell.bodies])
    return Sheet.of(_captioned(displayed(renderer_of(cell).render(camera, poses).light), name, facts))


@checked_arguments
def picture(
    run: str | Path | RecordedRun,
    out: str | Path,
    *,
    time: float | None = None,
    view: View = "cell",
    size: tuple[Pixels, Pixels] = (1280, 720),
    colour: ColourBy = "deviation",
    threads: Threads = 0,
) -> float:
    """Write a picture of the cell as PNG, and return its time in the run, s.

    Parameters
    ----------
    run
        Folder of a saved scan.
    out
        File of the picture.
    time
        In the run, s; None: that of the last exposure, or of the end where a robot program took none.
    view
        ``cell`` and ``part`` are fixed, ``orbit`` goes once around the cell, ``sensor`` follows the sensor.
    size
        Width and height, px.
    colour
        What the colours of the cloud show: its ``deviation`` from the mesh, or ``intensity``.
    threads
        0: as many as there are cores.

    Raises
    ------
    ScancellError
        If `time` is not in the run, the run cannot be read, or the file cannot be written.

    Examples
    --------
    >>> settings = {"scan.sweep.enabled": False, "scan.raster.pitch_mm": 5}
    >>> files = scancell.scan("part.stl", engine="geometric", settings=settings).save("run")
    >>> time = scancell.picture("run", "picture.png", view="part", size=(320, 240))
    >>> print(f"at {time / scancell.read_recording('run/recording.parquet').measured.time[-1]:.0%} of the scan")
    at 100% of the scan
    """
    run = _opened(run)
    exposures, end = run.motion.exposures, run.motion.duration
    last = min(float(exposures[-1]), end) if len(exposures) else end
    at = last if time is None else time
    if not run.motion.start <= at <= run.motion.duration:
        raise DescriptionError(key="time", value=at, expected=f"{run.motion.start:g} to {run.motion.duration:g} s")
    Sheet.of(run_pictures(run, view, size, colour, threads).at(at)).write(out)
    return at


@checked_arguments
def animate(
    run: str | Path | RecordedRun,
    out: str | Path,
    *,
    view: View = "cell",
    size: tuple[Pixels, Pixels] = (1280, 720),
    fps: Annotated[float, Within(1.0, 120.0)] = 25.0,
    seconds: Annotated[float, Within(0.01, 1e4)] | None = None,
    speed: Annotated[float, Within(1e-3, 1e6)] | None = None,
    colour: ColourBy = "deviation",
    threads: Threads = 0,
    progress: Progress | ProgressCallback | None = None,
) -> int:
    """Write an animation of the whole run as WebM (VP9) or animated WebP, and return the number of its frames.

    Parameters
    ----------
    run, view, size, colour, threads
        As of `picture`.
    out
        File that ends in ``.webm`` or ``.webp``.
    fps
        Frames per second.
    seconds, speed
        Length of the animation, s, or seconds of the run in one second of it; not both. 10 s by default.
    progress
        Receives the frames that are rendered.

    Raises
    ------
    ScancellError
        If an option is wrong, the run cannot be read, or the file cannot be written.

    Examples
    --------
    >>> settings = {"scan.sweep.enabled": False, "scan.raster.pitch_mm": 5}
    >>> files = scancell.scan("part.stl", engine="geometric", settings=settings).save("run")
    >>> scancell.animate("run", "scan.webp", size=(160, 120), seconds=0.2, fps=10)
    2
    """
    run = _opened(run)
    if seconds is not None and speed is not None:
        raise DescriptionError(f"`seconds` {seconds:g} and `speed` {speed:g}", expected="one of them")
    reported = as_progress(progress)
    start, length = run.motion.start, run.motion.duration - run.motion.start
    wanted = length / speed if speed is not None else _SECONDS if seconds is None else seconds
    count = max(1, round(wanted * fps))
    times = start + length * np.arange(count) / max(count - 1, 1)
    reported.stage("rendering", count, "frames")
    with video_writer(out, size, fps) as add:
        pictures = run_pictures(run, view, size, colour, threads, length / max(count - 1, 1))
        for frame in _in_order(pictures.at, times.tolist(), (np.arange(count) / count).tolist(), threads):
            add(frame)
            reported.advance(1)
    return count


def _opened(run: str | Path | RecordedRun) -> RecordedRun:
    return run if isinstance(run, RecordedRun) else open_run(run)


def _in_order(
    take: Callable[[float, float], Image], times: list[float], shares: list[float], threads: int
) -> Iterator[Image]:
    """Pictures one after the other, a few of the next ones in work in as many threads."""
    workers = threads or cpu_count() or 1
    waiting: deque[Future[Image]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for time, share in zip(times, shares, strict=True):
                waiting.append(pool.submit(take, time, share))
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def painted(body: Body, number: int) -> PaintedBody:
    """A body in the colour of its kind; links differ a little from their neighbours, by `number`."""
    frame, name = body.moves_with, body.name
    if name == "base" or (frame.startswith("link[") and name != "gripper"):
        colour = (_ARM, _JOINT)[number % 2]
    else:
        by_name = {"table_base": _STAND, "sensor": _SENSOR, "table": _TABLE, "part": _PART, "gripper": _GRIPPER}
        colour = _GRIPPER if frame.startswith("finger[") else by_name.get(name, _OTHER)
        colour = _SENSOR if frame.startswith("sensor[") else colour
    return PaintedBody(name, body.mesh, colour, lets_laser_pass=frame.startswith("sensor"))


def write_page(run: RecordedRun, out: str | Path, *, colour: ColourBy = "deviation", threads: int = 0) -> int:
    """Write a run as one HTML file, and return its size in bytes: 17.3 for each point, and the meshes.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    return write_filled(_TEMPLATE, out, TITLE=html.escape(run.name), RUN=script_data(_content(run, colour, threads)))


def _content(run: RecordedRun, colour: ColourBy, threads: int) -> dict[str, Any]:
    motion, laser = run.motion, run.setup.sensor.laser
    length = motion.duration - motion.start
    samples = int(np.clip(np.ceil(length / _STEP) + 1, 2, _SAMPLES))
    times = motion.start + np.linspace(0.0, length, samples)
    frames = list(run.cell.frame_poses())
    poses = np.array([[at[name] for name in frames] for at in map(motion.frames, times.tolist())])
    flat = np.concatenate([poses[..., :3, 3], pose.quaternion_from_rotation(poses[..., :3, :3])], -1)
    bodies = [
        {**packed_mesh(body.mesh), "frame": frames.index(body.moves_with), "colour": painted(body, number).colour}
        for number, body in enumerate(run.cell.bodies)
    ]
    corners = np.concatenate(
        [pose.transform_points(poses[0, frames.index(body.moves_with)], body.mesh.bounds) for body in run.cell.bodies]
    )
    low, high = corners.min(0), corners.max(0)
    reach = 1e-3 * run.setup.sensor.range.far_mm - 1e-3 * laser.source_z_mm
    return {
        "name": run.name,
        "start": motion.start,
        "step": length / (samples - 1),
        "samples": samples,
        "frames": frames,
        "poses": packed(flat, "<f4"),
        "exposures": packed(motion.exposures, "<f4"),
        "bodies": bodies,
        "middle": ((low + high) / 2).tolist(),
        "radius": float(np.linalg.norm(high - low)) / 2,
        "floor": float(low[2]),
        "laser": [1e-3 * laser.source_z_mm, reach, reach * float(np.tan(np.radians(laser.fan_half_angle_deg)))],
        "cloud": _cloud(run, colour, threads),
    }


def _cloud(run: RecordedRun, colour: ColourBy, threads: int) -> dict[str, Any]:
    if run.cloud is None:
        shown = ColouredCloud(
            *(np.zeros((0, 3)),) * 2, np.zeros(0), np.zeros((0, 3)), 0, 1.0, np.zeros((0, 3)), (0, 0), ""
        )
    else:
        shown = coloured_by(run.cloud, run.cloud_points, run.part, colour, threads)
    return {
        **quantised(shown.points_in_part, "points"),
        "colours": packed(np.rint(255 * np.sqrt(shown.colours)), "u1"),
        "time": packed(shown.time, "<f4"),
        "total": shown.total,
        "spacing": shown.spacing,
        "scale": np.rint(shown.scale[::8]).astype(int).tolist(),
        "limits": list(shown.limits),
        "title": shown.title,
    }
