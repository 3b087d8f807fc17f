"""Cells of boxes with a wall in front of the sensor: for the tests of the guard."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from guard_motions import cell_of, unit
from scancell.config.material import Material
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.geometry.pose import from_rotation, transform_points, translation
from scancell.guard.parts import Tool
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import Body
from scancell.proximity.scene import ProximityScene, cell_scene

Square = tuple[np.ndarray, np.ndarray, float, NominalCell, ProximityScene]


@cache
def boxes(arm: str = "six_axis") -> NominalCell:
    """The default cell, or another one, with a box of half the size in place of each body."""
    nominal, _ = cell_of(arm)

    def small(mesh: Mesh) -> Mesh:
        lower, upper = mesh.bounds
        return box_mesh(tuple((upper - lower) / 2)).transformed(translation((lower + upper) / 2))

    return replace(nominal, bodies=tuple(replace(body, mesh=small(body.mesh)) for body in nominal.bodies))


def behind_wall(
    axes: np.ndarray, direction: np.ndarray, gap: float, arm: str = "six_axis", body: str = "sensor"
) -> tuple[NominalCell, ProximityScene]:
    """A cell with a wall across `direction`, `gap` in front of the foremost point of a body at `axes`."""
    cell = boxes(arm)
    poses = dict(zip([body.name for body in cell.bodies], cell.body_poses(axes), strict=True))
    points = transform_points(poses[body], next(b.mesh.vertices for b in cell.bodies if b.name == body))
    foremost = points[np.argmax(points @ direction)]
    across = np.linalg.svd(direction[None])[2][1]
    turned = np.column_stack([direction, across, np.cross(direction, across)])
    place = from_rotation(turned, foremost + (gap + 0.0025) * direction)
    wall = Body("wall", "world", box_mesh((0.005, 0.15, 0.15)).transformed(place), Material(0.5))
    walled = replace(cell, bodies=(*cell.bodies, wall))
    return walled, cell_scene(walled, {body.name: body.mesh for body in walled.bodies})


def distances(cell: NominalCell, scene: ProximityScene, axes: np.ndarray, bound: float = 0.05) -> np.ndarray:
    return scene.distances(cell.body_poses(axes), bound, 1)


def straight(axes: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Rates (joints + 1,) of a translation of the tool."""
    tool = Tool(boxes())
    _, jacobian = tool.poses(axes[None, :-1])
    return np.append(tool.rates(jacobian, np.append(velocity, np.zeros(3))[None])[0], 0.0)


def near_home(rng: np.random.Generator) -> np.ndarray:
    return np.append(boxes().home + rng.uniform(-0.2, 0.2, 6), 0.0)


def is_clear(cell: NominalCell, scene: ProximityScene, axes: np.ndarray, gap: float) -> bool:
    """Whether all bodies keep the gap to the wall, and 2 mm to each other."""
    required = [gap - 1e-9 if "wall" in pair else 2e-3 for pair in scene.pairs]
    return not scene.clearance_violations(cell.body_poses(axes[None]), required, 1)


def square(rng: np.random.Generator, gaps: tuple[float, float], count: int) -> Iterator[Square]:
    """Random cells (axes, direction, gap, cell, scene) with a wall in front of the sensor."""
    found = 0
    while found < count:
        axes, direction, gap = near_home(rng), unit(rng), float(rng.uniform(*gaps))
        cell, scene = behind_wall(axes, direction, gap)
        if is_clear(cell, scene, axes, gap):
            found += 1
            yield axes, direction, gap, cell, scene
