"""Pictures and animations of a recorded run."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from os import cpu_count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.errors import DescriptionError
from scancell.nominal.cell import Body
from scancell.output.drawing import Sheet
from scancell.progress import NullProgress, Progress
from scancell.workspace.caption import captioned
from scancell.workspace.coloured_cloud import ColourBy, ColouredCloud, coloured_by
from scancell.workspace.laser import laser_sheet
from scancell.workspace.recorded_run import RecordedRun
from scancell.workspace.renderer import PaintedBody, Renderer
from scancell.workspace.shading import displayed
from scancell.workspace.video import video_writer
from scancell.workspace.views import CameraPath, View, camera_path

Image = NDArray[np.uint8]

_SECONDS = 10.0  # of an animation, unless its length or speed is given
_ARM, _JOINT = (0.90, 0.905, 0.91), (0.80, 0.815, 0.83)
_SENSOR, _GRIPPER = (0.23, 0.26, 0.31), (0.36, 0.40, 0.45)
_TABLE, _STAND, _PART = (0.56, 0.60, 0.645), (0.42, 0.45, 0.49), (0.86, 0.85, 0.82)
_OTHER = (0.80, 0.66, 0.40)


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
        laser = laser_sheet(run.setup.sensor, frames["sensor"]) if run.motion.laser_on(time, self._span) else None
        poses = np.stack([frames[body.moves_with] for body in run.cell.bodies])
        rendered = self._renderer.render(camera, poses, laser)
        if self._cloud is not None:
            self._cloud.draw(rendered, camera, frames["part"], time)
        return captioned(displayed(rendered.light), run.name, time, self._cloud)


def run_pictures(
    run: RecordedRun, view: View, size: tuple[int, int], colour: ColourBy, threads: int, span: float = 0.0
) -> RunPictures:
    """Prepare pictures of a run; see `animate`, and `RunPictures` for `span`."""
    path = camera_path(view, run, size)
    cloud = None if run.cloud is None else coloured_by(run.cloud, run.cloud_points, run.cell.part, colour, threads)
    standing = [body.mesh.bounds[0, 2] for body in run.cell.bodies if body.moves_with == "world"]
    middle = (run.cell.arm.world_from_base[:3, 3] + run.cell.world_from_table[:3, 3]) / 2
    bodies = [painted(body, number) for number, body in enumerate(run.cell.bodies)]
    return RunPictures(run, Renderer(bodies, float(min(standing, default=0.0)), middle), path, cloud, span)


def picture(
    run: RecordedRun,
    out: str | Path,
    *,
    time: float | None = None,
    view: View = "cell",
    size: tuple[int, int] = (1280, 720),
    colour: ColourBy = "deviation",
    threads: int = 0,
) -> float:
    """Write a picture of the cell as PNG, and return its time in the run, s: by default that of the last exposure.

    Raises
    ------
    ScancellError
        If `time` is not in the run, or the file cannot be written.
    """
    at = float(run.motion.times[-1]) if time is None else time
    if not run.motion.start <= at <= run.motion.duration:
        raise DescriptionError(key="time", value=at, expected=f"{run.motion.start:g} to {run.motion.duration:g} s")
    Sheet.of(run_pictures(run, view, size, colour, threads).at(at)).write(out)
    return at


def animate(
    run: RecordedRun,
    out: str | Path,
    *,
    view: View = "cell",
    size: tuple[int, int] = (1280, 720),
    fps: float = 25.0,
    seconds: float | None = None,
    speed: float | None = None,
    colour: ColourBy = "deviation",
    threads: int = 0,
    progress: Progress | None = None,
) -> int:
    """Write an animation of the whole run as WebM (VP9) or animated WebP, and return the number of its frames.

    Parameters
    ----------
    seconds, speed
        Length of the animation, s, or seconds of the run in one second of it; not both. 10 s by default.

    Raises
    ------
    ScancellError
        If an option is wrong, or the file cannot be written.
    """
    if seconds is not None and speed is not None:
        raise DescriptionError(f"`seconds` {seconds:g} and `speed` {speed:g}", expected="one of them")
    progress = NullProgress() if progress is None else progress
    start, length = run.motion.start, run.motion.duration - run.motion.start
    wanted = length / speed if speed is not None else _SECONDS if seconds is None else seconds
    count = max(1, round(wanted * fps))
    times = start + length * np.arange(count) / max(count - 1, 1)
    progress.stage("rendering", count, "frames")
    with video_writer(out, size, fps) as add:
        pictures = run_pictures(run, view, size, colour, threads, length / max(count - 1, 1))
        for frame in _in_order(pictures.at, times.tolist(), (np.arange(count) / count).tolist(), threads):
            add(frame)
            progress.advance(1)
    return count


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
    return PaintedBody(name, body.mesh, colour, lets_laser_pass=frame == "sensor")
