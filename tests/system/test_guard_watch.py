"""`scancell guard watch` beside `scancell controller`: UR in real time, ABB and KUKA in simulated time."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

import scancell
from scancell.wire.abb.packets import ROBOT, SENSOR, Kind, packed, unpacked
from scancell.wire.kuka.packets import Answer, answer_packet, state_from
from scancell.wire.robot import VirtualRobot
from scancell.wire.ur.client import RtdeClient
from scancell.wire.ur.variables import pose_vector
from wire_sensors import CELLS, SensorSocket, free_port
from wire_sensors import command as sensor_command
from wire_ur import CELL, command, own_address

GOAL = np.array([450.0, 0.0, 50.0])  # mm: 50 mm in the table
STEP = 0.2  # mm per cycle of 4 ms


def test_robot_is_stopped_in_front_of_the_table() -> None:
    """However late this machine makes the watch: its orders have an age, and the program a watchdog."""
    with scancell.Scanner(CELL) as scanner, scanner.session() as session:
        robot = VirtualRobot(session)
        goal = robot.base_from_tcp(robot.home)
    goal[:3, 3] = 0.45, 0.0, 0.05  # 50 mm in the table
    lines = ['rtde_set_watchdog("input_int_register_24", 2, "stop")', f"movel(p{pose_vector(goal).tolist()}, v=0.1)"]
    script = "def f():\n" + "\n".join(lines) + "\nend\n"
    words = ["guard", "watch", "ur", str(CELL), "--host", own_address(), "--max-age", "0.6"]
    with (
        command(),
        subprocess.Popen([sys.executable, "-m", "scancell", *words], stdout=subprocess.PIPE, text=True) as watch,
        RtdeClient(own_address(), timeout=20.0) as client,
    ):
        try:
            assert watch.stdout is not None
            assert watch.stdout.readline() == f"guard: watches {own_address()}\n"
            client.set_outputs(["actual_TCP_pose", "runtime_state", "input_int_register_24"], 125.0)
            client.start()
            heights, has_run, end = [], False, time.monotonic() + 60.0
            with socket.create_connection((own_address(), 30003), 20.0) as port:
                while time.monotonic() < end:
                    for package in client.receive(5.0):
                        heights.append(package["actual_TCP_pose"][2])
                        is_running = package["runtime_state"] == (2,)
                        if not has_run and package["input_int_register_24"][0] >= 10 and script:
                            port.sendall(script.encode())
                            script = ""
                    if has_run and not is_running:
                        break
                    has_run = has_run or is_running
        finally:
            watch.send_signal(signal.SIGTERM)
        told = watch.stdout.read()
    assert has_run
    assert not is_running
    assert min(heights) > 0.1
    assert "stops" in told


@pytest.mark.parametrize("maker", ["abb", "kuka"])
def test_guided_robot_is_stopped_in_front_of_the_table(maker: str) -> None:
    """However fast simulated time passes: the guard also stops the robot where its decisions come too late."""
    port = free_port()
    program = SensorSocket()
    words = ["guard", "watch", maker, str(CELLS[maker]), "--host", "127.0.0.1", "--max-age", "1.0"]
    words += ["--port", str(port), "--program-port", str(program.address[1])]
    heights: list[float] = []
    with subprocess.Popen([sys.executable, "-m", "scancell", *words], stdout=subprocess.PIPE, text=True) as watch:
        try:
            assert watch.stdout is not None
            assert watch.stdout.readline() == "guard: watches 127.0.0.1\n"
            with sensor_command(maker, port, "--simulated"):
                for _ in range(1500):
                    packet = program.receive()
                    place, answer = guidance(maker, packet)
                    heights.append(place[2])
                    program.answer(answer)
        finally:
            watch.send_signal(signal.SIGTERM)
            program.close()
        told = watch.stdout.read()
    assert heights[0] - heights[-1] > 1.0
    assert heights[-1] > 100.0
    assert np.ptp(heights[-50:]) < 0.01
    assert "1 stops" in told


def guidance(maker: str, packet: bytes) -> tuple[np.ndarray, bytes]:
    """Place of the TCP in a state, mm, and an answer that leads on to the goal."""
    if maker == "abb":
        planned = unpacked(packet, ROBOT)["planned"]["cartesian"]
        place = np.array([planned["pos"][key] for key in "xyz"])
        wanted = place + step_from(place)
        planned["pos"] = dict(zip("xyz", wanted.tolist(), strict=True))
        return place, packed({"header": {"mtype": Kind.CORRECTION}, "planned": {"cartesian": planned}}, SENSOR)
    ipoc, elements = state_from(packet)
    place = np.array([elements["RSol"][key] for key in "XYZ"])
    return place, answer_packet(Answer(ipoc, {"RKorr": np.append(step_from(place), np.zeros(3))}))


def step_from(place: np.ndarray) -> np.ndarray:
    way = GOAL - place
    return way * min(1.0, STEP / max(float(np.linalg.norm(way)), 1e-9))
