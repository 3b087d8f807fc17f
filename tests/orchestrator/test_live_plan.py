"""The plan of a live cell: cells of its map against kinematics and distances, and motions to its poses."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from live_cells import PATIENCE, run_until

from scancell import Scanner
from scancell.config.loading import Setup
from scancell.errors import CommandError, PlanningError
from scancell.live.cell import LiveCell
from scancell.live.plan import LivePlan, nearest_turn
from scancell.planning.model import PlanningCell, SensorRange
from scancell.planning.path_map.configuration_map import CLEARANCE, FREE, REACH, ConfigurationMap
from scancell.scanning.session import ScanSession
from scancell.views.motion import ProgramMotion
from spiral_cell import PART, spiral_setup


class Rig:
    """A live cell, which is stepped while its robot has to move, and a plan in it."""

    def __init__(self, session: ScanSession) -> None:
        self.session, self.live = session, LiveCell(session)
        self.plan = LivePlan(self.live, session)

    def planned(self) -> None:
        self.plan.start()
        self.until_ready()

    @staticmethod
    def until_done() -> None:
        for thread in threading.enumerate():
            if thread.name == "plan":
                thread.join(PATIENCE)

    def until_ready(self) -> None:
        self.until_done()
        assert self.plan.state.error == ""
        assert self.plan.state.stage == "ready"

    def go_to(self, axes: np.ndarray) -> None:
        done = self.plan.go_to(axes, "the pose")
        run_until(self.live, done.done)
        done.result(0)

    @property
    def axes(self) -> np.ndarray:
        return np.append(self.live.state.joints, self.live.state.table_angle)


@pytest.fixture(scope="module")
def scanner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scanner]:
    """A post beside the table forbids some of the poses."""
    with Scanner(setup=spiral_setup(tmp_path_factory.mktemp("post")), threads=2) as made:
        yield made


@pytest.fixture(scope="module")
def rig(scanner: Scanner) -> Iterator[Rig]:
    with scanner.session(PART, guarded=True) as session:
        made = Rig(session)
        made.planned()
        yield made


@pytest.fixture(scope="module")
def map_(rig: Rig) -> ConfigurationMap:
    branch = rig.plan.plan.paths[0].lattice.map.branch
    found = rig.plan.map_of(0, branch)
    assert found is not None
    return found


def some_cell(map_: ConfigurationMap, cause: int) -> tuple[float, float]:
    """Share of the way and table angle of a cell, in the middle of those that a constraint forbids."""
    columns, rows = np.nonzero(map_.cause == cause)
    assert len(columns), f"the map has no cell of cause {cause}"
    middle = len(columns) // 2
    return columns[middle] / (map_.columns - 1), float(map_.angle(rows[middle]))


def test_plan_is_that_of_the_pipeline_and_a_scan_finds_it(rig: Rig, scanner: Scanner) -> None:
    assert scanner.plan(PART) is rig.plan.plan
    world = rig.session.world
    assert rig.session.pipeline.plan(world) is rig.plan.plan


def test_whole_map_of_the_chosen_branch_is_evaluated(rig: Rig, map_: ConfigurationMap) -> None:
    assert map_.evaluated == map_.quality.size
    motion = rig.plan.plan.paths[0].motion.angle
    rows = np.rint(motion / (2 * np.pi) * map_.rows).astype(int) % map_.rows
    assert (map_.quality[np.arange(map_.columns), rows] > 0).all()  # the planned motion stays on free cells


def test_free_pose_brings_the_sensor_onto_the_path(rig: Rig, map_: ConfigurationMap) -> None:
    share, angle = some_cell(map_, FREE)
    pose = rig.plan.judge(0, map_.branch, share, angle)
    assert pose.quality > 0
    assert pose.reason == ""
    q, table = pose.axes[:-1], pose.axes[-1]
    path = rig.plan.plan.paths[0].view
    frames = rig.session.nominal.frame_poses([*q, table])
    table_from_sensor = np.linalg.inv(frames["table"]) @ frames["sensor"]
    along = path.at(np.linspace(0.0, path.length, 20_000))
    off = np.abs(along - table_from_sensor).max((1, 2))
    assert off.min() < 5e-4
    assert off.argmin() / 20_000 == pytest.approx(share, abs=0.1)  # of the time; the speed is not quite constant


def test_pose_without_clearance_names_the_pair_and_its_distance(rig: Rig, map_: ConfigurationMap) -> None:
    pose = rig.plan.judge(0, map_.branch, *some_cell(map_, CLEARANCE))
    assert pose.quality == 0
    world = rig.session.world
    cell = PlanningCell(rig.session.nominal, SensorRange.of(world.sensor), 8e-3)
    clashes = cell.clearance_violations(pose.axes[None], world.setup.scan.clearance_mm * 1e-3)
    worst = max(clashes, key=lambda clash: clash.clearance - clash.distance)
    assert worst.body_a in pose.reason
    assert worst.body_b in pose.reason


def test_pose_out_of_reach_says_by_how_much(rig: Rig, map_: ConfigurationMap) -> None:
    pose = rig.plan.judge(0, map_.branch, *some_cell(map_, REACH))
    assert pose.axes is None
    assert "reach" in pose.reason or "outside its limits" in pose.reason


def test_map_of_another_branch_is_evaluated_when_it_is_asked_for(rig: Rig, map_: ConfigurationMap) -> None:
    other = (map_.branch + 1) % len(rig.plan.plan.paths[0].branch_names)
    with pytest.raises(CommandError, match="not evaluated"):
        rig.plan.judge(0, other, 0.5, 0.0)
    rig.plan.evaluate(0, other)
    rig.until_ready()
    share, angle = some_cell(map_, FREE)
    first, second = rig.plan.judge(0, map_.branch, share, angle), rig.plan.judge(0, other, share, angle)
    assert second.axes is None or np.abs(second.axes - first.axes).max() > 0.1


def test_robot_goes_to_poses_of_the_plan_the_shorter_way(rig: Rig, map_: ConfigurationMap) -> None:
    pose = rig.plan.judge(0, map_.branch, *some_cell(map_, FREE))
    for axes in (pose.axes, rig.plan.plan.program.start):
        before = rig.axes[-1]
        rig.go_to(axes)
        off = rig.axes - axes
        off[-1] = (off[-1] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(off, 0.0, atol=1e-5)
        assert abs(rig.axes[-1] - before) <= np.pi + 1e-6
        assert rig.live.state.colliding is None


def test_colliding_pose_is_refused_with_the_bodies_and_the_robot_stays(rig: Rig, map_: ConfigurationMap) -> None:
    pose = rig.plan.judge(0, map_.branch, *some_cell(map_, CLEARANCE))
    before = rig.axes
    with pytest.raises(PlanningError, match="no collision-free path to the pose"):
        rig.go_to(pose.axes)
    np.testing.assert_allclose(rig.axes, before, atol=1e-6)


def test_failed_plan_says_why_and_leaves_the_last_one(rig: Rig, map_: ConfigurationMap) -> None:
    last, world = rig.plan.plan, rig.session.world
    near = world.setup.scan.replace({"clearance_mm": 100.0})
    rig.session.world = replace(world, setup=Setup(world.setup.cell, world.setup.sensor, near))
    rig.plan.start()
    with pytest.raises(CommandError, match="a plan is being made"):
        rig.plan.start()
    rig.until_done()
    rig.session.world = world
    assert rig.plan.state.stage == "failed"
    assert "clearance" in rig.plan.state.error
    assert rig.plan.plan is last
    assert rig.plan.map_of(0, map_.branch) is map_


def test_failed_evaluation_of_a_new_plan_leaves_the_last_plan_and_its_maps(
    rig: Rig, map_: ConfigurationMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    last, evaluated = rig.plan.plan, rig.plan.map_of(0, map_.branch)

    def fails(*_: object) -> None:
        raise PlanningError("interrupted")

    monkeypatch.setattr(rig.plan, "_evaluated", fails)
    rig.plan.start()
    rig.until_done()
    monkeypatch.undo()
    assert rig.plan.state.error == "interrupted"
    assert rig.plan.plan is last
    assert rig.plan.map_of(0, map_.branch) is evaluated
    rig.planned()


def test_empty_table_has_no_plan(rig: Rig) -> None:
    with pytest.raises(CommandError, match="the table is empty"):
        LivePlan(rig.live, rig.session, has_part=False).start()


def test_motion_of_a_program_goes_through_its_segments(rig: Rig) -> None:
    program = rig.plan.plan.program
    motion = ProgramMotion(program)
    assert motion.duration == pytest.approx(program.duration)
    for number, (begin, segment) in enumerate(zip(motion.begins, program.segments, strict=True)):
        np.testing.assert_allclose(motion.axes(begin), segment.axes[0], atol=1e-9)
        assert motion.segment_at(begin) == number
        middle = len(segment.times) // 2
        axes = segment.axes[middle]
        np.testing.assert_allclose(motion.axes(begin + segment.times[middle]), axes, atol=1e-9)
    np.testing.assert_allclose(motion.axes(motion.duration + 1), motion.axes(motion.duration))


@pytest.mark.parametrize(("table", "goal", "expected"), [(0.0, 6.0, 6.0 - 2 * np.pi), (-7.0, 0.1, 0.1 - 2 * np.pi)])
def test_nearest_turn(table: float, goal: float, expected: float) -> None:
    turned = nearest_turn(np.array([1.0, goal]), table)
    np.testing.assert_allclose(turned, [1.0, expected])
