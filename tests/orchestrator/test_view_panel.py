"""Viewpoints of a browser: what is in its picture, without a browser."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scancell.browser.panels.camera_panel import ViewPanel
from scancell.browser.scene.scene import VIEW_NAMES, ViewName, Viewpoint, viewpoint
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.nominal.cell import NominalCell, nominal_cell

# px, of windows without their docked panels
CANVASES = [(1280 - 720, 720), (1920 - 720, 1080), (800 - 320, 900), (1366 - 728, 768), (1366 - 728, 650)]


@pytest.fixture(scope="module")
def cell() -> NominalCell:
    return nominal_cell(load_setup().cell, box_mesh(np.array([0.08, 0.06, 0.03])))


@pytest.fixture(scope="module")
def frames(cell: NominalCell) -> dict[str, np.ndarray]:
    return {name: np.asarray(world) for name, world in cell.frame_poses(cell.home).items()}


def shown(seen: Viewpoint, points: np.ndarray, aspect: float) -> np.ndarray:
    """Positions (n, 2) in the picture, -1 to 1, of world points (n, 3); NaN behind the camera."""
    forward = (seen.look_at - seen.position) / np.linalg.norm(seen.look_at - seen.position)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    x, y, z = axes @ (points - seen.position).T
    return np.stack([x / aspect, y]).T / np.where(z > 0, z, np.nan)[:, None] / np.tan(seen.fov / 2)


@pytest.mark.parametrize("size", CANVASES)
@pytest.mark.parametrize("view", VIEW_NAMES)
def test_all_of_a_view_is_in_the_picture(
    cell: NominalCell, frames: dict[str, np.ndarray], view: ViewName, size: tuple[int, int]
) -> None:
    """Every vertex of the robot, the table and the part in the view of the cell; docked panels cover none of it."""
    aspect = size[0] / size[1]
    seen = viewpoint(view, cell, frames, aspect)
    for body in cell.bodies:
        if view == "cell" or body.moves_with == "part":
            points = pose.transform_points(frames[body.moves_with], body.mesh.vertices)
            assert np.abs(shown(seen, points, aspect)).max() < 1, body.name
    widest = [
        np.abs(shown(seen, pose.transform_points(frames[b.moves_with], b.mesh.vertices), aspect)).max()
        for b in cell.bodies
    ]
    assert max(widest) > 0.7  # not from far away


def test_view_of_a_held_part_is_near_it_wherever_the_table_is() -> None:
    held = nominal_cell(load_setup(assets_dir() / "cells/held_part.toml").cell, box_mesh((0.05, 0.04, 0.03)))
    frames = {name: np.asarray(world) for name, world in held.frame_poses(held.home).items()}
    seen = viewpoint("part", held, frames, 1.0)
    part, table = (next(body for body in held.bodies if body.name == name) for name in ("part", "table"))
    in_world = {body.name: pose.transform_points(frames[body.moves_with], body.mesh.vertices) for body in (part, table)}
    assert np.abs(shown(seen, in_world["part"], 1.0)).max() < 1.0
    assert not (np.abs(shown(seen, in_world["table"], 1.0)) < 1.0).all()


class Rig:
    """A browser whose camera and buttons a test sets."""

    def __init__(self, cell: NominalCell, frames: dict[str, np.ndarray]) -> None:
        self.sensor = np.zeros(3)
        self.camera = SimpleNamespace(
            position=np.zeros(3), look_at=np.ones(3), fov=1.0, image_width=560, image_height=720
        )
        scene: Any = SimpleNamespace(
            position=lambda _: self.sensor,
            viewpoint=lambda view, aspect: viewpoint(view, cell, frames, aspect),
        )
        self.panel = ViewPanel(self, self.camera, SimpleNamespace(callback=lambda act: act), scene)  # type: ignore[arg-type]

    def add_button_group(self, _label: str, options: tuple[str, ...], order: float) -> Any:
        self.options = options
        self.buttons = SimpleNamespace(value="", on_click=self._keep)
        return self.buttons

    def _keep(self, act: Callable[[], None]) -> None:
        self.press = act

    def choose(self, name: str) -> None:
        self.buttons.value = name
        self.press()


@pytest.fixture
def rig(cell: NominalCell, frames: dict[str, np.ndarray]) -> Rig:
    return Rig(cell, frames)


def test_view_is_fitted_to_another_window_until_the_user_moves_the_camera(rig: Rig) -> None:
    first = rig.camera.position
    rig.camera.image_width = 1200
    rig.panel.update()
    assert np.linalg.norm(rig.camera.position - first) > 0.1
    rig.camera.position = moved = rig.camera.position + 0.1
    rig.camera.image_width = 480
    rig.panel.update()
    np.testing.assert_array_equal(rig.camera.position, moved)
    rig.choose("part")
    assert np.linalg.norm(rig.camera.position - moved) > 0.1


def test_followed_sensor_keeps_its_place_in_the_picture(rig: Rig) -> None:
    rig.choose("follow")
    before = rig.camera.position
    for step in (np.array([0.1, 0.0, -0.2]), np.array([-0.3, 0.2, 0.0])):
        rig.sensor = rig.sensor + step
        rig.panel.update()
    np.testing.assert_allclose(rig.camera.position - before, rig.sensor)
    rig.choose("cell")
    fixed = rig.camera.position
    rig.sensor = rig.sensor + 0.1
    rig.panel.update()
    np.testing.assert_array_equal(rig.camera.position, fixed)
    assert rig.options == (*VIEW_NAMES, "follow")
