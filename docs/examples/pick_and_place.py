"""A part comes on the belt, is picked, put on the rotary table and scanned: ``python docs/examples/pick_and_place.py``.

Writes what ``scancell scan`` writes, and ``devices.png`` with the signals of every device, to the folder of ``--out``.
The cell is described in ``assets/cells/pick_and_place.toml``; docs/examples/pick_and_place.md explains.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from scancell import (
    CellSession,
    NominalCell,
    ScancellError,
    Scanner,
    ScanResult,
    Setup,
    SignalLog,
    assets_dir,
    load_setup,
    pose,
)

Array = NDArray[np.float64]

BELT_SPEED = 0.15  # m/s
GRIP_HEIGHT = 0.004  # m, of the finger tips above what the part lies on
APPROACH = 0.08  # m above that, from where the gripper goes straight down
DROP = 0.0002  # m above the table, where the part is let go
GRIP_FORCE = 30.0  # N
OPEN = 0.065  # m
GRIPPER_DOWN = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # closes along the world's y, reaches down

REALS = (
    "conveyor[1].travel", "conveyor[1].speed", "measured.gripper.width", "measured.gripper.force", "measured.table",
    *(f"measured.q[{i}]" for i in range(1, 7)),
    *(f"truth.part[1].position[{i}]" for i in (1, 2, 3)), *(f"truth.part[1].orientation[{i}]" for i in (1, 2, 3, 4)),
    "truth.clearance.distance",
)  # fmt: skip
BOOLEANS = ("presence[1].detected", "measured.gripper.gripped")


@dataclass
class PickAndPlace:
    """The commands that bring the part from the belt to the table, and what the devices did meanwhile."""

    setup: Setup
    nominal: NominalCell
    log: SignalLog | None = None
    stages: list[tuple[float, str]] = field(default_factory=list)

    def __call__(self, session: CellSession) -> None:
        """Run before the scan's program; ends at home, where that starts."""
        self.log = SignalLog(session.cell, REALS, BOOLEANS)
        world_from_part = self.fetch(session)
        self.stage(session, "pick")
        world_from_gripper = self.pick(session, world_from_part)
        self.stage(session, "place")
        self.place(session, pose.inverse(world_from_part) @ world_from_gripper)
        self.stage(session, "home")
        session.move_joints(self.nominal.home, 0.0, speed=0.5)
        self.stage(session, "scan")

    def stage(self, session: CellSession, name: str) -> None:
        """Remember when a stage began."""
        self.stages.append((session.time, name))

    def fetch(self, session: CellSession) -> Array:
        """Let the belt run until the barrier sees the part; returns where the part stands then, (4, 4).

        The barrier tells where its front is, and the belt's encoder how far it goes on until it rests.
        """
        self.stage(session, "belt")
        session.open_gripper(OPEN)
        session.run_conveyor(1, BELT_SPEED)
        session.wait_until(lambda: session.presence(1), "a part at the gate", timeout=20.0)
        seen = session.conveyor_travel(1)
        session.run_conveyor(1, 0.0)
        session.wait_until(lambda: session.value("conveyor[1].speed") == 0.0, "the belt at rest", timeout=5.0)
        overrun = session.conveyor_travel(1) - seen

        cell = self.setup.cell
        gate, belt = cell.presence_sensor[0], cell.conveyor[0]
        front = (gate.pose.y_mm - gate.y_size_mm / 2) * 1e-3
        half = self.nominal.part.bounds[1, 1]  # the part's y is the belt's x
        middle = front - half + overrun
        return pose.translation((belt.pose.x_mm * 1e-3, middle, belt.pose.z_mm * 1e-3))

    def pick(self, session: CellSession, world_from_part: Array) -> Array:
        """Grip the part and lift it; returns the gripper's pose (4, 4) when it closed."""
        grip = self.above(session, world_from_part[:3, 3])
        session.move_tool(lifted(grip), "gripper", speed=0.5)
        session.move_line(grip, "gripper", speed=0.1)
        session.close_gripper(GRIP_FORCE)
        session.move_line(lifted(grip), "gripper", speed=0.1)
        return grip

    def place(self, session: CellSession, part_from_gripper: Array) -> None:
        """Put the part where the scan expects it."""
        goal = pose.translation((0, 0, DROP)) @ self.nominal.world_from("part") @ part_from_gripper
        session.move_tool(lifted(goal), "gripper", speed=0.3)
        session.move_line(goal, "gripper", speed=0.05)
        session.open_gripper(OPEN)
        session.move_line(lifted(goal), "gripper", speed=0.1)

    def above(self, session: CellSession, place: Array) -> Array:
        """Pose (4, 4) of the gripper whose finger tips are at the part's sides, the part standing at a place (3,)."""
        gripper = self.setup.cell.gripper
        if gripper is None:
            raise ScancellError("the cell has no gripper")
        reach = np.array([0.0, 0.0, GRIP_HEIGHT + gripper.finger_length_mm * 1e-3])
        return pose.from_rotation(GRIPPER_DOWN, place + reach)


def lifted(world_from_gripper: Array) -> Array:
    """The same pose, higher."""
    return np.asarray(pose.translation((0.0, 0.0, APPROACH)) @ world_from_gripper)


def placing_error(task: PickAndPlace) -> tuple[float, float]:
    """How far (m) and by what angle (rad) the part lies off its nominal place on the table when the scan begins."""
    assert task.log is not None
    row = int(np.searchsorted(task.log.time, task.stages[-1][0]))
    position = [task.log[f"truth.part[1].position[{i}]"][row] for i in (1, 2, 3)]
    turn = [task.log[f"truth.part[1].orientation[{i}]"][row] for i in (1, 2, 3, 4)]
    off = pose.inverse(task.nominal.world_from("part")) @ pose.pose(position, turn)
    return float(np.linalg.norm(off[:3, 3])), float(np.linalg.norm(pose.log_rotation(off[:3, :3])))


def draw(task: PickAndPlace, path: Path) -> None:
    """A plot for each device over the simulated time."""
    log = task.log
    assert log is not None
    time = log.time
    plt.style.use("scancell.plots")
    figure, rows = plt.subplots(8, 1, figsize=(10, 14), sharex=True)
    belt, presence, width, force, joints, height, table, clear = rows
    belt.plot(time, log["conveyor[1].travel"] * 1e3, label="belt's way (mm)")
    belt.plot(time, log["conveyor[1].speed"] * 1e3, label="speed (mm/s)")
    presence.step(time, log["presence[1].detected"], where="post", label="part at the gate")
    presence.step(time, log["measured.gripper.gripped"], where="post", label="part gripped")
    presence.set_yticks([0, 1])
    width.plot(time, log["measured.gripper.width"] * 1e3, label="gripper's opening (mm)")
    force.plot(time, log["measured.gripper.force"], label="force of a finger (N)")
    for i in range(1, 7):
        joints.plot(time, np.degrees(log[f"measured.q[{i}]"]), label=f"joint {i} (deg)")
    height.plot(time, log["truth.part[1].position[3]"] * 1e3, label="height of the part (mm)")
    table.plot(time, np.degrees(log["measured.table"]), label="table (deg)")
    clear.plot(time[1:], log["truth.clearance.distance"][1:] * 1e3, label="smallest clearance (mm, up to 50)")
    for axes in rows:
        for begin, _ in task.stages:
            axes.axvline(begin, color="0.7", lw=0.8)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes.grid()
    for begin, name in task.stages:
        rows[0].annotate(name, (begin, 1.02), xycoords=("data", "axes fraction"), fontsize="small")
    # The scan goes on much longer than what comes before it.
    end = task.stages[-1][0] + 12.0
    rows[-1].set(xlabel="simulated time (s)", xlim=(0.0, end))
    turned = np.degrees(log["measured.table"][time < end])
    table.set_ylim(turned.min() - 20.0, turned.max() + 20.0)
    figure.savefig(path)
    plt.close(figure)


def run(part: Path, out: Path, setup: Setup, engine: str = "ray-traced") -> tuple[ScanResult, PickAndPlace]:
    """The whole example; results in `out`.

    Raises
    ------
    ScancellError
        With a message for people, whatever is wrong.
    """
    with Scanner(setup=setup) as scanner:
        task = PickAndPlace(setup, scanner.pipeline.load(setup, scanner.load_part(part)).nominal)
        result = scanner.scan(part, engine="geometric" if engine == "geometric" else "ray-traced", hook=task)
    result.save(out)
    draw(task, out / "devices.png")
    return result, task


def main() -> int:
    """Run the example as a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/pick_and_place"))
    parser.add_argument("--set", action="append", default=[], help="change a description, as in `scancell scan`")
    parser.add_argument("--engine", choices=["ray-traced", "geometric"], default="ray-traced")
    given = parser.parse_args()
    try:
        setup = load_setup(assets_dir() / "cells/pick_and_place.toml", settings=given.set)
        result, task = run(assets_dir() / "parts/step_block.stl", given.out, setup, given.engine)
    except ScancellError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    away, turn = placing_error(task)
    print(result.summary())
    print(f"the part lies {away * 1e6:.1f} µm and {np.degrees(turn) * 60:.2f} arcmin off its nominal place")
    print(f"signals of the devices: {given.out / 'devices.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
