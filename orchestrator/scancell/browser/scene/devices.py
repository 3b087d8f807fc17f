"""Marks of conveyors, readings of presence and distance sensors and light curtains, range and laser of the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.cell import CellDescription
from scancell.config.description import si_value
from scancell.config.devices import (
    ConveyorDescription,
    DistanceSensorDescription,
    LightCurtainDescription,
    PresenceSensorDescription,
)
from scancell.config.sensor import SensorDescription
from scancell.geometry import pose
from scancell.nominal.parts import pose_matrix

if TYPE_CHECKING:
    import viser


FREE, DETECTED = (90, 140, 190), (30, 190, 80)  # of presence sensors
_RAY, _DISCARDED, _BEAM = (235, 60, 50), (150, 150, 150), (230, 60, 60)
_MARK, _PITCH, _THICK = (236, 190, 60), 0.06, 0.008  # of marks on belts: colour, distance and width, m
_ABOVE = 0.4e-3  # m of marks above the belt
_RESOLUTION = 0.05e-3  # m: smaller changes of a reading are not sent

_LASER, _RANGE, _STRIPE = (255, 40, 40), (60, 130, 220), (255, 20, 20)
_GAP = 5.0  # times the median distance of neighbours, beyond which the stripe is broken


class BeltMarks:
    """Chevrons on a belt, which point along its travel and move with it.

    Parameters
    ----------
    scene
        Scene of viser.
    belt
        Its description.
    """

    def __init__(self, scene: viser.SceneApi, belt: ConveyorDescription) -> None:
        length, width = si_value(belt, "length_mm"), si_value(belt, "width_mm")
        reach = min(0.3 * width, _PITCH)  # of a chevron along the belt
        run = max(length - reach - _THICK, 0.0)
        self._pitch = run / max(1, round(run / _PITCH)) or _PITCH
        starts = np.asarray(-length / 2 + self._pitch * np.arange(max(1, round(run / self._pitch))), float)
        vertices, faces = _chevrons(starts, width, reach)
        world_from_belt = pose_matrix(belt.pose)
        name = f"/belts/{belt.name}"
        scene.add_frame(name, show_axes=False, **_placed(world_from_belt))
        self._marks = scene.add_mesh_simple(f"{name}/marks", vertices, faces, color=_MARK, cast_shadow=False)

    def show(self, travel: float) -> None:
        """Move the marks by the travel of the belt (m), modulo their pitch: they all look the same."""
        self._marks.position = (travel % self._pitch, 0.0, 0.0)


class DeviceView:
    """Volumes of presence sensors, rays of distance sensors, and beams of light curtains.

    Parameters
    ----------
    scene
        Scene of viser; the frames that devices move with are nodes of it.
    cell
        Description of the devices.
    """

    def __init__(self, scene: viser.SceneApi, cell: CellDescription) -> None:
        self._presence = [_presence_volume(scene, sensor) for sensor in cell.presence_sensor]
        self._rays = [_Ray(scene, sensor) for sensor in cell.distance_sensor]
        curtains = [_curtain(scene, curtain) for curtain in cell.light_curtain]
        self._nodes = [*self._presence, *(ray.node for ray in self._rays), *curtains]

    def read(self, present: Sequence[bool], distances: Sequence[float | None]) -> None:
        """Show the readings of the sensors; distances in m, None where the measurement was discarded."""
        for volume, detected in zip(self._presence, present, strict=True):
            volume.color = DETECTED if detected else FREE
        for ray, reading in zip(self._rays, distances, strict=True):
            ray.read(reading)

    def show(self, shown: bool) -> None:
        """Show the devices, or none."""
        for node in self._nodes:
            node.visible = shown


class _Ray:
    """Ray of a distance sensor, as long as its reading, with a label; grey over its range without one."""

    def __init__(self, scene: viser.SceneApi, sensor: DistanceSensorDescription) -> None:
        self._farthest = si_value(sensor, "farthest_mm")
        name = f"{_frame(sensor.moves_with)}/distance/{sensor.name}"
        self.node = scene.add_frame(name, show_axes=False, **_placed(pose_matrix(sensor.pose)))
        self._line = scene.add_line_segments(
            f"{name}/ray", self._segment(self._farthest), _DISCARDED, thickness=2.0, thickness_units="screen"
        )
        self._spot = scene.add_icosphere(f"{name}/spot", 0.004, _RAY, subdivisions=2, cast_shadow=False, visible=False)
        self._label = scene.add_label(f"{name}/reading", f"{sensor.name}: -", font_screen_scale=0.8)
        self._name, self._reading = sensor.name, np.nan

    def read(self, reading: float | None) -> None:
        value = np.inf if reading is None else reading
        if value == self._reading or abs(value - self._reading) < _RESOLUTION:
            return
        self._reading = value
        length = self._farthest if reading is None else reading
        self._line.points = self._segment(length)
        self._line.colors = np.array(_DISCARDED if reading is None else _RAY, np.uint8)
        self._spot.visible, self._spot.position = reading is not None, (0.0, 0.0, length)
        self._label.text = f"{self._name}: " + ("-" if reading is None else f"{1e3 * reading:.1f} mm")

    @staticmethod
    def _segment(length: float) -> Array:
        return np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, length]]])


def _presence_volume(scene: viser.SceneApi, sensor: PresenceSensorDescription) -> Any:
    x, y, z = (si_value(sensor, f"{axis}_size_mm") for axis in "xyz")
    name = f"{_frame(sensor.moves_with)}/presence/{sensor.name}"
    placed = _placed(pose_matrix(sensor.pose))
    return scene.add_box(name, FREE, (x, y, z), opacity=0.4, cast_shadow=False, receive_shadow=False, **placed)


def _curtain(scene: viser.SceneApi, curtain: LightCurtainDescription) -> Any:
    height, spacing = si_value(curtain, "height_mm"), si_value(curtain, "beam_spacing_mm")
    width, x = si_value(curtain, "width_mm"), np.arange(0.0, height + 1e-9, spacing)
    beams = [((one, 0.0, 0.0), (one, 0.0, width)) for one in x.tolist()]
    posts = [((0.0, 0.0, z), (height, 0.0, z)) for z in (0.0, width)]
    ends = np.array([*beams, *posts])
    name = f"{_frame(curtain.moves_with)}/curtain/{curtain.name}"
    placed = _placed(pose_matrix(curtain.pose))
    return scene.add_line_segments(name, ends, _BEAM, thickness=1.0, thickness_units="screen", **placed)


def _frame(moves_with: str) -> str:
    """Node of a frame, which the FMU names otherwise where it is that of the scanned part."""
    return f"/frames/{'part' if moves_with == 'part[1]' else moves_with}"


def _placed(frame_from_node: Array) -> dict[str, Array]:
    return {"position": frame_from_node[:3, 3], "wxyz": pose.quaternion_from_rotation(frame_from_node[:3, :3])}


def _chevrons(starts: Array, width: float, reach: float) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices and faces of chevrons that begin at x = `starts`, across 70 % of a belt's width, m."""
    half = 0.35 * width
    outline = np.array([(0, -half), (_THICK, -half), (reach, 0), (reach + _THICK, 0), (0, half), (_THICK, half)])
    one = np.column_stack([outline, np.full(6, _ABOVE)])
    faces = np.array([(0, 1, 3), (0, 3, 2), (2, 3, 5), (2, 5, 4)])
    vertices = (one + starts[:, None, None] * np.array([1.0, 0.0, 0.0])).reshape(-1, 3)
    numbered = (faces + 6 * np.arange(len(starts))[:, None, None]).reshape(-1, 3)
    return np.asarray(vertices, np.float32), np.asarray(numbered, np.uint32)


class SensorView:
    """Trapezoid of the measuring range, sheet of the laser, and the stripe on what it meets.

    Parameters
    ----------
    scene
        Scene of viser; the frame of the sensor is a node of it.
    sensor
        Range and laser.
    frame
        Name of the frame of the sensor.
    """

    def __init__(self, scene: viser.SceneApi, sensor: SensorDescription, frame: str = "sensor") -> None:
        self._shown, self._laser = True, True
        corners = field_corners(sensor)
        outline = np.stack([corners, np.roll(corners, -1, 0)], 1)
        self._range = scene.add_line_segments(
            f"/frames/{frame}/field_of_view", outline, _RANGE, thickness=2.0, thickness_units="screen"
        )
        source = np.array([[0.0, 0.0, si_value(sensor.laser, "source_z_mm")]])
        self._sheet = scene.add_mesh_simple(
            f"/frames/{frame}/laser",
            np.asarray(np.concatenate([source, corners[2:]]), np.float32),
            np.array([[0, 1, 2]], np.uint32),
            color=_LASER,
            opacity=0.18,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._stripe = scene.add_line_segments(
            "/stripe" if frame == "sensor" else f"/stripe/{frame}",
            np.zeros((1, 2, 3)),
            _STRIPE,
            thickness=3.0,
            thickness_units="screen",
            visible=False,
        )

    def show(self, shown: bool) -> None:
        """Show the measuring range and, while it is on, the laser's sheet."""
        self._shown = shown
        self._range.visible, self._sheet.visible = shown, shown and self._laser

    def show_laser(self, on: bool) -> None:
        """Switch the laser on or off."""
        self._laser = on
        self._sheet.visible = self._shown and on

    def show_stripe(self, points: Array | None) -> None:
        """Draw the stripe through points (n, 3), world, m, in the order along the line; None or fewer than 2: none."""
        segments = np.zeros((0, 2, 3)) if points is None else stripe_segments(points)
        if len(segments):
            self._stripe.points = segments
        self._stripe.visible = len(segments) > 0


def stripe_segments(points: Array) -> Array:
    """Ends (k, 2, 3) of lines between neighbours of points (n, 3), except across gaps."""
    segments = np.stack([points[:-1], points[1:]], 1)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1)
    return segments if len(length) == 0 else segments[length <= _GAP * np.median(length)]


def field_corners(sensor: SensorDescription) -> Array:
    """Corners (4, 3) of the field of view in the sensor frame, m: near, near, far, far."""
    slope = np.tan(np.radians(sensor.laser.fan_half_angle_deg))
    z = 1e-3 * np.array([sensor.range.near_mm, sensor.range.near_mm, sensor.range.far_mm, sensor.range.far_mm])
    y = slope * (z - 1e-3 * sensor.laser.source_z_mm) * np.array([-1, 1, 1, -1])
    return np.stack([np.zeros(4), y, z], 1)
