"""The live cell in a browser: what a person does there, and what the robot does then."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
import viser
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from bench.workspace_messages import run
from chromium import Watched, chromium
from contrast import contrast, rgb
from scancell import Scanner
from scancell.browser.server.gate import address
from scancell.browser.server.serve import Host
from scancell.browser.server.workspace import Workspace, WorkspaceSettings
from scancell.cell.driver import Operation
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.live.camera import CameraFrame
from scancell.live.state import Cancel, LiveState, MoveJoints, MoveTool, Reset, SetMonitorSpeed, SetOperation
from scancell.nominal.cell import NominalCell
from scancell.programs.robot import deg, location, mm
from scancell.reconstruction.cloud_files import read_ply
from tour import choose, draws, entry, fill, hosted, waits

PARTS, CELLS = (Path(__file__).resolve().parents[2] / "assets" / name for name in ("parts", "cells"))
INTO_TABLE = """from scancell import Robot, deg, location, mm


def main(robot: Robot) -> None:
    robot.move_tool(location(450 * mm, 0, 260 * mm, rx=180 * deg))
    robot.move_line(location(450 * mm, 0, 95 * mm, rx=180 * deg))
"""
# Names, text colours and backgrounds of a dimmed label, an active and an inactive tab, and filled and outlined buttons.
_TEXT_COLOURS = """() => {
  const find = (kind, text) => [...document.querySelectorAll(kind)].find((one) => one.innerText.trim() === text);
  const behind = (one) => {
    const colour = getComputedStyle(one).backgroundColor;
    if (!/rgba\\(.*, 0\\)/.test(colour)) return colour;
    return one.parentElement ? behind(one.parentElement) : "rgb(255, 255, 255)";
  };
  const wanted = [["label", "joint 1, deg"], ["[role=tab]", "Joints"], ["[role=tab]", "Pose"], ["button", "Stop"],
    ["button", "Move to home position"], ["button", "follow"]];
  return wanted.map(([kind, text]) => {
    const one = find(kind, text);
    return [text, getComputedStyle(one).color, behind(one)];
  });
}"""
WAITS = 600.0  # s: only a hang takes longer, on a busy machine, too
ABOVE_TABLE = location(450 * mm, 0, 260 * mm, rx=180 * deg)


@dataclass
class Opened:
    """A workspace that runs, the states that it went through, and its browsers."""

    host: Host
    server: Any
    out: Path
    browser: Any
    states: list[LiveState] = field(default_factory=list)

    @property
    def workspace(self) -> Workspace:
        assert self.host.workspace is not None
        return self.host.workspace

    @property
    def nominal(self) -> NominalCell:
        return self.workspace.nominal

    @property
    def address(self) -> str:
        return address(self.server)

    @property
    def state(self) -> LiveState:
        return self.workspace.live.state

    def page(self) -> Watched:
        watched = Watched(self.browser, 1200, 750, sharpness=0.0)
        watched.opens(self.address)
        watched.page.get_by_role("tab", name="Joints").wait_for()
        return watched

    def until(self, condition: Callable[[LiveState], bool], what: str) -> LiveState:
        """Wait; states in between are kept."""
        last, waited = self.state, Event()
        for _ in range(round(WAITS / 0.01)):
            if (state := self.state) is not last:
                self.states.append(state)
                last = state
            if condition(state):
                return state
            waited.wait(0.01)
        raise AssertionError(f"{what} never came: {self.state}")

    def frame(self, condition: Callable[[CameraFrame], bool]) -> CameraFrame:
        """The first picture for which a condition holds."""
        feed, waited = self.workspace.feed, Event()
        for _ in range(round(WAITS / 0.01)):
            frame = feed.frame
            if frame is not None and len(frame.points_in_sensor) and condition(frame):
                return frame
            waited.wait(0.01)
        raise AssertionError(f"no such picture: {feed.frame}")

    def rests(self) -> LiveState:
        return self.until(lambda state: not state.moving and state.progress in (0.0, 1.0), "rest")

    def begins_anew(self) -> None:
        """Bring the robot home, without browsers."""
        for context in self.browser.contexts:
            context.close()
        self.until(lambda _: not self.server.get_clients(), "the end of the browsers")
        submit = self.workspace.live.submit
        submit(Cancel())
        if self.until(lambda state: not state.moving, "rest").controller == "emergency stop":
            submit(Reset())
            self.until(lambda state: state.controller == "at rest", "the reset")
        submit(SetOperation(Operation.AUTOMATIC))
        self.until(lambda state: state.operation is Operation.AUTOMATIC, "automatic operation")
        submit(SetMonitorSpeed(1.0))
        submit(MoveJoints(self.nominal.home, 0.0))
        self.until(lambda state: np.abs(state.joints - self.nominal.home).max() < 1e-6 and not state.moving, "home")
        self.states.clear()

    def moves_to(self, world_from_tool: np.ndarray) -> None:
        self.workspace.live.submit(MoveTool(world_from_tool))
        reached = lambda state: np.allclose(self.nominal.world_from_sensor(state.joints), world_from_tool, atol=1e-6)  # noqa: E731
        self.until(lambda state: reached(state) and not state.moving, "the pose")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as made:
        yield made


@pytest.fixture(scope="module")
def scanner() -> Iterator[Scanner]:
    with Scanner(
        setup=load_setup(ideal=True, settings=["scan.max_profiles=120", "scan.sweep.enabled=false"]), threads=1
    ) as made:
        yield made


@pytest.fixture(scope="module")
def empty(scanner: Scanner, browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    """A workspace with an empty table."""
    out = tmp_path_factory.mktemp("out")
    with hosted(scanner, None, WorkspaceSettings(out)) as (host, server):
        yield Opened(host, server, out, browser)


@pytest.fixture
def opened(empty: Opened) -> Opened:
    """The same, with the robot at home, without images, which take the processor that draws the pages, too."""
    empty.begins_anew()
    empty.workspace.feed.wanted = False
    return empty


def test_page_makes_no_request_beyond_its_address(opened: Opened) -> None:
    watched = opened.page()
    hosts = {re.sub(r"^(?:blob:)?\w+://([^/]*).*", r"\1", url) for url in watched.requests}
    assert hosts == {opened.address.removeprefix("http://")}
    assert watched.errors == []


def test_docked_panels_cover_nothing_of_the_picture(opened: Opened) -> None:
    page = opened.page().page

    def is_between() -> bool:
        boxes = [canvas.bounding_box() for canvas in page.locator("canvas").all()]
        picture = max((box for box in boxes if box is not None), key=lambda box: box["height"])
        left, right = (page.get_by_role("tab", name=name).bounding_box() for name in ("Cameras", "Joints"))
        return bool(left["x"] + left["width"] < picture["x"] and picture["x"] + picture["width"] <= right["x"])

    waits(page, is_between, "the panels beside the picture")
    for name, text, behind in page.evaluate(_TEXT_COLOURS):
        assert contrast(rgb(text), rgb(behind)) >= 4.5, name


def test_slider_moves_the_arm_and_a_reload_keeps_the_state(opened: Opened) -> None:
    page = opened.page().page
    fill(page, "joint 1, deg", 20.0)
    state = opened.until(lambda state: abs(state.joints[0] - 20 * deg) < 1e-6, "joint 1 at 20 deg")
    np.testing.assert_allclose(state.joints[1:], opened.nominal.home[1:], atol=1e-6)
    page.reload()
    page.get_by_role("tab", name="Joints").wait_for()
    entry = page.locator("input[type=text][value='20']")
    entry.wait_for()
    fill(page, "joint 6, deg", -30.0)
    opened.until(lambda state: abs(state.joints[5] + 30 * deg) < 1e-6, "joint 6 at -30 deg after the reload")
    assert abs(opened.state.joints[0] - 20 * deg) < 1e-6


def test_unreachable_target_is_said_and_the_arm_stays(opened: Opened) -> None:
    page = opened.page().page
    before = opened.state.joints
    page.get_by_role("tab", name="Pose").click()
    fill(page, "x, y, z, mm", 5000.0)
    page.get_by_text("cannot be brought to (5000.0").first.wait_for()
    page.get_by_role("button", name="Move to this pose").click()
    page.locator(".mantine-Notification-root", has_text="cannot be brought to").wait_for()
    assert not opened.state.moving
    np.testing.assert_allclose(opened.state.joints, before, atol=1e-9)


def test_typed_pose_is_reached(opened: Opened) -> None:
    opened.moves_to(ABOVE_TABLE)
    page = opened.page().page
    page.get_by_role("tab", name="Pose").click()
    fill(page, "x, y, z, mm", 400.0)
    page.get_by_role("button", name="Move to this pose").click()
    opened.until(lambda state: state.moving, "the motion")
    state = opened.rests()
    sensor = opened.nominal.world_from_sensor(state.joints)
    np.testing.assert_allclose(1e3 * sensor[:3, 3], [400, 0, 260], atol=0.02)
    np.testing.assert_allclose(sensor[:3, :3], ABOVE_TABLE[:3, :3], atol=1e-4)


def test_jog_into_the_table_slows_down_and_rests(opened: Opened) -> None:
    opened.moves_to(ABOVE_TABLE)
    page = opened.page().page
    page.get_by_role("tab", name="Jog").click()
    choose(page, "axis", "tool along z")
    button = page.get_by_role("button", name="Hold to jog -")
    button.hover()
    page.mouse.down()
    opened.until(lambda state: state.moving, "the jog")
    opened.until(lambda state: state.pendant_beep and state.guard_text != "", "the warning")
    stopped = opened.until(lambda state: not state.moving and state.guard_text.startswith("no jog"), "the rest")
    page.get_by_role("alert").filter(has_text="The guard permits no jog in this direction").wait_for()
    page.mouse.up()
    assert not any(state.colliding for state in opened.states)
    assert opened.nominal.world_from_sensor(stopped.joints)[2, 3] < ABOVE_TABLE[2, 3] - 1 * mm


def test_lost_connection_stops_a_jog(opened: Opened) -> None:
    watched = opened.page()
    page = watched.page
    page.get_by_role("tab", name="Jog").click()
    page.get_by_role("button", name="Hold to jog +").hover()
    page.mouse.down()
    opened.until(lambda state: state.moving, "the jog")
    page.close()
    state = opened.until(lambda state: not state.moving, "rest")
    assert state.controller == "at rest"
    assert np.abs(state.joints[0] - opened.nominal.home[0]) < 60 * deg


def test_held_key_jogs_until_it_is_let_go(opened: Opened) -> None:
    page = opened.page().page
    page.get_by_role("tab", name="Jog").click()
    page.keyboard.press("5")
    waits(page, lambda: entry(page, "axis").input_value() == "joint 5", "the axis")
    page.keyboard.down("j")
    opened.until(lambda state: state.joints[4] < opened.nominal.home[4] - 3 * deg, "3 deg of joint 5")
    page.keyboard.up("j")
    opened.rests()
    np.testing.assert_allclose(opened.state.joints[:4], opened.nominal.home[:4], atol=1e-6)


def test_stop_key_stops_and_reset_lets_the_robot_move_again(opened: Opened) -> None:
    page = opened.page().page
    fill(page, "speed, %", 3)  # slow enough for any browser
    fill(page, "joint 1, deg", -60.0)
    opened.until(lambda state: state.moving, "the motion")
    page.keyboard.press("Escape")  # while an input has the focus
    state = opened.until(lambda state: state.controller == "emergency stop" and not state.moving, "the stop")
    assert abs(state.joints[0] + 60 * deg) > 10 * deg
    page.get_by_role("button", name="Reset after a stop").click()
    opened.until(lambda state: state.controller == "at rest", "the reset")
    page.get_by_role("tab", name="Joints").click()
    fill(page, "speed, %", 30)
    page.get_by_role("button", name="Move to home position").click()
    opened.until(lambda state: np.abs(state.joints - opened.nominal.home).max() < 1e-6, "the home position")


def test_second_browser_reads_until_it_takes_control(opened: Opened) -> None:
    first, second = opened.page().page, opened.page().page
    home = second.get_by_role("button", name="Move to home position")
    waits(second, home.is_disabled, "the inputs that a second browser cannot use")
    assert first.get_by_role("button", name="Move to home position").is_enabled()
    second.get_by_role("button", name="Take control").click()
    first.get_by_role("button", name="Take control").wait_for()
    fill(second, "joint 1, deg", 10.0)
    opened.until(lambda state: abs(state.joints[0] - 10 * deg) < 1e-6, "the motion of the new operator")
    assert first.get_by_role("button", name="Move to home position").is_disabled()
    first.get_by_role("button", name="Stop", exact=True).click()
    opened.until(lambda state: state.controller == "emergency stop", "the stop from a browser that only reads")


def test_malformed_messages_do_nothing(opened: Opened) -> None:
    before = opened.state
    address_of_socket = opened.address.replace("http", "ws")
    for message in (
        b"",
        b"\xc1",
        b"not msgpack",
        b"\x93\x01\x02\x03",
        b"\x81\xa4type\xa9Imaginary",
        "text",
        b"\xff" * 5000,
    ):
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        with connect(address_of_socket, subprotocols=[protocol], max_size=None) as socket:
            socket.send(message)
            socket.recv(timeout=WAITS)
    page = opened.page().page
    state = opened.state
    assert state.time > before.time
    np.testing.assert_allclose(state.joints, before.joints, atol=1e-9)
    fill(page, "joint 1, deg", 20.0)
    opened.until(lambda state: abs(state.joints[0] - 20 * deg) < 1e-6, "a motion after malformed messages")


def test_mutated_messages_leave_the_cell_to_its_browsers(
    scanner: Scanner, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """In a workspace of its own: some mutants are valid, and change the switches that all browsers share."""
    counts: Counter[str] = Counter()
    with hosted(scanner, None, WorkspaceSettings(tmp_path)) as (host, server):
        run(host, server, 600, seed=1, counts=counts, length=200)
    assert counts["mutants sent"] == 600
    assert "Traceback" not in capfd.readouterr().err


def test_images_and_profile_follow_the_arm_and_the_perturbations(opened: Opened) -> None:
    """The flat table is seen 160 mm away, then 150 mm; a turned laser tilts the profiles of the cameras apart."""
    opened.moves_to(ABOVE_TABLE)
    page = opened.page().page
    feed = opened.workspace.feed
    feed.wanted = True
    picture = page.locator("img[src^='blob:'], img[src^='data:image/jpeg']").first
    at_160 = opened.frame(lambda frame: abs(frame.points_in_sensor[:, 2].mean() - 0.16) < 2e-5)
    before = picture.get_attribute("src")
    opened.moves_to(ABOVE_TABLE @ pose.translation((0, 0, 10 * mm)))
    at_150 = opened.frame(lambda frame: abs(frame.points_in_sensor[:, 2].mean() - 0.15) < 2e-5)
    rows = [np.mean([stripe[:, 1].mean() for stripe in frame.stripes]) for frame in (at_160, at_150)]
    assert rows[0] - rows[1] > 20  # px
    page.wait_for_function("([picture, before]) => picture.src !== before", arg=[picture.element_handle(), before])
    page.get_by_role("tab", name="Sensor").last.click()
    fill(page, "laser turn z, deg", 1.0)
    turned = opened.frame(lambda frame: frame.as_built == ("sensor.laser.turn_z_deg=1",))
    slopes = [np.polyfit(*turned.points_in_sensor[turned.camera == camera, 1:].T, 1)[0] for camera in (0, 1)]
    assert slopes[0] * slopes[1] < 0
    assert abs(slopes[0] - slopes[1]) > 0.01
    page.get_by_role("button", name="All nominal").click()
    opened.frame(lambda frame: frame.as_built == ())
    assert feed.as_built == ()


def test_file_that_is_no_mesh_is_refused_and_the_part_stays(opened: Opened, tmp_path: Path) -> None:
    page = opened.page().page
    workspace = opened.workspace
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"solid nothing")
    page.get_by_role("tab", name="File").click()
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Open a part").click()
    chooser.value.set_files(broken)
    said = page.locator(".mantine-Notification-root", has_text="broken.stl: ")
    said.wait_for()
    assert said.inner_text().splitlines()[-1].startswith("broken.stl: ")
    assert opened.workspace is workspace


def test_program_into_the_table_is_slowed_then_stopped(scanner: Scanner, browser: Any, tmp_path: Path) -> None:
    program = tmp_path / "into_table.py"
    program.write_text(INTO_TABLE)
    with hosted(scanner, None, WorkspaceSettings(tmp_path, program=program)) as (host, server):
        runs_into_the_table(Opened(host, server, tmp_path, browser))


def runs_into_the_table(opened: Opened) -> None:
    opened.workspace.feed.wanted = False
    page = opened.page().page
    page.get_by_role("tab", name="Program").click()
    page.get_by_role("button", name="Run the program").click()
    slowed = opened.until(lambda state: state.guard_text.startswith("slowed"), "a slower program")
    assert slowed.job == "into_table.py"
    ended = opened.until(lambda state: state.message != "", "the end of the program")
    assert "into_table.py:6: move_line: held by the guard" in ended.message
    page.get_by_text("into_table.py: failed, line 6").wait_for()
    speeds = [state.monitor_speed_in_force for state in opened.states]
    assert any(0.05 < speed < 0.95 for speed in speeds)
    assert not any(state.colliding for state in opened.states)
    assert 100 * mm < opened.nominal.world_from_sensor(ended.joints)[2, 3] < 150 * mm


def test_dragged_gizmo_moves_the_tool_by_inverse_kinematics(opened: Opened) -> None:
    """The arrow along the tool's x axis is dragged: the sensor moves along it, and does not turn."""
    opened.moves_to(ABOVE_TABLE)
    page = opened.page().page
    page.get_by_role("tab", name="Pose").click()
    entry(page, "drag the tool in the scene").check()
    client = next(iter(opened.server.get_clients().values()))
    camera, position = client.camera, (0.7, -1.6, 0.5)
    camera.position, camera.look_at = position, (0.7, 0.0, 0.3)  # the tool is left of the panels
    sent = camera.update_timestamp
    waits(
        page, lambda: camera.update_timestamp > sent and np.allclose(camera.position, position, atol=1e-3), "the view"
    )
    draws(page)
    along = ABOVE_TABLE[:3, 0]
    grip, target = (pixel(page, camera, ABOVE_TABLE[:3, 3] + share * along) for share in (0.15, 0.25))
    page.mouse.move(*grip)
    draws(page)
    page.mouse.down()
    page.mouse.move(*target, steps=5)
    draws(page)
    page.mouse.up()
    opened.until(lambda state: state.moving, "the motion")
    sensor = opened.nominal.world_from_sensor(opened.rests().joints)
    moved = sensor[:3, 3] - ABOVE_TABLE[:3, 3]
    assert moved @ along == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(moved - (moved @ along) * along, 0.0, atol=1e-4)
    np.testing.assert_allclose(sensor[:3, :3], ABOVE_TABLE[:3, :3], atol=1e-4)


def test_scan_of_an_opened_part_runs_to_the_planned_cloud(opened: Opened) -> None:
    """A mesh by the file chooser, a scan of it, its run folder, and the cloud as a download."""
    page = opened.page().page
    page.get_by_role("tab", name="File").click()
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Open a part").click()
    chooser.value.set_files(PARTS / "step_block.stl")
    page.get_by_text("scancell: step_block.stl").wait_for()
    page.get_by_role("tab", name="Scan").click()
    choose(page, "engine", "geometric")
    page.get_by_role("button", name="Scan the part").click()
    page.locator("b", has_text=re.compile("^done$")).wait_for()
    scans = opened.workspace.scans
    result, state = scans.result, scans.state
    assert state is not None
    assert state.sensed == state.planned == len(result.recording)
    assert scans.cloud.count * scans.cloud.step == pytest.approx(len(result.cloud), rel=0.01)
    assert len(result.cloud) > 10_000
    page.get_by_text("compared, mean").wait_for()
    is_lost = page.get_by_text("discard a scan of")
    is_lost.wait_for()
    page.get_by_role("button", name="Save the run folder").click()
    page.locator(".mantine-Notification-root", has_text="saved: ").wait_for()
    is_lost.wait_for(state="detached")
    saved = read_ply(opened.out / "scan_1" / "cloud.ply")
    assert len(saved) == len(result.cloud)
    with page.expect_download() as download:
        page.get_by_role("button", name="Download the cloud").click()
    np.testing.assert_allclose(read_ply(download.value.path()).points_in_part, saved.points_in_part, atol=1e-7)
    page.get_by_role("button", name="Play the scan back").click()
    sentence = page.get_by_role("alert").filter(has_text="A recorded scan is played back")
    back = page.get_by_role("button", name="Back to the running cell")
    sentence.wait_for()
    playback = opened.workspace.playback
    page.get_by_role("button", name="Pause").click()
    fill(page, "time of the scan, s", 1.5)
    opened.until(lambda _: playback.time == 1.5, "the time of the slider")
    assert opened.frame(lambda frame: frame.is_replayed).engine == "geometric"
    back.click()
    opened.until(lambda state: state.job is None, "the running cell")
    sentence.wait_for(state="detached")
    opened.until(lambda _: not opened.workspace.feed.frame.is_replayed, "images of the running cell")


def pixel(page: Any, camera: Any, point: np.ndarray) -> tuple[float, float]:
    """Where a page shows a point of the world."""
    boxes = [canvas.bounding_box() for canvas in page.locator("canvas").all()]
    box = max((box for box in boxes if box is not None), key=lambda box: box["width"])
    seen = pose.inverse(pose.pose(camera.position, camera.wxyz)) @ np.append(point, 1.0)
    focal = box["height"] / 2 / np.tan(camera.fov / 2)
    x, y = focal * seen[:2] / seen[2]
    return float(box["x"] + box["width"] / 2 + x), float(box["y"] + box["height"] / 2 + y)


def test_sliders_of_a_track_and_of_a_table_beyond_a_turn_move_them(browser: Any, tmp_path: Path) -> None:
    """The slider of the table goes on from its end, and the page shows where the track carries the arm."""
    setup = load_setup(CELLS / "track.toml", ideal=True)
    with (
        Scanner(setup=setup, threads=1) as scanner,
        hosted(scanner, None, WorkspaceSettings(tmp_path)) as (host, server),
    ):
        opened = Opened(host, server, tmp_path, browser)
        opened.workspace.feed.wanted = False
        page = opened.page().page
        fill(page, "speed, %", 100)
        fill(page, "track, mm", 250.0)
        state = opened.until(lambda state: abs(state.further_axes[0] - 0.25) < 1e-6, "the track at 250 mm")
        np.testing.assert_allclose(state.joints, opened.nominal.home, atol=1e-6)
        base = opened.workspace.scene.position("link[1]")
        np.testing.assert_allclose(base[1], opened.nominal.world_from("link[1]", state.axes)[1, 3], atol=1e-3)
        for degrees in (360.0, 700.0):
            fill(page, "table, deg", degrees)
            opened.until(lambda state, at=degrees: abs(state.table_angle - at * deg) < 1e-5, f"the table at {degrees}°")
            opened.rests()
            page.locator(f"input[type=text][value='{degrees:g}']").wait_for()
        assert abs(opened.state.further_axes[0] - 0.25) < 1e-6
