"""The same calls of an FMU on Linux and, under Wine, on Windows: written to a file, played by `call_player.c`."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from cell_fixture import (
    CYCLE_US,
    FREE,
    Array,
    CellFmu,
    box_hull,
    cell_description,
    collision,
    read_description,
    runtime_folder,
)  # fmt: skip
from grasp_fixture import OVER_BOX, PLACE, TABLE, grasp_cell, grip, joints_at, move

import scancell

_HERE = Path(__file__).parent
_FMI_HEADERS = _HERE.parents[1] / "fmu/third_party/fmi"
_LETTERS = {"Real": "r", "Float64": "r", "Integer": "i", "Int32": "i", "Enumeration": "e", "Boolean": "b"}
# Of Linux and Windows, below the folder of the native runtime.
_BINARIES = {
    "RobotCell": ("RobotCell.so", "windows/RobotCell.dll"),
    "CellSequencer": ("sequencer/CellSequencer.so", "windows/CellSequencer.dll"),
}
_WINDOWS_COMPILER = "x86_64-w64-mingw32-gcc-posix"


class Calls(CellFmu):
    """Takes the commands of a test and writes them down instead of executing them."""

    def __init__(self, folder: Path, parameters: Mapping[str, float] | None = None) -> None:
        """`folder` holds the model description and resources of an unpacked FMU."""
        self.folder = folder
        self.description = read_description(folder)
        self.version = int(self.description.fmiVersion[0])
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.token = self.description.guid
        self.time_us = 0
        self.starts = 0
        outputs = [v for v in self.description.modelVariables if v.causality == "output" and v.type in _LETTERS]
        self.reals = np.array([v.type in {"Real", "Float64"} for v in outputs])
        self.names = [v.name for v in outputs]
        self.lines = ["columns " + " ".join(map(self._reference, self.names))]
        for name, value in (parameters or {}).items():
            self.set(name, value)
        self.lines.append("start")

    def _reference(self, name: str) -> str:
        variable = self.variables[name]
        return f"{_LETTERS[variable.type]}{variable.valueReference}"

    def set(self, name: str, value: float | int | str) -> None:
        self.lines.append(f"set {self._reference(name)} {float(value)!r}")

    def start_move(self, q: Array | None = None, table: float | None = None, mode: int = 2) -> None:
        self.starts += 1
        self.command(q, table, mode)
        self.set("command.start", self.starts)

    def step(self, size_us: int, count: int = 1) -> None:
        """A row of the table follows each step."""
        for _ in range(count):
            self.lines += [f"step {size_us * 1e-6!r}", "row"]
            self.time_us += size_us

    def save_as(self, file: str) -> None:
        self.lines.append(f"save {file}")

    def load_from(self, file: str, time_us: int) -> None:
        self.lines += [f"load {file}", f"time {time_us * 1e-6!r}"]
        self.time_us = time_us


@dataclass(frozen=True)
class Player:
    """`call_player` and the binary of an FMU for one system."""

    folder: Path  # with the programs, and for files of states
    wine: bool

    def play(self, calls: Calls) -> tuple[Array, str]:
        """Rows of time and outputs, and what was written to the error output.

        Raises
        ------
        RuntimeError
            If a call failed; holds the messages of the FMU.
        """
        (self.folder / "calls.txt").write_text("\n".join([*calls.lines, ""]))
        binary = runtime_folder() / _BINARIES[calls.description.coSimulation.modelIdentifier][self.wine]
        resources = quote(str(calls.folder / "resources"))
        program = ["wine", "call_player.exe"] if self.wine else ["./call_player"]
        drive = "Z:" if self.wine else ""
        uri = f"file:///{drive}{resources}" if self.wine else f"file://{resources}"
        command = [*program, str(calls.version), f"{drive}{binary}", uri, calls.token, "calls.txt"]
        done = subprocess.run(
            command, cwd=self.folder, env=wine_environment(self.folder), capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(done.stderr)
        return np.array([line.split(",") for line in done.stdout.split()], dtype=float), done.stderr


def wine_environment(folder: Path) -> dict[str, str]:
    """Environment with a Wine prefix of its own below a folder, without Wine's browser, .NET and messages."""
    return {
        **os.environ,
        "WINEPREFIX": str(folder / "prefix"),
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": "mscoree,mshtml=",
    }


def missing_for_wine(fmu: str = "RobotCell") -> str | None:
    """What a test of an FMU under Wine misses here; None: nothing."""
    if not (runtime_folder() / _BINARIES[fmu][1]).is_file():
        return f"no {fmu}.dll: fmu/windows/build makes it"
    missing = [tool for tool in ("wine", _WINDOWS_COMPILER) if shutil.which(tool) is None]
    return f"not installed: {', '.join(missing)}" if missing else None


def make_player(folder: Path, *, wine: bool) -> Player:
    """Compile the player into a folder."""
    compiler, name, libraries = (
        (_WINDOWS_COMPILER, "call_player.exe", ["-static"]) if wine else ("cc", "call_player", ["-ldl"])
    )
    options = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-I", str(_FMI_HEADERS)]
    subprocess.run([compiler, *options, str(_HERE / "call_player.c"), "-o", str(folder / name), *libraries], check=True)
    return Player(folder, wine)


def differences(calls: Calls, a: Array, b: Array) -> tuple[Array, Array]:
    """Largest difference of the real outputs but forces at each row, and numbers of the rows where events differ.

    The friction of two fingers is statically indeterminate, and the number of contact problems that the first solver
    leaves to the second is no event.
    """
    np.testing.assert_array_equal(a[:, 0], b[:, 0])
    apart = np.abs(a - b)[:, 1:]
    is_force = np.array(["force" in name for name in calls.names])
    is_event = ~calls.reals & (np.array(calls.names) != "truth.contact.solver_fallbacks")
    return apart[:, calls.reals & ~is_force].max(axis=1), np.flatnonzero(apart[:, is_event].any(axis=1))


def normal_forces(calls: Calls, rows: Array) -> Array:
    """Normal forces of the fingers and the force of the gripper at each row, N."""
    names = [name.endswith(("normal_force", "gripper.force")) for name in calls.names]
    return rows[:, 1:][:, names]


def continued(calls: Calls, first: Player, second: Player, row: int) -> tuple[Array, Array]:
    """Rows after a row as `first` plays them, and as `second` does from the serialized state of `first` there."""
    whole, _ = first.play(calls)
    cut = [i for i, line in enumerate(calls.lines) if line == "row"][row - 1] + 1
    before, after = Calls(calls.folder), Calls(calls.folder)
    before.lines = calls.lines[:cut]
    before.save_as("state")
    first.play(before)
    if second.folder != first.folder:
        shutil.copyfile(first.folder / "state", second.folder / "state")
    after.load_from("state", round(whole[row - 1, 0] * 1e6))
    after.lines += calls.lines[cut:]
    rest, _ = second.play(after)
    rest[:, 0] = whole[row:, 0]  # sums of steps round differently
    return whole[row:], rest


def free_motion(calls: Calls) -> None:
    """A move of all axes with timed exposures, then a jog of half a cycle per step."""
    start = [float(calls.variables[f"command.q[{i}]"].start) for i in range(1, 7)]
    calls.trigger(1, 0.05, 0.002)
    calls.start_move(np.array(start) + 0.1, 1.0)
    calls.step(CYCLE_US, 60)
    calls.trigger(0)
    calls.step(CYCLE_US // 2, 20)


def spin_table(calls: Calls, steps: int, scale: float = 1.0) -> None:
    """The table gathers speed, up to 9.9 rad/s, by `scale` faster."""
    angle = 0.0
    for speed in np.minimum(np.linspace(0.0, 15.0, 90), 9.9)[:steps]:
        angle += speed * CYCLE_US * 1e-6
        calls.command(table=angle * scale)
        calls.step(CYCLE_US)


def part_slides(calls: Calls) -> None:
    """The part slides to the edge of the turning table."""
    spin_table(calls, 70)


def pick_and_place(calls: Calls) -> None:
    """Grip a box, lift it, carry it aside, put it down and let go."""
    grip(calls, 20.0)
    above = joints_at(np.array([*PLACE, TABLE[2] + 0.08]))
    x, y = PLACE[0] + 0.03, PLACE[1] + 0.04
    aside, down = joints_at(np.array([x, y, TABLE[2] + 0.08])), joints_at(np.array([x, y, TABLE[2] + 0.021]))
    for start, end in ((OVER_BOX, above), (above, aside), (aside, down)):
        move(calls, start, end, 0.5)
    calls.set("command.gripper.mode", 1)
    calls.set("command.gripper.width", 0.06)
    calls.step(CYCLE_US, 40)


def _shipped_cell() -> dict[str, Any]:
    setup = scancell.load_setup()
    part = scancell.load_part(Path(__file__).parents[2] / "assets/parts/step_block.stl")
    return scancell.cell_json(setup.cell, scancell.nominal_cell(setup.cell, part), seed=0)


def _watched_cell() -> dict[str, Any]:
    """The test cell with outputs of the clearances between a tool and bodies on the table."""
    hulls = {"tool": ("link[6]", box_hull(0.06, 0.06, 0.1)), "part": ("part[1]", box_hull(0.06, 0.04, 0.05)),
             "post": ("table", box_hull(0.01, 0.01, 0.2))}  # fmt: skip
    bodies = [{"name": name, "frame": frame, "mesh": mesh} for name, (frame, mesh) in hulls.items()]
    pairs = collision(("tool", "part"), ("tool", "post"), range=1.0)
    return {**cell_description(), "bodies": bodies, "collision": pairs}


@dataclass(frozen=True)
class Scenario:
    """A cell, what moves it, and how far the systems may be apart (SI units)."""

    cell: Callable[[], dict[str, Any]]
    motion: Callable[[Calls], None]
    tolerance: float

    def calls(self, folder: Path) -> Calls:
        """Calls of the FMU of the cell, unpacked in a folder."""
        calls = Calls(folder)
        self.motion(calls)
        return calls


_WITHOUT_CONTACT, _WITH_CONTACT = 1e-9, 10e-6
SCENARIOS = {
    "arm and table": Scenario(cell_description, free_motion, _WITHOUT_CONTACT),
    "shipped cell": Scenario(_shipped_cell, free_motion, _WITHOUT_CONTACT),
    "clearances": Scenario(_watched_cell, free_motion, _WITHOUT_CONTACT),
    "part slides": Scenario(lambda: FREE, part_slides, _WITH_CONTACT),
    "pick and place": Scenario(grasp_cell, pick_and_place, _WITH_CONTACT),
}
