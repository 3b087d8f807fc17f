"""The cell in browsers: moving bodies, fields of view and readings of sensors, and a growing cloud."""

from __future__ import annotations

from collections.abc import Mapping
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.bodies import BodyNodes
from scancell.browser.scene.cloud import GrowingCloud
from scancell.browser.scene.devices import BeltMarks, DeviceView
from scancell.browser.scene.ghost import FORBIDDEN, PREVIEW, Ghost
from scancell.browser.scene.options import SceneOptions
from scancell.browser.scene.pairs import PairView
from scancell.browser.scene.sensor_view import SensorView
from scancell.browser.scene.surfaces import drawn_mesh
from scancell.browser.scene.trace import Trace
from scancell.browser.scene.viewpoints import ViewName, Viewpoint, placed, viewpoint
from scancell.cell.controller import Mode
from scancell.cell.sensing import collision_meshes
from scancell.config.cell import CellDescription
from scancell.config.sensor import SensorDescription
from scancell.live.state import LiveState
from scancell.nominal.cell import NominalCell
from scancell.views.shading import SUN

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_JOGS = (Mode.JOINT_JOG, Mode.CARTESIAN_JOG)
_ASPECT = 0.78  # of the first picture: what panels leave of a window of 1280 x 720 px
_HALL, _SUN = 0.38, 1.5  # intensities
_GRID = 0.1  # m between lines on the floor


class CellScene:
    """Shows a cell on a server; all its browsers see the same.

    Only changes are sent. All methods are thread-safe.

    Parameters
    ----------
    server
        Of viser.
    cell
        Bodies and frames, including obstacles that are unknown to planning.
    sensor
        Its measuring range and laser.
    description
        Of the devices, and how meshes are simplified for collisions.

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
        _light(scene)
        meshes = collision_meshes(description, cell)
        drawn = {body.name: drawn_mesh(body) for body in cell.bodies}
        self._bodies = BodyNodes(scene, cell, drawn, meshes)
        self._sensor_view = SensorView(scene, sensor)
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
        frames = {name: np.asarray(world) for name, world in cell.frame_poses(cell.home).items()}
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
            self._sensor_view.show_laser(laser)
            self._pairs.clear()
            self._show_ghost()
        self._server.flush()

    def show_preview(self, axes: Array | None, forbidden: bool = False) -> None:
        """Show a further ghost at joints and a table angle (axes,), rad, red where that is forbidden; or none.

        Its meshes are sent when it is shown first.
        """
        with self._lock, self._server.atomic():
            if axes is None:
                self._preview_from_body = None
            else:
                poses = self._cell.body_poses(axes)
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
            return viewpoint(view, self._cell.bodies, self._bodies.poses, aspect)

    @property
    def ghosts(self) -> tuple[str, ...]:
        """Names of the bodies whose ghosts are shown at the target of the motion."""
        return self._ghost.shown

    @property
    def previews(self) -> tuple[str, ...]:
        """Names of the bodies whose further ghosts are shown."""
        return () if self._preview is None else self._preview.shown

    def belt_pitch(self, number: int) -> float:
        """Distance between the marks of a belt, numbered from 1, m."""
        return self._belts[number - 1].pitch

    def show_laser(self, on: bool) -> None:
        """Switch the laser's sheet on or off; it is on at first, and seen with the field of view."""
        with self._lock:
            self._sensor_view.show_laser(on)

    def show_stripe(self, points: Array | None) -> None:
        """Draw the stripe through world points (n, 3), m, in their order along the line, or none."""
        with self._lock:
            self._sensor_view.show_stripe(points)

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
            nominal = self._cell.frame_poses([*state.joints, state.table_angle])
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
            self._sensor_view.show(options.field_of_view)
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


def _light(scene: viser.SceneApi) -> None:
    """Light of a bright hall, and a sun that casts shadows."""
    scene.configure_default_lights(False)
    scene.configure_environment_map("studio", environment_intensity=_HALL)
    scene.add_light_directional("/sun", intensity=_SUN, cast_shadow=True, position=tuple(5 * SUN))
