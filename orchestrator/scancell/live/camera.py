"""Camera images and profiles of a live cell on demand."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as NotDone
from dataclasses import dataclass, field, replace
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import checked_arguments, checked_value
from scancell.arrays import Array
from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.config.files import Assignments, assignments
from scancell.config.loading import require_sensor_words, sensor_words
from scancell.errors import DescriptionError, ScancellError
from scancell.geometry import pose
from scancell.live.cell import LiveCell
from scancell.scanning.pipeline import measured_motion
from scancell.scanning.scan import ScanData
from scancell.scanning.sense import ExposureImages
from scancell.scanning.session import ScanSession, measure_profile
from scancell.scanning.world import ExposureControl, World
from scancell.values import Closing

T = TypeVar("T", bound=np.generic)

_PATIENCE = 0.1  # s, period at which a waiting feed checks whether it was closed
_REPLAY_PERIOD = 0.02  # s, at which a feed that replays checks whether there is another exposure


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """Image and profile of a sensor at one instant; arrays are read-only.

    Attributes
    ----------
    number
        Number of frames so far, including this one.
    time
        Simulated, s.
    engine, as_built
        Engine, and the perturbations of the sensor in force.
    images
        (cameras, height, width) of 8 bits; None with the geometric engine, which makes none.
    stripes
        Image positions (k, 2) of the points of each camera, column and row, px.
    points_in_sensor, points_in_base
        (n, 3) the profile by the nominal sensor, and by measured joints and nominal geometry, m.
    intensity, camera
        (n,) of the points, digital numbers; index of the camera.
    error
        Reason why there is no frame; empty if there is one.
    is_replayed
        Whether it shows an exposure of a recorded scan, in place of the running cell.
    sensor
        Number of the sensor, from 1: that of the tool.
    world_from_base
        Pose (4, 4) of the base of the arm by the measured positions of what carries it.
    """

    number: int
    time: float
    engine: Engine
    as_built: tuple[str, ...]
    images: NDArray[np.uint8] | None
    stripes: tuple[Array, ...]
    points_in_sensor: Array
    points_in_base: Array
    intensity: NDArray[np.floating]
    camera: NDArray[np.int32]
    error: str = ""
    is_replayed: bool = False
    sensor: int = 1
    world_from_base: Array = field(default_factory=lambda: np.eye(4))

    @property
    def points_in_world(self) -> Array:
        """The points (m, 3) in the world, m."""
        return pose.transform_points(self.world_from_base, self.points_in_base)


class CameraFeed(Closing):
    """Renders frames of a sensor of a live cell on demand, in a thread of its own.

    The thread that owns the cell only reads its poses between two cycles. A new frame is rendered as soon as the last
    one is made and these or the settings have changed, so that image noise does not change at rest.

    Parameters
    ----------
    live, session
        A live cell that runs, and its session.
    engine
        ``ray-traced`` makes images, ``geometric`` points alone.
    on_frame
        Receives each frame, in the thread of the feed.

    Examples
    --------
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl", guarded=True) as session:
    ...     session.move_tool(scancell.location(0.45, 0.0, 0.23, rx=np.pi))
    ...     live = scancell.LiveCell(session)
    ...     with scancell.CameraFeed(live, session, "geometric") as feed:
    ...         feed.wanted = True
    ...         live.run(lambda: feed.frame is not None, realtime=False)
    >>> len(feed.frame.points_in_base) > 100
    True
    """

    @checked_arguments
    def __init__(
        self,
        live: LiveCell,
        session: ScanSession,
        engine: Engine = "ray-traced",
        on_frame: Callable[[CameraFrame], object] = lambda _: None,
    ) -> None:
        self._live, self._world, self._threads = live, session.world, session.pipeline.threads
        self._on_frame = on_frame
        self._setting = _Setting.of(engine, session.world)
        self._replayed: tuple[_Setting, ScanData, int] | None = None
        self._frame: CameraFrame | None = None
        self._wanted, self._closed = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="cameras", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a thread that still renders while the interpreter ends aborts the program

    @property
    def frame(self) -> CameraFrame | None:
        """The last frame; None before the first."""
        return self._frame

    @property
    def wanted(self) -> bool:
        """Whether frames are rendered; initially False."""
        return self._wanted.is_set()

    @wanted.setter
    def wanted(self, value: bool) -> None:
        if value:
            self._wanted.set()
        else:
            self._wanted.clear()

    @property
    def engine(self) -> Engine:
        """Engine of the rendering; may be changed at any time."""
        return self._setting.engine

    @engine.setter
    def engine(self, value: Engine) -> None:
        engine = checked_value("engine", value, Engine)
        self._setting = _Setting.of(engine, self._setting.world)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors of the cell, the main one first."""
        return self._world.setup.sensor_names

    @property
    def sensor(self) -> str:
        """Name of the sensor of the frames, at first the main one; may be changed at any time."""
        return self._setting.world.name

    @sensor.setter
    def sensor(self, value: str) -> None:
        if value not in self.sensors:
            raise DescriptionError(key="sensor", value=value, expected=", ".join(self.sensors))
        world, number = self._setting.world, self.sensors.index(value) + 1
        if number == world.number:
            return
        self._setting = _Setting.of(self.engine, replace(self._world, as_built=world.as_built).sensors[number - 1])
        replayed = self._replayed
        if replayed is not None:
            self.replay(*replayed[1:])

    @property
    def as_built(self) -> tuple[str, ...]:
        """Perturbations of the sensors in force, as ``key=value`` words."""
        return tuple(sensor_words(self._setting.world.as_built))

    def perturb(self, as_built: Assignments) -> None:
        """Render with other true sensors from now on; the nominal ones still interpret the images.

        Parameters
        ----------
        as_built
            All perturbations of the sensors, ``{"sensor.laser.turn_y_deg": 0.1}``; they replace the present ones.

        Raises
        ------
        DescriptionError
            If a perturbation is unknown, out of bounds or not one of the sensor; the present ones stay in force.
        SensorError
            If the sensor library refuses it.
        """
        words = tuple(assignments(as_built))
        require_sensor_words(words, "the cameras show the cell as it is")
        worlds = replace(self._world, as_built=words).sensors
        for world in worlds:
            _ = world.sensor_true, world.delays  # a wrong one leaves the present one in force
        self._setting = _Setting.of(self.engine, worlds[self._setting.world.number - 1])

    def replay(self, scan: ScanData, row: int) -> None:
        """Render an exposure of a recorded scan of this cell, with its engine and sensor, until another or `resume`.

        The images are those of the scan, noise included. With automatic exposure, the exposure time is that of
        consecutive profiles, as they are replayed.

        Parameters
        ----------
        row
            Index in the recording, from 0.
        """
        setting = None if self._replayed is None else self._replayed[0]
        world = scan.world.sensors[self._setting.world.number - 1]
        if setting is None or setting.world is not world or setting.engine != scan.engine:
            setting = _Setting.of(scan.engine, world)
        self._replayed = setting, scan, row

    def resume(self) -> None:
        """Render the running cell again."""
        self._replayed = None

    def close(self) -> None:
        """End the thread."""
        atexit.unregister(self.close)
        self._closed.set()
        self._wanted.set()
        self._thread.join()

    # In the thread of the feed

    def _run(self) -> None:
        shown: tuple[bytes, _Setting, float | None] | None = None
        request: Future[Recording] | None = None
        number = 0
        while not self._closed.is_set():
            if not self._wanted.wait(_PATIENCE):
                request = None  # its poses would be those of the beginning of the pause
                continue
            if (replayed := self._replayed) is not None:
                request = None
                setting, scan, row = replayed
                recording = scan.recording[row : row + 1]
            else:
                live = self._look(request or self._ask())
                if live is None or not self._wanted.is_set():
                    request = None
                    continue
                # Asked now, the next poses are there when this frame is made: rendering does not wait for a cycle.
                request = self._ask()
                setting, recording = self._setting, live
            key = (_poses(recording), setting, setting.control.first)
            if key != shown:
                number += 1
                frame = _made(number, recording, setting, self._threads)
                self._frame, shown = replace(frame, is_replayed=replayed is not None), key
                self._on_frame(self._frame)
            elif replayed is not None:
                self._closed.wait(_REPLAY_PERIOD)
        if request is not None:
            request.cancel()

    def _ask(self) -> Future[Recording]:
        return self._live.between_cycles(lambda session: session.snapshot(session.exposure))

    def _look(self, request: Future[Recording]) -> Recording | None:
        """The poses of the cell between two cycles; None if it does not run, or the feed ends."""
        while not self._closed.is_set():
            try:
                return request.result(_PATIENCE)
            except NotDone:
                continue
            except (CancelledError, ScancellError):  # the cell was closed
                self._closed.wait(_PATIENCE)
                break
        request.cancel()
        return None


@dataclass(frozen=True, eq=False)
class _Setting:
    engine: Engine
    world: World
    control: ExposureControl

    @classmethod
    def of(cls, engine: Engine, world: World) -> Self:
        """With a new choice of exposure times."""
        return cls(engine, world, world.control())


def _poses(recording: Recording) -> bytes:
    """Everything that the images depend on, except their noise."""
    moving = [name for name in recording.columns if name.startswith("trigger.truth.")]
    return np.concatenate([recording.columns[name] for name in moving]).tobytes()


def _made(number: int, recording: Recording, setting: _Setting, threads: int) -> CameraFrame:
    as_built = tuple(sensor_words(setting.world.as_built))
    try:
        found = measure_profile(setting.world, recording, setting.engine, threads, setting.control)
    except ScancellError as error:
        nothing = np.zeros((0, 3))
        return CameraFrame(
            number, float(recording.measured.time[0]), setting.engine, as_built, None, (), nothing, nothing,
            np.zeros(0), np.zeros(0, np.int32), str(error), sensor=setting.world.number,
        )  # fmt: skip
    profile = found.profile
    stripe = np.column_stack([profile.column, found.rows])
    return CameraFrame(
        number=number,
        time=float(recording.measured.time[0]),
        engine=setting.engine,
        as_built=as_built,
        images=None if found.images is None else _for_display(found.images),
        stripes=tuple(
            _read_only(stripe[profile.camera == camera]) for camera in range(len(setting.world.sensor.cameras))
        ),
        points_in_sensor=_read_only(profile.points_in_sensor),
        points_in_base=_read_only(found.points_in_base),
        intensity=_read_only(profile.intensity),
        camera=_read_only(profile.camera),
        sensor=setting.world.number,
        world_from_base=_base_of(setting.world, recording),
    )


def _base_of(world: World, recording: Recording) -> Array:
    """Pose (4, 4) of the base of the arm by the measured positions of what carries it."""
    return world.estimated.world_from("base", measured_motion(world.estimated, recording).axes[0])


def _for_display(images: ExposureImages) -> NDArray[np.uint8]:
    """The upper 8 bits."""
    shown = np.empty(images.images.shape, np.uint8)
    np.right_shift(images.images, max(0, images.bit_depth - 8), out=shown, casting="unsafe")
    shown.setflags(write=False)
    return shown


def _read_only(values: NDArray[T]) -> NDArray[T]:
    copied = values.copy()
    copied.setflags(write=False)
    return copied
