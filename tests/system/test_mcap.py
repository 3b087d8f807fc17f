"""Runs and sessions as MCAP files, read back by the reader of the format."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from commands import PARTS, QUICK, scancell_here
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from scancell import Scanner
from scancell.config.loading import load_setup
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry import pose
from scancell.live.camera import CameraFrame
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk
from scancell.live.state import MoveJoints
from scancell.views.mcap_export import SessionRecorder
from scancell.views.recorded_run import open_run

Messages = dict[str, list]


def read(path: Path) -> Messages:
    """Messages of each topic with their times, s."""
    found: Messages = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time * 1e-9, decoded))
    return found


def poses(message) -> dict[str, np.ndarray]:
    made = {}
    for one in message.transforms:
        assert one.parent_frame_id == "world"
        t, r = one.translation, one.rotation
        rotation = pose.rotation_from_quaternion(np.array([r.w, r.x, r.y, r.z]))
        made[one.child_frame_id] = pose.from_rotation(rotation, np.array([t.x, t.y, t.z]))
    return made


def columns(message) -> np.ndarray:
    assert message.frame_id == "part"
    assert message.point_stride == 4 * len(message.fields)
    return np.frombuffer(message.data, np.dtype([(field.name, "<f4") for field in message.fields]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Run folder of a small scan, and its export."""
    place = tmp_path_factory.mktemp("mcap")
    scan = ("scan", PARTS / "free_form.stl", *QUICK, "--out", "run")
    for words in (scan, ("export", "run", "--out", "run.mcap")):
        done = scancell_here(*words, "--json", cwd=place)
        assert done.code == 0, done.err
    return place


@pytest.fixture(scope="module")
def run(folder):
    return open_run(folder / "run", 1_000_000)


@pytest.fixture(scope="module")
def messages(folder) -> Messages:
    return read(folder / "run.mcap")


def test_poses_are_those_of_the_run_at_their_times(messages, run) -> None:
    assert len(messages["/tf"]) > 100
    assert messages["/tf"][-1][0] > run.motion.times[-1]
    for time, message in messages["/tf"][::20]:
        assert message.transforms[0].timestamp.ToNanoseconds() == pytest.approx(time * 1e9, abs=1)
        shown, frames = poses(message), run.motion.frames(time)
        assert list(shown) == [body.name for body in run.cell.bodies]
        for body in run.cell.bodies:
            np.testing.assert_allclose(shown[body.name], frames[body.moves_with], atol=1e-8)


def test_points_are_those_of_the_cloud(messages, run) -> None:
    (time, whole), chunks = messages["/cloud"][0], messages["/profiles"]
    points, cloud = columns(whole), run.cloud
    assert time == pytest.approx(cloud.time[-1], abs=1e-8)
    xyz = np.column_stack([points[name] for name in "xyz"])
    np.testing.assert_allclose(xyz, cloud.points_in_part, atol=1e-7)
    np.testing.assert_allclose(points["quality"], cloud.quality, rtol=1e-6)
    deviation = deviation_from_mesh(cloud, run.cell.part).distance
    np.testing.assert_allclose(points["deviation"], deviation, atol=1e-8)
    joined = np.concatenate([columns(message) for _, message in chunks])
    np.testing.assert_array_equal(joined, points)
    ends = np.cumsum([len(columns(message)) for _, message in chunks])
    np.testing.assert_allclose([time for time, _ in chunks], cloud.time[ends - 1], atol=1e-8)


def test_meshes_move_with_their_bodies(messages, run) -> None:
    ((_, scene),) = messages["/scene"]
    assert [entity.frame_id for entity in scene.entities] == [body.name for body in run.cell.bodies]
    for entity, body in zip(scene.entities, run.cell.bodies, strict=True):
        (triangles,) = entity.triangles
        points = np.array([(point.x, point.y, point.z) for point in triangles.points])
        assert np.ptp(points, axis=0) == pytest.approx(np.ptp(body.mesh.bounds, axis=0), abs=0.02)
        assert max(triangles.indices) < len(points)
        assert len(triangles.indices) % 3 == 0


def test_session_is_recorded_as_it_goes(tmp_path) -> None:
    chunk = LiveChunk(
        np.ones((2, 3)), *[np.arange(2.0)] * 3, np.zeros(2, np.int32), np.array([1e-5, -1e-5]), np.ones(2)
    )
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    frame = CameraFrame(
        1, 0.1, "ray-traced", (), np.stack([image, image + 1]), (), *[np.zeros((0, 3))] * 2, np.zeros(0), np.zeros(0)
    )
    states = []
    with (
        Scanner(setup=load_setup(ideal=True)) as scanner,
        scanner.session(guarded=True) as session,
        SessionRecorder(tmp_path / "session.mcap", session.true) as recorder,
    ):
        live = LiveCell(session)
        live.submit(MoveJoints(session.joints + 0.1))
        live.submit(MoveJoints([0.0, 1.0]))
        for _ in range(60):
            live.step()
            recorder.state(live.state)
            recorder.state(live.state)
            states.append(live.state)
        recorder.points(chunk)
        recorder.cameras(frame)
    found = read(tmp_path / "session.mcap")
    assert [time for time, _ in found["/tf"]] == pytest.approx([state.time for state in states], abs=1e-8)
    for (_, message), state in zip(found["/tf"], states, strict=True):
        for name, shown in poses(message).items():
            np.testing.assert_allclose(shown, state.world_from_body[name], atol=1e-8)
    positions = np.array([[joint.position for joint in message.joints] for _, message in found["/joints"]])
    np.testing.assert_allclose(positions[:, :-1], [state.joints for state in states], atol=1e-12)
    assert any("expected 6 angles" in message.message for _, message in found["/log"])
    np.testing.assert_allclose(columns(found["/profiles"][0][1])["deviation"], chunk.deviation)
    for topic, sent in (("/camera1", image), ("/camera2", image + 1)):
        ((_, message),) = found[topic]
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(message.data))), sent)
