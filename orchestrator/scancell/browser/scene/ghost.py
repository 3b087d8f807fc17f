"""Translucent arm and table at the destination of the motion, or at a pose of a plan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.bodies import MovedNodes
from scancell.browser.scene.surfaces import DrawnMesh, Rgb
from scancell.geometry import pose
from scancell.nominal.cell import Body, NominalCell

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]
Poses = Mapping[str, Array]

TARGET, PREVIEW, FORBIDDEN = (40, 115, 225), (240, 150, 20), (215, 35, 35)
_OPACITY = 0.35
_POSITION, _ANGLE = 0.1e-3, np.radians(0.01)  # m and rad: nearer to its target, a body has no ghost
_ON_TABLE = 5e-3  # m and rad by which a part on the table may be off its nominal pose
_LARGER = 1.004  # scale of the ghost: faces of both in one plane would flicker


class Ghost:
    """The ghost of the bodies on the arm and on the table; a body at its target has none.

    Poses hold the table's platter, too, by which the part is carried.

    Parameters
    ----------
    scene
        Of viser.
    cell
        Bodies and frames.
    drawn
        Meshes by the names of the bodies.
    root, colour
        Name of the scene's node above the bodies, and their colour.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        cell: NominalCell,
        drawn: Mapping[str, DrawnMesh],
        root: str = "/ghost",
        colour: Rgb = TARGET,
    ) -> None:
        self._root, self._colour = root, colour
        self._bodies = [body for body in cell.bodies if _moves(body)]
        self._table_from_part = cell.table_from_part
        flanges = [body.name for body in self._bodies if body.moves_with.startswith("link[")]
        self._carrier = {"finger": flanges[-1] if flanges else "", "part": "table"}
        self._nodes = MovedNodes({body.name: self._add(scene, body.name, drawn[body.name]) for body in self._bodies})

    def _add(self, scene: viser.SceneApi, name: str, drawn: DrawnMesh) -> Any:
        return scene.add_mesh_simple(
            f"{self._root}/{name}",
            *drawn,
            color=self._colour,
            opacity=_OPACITY,
            scale=_LARGER,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of the bodies whose ghosts are shown."""
        return tuple(name for name, node in self._nodes.nodes.items() if node.visible)

    def show(self, target_from_body: Poses, world_from_body: Poses) -> None:
        """Put the ghosts of all bodies at poses (4, 4), where these differ from the bodies' own."""
        if not self._bodies:
            return
        target = np.stack([self._target(body, target_from_body, world_from_body) for body in self._bodies])
        true = np.stack([world_from_body[body.name] for body in self._bodies])
        away = np.linalg.norm(target[:, :3, 3] - true[:, :3, 3], axis=1) > _POSITION
        turned = np.linalg.norm(target[:, :3, :3] - true[:, :3, :3], axis=(1, 2)) / np.sqrt(2)  # 2 sin(angle / 2)
        visible = away | (turned > 2 * np.sin(_ANGLE / 2))
        for node, shown in zip(self._nodes.nodes.values(), visible.tolist(), strict=True):
            node.visible = shown
        if visible.any():
            self._nodes.move(target)

    def paint(self, colour: Rgb) -> None:
        """Give all bodies another colour."""
        if colour != self._colour:
            self._colour = colour
            for node in self._nodes.nodes.values():
                node.color = colour

    def hide(self) -> None:
        """Show no ghost."""
        for node in self._nodes.nodes.values():
            node.visible = False

    def _target(self, body: Body, target_from_body: Poses, world_from_body: Poses) -> Array:
        """Target of a body; fingers and the part go on as they are held now, which no motion of the arm changes."""
        kind = body.moves_with.partition("[")[0]
        if kind not in self._carrier:
            return target_from_body[body.name]
        carrier = self._carrier[kind]
        if carrier not in world_from_body:
            return world_from_body[body.name]
        carrier_from_body = pose.inverse(world_from_body[carrier]) @ world_from_body[body.name]
        if kind == "part" and np.abs(carrier_from_body - self._table_from_part).max() > _ON_TABLE:
            return world_from_body[body.name]
        return np.asarray(target_from_body[carrier] @ carrier_from_body)


def _moves(body: Body) -> bool:
    """Whether a body has a ghost; the platter looks the same at all angles."""
    carried = body.moves_with in ("sensor", "table", "part") or body.moves_with.startswith(("link[", "finger["))
    return carried and body.name != "table"
