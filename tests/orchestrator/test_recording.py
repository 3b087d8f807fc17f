"""Recordings: file round trip, poses during the exposure, separation of the truth, invalid files."""

from __future__ import annotations

import numpy as np
import pytest

from scancell.cell.recording import (
    INTEGER_COLUMNS,
    Recording,
    RecordLayout,
    TriggerRecords,
    read_recording,
    slopes,
    write_recording,
)
from scancell.errors import DescriptionError, OutputError
from scancell.geometry import pose

COUNT = 7
LAYOUT = RecordLayout()


def recording(count: int = COUNT) -> Recording:
    rng = np.random.default_rng(5)
    columns = {name: rng.normal(size=count) for name in (*LAYOUT.measured, *LAYOUT.truth)}
    columns["trigger.time"] = np.cumsum(rng.uniform(1e-3, 0.1, count))
    columns["trigger.exposure"] = np.full(count, 2e-3)
    for frame in LAYOUT.frames:
        names = [f"trigger.truth.{frame}.orientation[{i}]" for i in range(1, 5)]
        quaternion = np.array([columns[name] for name in names])
        columns |= dict(zip(names, quaternion / np.linalg.norm(quaternion, axis=0), strict=True))
    columns["trigger.index"] = np.arange(1, count + 1)
    columns["trigger.segment"] = np.repeat([3, 9], [count // 2, count - count // 2])
    return Recording(columns)


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
@pytest.mark.parametrize("has_truth", [True, False])
def test_file_round_trip_is_lossless(tmp_path, suffix, has_truth) -> None:
    written = recording() if has_truth else recording().without_truth()
    path = tmp_path / f"recording.{suffix}"
    assert written.save(str(path)) == path
    read = read_recording(path)
    assert set(read.columns) == set(written.columns)
    for name, values in written.columns.items():
        assert np.array_equal(read.columns[name], values, equal_nan=True), name
    assert all(read.columns[name].dtype == np.int64 for name in INTEGER_COLUMNS)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def accelerating(time: np.ndarray, segment: np.ndarray) -> TriggerRecords:
    """Joints and table that accelerate by 1 … 6 rad/s² and 7 rad/s²."""
    acceleration = np.arange(1.0, 8.0)
    count = len(time)
    axes, rates = 0.5 * acceleration * time[:, None] ** 2, acceleration * time[:, None]
    names = (*(f"joint[{i}]" for i in range(1, 7)), "table")
    return TriggerRecords(np.arange(count), segment, time, np.zeros(count), names, axes, rates)


@pytest.mark.parametrize("pitch", [1e-3, 14e-3])
def test_readings_after_a_delay_include_the_acceleration(pitch) -> None:
    time = 1.0 + pitch * np.arange(30)
    late = accelerating(time, np.full(30, 4)).after(12e-3)
    expected = accelerating(time + 12e-3, np.full(30, 4))
    assert late.axes == pytest.approx(expected.axes, abs=1e-12)


def test_accelerations_are_of_one_segment_and_zero_for_a_single_row() -> None:
    time = np.array([0.0, 0.02, 0.04, 0.06, 0.08, 0.10])
    segment = np.array([1, 1, 2, 3, 3, 3])
    measured = accelerating(time, segment)
    measured.rates[3:, :6] += 100.0
    acceleration = slopes(measured.rates, time, segment)
    assert acceleration[[0, 1, 3, 4, 5]] == pytest.approx(np.tile(np.arange(1.0, 8.0), (5, 1)))
    assert acceleration[2] == pytest.approx(0)
    empty = accelerating(np.zeros(0), np.zeros(0, np.int64))
    assert slopes(empty.rates, empty.time, empty.segment).shape == (0, 7)


def test_travel_of_belts_is_read_by_number(tmp_path) -> None:
    columns = dict(recording().columns)
    for belt in (1, 2):
        columns[f"trigger.measured.conveyor[{belt}].travel"] = belt * np.arange(COUNT, dtype=float)
        columns[f"trigger.measured.conveyor[{belt}].speed"] = np.full(COUNT, 0.1 * belt)
    measured = read_recording(Recording(columns).save(tmp_path / "belts.csv")).measured
    measured.require_axes(["table", "conveyor[2]"])
    assert np.array_equal(measured.axes[:, -1], 2.0 * np.arange(COUNT))
    assert np.array_equal(measured.rates[:, -1], np.full(COUNT, 0.2))
    with pytest.raises(DescriptionError, match=r"no travel of conveyor\[3\]"):
        measured.require_axes(["conveyor[3]"])
    assert recording().measured.names[-1] == "table"


def test_rows_without_trigger_are_skipped(tmp_path) -> None:
    fired = recording()
    twice = {name: np.repeat(values, 2) for name, values in fired.columns.items()}
    before = {name: np.zeros(3, values.dtype) for name, values in fired.columns.items()}
    path = tmp_path / "log.parquet"
    write_recording(Recording({name: np.concatenate([before[name], twice[name]]) for name in twice}), path)
    read = read_recording(str(path))
    assert len(read) == COUNT
    assert np.array_equal(read.measured.time, fired.measured.time)


def test_measured_columns_map_to_fields() -> None:
    given = recording()
    measured = given.measured
    assert measured.axes.shape == measured.rates.shape == (COUNT, 7)
    assert measured.q.shape == (COUNT, 6)
    assert np.array_equal(measured.q[:, 2], given.columns["trigger.measured.q[3]"])
    assert np.array_equal(measured.rates[:, 5], given.columns["trigger.measured.qd[6]"])
    assert np.array_equal(measured.table, given.columns["trigger.measured.table"])
    assert np.array_equal(measured.segment, given.columns["trigger.segment"])


def test_without_truth_removes_only_truth() -> None:
    given = recording()
    lost = given.without_truth()
    for name, values in lost.columns.items():
        if ".truth." in name:
            assert np.isnan(values).all()
        else:
            assert values is given.columns[name]


def test_exposure_poses_follow_from_twist() -> None:
    """Constant rotation rate about a fixed axis and constant velocity: exact for any exposure."""
    given = dict(recording().columns)
    duration, rate, speed = 0.5, np.array([0.3, -0.4, 1.2]), np.array([0.05, 0.0, -0.02])
    middle = pose.pose((0.1, 0.2, 0.3), (0.8, 0.0, 0.6, 0.0))
    given["trigger.exposure"] = np.full(COUNT, duration)
    for i, name in enumerate("123"):
        given[f"trigger.truth.sensor.position[{name}]"] = np.full(COUNT, middle[i, 3])
        given[f"trigger.truth.sensor.velocity[{name}]"] = np.full(COUNT, speed[i])
        given[f"trigger.truth.sensor.angular_velocity[{name}]"] = np.full(COUNT, rate[i])
    for i, value in enumerate((0.8, 0.0, 0.6, 0.0), 1):
        given[f"trigger.truth.sensor.orientation[{i}]"] = np.full(COUNT, value)
    truth = Recording(given).truth
    assert set(truth.world_from_frame) == set(LAYOUT.frames)
    poses = truth.world_from_frame["sensor"]
    assert poses.shape == (COUNT, 2, 4, 4)
    for end, sign in ((0, -1), (1, 1)):
        time_offset = sign * duration / 2
        assert poses[0, end, :3, 3] == pytest.approx(middle[:3, 3] + time_offset * speed, abs=1e-15)
        # Rodrigues' formula, written out.
        angle, axis = time_offset * np.linalg.norm(rate), rate / np.linalg.norm(rate)
        k = np.cross(np.eye(3), axis)  # k @ v = axis × v
        turn = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
        assert poses[0, end, :3, :3] == pytest.approx(turn @ middle[:3, :3], abs=1e-14)


@pytest.mark.parametrize("name", ["trigger.measured.q[4]", "trigger.truth.table.position[2]", "trigger.index"])
def test_missing_column_error(tmp_path, name) -> None:
    path = tmp_path / "recording.csv"
    write_recording(Recording({n: v for n, v in recording().columns.items() if n != name}), path)
    with pytest.raises(DescriptionError, match=r"recording\.csv.*missing") as caught:
        read_recording(path)
    assert name in str(caught.value)


def test_nan_in_measured_column_error(tmp_path) -> None:
    columns = dict(recording().columns)
    columns["trigger.measured.q[2]"] = np.where(np.arange(COUNT) == 4, np.nan, 0.0)
    path = tmp_path / "recording.parquet"
    write_recording(Recording(columns), path)
    with pytest.raises(DescriptionError, match="row 5") as caught:
        read_recording(path)
    assert "trigger.measured.q[2]" in str(caught.value)


def test_text_in_numeric_column_error(tmp_path) -> None:
    path = tmp_path / "recording.csv"
    write_recording(recording(), path)
    lines = path.read_text().splitlines()
    column = lines[0].split(",").index('"trigger.measured.table"')
    words = lines[3].split(",")
    words[column] = "text"
    path.write_text("\n".join([*lines[:3], ",".join(words), *lines[4:]]))
    with pytest.raises(DescriptionError, match=r"trigger\.measured\.table"):
        read_recording(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("recording.parquet", b"PAR1 not really", "expected a Parquet or CSV table"),
        ("recording.csv", b"trigger.ind\xd2ex,b\n1,2\n", "expected a Parquet or CSV table"),
        ("gone.csv", None, "no such file"),
        ("gone.parquet", None, "no such file"),
    ],
)
def test_invalid_file_error(tmp_path, name: str, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DescriptionError, match=message):
        read_recording(tmp_path / name)


def test_recording_without_triggers_is_rejected(tmp_path) -> None:
    path = tmp_path / "recording.csv"
    columns = {**recording().columns, "trigger.index": np.zeros(COUNT, np.int64)}
    write_recording(Recording(columns), path)
    with pytest.raises(DescriptionError, match="holds no trigger"):
        read_recording(path)


def test_unwritable_path_error(tmp_path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(OutputError, match=r"taken/recording\.csv"):
        write_recording(recording(), tmp_path / "taken" / "recording.csv")


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(DescriptionError, match=r"^frame = 'tool': expected link\[1\], .*, sensor, table, part\[1\]$"):
        recording().truth_at_middle("tool")
    with pytest.raises(DescriptionError, match=r"^frame = array\(.*: expected "):
        recording().truth_at_middle(np.zeros(3))  # type: ignore[arg-type]
    other = Recording({"trigger.index": np.arange(3)})
    for parts in ([], [recording(), other]):
        with pytest.raises(DescriptionError, match=r"^parts = .*: expected recordings with the same columns$"):
            Recording.joined(parts)
