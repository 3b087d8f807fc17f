"""Nodes of the scene in a browser, compared with the states that it shows."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from cells import block, mesh_of

from remote_browser import RemoteBrowser
from scancell import Mode, Scanner
from scancell.config.loading import Setup, assets_dir, load_setup
from scancell.config.material import PRESETS
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh
from scancell.live.cell import LiveCell
from scancell.live.state import MoveJoints, MoveTool, OpenGripper, RunConveyor
from scancell.nominal.cell import without_bodies
from scancell.programs.robot import deg, location, mm
from scene_nodes import visible_bodies

viser = pytest.importorskip("viser")

from scancell.browser.scene import cloud  # noqa: E402
from scancell.browser.scene.bodies import (  # noqa: E402  # noqa: E402
    COLLIDING,
    NEAREST,
    MovedNodes,
    inset,
    material_colour,
    split_at_creases,
)
from scancell.browser.scene.cloud import Trace  # noqa: E402
from scancell.browser.scene.devices import (  # noqa: E402
    DETECTED,
    FREE,
    stripe_segments,
)
from scancell.browser.scene.scene import CellScene  # noqa: E402
from scancell.browser.server.gate import address, quiet_server  # noqa: E402

DEVICES = (
    'cell.distance_sensor=[{ name = "height", pose = { x_mm = 370, y_mm = -400, z_mm = 300, rx_deg = 180 },'
    " farthest_mm = 300 }]",
    'cell.light_curtain=[{ name = "door", pose = { y_mm = -700 }, width_mm = 700, height_mm = 300,'
    " beam_spacing_mm = 20 }]",
)
POSE = 3e-5  # viser leaves out changes of 1e-5 of a value


@pytest.fixture(scope="module")
def setup() -> Setup:
    return load_setup(assets_dir() / "cells" / "pick_and_place.toml", settings=DEVICES)


@pytest.fixture(scope="module")
def live(setup: Setup) -> Iterator[LiveCell]:
    """A belt, a gripper and sensors, some of which move."""
    with Scanner(setup=setup, threads=1) as scanner, scanner.session(block(0.04, 0.03, 0.02)) as session:
        live = LiveCell(session)
        live.true = session.true  # type: ignore[attr-defined]
        live.submit(MoveJoints(live.state.joints + np.array([0.3, 0.1, -0.1, 0.4, 0.2, 0.5]), 0.7, 0.5))
        live.submit(RunConveyor(1, 0.05))
        live.submit(OpenGripper(0.03))
        for _ in range(40):
            live.step()
        yield live


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    with quiet_server(port=0) as made:
        yield made


@pytest.fixture
def scene(server, live, setup) -> CellScene:
    return CellScene(server, live.true, setup.sensor, setup.cell)


def node(server: viser.ViserServer, name: str):
    found = server.scene.get_handle_by_name(name)
    assert found is not None, name
    return found


def ghosts(server: viser.ViserServer, live: LiveCell) -> tuple[str, ...]:
    return visible_bodies(server, "/ghost", live.true)


def shown_at(handle) -> np.ndarray:
    return pose.from_rotation(pose.rotation_from_quaternion(handle.wxyz), handle.position)


def chunk_names(server: viser.ViserServer, count: int) -> list[bool]:
    return [server.scene.get_handle_by_name(f"/frames/part/cloud/{number}") is not None for number in range(count)]


# --- poses ----------------------------------------------------------------------------------------------------------


def test_bodies_are_shown_where_they_truly_are(server, scene, live) -> None:
    scene.show(live.state)
    for body in live.true.bodies:
        node(server, f"/frames/{body.moves_with}/{body.name}")
        frame = node(server, f"/frames/{body.moves_with}")
        np.testing.assert_allclose(shown_at(frame), live.state.world_from_body[body.name], atol=POSE)
    assert {body.moves_with for body in live.true.bodies} >= {"finger[1]", "sensor", "table", "part", "link[6]"}


def test_frames_without_a_body_follow_nominal_kinematics(server, live, setup) -> None:
    bare = without_bodies(live.true, ["sensor", "link[5]"])
    CellScene(server, bare, setup.sensor, setup.cell).show(live.state)
    nominal = bare.frame_poses([*live.state.joints, live.state.table_angle])
    for name in ("sensor", "link[5]"):
        np.testing.assert_allclose(shown_at(node(server, f"/frames/{name}")), nominal[name], atol=POSE)


def test_only_nodes_that_moved_are_sent() -> None:
    sent: list[str] = []

    class Node:
        def __init__(self, name: str) -> None:
            self.__dict__["name"] = name

        def __setattr__(self, key: str, value: object) -> None:
            sent.append(f"{self.__dict__['name']}.{key}")

    nodes = MovedNodes({name: Node(name) for name in "ab"})
    poses = np.stack([np.eye(4), pose.translation((1, 2, 3))])
    nodes.move(poses)
    assert sorted(sent) == ["a.position", "a.wxyz", "b.position", "b.wxyz"]
    sent.clear()
    nodes.move(poses)
    assert sent == []
    poses[1, 0, 3] += 1e-3
    nodes.move(poses)
    assert sorted(sent) == ["b.position", "b.wxyz"]


def test_small_steps_add_up_until_they_are_sent() -> None:
    handle = SimpleNamespace()
    nodes = MovedNodes({"a": handle})
    for step in range(100):
        nodes.move(pose.translation((1e-7 * step, 0, 0))[None])
    assert handle.position[0] == pytest.approx(99e-7, abs=1.1e-6)


# --- ghost ----------------------------------------------------------------------------------------------------------


def test_ghost_shows_the_destination_until_it_is_reached(server, scene, live) -> None:
    state = live.state
    scene.show(state)
    for name in ("link1", "link6", "sensor", "gripper"):
        ghost = node(server, f"/ghost/{name}")
        assert ghost.visible
        np.testing.assert_allclose(shown_at(ghost), state.world_from_body_at_destination[name], atol=POSE)
    scene.options.ghost = False
    assert not node(server, "/ghost/link6").visible
    scene.options.ghost = True
    assert node(server, "/ghost/link6").visible
    scene.show(replace(state, world_from_body_at_destination=state.world_from_body))
    assert ghosts(server, live) == ()
    for controller in ("at rest", "emergency stop"):  # after a jog the destination is that of the last move
        scene.show(replace(state, controller=controller))
        assert ghosts(server, live) == ()
    scene.show(replace(state, controller="moving", mode=Mode.CARTESIAN_JOG))
    assert ghosts(server, live) == ()


@pytest.mark.parametrize(
    ("off", "shown"),
    [
        (pose.translation((0.09e-3, 0, 0)), False),
        (pose.translation((0, 0.11e-3, 0)), True),
        (pose.from_rotation(pose.rotation_about(0, np.radians(0.009))), False),
        (pose.from_rotation(pose.rotation_about(1, np.radians(0.011))), True),
    ],
)
def test_ghost_is_hidden_within_a_tenth_of_a_millimetre_and_a_hundredth_of_a_degree(
    server, scene, live, off, shown
) -> None:
    target = dict(live.state.world_from_body)
    target["link3"] = target["link3"] @ off
    scene.show(replace(live.state, world_from_body_at_destination=target))
    assert ghosts(server, live) == (("link3",) if shown else ())


def test_ghost_of_fingers_is_as_wide_as_the_gripper_is(server, scene, live) -> None:
    scene.show(live.state)
    fingers = [node(server, f"/ghost/finger{number}").position for number in (1, 2)]
    assert live.state.gripper_width is not None
    assert np.linalg.norm(fingers[0] - fingers[1]) == pytest.approx(live.state.gripper_width, abs=1e-4)


def test_preview_shows_any_axes_and_leaves_the_ghost_of_the_target(server, scene, live) -> None:
    scene.show(live.state)
    before = ghosts(server, live)
    axes = np.append(live.state.joints + 0.5, live.state.table_angle + 0.4)
    scene.show_preview(axes)
    nominal = dict(zip([b.name for b in live.true.bodies], live.true.body_poses(axes), strict=True))
    for name in ("link2", "link6", "sensor"):
        np.testing.assert_allclose(shown_at(node(server, f"/preview/{name}")), nominal[name], atol=POSE)
    assert ghosts(server, live) == before
    free = node(server, "/preview/link6").color
    scene.show_preview(axes, forbidden=True)
    assert node(server, "/preview/link6").color != free
    scene.show_preview(None)
    assert visible_bodies(server, "/preview", live.true) == ()
    assert ghosts(server, live) == before


def test_part_on_the_belt_has_no_ghost_and_part_on_the_table_turns_with_it(server, scene, live) -> None:
    state = live.state
    scene.show(state)
    assert "part" not in ghosts(server, live)  # it arrives on the belt
    on_table = dict(state.world_from_body)
    on_table["part"] = on_table["table"] @ live.true.table_from_part
    scene.show(replace(state, world_from_body=on_table))
    assert "part" in ghosts(server, live)


# --- pairs ----------------------------------------------------------------------------------------------------------


def test_colliding_bodies_are_red_and_the_nearest_amber(server, scene, live) -> None:
    def colours() -> dict[str, tuple[int, int, int]]:
        return {b.name: tuple(node(server, f"/frames/{b.moves_with}/{b.name}").color) for b in live.true.bodies}

    still = replace(live.state, colliding=None, nearest=None)
    scene.show(still)
    before = colours()
    scene.show(replace(still, colliding=("sensor", "table"), nearest=("sensor", "part", 0.01)))
    assert colours() == before | {"sensor": COLLIDING, "table": COLLIDING, "part": NEAREST}
    scene.show(replace(still, nearest=("link4", "table", 0.01)))
    assert colours() == before | {"link4": NEAREST, "table": NEAREST}
    scene.show(still)
    assert colours() == before


@pytest.mark.parametrize(
    "text", ["stop: sensor - table: 33 mm", "slowed to 50%: sensor - table", "sensor - table: 40 mm, contact in 0.4 s"]
)
def test_bodies_that_the_guard_names_are_painted_with_a_line_between_them(server, scene, live, text: str) -> None:
    still = replace(live.state, colliding=None, nearest=None, guard_text=text)
    scene.show(still)
    assert still.guarded_pair == ("sensor", "table")
    assert [node(server, f"/frames/{frame}").color for frame in ("sensor/sensor", "table/table")] == [NEAREST] * 2
    line, label = node(server, "/nearest/line"), node(server, "/nearest/distance")
    assert line.visible
    length = float(np.linalg.norm(np.diff(line.points[0], axis=0)))
    assert label.text == f"{1e3 * length:.1f} mm"
    scene.show(replace(still, guard_text="", time=still.time + 1))
    assert not line.visible
    for nothing in ("", "stop: the motion changes too fast", "stop: nobody - nothing: 3 mm"):
        assert replace(still, guard_text=nothing).guarded_pair is None


def test_line_between_nearest_bodies_is_as_long_as_the_cell_says(server) -> None:
    setup = load_setup()
    with Scanner(setup=setup, threads=1) as scanner, scanner.session(block(0.04, 0.03, 0.02)) as session:
        live = LiveCell(session)
        scene = CellScene(server, session.true, setup.sensor, setup.cell)
        live.submit(MoveTool(location(450 * mm, 0, 131 * mm, rx=180 * deg)))
        for _ in range(200):
            live.step()
        state = live.state
    assert state.nearest is not None
    *names, distance = state.nearest
    assert "sensor" in names
    scene.show(state)
    line, label = node(server, "/nearest/line"), node(server, "/nearest/distance")
    assert line.visible
    assert label.visible
    (start, end), *others = np.asarray(line.points, float)
    assert not others
    assert np.linalg.norm(end - start) == pytest.approx(distance, abs=1e-6)
    assert label.text == f"{1e3 * distance:.1f} mm"
    scene.options.distances = False
    assert not line.visible
    assert not label.visible
    scene.show(state)
    assert not line.visible


# --- devices --------------------------------------------------------------------------------------------------------


def belt_marks(server: viser.ViserServer) -> np.ndarray:
    """Vertices (n, 3) of the marks in the frame of the belt."""
    marks = node(server, "/belts/belt/marks")
    return np.asarray(marks.vertices, float) + marks.position


def test_marks_move_with_the_belt_and_stay_on_it(server, scene, live, setup) -> None:
    belt = setup.cell.conveyor[0]
    half = np.array([belt.length_mm, belt.width_mm]) / 2e3
    first = None
    travelled = []
    for travel in np.linspace(0.0, 0.3, 61):
        scene.show(replace(live.state, conveyors=((0.1, float(travel)),)))
        marks = belt_marks(server)
        assert (np.abs(marks[:, :2]) <= half + 1e-6).all()
        first = marks if first is None else first
        travelled.append(marks[0, 0] - first[0, 0])
    starts = np.unique(np.round(first[::6, 0], 6))
    pitch = (starts[-1] - starts[0]) / (len(starts) - 1)
    np.testing.assert_allclose(travelled, np.linspace(0.0, 0.3, 61) % pitch, atol=1e-6)
    np.testing.assert_allclose(np.diff(starts), pitch, atol=2e-6)


def test_belt_frame_is_that_of_the_description(server, scene, setup) -> None:
    shown = shown_at(node(server, "/belts/belt"))
    np.testing.assert_allclose(shown[:3, 3], (0.370, -0.435, 0.1), atol=POSE)
    np.testing.assert_allclose(shown[:3, 0], (0, 1, 0), atol=POSE)


def test_presence_sensor_has_the_colour_of_its_state(server, scene, live) -> None:
    volume = node(server, "/frames/world/presence/gate")
    for present, colour in ((True, DETECTED), (False, FREE)):
        scene.show(replace(live.state, presence=(present,)))
        assert tuple(volume.color) == colour
    np.testing.assert_allclose(volume.dimensions, (0.12, 0.002, 0.006))
    np.testing.assert_allclose(volume.position, (0.37, -0.29, 0.11), atol=POSE)


def test_ray_of_a_distance_sensor_is_as_long_as_its_reading(server, scene, live) -> None:
    name = "/frames/world/distance/height"
    ray, label, spot = (node(server, f"{name}/{part}") for part in ("ray", "reading", "spot"))
    scene.show(replace(live.state, distance=(0.1234,)))
    world_from_ray = shown_at(node(server, name))
    ends = pose.transform_points(world_from_ray, np.asarray(ray.points, float)[0])
    np.testing.assert_allclose(ends, [(0.37, -0.4, 0.3), (0.37, -0.4, 0.3 - 0.1234)], atol=POSE)
    assert label.text == "height: 123.4 mm"
    assert spot.visible
    scene.show(replace(live.state, distance=(None,)))
    assert np.ptp(ray.points[0], axis=0)[2] == pytest.approx(0.3)  # its range
    assert label.text == "height: -"
    assert not spot.visible


def test_light_curtain_has_all_its_beams_and_two_posts(server, scene) -> None:
    lines = node(server, "/frames/world/curtain/door").points
    assert lines.shape == (16 + 2, 2, 3)
    way = np.abs(lines[:, 1] - lines[:, 0])
    np.testing.assert_allclose(way[:16], np.tile((0, 0, 0.7), (16, 1)), atol=1e-6)
    np.testing.assert_allclose(way[16:], np.tile((0.3, 0, 0), (2, 1)), atol=1e-6)
    np.testing.assert_allclose(np.unique(np.round(lines[:16, 0, 0], 6)), 0.02 * np.arange(16), atol=1e-6)


# --- cloud, trace, stripe -------------------------------------------------------------------------------------------


def test_cloud_chunks_are_in_the_part_frame_and_can_be_removed(server, scene) -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(700, 3))
    colours = rng.integers(0, 255, (700, 3), dtype=np.uint8)
    for rows in (slice(0, 300), slice(300, 700)):
        assert scene.add_points(points[rows], colours[rows], 1e-4) == len(points[rows])
    chunks = [node(server, f"/frames/part/cloud/{number}") for number in (0, 1)]
    np.testing.assert_allclose(np.concatenate([chunk.points for chunk in chunks]), points, atol=1e-6)
    np.testing.assert_array_equal(np.concatenate([chunk.colors for chunk in chunks]), colours)
    for count in (0, 1, 2):
        scene.show_chunks(count)
        assert [chunk.visible for chunk in chunks] == [number < count for number in (0, 1)]
    scene.clear_points()
    assert chunk_names(server, 2) == [False, False]
    assert scene.add_points(points, colours, 1e-4) == 700
    assert chunk_names(server, 2) == [True, False]


def test_cloud_ends_at_its_limit(server, scene, monkeypatch) -> None:
    monkeypatch.setattr(cloud, "MOST_POINTS", 25)
    points, colours = np.zeros((10, 3)), np.zeros((10, 3), np.uint8)
    assert [scene.add_points(points, colours, 1e-4) for _ in range(4)] == [10, 10, 5, 0]
    assert len(node(server, "/frames/part/cloud/2").points) == 5
    assert chunk_names(server, 4) == [True, True, True, False]


def test_trace_follows_the_point_and_is_bounded(server) -> None:
    trace = Trace(server.scene)
    points = np.column_stack([np.cos(t := np.linspace(0, 60, 9000)), np.sin(t), t / 100])
    for point in points:
        trace.add(point)
    segments = trace.segments
    assert 1500 < len(segments) <= 2000
    np.testing.assert_allclose(segments[1:, 0], segments[:-1, 1], atol=1e-6)  # one line without gaps
    np.testing.assert_allclose(segments[-1, 1], points[-1], atol=7e-3)
    np.testing.assert_allclose(np.linalg.norm(segments[..., :2], axis=-1), 1.0, atol=1e-4)
    trace.clear()
    assert len(trace.segments) == 0


def test_trace_is_broken_at_jumps(server) -> None:
    trace = Trace(server.scene)
    for x in (0.0, 0.01, 0.02, 1.0, 1.01):
        trace.add((x, 0.0, 0.0))
    np.testing.assert_allclose(trace.segments[..., 0], [(0, 0.01), (0.01, 0.02), (1.0, 1.01)], atol=1e-6)


def test_sensor_leaves_a_trace(server, scene, live) -> None:
    states = [live.state]
    for _ in range(10):
        live.step()
        states.append(live.state)
    for state in states:
        scene.show(state)
    ends = node(server, "/trace/1").points
    np.testing.assert_allclose(ends[0, 0], states[0].world_from_body["sensor"][:3, 3], atol=1e-6)
    scene.options.trace = False
    assert not node(server, "/trace/1").visible
    scene.clear_trace()
    assert server.scene.get_handle_by_name("/trace/1") is None


def test_stripe_is_broken_at_gaps(server, scene) -> None:
    y = np.r_[np.linspace(0, 0.01, 11), np.linspace(0.03, 0.04, 11)]
    points = np.column_stack([np.zeros(22), y, np.zeros(22)])
    segments = stripe_segments(points)
    assert len(segments) == 20
    assert not ((segments[:, 0, 1] < 0.02) & (segments[:, 1, 1] > 0.02)).any()
    scene.show_stripe(points)
    assert node(server, "/stripe").visible
    np.testing.assert_allclose(node(server, "/stripe").points, segments, atol=1e-8)
    for nothing in (None, points[:1], points[:0]):
        scene.show_stripe(nothing)
        assert not node(server, "/stripe").visible


# --- options --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "name"),
    [
        ("frames", "/frames/link[3]/name"),
        ("field_of_view", "/frames/sensor/field_of_view"),
        ("field_of_view", "/frames/sensor/laser"),
        ("devices", "/frames/world/presence/gate"),
        ("devices", "/frames/world/distance/height"),
        ("devices", "/frames/world/curtain/door"),
    ],
)
def test_options_show_and_hide(server, scene, option, name) -> None:
    for shown in (True, False, True):
        setattr(scene.options, option, shown)
        assert getattr(scene.options, option) is shown
        assert node(server, name).visible is shown


def test_collision_meshes_are_those_of_the_description(server, scene, live, setup) -> None:
    assert server.scene.get_handle_by_name("/frames/part/collision/part") is None  # nothing is sent before
    scene.options.collision_meshes = True
    for body in live.true.bodies:
        wire = node(server, f"/frames/{body.moves_with}/collision/{body.name}")
        assert wire.visible
        assert wire.wireframe
        assert len(wire.faces) <= setup.cell.collision.max_faces
    scene.options.collision_meshes = False
    assert not node(server, "/frames/part/collision/part").visible


def test_laser_is_seen_while_it_is_on_and_the_field_is_shown(server, scene) -> None:
    sheet = node(server, "/frames/sensor/laser")
    for field, on in ((True, False), (False, True), (True, True)):
        scene.options.field_of_view = field
        scene.show_laser(on)
        assert sheet.visible is (field and on)


def test_first_view_has_the_whole_cell_in_it(server, scene, live) -> None:
    camera = server.initial_camera
    forward = (camera.look_at - camera.position) / np.linalg.norm(camera.look_at - camera.position)
    assert forward[2] < -0.2  # from above
    slope = np.tan(camera.fov / 2)
    frames = live.true.frame_poses(live.true.home)
    for body in live.true.bodies:
        seen = pose.transform_points(frames[body.moves_with], body.mesh.vertices) - camera.position
        ahead = seen @ forward
        assert (np.linalg.norm(seen - ahead[:, None] * forward, axis=1) <= np.sqrt(2) * slope * ahead).all()


# --- surfaces -------------------------------------------------------------------------------------------------------


def test_box_has_sharp_edges_and_a_sphere_none() -> None:
    vertices, faces = split_at_creases(box_mesh((1.0, 2.0, 3.0)))
    assert (len(vertices), len(faces)) == (24, 12)  # each corner once for each of its three sides
    ball = mesh_of(trimesh.creation.icosphere(3, 0.02))
    vertices, faces = split_at_creases(ball)
    assert len(vertices) == len(ball.vertices)


def test_cylinder_is_smooth_around_and_sharp_at_its_ends() -> None:
    made = mesh_of(trimesh.creation.cylinder(0.02, 0.05, sections=48))
    vertices, faces = split_at_creases(made)
    split = trimesh.Trimesh(vertices, faces, process=False)
    around = np.abs(vertices[:, 2]) > 0
    normals = split.vertex_normals[around]
    is_end = np.abs(normals[:, 2]) > 0.5
    np.testing.assert_allclose(np.abs(normals[is_end, 2]), 1.0, atol=1e-6)
    np.testing.assert_allclose(normals[~is_end, 2], 0.0, atol=1e-6)


@pytest.mark.parametrize("shared", [True, False])
def test_splitting_leaves_every_triangle_where_it_was(shared) -> None:
    made = trimesh.creation.annulus(0.01, 0.02, 0.01)
    if not shared:
        made.unmerge_vertices()
    mesh = mesh_of(made)
    vertices, faces = split_at_creases(mesh)
    np.testing.assert_allclose(vertices[faces], mesh.vertices[mesh.faces], atol=1e-9)


def test_inset_mesh_lies_inside_by_its_depth() -> None:
    made = trimesh.creation.icosphere(4, 0.02)
    made.unmerge_vertices()
    smaller = inset(mesh_of(made), 0.3e-3)
    np.testing.assert_allclose(np.linalg.norm(smaller.vertices, axis=1), 0.0197, atol=1e-6)
    np.testing.assert_array_equal(smaller.faces, made.faces)


def test_bright_materials_are_shown_brighter() -> None:
    order = ["black_rubber", "painted_plastic", "matt_white"]
    shown = [sum(material_colour(PRESETS[name])) for name in order]
    assert all(a < b for a, b in pairwise(shown))
    red, _, blue = material_colour(PRESETS["machined_aluminium"])
    assert blue > red  # metals are colder


def test_server_prints_nothing(capfd) -> None:
    with quiet_server(port=0):
        pass
    said = capfd.readouterr()
    assert said.out + said.err == ""


def test_update_of_a_browser_that_has_left_warns_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with quiet_server(port=0) as server:
            clients: list[viser.ClientHandle] = []
            came, left = Event(), Event()
            server.on_client_connect(lambda client: (clients.append(client), came.set()))
            server.on_client_disconnect(lambda _: left.set())
            with RemoteBrowser(address(server)):
                assert came.wait(60)
            assert left.wait(60)
            clients[0].gui.add_html("too late")
