"""Bodies of a cell in a scene: their meshes and colours, frames, ghosts at targets, and pairs that are close."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.config.material import Material
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, decimated
from scancell.geometry.mesh_files import weld
from scancell.live.state import LiveState
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.proximity.scene import ProximityScene
from scancell.views.pictures import painted

if TYPE_CHECKING:
    import viser


Vertices = NDArray[np.float32]
Faces = NDArray[np.uint32]
DrawnMesh = tuple[Vertices, Faces]
Rgb = tuple[int, int, int]

_MOST_FACES = 150_000  # of a body on the screen; more only take longer to load
_CREASE = np.radians(32.0)  # edges at which the surface bends by more are drawn sharp
_INSET = 0.3e-3  # m by which the scanned part is drawn smaller, or it would hide half of its cloud
_METALS = ("rough_conductor", "grooved_conductor", "mirror")
_PAINT, _METAL = np.array([1.0, 0.985, 0.95]), np.array([0.94, 0.97, 1.0])
_DARKEST = 0.14  # displayed brightness; blacker surfaces would lose their shape

_AXES = 0.08  # m, of frames
_TRANSLUCENT = 0.45  # opacity of bodies, most of which hide their frames
_WIRE, _FAINT = (220, 90, 0), 0.35  # colour and opacity of wire frames
_STILL = 1e-6  # m and rad: smaller changes of a pose are not sent

Poses = Mapping[str, Array]

TARGET, PREVIEW, FORBIDDEN = (40, 115, 225), (240, 150, 20), (215, 35, 35)
_OPACITY = 0.35
_POSITION, _ANGLE = 0.1e-3, np.radians(0.01)  # m and rad: nearer to its target, a body has no ghost
_ON_TABLE = 5e-3  # m and rad by which a part on the table may be off its nominal pose
_LARGER = 1.004  # scale of the ghost: faces of both in one plane would flicker

COLLIDING, NEAREST = (215, 35, 35), (245, 165, 30)
_LINE = (200, 60, 0)
_PERIOD = 0.1  # s of the cell between computations of the line
_GUARDED_REACH = 1.0  # m
_SLACK = 2e-3  # m by which the nearest points may be farther apart than the distance that is known


def drawn_mesh(body: Body) -> DrawnMesh:
    """Vertices (n, 3), m, and faces (m, 3) of a body, simplified where it is huge, with `split_at_creases`."""
    mesh = decimated(body.mesh, _MOST_FACES)
    return split_at_creases(inset(mesh, _INSET) if body.moves_with == "part" else mesh)


def inset(mesh: Mesh, depth: float) -> Mesh:
    """The mesh with its vertices moved inwards by `depth`, m, along the mean normals of their faces."""
    first, number = weld(mesh.vertices)
    normals = np.zeros((len(first), 3))
    np.add.at(normals, number[mesh.faces], (mesh.areas[:, None] * mesh.normals)[:, None])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    moved = mesh.vertices[first] - depth * normals / np.where(length > 0, length, 1.0)
    return Mesh(moved[number], mesh.faces, mesh.source)


def split_at_creases(mesh: Mesh) -> DrawnMesh:
    """Vertices (n, 3), m, and faces (m, 3), in their order, so that faces share a vertex only across smooth edges.

    A renderer that takes the mean normal of the faces at each vertex then draws edges sharp where the normals of both
    faces differ by more than 32°.
    """
    from scipy.sparse import coo_array  # noqa: PLC0415  (takes a while to import)
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    first, number = weld(mesh.vertices)
    faces = number[mesh.faces].astype(np.int64)
    corner = np.arange(3 * len(faces)).reshape(-1, 3)  # of a face: the vertices, were none shared
    start, end = faces.ravel(), np.roll(faces, -1, 1).ravel()
    from_corner, to_corner = corner.ravel(), np.roll(corner, -1, 1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    one, other = order[:-1], order[1:]
    normals = mesh.normals
    smooth = (low[one] == low[other]) & (high[one] == high[other])
    smooth &= np.einsum("ni,ni->n", normals[one // 3], normals[other // 3]) >= np.cos(_CREASE)
    one, other = one[smooth], other[smooth]
    at_low = np.where(start == low, from_corner, to_corner)
    at_high = np.where(start == low, to_corner, from_corner)
    rows, columns = np.concatenate([at_low[one], at_high[one]]), np.concatenate([at_low[other], at_high[other]])
    joined = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(corner.size, corner.size))
    count, vertex = connected_components(joined, directed=False)
    source = np.zeros(count, np.int64)
    source[vertex] = start
    vertices = np.asarray(mesh.vertices[first][source], np.float32)
    return vertices, np.asarray(vertex.reshape(-1, 3), np.uint32)


def body_colour(body: Body, number: int) -> Rgb:
    """Displayed colour of a body: parts, belts and obstacles by their material, the machine as in pictures."""
    machine = ("base", "table", "table_base", "sensor", "gripper")
    if body.name in machine or body.moves_with.startswith(("link[", "finger[", "sensor[")):
        return as_rgb(painted(body, number).colour)
    return material_colour(body.material)


def material_colour(material: Material) -> Rgb:
    """Displayed colour of a material: its reflectance as grey, metals colder than paint."""
    tint = _METAL if material.model in _METALS else _PAINT
    return as_rgb(tint * max(np.sqrt(material.reflectance), _DARKEST))


def as_rgb(colour: NDArray[np.float64] | tuple[float, float, float]) -> Rgb:
    """Values 0 to 255 of a displayed colour, 0 to 1."""
    red, green, blue = (round(255 * float(share)) for share in colour)
    return red, green, blue


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
        Scene of viser.
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
        look = {"show_axes": False, "axes_length": _AXES, "axes_radius": _AXES / 30, "origin_radius": _AXES / 16}
        self._frames = MovedNodes({name: scene.add_frame(f"/frames/{name}", **look) for name in self.names})
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
        self._painted_faces: list[Any] = []
        self._clicked: Callable[[Any], object] | None = None

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

    def on_part_click(self, act: Callable[[Any], object]) -> None:
        """Call `act` with the event of each click on the part or its painted faces; one function at a time."""
        self._clicked = act
        self._meshes["part"].on_click(act)

    def paint_faces(self, faces: Mapping[Rgb, Mesh]) -> None:
        """Paint faces of the part, meshes in its frame by colour, which lie as far out as the part itself does."""
        for node in self._painted_faces:
            node.remove()
        self._painted_faces = [
            self._scene.add_mesh_simple(f"/frames/part/faces/{number}", *split_at_creases(mesh), color=colour)
            for number, (colour, mesh) in enumerate(faces.items())
        ]
        if self._clicked is not None:
            for node in self._painted_faces:
                node.on_click(self._clicked)

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


class Ghost:
    """The ghost of the bodies that axes move; a body at its target has none.

    Poses hold the table's platter, too, by which the part is carried.

    Parameters
    ----------
    scene
        Scene of viser.
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
        self._bodies = [body for body in cell.bodies if _moves(cell, body)]
        self._table_from_part = cell.table_from_part
        flanges = [body.name for body in self._bodies if body.moves_with.startswith("link[")]
        flange = flanges[-1] if flanges else ""
        self._carrier = {"finger": flange, "part": flange if cell.holds_part else "table"}
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


def _moves(cell: NominalCell, body: Body) -> bool:
    """Whether a body has a ghost; a platter that nothing carries looks the same at all angles."""
    if {axis.name for axis in cell.further_axes} & set(cell.tree.axes_of(body.moves_with)):
        return True
    frame = cell.carrier(body.moves_with)
    carried = frame in ("sensor", "table", "part") or frame.startswith(("link[", "finger["))
    return carried and body.name != "table"


class PairView:
    """Paints pairs of bodies, and draws the line between the nearest points of one.

    It is the pair that the guard names, else the nearest one.

    Parameters
    ----------
    scene
        Scene of viser.
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
        names = self._drawn
        if names not in self._pairs:
            self._pairs[names] = ProximityScene({name: self._meshes[name] for name in names}, [(names[0], names[1])])
        ends = self._pairs[names].closest_points(poses[None], reach, threads=1)[1][0, 0]
        found = bool(np.isfinite(ends).all())
        self._line.visible = self._label.visible = found
        if found:
            self._line.points = ends[None]
            self._label.text = f"{1e3 * np.linalg.norm(ends[1] - ends[0]):.1f} mm"
            self._label.position = ends.mean(0)

    def _hide(self) -> None:
        self._drawn = ()
        self._line.visible = self._label.visible = False


def _pair(state: LiveState) -> tuple[tuple[str, ...], float]:
    """Names of the two bodies to show, and a bound on their distance, m; no names if there are none."""
    if (guarded := state.guarded_pair) is not None:
        return guarded, _GUARDED_REACH
    return ((), 0.0) if state.nearest is None else (state.nearest[:2], state.nearest[2] + _SLACK)
