"""The cell in browsers: its viewpoints, moving bodies, readings of sensors, switches, and the cloud of a scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array, Image
from scancell.browser.scene.bodies import FORBIDDEN, PREVIEW, BodyNodes, Ghost, PairView, Rgb, drawn_mesh
from scancell.browser.scene.cloud import GrowingCloud, Trace
from scancell.browser.scene.devices import BeltMarks, DeviceView, SensorView
from scancell.cell.driver import Mode
from scancell.cell.fmu_file import collision_meshes
from scancell.config.cell import CellDescription, sensor_frame
from scancell.config.sensor import SensorDescription
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.live.scan import LiveChunk
from scancell.live.state import LiveState
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.output.deviation_report import colour_limit_um
from scancell.views.camera import framing
from scancell.views.renderer import SUN, colour_scale

if TYPE_CHECKING:
    import viser


ViewName = Literal["cell", "part", "sensor"]
VIEW_NAMES: tuple[ViewName, ...] = get_args(ViewName)

_DIRECTIONS = {"cell": (-38.0, 24.0), "part": (-52.0, 38.0), "sensor": (-52.0, 20.0)}  # azimuth, elevation, deg
_HEIGHT_PX = 800
_SAMPLES = 200  # vertices of a body


_JOGS = (Mode.JOINT_JOG, Mode.CARTESIAN_JOG)
_ASPECT = 0.78  # of the first picture: what panels leave of a window of 1280 x 720 px
_HALL, _SUN = 0.38, 1.5  # intensities
_GRID = 0.1  # m between lines on the floor

LiveColour = Literal["deviation", "intensity", "quality", "camera"]
LIVE_COLOURS: tuple[LiveColour, ...] = get_args(LiveColour)

_CAMERAS = np.array([(220, 120, 40), (40, 120, 210), (60, 160, 80), (160, 70, 170)], np.uint8)
_INTERVALS = 48  # of the histogram
_SIZE = 1.2  # of a point, in mean distances between points
MOST_SHOWN = 500_000  # points


@dataclass(frozen=True)
class Viewpoint:
    """Camera of a browser: `position` and `look_at` (3,), world, m; vertical field of view `fov`, rad."""

    position: Array
    look_at: Array
    fov: float


def viewpoint(view: ViewName, cell: NominalCell, frames: Mapping[str, Array], aspect: float) -> Viewpoint:
    """The nearest viewpoint that has the bodies of a view in a picture with a rim around them.

    Parameters
    ----------
    cell, frames
        The cell, and poses ``world_from_frame`` (4, 4) by the names of its frames. The view ``part`` is of the part and
        what carries it.
    aspect
        Width of the picture over its height.
    """
    carriers = {"part": ("part", cell.support), "sensor": ("part", "sensor")}.get(view)
    points = placed(
        [body for body in cell.bodies if not carriers or body.moves_with in carriers] or cell.bodies, frames
    )
    camera = framing(points, *_DIRECTIONS[view], (round(aspect * _HEIGHT_PX), _HEIGHT_PX))
    middle = (points.min(0) + points.max(0)) / 2
    forward = camera.world_from_camera[:3, 2]
    look_at = camera.centre + np.linalg.norm(middle - camera.centre) * forward
    return Viewpoint(camera.centre, look_at, float(2 * np.arctan(_HEIGHT_PX / 2 / camera.focal_px)))


def placed(bodies: Iterable[Body], frames: Mapping[str, Array]) -> Array:
    """World points (n, 3) of some vertices of bodies, m."""
    return np.concatenate(
        [
            pose.transform_points(
                frames[body.moves_with], body.mesh.vertices[:: max(1, len(body.mesh.vertices) // _SAMPLES)]
            )
            for body in bodies
        ]
    )


class SceneOptions:
    """Switches of a scene; each may be set at any time from any thread.

    Attributes
    ----------
    frames
        Axes of all frames, with their names.
    collision_meshes
        The meshes of which the cell computes collisions and distances, as wire frames.
    field_of_view
        Outline of the sensor's measuring range, and the laser's sheet while the laser is on.
    ghost
        The arm and the table where the motion in force leads.
    trace
        Line along which the sensor's origin went.
    distances
        Line between the nearest bodies, with its length.
    devices
        Presence sensors, distance sensors and light curtains.
    """

    frames: bool = False
    collision_meshes: bool = False
    field_of_view: bool = True
    ghost: bool = True
    trace: bool = True
    distances: bool = True
    devices: bool = True
    _changed: Callable[[], None]

    def __init__(self, changed: Callable[[], None]) -> None:
        object.__setattr__(self, "_changed", changed)

    def __setattr__(self, name: str, value: Any) -> None:
        if not isinstance(getattr(SceneOptions, name, None), bool):
            raise AttributeError(f"a scene has no option {name}")
        object.__setattr__(self, name, bool(value))
        self._changed()


class CellScene:
    """Shows a cell on a server; all its browsers see the same.

    Only changes are sent. All methods are thread-safe.

    Parameters
    ----------
    server
        Server of viser.
    cell
        Bodies and frames, including obstacles that are unknown to planning.
    sensor
        Its measuring range and laser.
    description
        Description of the devices, and how meshes are simplified for collisions.

    Attributes
    ----------
    options
        What is shown.

    Raises
    ------
    MeshError
        If a mesh cannot be simplified.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        cell: NominalCell,
        sensor: SensorDescription,
        description: CellDescription,
    ) -> None:
        self._server, self._cell, self._lock = server, cell, RLock()
        self._state: LiveState | None = None
        scene = server.scene
        scene.set_up_direction("+z")
        # Light of a bright hall, and a sun that casts shadows.
        scene.configure_default_lights(False)
        scene.configure_environment_map("studio", environment_intensity=_HALL)
        scene.add_light_directional("/sun", intensity=_SUN, cast_shadow=True, position=tuple(5 * SUN))
        meshes = collision_meshes(description, cell)
        drawn = {body.name: drawn_mesh(body) for body in cell.bodies}
        self._bodies = BodyNodes(scene, cell, drawn, meshes)
        self._sensor_views = [
            SensorView(scene, sensor),
            *(
                SensorView(scene, further.sensor or sensor, sensor_frame(number))
                for number, further in enumerate(description.further_sensor, 2)
            ),
        ]
        self._devices = DeviceView(scene, description)
        self._belts = [BeltMarks(scene, belt) for belt in description.conveyor]
        self._drawn, self._ghost = drawn, Ghost(scene, cell, drawn)
        self._preview: Ghost | None = None
        self._preview_from_body: Mapping[str, Array] | None = None
        self._pairs = PairView(scene, self._bodies, meshes)
        self._trace, self._cloud = Trace(scene), GrowingCloud(scene)
        carried = {body.moves_with: body.name for body in reversed(cell.bodies)}
        self._carried = {name: carried.get(name) for name in self._bodies.names if name != "world"}
        self.options = SceneOptions(self._apply_options)
        frames = {name: np.asarray(world) for name, world in cell.frame_poses(cell.start).items()}
        self._add_floor(frames)
        self._apply_options()
        self.move(frames)
        camera, first = server.initial_camera, self.viewpoint("cell", _ASPECT)
        camera.position, camera.look_at, camera.fov = tuple(first.position), tuple(first.look_at), first.fov

    def show(self, state: LiveState) -> None:
        """Show the true state of a running cell."""
        with self._lock, self._server.atomic():
            self._state = state
            frames = self._frames(state)
            self._bodies.move(frames)
            self._trace.add(frames["sensor"][:3, 3])
            self._pairs.show(state)
            self._devices.read(state.presence, state.distance)
            for marks, (_, travel) in zip(self._belts, state.conveyors, strict=True):
                marks.show(travel)
            self._show_ghost()
        self._server.flush()  # viser waits for more otherwise, and sends 30 times a second

    def move(self, frames: Mapping[str, Array]) -> None:
        """Put all frames that bodies move with at poses ``world_from_frame`` (4, 4)."""
        with self._lock, self._server.atomic():
            self._bodies.move(frames)

    def replay(self, frames: Mapping[str, Array], laser: bool) -> None:
        """Show recorded poses and whether the laser was on, without targets and distances of the running cell.

        The next `show` returns to the running cell.
        """
        with self._lock, self._server.atomic():
            self._state = None
            self._bodies.move(frames)
            self._show_laser(laser)
            self._pairs.clear()
            self._show_ghost()
        self._server.flush()

    def on_part_click(self, act: Callable[[Array, Array], object]) -> None:
        """Call `act` with the ray of each click on the part: origin and direction (3,) in the frame of the part, m."""

        def clicked(event: Any) -> None:
            part_from_world = pose.inverse(self._bodies.poses["part"])
            origin = pose.transform_points(part_from_world, np.array([event.ray_origin]))[0]
            act(origin, part_from_world[:3, :3] @ np.array(event.ray_direction))

        with self._lock:
            self._bodies.on_part_click(clicked)

    def paint_faces(self, faces: Mapping[Rgb, Mesh]) -> None:
        """Paint faces of the part, meshes in its frame by colour, m; others have the colour of the part."""
        with self._lock, self._server.atomic():
            self._bodies.paint_faces(faces)
        self._server.flush()

    def show_preview(self, axes: Array | None, forbidden: bool = False) -> None:
        """Show a further ghost at positions (axes,), red where they are forbidden; or none.

        Axes beyond the table that are not stated are where they start.

        Its meshes are sent when it is shown first.
        """
        with self._lock, self._server.atomic():
            if axes is None:
                self._preview_from_body = None
            else:
                poses = self._cell.body_poses(self._cell.with_further_axes(axes))
                named = zip(self._cell.bodies, poses, strict=True)
                self._preview_from_body = {body.name: np.asarray(at) for body, at in named}
                if self._preview is None:
                    self._preview = Ghost(self._server.scene, self._cell, self._drawn, "/preview", PREVIEW)
                self._preview.paint(FORBIDDEN if forbidden else PREVIEW)
            self._show_ghost()

    def position(self, frame: str) -> Array:
        """Where a frame is shown (3,), m."""
        return self._bodies.position(frame)

    def viewpoint(self, view: ViewName, aspect: float) -> Viewpoint:
        """Viewpoint that has the bodies of a view in a picture of a width over height, see `viewpoint`."""
        with self._lock:
            return viewpoint(view, self._cell, self._bodies.poses, aspect)

    def _show_laser(self, on: bool) -> None:
        for view in self._sensor_views:
            view.show_laser(on)

    def show_laser(self, on: bool) -> None:
        """Switch the laser's sheet on or off; it is on at first, and seen with the field of view."""
        with self._lock:
            self._show_laser(on)

    def show_stripe(self, points: Array | None) -> None:
        """Draw the stripe through world points (n, 3), m, in their order along the line, or none."""
        with self._lock:
            self._sensor_views[0].show_stripe(points)

    def add_points(self, points_in_part: Array, colours: Image, size: float) -> int:
        """Add a chunk of points (n, 3), m, of colours (n, 3) and a size, m, to the cloud, and send it once.

        A browser draws each chunk by itself, so few large ones are better than many. Returns the number of points that
        there was room for: `cloud.MOST_POINTS` in all.
        """
        with self._lock:
            return self._cloud.add(points_in_part, colours, size)

    def show_chunks(self, count: int) -> None:
        """Show the first `count` chunks of points that were added, and no others."""
        with self._lock, self._server.atomic():
            self._cloud.show(count)

    def clear_points(self) -> None:
        """Remove the cloud."""
        with self._lock:
            self._cloud.clear()

    def clear_trace(self) -> None:
        """Begin the trace of the sensor anew."""
        with self._lock:
            self._trace.clear()

    def _frames(self, state: LiveState) -> Mapping[str, Array]:
        """Poses (4, 4) of all frames: true where a body shows them, else nominal at the measured angles."""
        frames = {name: state.world_from_body[body] for name, body in self._carried.items() if body is not None}
        if len(frames) < len(self._carried):
            nominal = self._cell.frame_poses(state.axes)
            frames = {name: np.asarray(world) for name, world in nominal.items()} | frames
        return {**frames, "world": np.eye(4)}

    def _show_ghost(self) -> None:
        # At rest, in a jog and after a stop, the destination is that of a motion which has ended.
        state = self._state
        moves = state is not None and state.controller in ("moving", "braking") and state.mode not in _JOGS
        if state is None or not moves or not self.options.ghost:
            self._ghost.hide()
        else:
            self._ghost.show(state.world_from_body_at_destination, state.world_from_body)
        if self._preview is None:
            return
        if self._state is None or self._preview_from_body is None:
            self._preview.hide()
        else:
            self._preview.show(self._preview_from_body, self._state.world_from_body)

    def _apply_options(self) -> None:
        with self._lock, self._server.atomic():
            options = self.options
            self._bodies.show_frames(options.frames)
            self._bodies.show_collision_meshes(options.collision_meshes)
            for view in self._sensor_views:
                view.show(options.field_of_view)
            self._trace.show(options.trace)
            self._pairs.show_distances(options.distances)
            self._devices.show(options.devices)
            self._show_ghost()

    def _add_floor(self, frames: Mapping[str, Array]) -> None:
        points = placed(self._cell.bodies, frames)
        middle = (points.min(0) + points.max(0)) / 2
        self._server.scene.add_grid(
            "/floor",
            infinite_grid=True,
            cell_size=_GRID,
            section_size=5 * _GRID,
            cell_color=(200, 206, 213),
            section_color=(170, 178, 187),
            fade_distance=4.0,
            fade_from="origin",
            plane_color=(226, 230, 235),
            plane_opacity=1.0,
            shadow_opacity=0.25,
            position=(float(middle[0]), float(middle[1]), float(points[:, 2].min()) - 1e-3),
        )


@dataclass(frozen=True, eq=False)
class ColourBar:
    """Meaning of the colours of a cloud.

    Attributes
    ----------
    title
        Value that the colours show, and its unit.
    limits
        Values of the first and the last colour.
    colours
        (n, 3) from the first to the last, 0 to 255.
    counts
        (intervals,) number of points in equal intervals between the limits; values beyond are in the outer ones.
    """

    title: str
    limits: tuple[float, float]
    colours: NDArray[np.float64]
    counts: NDArray[np.int64]


class LiveCloud:
    """Adds chunks of a scan to a scene, where each is sent once; other colours or limits send them again.

    The limits of the colours are those of the first chunk until `limit` changes them. Where there are too many points,
    every second one is shown, then every fourth, and so on. Any thread may call.

    Parameters
    ----------
    most
        Points that are kept and shown at most.

    Attributes
    ----------
    step
        Every how many points one is shown.
    """

    def __init__(self, scene: CellScene, most: int = MOST_SHOWN) -> None:
        self._scene, self._most, self._lock = scene, most, RLock()
        self._until, self.step = np.inf, 1
        self._chunks: list[LiveChunk] = []
        self._colour: LiveColour = "deviation"
        self._limits: dict[LiveColour, tuple[float, float]] = {}
        self._counts = np.zeros(_INTERVALS, np.int64)
        self._size = 1e-3

    @property
    def colour(self) -> LiveColour:
        """Quantity that the colours show."""
        return self._colour

    @property
    def count(self) -> int:
        """Number of points that are shown."""
        return sum(len(chunk.time) for chunk in self._chunks)

    def clear(self) -> None:
        """Remove what is shown."""
        with self._lock:
            self._scene.clear_points()
            self._chunks, self._limits, self.step = [], {}, 1
            self._counts[:] = 0

    def add(self, chunk: LiveChunk, spacing: float) -> None:
        """Show more points; `spacing` is the mean distance between neighbours in the complete cloud, m."""
        with self._lock:
            if not self._chunks:
                self._limits, self._size = _limits(chunk), _SIZE * spacing
            self._chunks.append(chunk[:: self.step])
            self._show(self._chunks[-1])
            while self.count > self._most:
                self.step *= 2
                self._chunks = [one[::2] for one in self._chunks]
                self._show_again()

    def show_until(self, time: float) -> None:
        """Show only chunks that were complete at a time of the scan, s."""
        with self._lock:
            self._until = time
            self._show_complete()

    def colour_by(self, colour: LiveColour) -> None:
        """Show other colours."""
        with self._lock:
            self._colour = colour
            self._show_again()

    def limit(self, low: float | None = None, high: float | None = None) -> None:
        """Change the limits of the present colours; None: those of the first chunk.

        Raises
        ------
        DescriptionError
            If `low` is not less than `high`.
        """
        with self._lock:
            if not self._chunks or self._colour == "camera":
                return
            first = _limits(self._chunks[0])[self._colour]
            limits = first if low is None or high is None else (low, high)
            if not limits[0] < limits[1]:
                raise DescriptionError(key="limits", value=f"{limits[0]:g} to {limits[1]:g}", expected="first < second")
            self._limits[self._colour] = limits
            self._show_again()

    @property
    def bar(self) -> ColourBar | None:
        """Meaning of the colours; None without points, and where colours distinguish cameras."""
        # Without the lock: another thread holds it while it sends all points again.
        colour, limits = self._colour, self._limits.get(self._colour)
        if limits is None:
            return None
        unit = {"deviation": ", µm", "intensity": ", DN"}.get(colour, "")
        return ColourBar(f"{colour}{unit}", limits, self._scale(), self._counts.copy())

    def _show_again(self) -> None:
        self._scene.clear_points()
        self._counts[:] = 0
        for chunk in self._chunks:
            self._show(chunk)
        self._show_complete()

    def _show_complete(self) -> None:
        self._scene.show_chunks(sum(bool(chunk.time[-1] <= self._until) for chunk in self._chunks))

    def _show(self, chunk: LiveChunk) -> None:
        self._scene.add_points(chunk.points_in_part, self._colours(chunk), self._size)

    def _scale(self) -> NDArray[np.float64]:
        return colour_scale("deviation" if self._colour == "deviation" else "intensity")

    def _colours(self, chunk: LiveChunk) -> Image:
        """Colours (n, 3) of a chunk, whose values are counted."""
        if self._colour == "camera":
            return _CAMERAS[np.asarray(chunk.camera) % len(_CAMERAS)]
        scale = self._scale()
        low, high = self._limits[self._colour]
        values = 1e6 * chunk.deviation if self._colour == "deviation" else getattr(chunk, self._colour)
        share = np.nan_to_num(np.clip((np.asarray(values, float) - low) / (high - low), 0.0, 1.0))
        interval = np.minimum((share * _INTERVALS).astype(np.int64), _INTERVALS - 1)
        self._counts += np.bincount(interval, minlength=_INTERVALS)
        return np.asarray(scale[(share * (len(scale) - 1)).astype(np.int64)], np.uint8)


def _limits(chunk: LiveChunk) -> dict[LiveColour, tuple[float, float]]:
    deviation = colour_limit_um(float(np.quantile(np.abs(chunk.deviation), 0.95)))
    intensity = max(float(np.quantile(chunk.intensity, 0.99)), 1e-9)
    return {"deviation": (-deviation, deviation), "intensity": (0.0, intensity), "quality": (0.0, 1.0)}
