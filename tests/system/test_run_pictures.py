"""Pictures and animations of a recorded run: motion, cloud, video file, and messages."""

from __future__ import annotations

import shutil

import cv2
import numpy as np
import pyarrow.parquet
import pytest
from commands import PARTS, QUICK, scancell_here
from PIL import Image

from scancell.cell.recording import read_recording
from scancell.errors import OutputError
from scancell.geometry import pose
from scancell.planning.plan import Plan
from scancell.reconstruction.cloud_files import read_ply, write_cloud
from scancell.views import pictures
from scancell.views.camera import camera_path
from scancell.views.motion import RunMotion
from scancell.views.pictures import _in_order, run_pictures
from scancell.views.recorded_run import open_run
from scancell.views.renderer import Rendered, coloured_by

PART = PARTS / "free_form.stl"
SMALL = ("--size", "160x96", "--json")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Run folder of a small scan."""
    place = tmp_path_factory.mktemp("pictures")
    done = scancell_here("scan", PART, *QUICK, "--out", "run", "--json", cwd=place)
    assert done.code == 0, done.err
    return place / "run"


@pytest.fixture(scope="module")
def run(folder):
    return open_run(folder, most_points=20_000)


@pytest.fixture(scope="module")
def recording(folder):
    return read_recording(folder / "recording.parquet")


# --- motion ---------------------------------------------------------------------------------------------------------


def test_at_exposures_everything_is_where_it_truly_was(run, recording) -> None:
    for frame in ("link[3]", "sensor", "table", "part"):
        truth = recording.truth_at_middle("part[1]" if frame == "part" else frame)
        shown = [run.motion.frames(time)[frame] for time in recording.measured.time.tolist()]
        np.testing.assert_allclose(shown, truth, atol=1e-12)


def test_run_begins_and_ends_at_home(run) -> None:
    for time in (run.motion.start, run.motion.duration):
        q = run.cell.home
        np.testing.assert_allclose(run.motion.frames(time)["sensor"], run.cell.world_from_sensor(q), atol=1e-6)


def test_motion_has_no_jumps(run) -> None:
    """The sensor never moves faster than all joints together could move it."""
    times = np.linspace(run.motion.start, run.motion.duration, 3000)
    sensor = np.array([run.motion.frames(time)["sensor"][:3, 3] for time in times.tolist()])
    reach = np.linalg.norm(sensor, axis=1).max() + 0.5
    fastest = float(run.cell.arm.max_speed.max()) * reach
    speed = np.linalg.norm(np.diff(sensor, axis=0), axis=1) / np.diff(times)
    assert speed.max() < fastest


def test_gaps_between_exposures_follow_the_plan(run, folder, recording) -> None:
    plan = Plan.load(folder / "plan.json")
    planned = np.concatenate([run.cell.world_from_sensor(segment.axes)[:, :3, 3] for segment in plan.program.segments])
    times = recording.measured.time
    widest = int(np.argmax(np.diff(times)))
    for share in (0.2, 0.5, 0.8):
        time = float((1 - share) * times[widest] + share * times[widest + 1])
        position = run.motion.frames(time)["sensor"][:3, 3]
        assert np.linalg.norm(planned - position, axis=1).min() < 0.01  # a cycle of a fast move


def test_without_a_plan_the_run_is_from_the_first_to_the_last_exposure(run, recording) -> None:
    motion = RunMotion(run.cell, recording, None)
    assert (motion.start, motion.duration) == (recording.measured.time[0], recording.measured.time[-1])
    for time in (motion.start, motion.duration):
        assert np.isfinite(motion.frames(float(time))["sensor"]).all()
    measured = recording.measured
    widest = int(np.argmax(np.diff(measured.time)))
    for share in (0.25, 0.75):  # the joints move evenly
        time, axes = ((1 - share) * v[widest] + share * v[widest + 1] for v in (measured.time, measured.axes))
        frames = motion.frames(float(time))
        for frame in ("sensor", "table"):
            np.testing.assert_allclose(frames[frame], run.cell.world_from(frame, axes), atol=1e-9)


def test_part_stays_on_the_table(run) -> None:
    for time in np.linspace(run.motion.start, run.motion.duration, 50).tolist():
        frames = run.motion.frames(time)
        np.testing.assert_allclose(pose.inverse(frames["table"]) @ frames["part"], run.cell.table_from_part, atol=1e-6)


def test_laser_is_on_around_exposures_only(run, recording) -> None:
    times = recording.measured.time
    assert run.motion.laser_on(float(times[3]))
    assert not run.motion.laser_on(float(times[0]) - 0.06)
    assert run.motion.laser_on(float(times[0]) - 0.06, span=0.13)


# --- cloud ----------------------------------------------------------------------------------------------------------


def test_no_point_is_shown_before_it_was_measured(run) -> None:
    cloud = coloured_by(run.cloud, run.cloud_points, run.cell.part, "deviation")
    assert cloud.measured_until(float(cloud.time[0]) - 1e-6) == 0
    assert cloud.measured_until(float(cloud.time[-1])) == len(cloud.time)
    for time in np.linspace(0, run.motion.duration, 20).tolist():
        count = cloud.measured_until(time)
        assert (cloud.time[:count] <= time).all()
        assert (cloud.time[count:] > time).all()


def drawn(run, time: float, depth: float = np.inf) -> np.ndarray:
    """Pixels (h, w) that the cloud covers in an empty picture, whose surfaces lie at `depth`."""
    size = (320, 200)
    cloud = coloured_by(run.cloud, run.cloud_points, run.cell.part, "deviation")
    camera = camera_path("part", run, size)(time, 0.0)
    shape = size[::-1]
    empty = Rendered(np.full((*shape, 3), -1.0), np.zeros(shape), np.zeros(shape, np.int64), np.full(shape, depth))
    cloud.draw(empty, camera, run.motion.frames(time)["part"], time)
    return (empty.light != -1.0).any(-1)


def test_the_cloud_grows_and_lies_on_the_part(run) -> None:
    first, last = float(run.cloud.time[0]), float(run.cloud.time[-1])
    assert not drawn(run, first - 1e-3).any()
    assert 0 < drawn(run, first).sum() < drawn(run, last).sum()
    camera = camera_path("part", run, (320, 200))(last, 0.0)
    vertices = pose.transform_points(run.motion.frames(last)["part"], run.cell.part.vertices)
    low, high = (camera.project(vertices)[0].min(0) - 4, camera.project(vertices)[0].max(0) + 4)
    rows, columns = np.nonzero(drawn(run, last))
    assert (columns >= low[0]).all() and (columns <= high[0]).all()
    assert (rows >= low[1]).all() and (rows <= high[1]).all()


def test_colours_show_the_values_that_the_scale_says(run) -> None:
    cloud = coloured_by(run.cloud, run.cloud_points, run.cell.part, "intensity")
    place = np.clip(run.cloud.intensity / cloud.limits[1], 0, 1) * (len(cloud.scale) - 1)
    shown = 255 * np.sqrt(cloud.colours)
    np.testing.assert_allclose(shown, cloud.scale[place.astype(int)], atol=1e-6)
    assert cloud.limits[1] == pytest.approx(np.quantile(run.cloud.intensity, 0.99))


def test_what_stands_before_the_cloud_hides_it(run) -> None:
    assert not drawn(run, float(run.cloud.time[-1]), depth=0.05).any()


def test_cloud_file_in_another_frame_shows_the_same_points(folder, run, tmp_path) -> None:
    other = tmp_path / "world"
    shutil.copytree(folder, other)
    world_from_part = run.cell.world_from("part")
    write_cloud(other / "cloud.ply", read_ply(folder / "cloud.ply"), ("frame world",), world_from_part)
    moved = open_run(other, most_points=20_000)
    np.testing.assert_allclose(moved.cloud.points_in_part, run.cloud.points_in_part, atol=1e-9)


# --- files ----------------------------------------------------------------------------------------------------------


def test_picture_has_the_size_that_was_asked_for(folder, tmp_path) -> None:
    for view in ("cell", "part", "orbit", "sensor"):
        done = scancell_here("picture", folder, "--out", f"{view}.png", "--view", view, *SMALL, cwd=tmp_path)
        assert done.code == 0, done.err
        with Image.open(tmp_path / f"{view}.png") as image:
            assert image.size == (160, 96)
            assert np.asarray(image).std() > 10  # there is something in it


def test_animation_reads_back_with_frames_size_and_rate(folder, tmp_path) -> None:
    words = ("--seconds", "1.2", "--fps", "10", "--out", "scan.webm")
    done = scancell_here("animate", folder, *words, *SMALL, cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.last_line["figures"] == {"frames": 12, "seconds": 1.2}
    assert [path.name for path in tmp_path.iterdir()] == ["scan.webm"]
    film = cv2.VideoCapture(str(tmp_path / "scan.webm"))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0, rel=1e-3)
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1].astype(int))
    assert [frame.shape for frame in frames] == [(96, 160, 3)] * 12
    assert np.abs(frames[0] - frames[5]).max() > 50  # the arm has moved


def test_animated_picture_holds_the_frames(folder, tmp_path) -> None:
    words = ("--seconds", "1.2", "--fps", "10", "--out", "scan.webp")
    done = scancell_here("animate", folder, *words, *SMALL, cwd=tmp_path)
    assert done.code == 0, done.err
    with Image.open(tmp_path / "scan.webp") as picture:
        assert (picture.format, picture.size, picture.info["loop"]) == ("WEBP", (160, 96), 0)
        frames, milliseconds = [], 0
        for number in range(picture.n_frames):
            picture.seek(number)
            frames.append(np.asarray(picture.convert("RGB"), int))
            milliseconds += picture.info["duration"]
    assert milliseconds == 1200  # equal frames are joined
    assert np.abs(frames[0] - frames[len(frames) // 2]).max() > 50  # the arm has moved


def test_animated_picture_that_is_too_large_is_refused(run, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(pictures, "_MOST_BYTES", 5 * 64 * 64 * 3)
    with pytest.raises(OutputError, match="more than 1 GB of frames"):
        pictures.animate(run, tmp_path / "scan.webp", size=(64, 64), seconds=1)
    assert not list(tmp_path.iterdir())


def test_speed_sets_the_length(folder, run, tmp_path) -> None:
    speed = run.motion.duration / 0.5
    done = scancell_here("animate", folder, "--speed", f"{speed}", "--fps", "10", *SMALL, cwd=tmp_path)
    assert done.last_line["figures"]["frames"] == 5


def test_frames_come_in_order_and_do_not_depend_on_threads(run) -> None:
    taken = run_pictures(run, "cell", (96, 64), "deviation", 1)
    times = np.linspace(0, run.motion.duration, 5).tolist()
    one, three = (list(_in_order(taken.at, times, [0.0] * 5, threads)) for threads in (1, 3))
    for a, b, time in zip(one, three, times, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, taken.at(time, 0.0))


def test_cancelled_animation_leaves_no_file(run, tmp_path) -> None:
    class Stop:
        def stage(self, name: str, total: float, unit: str) -> None: ...

        def advance(self, steps: float) -> None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pictures.animate(run, tmp_path / "scan.webm", size=(64, 64), seconds=1, progress=Stop())
    assert list(tmp_path.iterdir()) == []


# --- messages -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("picture", "RUN", "--time", "1e6"), "--time 1000000.0: expected 0 to"),
        (("picture", "RUN", "--size", "wide"), "--size wide: expected WIDTHxHEIGHT"),
        (("picture", "RUN", "--size", "10x10"), "--size 10x10: expected 64 to 7680"),
        (("picture", "nowhere"), "nowhere: expected a run folder"),
        (("animate", "RUN", "--out", "scan.avi"), "--out scan.avi: expected a file name that ends in .webm or .webp"),
        (("animate", "RUN", "--size", "101x100"), "--size 101x100: expected even numbers"),
        (("animate", "RUN", "--seconds", "1", "--speed", "2"), "--seconds 1 and --speed 2; expected one of them"),
        (("animate", "RUN", "--out", "taken/scan.webm"), "taken/scan.webm: cannot be written"),
    ],
)
def test_wrong_options_are_named(folder, tmp_path, words, expected) -> None:
    (tmp_path / "taken").write_text("a file")
    done = scancell_here(*(folder if word == "RUN" else word for word in words), "--json", cwd=tmp_path)
    assert done.code == 1
    assert expected in done.message
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_missing_encoder_is_named(folder, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(cv2.VideoWriter, "fourcc", lambda *letters: 0)  # a codec that no build has
    done = scancell_here("animate", folder, "--seconds", "1", *SMALL, cwd=tmp_path)
    assert "the installed OpenCV cannot encode VP9" in done.message
    assert not list(tmp_path.rglob("*.webm"))


def test_recording_without_truth_is_refused_by_name(folder, recording, tmp_path) -> None:
    other = tmp_path / "run"
    shutil.copytree(folder, other)
    columns = {name: pyarrow.array(values) for name, values in recording.without_truth().columns.items()}
    pyarrow.parquet.write_table(pyarrow.table(columns), other / "recording.parquet")
    done = scancell_here("picture", other, "--json", cwd=tmp_path)
    assert "recording.parquet: column trigger.truth." in done.message


def test_run_without_a_cloud_is_shown_with_a_warning(folder, tmp_path) -> None:
    other = tmp_path / "run"
    shutil.copytree(folder, other, ignore=shutil.ignore_patterns("cloud.ply"))
    done = scancell_here("picture", other, *SMALL, cwd=tmp_path)
    assert done.code == 0
    assert "no cloud is shown" in done.last_line["warnings"][0]
