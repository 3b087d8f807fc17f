"""Frames and bodies of a cell as nodes of a scene: poses are sent for frames that moved."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.surfaces import DrawnMesh, Rgb, body_colour
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import NominalCell

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]

_AXES = 0.08  # m, of frames
_TRANSLUCENT = 0.45  # opacity of bodies, most of which hide their frames
_WIRE, _FAINT = (220, 90, 0), 0.35  # colour and opacity of wire frames
_STILL = 1e-6  # m and rad: smaller changes of a pose are not sent


class MovedNodes:
    """Nodes of a scene that follow poses; only changed poses are sent.

    Parameters
    ----------
    nodes
        By name, in the order of the poses.
    """

    def __init__(self, nodes: Mapping[str, Any]) -> None:
        self.nodes = dict(nodes)
        self._sent = np.full((len(self.nodes), 4, 4), np.inf)

    @property
    def poses(self) -> Mapping[str, Array]:
        """Poses (4, 4) that were sent, by name."""
        return dict(zip(self.nodes, self._sent, strict=True))

    def move(self, world: Array) -> None:
        """Put the nodes at poses ``world_from_node`` (n, 4, 4)."""
        moved = np.flatnonzero(np.abs(world - self._sent).max((1, 2)) > _STILL)
        if not len(moved):
            return
        nodes = list(self.nodes.values())
        self._sent[moved] = world[moved]
        for row, quaternion in zip(moved, pose.quaternion_from_rotation(world[moved, :3, :3]), strict=True):
            nodes[row].position = world[row, :3, 3]
            nodes[row].wxyz = quaternion


class BodyNodes:
    """All frames that bodies move with, and the bodies in them.

    Parameters
    ----------
    scene
        Of viser.
    cell
        Bodies and frames.
    drawn, collision_meshes
        Meshes that are drawn, and those of which collisions are computed, by the names of the bodies.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        cell: NominalCell,
        drawn: Mapping[str, DrawnMesh],
        collision_meshes: Mapping[str, Mesh],
    ) -> None:
        self._scene, self._cell, self._collision_meshes = scene, cell, collision_meshes
        self.names = tuple(cell.frame_poses())
        self._frames = MovedNodes({name: self._add_frame(name) for name in self.names})
        self._labels = [
            scene.add_label(f"/frames/{name}/name", name, position=tip, visible=False, font_screen_scale=0.8)
            for name, tip in zip(self.names, cycle(1.1 * _AXES * np.eye(3)))
        ]
        self._colours = {body.name: body_colour(body, number) for number, body in enumerate(cell.bodies)}
        self._meshes = {
            body.name: scene.add_mesh_simple(
                f"/frames/{body.moves_with}/{body.name}", *drawn[body.name], color=self._colours[body.name]
            )
            for body in cell.bodies
        }
        self._wires: list[Any] = []

    def _add_frame(self, name: str) -> Any:
        return self._scene.add_frame(
            f"/frames/{name}", show_axes=False, axes_length=_AXES, axes_radius=_AXES / 30, origin_radius=_AXES / 16
        )

    def move(self, frames: Mapping[str, Array]) -> None:
        """Put frames at poses ``world_from_frame`` (4, 4)."""
        self._frames.move(np.stack([frames[name] for name in self.names]))

    @property
    def poses(self) -> Mapping[str, Array]:
        """Poses ``world_from_frame`` (4, 4) of the frames as they are shown."""
        return self._frames.poses

    def position(self, frame: str) -> Array:
        """Where a frame is shown (3,), m."""
        return np.array(self._frames.nodes[frame].position, float)

    def paint(self, body: str, colour: Rgb | None) -> None:
        """Paint a body, or restore its own colour."""
        if body in self._meshes:
            self._meshes[body].color = self._colours[body] if colour is None else colour

    def show_frames(self, shown: bool) -> None:
        """Show the axes and names of all frames, and bodies translucent, or none."""
        for mesh in self._meshes.values():
            mesh.opacity = _TRANSLUCENT if shown else None
        for node, label in zip(self._frames.nodes.values(), self._labels, strict=True):
            node.show_axes = shown
            label.visible = shown

    def show_collision_meshes(self, shown: bool) -> None:
        """Show the meshes that collisions are computed with; they are sent when they are shown first."""
        if shown and not self._wires:
            self._wires = [
                self._scene.add_mesh_simple(
                    f"/frames/{body.moves_with}/collision/{body.name}",
                    np.asarray(self._collision_meshes[body.name].vertices, np.float32),
                    np.asarray(self._collision_meshes[body.name].faces, np.uint32),
                    color=_WIRE,
                    wireframe=True,
                    opacity=_FAINT,
                    cast_shadow=False,
                    receive_shadow=False,
                )
                for body in self._cell.bodies
            ]
        for wire in self._wires:
            wire.visible = shown
