"""Camera images and profile in the workspace: each new frame is shown once, while it is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from chromium import chromium
from scancell.config.loading import as_built_sensor, load_setup
from scancell.live.camera import CameraFrame

viser = pytest.importorskip("viser")

from scancell.browser.panels.camera_panel import (  # noqa: E402
    _CLICK,
    _ENLARGE,
    _SCRIPT,
    CameraPanel,
    column_text,
    profile_data,
    side_by_side,
    with_stripe,
)
from scancell.browser.panels.cell_panel import perturbations  # noqa: E402
from scancell.browser.server.gate import quiet_server  # noqa: E402

POINTS = np.array([[0.0, 0.004, 0.101], [0.0, -0.002, 0.099], [0.0, 0.001, 0.1]])


_KEEP_PRESSED = """() => {
  window.pressed = [];
  window.onclick = (event) => event.target.tagName === "BUTTON" && window.pressed.push(event.target.innerText);
}"""


def frame_of(number: int) -> CameraFrame:
    """Frame of two cameras with a white stripe in row 60 of 960 x 120 pixels."""
    images = np.zeros((2, 120, 960), np.uint8)
    images[:, 60] = 255
    stripes = (np.array([[500.0, 60.0], [520.0, 60.0]]), np.array([[510.0, 60.0]]))
    camera = np.array([0, 1, 0], np.int32)
    in_base = POINTS + np.array([0.4, 0.0, 0.0])
    return CameraFrame(number, 0.5, "ray-traced", (), images, stripes, POINTS, in_base, np.ones(3), camera)


class Shown:
    """The panel of a feed without a cell."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.feed = SimpleNamespace(frame=None, wanted=True)
        self.panel = CameraPanel(server.gui, self.feed, load_setup().sensor, beside=True)  # type: ignore[arg-type]

    @property
    def picture(self) -> np.ndarray:
        return np.asarray(self.panel._views[0]._image.image)


@pytest.fixture
def shown() -> Iterator[Shown]:
    with quiet_server(port=0) as server:
        yield Shown(server)


def test_each_frame_is_shown_once_with_its_images_side_by_side(shown: Shown) -> None:
    blank = shown.picture
    shown.panel.show()
    assert shown.picture is blank
    for number in (1, 2):
        before = shown.picture
        shown.feed.frame = frame_of(number)
        shown.panel.show()
        now = shown.picture
        assert now is not before
        shown.panel.show()
        assert shown.picture is now
    assert now.shape[0] == 60
    assert 2 * 480 <= now.shape[1] <= 2 * 480 + 10
    marked = (now[..., 0] != now[..., 1]).nonzero()[1]
    assert ((marked < 480).sum(), (marked >= 480).sum()) == (2, 1)


def test_no_frame_is_shown_while_none_is_wanted(shown: Shown) -> None:
    blank = shown.picture
    shown.feed.frame = frame_of(1)
    shown.feed.wanted = False
    shown.panel.show()
    assert shown.picture is blank
    shown.feed.wanted = True
    shown.panel.show()
    assert shown.picture is not blank


def test_no_blank_image_is_shown_before_the_first_frame_and_a_frame_without_a_stripe_says_why(shown: Shown) -> None:
    shown.panel.show()
    assert not shown.panel._views[0]._image.visible
    nothing = np.zeros((0, 3))
    shown.feed.frame = replace(frame_of(1), points_in_sensor=nothing, points_in_base=nothing, camera=np.zeros(0))
    shown.panel.show()
    assert shown.panel._views[0]._image.visible
    assert "no stripe" in shown.panel._views[0]._text.content
    shown.feed.frame = frame_of(2)
    shown.panel.show()
    assert "no stripe" not in shown.panel._views[0]._text.content
    shown.feed.frame = replace(frame_of(3), images=None, engine="geometric")
    shown.panel.show()
    assert not shown.panel._views[0]._image.visible


def test_stripe_is_marked_only_where_it_is_switched_on(shown: Shown) -> None:
    def is_marked(picture: np.ndarray) -> bool:
        return bool((picture[..., 0] != picture[..., 1]).any())

    shown.feed.frame = frame_of(1)
    shown.panel.show()
    assert is_marked(shown.picture)
    shown.panel._views[0]._marks.value = False
    shown.panel.show()
    assert not is_marked(shown.picture)


def test_enlarged_image_has_every_pixel_and_the_profile_of_a_column(shown: Shown) -> None:
    large = shown.panel._views[0]._large
    shown.feed.frame = frame_of(1)
    shown.panel.show_enlarged()
    assert large._image.image.shape[0] == 2  # nothing is sent while it is closed
    large.open("minus")
    shown.panel.show_enlarged()
    assert large._image.image.shape == (120, 960, 3)
    assert large._column.value == 480
    large._column.value = 510
    shown.panel.show_enlarged()
    rows, values = large._plot.data
    np.testing.assert_array_equal(values, 255.0 * (rows == 60))
    assert "column 510: peak at row 60.00, largest intensity 255 of 255, saturated" in large._text.content
    assert "no peak" in column_text(frame_of(1), 1, 500)
    shown.feed.frame = replace(frame_of(3), images=None)
    shown.panel.show_enlarged()
    assert "makes no images" in large._text.content
    large.close()
    shown.feed.frame = frame_of(2)
    shown.panel.show_enlarged()
    assert large._shown[0] == 1


def test_images_of_different_heights_are_padded() -> None:
    both = side_by_side([np.zeros((4, 6, 3), np.uint8), np.ones((7, 5, 3), np.uint8)])
    assert both.shape[0] == 7
    assert (both[:4, :6] == 0).all()
    assert (both[:, -5:] == 1).all()


def test_profile_is_in_order_and_each_point_belongs_to_its_camera() -> None:
    y, plus, minus = profile_data(frame_of(1), 2)
    np.testing.assert_allclose(y, [-2.0, 1.0, 4.0])
    np.testing.assert_allclose(plus, [np.nan, 100.0, 101.0])
    np.testing.assert_allclose(minus, [99.0, np.nan, np.nan])
    empty = replace(frame_of(1), points_in_sensor=POINTS[:0])
    assert all(len(column) == 1 for column in profile_data(empty, 2))


def test_marks_lie_on_the_stripe_of_a_smaller_image() -> None:
    """Half as large: a stripe one pixel wide stays, and its points are marked."""
    shown = with_stripe(frame_of(1).images[0], frame_of(1).stripes[0], 480)
    assert shown.shape == (60, 480, 3)
    marked = shown[..., 0] != shown[..., 1]
    rows, columns = np.nonzero(marked)
    assert sorted(columns.tolist()) == [250, 260]
    assert (shown[rows[0], ~marked[rows[0]]] == 255).all()
    outside = with_stripe(frame_of(1).images[0], np.array([[-3.0, 60.0], [500.0, 125.0], [961.0, 60.0]]), 480)
    assert (outside[..., 0] == outside[..., 1]).all()


def test_click_on_an_image_presses_the_button_of_its_camera() -> None:
    """On a page with the elements of viser: an image below its label, and a row of buttons beside a label."""
    content = f"""<div><p>plus | minus, {_CLICK}</p><div><img width=400 height=100></div></div>
      <div><div><label>{_ENLARGE}</label></div><div><button>plus</button><button>minus</button></div></div>
      <div><p>other</p><div><img width=400 height=100></div></div>"""
    with chromium() as browser:
        page = browser.new_page()
        page.set_content(content)
        page.evaluate(_SCRIPT)
        page.evaluate(_KEEP_PRESSED)
        pictures = page.locator("img").all()
        for picture, x in ((pictures[0], 300), (pictures[0], 20), (pictures[1], 20)):
            picture.click(position={"x": x, "y": 50})
        assert page.evaluate("pressed") == ["minus", "plus"]


def test_every_slider_of_the_true_sensor_states_a_deviation_that_the_sensor_takes() -> None:
    sensor = load_setup().sensor
    offered = perturbations(sensor)
    assert {f"sensor.camera[{number}].tilt_deg" for number in (1, 2)} <= {one.key for one in offered}
    for one in offered:
        for value in (one.low, one.high):
            changed = as_built_sensor(sensor, [f"{one.key}={value}"])
            assert (changed == sensor) == (value == one.nominal), one.key
