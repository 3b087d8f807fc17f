"""Poses of all bodies at any time of a recorded run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from scancell.arrays import Array
from scancell.cell.program import Program
from scancell.cell.recording import Recording, RecordLayout
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.nominal.cell import NominalCell, fmu_frame
from scancell.planning.plan import Plan

_CLOSE = 0.1  # s between exposures up to which the motion between them is interpolated
_LIT = 0.05  # s around an exposure in which the laser counts as on


class ProgramMotion:
    """Set-points of a program against its own clock, which does not count settling.

    Attributes
    ----------
    begins
        (segments,) times at which the segments begin, s.
    duration
        s.
    """

    def __init__(self, program: Program) -> None:
        segments = program.segments
        ends = np.cumsum([float(item.times[-1]) for item in segments])
        self.begins, self.duration = np.concatenate([[0.0], ends[:-1]]), float(ends[-1])
        self._times = np.concatenate([begin + item.times for begin, item in zip(self.begins, segments, strict=True)])
        self._axes = np.concatenate([item.all_axes for item in segments])

    def axes(self, at: float) -> Array:
        """Positions (axes,), rad or m, at a time, s; at rest before the start and after the end."""
        return np.array([np.interp(at, self._times, axis) for axis in self._axes.T])

    def segment_at(self, at: float) -> int:
        """Index of the segment that moves at a time, s."""
        return max(0, int(np.searchsorted(self.begins, at + 1e-9, side="right")) - 1)


class RunMotion:
    """Poses of all frames of a cell at times of a run, from its recording and its plan.

    Between exposures at most 0.1 s apart, recorded true poses are interpolated. In longer gaps, and before the first
    and after the last exposure, the arm and the table follow the set-points of the plan, stretched to the time that the
    gap took and shifted to meet the measured joints at its ends; without a plan they move evenly from one exposure to
    the next, and what stood on the table or in the world moves evenly too. The recording of a robot program also holds
    poses between its exposures.

    Parameters
    ----------
    cell
        Nominal cell.
    recording
        With true poses; those of a real cell follow from its measured joints and the nominal cell.
    program
        The planned motion; None where the run had none.
    exposures
        (n,) times of the exposures, s; None: those of the recording.
    is_stopped
        Whether the run ended with its last exposure, before the end of the program.

    Attributes
    ----------
    times
        (n,) times of the recorded poses, s.
    exposures
        As above.

    Raises
    ------
    DescriptionError
        If the recording lacks true poses of a frame, or has segments that the plan does not have.
    """

    def __init__(
        self,
        cell: NominalCell,
        recording: Recording,
        program: Program | None,
        exposures: Array | None = None,
        is_stopped: bool = False,
    ) -> None:
        self._cell, self._is_stopped = cell, is_stopped
        measured = recording.measured
        measured.require_joints(len(cell.home))
        self.times = measured.time
        self.exposures = self.times if exposures is None else exposures
        self._axes = measured.axes[:, : len(cell.axes)]
        wanted = {name: fmu_frame(name) for name in cell.frame_poses() if name != "world"}
        if recording.has_truth:
            _require_true_poses(recording, wanted.values())
            self._recorded = {name: recording.truth_at_middle(frame) for name, frame in wanted.items()}
        else:
            frames = cell.frame_poses(measured.axes)
            self._recorded = {name: np.asarray(frames[name]) for name in wanted}
        self._support = cell.support if cell.holds_part else "table"
        self._support_from_part = pose.inverse(self._recorded[self._support]) @ self._recorded["part"]
        self._plan = None if program is None else _Plan(program, measured.segment, self._axes)

    @property
    def duration(self) -> float:
        """Time from the start of the run to its end, s."""
        last = float(self.times[-1])
        if self._plan is None or self._is_stopped:
            return last
        return last + self._plan.duration - float(self._plan.clock[-1])

    @property
    def start(self) -> float:
        """First time that is known, s: 0 with a plan, else that of the first recorded pose."""
        return 0.0 if self._plan is not None else float(self.times[0])

    def laser_on(self, time: float, span: float = 0.0) -> bool:
        """Whether there is an exposure within 0.05 s, or half of `span` (s), of `time`."""
        return bool((np.abs(self.exposures - time) <= max(_LIT, span / 2)).any())

    def frames(self, time: float) -> Mapping[str, Array]:
        """``world_from_frame`` (4, 4) of all frames that bodies move with."""
        after = int(np.searchsorted(self.times, time))
        before, after = max(after - 1, 0), min(after, len(self.times) - 1)
        gap = float(self.times[after] - self.times[before])
        share = 0.0 if gap == 0.0 else (time - float(self.times[before])) / gap
        between = {name: _between(poses, before, after, share) for name, poses in self._recorded.items()}
        between["world"] = np.eye(4)
        if 0.0 < gap <= _CLOSE or time == self.times[after]:
            return between
        axes = self._axes_in_gap(before, after, share, time)
        nominal = {name: np.asarray(p) for name, p in self._cell.frame_poses(axes).items()}
        carried = {name: p for name, p in between.items() if name.startswith("part[")}
        carried["part"] = nominal[self._support] @ _between(self._support_from_part, before, after, share)
        return {**nominal, **carried}

    def _axes_in_gap(self, before: int, after: int, share: float, time: float) -> Array:
        """Positions (axes,) by the plan, or evenly."""
        if self._plan is None:
            return np.asarray((1 - share) * self._axes[before] + share * self._axes[after])
        clock, plan = self._plan.clock, self._plan
        if before == after:  # before the first exposure, or after the last
            first = time < self.times[0]
            at = clock[0] * time / self.times[0] if first else clock[-1] + time - self.times[-1]
            return np.asarray(plan.axes(float(at)))
        at = (1 - share) * clock[before] + share * clock[after]
        error = self._axes[[before, after]] - np.stack([plan.axes(clock[before]), plan.axes(clock[after])])
        return np.asarray(plan.axes(float(at)) + (1 - share) * error[0] + share * error[1])


def scan_motion(cell: NominalCell, recording: Recording, plan: Plan | None) -> RunMotion:
    """Motion of a scan; with fewer exposures than planned it was stopped after the last one."""
    if plan is None:
        return RunMotion(cell, recording, None)
    return RunMotion(cell, recording, plan.program, is_stopped=len(recording) < len(plan.segment))


class _Plan(ProgramMotion):
    """The motion of a program; `clock` (n,) is the time in it at which exposures were taken."""

    def __init__(self, program: Program, segment: NDArray[np.int64], measured: Array) -> None:
        super().__init__(program)
        segments = program.segments
        number = {item.id: i for i, item in enumerate(segments)}
        strange = sorted(set(segment.tolist()) - set(number))
        if strange:
            raise DescriptionError(f"the recording has segment {strange[0]}, the plan only {sorted(number)}")
        self.clock = np.zeros(len(segment))
        for one in np.unique(segment):
            rows, item = np.flatnonzero(segment == one), segments[number[int(one)]]
            near = measured[rows, : item.all_axes.shape[1]]
            self.clock[rows] = self.begins[number[int(one)]] + _nearest_times(item.times, item.all_axes, near)


def _require_true_poses(recording: Recording, frames: Iterable[str]) -> None:
    missing = [frame for frame in frames if frame not in RecordLayout.of(recording.columns).frames]
    if missing:
        raise DescriptionError(f"the recording holds no poses of {missing[0]}, which the cell has")
    for name, values in recording.columns.items():
        if not np.isfinite(values).all():
            raise DescriptionError("not all values are finite; pictures show the true poses", key=f"column {name}")


def _nearest_times(times: Array, planned: Array, measured: Array) -> Array:
    """Times (m,) at which the polyline `planned` (n, axes) at `times` (n,) passes nearest to points (m, axes)."""
    step = np.diff(planned, axis=0)
    length2 = np.maximum((step * step).sum(1), 1e-30)
    found = np.zeros(len(measured))
    for row, point in enumerate(measured):
        share = np.clip(((point - planned[:-1]) * step).sum(1) / length2, 0.0, 1.0)
        off = ((planned[:-1] + share[:, None] * step - point) ** 2).sum(1)
        best = int(off.argmin())
        found[row] = times[best] + share[best] * (times[best + 1] - times[best])
    return found


def _between(poses: Array, before: int, after: int, share: float) -> Array:
    """Pose (4, 4) at `share` of the way between two of (n, 4, 4)."""
    if before == after:
        return np.asarray(poses[before])
    return np.asarray(pose.interpolate_straight(poses[before], poses[after], np.array([share]))[0])
