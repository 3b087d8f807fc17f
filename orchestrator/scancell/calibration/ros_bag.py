"""Profiles with readings of the robot from ROS 2 bags, whose messages are joined by their time stamps; without ROS."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from scancell.arrays import Array
from scancell.calibration.measured_table import ProfileTable, profile_table
from scancell.calibration.pose_files import PREFIX, flange_columns
from scancell.config.table_format import BagDescription, FormatDescription
from scancell.errors import DescriptionError, ScancellError, require
from scancell.files import atomic_write
from scancell.geometry import pose

_CLOUD, _SCAN = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"
_JOINTS, _TRANSFORMS = "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage"
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
_TABLE = "table"  # name of its joint, unless another one is stated
_LONGEST_GAP = 0.2  # s without a reading, in which an exposure has no position
# Columns of a table of points that fields of a cloud may have.
_COLUMNS = ("sigma_um", "time_offset_ms", "camera", "column_px", "flags")
# Columns of positions of axes, beside those of points and of poses.
_AXIS = re.compile(r"(?!flange_|[xyz]_mm)(?:q(?P<joint>\d+)|(?P<name>.+))_(?P<unit>deg|mm)")
_FLOAT64 = 8
_MOVES = 1e-5  # rad or m from message to message: joints do not move by less
_UNITS = {"deg": 180.0 / np.pi, "mm": 1e3}
_MOST_NAMED = 12


@dataclass
class _Series:
    """Samples of a joint, or of a transform to the frame `parent`: times (ns) and values, with velocities of joints."""

    parent: str = ""
    time: list[int] = field(default_factory=list)
    value: list[Any] = field(default_factory=list)
    velocity: list[float] = field(default_factory=list)

    def sorted(self, start: int) -> tuple[Array, NDArray[np.intp]]:
        """Times (n,), s after `start` (ns), each once and in their order, and their rows (n,)."""
        time, rows = np.unique(np.array(self.time, np.int64), return_index=True)
        return np.asarray(1e-9 * (time - start)), rows


@dataclass
class _Content:
    """Content of a bag: times (ns) and points of the profiles, and series of samples by names of joints and frames."""

    time: list[int] = field(default_factory=list)
    sensor: list[int] = field(default_factory=list)
    profiles: list[dict[str, Array]] = field(default_factory=list)
    joints: defaultdict[str, _Series] = field(default_factory=lambda: defaultdict(_Series))
    frames: defaultdict[str, _Series] = field(default_factory=lambda: defaultdict(_Series))
    unstamped: int = 0


def read_bag(path: Path, form: FormatDescription) -> ProfileTable:
    """Profiles of a bag (folder, MCAP or SQLite file) with joints, or poses of the flange, at their time stamps.

    Positions between two messages are interpolated. Exposures before the first and after the last of them, or in a gap
    of more than 0.2 s, are left out.

    Raises
    ------
    DescriptionError
        If the bag cannot be read, lacks the topics or names that the format states, or none of its profiles lies
        between readings.
    MissingExtraError
        If the packages of the extra `formats` are not installed.
    """
    bag = form.bag
    reader, typesys = require("rosbags.highlevel", "formats"), require("rosbags.typesys", "formats")
    try:
        with reader.AnyReader([path], default_typestore=typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)) as opened:
            topics = _profile_topics(path, bag, {one.topic: one.msgtype for one in opened.connections})
            content = _content(path, opened, topics, form)
    except ScancellError:
        raise
    except Exception as error:  # of a library that reads a broken file
        text = " ".join(str(error).split()) or type(error).__name__
        raise DescriptionError(text, file=path, expected="a ROS 2 bag (MCAP or SQLite) with CDR messages") from None
    if not content.time:
        raise DescriptionError("holds no message", file=path, key=f"topics {', '.join(topics)}")
    return _joined(path, form, bag, topics, content)


def _profile_topics(path: Path, bag: BagDescription, kinds: Mapping[str, str]) -> Sequence[str]:
    """Topics of profiles, that of sensor 1 first."""
    found = sorted(topic for topic, kind in kinds.items() if kind in (_CLOUD, _SCAN))
    for topic in bag.profiles:
        if topic not in found:
            raise DescriptionError(
                file=path, key="format.bag.profiles", value=topic,
                expected=f"a topic of PointCloud2 or LaserScan: {', '.join(found) or 'the bag has none'}",
            )  # fmt: skip
    if not bag.profiles and len(found) != 1:
        raise DescriptionError(
            f"holds {len(found)} topics of PointCloud2 or LaserScan{': ' if found else ''}{', '.join(found)}",
            file=path, key="format.bag.profiles", expected="one of them, or their names in a file of the format",
        )  # fmt: skip
    return bag.profiles or found


def _content(path: Path, opened: Any, topics: Sequence[str], form: FormatDescription) -> _Content:
    made = _Content()
    wanted = [one for one in opened.connections if one.topic in topics or one.msgtype in (_JOINTS, _TRANSFORMS)]
    for connection, logged, raw in opened.messages(connections=wanted):
        message = opened.deserialize(raw, connection.msgtype)
        if connection.msgtype == _TRANSFORMS:
            for one in message.transforms:
                moved = made.frames[one.child_frame_id]
                moved.parent = one.header.frame_id
                moved.time.append(0 if connection.topic.endswith("tf_static") else _stamp(one) or logged)
                moved.value.append(_matrix(one.transform))
            continue
        time = _stamp(message)
        made.unstamped += not time
        if connection.msgtype == _JOINTS:
            velocity = message.velocity if len(message.velocity) == len(message.name) else [np.nan] * len(message.name)
            for name, position, rate in zip(message.name, message.position, velocity, strict=True):
                one = made.joints[name]
                one.time.append(time or logged)
                one.value.append(float(position))
                one.velocity.append(float(rate))
            continue
        where = f"topic {connection.topic}, message {len(made.time) + 1}"
        made.time.append(time or logged)
        made.sensor.append(topics.index(connection.topic) + 1)
        made.profiles.append((_of_scan if connection.msgtype == _SCAN else _of_cloud)(path, where, message, form))
    return made


def _stamp(message: Any) -> int:
    """Time stamp, ns; 0 where a driver leaves it empty."""
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def _matrix(transform: Any) -> Array:
    turn, shift = transform.rotation, transform.translation
    rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    return pose.from_rotation(rotation, (shift.x, shift.y, shift.z))


def _of_scan(path: Path, where: str, message: Any, form: FormatDescription) -> dict[str, Array]:
    """Points (k,) from ranges about the axis z of a frame whose x looks forward, and y along the line."""
    ranges = np.asarray(message.ranges, float)
    angle = message.angle_min + message.angle_increment * np.arange(len(ranges))
    is_valid = np.isfinite(ranges) & (ranges >= message.range_min) & (ranges <= message.range_max)
    ranges = np.where(is_valid, ranges, np.nan)
    intensity = np.asarray(message.intensities, float)
    return {
        "along": ranges * np.sin(angle),
        "height": ranges * np.cos(angle),
        "across": np.zeros(len(ranges)),
        "intensity": intensity if len(intensity) == len(ranges) else np.zeros(len(ranges)),
    }


def _of_cloud(path: Path, where: str, message: Any, form: FormatDescription) -> dict[str, Array]:
    """Points (k,) from the fields of a cloud that are named x and z in the format, and the third one."""
    if message.height != 1:
        raise DescriptionError(file=path, key=f"{where}: height", value=int(message.height), expected="1: one profile")
    order = ">" if message.is_bigendian else "<"
    fields = {one.name: (int(one.offset), order + _NUMBERS[one.datatype]) for one in message.fields}
    along, height = str(form.x.column), str(form.z.column)
    for name in (along, height):
        if name not in fields:
            raise DescriptionError(
                "is missing", file=path, key=f"{where}: field '{name}'", expected=f"among {', '.join(fields)}"
            )
    record = np.dtype(
        {
            "names": list(fields),
            "formats": [kind for _, kind in fields.values()],
            "offsets": [offset for offset, _ in fields.values()],
            "itemsize": int(message.point_step),
        }
    )
    table = np.frombuffer(np.asarray(message.data, np.uint8).tobytes(), record, int(message.width))
    found = {"along": table[along].astype(float), "height": table[height].astype(float)}
    across = next((name for name in "xyz" if name in fields and name not in (along, height)), None)
    # The frame (across, along, height) of the sensor is right-handed, as that of the message is.
    sign = 1.0 if (across or "x") + along + height in "xyzxy" else -1.0
    found["across"] = np.zeros(len(table)) if across is None else sign * table[across].astype(float)
    brightness = form.intensity_column
    found["intensity"] = table[str(brightness)].astype(float) if brightness in fields else np.zeros(len(table))
    return found | {name: table[name].astype(float) for name in _COLUMNS if name in fields}


def _joined(
    path: Path, form: FormatDescription, bag: BagDescription, topics: Sequence[str], content: _Content
) -> ProfileTable:
    """The profiles that lie between readings, with these."""
    stamps, start = np.array(content.time, np.int64), min(content.time)
    time = np.asarray(1e-9 * (stamps - start))
    by_poses = bag.flange_frame is not None
    readings, known = (_flange if by_poses else _joints)(path, bag, content, start, time)
    named = bag.axes or ({"table_deg": _TABLE} if _TABLE in content.joints else {})
    axes, also = _axes(path, named, content, start, time)
    readings, known = readings | axes, known & also
    if not known.any():
        raise DescriptionError(
            f"no profile lies between readings that are at most {_LONGEST_GAP:g} s apart", file=path, key="time stamps"
        )
    order = np.argsort(time, kind="stable")
    order = order[known[order]]
    size = np.array([len(content.profiles[row]["along"]) for row in order])
    row = np.repeat(order, size)
    stated = set[str].intersection(*({*profile} for profile in content.profiles))
    points = {name: np.concatenate([content.profiles[i][name] for i in order]) for name in sorted(stated)}
    columns = {name: values[row] for name, values in readings.items()}
    columns |= {name: points[name] for name in _COLUMNS if name in stated}
    columns["x_mm"] = form.x.scale_mm * points["across"]
    if len(topics) > 1:
        columns["sensor"] = np.array(content.sensor)[row]
    left_out = int((~known).sum())
    source = f"transforms to {bag.flange_frame}" if by_poses else "joint states"
    notes = [f"{form.name}, {', '.join(topics)} with {source}"]
    notes += [f"{left_out} profiles without readings at their time are left out"] * (left_out > 0)
    notes += [f"{content.unstamped} messages have no time stamp: times of recording count"] * (content.unstamped > 0)
    # Profiles of several sensors at one instant are one exposure.
    exposure = np.asarray(np.unique(stamps[row], return_inverse=True)[1].reshape(-1), float)
    made = profile_table(
        path, form, [points["along"], np.zeros(len(row)), points["height"]], exposure, time[row], points["intensity"],
        False,
    )  # fmt: skip
    files = (path,) if path.is_file() else tuple(sorted(file for file in path.iterdir() if file.is_file()))
    return replace(made, kind="; ".join(notes), files=files, readings=columns)


def _flange(
    path: Path, bag: BagDescription, content: _Content, start: int, time: Array
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Columns of the flange's poses (n,) at times (n,), and which of them are known."""
    frame, known = str(bag.flange_frame), np.ones(len(time), bool)
    matrix, passed = np.broadcast_to(np.eye(4), (len(time), 4, 4)), [frame]
    while frame != bag.base_frame:
        if frame not in content.frames or content.frames[frame].parent in passed:
            found = ", ".join(sorted({*content.frames, *(one.parent for one in content.frames.values())})[:_MOST_NAMED])
            raise DescriptionError(
                f"states no transforms from {bag.base_frame} to {bag.flange_frame}", file=path,
                key="format.bag.base_frame, flange_frame", expected=f"two of: {found or 'the bag has no transforms'}",
            )  # fmt: skip
        moved = content.frames[frame]
        at, rows = moved.sorted(start)
        values = np.stack(moved.value)[rows]
        if len(rows) == 1:
            matrix = values[0] @ matrix
        else:
            known &= _between(at, time)
            inside = np.clip(time, at[0], at[-1])
            turns = Slerp(at, Rotation.from_matrix(values[:, :3, :3]))(inside).as_matrix()
            shifts = np.stack([np.interp(inside, at, values[:, i, 3]) for i in range(3)], -1)
            matrix = pose.from_rotation(turns, shifts) @ matrix
        frame = moved.parent
        passed.append(frame)
    return flange_columns(np.asarray(matrix)), known


def _joints(
    path: Path, bag: BagDescription, content: _Content, start: int, time: Array
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Columns of the arm's joints (n,) at times (n,), and which of them are known."""
    return _axes(path, {f"q{i}_deg": name for i, name in enumerate(_names(path, bag, content.joints), 1)},
                 content, start, time)  # fmt: skip


def _names(path: Path, bag: BagDescription, found: Iterable[str]) -> Sequence[str]:
    """Names of the arm's joints in their order, which that of a message need not be."""
    if bag.joints:
        return bag.joints
    others = [name for name in found if name != _TABLE and name not in bag.axes.values()]
    numbers = {name: int(tail.group()) for name in others if (tail := re.search(r"\d+$", name))}
    if others and sorted(numbers.values()) == list(range(1, len(others) + 1)):
        return sorted(others, key=numbers.__getitem__)
    listed = ", ".join(sorted(others)[:_MOST_NAMED]) or "it has no joint states"
    raise DescriptionError(
        f"the order of its joints is not known: {listed}",
        file=path,
        key="format.bag.joints",
        expected="their names from the base to the flange, or format.bag.flange_frame",
    )


def _axes(
    path: Path, names: Mapping[str, str], content: _Content, start: int, time: Array
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Columns of positions and rates (n,) at times (n,), of joints by the column of their position."""
    columns, known = dict[str, Array](), np.ones(len(time), bool)
    for column, name in names.items():
        if name not in content.joints:
            listed = ", ".join(sorted(content.joints)[:_MOST_NAMED]) or "joint states, of which it has none"
            raise DescriptionError("is missing", file=path, key=f"joint '{name}'", expected=f"among {listed}")
        one = content.joints[name]
        at, rows = one.sorted(start)
        position, rate = np.array(one.value)[rows], np.array(one.velocity)[rows]
        rates, unit = _rate_column(column), column.rpartition("_")[2]
        if len(at) == 1:
            columns[column], columns[rates] = np.full(len(time), _UNITS[unit] * position[0]), np.zeros(len(time))
            continue
        steps = np.abs(np.diff(position))[np.diff(at) <= _LONGEST_GAP]
        if not np.isfinite(rate).all() or (not rate.any() and steps.max(initial=0.0) > _MOVES):
            rate = np.gradient(position, at)  # some drivers state no rates, or 0
        known &= _between(at, time)
        curve = CubicHermiteSpline(at, position, rate)
        inside = np.clip(time, at[0], at[-1])
        columns[column], columns[rates] = _UNITS[unit] * curve(inside), _UNITS[unit] * curve(inside, 1)
    return columns, known


def _rate_column(column: str) -> str:
    """Column of the rate of the axis whose position has a column."""
    axis, unit = column.rsplit("_", 1)
    return f"qd{axis[1:]}_{unit}_s" if re.fullmatch(r"q\d+", axis) else f"{axis}_rate_{unit}_s"


def _between(at: Array, time: Array) -> NDArray[np.bool_]:
    """Flags (n,) of the times that are those of readings (m,), or lie between two readings near to each other."""
    after = np.clip(np.searchsorted(at, time), 1, len(at) - 1)
    gap = at[after] - at[after - 1]
    is_near = (gap <= _LONGEST_GAP) & (time >= at[0]) & (time <= at[-1])
    return np.asarray(is_near | np.isin(time, at))


def write_bag(path: Path, columns: Mapping[str, NDArray[Any]]) -> int:
    """Write a table of points as a ROS 2 bag (MCAP), of which `read_bag` makes the same again; the number of messages.

    Each exposure is a PointCloud2 (x along the profile, z the height, m) on ``/profiles``, of further sensors on
    ``/sensor2/profiles`` …, with the JointState of arm, table and further axes on ``/joint_states``, or the transform
    from ``base_link`` to ``flange`` on ``/tf``; all have the time of the exposure.

    Raises
    ------
    MissingExtraError
        If the packages of the extra `formats` are not installed.
    OutputError
        If the file cannot be written.
    """
    exposure = np.asarray(columns["exposure"], np.int64)
    sensor = np.asarray(columns.get("sensor", np.ones(len(exposure))), np.int64)
    changes = np.flatnonzero(np.diff(exposure) | np.diff(sensor)) + 1
    bounds = [0, *changes.tolist(), len(exposure)]
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        bag = _BagWriter(stream)
        for first, end in pairwise(bounds):
            bag.time = round(1e9 * float(columns["time_s"][first]))
            if first == 0 or exposure[first] != exposure[first - 1]:
                bag.readings({name: float(values[first]) for name, values in columns.items()})
            bag.profile(int(sensor[first]), {name: values[first:end] for name, values in columns.items()})
        bag.finish()
    return bag.messages


class _BagWriter:
    """Writes messages with the stamp `time` (ns)."""

    def __init__(self, stream: BinaryIO) -> None:
        typesys = require("rosbags.typesys", "formats")
        self._store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self._file = require("mcap.writer", "formats").Writer(stream)
        self._file.start(profile="ros2", library="scancell")
        self._channels: dict[str, int] = {}
        self.time = self.messages = 0

    def readings(self, columns: Mapping[str, float]) -> None:
        """Positions and rates of an exposure, or its pose of the flange, by the columns of its first point."""
        found = {name: match for name in columns if (match := _AXIS.fullmatch(name))}
        if found:
            scale = np.array([_UNITS[match["unit"]] for match in found.values()])
            names = [f"joint{match['joint']}" if match["joint"] else match["name"] for match in found.values()]
            position = np.array([columns[name] for name in found]) / scale
            rate = np.array([columns.get(_rate_column(name), 0.0) for name in found]) / scale
            self._write("/joint_states", _JOINTS, self._header(""), names, position, rate, np.zeros(0))
        if f"{PREFIX}x_mm" in columns:
            turn = np.array([columns[f"{PREFIX}matrix_{i}"] for i in range(1, 10)]).reshape(3, 3)
            x, y, z, w = Rotation.from_matrix(turn).as_quat()
            moved = self._make(
                "geometry_msgs/msg/Transform",
                self._make("geometry_msgs/msg/Vector3", *(1e-3 * columns[f"{PREFIX}{axis}_mm"] for axis in "xyz")),
                self._make("geometry_msgs/msg/Quaternion", x, y, z, w),
            )
            one = self._make("geometry_msgs/msg/TransformStamped", self._header("base_link"), "flange", moved)
            self._write("/tf", _TRANSFORMS, [one])

    def profile(self, sensor: int, columns: Mapping[str, NDArray[Any]]) -> None:
        """Points of a sensor at an exposure, by the columns (k,) of a table of points."""
        values = {
            "x": 1e-3 * columns["y_mm"],
            "y": -1e-3 * columns["x_mm"],
            "z": 1e-3 * columns["z_mm"],
            "intensity": columns["intensity_dn"],
            **{name: columns[name] for name in _COLUMNS if name in columns},
        }
        table = np.stack([np.asarray(column, "<f8") for column in values.values()], -1)
        fields = [
            self._make("sensor_msgs/msg/PointField", name, 8 * number, _FLOAT64, 1)
            for number, name in enumerate(values)
        ]
        count, size = table.shape
        self._write(
            f"/sensor{sensor}/profiles" if sensor > 1 else "/profiles", _CLOUD,
            self._header("profile"), 1, count, fields, False, 8 * size, 8 * size * count,
            np.frombuffer(table.tobytes(), np.uint8), True,
        )  # fmt: skip

    def finish(self) -> None:
        """Complete the file."""
        self._file.finish()

    def _make(self, kind: str, *values: Any) -> Any:
        return self._store.types[kind](*values)

    def _header(self, frame: str) -> Any:
        stamp = self._make("builtin_interfaces/msg/Time", *divmod(self.time, 10**9))
        return self._make("std_msgs/msg/Header", stamp, frame)

    def _write(self, topic: str, kind: str, *values: Any) -> None:
        if topic not in self._channels:
            definition = self._store.generate_msgdef(kind, ros_version=2)[0].encode()
            schema = self._file.register_schema(kind, "ros2msg", definition)
            self._channels[topic] = self._file.register_channel(topic, "cdr", schema)
        data = bytes(self._store.serialize_cdr(self._make(kind, *values), kind))
        self._file.add_message(self._channels[topic], log_time=self.time, data=data, publish_time=self.time)
        self.messages += 1
