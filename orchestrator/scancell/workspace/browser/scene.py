"""The cell in browsers: bodies, frames, the sensor's field of view, and a cloud that grows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell
from scancell.workspace.pictures import painted

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_AXES = 0.08  # m, of frames
_LASER, _RANGE = (255, 40, 40), (60, 130, 220)


class CellScene:
    """Shows a cell on a server; all its browsers see the same.

    Poses are sent for what moved alone.

    Parameters
    ----------
    server
        Of viser.
    cell
        Bodies and frames.
    sensor
        Its field of view.
    """

    def __init__(self, server: viser.ViserServer, cell: NominalCell, sensor: SensorDescription) -> None:
        self._scene, self._bodies = server.scene, cell.bodies
        self._scene.set_up_direction("+z")
        frames = cell.frame_poses(cell.home, 0.0)
        self._nodes: dict[str, Any] = {
            name: self._scene.add_frame(
                f"/frames/{name}", axes_length=_AXES, axes_radius=_AXES / 30, show_axes=False, visible=True
            )
            for name in frames
        }
        self._known: dict[str, Array] = {}
        for number, body in enumerate(cell.bodies):
            colour = tuple(round(255 * share) for share in painted(body, number).colour)
            self._scene.add_mesh_simple(
                f"/frames/{body.moves_with}/{body.name}",
                np.asarray(body.mesh.vertices, np.float32),
                np.asarray(body.mesh.faces, np.uint32),
                color=colour,
                flat_shading=True,
                side="double",
            )
        self._field = self._scene.add_line_segments(
            "/frames/sensor/field_of_view", _outline(sensor), _RANGE, thickness=0.001
        )
        self._sheet = self._scene.add_mesh_simple(
            "/frames/sensor/laser", *_fan(sensor), color=_LASER, opacity=0.25, side="double", cast_shadow=False
        )
        self._clouds: list[Any] = []
        self.move({name: np.asarray(world) for name, world in frames.items()})

    def move(self, frames: Mapping[str, Array]) -> None:
        """Put frames at poses ``world_from_frame`` (4, 4)."""
        for name, world in frames.items():
            node = self._nodes.get(name)
            if node is None or np.array_equal(self._known.get(name, 0.0), world):
                continue
            self._known[name] = world
            node.position = world[:3, 3]
            node.wxyz = pose.quaternion_from_rotation(world[:3, :3])

    def show(self, state: Any) -> None:
        """Put all bodies where they are."""
        self.move({body.moves_with: state.world_from_body[body.name] for body in self._bodies})

    def position(self, frame: str) -> Array:
        """Where a frame is shown (3,), m."""
        return np.asarray(self._nodes[frame].position, float)

    def show_frames(self, shown: bool) -> None:
        """Show the axes of all frames, or none."""
        for node in self._nodes.values():
            node.show_axes = shown

    def show_field(self, shown: bool, laser: bool = True) -> None:
        """Show the field of view and, if it is on, the laser's sheet."""
        self._field.visible = shown
        self._sheet.visible = shown and laser

    def add_points(self, points_in_part: Array, colours: Image, size: float) -> None:
        """Add points (n, 3), m, of colours (n, 3) and a size, m, to the cloud: they are sent once."""
        self._clouds.append(
            self._scene.add_point_cloud(
                f"/frames/part/cloud/{len(self._clouds)}",
                np.asarray(points_in_part, np.float32),
                colours,
                point_size=size,
                point_shape="circle",
                precision="float32",
            )
        )

    def show_chunks(self, count: int) -> None:
        """Show the first `count` lots of points that were added."""
        for number, cloud in enumerate(self._clouds):
            if cloud.visible != (number < count):
                cloud.visible = number < count


def _corners(sensor: SensorDescription) -> Array:
    """Corners (4, 3) of the field of view in the sensor frame, m: near, near, far, far."""
    slope = np.tan(np.radians(sensor.laser.fan_half_angle_deg))
    z = 1e-3 * np.array([sensor.range.near_mm, sensor.range.near_mm, sensor.range.far_mm, sensor.range.far_mm])
    y = slope * (z - 1e-3 * sensor.laser.source_z_mm) * np.array([-1, 1, 1, -1])
    return np.stack([np.zeros(4), y, z], 1)


def _outline(sensor: SensorDescription) -> NDArray[np.float32]:
    corners = _corners(sensor)
    return np.asarray(np.stack([corners, np.roll(corners, -1, 0)], 1), np.float32)


def _fan(sensor: SensorDescription) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    source = np.array([[0.0, 0.0, 1e-3 * sensor.laser.source_z_mm]])
    corners = np.concatenate([source, _corners(sensor)[2:]])
    return np.asarray(corners, np.float32), np.array([[0, 1, 2]], np.uint32)
