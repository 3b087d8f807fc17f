"""A cell and its guard in another process: what becomes of the robot when the guard dies, and obstacles it knows.

The cell's clock stands still while an answer is under way: nothing depends on how busy the machine is.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import COMMAND, PATIENCE_S, environment

from guard_answers import until
from scancell.cell.driver import Mode, Operation
from scancell.cell.fmu_file import cell_json, make_temporary_fmu
from scancell.cell.instance import CellInstance
from scancell.config.cell import CellDescription
from scancell.config.choices import LOOPBACK
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry.mesh import box_mesh
from scancell.guard.guard import GuardedCell, GuardSettings
from scancell.guard.parts import Tool
from scancell.guard.transport import Arrival, Link, TcpTransport, Transport, UdpTransport
from scancell.nominal.cell import NominalCell, nominal_cell

TRANSPORTS = {"udp": UdpTransport, "tcp": TcpTransport}
AGE = GuardSettings().max_age
TO_POST = 1.3  # rad of joint 1 from home to the middle of the post
POST = (0.06, 0.06, 0.5)  # m
MOVED = 0.3  # rad of joint 1 at which it has its full speed
EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "guarded_cell.py"
SAMPLES = 4  # of the motion in a cycle
EMERGENCY, TIMEOUT = 3, 11  # controller.state, controller.error


@pytest.fixture(scope="module")
def post(tmp_path_factory) -> tuple[Path, Path, np.ndarray]:
    """A cell with a post where joint 1 leads the sensor, its mesh, and the place of the post, m."""
    folder = tmp_path_factory.mktemp("post")
    bare = nominal_cell(load_setup().cell, box_mesh((0.01, 0.01, 0.01)))
    turned = bare.home.copy()
    turned[0] += TO_POST
    place = Tool(bare).poses(turned[None])[0][0, :3, 3] * [1, 1, 0] + [0, 0, POST[2] / 2]
    mesh = folder / "post.stl"
    trimesh.creation.box(1e3 * np.array(POST)).export(mesh)
    shipped = assets_dir()
    text = (shipped / "cells" / "default.toml").read_text().replace('"../', f'"{shipped}/')
    x, y, z = 1e3 * place
    text += f'\n[[obstacle]]\nname = "post"\nmesh = "{mesh}"\npose = {{ x_mm = {x}, y_mm = {y}, z_mm = {z} }}\n'
    cell = folder / "cell.toml"
    cell.write_text(text)
    return cell, mesh, place


@contextlib.contextmanager
def served(*words: str | Path, port: int = 0) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """`scancell guard serve` and its port."""
    process = subprocess.Popen(
        [*COMMAND, "guard", "serve", *map(str, words), "--port", str(port), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("guard: "), line + process.stderr.read()
        yield process, int(line.split()[-1])
    finally:
        process.kill()
        process.communicate(timeout=PATIENCE_S)


class Waiting:
    """A transport that waits for the answer to each state while the guard answers."""

    def __init__(self, transport: Transport) -> None:
        self._transport, self.answers, self._sent = transport, True, False

    def send(self, packet: bytes, time: float) -> None:
        self._transport.send(packet, time)
        self._sent = True

    def receive(self, time: float) -> list[Arrival]:
        sent, self._sent = self._sent, False
        if sent and self.answers:
            return until(lambda: self._transport.receive(time) or None)
        return self._transport.receive(time)

    def reset(self) -> None:
        self._transport.reset()

    def close(self) -> None:
        self._transport.close()


@dataclass
class Rig:
    """A cell with a guard; `times` (s) and `angles` (rad) of joint 1 from home.

    `answers` are the times of their states, s, and whether they are emergency stops.
    """

    cell: CellInstance
    nominal: NominalCell
    cycle_us: int
    link: Link | None
    transport: Waiting | None
    times: list[float] = field(default_factory=list)
    angles: list[float] = field(default_factory=list)
    answers: list[tuple[float, bool]] = field(default_factory=list)
    touched: bool = False

    def __post_init__(self) -> None:
        self.guarded = GuardedCell(self.cell, self.cycle_us, self.link, AGE)
        self._truth = self.cell.real_group(["truth.q[1]"])
        self.targets = self.cell.real_group(self.cell.axis_names("command."))
        self._speed = self.cell.real_group(["command.speed"])
        self._jog = self.cell.real_group(["command.jog[1]"])
        self.rate = self.cell.real_group(["controller.rate"])

    def start(self, operation: Operation) -> None:
        """Joint 1 turns to the post and beyond: by hand at full deflection, or by a move at about 1 rad/s."""
        self.cell.set_integer("command.operation", operation)
        if operation is Operation.MANUAL:
            self.cell.set_integer("command.mode", Mode.JOINT_JOG)
            self.cell.set(self._jog, np.array([1.0]))
        else:
            self.cell.set_integer("command.mode", Mode.JOINT_MOVE)
            self.cell.set(self.targets, np.append(self.nominal.home + np.eye(6)[0] * 1.7 * TO_POST, 0.0))
            self.cell.set(self._speed, np.array([0.18]))
            self.cell.set_integer("command.start", 1)

    def reset(self, operation: Operation) -> None:
        """As a person does: a jog is let go first, and begun again."""
        mode = self.cell.get_integer("command.mode")
        if operation is Operation.MANUAL:
            self.cell.set_integer("command.mode", Mode.HOLD)
        self.cell.set_integer("command.reset", self.cell.get_integer("command.reset") + 1)
        self.cycles(3)
        self.cell.set_integer("command.mode", mode)

    def cycle(self) -> None:
        self.answers += [(answer.state_time, answer.emergency_stop) for answer in self.guarded.poll()]
        start = self.cell.time_us
        for k in range(1, SAMPLES + 1):
            self.cell.step_to(start + k * self.cycle_us // SAMPLES)
            self.times.append(self.cell.time_us * 1e-6)
            self.angles.append(float(self.cell.get(self._truth)[0] - self.nominal.home[0]))
        self.touched |= self.cell.get_integer("truth.collision.pairs") > 0

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.cycle()

    def rests(self) -> bool:
        return not self.cell.get_boolean("controller.moving")

    def stopped(self) -> bool:
        return self.cell.get_integer("controller.state") == EMERGENCY

    def until(self, condition: Callable[[], bool]) -> None:
        """Run until a condition holds, at most 10 s."""
        for _ in range(round(10e6 / self.cycle_us)):
            self.cycle()
            if condition():
                return
        raise AssertionError(f"joint 1 is at {self.angles[-1]:.3f} rad: the condition never held")

    def angle_at(self, time: float) -> float:
        return float(np.interp(time, self.times, self.angles))

    def speed(self) -> float:
        """Of joint 1 in the last sample, rad/s."""
        return (self.angles[-1] - self.angles[-2]) / (self.times[-1] - self.times[-2])


@contextlib.contextmanager
def rig(cell_file: Path, folder: Path, port: int = 0, protocol: str = "udp") -> Iterator[Rig]:
    """The cell; port 0: without a guard."""
    description = load_setup(cell_file).cell
    nominal = nominal_cell(description, box_mesh((0.01, 0.01, 0.01)))
    transport = Waiting(TRANSPORTS[protocol](LOOPBACK, port)) if port else None
    link = Link(transport, AGE) if transport else None
    with CellInstance(make_temporary_fmu(cell_json(description, nominal, 0), folder / f"fmu{port}")) as cell:
        yield Rig(cell, nominal, description.world.controller_cycle_us, link, transport)
    if transport:
        transport.close()


def acceleration() -> float:
    """Of joint 1, rad/s2."""
    return float(np.radians(CellDescription.default().robot.joint[0].max_acceleration_deg_s2))


def guaranteed(operation: Operation, speed: float, cycle: float) -> float:
    """Angle (rad) after the last answered state within which joint 1 rests, from its `speed` (rad/s).

    By hand it goes on for the age and two cycles, then brakes; a program slows down from half of the age on.
    """
    braking = speed**2 / (2 * acceleration())
    if operation is Operation.MANUAL:
        return speed * (AGE + 2 * cycle) + braking + speed * cycle / 2
    return speed * (AGE / 2 + 2 * cycle) + braking


@pytest.mark.parametrize("operation", Operation)
def test_without_a_guard_the_robot_runs_into_the_post(operation, post, tmp_path):
    with rig(post[0], tmp_path) as run:
        run.start(operation)
        run.until(lambda: run.touched)


@pytest.mark.parametrize("protocol", TRANSPORTS)
@pytest.mark.parametrize("operation", Operation)
def test_robot_rests_when_the_guard_is_killed_and_moves_again_only_after_resets(operation, protocol, post, tmp_path):
    """At full speed: within the guaranteed stop. A new guard, a new session and a reset are all needed to go on."""
    with served(post[0], "--transport", protocol) as (process, port), rig(post[0], tmp_path, port, protocol) as run:
        run.start(operation)
        run.until(lambda: run.angles[-1] > MOVED)
        speed, answered = run.speed(), run.answers[-1][0]
        before = run.angle_at(answered)
        assert speed > 0.45
        process.send_signal(signal.SIGKILL)
        process.wait()
        run.transport.answers = False
        run.until(run.rests)
        assert run.answers[-1][0] == answered
        assert run.angles[-1] - before <= guaranteed(operation, speed, 1e-6 * run.cycle_us)
        assert run.angles[-1] - before >= speed * AGE / 2  # permitted until then
        run.cycles(4)  # the error comes with the age, the rest before
        error, state = (run.cell.get_integer(f"controller.{name}") for name in ("error", "state"))
        assert state == EMERGENCY if operation is Operation.MANUAL else error == TIMEOUT

        with served(post[0], "--transport", protocol, port=port):
            stood = run.angles[-1]
            accepted = run.link.counts.copy()
            run.cycles(30)
            run.reset(operation)
            run.cycles(30)
            assert run.link.counts == accepted  # the session has ended with the guard
            run.link.reset()
            run.transport.answers = True
            run.cycles(30)
            assert run.answers[-1][0] > answered
            assert np.ptp([stood, *run.angles[-90 * SAMPLES :]]) < 1e-6
            run.reset(operation)
            run.cycles(20)
            assert run.angles[-1] > stood + 0.01
            run.until(run.rests)
        assert not run.touched


def test_jog_slows_down_and_rests_in_front_of_the_post(post, tmp_path):
    """Without an emergency stop; if the guard dies when it slows the robot down, the robot stops farther away."""
    with served(post[0]) as (_, port), rig(post[0], tmp_path / "first", port) as run:
        run.start(Operation.MANUAL)
        run.until(lambda: run.rests() and run.angles[-1] > MOVED)
        run.cycles(20)
        assert run.rests()
        assert not run.touched
        assert not any(stop for _, stop in run.answers)
        assert run.cell.get_string("pendant.text").startswith("no jog: ")
        held = run.angles[-1]
    with served(post[0]) as (process, port), rig(post[0], tmp_path / "second", port) as run:
        run.start(Operation.MANUAL)
        run.until(lambda: run.cell.get_string("pendant.text").startswith("slowed: "))
        process.send_signal(signal.SIGKILL)
        process.wait()
        run.transport.answers = False
        run.until(run.stopped)
        run.until(run.rests)
        assert not run.touched
    assert MOVED < run.angles[-1] < held


def test_move_that_the_guard_has_not_seen_does_not_begin(post, tmp_path):
    """The guard dies before it; what it permitted at rest is no permission to move."""
    with served(post[0]) as (process, port), rig(post[0], tmp_path, port) as run:
        run.cell.set_integer("command.operation", Operation.AUTOMATIC)
        run.cycles(20)
        assert run.answers
        process.send_signal(signal.SIGKILL)
        process.wait()
        run.transport.answers = False
        run.start(Operation.AUTOMATIC)
        run.cycles(2)
        assert run.cell.get_string("pendant.text") == "Waits for the guard"
        run.until(lambda: run.cell.get_integer("controller.error") == TIMEOUT)
        run.cycles(10)
        assert run.rests()
        assert np.ptp(run.angles) == 0


def test_each_move_of_a_chain_waits_for_an_answer_to_a_state_that_shows_it(post, tmp_path):
    """There and back, the second one given while the first is under way: it stops on its path first."""
    with served(post[0]) as (_, port), rig(post[0], tmp_path, port) as run:
        path_time = run.cell.real_group(["controller.path_time"])
        run.start(Operation.AUTOMATIC)
        run.until(lambda: run.angles[-1] > MOVED)
        first = float(run.cell.get(path_time)[0])
        run.cell.set(run.targets, np.append(run.nominal.home, 0.0))
        run.cell.set_integer("command.start", 2)
        run.until(lambda: run.cell.get(path_time)[0] > first)
        second = float(run.cell.get(path_time)[0])
        run.until(lambda: not run.rests())
        waited = 1e-6 * (run.cell.time_us - run.cycle_us) - second
        shown = [time for time, _ in run.answers if time > second]
        assert len(shown) >= 1
        assert 1e-6 * run.cycle_us <= waited <= 4e-6 * run.cycle_us
        run.until(lambda: run.cell.get_boolean("controller.at_destination"))
        assert abs(run.angles[-1]) < 1e-9
        assert not any(stop for _, stop in run.answers)


@pytest.mark.parametrize("known", ["obstacle", "points"])
def test_move_waits_in_front_of_what_the_guard_knows(known, post, tmp_path):
    """A post of the cell's description, or one that only a measured point cloud shows."""
    cell, _, place = post
    words: list[str | Path] = [cell]
    if known == "points":
        grid = [np.arange(-side / 2, side / 2 + 1e-9, 5e-3) for side in POST]
        points = np.stack(np.meshgrid(*grid), -1).reshape(-1, 3) + place
        trimesh.PointCloud(1e3 * points).export(tmp_path / "cloud.ply")
        scan = tmp_path / "scan.toml"
        scan.write_text(f'[[occupied]]\nfile = "{tmp_path / "cloud.ply"}"\nframe = "world"\n')
        words = [assets_dir() / "cells" / "default.toml", "--scan", scan]
    with served(*words) as (_, port), rig(cell, tmp_path, port) as run:
        run.start(Operation.AUTOMATIC)
        run.until(lambda: run.rests() and run.angles[-1] > 0.1)
        run.cycles(20)
        assert run.rests()
        assert not run.touched
        assert run.cell.get_integer("controller.error") == 0
        assert run.cell.get_integer("controller.state") != EMERGENCY
        assert run.cell.get(run.rate)[0] == 0.0
        assert "slow" in run.cell.get_string("pendant.text").lower()
        assert 0.5 < run.angles[-1] < TO_POST


def test_example_in_real_time_rests_without_contact():
    """Held by the guard, or stopped by it where the machine is busy and answers come late or not at all."""
    with served() as (_, port):
        command = [sys.executable, str(EXAMPLE), LOOPBACK, str(port)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1]
    assert last.startswith(("no jog: ", "slowed: ", "Emergency stop"))
    assert "; 0 contacts; packets: " in last
    assert " accepted" in last
