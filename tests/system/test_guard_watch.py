"""`scancell guard watch ur` beside `scancell controller ur`, in real time over the ports of a robot."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time

import scancell
from scancell.wire.robot import VirtualRobot
from scancell.wire.ur.client import RtdeClient
from scancell.wire.ur.variables import pose_vector
from wire_ur import CELL, command, own_address


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
