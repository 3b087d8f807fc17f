"""Bodies that collide, that the guard names or that are nearest, in colour, with the line between nearest points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scancell.browser.scene.bodies import BodyNodes
from scancell.browser.scene.surfaces import Rgb
from scancell.geometry.mesh import Mesh
from scancell.live.state import LiveState
from scancell.proximity.scene import ProximityScene

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]

COLLIDING, NEAREST = (215, 35, 35), (245, 165, 30)
_LINE = (200, 60, 0)
_PERIOD = 0.1  # s of the cell between computations of the line
_GUARDED_REACH = 1.0  # m
_SLACK = 2e-3  # m by which the nearest points may be farther apart than the distance that is known


class PairView:
    """Paints pairs of bodies, and draws the line between the nearest points of one.

    It is the pair that the guard names, else the nearest one.

    Parameters
    ----------
    scene
        Of viser.
    bodies
        To be painted.
    collision_meshes
        By the names of the bodies, in their frames.
    """

    def __init__(self, scene: viser.SceneApi, bodies: BodyNodes, collision_meshes: Mapping[str, Mesh]) -> None:
        self._bodies, self._meshes = bodies, collision_meshes
        self._painted: dict[str, Rgb] = {}
        self._pairs: dict[tuple[str, ...], ProximityScene] = {}
        self._drawn: tuple[str, ...] = ()  # pair of the line
        self._computed = -np.inf  # s
        self._shown = True
        self._line = scene.add_line_segments(
            "/nearest/line", np.zeros((1, 2, 3)), _LINE, thickness=3.0, thickness_units="screen", visible=False
        )
        self._label = scene.add_label("/nearest/distance", "", visible=False, anchor="bottom-left")

    def show(self, state: LiveState) -> None:
        """Paint the pairs of a state, and draw the line."""
        self._paint(dict.fromkeys(_pair(state)[0], NEAREST) | dict.fromkeys(state.colliding or (), COLLIDING))
        names, reach = _pair(state)
        if not names or state.colliding is not None or not self._shown:
            self._hide()
        elif names != self._drawn or abs(state.time - self._computed) >= _PERIOD:
            self._drawn, self._computed = names, state.time
            self._draw(np.stack([state.world_from_body[name] for name in names]), reach)

    def clear(self) -> None:
        """Show no pair, until the next state."""
        self._paint({})
        self._hide()

    def show_distances(self, shown: bool) -> None:
        """Show the line, from the next state on, or hide it."""
        self._shown = shown
        if not shown:
            self._hide()

    def _paint(self, wanted: dict[str, Rgb]) -> None:
        if wanted == self._painted:
            return
        for body in self._painted.keys() | wanted.keys():
            self._bodies.paint(body, wanted.get(body))
        self._painted = wanted

    def _draw(self, poses: Array, reach: float) -> None:
        ends = self._scene_of(self._drawn).closest_points(poses[None], reach, threads=1)[1][0, 0]
        found = bool(np.isfinite(ends).all())
        self._line.visible = self._label.visible = found
        if found:
            self._line.points = ends[None]
            self._label.text = f"{1e3 * np.linalg.norm(ends[1] - ends[0]):.1f} mm"
            self._label.position = ends.mean(0)

    def _scene_of(self, names: tuple[str, ...]) -> ProximityScene:
        if names not in self._pairs:
            self._pairs[names] = ProximityScene({name: self._meshes[name] for name in names}, [(names[0], names[1])])
        return self._pairs[names]

    def _hide(self) -> None:
        self._drawn = ()
        self._line.visible = self._label.visible = False


def _pair(state: LiveState) -> tuple[tuple[str, ...], float]:
    """Names of the two bodies to show, and a bound on their distance, m; no names if there are none."""
    if (guarded := state.guarded_pair) is not None:
        return guarded, _GUARDED_REACH
    return ((), 0.0) if state.nearest is None else (state.nearest[:2], state.nearest[2] + _SLACK)
