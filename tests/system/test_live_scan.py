"""A scan in a live cell: the points that it hands over, its result, and how it ends."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from scancell import Scanner
from scancell.cell.driver import Operation
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CancelledError, PlanningError
from scancell.geometry import pose
from scancell.live.cell import LiveCell
from scancell.live.scan import LiveChunk, LiveScan
from scancell.live.state import Cancel, MoveJoints, MoveLine, Reset, SetOperation
from scancell.programs.robot import deg, location, mm
from scancell.results import ScanResult
from scancell.scanning.session import ScanSession
from scancell.views.recorded_run import open_run

PART = assets_dir() / "parts" / "free_form.stl"
COARSE = ["scan.max_profiles=120"]
PATIENCE_S = 300


class Rig:
    """A live cell whose cycles follow one another as fast as they can, and a scan in it."""

    def __init__(self, session: ScanSession, **options: object) -> None:
        self.session, self.live = session, LiveCell(session)
        self.chunks: list[LiveChunk] = []
        self.behind: list[int] = []
        self.scan = LiveScan(on_points=self._keep, **options)

    def _keep(self, chunk: LiveChunk) -> None:
        self.chunks.append(chunk)
        self.behind.append(self.scan.state.behind)

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.live.step()

    def run(self) -> ScanResult:
        self.scan.start(self.live)
        self.cycles(40)
        return self.scan.result.result(PATIENCE_S)


@pytest.fixture(scope="module")
def scanner() -> Iterator[Scanner]:
    with Scanner(setup=load_setup(settings=COARSE), threads=2) as made:
        yield made


@pytest.fixture
def session(scanner: Scanner) -> Iterator[ScanSession]:
    with scanner.session(PART, seed=3, as_built={"tool.x_mm": 0.05}, guarded=True) as made:
        yield made


def joined(chunks: list[LiveChunk], name: str) -> np.ndarray:
    return np.concatenate([getattr(chunk, name) for chunk in chunks])


@pytest.mark.parametrize("engine", ["geometric", "ray-traced"])
def test_points_handed_over_are_those_of_saved_cloud(session: ScanSession, tmp_path, engine) -> None:
    rig = Rig(session, engine=engine)
    result = rig.run()
    cloud = result.cloud
    assert len(rig.chunks) > 4
    assert len(cloud) > 2000
    np.testing.assert_allclose(joined(rig.chunks, "points_in_part"), cloud.points_in_part, atol=1e-12)
    np.testing.assert_allclose(joined(rig.chunks, "deviation"), result.deviation.distance, atol=1e-12)
    for name in ("intensity", "quality", "sigma", "camera", "time"):
        np.testing.assert_allclose(joined(rig.chunks, name), getattr(cloud, name), rtol=1e-6)
    world = session.world
    whole, dropped = session.pipeline.reconstruct(world.estimated, result.recording, result.profiles, world.setup)
    np.testing.assert_allclose(whole.normals, cloud.normals, atol=1e-9)
    assert dropped.as_json() == result.dropped.as_json()
    state = rig.scan.state
    assert (state.stage, state.behind, state.points) == ("done", 0, len(cloud))
    assert state.taken == state.planned == len(result.recording) == len(result.plan.segment)
    assert len(result.sample_images) == (4 if engine == "ray-traced" else 0)
    result.save(tmp_path / "run")
    opened = open_run(tmp_path / "run", len(cloud))
    np.testing.assert_allclose(opened.cloud.points_in_part, cloud.points_in_part, atol=1e-6)
    middle = len(result.recording) // 2
    sensor = opened.motion.frames(float(result.recording.measured.time[middle]))["sensor"]
    np.testing.assert_allclose(sensor, result.recording.truth_at_middle("sensor")[middle], atol=1e-9)
    assert 0.0 == opened.motion.start < opened.motion.times[0] < opened.motion.times[-1] < opened.motion.duration


def test_result_is_that_of_a_scan_without_view(scanner: Scanner, session: ScanSession) -> None:
    """The poses of the exposures, and so the points, differ by what triggers and noise differ by."""
    live = Rig(session, engine="geometric").run()
    alone = scanner.scan(PART, engine="geometric", seed=3, as_built={"tool.x_mm": 0.05})
    np.testing.assert_allclose(live.plan.q, alone.plan.q, atol=1e-12)
    apart = pose.inverse(live.recording.truth_at_middle("sensor")) @ alone.recording.truth_at_middle("sensor")
    assert np.abs(apart[:, :3, 3]).max() < 0.3e-3
    assert len(live.cloud) == pytest.approx(len(alone.cloud), rel=0.01)
    assert live.deviation.mean == pytest.approx(alone.deviation.mean, abs=5e-6)
    assert live.deviation.rms == pytest.approx(alone.deviation.rms, rel=0.1)


def test_scan_starts_from_where_the_arm_was_stopped(session: ScanSession) -> None:
    rig = Rig(session, engine="geometric")
    rig.live.submit(MoveJoints(session.joints + np.array([0.5, 0.1, 0, 0, 0.2, 0]), table_angle=2.0, speed=0.2))
    rig.cycles(25)
    rig.live.submit(Cancel())
    rig.cycles(20)
    rig.live.submit(SetOperation(Operation.MANUAL))
    rig.cycles(20)
    away = np.abs(session.joints - session.home).max()
    assert 0.01 < away < 0.45
    assert len(rig.run().cloud) > 2000
    assert rig.live.state.message == ""
    assert rig.live.state.operation is Operation.AUTOMATIC
    np.testing.assert_allclose(session.joints, session.home, atol=1e-3)


def test_scan_waits_for_slow_sensing(session: ScanSession) -> None:
    rig = Rig(session, engine="ray-traced", batch=4, most_behind=2)
    rig.run()
    assert max(rig.behind) >= 8
    # Those that wait, one that is sensed, one that is handed over.
    assert max(rig.behind) <= 4 * 4


@pytest.mark.parametrize("stage", ["planning", "scanning"])
def test_stop_ends_scan_keeps_what_was_measured_and_cell_takes_commands(session: ScanSession, tmp_path, stage) -> None:
    rig = Rig(session, engine="geometric", batch=50)  # the last batch is incomplete when the scan is stopped

    def stop() -> None:
        state = rig.scan.state
        if state.stage == stage and (stage == "planning" or state.taken > 30):
            rig.live.emergency_stop()

    session.cell.on_cycle(16_000, stop)
    if stage == "planning":
        with pytest.raises(CancelledError, match="ended: stopped"):
            rig.run()
    else:
        result = rig.run()
        state = rig.scan.state
        assert 30 < state.sensed == state.taken == len(result.recording) < state.planned
        assert len(result.cloud) == state.points == sum(len(chunk.time) for chunk in rig.chunks) > 100
        assert f"stopped after {state.sensed} of {state.planned} exposures: stopped" in result.warnings
        result.save(tmp_path / "run")
        opened = open_run(tmp_path / "run", len(result.cloud))
        assert len(opened.cloud) == len(result.cloud)
        assert opened.motion.duration == opened.motion.times[-1]  # not that of the plan
    assert rig.scan.state.stage == "stopped"
    assert rig.scan.state.ended_by == ("" if stage == "planning" else "stopped")
    assert rig.live.state.controller == "emergency stop"
    rig.live.submit(Reset())
    rig.cycles(5)
    raised = session.world_from_tool() + np.array([0, 0, 0.02, 0])[:, None] * [0, 0, 0, 1]
    rig.live.submit(MoveLine(raised))
    rig.cycles(250)
    np.testing.assert_allclose(session.world_from_tool(), raised, atol=1e-3)


def test_every_exposure_taken_before_a_stop_is_kept_while_sensing_lags(session: ScanSession) -> None:
    rig, waited = Rig(session, engine="geometric"), threading.Event()

    def lag(_: LiveChunk) -> None:
        """The first chunk takes until the scan waits for it, and is cancelled."""
        while rig.scan.state.taken < 12:
            waited.wait(0.01)
        if rig.scan.state.sensed <= 4:
            rig.live.submit(Cancel())
            while rig.live.state.job is not None:
                waited.wait(0.01)

    rig.scan = LiveScan("geometric", lag, batch=4, most_behind=1)
    _require_all_kept(rig, rig.run())


def test_exposures_before_a_stop_by_the_controller_are_kept(session: ScanSession) -> None:
    """As the guard stops it."""
    rig = Rig(session, engine="geometric", batch=4)
    session.cell.on_cycle(16_000, lambda: rig.scan.state.taken > 10 and session.press_emergency_stop())
    _require_all_kept(rig, rig.run())
    assert rig.live.state.controller == "emergency stop"


def _require_all_kept(rig: Rig, result: ScanResult) -> None:
    state = rig.scan.state
    assert state.stage == "stopped"
    assert 10 < len(result.recording) == state.sensed == state.taken < state.planned
    index = result.recording.measured.index
    np.testing.assert_array_equal(index, np.arange(len(index)) + index[0])
    assert index[-1] >= rig.session.cell.get_integer("trigger.count") - 1  # one may be exposed when it stops
    assert f"stopped after {state.sensed} of {state.planned} exposures: {state.ended_by}" in result.warnings


def test_stopped_scan_is_saved_and_evaluated_as_a_finished_one(session: ScanSession, tmp_path) -> None:
    whole = Rig(session, engine="geometric")
    finished = whole.run()
    part = Rig(session, engine="geometric")
    session.cell.on_cycle(16_000, lambda: part.scan.state.taken > 60 and part.live.submit(Cancel()))
    stopped = part.run()
    assert part.scan.state.stage == "stopped"
    files = [sorted(file.name for file in result.save(tmp_path / name)) for name, result in
             (("finished", finished), ("stopped", stopped))]  # fmt: skip
    assert files[0] == files[1]
    assert stopped.deviation.rms == pytest.approx(finished.deviation.rms, rel=0.2)
    assert 0 < stopped.coverage.fraction < finished.coverage.fraction


def test_error_of_the_receiver_ends_the_scan(session: ScanSession) -> None:
    rig = Rig(session, engine="geometric", batch=4, most_behind=1)
    rig.scan = LiveScan("geometric", lambda _: 1 / 0, batch=4, most_behind=1)
    with pytest.raises(ZeroDivisionError):
        rig.run()
    assert "ZeroDivisionError" in rig.live.state.message
    assert rig.live.state.job is None


def test_missing_path_to_the_start_is_reported(scanner: Scanner) -> None:
    """Without a guard the sensor may be brought into the table, from where no motion is free."""
    with scanner.session(PART) as session:
        rig = Rig(session, engine="geometric")
        session.move_tool(location(450 * mm, 0, 20 * mm, rx=180 * deg))
        with pytest.raises(PlanningError, match="no collision-free path to the start of the program: link5 hits part"):
            rig.run()
        assert "no collision-free path" in rig.live.state.message


def test_scan_that_never_begins_is_cancelled(session: ScanSession) -> None:
    rig, ended = Rig(session, engine="geometric"), threading.Event()
    rig.live.submit(MoveJoints(session.joints + 0.3))
    rig.scan.start(rig.live)
    rig.cycles(2)
    ended.set()
    rig.live.run(ended.is_set)
    with pytest.raises(CancelledError, match="had not begun"):
        rig.scan.result.result(PATIENCE_S)


ENDS_EARLY = """
import sys
from scancell import LiveCell, LiveScan, Scanner
from scancell.live.state import Cancel

part, stage = sys.argv[1:]
with Scanner() as scanner, scanner.session(part) as session:
    live, cycles = LiveCell(session), 0
    scan = LiveScan()
    scan.start(live)

    def is_stopped():
        global cycles
        cycles += scan.state.stage == stage
        if cycles == 100:
            live.submit(Cancel())
        return scan.state.ended_by or scan.result.done()

    live.run(is_stopped, realtime=False)
    assert cycles >= 100
"""


@pytest.mark.parametrize("stage", ["planning", "scanning"])
def test_program_may_end_while_a_stopped_scan_still_computes(stage: str) -> None:
    command = [sys.executable, "-c", ENDS_EARLY, str(PART), stage]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")
