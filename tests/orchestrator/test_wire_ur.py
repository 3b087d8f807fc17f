"""The simulated UR over its ports: clients of our own, and scripts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import scancell
from scancell.errors import DescriptionError, LinkError
from scancell.wire.robot import VirtualRobot
from scancell.wire.ur.client import DashboardClient, RtdeClient
from scancell.wire.ur.controller import UrController
from scancell.wire.ur.variables import pose_of, pose_vector
from wire_ur import NAMES, controller_of, own_address, served

RESOLUTION = np.radians(0.0002)  # of the encoders


@pytest.fixture
def controller() -> Iterator[UrController]:
    with controller_of() as made:
        yield made


def run(controller: UrController, text: str, cycles: int = 20_000) -> int:
    """Run a program to its end; the number of cycles."""
    controller.run_script(text)
    for count in range(cycles):
        if not controller.is_running:
            return count
        controller.step()
    raise AssertionError("the program goes on")


def test_simulated_time_loses_no_cycle(controller: UrController) -> None:
    """Ten seconds at 500 Hz (`bench.wire_ur` for ten minutes): every cycle arrives, in its order."""
    with served(controller) as (rtde, _, _, server), RtdeClient(own_address(), server.ports[rtde]) as client:
        client.set_outputs(NAMES, 500.0)
        client.start()
        times = [controller.cycle]
        while times[-1] < 10.0:
            times += [package["timestamp"][0] for package in client.receive(2.0)]
    assert np.diff(times[1:]) == pytest.approx(controller.cycle, abs=1e-9)
    assert server.timing.dropped == 0


def test_client_that_does_not_read_holds_up_simulated_time(controller: UrController) -> None:
    with served(controller) as (rtde, _, dashboard, server), RtdeClient(own_address(), server.ports[rtde]) as client:
        client.set_outputs(NAMES, 500.0)
        client.start()
        with DashboardClient(own_address(), server.ports[dashboard]) as other:
            assert other.request("robotmode") == "Robotmode: RUNNING"
        last = [package["timestamp"][0] for package in client.receive(2.0)][-1]
        received = client.receive(2.0)
        assert not received or received[0]["timestamp"][0] == pytest.approx(last + controller.cycle, abs=1e-9)


def test_registers_and_slider_come_from_a_client(controller: UrController) -> None:
    with served(controller) as (rtde, _, _, server), RtdeClient(own_address(), server.ports[rtde]) as client:
        assert client.version == controller.version
        client.set_outputs(["input_int_register_7", "target_speed_fraction", "actual_digital_output_bits"], 125.0)
        names = ("input_int_register_7", "speed_slider_mask", "speed_slider_fraction")
        outputs = ("standard_digital_output_mask", "standard_digital_output")
        recipe, second = client.set_inputs(names), client.set_inputs(outputs)
        client.write(recipe, [42, 1, 0.25])
        client.write(second, [0b110, 0b010])
        client.start()
        package = client.receive(2.0)[-1]
    assert package == {
        "input_int_register_7": (42,),
        "target_speed_fraction": (0.25,),
        "actual_digital_output_bits": (0b010,),
    }
    with pytest.raises(LinkError):
        RtdeClient(own_address(), server.ports[rtde], timeout=0.5)


def test_program_moves_and_ends_where_it_says(controller: UrController) -> None:
    robot = controller.robot
    goal = robot.home + 0.1
    lower = robot.base_from_tcp(goal)
    lower[2, 3] -= 0.03
    vector = ", ".join(f"{x:.9f}" for x in pose_vector(lower))
    lines = [f"movej({goal.tolist()}, v=1.0)", f"movel(p[{vector}], v=0.1)", "set_digital_out(2, True)"]
    run(controller, "def f():\n" + "\n".join(lines) + "\nend")
    assert controller.refusals.total() == 0
    assert robot.base_from_tcp(robot.targets) == pytest.approx(lower, abs=1e-6)
    assert robot.outputs == 0b100


@pytest.mark.parametrize("speed", [0.2, 1.0])
def test_speed_of_a_joint_move_is_that_of_its_fastest_joint(controller: UrController, speed: float) -> None:
    goal = controller.robot.home + np.array([0.5, 0.2, 0.0, 0.0, 0.0, 0.0])
    controller.run_script(f"movej({goal.tolist()}, v={speed})")
    fastest = 0.0
    while controller.is_running:
        controller.step()
        fastest = max(fastest, float(np.abs(controller.robot.target_rates).max()))
    assert fastest == pytest.approx(speed, rel=1e-3)
    assert controller.robot.joints == pytest.approx(goal, abs=RESOLUTION)


def test_line_is_straight_at_its_speed_for_another_tcp(controller: UrController) -> None:
    """The TCP is 120 mm in front of the flange; the path of the TCP, not of the sensor, is straight."""
    robot = controller.robot
    run(controller, "set_tcp(p[0, 0, 0.12, 0, 0, 0])")
    start = robot.base_from_tcp(robot.targets)
    end = start @ pose_of(np.array([0.05, 0.02, -0.04, 0.3, 0.0, 0.2]))
    controller.run_script(f"movel(p{pose_vector(end).tolist()}, v=0.05)")
    path, times = [start[:3, 3]], [robot.time]
    while controller.is_running:
        controller.step()
        path.append(robot.base_from_tcp(robot.targets)[:3, 3])
        times.append(robot.time)
    along = (end - start)[:3, 3] / np.linalg.norm((end - start)[:3, 3])
    way = np.array(path) - path[0]
    assert np.linalg.norm(way - np.outer(way @ along, along), axis=1).max() < 1e-6
    assert np.gradient(way @ along, times).max() == pytest.approx(0.05, rel=1e-2)
    assert robot.base_from_tcp(robot.targets) == pytest.approx(end, abs=1e-6)


@pytest.mark.parametrize(
    "line",
    [
        "movel(p[3, 0, 0.4, 0, 3.14, 0])",
        "movej(p[0, 0, 5, 0, 0, 0])",
        "movej([7, 0, 0, 0, 0, 0])",
        "set_digital_out(8, True)",
        "write_output_float_register(48, 1)",
        "rtde_set_watchdog('actual_q', 10)",
        "rtde_set_watchdog('input_int_register_0', 10, 'explode')",
    ],
)
def test_refused_statement_ends_the_program_at_rest(controller: UrController, line: str) -> None:
    run(controller, f"def f():\n  {line}\n  set_digital_out(0, True)\nend")
    assert controller.refusals["program"] == 1
    assert controller.robot.outputs == 0
    assert not controller.robot.is_moving
    run(controller, "set_digital_out(0, True)")
    assert controller.robot.outputs == 1


def test_registers_of_programs(controller: UrController) -> None:
    lines = ["write_output_integer_register(3, -7)", "write_output_boolean_register(33, True)"]
    run(controller, "def f():\n" + "\n".join([*lines, "write_output_boolean_register(64, True)"]) + "\nend")
    assert controller.registers["output_int_register_3"] == -7
    assert controller.registers["output_bit_registers32_to_63"] == 2
    assert controller.registers["output_bit_register_64"] == 1


def test_secondary_program_does_not_end_the_one_that_runs(controller: UrController) -> None:
    controller.run_script("sleep(1)")
    controller.step()
    controller.run_script("sec s():\n  set_digital_out(1, True)\nend")
    assert controller.is_running
    assert controller.robot.outputs == 0b10
    controller.run_script("sec s():\n  sleep(1)\nend")
    assert controller.refusals["script"] == 1


def test_pause_and_play_end_on_the_same_path(controller: UrController) -> None:
    robot, goal = controller.robot, controller.robot.home + 0.2
    controller.run_script(f"movej({goal.tolist()}, v=0.5)")
    for _ in range(100):
        controller.step()
    assert controller.pause()
    for _ in range(300):
        controller.step()
    rest = robot.targets
    for _ in range(50):
        controller.step()
    assert (robot.targets == rest).all()
    assert controller.runtime_state == 4
    assert controller.play()
    run_on = 0
    while controller.is_running:
        controller.step()
        run_on += 1
    assert 0 < run_on < 1_000
    assert robot.joints == pytest.approx(goal, abs=RESOLUTION)


def test_slider_slows_moves(controller: UrController) -> None:
    goal = (controller.robot.home + 0.3).tolist()
    full = run(controller, f"movej({goal}, v=0.5)")
    controller.set_speed_slider(0.25)
    slow = run(controller, f"movej({controller.robot.home.tolist()}, v=0.5)")
    assert 3.0 < slow / full < 4.5


def test_protective_stop_ends_the_program_until_it_is_unlocked(controller: UrController) -> None:
    controller.run_script(f"movej({(controller.robot.home + 0.5).tolist()}, v=1)")
    for _ in range(100):
        controller.step()
    controller.robot.stop()
    for _ in range(500):
        controller.step()
    assert controller.robot.is_stopped
    assert not controller.is_running
    assert not controller.robot.is_moving
    controller.run_script("sleep(1)")
    assert not controller.is_running
    assert controller.unlock()
    controller.step()
    controller.step()
    assert not controller.robot.is_stopped
    assert run(controller, f"movej({controller.robot.home.tolist()}, v=1)") > 100


@pytest.mark.parametrize("rates", [(0.5, 0, 0, 0, 0, 0), (0.0, -0.2, 0.1, 0, 0, 9.0)])
def test_streamed_speeds_accelerate_as_asked_within_the_limits(
    controller: UrController, rates: tuple[float, ...]
) -> None:
    robot, wanted = controller.robot, np.array(rates)
    robot.move_at_rates(lambda: wanted, 2.0)
    seen = []
    for _ in range(1_000):
        robot.step()
        seen.append(robot.target_rates)
    held = wanted / max(1.0, np.abs(wanted).max() / np.pi)  # 180 deg/s
    assert seen[-1] == pytest.approx(held, abs=1e-6)
    assert np.abs(np.diff(seen, axis=0)).max() / robot.cycle < 2.0 + 1e-6


def test_streams_end_at_joint_limits(controller: UrController) -> None:
    robot = controller.robot
    robot.move_at_rates(lambda: np.array([0, 0, 0, 0, 0, 3.0]), 10.0)
    for _ in range(1_500):
        robot.step()
    assert robot.joints[5] == pytest.approx(2 * np.pi, abs=1e-4)
    assert robot.fault == ""
    robot.move_at_rates(lambda: np.array([0, 0, 0, 0, 0, -1.0]), 10.0)
    for _ in range(500):
        robot.step()
    assert robot.joints[5] < 2 * np.pi - 0.5


def test_jacobian_of_the_tcp_is_that_of_differences(controller: UrController) -> None:
    robot, step = controller.robot, 1e-6
    for joints in np.random.default_rng(3).uniform(-2.0, 2.0, (5, 6)):
        whole = robot.tcp_jacobian(joints)
        for axis in range(6):
            ahead = robot.base_from_tcp(joints + step * np.eye(6)[axis])
            back = robot.base_from_tcp(joints - step * np.eye(6)[axis])
            assert (ahead - back)[:3, 3] / (2 * step) == pytest.approx(whole[:3, axis], abs=1e-6)
            turned = pose_vector(ahead @ np.linalg.inv(back))[3:]
            assert turned / (2 * step) == pytest.approx(whole[3:, axis], abs=1e-6)


@pytest.mark.parametrize(("action", "state"), [("stop", 1), ("pause", 4), ("ignore", 2)])
def test_watchdog_acts_on_a_program_that_is_not_fed(controller: UrController, action: str, state: int) -> None:
    lines = [f'rtde_set_watchdog("input_int_register_0", 10, "{action}")', "sleep(10)"]
    controller.run_script("def f():\n" + "\n".join(lines) + "\nend")
    for _ in range(200):
        controller.write_register("input_int_register_0", 1)
        controller.step()
    assert controller.runtime_state == 2
    for _ in range(60):
        controller.step()
    assert controller.runtime_state == state


def test_guard_holds_a_move_into_the_table() -> None:
    """The guard of the cell lets the controller of a UR move no nearer; streamed speeds are refused."""
    cell = scancell.assets_dir() / "cells" / "ur5e.toml"
    settings = {"cell.world.controller_cycle_us": 8000}
    with scancell.Scanner(cell, settings=settings) as scanner, scanner.session(guarded=True) as session:
        controller = UrController(VirtualRobot(session))
        robot = controller.robot
        below = robot.base_from_tcp(robot.home)
        below[:3, 3] = 0.45, 0.0, 0.09  # the top of the table is at 100 mm
        controller.run_script(f"movel(p{pose_vector(below).tolist()}, v=0.25)")
        lowest = np.inf
        for _ in range(600):
            controller.step()
            lowest = min(lowest, float(robot.base_from_tcp(robot.joints)[2, 3]))
        assert controller.refusals.total() == 0
        assert 0.1 < lowest < 0.2
        assert "table" in robot.text
        controller.stop_program()
        robot.move_at_rates(lambda: np.full(6, 0.1), 1.0)
        for _ in range(20):
            controller.step()
        assert "guard" in robot.fault


@pytest.mark.parametrize(
    ("cell", "part", "settings"),
    [("track", None, {"cell.axis[1].start_mm": 200.0}), ("held_part", "step_block.stl", {})],
)
def test_other_cells(cell: str, part: str | None, settings: dict[str, float]) -> None:
    """An arm on a track that does not rest at 0, and one that carries no sensor: poses are those in its base."""
    assets = scancell.assets_dir()
    with (
        scancell.Scanner(assets / "cells" / f"{cell}.toml", settings=settings) as scanner,
        scanner.session(None if part is None else assets / "parts" / part) as session,
    ):
        controller = UrController(VirtualRobot(session))
        robot = controller.robot
        goal = robot.base_from_tcp(robot.home)
        goal[:3, 3] += 0.01, 0.01, 0.03
        vector = pose_vector(goal).tolist()
        run(controller, f"def f():\n  movej({(robot.home + 0.05).tolist()}, v=0.5)\n  movel(p{vector}, v=0.1)\nend")
        assert controller.refusals.total() == 0
        frames = session.nominal.tree.place(session.destination, ["base", session.nominal.arm.flange])
        flange = np.linalg.inv(frames["base"]) @ frames[session.nominal.arm.flange]
        assert flange @ robot.flange_from_tcp == pytest.approx(goal, abs=1e-6)


def test_presence_sensors_are_digital_inputs() -> None:
    assets = scancell.assets_dir()
    with (
        scancell.Scanner(assets / "cells" / "pick_and_place.toml") as scanner,
        scanner.session(assets / "parts" / "step_block.stl") as session,
    ):
        robot, before = VirtualRobot(session), []
        session.run_conveyor(1, 0.15)
        while not robot.inputs and robot.time < 5.0:
            before.append(session.presence(1))
            robot.step()
        assert robot.inputs == 1
        assert session.presence(1)
        assert not any(before)


def test_other_numbers_of_joints_are_refused() -> None:
    cell = scancell.assets_dir() / "cells" / "seven_axis.toml"
    with (
        scancell.Scanner(cell) as scanner,
        scanner.session() as session,
        pytest.raises(DescriptionError, match="6 joints"),
    ):
        UrController(VirtualRobot(session))
