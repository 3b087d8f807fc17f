"""The package `ur-rtde` as a foreign client of `scancell controller ur`: it moves, reads back and stops the robot.

It uploads its own control script, and its ports are fixed, so that every process has a loopback address of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from wire_ur import command, own_address

pytest.importorskip("rtde_control")

RESOLUTION = np.radians(0.0002)  # of the encoders


@pytest.fixture(scope="module")
def ur() -> Iterator[SimpleNamespace]:
    """Interfaces of `ur-rtde` to one robot in simulated time."""
    import rtde_control  # noqa: PLC0415
    import rtde_io  # noqa: PLC0415
    import rtde_receive  # noqa: PLC0415

    with command("--simulated"):
        receive = rtde_receive.RTDEReceiveInterface(own_address())
        control = rtde_control.RTDEControlInterface(own_address())
        io = rtde_io.RTDEIOInterface(own_address())
        yield SimpleNamespace(receive=receive, control=control, io=io)
        for interface in (control, receive, io):  # else their destructors end the process
            interface.disconnect()


@pytest.fixture(autouse=True)
def at_start(ur: SimpleNamespace) -> Iterator[list[float]]:
    """The robot at a pose, with a control script that runs."""
    if not ur.control.isProgramRunning():
        ur.control.reuploadScript()
        wait_for(ur.control.isProgramRunning)
    start = [0.3, -1.2, -1.9, -1.6, 1.57, 0.0]
    assert ur.control.moveJ(start, 3.0, 5.0)
    yield start


def test_moves_read_back_within_the_resolution_of_the_encoders(ur: SimpleNamespace, at_start: list[float]) -> None:
    goal = np.add(at_start, [0.1, 0.05, -0.05, 0.1, 0.0, 0.2]).tolist()
    assert ur.control.moveJ(goal, 1.05, 1.4)
    reads(ur.receive.getActualQ, goal, RESOLUTION)
    pose = ur.receive.getActualTCPPose()
    pose[2] += 0.04
    assert ur.control.moveL(pose, 0.25, 1.2)
    reads(ur.receive.getActualTCPPose, pose, 5e-6)
    assert ur.control.isSteady()
    assert ur.control.moveJ_IK(pose, 1.05, 1.4)
    reads(ur.receive.getActualTCPPose, pose, 5e-6)


def test_kinematics(ur: SimpleNamespace, at_start: list[float]) -> None:
    pose = ur.control.getForwardKinematics()
    assert pose == pytest.approx(ur.receive.getActualTCPPose(), abs=1e-9)
    assert ur.control.getInverseKinematics(pose) == pytest.approx(at_start, abs=2 * RESOLUTION)
    assert ur.control.poseTrans(pose, [0.0] * 6) == pytest.approx(pose, abs=1e-9)
    assert ur.control.isPoseWithinSafetyLimits(pose)
    assert not ur.control.isPoseWithinSafetyLimits([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert not ur.control.isJointsWithinSafetyLimits([7.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_stop_of_an_asynchronous_move(ur: SimpleNamespace, at_start: list[float]) -> None:
    goal = (np.array(at_start) + 1.0).tolist()
    assert ur.control.moveJ(goal, 0.1, 1.4, True)
    assert ur.control.getAsyncOperationProgress() >= 0
    ur.control.stopJ(2.0)
    assert ur.control.getAsyncOperationProgress() < 0
    reads(ur.receive.getActualQd, [0.0] * 6, 1e-6)
    assert 0.0 < ur.receive.getActualQ()[0] - at_start[0] < 0.9


def test_streams_of_speeds_and_set_points(ur: SimpleNamespace) -> None:
    ur.control.speedJ([0.2, 0.0, 0.0, 0.0, 0.0, 0.0], 5.0)
    wait_for(lambda: ur.receive.getActualQd()[0] == pytest.approx(0.2, abs=1e-6))
    assert ur.control.speedStop()
    reads(ur.receive.getActualQd, [0.0] * 6, 1e-6)
    ur.control.speedL([0.0, 0.0, -0.02, 0.0, 0.0, 0.0], 5.0)
    wait_for(lambda: ur.receive.getActualTCPSpeed()[2] == pytest.approx(-0.02, rel=1e-3))
    assert ur.control.speedStop()
    goal = (np.array(ur.receive.getActualQ()) + 0.02).tolist()
    ur.control.servoJ(goal, 0.0, 0.0, 0.002, 0.1, 300)
    wait_for(lambda: ur.receive.getActualQ() == pytest.approx(goal, abs=RESOLUTION))
    assert ur.control.servoStop()


def test_path_in_the_script(ur: SimpleNamespace, at_start: list[float]) -> None:
    points = [np.array(at_start) + shift for shift in (0.05, -0.05, 0.1)]
    assert ur.control.moveJ([[*point.tolist(), 1.0, 1.0, 0.0] for point in points])
    reads(ur.receive.getActualQ, points[-1], RESOLUTION)


def test_another_question_does_not_end_an_asynchronous_move(ur: SimpleNamespace, at_start: list[float]) -> None:
    goal = np.add(at_start, [0.2, 0.0, 0.0, 0.0, 0.0, 0.0]).tolist()
    assert ur.control.moveJ(goal, 0.5, 1.4, True)
    ur.control.getStepTime()  # it is read before the robot has answered, by design of the package
    assert not ur.control.isSteady()
    wait_for(lambda: ur.control.getAsyncOperationProgress() < 0)
    reads(ur.receive.getActualQ, goal, RESOLUTION)


def test_script_is_uploaded_again_while_it_runs(ur: SimpleNamespace) -> None:
    assert ur.control.isProgramRunning()
    assert ur.control.reuploadScript()
    wait_for(ur.control.isProgramRunning)


def test_refused_motion_ends_the_script(ur: SimpleNamespace) -> None:
    assert not ur.control.moveL([3.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.1, 0.1)
    assert not ur.control.isProgramRunning()
    assert ur.control.reuploadScript()
    wait_for(ur.control.isProgramRunning)


def test_watchdog_ends_the_script(ur: SimpleNamespace) -> None:
    assert ur.control.setWatchdog(10.0)
    wait_for(lambda: not ur.control.isProgramRunning())


def test_stop_script_and_custom_script(ur: SimpleNamespace) -> None:
    assert ur.control.sendCustomScriptFunction("outputs", "set_digital_out(1, True)\nset_digital_out(2, False)")
    assert ur.receive.getDigitalOutState(1)
    assert ur.io.setStandardDigitalOut(1, False)
    wait_for(lambda: not ur.receive.getDigitalOutState(1))
    assert ur.io.setSpeedSlider(0.5)
    wait_for(lambda: ur.receive.getTargetSpeedFraction() == 0.5)
    assert ur.io.setSpeedSlider(1.0)
    ur.control.stopScript()
    wait_for(lambda: not ur.control.isProgramRunning())


def reads(reading: Callable[[], list[float]], expected: object, most: float) -> None:
    """The second connection of the client may be some packages behind the first one."""
    wait_for(lambda: reading() == pytest.approx(expected, abs=most))


def wait_for(condition: Callable[[], bool], longest: float = 20.0) -> None:
    end = time.monotonic() + longest
    while not condition():
        assert time.monotonic() < end, "the condition did not come true in time"
        time.sleep(0.01)
