"""The package `abbrobotegm` as a foreign client of `scancell controller abb`: it guides, reads back and stops."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from wire_sensors import RESOLUTION, command, free_port

egm = pytest.importorskip("ABBRobotEGM")


class Client:
    """What a program does with the package: receive a state, answer it."""

    def __init__(self, session: Any) -> None:
        self._session = session
        self.state = self.receive()

    def receive(self) -> Any:
        succeeded, state = self._session.receive_from_robot(20.0)
        assert succeeded
        self.state = state
        return state

    def guide(self, send: Callable[[Any], bool], until: Callable[[Any], bool], most: int = 2000) -> Any:
        """Send the same until a condition of the states holds, for some cycles."""
        for _ in range(most):
            assert send(self._session)
            if until(self.receive()):
                return self.state
        raise AssertionError("the condition did not come true")


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    port = free_port()
    with egm.EGM(port) as session, command("abb", port, "--simulated"):
        yield Client(session)


def arrived(state: Any) -> bool:
    return bool(state.mci_convergence_met)


def pose_of(state: Any) -> np.ndarray:
    return np.append(state.cartesian.pos, state.cartesian.orient)


def test_first_state(client: Client) -> None:
    state = client.state
    assert state.motors_on
    assert state.rapid_running
    assert len(state.joint_angles) == 6
    assert state.joint_angles == pytest.approx(state.joint_angles_planned, abs=np.degrees(RESOLUTION))
    assert pose_of(state) == pytest.approx(np.append(*state.cartesian_planned[:2]), abs=1e-2)


def test_joints_are_read_back_within_the_resolution_of_the_encoders(client: Client) -> None:
    goal = client.state.joint_angles + np.array([5.0, 3.0, -4.0, 6.0, 2.0, 10.0])
    state = client.guide(lambda session: session.send_to_robot(goal), arrived)
    assert state.joint_angles == pytest.approx(goal, abs=np.degrees(RESOLUTION))
    assert state.joint_angles_planned == pytest.approx(goal, abs=1e-9)
    assert state.mci_state == 3


@pytest.mark.parametrize("shift", [(0.0, 0.0, -40.0), (20.0, -30.0, 10.0)])
def test_pose_is_read_back(client: Client, shift: tuple[float, float, float]) -> None:
    place = pose_of(client.state)
    position, orientation = place[:3] + shift, place[3:]
    state = client.guide(lambda session: session.send_to_robot_cart(position, orientation), arrived)
    assert pose_of(state)[:3] == pytest.approx(position, abs=5e-3)  # mm
    assert abs(pose_of(state)[3:] @ orientation) == pytest.approx(1.0, abs=1e-9)


def test_speed_and_stop(client: Client) -> None:
    def angle(state: Any) -> float:
        return float(state.joint_angles[0])

    start, before = angle(client.state), client.state.header.tm
    speeds = np.array([-8.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    state = client.guide(
        lambda session: session.send_to_robot(speed_ref=speeds), lambda state: angle(state) < start - 4
    )
    assert state.header.tm - before == pytest.approx(500, abs=60)  # ms for 4 degrees at 8 deg/s
    client.guide(
        lambda session: session.send_to_robot(speed_ref=np.zeros(6)), lambda s: s.header.tm > state.header.tm + 200
    )
    rest = client.state.joint_angles
    client.guide(lambda session: session.send_to_robot(), lambda s: s.header.tm > state.header.tm + 400)
    assert client.state.joint_angles == pytest.approx(rest, abs=np.degrees(RESOLUTION))
    assert start - 5.0 < angle(client.state) < start - 4.0


def test_path_correction_is_refused(client: Client) -> None:
    """There is no path to correct; guidance goes on."""
    before = client.state.joint_angles
    client.guide(lambda session: session.send_to_robot_path_corr(np.array([1.0, 0.0, 0.0])), lambda _: True)
    client.guide(lambda session: session.send_to_robot(before), arrived)
    assert client.state.joint_angles == pytest.approx(before, abs=np.degrees(RESOLUTION))
