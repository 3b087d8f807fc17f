"""A cell whose guard answers in simulated time, and the contacts that python-fcl finds in the true motion."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from fcl_collisions import colliding

from scancell.cell.driver import Mode
from scancell.cell.fmu_file import cell_json, make_temporary_fmu
from scancell.cell.instance import CellInstance
from scancell.cell.session import CellSession
from scancell.config.cell import CellDescription
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.guard.guard import Guard, GuardedCell
from scancell.guard.parts import PartTracker
from scancell.guard.transport import InProcess, Link
from scancell.nominal.cell import NominalCell, fmu_frame, nominal_cell
from scancell.proximity.scene import ProximityScene
from scancell.scanning.session import guard_of, settings_of
from scancell.studies.guard.scenario import moving_program
from scancell.studies.guard.simulation import EarlierCell

EMERGENCY_STOP = 3  # of controller.state
_ANSWER_TIME = 0.003  # s
_RESET_WAIT = 0.6  # s, after which the guard takes a new session
_JUDGED = 4  # samples of the motion in a controller cycle


class RestartedServer:
    """A guard in this process that can be replaced by a new one, which knows nothing of the past."""

    def __init__(self, make: Callable[[], Guard]) -> None:
        self._make = make
        self.restart()

    def restart(self) -> None:
        self._now = InProcess(self._make(), _ANSWER_TIME)
        self.send, self.receive = self._now.send, self._now.receive

    def reset(self) -> None:
        """There is no connection."""

    def close(self) -> None:
        """There is no connection."""


@dataclass
class GuardRig:
    """A robot at `start` (axes,), rad or m, that does what a test commands."""

    description: CellDescription
    nominal: NominalCell
    session: CellSession
    server: RestartedServer
    link: Link
    guarded: GuardedCell
    folder: Path
    axes: list[np.ndarray] = field(default_factory=list)
    frames: list[np.ndarray] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    stops: int = 0

    def __post_init__(self) -> None:
        cell = self.session.cell
        self._truth = cell.real_group(cell.axis_names("truth."))
        self._moving = [
            name
            for name in dict.fromkeys(fmu_frame(body.moves_with) for body in self.nominal.bodies)
            if name.startswith(("finger[", "part["))
        ]
        self._poses = cell.real_group(
            [
                f"truth.{frame}.{key}"
                for frame in self._moving
                for key in (*(f"position[{i}]" for i in (1, 2, 3)), *(f"orientation[{i}]" for i in (1, 2, 3, 4)))
            ]
        )

    @property
    def now(self) -> np.ndarray:
        """Commanded positions (axes,), rad or m, of a robot at rest."""
        return self.session.commanded

    def cycles(self, count: int) -> None:
        cell, cycle_us = self.session.cell, self.description.world.controller_cycle_us
        for _ in range(count):
            self.stops += sum(answer.emergency_stop for answer in self.guarded.poll())
            start = cell.time_us
            for k in range(1, _JUDGED + 1):
                cell.step_to(start + k * cycle_us // _JUDGED)
                self.axes.append(cell.get(self._truth).copy())
                self.frames.append(cell.get(self._poses).copy())
            self.texts.append(cell.get_string("pendant.text"))

    def until_there(self, patience: float = 1.0) -> bool:
        """Whether the last move arrives within `patience` (s)."""
        for _ in range(round(patience / self.session.cycle)):
            self.cycles(1)
            if self.session.cell.get_boolean("controller.at_destination"):
                return True
        return False

    def move(self, by: np.ndarray, speed: float = 1.0, patience: float = 1.0) -> bool:
        """Whether a joint move by a travel of each axis (axes,), rad or m, arrives."""
        self.session._start_move(self.now + by, speed)
        return self.until_there(patience)

    def run_program(self, by: np.ndarray, points: int = 2, patience: float = 1.0) -> bool:
        """Whether a segment of equidistant set-points arrives, one per controller cycle."""
        cell, start = self.session.cell, self.now
        path = start + np.linspace(0.0, 1.0, points)[:, None] * by
        times = self.session.cycle * np.arange(points)
        file = self.folder / f"program{len(self.axes)}.json"
        file.write_text(json.dumps(moving_program(times, np.asarray(path), len(self.nominal.home))))
        cell.set_string("command.program", str(file))
        cell.set_integer("command.segment", 1)
        cell.set_integer("command.mode", Mode.PROGRAM)
        cell.set_integer("command.start", cell.get_integer("command.start") + 1)
        return self.until_there(patience)

    def renew_session(self, restarts: bool = False) -> None:
        """Open a new session with the guard, which may be restarted, and reset the controller, as an operator does."""
        if restarts:
            self.server.restart()
        self.link.reset()
        self.cycles(round(_RESET_WAIT / self.session.cycle))
        self.session.release_emergency_stop()
        self.cycles(4)

    def poses(self) -> np.ndarray:
        """True poses (n, bodies, 4, 4) of all bodies."""
        axes, rows = np.array(self.axes), np.array(self.frames)
        frames = self.nominal.frame_poses(axes)
        for k, frame in enumerate(self._moving):
            row = rows[:, 7 * k : 7 * k + 7]
            placed = np.tile(np.eye(4), (len(row), 1, 1))
            placed[:, :3, :3] = np.array([pose.rotation_from_quaternion(one) for one in row[:, 3:]])
            placed[:, :3, 3] = row[:, :3]
            frames["part" if frame == "part[1]" else frame] = placed
        return np.stack([frames[body.moves_with] for body in self.nominal.bodies], 1)

    def contacts(
        self, shifts: Mapping[str, np.ndarray] | None = None, touching: tuple[tuple[str, str], ...] = ()
    ) -> set[tuple[str, str]]:
        """Pairs that come into contact: of all bodies that move relative to each other and are apart at the start.

        Bodies are truly `shifts` (m, in the world at the start) from where the guard assumes them. Pairs `touching`
        may touch.
        """
        poses = self.poses()
        for k, body in enumerate(self.nominal.bodies):
            if shifts and body.name in shifts:
                poses[:, k, :3, 3] += poses[:, k, :3, :3] @ (poses[0, k, :3, :3].T @ shifts[body.name])
        meshes = {body.name: body.mesh for body in self.nominal.bodies}
        names = list(meshes)
        relative = np.linalg.inv(poses)[:, :, None] @ poses[:, None]
        moves = np.ptp(relative, axis=0).max((-1, -2)) > 1e-7
        pairs = [
            (a, b)
            for (i, a), (j, b) in combinations(enumerate(names), 2)
            if moves[i, j] and (a, b) not in touching and (b, a) not in touching
        ]
        kept = np.unique(np.append(np.arange(0, len(poses), _JUDGED), len(poses) - 1))
        found = colliding(meshes, pairs, poses[kept])
        at_start = {(a, b) for k, a, b in found if k == 0}
        return {(a, b) for _, a, b in found} - at_start


@contextmanager
def guard_rig(
    folder: Path, description: CellDescription, part: Mesh | None, start: np.ndarray, version: int = 2
) -> Iterator[GuardRig]:
    """A robot at `start` (axes,), rad or m, in front of a guard of the description and the part.

    Its controller speaks a `version` of the guard's protocol.
    """
    nominal = nominal_cell(description, part)
    server = RestartedServer(lambda: guard_of(description, part))
    described = cell_json(description, nominal, 0, collision_outputs=False)
    for axis, at in zip(
        [*described["robot"]["joints"], described["table"], *described.get("axes", ())], start, strict=True
    ):
        axis["start"] = float(at)
    max_age = settings_of(description).max_age
    with CellInstance(make_temporary_fmu(described, folder / "fmu")) as cell:
        cycle_us = description.world.controller_cycle_us
        link = Link(server, max_age)
        session = CellSession(cell, nominal, cycle_us)
        kind = GuardedCell if version == 2 else EarlierCell
        guarded = kind(cell, cycle_us, link, max_age, parts=PartTracker(description, nominal))
        yield GuardRig(description, nominal, session, server, link, guarded, folder)


class Distance:
    """Distance of two bodies, m, at axes (joints + 1,), rad."""

    def __init__(self, nominal: NominalCell, pair: tuple[str, str]) -> None:
        bodies = [body for body in nominal.bodies if body.name in pair]
        self._cell = replace(nominal, bodies=tuple(bodies))
        self._scene = ProximityScene({body.name: body.mesh for body in bodies}, [pair])

    def __call__(self, axes: np.ndarray) -> float:
        poses = self._cell.body_poses(axes[None])
        return float(self._scene.distances(poses, np.inf, 1)[0, 0])

    def direction(self, axes: np.ndarray) -> np.ndarray:
        """Unit vector (3,), in the world, from the first body to the second."""
        poses = self._cell.body_poses(axes[None])
        first, second = self._scene.closest_points(poses, np.inf, 1)[1][0, 0]
        return np.asarray((second - first) / np.linalg.norm(second - first))

    def reached(self, axes: np.ndarray, direction: np.ndarray, wanted: float) -> np.ndarray:
        """Axes on the line from `axes` along `direction` (joints + 1,) where approaching bodies are `wanted` apart."""
        low, high = 0.0, 0.0
        while self(axes + high * direction) > wanted:
            low, high = high, high + 0.01
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (middle, high) if self(axes + middle * direction) > wanted else (low, middle)
        return np.asarray(axes + low * direction)
