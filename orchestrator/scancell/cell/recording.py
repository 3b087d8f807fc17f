"""Records of all triggers of a run, with measured and true values apart, and their files.

A recording is a table whose columns are named like the FMU's variables, so that a table made by any FMI tool works.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import NoReturn

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from scancell.arguments import checked_arguments
from scancell.arrays import Array
from scancell.errors import DescriptionError
from scancell.files import RECORDING_VERSION, arrow_table, atomic_write, require_file, require_format_version
from scancell.geometry import pose
from scancell.values import Value

_PARTS_OF_POSE = (("position", 3), ("orientation", 4), ("velocity", 3), ("angular_velocity", 3))
_TRUTH = "trigger.truth."
_MEASURED = "trigger.measured."
_SPAN = 0.01  # s
_INDEXED = re.compile(
    r"trigger\.(?:measured|truth)\.(?P<kind>qd?|conveyor|link|part|finger|sensor)\[(?P<index>[0-9]{1,9})\]"
)
_LARGEST = 1e6  # m, rad, m/s, rad/s or s of an exposure
_LATEST = 1e10  # s: clocks may count from 1970
_LARGEST_INTEGER = 2.0**32 - 1
_VERSION_KEY = "format_version"
_DIGITS = re.compile(r"[0-9]{1,9}")
_UNIT = 1e-3  # deviation of the norm of a quaternion from 1, for files of few digits


def _indexed(name: str, count: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(1, count + 1)]


INTEGER_COLUMNS = ("trigger.index", "trigger.segment")


@dataclass(frozen=True)
class RecordLayout:
    """Columns of a record in a cell with n `joints` of the arm, n `parts`, n `fingers` of a gripper, n `conveyors`.

    `further` are the names of the axes beside joints, table and conveyors. `sensors` counts that of the tool, too.
    """

    joints: int = 6
    parts: int = 1
    fingers: int = 0
    conveyors: int = 0
    further: tuple[str, ...] = ()
    sensors: int = 1

    @classmethod
    def of(cls, columns: Iterable[str]) -> RecordLayout:
        """Layout of columns or FMU variables, by the largest index of each; at least 4 joints and 1 part.

        A column that is missing below the largest index is one of the layout.
        """
        largest = Counter({"q": 4, "part": 1, "sensor": 1})
        names = list(columns)
        for name in names:
            found = _INDEXED.match(name)
            if found:
                kind = {"qd": "q", "link": "q"}.get(found["kind"], found["kind"])
                # An index beyond the number of columns is wrong: no list of that length is needed to say so.
                largest[kind] = max(largest[kind], min(int(found["index"]), len(names)))
        first = f"{_MEASURED}axis."
        further = tuple(name.removeprefix(first) for name in names if name.startswith(first))
        counts = (largest["q"], largest["part"], largest["finger"], largest["conveyor"])
        return cls(*counts, further, largest["sensor"])

    @property
    def axes(self) -> dict[str, tuple[str, str]]:
        """Columns of the measured position and rate of each axis by its name."""
        numbers = range(1, self.joints + 1)
        return {
            **{f"joint[{i}]": (f"{_MEASURED}q[{i}]", f"{_MEASURED}qd[{i}]") for i in numbers},
            "table": (f"{_MEASURED}table", f"{_MEASURED}table_rate"),
            **{name: (f"{_MEASURED}axis.{name}", f"{_MEASURED}axis_rate.{name}") for name in self.further},
            **{
                belt: (f"{_MEASURED}{belt}.travel", f"{_MEASURED}{belt}.speed")
                for belt in _indexed("conveyor", self.conveyors)
            },
        }

    @property
    def measured(self) -> tuple[str, ...]:
        """Columns of real numbers that a real controller provides."""
        axes = list(self.axes.values())
        positions, rates = zip(*axes[: self.joints], strict=True)
        return ("trigger.time", "trigger.exposure", *positions, *rates, *chain.from_iterable(axes[self.joints :]))

    @property
    def frames(self) -> tuple[str, ...]:
        """Frames whose true pose a record holds."""
        return (
            *_indexed("link", self.joints),
            "sensor",
            "table",
            *(f"axis_frame.{name}" for name in self.further),
            *_indexed("part", self.parts),
            *_indexed("finger", self.fingers),
            *_indexed("sensor", self.sensors)[1:],
        )

    @property
    def truth(self) -> tuple[str, ...]:
        """Columns that hold truth."""
        return tuple(
            column
            for frame in self.frames
            for part, count in _PARTS_OF_POSE
            for column in _indexed(f"{_TRUTH}{frame}.{part}", count)
        )


@dataclass(frozen=True, eq=False, repr=False)
class TriggerRecords(Value):
    """Records of a real controller, one row per exposure (n rows).

    Positions `axes` and `rates` (n, k) of the named axes, rad and m, rad/s and m/s, were latched at mid-exposure `time`
    (n,), s; `exposure` (n,) in s.
    """

    index: NDArray[np.int64]
    segment: NDArray[np.int64]
    time: Array
    exposure: Array
    names: tuple[str, ...]
    axes: Array
    rates: Array

    @property
    def q(self) -> Array:
        """Joints (n, joints), rad."""
        return self.axes[:, : self.names.index("table")]

    @property
    def table(self) -> Array:
        """Angles (n,) of the table, rad."""
        return self.axes[:, self.names.index("table")]

    def require_joints(self, joints: int) -> None:
        """Raises `DescriptionError` if the records are of an arm with another number of joints."""
        if self.q.shape[1] != joints:
            raise DescriptionError(
                f"states {self.q.shape[1]} joints", key="recording", expected=f"{joints}, as the arm of the cell"
            )

    def require_axes(self, names: Sequence[str]) -> None:
        """Raises `DescriptionError` if the records do not state one of these axes."""
        for name in names:
            if name in self.names:
                continue
            belt = name.startswith("conveyor[")
            what, column = ("travel of", f"{name}.travel") if belt else ("position of the axis", f"axis.{name}")
            raise DescriptionError(f"states no {what} {name}", key="recording", expected=f"{_MEASURED}{column}")

    def after(self, latency: float) -> TriggerRecords:
        """With all axes `latency` (s) later than they were latched, by their rates and accelerations."""
        if not latency:
            return self
        accelerations = slopes(self.rates, self.time, self.segment)
        return replace(self, axes=later(self.axes, self.rates, accelerations, latency))


def later(position: Array, rate: Array, acceleration: Array, time: float) -> Array:
    """Positions `time` (s) later, by their rates and accelerations."""
    return position + time * (rate + time / 2 * acceleration)


def slopes(values: Array, time: Array, segment: NDArray[np.int64]) -> Array:
    """Slopes (n, ...) of values (n, ...) at rising times (n,), s, between rows of the same segment.

    Between the nearest ones `_SPAN` before and after, as noise of the values allows no shorter time; 0 for a row that
    is alone.
    """
    ends = np.append(np.flatnonzero(np.diff(segment)), len(segment) - 1)
    run = np.searchsorted(ends, np.arange(len(segment)))
    first, last = np.append(-1, ends)[run] + 1, ends[run]
    before = np.maximum(np.searchsorted(time, time - _SPAN, "right") - 1, first)
    after = np.minimum(np.searchsorted(time, time + _SPAN, "left"), last)
    duration = (time[after] - time[before]).reshape(-1, *[1] * (values.ndim - 1))
    change = np.where(duration > 0, values[after] - values[before], 0.0)
    return np.asarray(change / np.where(duration > 0, duration, 1.0))


@dataclass(frozen=True)
class ExposureTruth:
    """True poses while the shutter was open; only the renderer, evaluation and tests may read them.

    `duration` (n,) is the exposure of a pixel, s. `world_from_frame` maps a frame's name to (n, 2, 4, 4) poses at start
    and end of each exposure (of all rows together, when the shutter rolls), which follow from the pose and twist
    latched at its middle.
    """

    duration: Array
    world_from_frame: Mapping[str, Array]


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Value):
    """All trigger records of a run.

    Attributes
    ----------
    columns
        Values (n,) by the FMU's variable names, SI, one row per exposure.

    Examples
    --------
    >>> start = scancell.location(0.45, 0.0, 0.23, rx=np.pi)
    >>> with scancell.Scanner() as scanner, scanner.session("part.stl") as session:
    ...     session.move_tool(start)
    ...     recording = session.record_line(start @ scancell.location(0.02, 0, 0), spacing=1e-3, exposure=5e-4)
    >>> len(recording), recording.measured.q.shape
    (21, (21, 6))
    >>> true_x = recording.truth_at_middle("sensor")[:, 0, 3]
    >>> bool(np.allclose(np.diff(true_x), 1e-3, atol=1e-5))
    True
    """

    columns: Mapping[str, NDArray[np.float64] | NDArray[np.int64]]

    def __len__(self) -> int:
        return len(self.columns["trigger.index"])

    def __getitem__(self, rows: slice | NDArray[np.intp]) -> Recording:
        """The recording of some of its rows."""
        return Recording({name: values[rows] for name, values in self.columns.items()})

    @property
    def measured(self) -> TriggerRecords:
        """The part of the recording that reconstruction may use.

        Arrays of n rows: ``time`` of the middle of each exposure and its duration ``exposure``, s, ``index`` and
        ``segment`` of the program, positions ``axes`` and ``rates`` (n, k), rad and m, rad/s and m/s, of the axes that
        ``names`` holds (``joint[1]``, …, ``table``, ``conveyor[1]``, …); ``q`` and ``table`` are some of the positions.
        """
        axes = RecordLayout.of(self.columns).axes
        positions, rates = zip(*axes.values(), strict=True)
        return TriggerRecords(
            index=self.columns["trigger.index"].astype(np.int64),
            segment=self.columns["trigger.segment"].astype(np.int64),
            time=self._stack(["trigger.time"])[:, 0],
            exposure=self._stack(["trigger.exposure"])[:, 0],
            names=tuple(axes),
            axes=self._stack(positions),
            rates=self._stack(rates),
        )

    @property
    def has_truth(self) -> bool:
        """Whether it states true poses; a recording of a real cell does not."""
        return any(name.startswith(_TRUTH) for name in self.columns)

    @property
    def truth(self) -> ExposureTruth:
        """The part of the recording that the renderer uses, with a global shutter.

        ``duration`` (n,), s, and ``world_from_frame``, the poses (n, 2, 4, 4) at start and end of each exposure by the
        name of the frame.
        """
        return self.truth_for_rows(0.0)

    @checked_arguments
    def truth_at_middle(self, frame: str) -> Array:
        """Poses ``world_from_frame`` (n, 4, 4) of `frame` in the middle of every exposure.

        `frame` is ``link[1]`` …, ``sensor``, ``sensor[2]`` …, ``table``, ``part[1]`` … or ``finger[1]``, ``finger[2]``.

        Raises
        ------
        DescriptionError
            If the recording has no such frame.
        """
        frames = RecordLayout.of(self.columns).frames
        if frame not in frames:
            raise DescriptionError(key="frame", value=frame, expected=", ".join(frames))
        position, orientation = (
            self._stack(_indexed(f"{_TRUTH}{frame}.{part}", count)) for part, count in _PARTS_OF_POSE[:2]
        )
        return np.asarray(pose.from_rotation(pose.rotation_from_quaternion(orientation), position))

    @property
    def windows(self) -> Array:
        """Middle of each exposure after the recorded middle, 0, and its duration (n, 1, 2), s."""
        duration = self._stack(["trigger.exposure"])
        return np.stack([np.zeros_like(duration), duration], -1)

    def truth_for_rows(self, readout: float, windows: Array | None = None) -> ExposureTruth:
        """`truth` for a rolling shutter, whose last row is exposed `readout` seconds after the first one.

        `windows` (n or 1, k, 2) gives k exposures in each row instead of the recorded one: their middles after the
        recorded middle, and durations, s. The truth has n k of them, those of a row one after another.
        """
        windows = self.windows if windows is None else windows
        offset, duration = (np.broadcast_to(one, (len(self), one.shape[1])) for one in np.moveaxis(windows, -1, 0))
        frames = RecordLayout.of(self.columns).frames
        position, orientation, velocity, rate = (
            np.stack([self._stack(_indexed(f"{_TRUTH}{frame}.{part}", count)) for frame in frames])
            for part, count in _PARTS_OF_POSE
        )
        middle = pose.rotation_from_quaternion(orientation)[:, :, None]
        ends = []
        for end in (-0.5, 0.5):
            after = (offset + end * (duration + readout))[..., None]
            turn = pose.exp_rotation(rate[:, :, None] * after)
            ends.append(pose.from_rotation(turn @ middle, position[:, :, None] + velocity[:, :, None] * after))
        poses = np.stack(ends, 3).reshape(len(frames), -1, 2, 4, 4)
        return ExposureTruth(duration.ravel(), dict(zip(frames, poses, strict=True)))

    def _stack(self, names: Sequence[str]) -> Array:
        values = [np.asarray(self.columns[name], float) for name in names]
        return np.stack(values, -1) if values else np.empty((len(self), 0))

    @checked_arguments
    def save(self, path: str | Path) -> Path:
        """Write the file `path` for `read_recording`: CSV by its ending, else Parquet.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        write_recording(self, Path(path))
        return Path(path)

    @classmethod
    @checked_arguments
    def joined(cls, parts: Sequence[Recording]) -> Recording:
        """The rows of the recordings `parts`, at least one, with the same columns, one after another.

        Raises
        ------
        DescriptionError
            If there is none, or the columns differ.
        """
        if len({frozenset(part.columns) for part in parts}) != 1:
            raise DescriptionError(key="parts", value=list(parts), expected="recordings with the same columns")
        return cls({name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns})

    def since(self, time: float) -> Recording:
        """A copy whose times, s, count from `time`."""
        return Recording({**self.columns, "trigger.time": np.asarray(self.columns["trigger.time"] - time, float)})

    def without_truth(self) -> Recording:
        """A copy in which every truth column is NaN."""
        return Recording(
            {name: np.full(len(self), np.nan) if name.startswith(_TRUTH) else v for name, v in self.columns.items()}
        )


def write_recording(recording: Recording, path: Path) -> None:
    """Write Parquet (or CSV by suffix) atomically.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    table = arrow_table(recording.columns).replace_schema_metadata({_VERSION_KEY: str(RECORDING_VERSION)})
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".csv":
            pyarrow.csv.write_csv(table, temporary)
        else:
            pyarrow.parquet.write_table(table, temporary)


@checked_arguments
def read_recording(path: str | Path) -> Recording:
    """Read trigger records from the file `path`: CSV by its ending, else Parquet.

    Any FMI tool can write it. Rows without a new trigger (same or zero ``trigger.index``) are passed over.

    Raises
    ------
    DescriptionError
        If the file is missing, not a table, of a newer version, lacks a column, or holds values that are not finite
        numbers within bounds, or indices or times that do not rise.

    Examples
    --------
    A saved scan holds its recording:

    >>> settings = {"scan.sweep.angle_step_deg": 20, "scan.raster.pitch_mm": 10}
    >>> files = scancell.scan("part.stl", engine="geometric", settings=settings).save("run")
    >>> recording = scancell.read_recording("run/recording.parquet")
    >>> bool(np.all(np.diff(recording.measured.time) > 0))
    True
    """
    return _read(Path(path), with_truth=True)


def read_any_recording(path: Path) -> Recording:
    """Read a recording, which may be of a real cell and then states no true pose; see `read_recording`."""
    return _read(path, with_truth=False)


def read_exposure_times(path: Path) -> Array:
    """Times (n,) of the middle of each exposure, s, of a recording that may hold none.

    Raises
    ------
    DescriptionError
        If the file is missing, not a table, of a newer version, lacks this column or holds values that are not rising
        numbers.
    """
    table = _read_recording_table(path)
    if "trigger.time" not in table.column_names:
        raise DescriptionError("the column 'trigger.time' is missing", file=path)
    times = numbers(table, "trigger.time", path, _LATEST)
    _require_rising(times, "trigger.time", np.arange(len(times)), path)
    return times


def _read(path: Path, with_truth: bool) -> Recording:
    table = _read_recording_table(path)
    layout = RecordLayout.of(table.column_names)
    with_truth |= any(name.startswith(_TRUTH) for name in table.column_names)
    wanted = (*INTEGER_COLUMNS, *layout.measured, *(layout.truth if with_truth else ()))
    missing = [name for name in wanted if name not in table.column_names]
    if missing:
        raise DescriptionError(f"{len(missing)} columns are missing, the first is '{missing[0]}'", file=path)
    columns: dict[str, NDArray[np.float64] | NDArray[np.int64]] = {
        name: integers(table, name, path) for name in INTEGER_COLUMNS
    }
    for name in (*layout.measured, *(layout.truth if with_truth else ())):
        largest = _LATEST if name == "trigger.time" else _LARGEST
        columns[name] = numbers(table, name, path, largest, nan=name.startswith(_TRUTH))
    index = columns["trigger.index"]
    rows = np.flatnonzero((index > 0) & (np.diff(index, prepend=0) != 0))
    if not len(rows):
        raise DescriptionError(f"holds no trigger (trigger.index is 0 in all {len(index)} rows)", file=path)
    kept = {name: values[rows] for name, values in columns.items()}
    for name in ("trigger.index", "trigger.time"):
        _require_rising(kept[name], name, rows, path)
    short = np.flatnonzero(kept["trigger.exposure"] < 0.0)
    if len(short):
        row = int(short[0])
        refuse_value(path, "trigger.exposure", int(rows[row]), kept["trigger.exposure"][row], "0 s or more")
    for frame in layout.frames if with_truth else ():
        norm = np.linalg.norm([kept[name] for name in _indexed(f"{_TRUTH}{frame}.orientation", 4)], axis=0)
        wrong = np.flatnonzero(np.abs(norm - 1.0) > _UNIT)  # not where it is NaN
        if len(wrong):
            row = int(wrong[0])
            expected = "the norm 1 of a quaternion"
            refuse_value(path, f"{_TRUTH}{frame}.orientation[1] to [4]", int(rows[row]), float(norm[row]), expected)
    return Recording(kept)


def _read_recording_table(path: Path) -> pa.Table:
    table = read_table(path)
    stated = (table.schema.metadata or {}).get(_VERSION_KEY.encode())
    if stated is not None:
        text = stated.decode(errors="replace")
        require_format_version(int(text) if _DIGITS.fullmatch(text) else text, RECORDING_VERSION, path)
    return table


def _require_rising(
    values: NDArray[np.float64] | NDArray[np.int64], name: str, rows: NDArray[np.intp], path: Path
) -> None:
    """Refuse values (n,) of the `rows` (n,) of a file that do not rise from each to the next."""
    back = np.flatnonzero(np.diff(values) <= 0)
    if len(back):
        row = int(back[0]) + 1
        expected = f"more than {values[row - 1].item()!r} of the exposure before"
        refuse_value(path, name, int(rows[row]), values[row].item(), expected)


def refuse_value(path: Path, name: str, row: int, value: object, expected: str) -> NoReturn:
    """Raise a `DescriptionError` on a value of a table; `row` counts from 0."""
    raise DescriptionError(file=path, key=f"column '{name}', row {row + 1}", value=value, expected=expected)


def read_table(path: Path) -> pa.Table:
    """Table of a CSV or Parquet file.

    Raises
    ------
    DescriptionError
        If the file is missing or no such table.
    """
    require_file(path)
    try:
        is_csv = path.suffix.lower() == ".csv"
        table = pyarrow.csv.read_csv(path) if is_csv else pyarrow.parquet.read_table(path)
        _ = table.column_names  # decodes them
    except MemoryError:  # no fault of the file's format
        raise
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(error), file=path, expected="a Parquet or CSV table") from None
    return table


def numbers(table: pa.Table, name: str, path: Path, largest: float, *, nan: bool = False) -> NDArray[np.float64]:
    """Values (n,) of a column of a table of the file `path`.

    Raises `DescriptionError` if one is not a number from -`largest` to `largest`; with `nan`, NaN is accepted.
    """
    try:
        values = np.asarray(table.column(name).to_numpy(), float)
    except (ValueError, TypeError):
        raise DescriptionError("holds values that are not numbers", file=path, key=f"column '{name}'") from None
    except KeyError:
        raise DescriptionError("is missing", file=path, key=f"column '{name}'") from None
    wrong = np.flatnonzero(~((np.abs(values) <= largest) | (nan & np.isnan(values))))
    if len(wrong):
        row = int(wrong[0])
        refuse_value(path, name, row, float(values[row]), f"a finite number from {-largest:g} to {largest:g}")
    return values


def integers(table: pa.Table, name: str, path: Path) -> NDArray[np.int64]:
    """Values (n,) of a column of integers from 0, see `numbers`."""
    values = numbers(table, name, path, _LARGEST_INTEGER)
    wrong = np.flatnonzero((values < 0) | (values != np.floor(values)))
    if len(wrong):
        row = int(wrong[0])
        refuse_value(path, name, row, float(values[row]), "an integer, 0 or more")
    return values.astype(np.int64)
