"""ROS 2 bags: those of other programs and our own give the cloud of their scan; wrong ones are refused by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import scancell
from scancell.cli import app
from scancell.config.loading import assets_dir
from scancell.errors import DescriptionError, EmptyScanError
from scancell.geometry import pose

PART = assets_dir() / "parts" / "sphere_on_foot.stl"
SETTINGS = {"scan.max_profiles": 40, "sensor.geometric.rays": 128}
EPOCH = 1_790_000_000_123_456_789  # ns
STORE = get_typestore(Stores.ROS2_JAZZY)
CLOUD, SCAN = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"
# As a driver of Universal Robots orders them: not by the arm.
ARM = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
STATED = f"""
[format]
preset = "ros2_bag"
[format.bag]
joints = {ARM}
axes = {{ table_deg = "turntable" }}
"""


@pytest.fixture(scope="module")
def scanned() -> scancell.ScanResult:
    return scancell.scan(PART, engine="geometric", settings=SETTINGS, seed=2)


def make(kind: str, *values: Any) -> Any:
    return STORE.types[kind](*values)


def header(time: float, frame: str = "") -> Any:
    stamp = EPOCH + round(1e9 * time)
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", *divmod(stamp, 10**9)), frame)


def cloud_message(time: float, names: Sequence[str], columns: Sequence[np.ndarray], height: int = 1) -> Any:
    """A cloud of 32-bit numbers with a gap of four bytes behind each point, as drivers align them."""
    table = np.zeros((len(columns[0]), len(names) + 1), "<f4")
    table[:, :-1] = np.stack(columns, -1)
    fields = [make("sensor_msgs/msg/PointField", name, 4 * i, 7, 1) for i, name in enumerate(names)]
    size = 4 * table.shape[1]
    data = np.frombuffer(table.tobytes(), np.uint8)
    return make(CLOUD, header(time), height, len(table), fields, False, size, size * len(table), data, False)


def scan_message(time: float, along: np.ndarray, height: np.ndarray) -> Any:
    """Ranges at even angles that points of a profile are near to; out of range, infinite or NaN where there is none."""
    angles = np.linspace(-0.3, 0.3, 4000)
    order = np.argsort(np.arctan2(along, height))
    own, ranges = np.arctan2(along, height)[order], np.hypot(along, height)[order]
    after = np.clip(np.searchsorted(own, angles), 1, len(own) - 1)
    nearest = np.where(angles - own[after - 1] < own[after] - angles, after - 1, after)
    none = np.resize([9.0, np.inf, np.nan], len(angles))
    ranges = np.where(np.abs(own[nearest] - angles) < 1e-4, ranges[nearest], none).astype(np.float32)
    return make(
        SCAN,
        header(time),
        -0.3,
        0.3,
        float(angles[1] - angles[0]),
        0.0,
        0.0,
        0.05,
        2.0,
        ranges,
        np.zeros(0, np.float32),
    )


def joints_message(time: float, names: Sequence[str], positions: np.ndarray, rates: np.ndarray | None = None) -> Any:
    rates = np.zeros(0) if rates is None else rates
    return make("sensor_msgs/msg/JointState", header(time), list(names), positions, rates, np.zeros(0))


def transform_message(time: float, parent: str, child: str, matrix: np.ndarray) -> Any:
    moved = make(
        "geometry_msgs/msg/Transform",
        make("geometry_msgs/msg/Vector3", *matrix[:3, 3]),
        make("geometry_msgs/msg/Quaternion", *Rotation.from_matrix(matrix[:3, :3]).as_quat()),
    )
    return make(
        "tf2_msgs/msg/TFMessage", [make("geometry_msgs/msg/TransformStamped", header(time, parent), child, moved)]
    )


Message = tuple[str, str, float, Any]


def write(folder: Path, messages: Sequence[Message], storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    """A bag as ``ros2 bag record`` leaves it."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        channels: dict[str, Any] = {}
        for topic, kind, time, message in messages:
            if topic not in channels:
                channels[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(channels[topic], EPOCH + round(1e9 * (time + 0.003)), STORE.serialize_cdr(message, kind))
    return folder


def profiles_of(
    result: scancell.ScanResult,
    message: Callable[..., Any],
    kind: str = CLOUD,
    topic: str = "/scanner",
    delay: float = 0.0,
) -> list[Message]:
    """A message of each profile, with x along it and y across, in the right-handed frame with the height z."""
    made: list[Message] = []
    for row, time in enumerate(result.recording.measured.time - delay):
        x, y, z = np.asarray(result.profiles.points_in_sensor, float)[result.profiles.frame == row].T
        made.append((topic, kind, float(time), message(time, y, -x, z)))
    return made


def as_cloud(time: float, along: np.ndarray, across: np.ndarray, height: np.ndarray) -> Any:
    return cloud_message(time, ["x", "y", "z", "intensity"], [along, across, height, np.full(len(along), 7.0)])


def motion_of(result: scancell.ScanResult) -> CubicSpline:
    """Positions of joints and table at any time of a scan, which pass through its readings."""
    measured = result.recording.measured
    return CubicSpline(measured.time, measured.axes)


def states_of(result: scancell.ScanResult, rate: float = 125.0) -> list[Message]:
    """States of arm and table, each of a driver of its own, at times that are not those of the exposures."""
    time = result.recording.measured.time
    position = motion_of(result)
    at = np.arange(time[0] - 0.0007, time[-1] + 1 / rate, 1 / rate)
    order = np.argsort(ARM)
    arm = [
        (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            float(t),
            joints_message(t, np.array(ARM)[order], q[:-1][order]),
        )
        for t, q in zip(at, position(at), strict=True)
    ]
    table = [
        ("/table/joint_states", "sensor_msgs/msg/JointState", float(t), joints_message(t, ["turntable"], q[-1:]))
        for t, q in zip(at, position(at), strict=True)
    ]
    return [*arm, *table]


@pytest.fixture
def form(tmp_path) -> Path:
    file = tmp_path / "robot.toml"
    file.write_text(STATED)
    return file


def furthest(found: scancell.Cloud, scanned: scancell.Cloud) -> float:
    assert len(found) == len(scanned)
    return float(np.abs(found.points_in_part - scanned.points_in_part).max())


def test_own_bag_gives_the_cloud_of_the_run_again(scanned, tmp_path) -> None:
    scanned.save(tmp_path / "run")
    done = CliRunner().invoke(app, ["export", str(tmp_path / "run"), "--ros", "--out", str(tmp_path / "run.mcap")])
    assert done.exit_code == 0, done.output
    found = scancell.reconstruct(tmp_path / "run.mcap", part=PART)
    assert furthest(found.cloud, scanned.cloud) < 1e-9
    assert np.asarray(found.cloud.sigma) == pytest.approx(np.asarray(scanned.cloud.sigma), rel=1e-6)
    assert found.data.readings.rates == pytest.approx(scanned.recording.measured.rates, abs=1e-12)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_streams_of_a_robot_are_joined_by_their_stamps(scanned, form, tmp_path, storage) -> None:
    """Joints in another order than that of the arm, at 125 Hz without rates; profiles of 32-bit numbers."""
    messages = [*states_of(scanned), *profiles_of(scanned, as_cloud)]
    bag = write(tmp_path / "bag", messages, storage)
    found = scancell.reconstruct(bag, part=PART, table_format=form)
    assert furthest(found.cloud, scanned.cloud) < 1e-6
    assert (np.asarray(found.cloud.intensity) == 7.0).all()
    rates = motion_of(scanned).derivative()(scanned.recording.measured.time)
    assert found.data.readings.rates[2:-2] == pytest.approx(rates[2:-2], abs=2e-3)


def test_transforms_give_the_poses_of_the_flange(scanned, tmp_path) -> None:
    """The chain has a moving and a fixed link."""
    measured, arm = scanned.recording.measured, scanned.nominal.arm
    flange = pose.inverse(arm.world_from_base) @ arm.fk(measured.q)
    wrist_from_flange = pose.from_euler_xyz((0.3, -0.2, 0.1), (0.01, 0.02, 0.03))
    messages: list[Message] = [
        ("/tf_static", "tf2_msgs/msg/TFMessage", 0.0, transform_message(0.0, "wrist", "tool0", wrist_from_flange))
    ]
    for time, matrix, table in zip(measured.time, flange, measured.table, strict=True):
        moved = transform_message(time, "base_link", "wrist", matrix @ pose.inverse(wrist_from_flange))
        messages.append(("/tf", "tf2_msgs/msg/TFMessage", float(time), moved))
        state = joints_message(time, ["table"], np.array([table]))
        messages.append(("/table", "sensor_msgs/msg/JointState", float(time), state))
    bag = write(tmp_path / "bag", [*messages, *profiles_of(scanned, as_cloud)])
    form = tmp_path / "tf.toml"
    form.write_text('[format]\npreset = "ros2_bag"\nbag = { flange_frame = "tool0" }\n')
    with_rates = scancell.reconstruct(bag, part=PART, table_format=form)
    # Poses state no rates, by which points of one exposure would move apart.
    assert furthest(with_rates.cloud, scanned.cloud) < 20e-6
    assert np.median(np.abs(with_rates.cloud.points_in_part - scanned.cloud.points_in_part)) < 2e-6
    form.write_text('[format]\npreset = "ros2_bag"\nbag = { flange_frame = "tool1" }\n')
    with pytest.raises(DescriptionError, match=r"from base_link to tool1.*tool0"):
        scancell.reconstruct(bag, part=PART, table_format=form)


def test_ranges_of_a_laser_scan_are_points_of_the_sheet(scanned, form, tmp_path) -> None:
    def message(time: float, along: np.ndarray, across: np.ndarray, height: np.ndarray) -> Any:
        return scan_message(time, along, height)

    bag = write(tmp_path / "bag", [*states_of(scanned), *profiles_of(scanned, message, SCAN, "/scan")])
    found = scancell.reconstruct(bag, part=PART, table_format=form)
    assert len(found.cloud) > 1000
    assert abs(float(np.median(found.deviation.distance))) < 20e-6


def test_delay_of_the_stamps_is_estimated(scanned, form, tmp_path) -> None:
    bag = write(tmp_path / "bag", [*states_of(scanned), *profiles_of(scanned, as_cloud, delay=0.004)])
    late = scancell.reconstruct(bag, part=PART, table_format=form)
    found = scancell.reconstruct(bag, part=PART, table_format=form, latency_ms="estimate")
    assert 1e3 * found.data.latency.value == pytest.approx(4.0, abs=0.2)
    assert found.deviation.rms < late.deviation.rms / 3


def test_calibration_takes_bags(form, tmp_path) -> None:
    """Of a ball that the table turns past a sensor that stands 0.3 mm beside its place."""
    with scancell.Scanner() as scanner:
        report = scanner.calibrate("tool", as_built={"tool.x_mm": 0.3}, engine="geometric")
        data = report.calibration.problem.observations
        joints, messages = np.array(ARM), list[Message]()
        order = np.argsort(ARM)
        for row in range(len(data.readings)):
            time, axes = 0.1 * row, data.readings.axes[row]
            x, y, z = data.points_in_sensor[data.frame == row].T
            messages += [
                (
                    "/joint_states",
                    "sensor_msgs/msg/JointState",
                    time,
                    joints_message(time, joints[order], axes[:-1][order]),
                ),
                ("/table", "sensor_msgs/msg/JointState", time, joints_message(time, ["turntable"], axes[-1:])),
                ("/scanner", CLOUD, time, as_cloud(time, y, -x, z)),
            ]
        bag = write(tmp_path / "bag", messages)
        again = scanner.calibrate("tool", from_points=bag, table_format=form)
    found, expected = ({row.name: row.value for row in one.rows} for one in (again, report))
    assert found["tool.x"] == pytest.approx(0.3, abs=0.01)
    assert found == pytest.approx(expected, abs=0.02)


def test_exposures_without_readings_are_left_out_and_counted(scanned, form, tmp_path) -> None:
    measured = scanned.recording.measured
    span = float(measured.time[-1] - measured.time[0])
    early = [one for one in states_of(scanned) if one[2] < measured.time[0] + span / 2]
    bag = write(tmp_path / "bag", [*early, *profiles_of(scanned, as_cloud)])
    found = scancell.reconstruct(bag, part=PART, table_format=form)
    kept = len(found.data.found.index)
    assert 0 < kept < len(measured.time)
    assert any(f"{len(measured.time) - kept} profiles without readings" in text for text in found.warnings)
    assert furthest(found.cloud, scanned.cloud[np.isin(scanned.cloud.profile, measured.index[:kept])]) < 1e-6


def stated(bag: Mapping[str, str]) -> str:
    return '[format]\npreset = "ros2_bag"\n[format.bag]\n' + "\n".join(f"{key} = {value}" for key, value in bag.items())


@pytest.mark.parametrize(
    ("bag", "message"),
    [
        ({}, r"format\.bag\.joints: the order of its joints is not known: elbow_joint, "),
        ({"joints": str([*ARM[:5], "wrist_4_joint"])}, r"joint 'wrist_4_joint'.*wrist_3_joint"),
        ({"joints": str(ARM[:5])}, r"column 'q6_deg'"),
        ({"joints": str(ARM), "profiles": '["/images"]'}, r"format\.bag\.profiles.*/scanner"),
        ({"joints": str(ARM), "axes": '{ table = "turntable" }'}, r"format\.bag\.axes"),
        ({"joints": str(ARM), "frame": '"a"'}, r"format\.bag\.frame"),
    ],
)
def test_wrong_names_are_told(scanned, tmp_path, bag, message) -> None:
    folder = write(tmp_path / "bag", [*states_of(scanned, 50.0), *profiles_of(scanned, as_cloud)[:5]])
    form = tmp_path / "form.toml"
    form.write_text(stated(bag))
    with pytest.raises(DescriptionError, match=message):
        scancell.reconstruct(folder, part=PART, table_format=form)


def test_wrong_messages_are_told(scanned, form, tmp_path) -> None:
    states, points = states_of(scanned, 50.0), np.zeros(6)
    wrong = {
        r"2 topics of PointCloud2": [
            *profiles_of(scanned, as_cloud)[:2],
            *profiles_of(scanned, as_cloud, topic="/b")[:2],
        ],
        r"message 1: height.*3": [("/a", CLOUD, 0.1, cloud_message(0.1, ["x", "y", "z"], [points] * 3, 3))],
        r"field 'z'.*x, range": [("/a", CLOUD, 0.1, cloud_message(0.1, ["x", "range"], [points] * 2))],
        r"no profile lies between readings": [("/a", CLOUD, 99.0, cloud_message(99.0, ["x", "y", "z"], [points] * 3))],
        r"0 topics": [],
    }
    for number, (message, messages) in enumerate(wrong.items()):
        bag = write(tmp_path / f"bag{number}", [*states, *messages])
        with pytest.raises(DescriptionError, match=message):
            scancell.reconstruct(bag, part=PART, table_format=form)


def test_damaged_bags_are_refused(scanned, form, tmp_path) -> None:
    """Truncated and with changed bytes: a message that names the file, or a cloud where no number is read there."""
    bag = write(tmp_path / "bag", [*states_of(scanned, 30.0), *profiles_of(scanned, as_cloud)[:8]], StoragePlugin.MCAP)
    data = next(bag.glob("*.mcap")).read_bytes()
    file, rng = tmp_path / "damaged.mcap", np.random.default_rng(3)
    refused = 0
    for case in range(80):
        changed = bytearray(data if case % 2 else data[: rng.integers(1, len(data))])
        for place in rng.integers(0, len(changed), 3):
            changed[place] ^= int(rng.integers(1, 256))
        file.write_bytes(changed)
        try:
            scancell.reconstruct(file, part=PART, table_format=form)
        except (DescriptionError, EmptyScanError) as error:
            assert "damaged.mcap" in str(error)
            refused += 1
    assert refused > 40
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(DescriptionError, match=r"empty\.mcap"):
        scancell.reconstruct(tmp_path / "empty.mcap", part=PART, table_format=form)
