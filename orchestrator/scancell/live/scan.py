"""A planned scan in a live cell that delivers points while it runs."""

from __future__ import annotations

import queue
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, fields, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from scancell.arguments import Count, checked_arguments
from scancell.cell.instance import RecordBatches
from scancell.cell.program import Program
from scancell.cell.recording import Recording
from scancell.config.choices import Engine
from scancell.errors import CancelledError, CommandError, EmptyScanError
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.live.cell import LiveCell
from scancell.live.state import CLOSED, JobStopped, ready_to_move, while_stepping
from scancell.nominal.plausibility import setup_warnings
from scancell.planning.plan import Plan
from scancell.progress import NullProgress, Progress, Stopwatch
from scancell.reconstruction.cloud import Cloud
from scancell.reconstruction.reconstruct import Dropped, ProfilePoints
from scancell.results import ScanResult
from scancell.scanning.scan import SAMPLE_IMAGES, Scan
from scancell.scanning.sense import ExposureImages, SensedProfiles, StoredColumns, sample_rows
from scancell.scanning.session import ScanSession
from scancell.scanning.world import ExposureControl

Stage = Literal["waiting", "planning", "approaching", "scanning", "sensing", "done", "stopped", "failed"]

_AT_START = 1e-6  # rad and m
_PATIENCE = 0.02  # s, period at which a scan that waits for its sensing checks whether it has to end


@dataclass(frozen=True, eq=False)
class LiveChunk:
    """Points (n) of successive exposures, as they are in the cloud of the result, but without normals.

    Attributes
    ----------
    points_in_part
        (n, 3), m.
    intensity, quality, sigma, camera
        (n,) as in `Cloud`.
    deviation
        (n,) distance from the mesh of the part, m, positive outside; absolute where the mesh is open.
    time
        (n,) simulated time since the scan began, s.
    """

    points_in_part: NDArray[np.float64]
    intensity: NDArray[np.floating]
    quality: NDArray[np.floating]
    sigma: NDArray[np.floating]
    camera: NDArray[np.int32]
    deviation: NDArray[np.float64]
    time: NDArray[np.float64]

    @classmethod
    def of(cls, cloud: Cloud, deviation: NDArray[np.float64]) -> Self:
        """From a cloud and the distance (n,) of its points from the mesh, m."""
        columns = (cloud.intensity, cloud.quality, cloud.sigma, cloud.camera, deviation, cloud.time)
        return cls(cloud.points_in_part, *columns)

    def __getitem__(self, rows: slice) -> Self:
        """A copy of some points."""
        return type(self)(*(getattr(self, field.name)[rows].copy() for field in fields(self)))


@dataclass(frozen=True)
class LiveScanState:
    """Progress of a scan.

    Attributes
    ----------
    planned, taken, sensed
        Numbers of exposures: of the plan (0 before there is one), taken by the cell, and sensed.
    points
        Number of points delivered.
    ended_by
        Why it was stopped; empty where it was not.
    """

    stage: Stage
    planned: int
    taken: int
    sensed: int
    points: int
    ended_by: str = ""

    @property
    def behind(self) -> int:
        """Number of exposures by which sensing lags the cell."""
        return self.taken - self.sensed


def _require_axes_at_start(session: ScanSession, at: NDArray[np.float64]) -> None:
    """Raise `CommandError` where axes (axes,) beyond the table are not where the plan of a scan holds them."""
    first = len(session.home) + 1
    for axis, position in zip(session.nominal.further_axes, at[first:].tolist(), strict=True):
        if abs(position - axis.start) > _AT_START:
            here, start = axis.in_words(position), axis.in_words(axis.start)
            raise CommandError(f"the axis {axis.name} is at {here}: move it to {start}, where scans hold it, first")


class LiveScan:
    """Plans and drives the scan of the session's descriptions, and senses it in another thread meanwhile.

    The arm moves from where it rests to the start of the program on a planned path free of collision; manual operation
    is left before. The cell waits, and its time with it, while sensing is too far behind. If the scan is stopped, or
    the controller does not continue it, the points measured until then are the result, with a warning.

    Parameters
    ----------
    engine
        How exposures are sensed.
    on_points
        Receives the points of successive exposures in order, in the thread that senses.
    plan
        In place of a new one; it is checked again.
    batch
        Number of exposures in a chunk.
    most_behind
        Largest number of chunks that wait to be sensed.

    Attributes
    ----------
    result
        Future of the scan, as `Scanner.scan` returns it, or of its error.

    Examples
    --------
    >>> counts = []
    >>> settings = {"scan.sweep.enabled": False, "scan.raster.pitch_mm": 5}
    >>> with scancell.Scanner(settings=settings) as scanner, scanner.session("part.stl") as session:
    ...     live = scancell.LiveCell(session)
    ...     scan = scancell.LiveScan("geometric", on_points=lambda chunk: counts.append(len(chunk.points_in_part)))
    ...     scan.start(live)
    ...     live.run(scan.result.done, realtime=False)
    >>> sum(counts) == len(scan.result.result().cloud)
    True
    """

    @checked_arguments
    def __init__(
        self,
        engine: Engine = "ray-traced",
        on_points: Callable[[LiveChunk], object] = lambda _: None,
        plan: Plan | None = None,
        batch: Count = 16,
        most_behind: Count = 8,
    ) -> None:
        self._engine, self._on_points, self._given, self._batch = engine, on_points, plan, batch
        self._chunks: queue.Queue[Recording | None] = queue.Queue(most_behind)
        self._after_stop: deque[Recording] = deque()  # chunks that a stop left no time to wait with
        self._lock, self._given_up = threading.Lock(), threading.Event()
        self._stage: Stage = "waiting"
        self._planned = self._taken = self._sensed = self._points = 0
        self._recordings: list[Recording] = []
        self._profiles, self._cloud = StoredColumns(ProfilePoints), StoredColumns(Cloud)
        self._dropped: Dropped | None = None
        self._timings: Counter[str] = Counter()
        self._ended_by = ""
        self._images: list[ExposureImages] = []
        self._begin = 0.0
        self._watch = Stopwatch()
        self.result: Future[ScanResult] = Future()
        self.result.set_running_or_notify_cancel()

    # From any thread

    @property
    def state(self) -> LiveScanState:
        """Progress: ``stage``, numbers of exposures ``planned``, ``taken`` and ``sensed``, and of ``points``."""
        counts = self._planned, self._taken, self._sensed, self._points
        return LiveScanState(self._stage, *counts, self._ended_by)

    @checked_arguments
    def start(self, live: LiveCell) -> None:
        """Submit the scan to the cell `live`, once."""
        live.perform(self._drive, "a scan").add_done_callback(self._driven)

    def _driven(self, driven: Future[None]) -> None:
        if driven.cancelled():
            self._fail(CancelledError("the scan was ended: it had not begun"), "stopped")
        elif (error := driven.exception()) is None:
            return
        elif not isinstance(error, JobStopped | CommandError):
            self._fail(error)
        elif self._taken and str(error) != CLOSED:
            self._ended_by = str(error)  # what was taken is still sensed
        elif isinstance(error, JobStopped):
            self._fail(CancelledError(f"the scan was ended: {error}"), "stopped")
        else:
            self._fail(error)

    def _fail(self, error: BaseException, stage: Stage = "failed") -> None:
        with self._lock:  # driving and sensing may fail at the same time
            if not self.result.done():
                self._stage = stage
                self.result.set_exception(error)
        self._given_up.set()

    # In the thread of the cell

    def _drive(self, session: ScanSession) -> None:
        self._stage = "planning"
        start = ready_to_move(session)
        _require_axes_at_start(session, start)
        plan, approach = while_stepping(session, lambda progress: self._plan(session, start, progress))
        self._stage, self._planned = "approaching", len(plan.segment)
        if approach is not None:
            session.run_program(approach, session.exposure)
        sensing = threading.Thread(target=self._sense_all, args=(session, plan), name="sense")
        sensing.start()
        self._stage, self._begin = "scanning", session.time
        with self._watch.measure("drive"):
            session.run_program(
                plan.program, session.exposure, RecordBatches(self._batch, lambda taken: self._take(taken, session))
            )
        self._stage = "sensing"
        self._hand_over(None, session)

    def _plan(
        self, session: ScanSession, start: NDArray[np.float64], progress: Progress
    ) -> tuple[Plan, Program | None]:
        world, pipeline = session.world, session.pipeline
        with self._watch.measure("plan"):
            plan = pipeline.plan(world, self._given, progress=progress)
        goal, purpose = plan.program.start, "the start of the program"
        return plan, pipeline.approach(world, start, goal, purpose)

    def _take(self, taken: Recording, session: ScanSession) -> None:
        self._taken += len(taken)
        self._hand_over(taken.since(self._begin), session)

    def _hand_over(self, chunk: Recording | None, session: ScanSession) -> None:
        """Wait until sensing is near enough; a stop or `Cancel` ends the wait, but keeps the chunk."""
        while True:
            if self._given_up.is_set():
                self.result.result(0)  # raises
            try:
                return self._chunks.put(chunk, timeout=_PATIENCE)
            except queue.Full:
                pass
            try:
                session.progress.advance(0.0)
            except JobStopped:
                if chunk is not None:
                    self._after_stop.append(chunk)
                raise

    # In the thread that senses

    def _sense_all(self, session: ScanSession, plan: Plan) -> None:
        world = session.world
        scan = Scan(session.pipeline, world, self._engine, setup_warnings=tuple(setup_warnings(world.setup)))
        samples, controls = np.array(sample_rows(self._planned, SAMPLE_IMAGES)), world.controls()
        try:
            while (chunk := self._next()) is not None:
                self._sense(chunk, scan, samples, controls)
            if not self._given_up.is_set() and self._recordings:
                self._finish(session, plan, scan)
            elif self._ended_by:
                self._fail(CancelledError(f"the scan was ended: {self._ended_by}"), "stopped")
        except Exception as error:
            self._fail(error)

    def _next(self) -> Recording | None:
        """The next chunk; None at the end, also of a scan that was stopped, and where it was given up."""
        while not self._given_up.is_set():
            try:
                return self._chunks.get(timeout=_PATIENCE)
            except queue.Empty:
                if self._ended_by:
                    return self._after_stop.popleft() if self._after_stop else None
        return None

    def _sense(
        self, chunk: Recording, scan: Scan, samples: NDArray[np.int64], controls: Sequence[ExposureControl]
    ) -> None:
        rows = samples[(samples >= self._sensed) & (samples < self._sensed + len(chunk))] - self._sensed
        with self._watch.measure("sense"):
            sensed = scan.sense(chunk, NullProgress(), rows.tolist(), controls)
        self._images += sensed.images
        with self._watch.measure("reconstruct"):
            cloud, dropped = scan.points_of(chunk, sensed.points)
            self._store(chunk, sensed, cloud, dropped)
            world = scan.world
            points = LiveChunk.of(cloud, deviation_from_mesh(cloud, world.part_surface, scan.pipeline.threads).distance)
        self._sensed += len(chunk)
        if len(cloud):
            self._points += len(cloud)
            self._on_points(points)

    def _store(self, chunk: Recording, sensed: SensedProfiles, cloud: Cloud, dropped: Dropped) -> None:
        frame = (sensed.points.frame + self._sensed).astype(np.int32)
        self._profiles.append(replace(sensed.points, frame=frame))
        self._cloud.append(cloud)
        self._recordings.append(chunk)
        self._dropped = dropped if self._dropped is None else self._dropped + dropped
        self._timings.update(sensed.timings)

    def _finish(self, session: ScanSession, plan: Plan, scan: Scan) -> None:
        assert self._dropped is not None
        profiles, images = self._profiles.joined(), tuple(self._images)
        sensed = SensedProfiles(profiles, self._sensed, dict(self._timings), images)
        if self._ended_by:
            warning = f"stopped after {self._sensed} of {self._planned} exposures: {self._ended_by}"
            scan = replace(scan, setup_warnings=(*scan.setup_warnings, warning))
        try:
            recording, parts = Recording.joined(self._recordings), (self._cloud.joined(), self._dropped)
            result = scan.of_profiles(recording, sensed, plan, NullProgress(), self._watch, parts)
        except EmptyScanError as error:
            self._fail(error, "stopped" if self._ended_by else "failed")
            return
        self._stage = "stopped" if self._ended_by else "done"
        self.result.set_result(ScanResult.of(replace(result, fmu_token=session.cell.token)))
