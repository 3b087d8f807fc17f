"""Camera images of a live cell: what they show, when they are made, and what perturbations change."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from live_cells import PATIENCE, run_until

from scancell import Scanner
from scancell.config.loading import assets_dir
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.live import camera as live_camera
from scancell.live.camera import CameraFeed, CameraFrame
from scancell.live.cell import LiveCell
from scancell.live.state import MoveLine
from scancell.programs.robot import deg, location, mm
from scancell.scanning.session import ScanSession

PART = assets_dir() / "parts" / "step_block.stl"


class Rig:
    """A live cell with the sensor above the part, and its cameras."""

    def __init__(self, session: ScanSession) -> None:
        self.session, self.live = session, LiveCell(session)
        self.above = location(450 * mm, 0, 0.0, rx=180 * deg)
        self.above[:3, 3] = session.nominal.world_from_table[:3, 3] + [0, 0, 170 * mm]
        session.move_tool(self.above)
        self.frames: list[CameraFrame] = []
        self.feed = CameraFeed(self.live, session, on_frame=self.frames.append)

    def frame(self, condition: Callable[[CameraFrame], bool] = lambda _: True) -> CameraFrame:
        """The first frame that satisfies a condition, once there is one."""
        run_until(self.live, lambda: any(condition(one) for one in self.frames))
        return next(one for one in self.frames if condition(one))

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.live.step()


@pytest.fixture
def rig(ideal_scanner: Scanner) -> Iterator[Rig]:
    with ideal_scanner.session(PART, guarded=True) as session:
        made = Rig(session)
        with made.feed:
            yield made


def test_images_show_the_stripe_where_its_points_are_found(rig: Rig) -> None:
    rig.feed.wanted = True
    frame = rig.frame()
    sensor = rig.session.world.sensor
    assert frame.images.shape == (2, sensor.cameras[0].height_px, sensor.cameras[0].width_px)
    assert frame.images.dtype == np.uint8
    assert [len(stripe) for stripe in frame.stripes] == [(frame.camera == camera).sum() for camera in (0, 1)]
    for image, stripe in zip(frame.images, frame.stripes, strict=True):
        assert len(stripe) > 200
        column, row = np.rint(stripe).astype(int).T
        assert np.median(image[row, column]) > 4 * (np.median(image) + 1)
    height = pose.transform_points(
        pose.inverse(rig.session.nominal.world_from_table) @ rig.session.nominal.arm.world_from_base,
        frame.points_in_base,
    )[:, 2]
    assert np.abs(height - np.median(height)).max() < 60 * mm
    assert height.min() > -0.1 * mm
    alone = rig.session.profile("ray-traced")
    np.testing.assert_allclose(frame.points_in_base, alone.points_in_base, atol=1e-6)
    with pytest.raises(ValueError, match="read-only"):
        frame.images[0, 0, 0] = 1


def test_frames_are_made_when_wanted_and_something_changed(rig: Rig) -> None:
    rig.cycles(20)
    assert rig.feed.frame is None
    rig.feed.wanted = True
    first = rig.frame()
    rig.cycles(40)
    assert rig.feed.frame is first
    rig.live.submit(MoveLine(rig.above @ pose.translation((10 * mm, 0, 0))))
    moved = rig.frame(lambda frame: frame.number > first.number)
    assert moved.time > first.time
    run_until(rig.live, lambda: not rig.live.state.moving)
    rig.feed.engine = "geometric"
    assert rig.frame(lambda frame: frame.engine == "geometric").images is None  # the last one of the cell at rest
    rig.feed.wanted = False
    switched_off = rig.live.state.time
    rig.live.submit(MoveLine(rig.above))
    rig.cycles(40)
    rig.feed.close()  # a frame that was being made is finished
    assert max(frame.time for frame in rig.frames) <= switched_off


def test_perturbation_shows_at_once_in_the_profile(rig: Rig) -> None:
    """A laser that is turned about its line's normal by 1 mrad in truth shifts what the nominal sensor says."""
    rig.feed.engine = "geometric"
    rig.feed.wanted = True
    nominal = rig.frame()
    rig.feed.perturb({"sensor.laser.turn_y_deg": 0.1})
    turned = rig.frame(lambda frame: bool(frame.as_built))
    assert turned.as_built == ("sensor.laser.turn_y_deg=0.1",)
    shift = np.median(turned.points_in_sensor[:, 2]) - np.median(nominal.points_in_sensor[:, 2])
    assert 20e-6 < abs(shift) < 2e-3
    for words, message in (
        ({"sensor.laser.nothing": 0.1}, "nothing"),
        ({"tool.x_mm": 0.1}, "tool.x_mm"),
        ({"sensor.laser.turn_y_deg": "much"}, "turn_y_deg"),
        ({"sensor.laser.waist_z_mm": 1e300}, "waist_z_mm.*less than or equal to 100000"),  # ended the process
        ({"sensor.laser.divergence_mrad": 1e30}, "divergence_mrad.*less than or equal to 1000"),
    ):
        with pytest.raises(DescriptionError, match=message):
            rig.feed.perturb(words)
    rig.feed.perturb(())
    again = rig.frame(lambda frame: frame.number > turned.number)
    np.testing.assert_allclose(again.points_in_sensor, nominal.points_in_sensor, atol=1e-9)


def test_cell_goes_on_while_a_frame_is_made(rig: Rig, monkeypatch) -> None:
    begun, go_on = threading.Event(), threading.Event()
    measure = live_camera.measure_profile

    def slow(*inputs: object) -> object:
        begun.set()
        assert go_on.wait(PATIENCE)
        return measure(*inputs)

    monkeypatch.setattr(live_camera, "measure_profile", slow)
    rig.feed.wanted = True
    run_until(rig.live, begun.is_set)
    before = rig.live.state.time
    rig.cycles(20)
    assert rig.feed.frame is None
    go_on.set()
    assert rig.frame().time <= before


def test_feed_that_is_not_closed_ends_with_the_program(ideal_scanner: Scanner, monkeypatch) -> None:
    """Its thread would abort the program if it still rendered when the interpreter ends."""
    at_exit: list[Callable[[], None]] = []
    monkeypatch.setattr(atexit, "register", at_exit.append)
    before = set(threading.enumerate())
    with ideal_scanner.session(PART, guarded=True) as session:
        CameraFeed(LiveCell(session), session).wanted = True
    (thread,) = (one for one in set(threading.enumerate()) - before if one.name == "cameras")
    for end in at_exit:
        end()
    assert not thread.is_alive()
