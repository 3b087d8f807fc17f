"""Camera images and profile in the workspace: each new frame is shown once, while it is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.live.camera import CameraFrame

viser = pytest.importorskip("viser")

from scancell.browser.scene.camera_view import CameraView, profile_data, with_stripe  # noqa: E402
from scancell.browser.server.quiet import quiet_server  # noqa: E402

WORLD_FROM_BASE = pose.from_euler_xyz((0.1, -0.2, 0.3), (0.0, 0.0, 0.5))
POINTS = np.array([[0.0, 0.004, 0.101], [0.0, -0.002, 0.099], [0.0, 0.001, 0.1]])


def frame_of(number: int) -> CameraFrame:
    """Frame of two cameras with a white stripe in row 60 of 960 x 120 pixels."""
    images = np.zeros((2, 120, 960), np.uint8)
    images[:, 60] = 255
    stripes = (np.array([[500.0, 60.0], [520.0, 60.0]]), np.array([[510.0, 60.0]]))
    camera = np.array([0, 1, 0], np.int32)
    in_base = POINTS + np.array([0.4, 0.0, 0.0])
    return CameraFrame(number, 0.5, "ray-traced", (), images, stripes, POINTS, in_base, np.ones(3), camera)


class Shown:
    """A view of a feed without a cell, and the stripes that its scene was given."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.stripes: list[np.ndarray | None] = []
        self.feed = SimpleNamespace(frame=None, wanted=False)
        scene = SimpleNamespace(show_stripe=self.stripes.append)
        self.view = CameraView(server, scene, self.feed, load_setup().sensor, WORLD_FROM_BASE)  # type: ignore[arg-type]


@pytest.fixture
def shown() -> Iterator[Shown]:
    with quiet_server(port=0) as server:
        yield Shown(server)


def test_each_frame_is_shown_once(shown: Shown) -> None:
    assert shown.feed.wanted
    shown.view.show()
    assert shown.stripes == []
    for number in (1, 2):
        shown.feed.frame = frame_of(number)
        for _ in range(3):
            shown.view.show()
        assert len(shown.stripes) == number
    stripe = shown.stripes[-1]
    assert stripe is not None
    np.testing.assert_allclose(stripe, pose.transform_points(WORLD_FROM_BASE, frame_of(2).points_in_base))


def test_no_frame_is_shown_while_none_is_wanted(shown: Shown) -> None:
    shown.feed.frame = frame_of(1)
    shown.feed.wanted = False
    shown.view.show()
    assert shown.stripes == []
    shown.feed.wanted = True
    shown.view.show()
    assert len(shown.stripes) == 1


def test_profile_is_in_order_and_each_point_belongs_to_its_camera() -> None:
    y, plus, minus = profile_data(frame_of(1), 2)
    np.testing.assert_allclose(y, [-2.0, 1.0, 4.0])
    np.testing.assert_allclose(plus, [np.nan, 100.0, 101.0])
    np.testing.assert_allclose(minus, [99.0, np.nan, np.nan])
    empty = replace(frame_of(1), points_in_sensor=POINTS[:0])
    assert all(len(column) == 1 for column in profile_data(empty, 2))


def test_marks_lie_on_the_stripe_of_a_smaller_image() -> None:
    """Half as large: a stripe one pixel wide stays, and its points are marked."""
    shown = with_stripe(frame_of(1).images[0], frame_of(1).stripes[0])
    assert shown.shape == (60, 480, 3)
    marked = shown[..., 0] != shown[..., 1]
    rows, columns = np.nonzero(marked)
    assert sorted(columns.tolist()) == [250, 260]
    assert (shown[rows[0], ~marked[rows[0]]] == 255).all()
    outside = with_stripe(frame_of(1).images[0], np.array([[-3.0, 60.0], [500.0, 125.0], [961.0, 60.0]]))
    assert (outside[..., 0] == outside[..., 1]).all()
