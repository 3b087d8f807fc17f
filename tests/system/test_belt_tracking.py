"""The arm follows a belt that runs: the tool keeps its poses in the frame of the belt, within all limits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import scancell
from scancell import location
from scancell.geometry import pose

Array = NDArray[np.float64]

CELL, PART = scancell.assets_dir() / "cells/pick_and_place.toml", scancell.assets_dir() / "parts/step_block.stl"
EXACT = {f"cell.robot.joint[{i}].encoder_{key}_deg": 0.0 for i in range(1, 7) for key in ("resolution", "noise")}
SPEED = 0.1  # m/s
DOWN = location(0.0, 0.0, 0.0, rx=np.pi)


@contextmanager
def running(speed: float = SPEED, guarded: bool = False, **changes: Any) -> Iterator[scancell.ScanSession]:
    """A session whose sensor is above the belt, which runs."""
    with (
        scancell.Scanner(CELL, settings=EXACT | changes) as scanner,
        scanner.session(PART, guarded=guarded) as session,
    ):
        session.move_tool(on_belt(session, 0.0, 0.2))
        session.run_conveyor(1, speed)
        session.wait(0.4)
        yield session


def on_belt(session: scancell.ScanSession, x: float, z: float) -> Array:
    return session.nominal.world_from_conveyors[0] @ location(x, 0.0, z) @ DOWN


class Watch:
    """Time on the path, joints, and pose of the tool in the frame that moves with the belt, in every step."""

    def __init__(self, session: scancell.ScanSession, tool: str = "sensor") -> None:
        self.session, self.tool, self.start = session, tool, session.conveyor_travel(1)
        self.clock: list[float] = []
        self.joints: list[Array] = []
        self.poses: list[Array] = []
        self.end = session.cell.on_step(self.look)

    def look(self) -> None:
        session = self.session
        moved = session.conveyor_travel(1) - self.start
        belt = session.nominal.world_from_conveyors[0] @ pose.translation((moved, 0.0, 0.0))
        self.clock.append(session.value("controller.clock"))
        self.joints.append(session.joints)
        self.poses.append(pose.inverse(belt) @ session.world_from_tool(self.tool))


@pytest.mark.parametrize(("speed", "guarded"), [(SPEED, False), (-SPEED / 2, False), (SPEED, True)])
def test_tool_rests_on_the_belt_at_each_pose(speed: float, guarded: bool) -> None:
    with running(speed, guarded) as session:
        watch, dwell, at = Watch(session), 0.2, -0.02 * np.sign(speed)
        targets = [on_belt(session, at, 0.16), on_belt(session, at + 0.02, 0.12) @ location(0.0, 0.01, 0.0, rz=0.1)]
        reached: list[tuple[int, float]] = []
        session.follow_conveyor(
            1, targets, dwell=dwell, on_pose=lambda number: reached.append((number, session.value("controller.clock")))
        )
        watch.end()
        assert [number for number, _ in reached] == [0, 1]
        poses, clock = np.array(watch.poses), np.array(watch.clock)
        last = len(clock) - 1 - int(np.argmax(np.diff(clock)[::-1] < 0))  # where the motion that was run began
        for (_, time), target in zip(reached, targets, strict=True):
            rows = np.flatnonzero((clock >= time) & (clock <= time + dwell - 0.02) & (np.arange(len(clock)) >= last))
            assert len(rows) >= 8
            wanted = pose.inverse(session.nominal.world_from_conveyors[0]) @ target
            np.testing.assert_allclose(poses[rows], np.broadcast_to(wanted, (len(rows), 4, 4)), atol=1e-6)
        joints = np.diff(np.array(watch.joints)[last:], axis=0) / session.cycle
        assert (np.abs(joints) <= session.nominal.arm.max_speed * (1 + 1e-6)).all()
        at_end = session.joints
        session.wait(0.1)
        np.testing.assert_allclose(session.joints, at_end, atol=1e-9)


def test_speed_is_a_share_of_the_limits_of_the_joints() -> None:
    with running() as session:
        watch, target = Watch(session), on_belt(session, -0.05, 0.15)
        session.follow_conveyor(1, [target], dwell=0.1, speed=0.1)
        watch.end()
        rates = np.abs(np.diff(np.array(watch.joints), axis=0)) / session.cycle
        share = float((rates / session.nominal.arm.max_speed).max())
        assert 0.05 < share < 0.1
        belt = session.nominal.world_from_conveyors[0]
        near = [float(np.linalg.norm((one - pose.inverse(belt) @ target)[:3, 3])) for one in watch.poses]
        assert min(near) < 1e-6


def test_gripper_picks_a_part_from_the_running_belt() -> None:
    """The fingers close while they move with the part, and lift it."""
    fingers_down = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # they close along the travel
    height = 0.049  # m, of the gripper above the belt

    def grip(session: scancell.ScanSession) -> Array:
        belt, moved = session.nominal.world_from_conveyors[0], session.conveyor_travel(1)
        return pose.from_rotation(fingers_down, belt @ [-0.15 + moved, 0.0, height, 1.0] @ np.eye(4, 3))

    with running(0.05) as session:
        robot = scancell.Robot(session, "geometric")
        robot.set_tool("gripper")
        session.open_gripper(0.065)
        session.wait_until(lambda: session.conveyor_travel(1) > 0.17, "a part in reach")
        session.move_tool(pose.translation((0.0, 0.05, 0.08)) @ grip(session), "gripper")
        up = pose.translation((0.0, 0.0, 0.05))
        robot.follow_conveyor(
            1, [up @ grip(session), grip(session), up @ grip(session)], dwell=0.4, grip_at=1, force=30.0
        )
        assert session.cell.get_boolean("measured.gripper.gripped")
        part = session.snapshot(1e-3).truth_at_middle("part[1]")[0]
        held = pose.inverse(session.world_from_tool("gripper")) @ part
        assert part[2, 3] == pytest.approx(0.15, abs=1e-3)
        np.testing.assert_allclose(held[:3, 3], [0.0, 0.0, height], atol=2e-3)
        with pytest.raises(scancell.CommandError, match="grip_at = 1: expected 0 to 0"):
            robot.follow_conveyor(1, [up @ grip(session)], grip_at=1)


def test_arm_that_falls_behind_is_stopped() -> None:
    with running() as session:
        targets = [on_belt(session, -0.02, 0.16)]
        with pytest.raises(scancell.CommandError, match=r"falls behind the belt: monitor speed 0\.5"):
            session.follow_conveyor(1, targets, dwell=1.0, on_pose=lambda _: session.set_monitor_speed(0.5))
        session.come_to_rest()
        with pytest.raises(scancell.CommandError, match="monitor speed is below 1"):
            session.follow_conveyor(1, targets)


def test_guard_keeps_the_tool_out_of_the_belt() -> None:
    with running(guarded=True) as session:
        into = on_belt(session, 0.0, -0.02)
        with pytest.raises(scancell.CommandError, match=r"guard|falls behind"):
            session.follow_conveyor(1, [into], dwell=0.5)
        assert session.world_from_tool()[2, 3] > session.nominal.world_from_conveyors[0][2, 3]


@pytest.mark.parametrize(
    ("speed", "x", "dwell", "message"),
    [
        (SPEED, -0.02, 30.0, r"belt carries the tool to .* cannot be brought"),
        (SPEED, 1.5, 0.0, r"cannot be brought within joint limits"),
    ],
)
def test_motions_out_of_reach_are_refused_before_the_arm_moves(
    speed: float, x: float, dwell: float, message: str
) -> None:
    with running(speed) as session:
        before = session.joints
        with pytest.raises(scancell.CommandError, match=message):
            session.follow_conveyor(1, [on_belt(session, x, 0.16)], dwell=dwell)
        np.testing.assert_array_equal(session.joints, before)


def test_belt_that_is_too_fast_or_changes_its_speed_is_refused() -> None:
    slow = {f"cell.robot.joint[{i}].max_speed_deg_s": 4.0 for i in range(1, 7)}
    with running(**slow) as session:
        with pytest.raises(scancell.CommandError, match=r"needs .* of the .* may have: the belt is too fast"):
            session.follow_conveyor(1, [on_belt(session, -0.02, 0.16)], dwell=0.3)
        session.run_conveyor(1, 0.3)
        session.wait(0.05)
        with pytest.raises(scancell.CommandError, match=r"the belt accelerates"):
            session.follow_conveyor(1, [on_belt(session, -0.02, 0.16)])
        with pytest.raises(scancell.CommandError, match=r"conveyor = 2: expected 1 to 1"):
            session.follow_conveyor(2, [on_belt(session, -0.02, 0.16)])
        with pytest.raises(scancell.CommandError, match=r"expected at least one"):
            session.follow_conveyor(1, [])
        with pytest.raises(scancell.DescriptionError, match="pose"):
            session.follow_conveyor(1, [np.eye(3)])
