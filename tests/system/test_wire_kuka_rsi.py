"""The package `rsipi` as a foreign client of `scancell controller kuka`: it corrects, reads back and stops."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from wire_sensors import command, free_port

rsipi = pytest.importorskip("RSIPI")

RESOLUTION = 0.0002  # deg, of the encoders


@pytest.fixture(scope="module", params=["relative", "absolute"])
def api(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A client with the signals of the package's sample configuration, and the robot in simulated time."""
    port = free_port()
    sample = Path(rsipi.__file__).parent / "contexts" / "RSI_EthernetConfig_Joints.xml"
    text = re.sub(r"<PORT>\d+</PORT>", f"<PORT>{port}</PORT>", sample.read_text())
    config = tmp_path_factory.mktemp("rsi") / "RSI_EthernetConfig.xml"
    config.write_text(re.sub(r"<IP_NUMBER>[\d.]+</IP_NUMBER>", "<IP_NUMBER>127.0.0.1</IP_NUMBER>", text))
    with (
        rsipi.RSIAPI(str(config), rsi_mode=request.param, cycle_time=0.004) as made,
        command("kuka", port, "--simulated", f"--{request.param}"),
    ):
        made.start()
        assert made.wait_for_connection(20.0)
        yield made


def test_pose_is_read_back(api: Any) -> None:
    start = api.motion.get_current_pose()
    goal = {"X": start["X"] + 10.0, "Y": start["Y"] - 5.0, "Z": start["Z"] - 20.0}
    api.motion.move_cartesian_trajectory(start | goal, steps=100)
    reads(api, "RSol", goal, 5e-3)
    reads(api, "RIst", goal, 5e-3)


def test_joints_are_read_back_within_the_resolution_of_the_encoders(api: Any) -> None:
    start = api.motion.get_current_joints()
    goal = {axis: angle + shift for (axis, angle), shift in zip(start.items(), (3, -2, 2, 4, -3, 5), strict=True)}
    api.motion.move_joint_trajectory(goal, steps=50)
    reads(api, "ASPos", goal, 1e-4)
    reads(api, "AIPos", goal, 2 * RESOLUTION)


def test_stop_of_the_client_ends_motion(api: Any) -> None:
    """A stop of the package zeroes corrections from one cycle to the next, or freezes absolute ones."""
    before = api.motion.get_current_joints()["A1"]
    if api.client.rsi_mode == "relative":
        api.motion.update_joints(A1=0.001)
    else:
        api.motion.update_joints(A1=api.client.receive_variables["AKorr"]["A1"] + 1.0)
    wait_for(lambda: abs(api.motion.get_current_joints()["A1"] - before) > 0.5)
    api.safety.stop()
    time.sleep(0.2)
    rest = api.client.send_variables["AIPos"]
    time.sleep(0.2)
    assert api.client.send_variables["AIPos"] == rest
    assert api.client.state.name == "RUNNING"
    assert api.client.send_variables["Delay"] == {"D": 0}
    api.safety.reset()


def reads(api: Any, name: str, expected: dict[str, float], most: float) -> None:
    def is_read() -> bool:
        element = api.client.send_variables[name]
        return {key: element[key] for key in expected} == pytest.approx(expected, abs=most)

    wait_for(is_read)


def wait_for(condition: Callable[[], bool], longest: float = 20.0) -> None:
    end = time.monotonic() + longest
    while not condition():
        assert time.monotonic() < end, "the condition did not come true in time"
        time.sleep(0.01)
