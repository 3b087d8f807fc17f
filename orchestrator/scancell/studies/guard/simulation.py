"""Runs of a simulated cell with and without its guard, and their true poses, by which an independent judge decides."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.arrays import Array
from scancell.cell.driver import Mode, Operation
from scancell.cell.fmu_file import ReusableCell, cell_json
from scancell.cell.instance import CellInstance
from scancell.config.cell import LinkDescription
from scancell.geometry import pose
from scancell.guard.endpoints import CellEndpoint
from scancell.guard.guard import Decision, Guard, GuardedCell
from scancell.guard.messages import CellState, GuardMessage, axis_bits
from scancell.guard.parts import PartTracker
from scancell.guard.transport import Arrival, InProcess, Link, faulty_link
from scancell.nominal.cell import NominalCell, fmu_frame
from scancell.studies.guard.scenario import POSE_KEYS, Begun, Operator, Scenario
from scancell.studies.guard.worlds import World
from scancell.values import Closing

COMPUTE = 0.004  # s that an answer takes
RIVALS = ("", "cell", "guard")  # beside the cell and its guard
_CALLS = 0.05  # s between states of a second cell
_OTHER_AGE = 1.0  # s

SAMPLES = 4  # of the motion in a controller cycle that are judged
_JUDGED = 0.2e-3  # m: points that are judged are no further apart, unless they are consecutive samples
_MEASURED = 1e-3  # m: the same, of points whose distances are measured
_REACH = 1.2  # m: no point of arm or table is further from an axis that turns it
_REST = 1.0  # s without motion after which a run is over
_STILL = 1e-7  # rad in a cycle
_EMERGENCY_STOP = 3  # of controller.state
_SETTLING = 0.3  # s after a gripper has closed or opened, for which a part still moves


class Servers:
    """A transport to a guard.

    Parameters
    ----------
    make
        Makes a guard that knows nothing of the past.
    rival
        One of `RIVALS`: a second `cell` at rest at its start that asks the guard for a session all the time; or a
        second guard of the same cell that gets the same states, whose answers come 2 ms later.

    Attributes
    ----------
    log
        Decisions, with the times of their states on the controller's clock, s.
    """

    def __init__(self, make: Callable[[], Guard], rival: str, cell: NominalCell) -> None:
        self.log: list[tuple[float, Decision]] = []
        self._make, self._cell = make, cell
        self._guard = InProcess(_Observed(make(), self.log), COMPUTE)
        self._second = InProcess(make(), COMPUTE + 2e-3) if rival == "guard" else None
        self._caller = CellEndpoint(_OTHER_AGE) if rival == "cell" else None
        self._calls = 0

    def restart(self) -> None:
        """Replace the guard by a new one; what was under way is lost."""
        self._guard = InProcess(_Observed(self._make(), self.log), COMPUTE)

    def send(self, packet: bytes, time: float) -> None:
        """Hand a packet to all guards."""
        self._guard.send(packet, time)
        if self._second is not None:
            self._second.send(packet, time)

    def receive(self, time: float) -> list[Arrival]:
        """Answers of all guards until `time`, s."""
        if self._caller is not None and time >= self._calls * _CALLS:
            self._calls += 1
            axes, prismatic = self._cell.start, axis_bits(self._cell.prismatic)
            state = CellState(self._calls, time, Operation.AUTOMATIC, Mode.HOLD, False, axes, prismatic=prismatic)
            self._guard.send(self._caller.packet(state), time)
        return sorted([*self._guard.receive(time), *(self._second.receive(time) if self._second else ())])

    def reset(self) -> None:
        """Nothing: there is no connection."""

    def close(self) -> None:
        """Nothing: there is no connection."""


class _Observed:
    """A guard that logs its decisions with the times of the states."""

    def __init__(self, guard: Guard, log: list[tuple[float, Decision]]) -> None:
        self._guard, self._log = guard, log

    def answer(self, state: CellState) -> GuardMessage:
        """Answer of the guard to a state."""
        message = self._guard.answer(state)
        self._log.append((state.time, self._guard.decision))
        return message

    def reset(self) -> None:
        """A session begins."""
        self._guard.reset()


@dataclass(frozen=True)
class MotionRecord:
    """Record of a run.

    Attributes
    ----------
    times, axes
        (n,), s, and true positions (n, axes), rad or m.
    frames
        True poses (n, frames, 7) of fingers and free parts: positions, m, and quaternions.
    answers
        Answers of the guard, as the controller received them, with the times of receipt, s.
    decisions
        Decisions of the guard, with the times of their states on the controller's clock, s.
    begun
        Motions.
    stopped_at, refused_at, held_at
        Times, s, of the first emergency stop, of the first answer that held a jog at rest, and at which the operator
        gave up a held motion; None: there was none.
    resets, sessions
        Numbers of resets of the controller and of new sessions.
    gripped
        Whether the gripper held a part, (n,).
    """

    times: Array
    axes: Array
    frames: Array
    answers: tuple[tuple[float, GuardMessage], ...]
    decisions: tuple[tuple[float, Decision], ...]
    begun: tuple[Begun, ...]
    stopped_at: float | None
    refused_at: float | None
    held_at: float | None
    resets: int
    sessions: int
    gripped: NDArray[np.bool_]

    def spaced(self, distance: float) -> NDArray[np.int64]:
        """Numbers of samples between which no point moves further than `distance`, m, or which are consecutive."""
        moved = np.abs(np.diff(self.axes, axis=0)).sum(1)
        if self.frames.shape[1]:
            moved = moved + np.abs(np.diff(self.frames, axis=0)).max((1, 2))
        travelled = _REACH * np.append(0.0, np.cumsum(moved))
        kept = [0]
        while kept[-1] < len(travelled) - 1:
            farthest = int(np.searchsorted(travelled, travelled[kept[-1]] + distance, "right")) - 1
            kept.append(max(kept[-1] + 1, farthest))
        return np.array(kept)


@dataclass(frozen=True)
class Network:
    """Connection of a cell and its guard: faults, the seed of their random numbers, and a rival (`Servers`)."""

    faults: LinkDescription = field(default_factory=LinkDescription)
    seed: int = 0
    rival: str = ""


class EarlierCell(GuardedCell):
    """A cell that speaks version 1 of the protocol: without widths of fingers; the path begins one cycle later."""

    def state(self) -> CellState:
        state = super().state()
        return replace(state, ahead=np.asarray(state.ahead)[1:], widths=(), parts=(), digest=0, version=1)


class Simulation(Closing):
    """A cell for many runs, with and without a guard. Use it as a context manager.

    Parameters
    ----------
    world
        The cell as the guard knows it.
    folder
        For the files of the FMU; None: where the system keeps temporary files.
    shows_jogs
        Whether the controller sends the path of a jog to the guard before it moves.
    version
        Version of the protocol that it speaks.
    """

    def __init__(
        self,
        world: World,
        folder: Path | None = None,
        shows_jogs: bool = True,
        version: int = 2,
    ) -> None:
        self.world, self._shows_jogs, self._max_age = world, shows_jogs, world.settings.max_age
        self._kind = EarlierCell if version == 1 else GuardedCell
        described = world.described
        self._cycle_us = described.world.controller_cycle_us
        # Where nothing but the controller moves the bodies, one step of the dynamics in a sample is enough.
        kinematic = described.robot.drive == "kinematic" and not world.grips
        step_us = self._cycle_us // SAMPLES if kinematic else described.world.time_step_us
        stepped = described.model_copy(update={"world": described.world.model_copy(update={"time_step_us": step_us})})
        self._described = cell_json(stepped, world.nominal, 0, collision_outputs=False)
        self._cell = ReusableCell(folder)
        self._files = tempfile.TemporaryDirectory(prefix="scancell-programs-", dir=folder)
        moving = ("finger[", "part[") if world.grips else ("finger[",)
        names = dict.fromkeys(fmu_frame(body.moves_with) for body in world.nominal.bodies)
        self._moving = [name for name in names if name.startswith(moving)]

    @property
    def cycle(self) -> float:
        """Cycle of the controller, s."""
        return self._cycle_us * 1e-6

    def new_guard(self) -> Guard:
        """A guard that knows nothing of the past."""
        return self.world.guard()

    def new_link(self, servers: Servers, network: Network) -> Link:
        """A link from the cell to its guards."""
        return faulty_link(servers, network.faults, self._max_age, network.seed)

    def run(self, scenario: Scenario, network: Network | None = None) -> MotionRecord:
        """Run a scenario, with a guard behind a network or without.

        The run ends where nothing moves any more.
        """
        if network is None:
            return self._run(scenario, None, None)
        servers = Servers(self.new_guard, network.rival, self.world.nominal)
        return self._run(scenario, servers, self.new_link(servers, network))

    def _run(self, scenario: Scenario, servers: Servers | None, link: Link | None) -> MotionRecord:
        cell = self._started(scenario.start)
        parts = PartTracker(self.world.described, self.world.nominal) if self.world.grips else None
        guarded = self._kind(cell, self._cycle_us, link, self._max_age, self._shows_jogs, parts)

        def renew(restarts: bool) -> None:
            if servers is not None and link is not None:
                if restarts:
                    servers.restart()
                link.reset()

        operator = Operator(cell, self.world.nominal, scenario, self.cycle, Path(self._files.name), renew)
        names = cell.axis_names("truth.")
        truth = cell.real_group([*names, *(f"truth.{frame}.{key}" for frame in self._moving for key in POSE_KEYS)])
        times, poses = [0.0], [cell.get(truth).copy()]
        answers: list[tuple[float, GuardMessage]] = []
        gripped = [False]
        stopped = refused = None
        rest_us = 0
        while cell.time_us < scenario.duration * 1e6:
            start_us = cell.time_us
            now = start_us * 1e-6
            state = cell.get_integer("controller.state")
            if stopped is None and state == _EMERGENCY_STOP:
                stopped = now
            operator.act(state)
            received = guarded.poll()
            answers += [(now, answer) for answer in received]
            holds = any(answer.monitor_speed == 0.0 and not answer.emergency_stop for answer in received)
            if refused is None and operator.jogs and holds:
                refused = now
            for k in range(1, SAMPLES + 1):
                cell.step_to(start_us + k * self._cycle_us // SAMPLES)
                times.append(cell.time_us * 1e-6)
                poses.append(cell.get(truth).copy())
            gripped += [parts is not None and cell.get_boolean("measured.gripper.gripped")] * SAMPLES
            if np.abs(poses[-1] - poses[-1 - SAMPLES])[: len(names)].max() > _STILL or not operator.done:
                rest_us = cell.time_us
            if cell.time_us - rest_us >= _REST * 1e6:
                break
        axes, frames = np.split(np.array(poses), [len(names)], 1)
        return MotionRecord(
            np.array(times),
            axes,
            frames.reshape(len(times), len(self._moving), 7),
            tuple(answers),
            tuple(servers.log) if servers else (),
            tuple(operator.begun),
            stopped,
            refused,
            operator.given_up_at,
            operator.resets,
            operator.sessions,
            np.array(gripped),
        )

    def _started(self, start: Array) -> CellInstance:
        described = self._described
        axes = [*described["robot"]["joints"], described["table"], *described.get("axes", ())]
        for axis, position in zip(axes, start, strict=True):
            axis["start"] = float(position)
        return self._cell.start(self._described)

    def poses(self, record: MotionRecord, kept: NDArray[np.int64], shifts: Array) -> Array:
        """True poses (n, bodies, 4, 4) at samples; bodies are off by `shifts` (bodies, 3), m, in their own frames."""
        nominal = self.world.nominal
        frames = nominal.frame_poses(record.axes[kept])
        for k, frame in enumerate(self._moving):
            row = record.frames[kept, k]
            placed = np.tile(np.eye(4), (len(row), 1, 1))
            placed[:, :3, :3], placed[:, :3, 3] = pose.rotation_from_quaternion(row[:, 3:]), row[:, :3]
            frames["part" if frame == "part[1]" else frame] = placed
        return shifted(np.stack([frames[body.moves_with] for body in nominal.bodies], 1), shifts)

    def displacement(self, record: MotionRecord, time: float) -> float:
        """Distance, m, by which the part has moved since it was gripped or released last, until `time`, s.

        In the gripper while it holds the part, else in the world; what it moves in the first `_SETTLING` is none.
        """
        end = int(np.searchsorted(record.times, time, "right"))
        held = record.gripped[:end]
        changes = np.flatnonzero(np.diff(held))
        begin = int(changes[-1]) + 1 if len(changes) else 0
        begin = min(int(np.searchsorted(record.times, record.times[begin] + _SETTLING)), end - 1)
        rows = np.arange(begin, end)
        names, poses = self.world.names, self.poses(record, rows, np.zeros((len(self.world.names), 3)))
        seen = poses[:, names.index("part")]
        if held[-1]:
            seen = np.linalg.inv(poses[:, names.index("gripper")]) @ seen
        return float(np.linalg.norm(seen[:, :3, 3] - seen[0, :3, 3], axis=1).max())

    def contact(self, record: MotionRecord, shifts: Array) -> tuple[float, tuple[str, str]] | None:
        """Time and pair of the first contact that python-fcl finds in the recorded motion."""
        kept = record.spaced(_JUDGED)
        found = self.world.judge.first_collision(self.poses(record, kept, shifts))
        return None if found is None else (float(record.times[kept[found.index]]), (found.body_a, found.body_b))

    def clearances(self, record: MotionRecord, shifts: Array, farthest: ArrayLike) -> Array:
        """Distances (n, pairs), m, of the judged pairs at most a millimetre of motion apart, at most `farthest`."""
        return self.world.scene.distances(self.poses(record, record.spaced(_MEASURED), shifts), farthest, 1)

    def fastest(self, record: MotionRecord, pair: tuple[str, str]) -> float:
        """Largest speed, m/s, of a corner of the bounding box of one body of a pair, seen from the other."""
        kept = record.spaced(_MEASURED)
        poses = self.poses(record, kept, np.zeros((len(self.world.names), 3)))
        one, other = (self.world.names.index(name) for name in pair)
        speed = 0.0
        for a, b in ((one, other), (other, one)):
            low, high = self.world.nominal.bodies[b].mesh.bounds
            corners = np.array(np.meshgrid(*np.stack([low, high], 1))).reshape(3, -1)
            seen = np.linalg.inv(poses[:, a]) @ poses[:, b]
            points = seen[:, :3, :3] @ corners + seen[:, :3, 3:]
            step = np.linalg.norm(np.diff(points, axis=0), axis=1).max(1)
            speed = max(speed, float((step / np.diff(record.times[kept])).max(initial=0.0)))
        return speed

    def close(self) -> None:
        """Free the FMU and its files."""
        self._cell.close()
        self._files.cleanup()


def shifted(poses: Array, shifts: Array) -> Array:
    """Poses (n, bodies, 4, 4) of bodies that are off by `shifts` (bodies, 3), m, in their own frames."""
    poses = poses.copy()
    poses[..., :3, 3] += (poses[..., :3, :3] @ shifts[..., None])[..., 0]
    return poses
