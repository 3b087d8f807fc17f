"""Runs of a simulated cell with and without its guard, and the verdict of an independent judge."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.cell.controller import Operation
from scancell.cell.fmu_file import cell_json
from scancell.cell.instance import CellInstance
from scancell.cell.reusable import ReusableCell
from scancell.closing import Closing
from scancell.config.cell import CellDescription
from scancell.config.channel import LinkDescription
from scancell.geometry.reduction import reduced
from scancell.guard.guard import Decision, Guard
from scancell.guard.guarded_cell import GuardedCell
from scancell.guard.link import Link, faulty_link
from scancell.guard.messages import CellState, GuardMessage
from scancell.guard.settings import GuardSettings
from scancell.guard.transport import InProcess
from scancell.nominal.cell import NominalCell
from scancell.proximity.judge import Judge
from scancell.proximity.scene import ProximityScene, arm_chain, cell_scene
from scancell.studies.guard.scenario import Operator, Scenario

Array = NDArray[np.float64]

SAMPLES = 4  # of the motion in a controller cycle that is judged, at full speed
_MAX_FACES = 5000
_MAX_ERROR = 0.5e-3  # m
_ROUGH_FACES = 400
_ROUGH_ERROR = 1e-3  # m
_RANGE_MM = 1.0
_FAR = 0.15  # m: distances are not searched beyond
_FAST = 1 / 16  # share of the full speed from which on a cycle has several samples
_MOST_CYCLES = 16  # between two samples of slow motion
ROUGH_CYCLES = 4  # the same, of a rough course
_JUDGED = 0.2e-3  # m: points that are judged are no further apart, unless they are consecutive samples
_MEASURED = 1e-3  # m: the same, of points whose distances are measured
_REACH = 1.2  # m: no point of arm or table is further from an axis
_REST = 1.0  # s without motion after which a run is over
_STILL = 1e-7  # rad in that time

# States of the controller, as its output `controller.state` numbers them.
_EMERGENCY_STOP = 3

_COMPUTE = 0.004  # s that an answer takes


@dataclass(frozen=True)
class MotionRecord:
    """Record of a run.

    Attributes
    ----------
    times, axes
        (n,), s, and true joints and table (n, joints + 1), rad.
    answers
        Of the guard, as the controller received them, with the times of receipt, s.
    stopped_at
        Time of the first emergency stop, s; None: there was none.
    refused_at
        Time at which the first answer held a jog at rest, s; None: there was none.
    arrived_at
        Time at which the last move was at its destination, s; None: it was not, or there was none.
    rate
        Of the path clock at the end.
    touched
        Whether the cell's own collision outputs reported a contact.
    rejected
        Whether the controller has rejected its last command at the end.
    """

    times: Array
    axes: Array
    answers: tuple[tuple[float, GuardMessage], ...]
    stopped_at: float | None
    refused_at: float | None
    arrived_at: float | None
    rate: float
    touched: bool
    rejected: bool

    def spaced(self, distance: float) -> NDArray[np.int64]:
        """Numbers of samples between which no point moves further than `distance`, m, or which are consecutive."""
        travelled = _REACH * np.append(0.0, np.cumsum(np.abs(np.diff(self.axes, axis=0)).sum(1)))
        kept = [0]
        while kept[-1] < len(travelled) - 1:
            farthest = int(np.searchsorted(travelled, travelled[kept[-1]] + distance, "right")) - 1
            kept.append(max(kept[-1] + 1, farthest))
        return np.array(kept)


class Simulation(Closing):
    """A cell for many runs. Use it as a context manager.

    Parameters
    ----------
    cell
        Description.
    nominal
        True geometry of its bodies with a part.
    ignored
        Pairs of bodies that may touch.
    folder
        For the files of the FMU; None: where the system keeps temporary files.
    shows_jogs
        Whether the controller shows a jog to the guard before it moves.
    """

    def __init__(
        self,
        cell: CellDescription,
        nominal: NominalCell,
        ignored: Collection[tuple[str, str]] = (),
        folder: Path | None = None,
        shows_jogs: bool = True,
    ) -> None:
        self.description, self.nominal, self._shows_jogs = cell, nominal, shows_jogs
        self._ignored = [frozenset(pair) for pair in ignored]
        self._cycle_us = cell.world.controller_cycle_us
        # Where nothing but the controller moves the bodies, as in rough courses, one step of the dynamics in a sample
        # is enough. Of the collision outputs contacts are read, not clearances.
        collision = cell.collision.model_copy(update={"range_mm": _RANGE_MM})
        self._described = {}
        for seen, samples in ((False, 1), (True, SAMPLES)):
            robot = cell.robot if seen else cell.robot.model_copy(update={"drive": "kinematic"})
            step_us = self._cycle_us // samples if robot.drive == "kinematic" else cell.world.time_step_us
            world = cell.world.model_copy(update={"time_step_us": step_us})
            stepped = cell.model_copy(update={"robot": robot, "world": world, "collision": collision})
            self._described[seen] = cell_json(stepped, nominal, 0, collision_outputs=seen)
        self._cells = {seen: ReusableCell(folder) for seen in self._described}
        self._files = tempfile.TemporaryDirectory(prefix="scancell-programs-", dir=folder)

    @property
    def cycle(self) -> float:
        """Of the controller, s."""
        return self._cycle_us * 1e-6

    @cached_property
    def scene(self) -> ProximityScene:
        """Bodies and the pairs to check."""
        return self._scene_of(_MAX_FACES, _MAX_ERROR)

    @cached_property
    def _rough_scene(self) -> ProximityScene:
        """The same pairs of bodies of few triangles, within 1 mm."""
        if max(len(body.mesh.faces) for body in self.nominal.bodies) <= _MAX_FACES // 2:
            return self.scene  # meshes of few triangles
        scene = self._scene_of(_ROUGH_FACES, _ROUGH_ERROR)
        kept = {frozenset(pair) for pair in self.scene.pairs}
        return scene.without([frozenset(pair) for pair in scene.pairs if frozenset(pair) not in kept])

    def _scene_of(self, faces: int, error: float) -> ProximityScene:
        bodies = self.nominal.bodies
        scene = cell_scene(self.nominal, {body.name: reduced(body.mesh, faces, error).mesh for body in bodies})
        return scene.without(self._ignored)

    @cached_property
    def _judge(self) -> Judge:
        meshes = {body.name: body.mesh for body in self.nominal.bodies}
        return Judge(meshes, tuple(meshes), self.nominal.body_poses(self.nominal.home, 0.0), self._ignored)

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """Which pairs of the scene are two bodies of the arm."""
        arm = set(arm_chain(self.nominal))
        return np.array([a in arm and b in arm for a, b in self.scene.pairs])

    def run(
        self,
        scenario: Scenario,
        link: Callable[[], Link] | None = None,
        max_age: float = 0.0,
        rough: bool = False,
    ) -> MotionRecord:
        """Run a scenario, with a guard behind a link or without.

        The run ends with a contact, or where nothing moves any more. Slow motion has fewer samples, and so does a
        `rough` course, which has no contacts.
        """
        cell = self._started(scenario.start, not rough)
        guarded = GuardedCell(cell, self._cycle_us, link() if link else None, max_age, self._shows_jogs)
        operator = Operator(cell, scenario, self.cycle, Path(self._files.name))
        truth = cell.real_group(cell.axis_names("truth."))
        samples = SAMPLES if scenario.speed > _FAST and not rough else 1
        sparse = min(max(int(_FAST / scenario.speed), 1), _MOST_CYCLES)  # cycles between looks for contacts
        sparse = max(sparse, ROUGH_CYCLES) if rough else sparse
        manual = scenario.operation is Operation.MANUAL
        times, axes, answers = [0.0], [cell.get(truth).copy()], []
        stopped = refused = arrived = None
        touched, cycles, rest_us = False, 0, 0
        while cell.time_us < scenario.duration * 1e6 and not touched:
            start_us = cell.time_us
            now = start_us * 1e-6
            state = cell.get_integer("controller.state")
            if stopped is None and state == _EMERGENCY_STOP:
                stopped = now
            waits = operator.act(state)
            received = guarded.poll()
            answers += [(now, answer) for answer in received]
            if refused is None and manual and operator.jogs and any(_holds(answer) for answer in received):
                refused = now
            stride = sparse if link is None else 1
            due = int(np.ceil(min(operator.next_time, 1e6) * 1e6 / self._cycle_us)) - start_us // self._cycle_us
            end_us = start_us + self._cycle_us * min(stride, max(due, 1))
            for k in range(1, samples + 1):
                cell.step_to(start_us + k * (end_us - start_us) // samples)
                times.append(cell.time_us * 1e-6)
                axes.append(cell.get(truth).copy())
            cycles += 1
            looks = link is None or cycles % sparse == 0
            touched = not rough and looks and cell.get_integer("truth.collision.pairs") > 0
            if operator.done and not manual and arrived is None and cell.get_boolean("controller.at_destination"):
                arrived = cell.time_us * 1e-6
                break
            moved = np.abs(axes[-1] - axes[-1 - samples]).max() > _STILL / _REST * (end_us - start_us) * 1e-6
            if moved or not operator.done or not waits:
                rest_us = cell.time_us
            elif cell.time_us - rest_us >= _REST * 1e6:
                break
        rate = float(cell.get(cell.real_group(["controller.rate"]))[0])
        recorded = np.array(times), np.array(axes)
        rejected = cell.get_integer("controller.error") != 0
        return MotionRecord(*recorded, tuple(answers), stopped, refused, arrived, rate, touched, rejected)

    def _started(self, start: Array, seen: bool) -> CellInstance:
        described = self._described[seen]
        for joint, angle in zip(described["robot"]["joints"], start[:-1], strict=True):
            joint["start"] = float(angle)
        described["table"]["start"] = float(start[-1])
        return self._cells[seen].start(described)

    def clearances(self, axes: Array, farthest: ArrayLike = _FAR, rough: bool = False) -> Array:
        """Distances (n, pairs), m, of the pairs of the scene, at most `farthest`; `rough` ones are within 1 mm.

        `farthest` is one for all pairs or (pairs,); the smaller, the faster.
        """
        scene = self._rough_scene if rough else self.scene
        return scene.distances(self.nominal.body_poses(axes[:, :-1], axes[:, -1]), farthest, 1)

    def distances_of(self, pair: NDArray[np.bool_], axes: Array) -> Array:
        """Distances (n,), m, of the one `pair` (pairs,) of the scene, however far."""
        return self.clearances(axes, np.where(pair, np.inf, 0.0))[:, pair][:, 0]

    def clearance(self, course: MotionRecord, farthest: float, rough: bool = False) -> float:
        """Smallest distance of the arm to other bodies, m, at most `farthest`."""
        outside = ~self.inner
        axes = course.axes[course.spaced(_MEASURED)]
        clearances = self.clearances(axes, np.where(outside, farthest, 0.0), rough)
        return float(clearances[:, outside].min())

    def contact(self, course: MotionRecord) -> tuple[float, str] | None:
        """Time and pair of the first contact that python-fcl finds in the recorded motion."""
        judged = course.spaced(_JUDGED)
        axes = course.axes[judged]
        found = self._judge.first_collision(self.nominal.body_poses(axes[:, :-1], axes[:, -1]))
        return None if found is None else (float(course.times[judged[found.index]]), f"{found.body_a} - {found.body_b}")

    def fastest(self, course: MotionRecord, pair: tuple[str, str]) -> float:
        """Largest speed, m/s, of a corner of the bounding box of one body of a pair, seen from the other."""
        kept = course.spaced(_MEASURED)
        axes, times = course.axes[kept], course.times[kept]
        poses = self.nominal.body_poses(axes[:, :-1], axes[:, -1])
        names = [body.name for body in self.nominal.bodies]
        one, other = (names.index(name) for name in pair)
        speed = 0.0
        for a, b in ((one, other), (other, one)):
            low, high = self.nominal.bodies[b].mesh.bounds
            corners = np.array(np.meshgrid(*np.stack([low, high], 1))).reshape(3, -1)
            seen = np.linalg.inv(poses[:, a]) @ poses[:, b]
            points = seen[:, :3, :3] @ corners + seen[:, :3, 3:]
            step = np.linalg.norm(np.diff(points, axis=0), axis=1).max(1)
            speed = max(speed, float((step / np.diff(times)).max(initial=0.0)))
        return speed

    def close(self) -> None:
        """Free the FMU and its files."""
        for cell in self._cells.values():
            cell.close()
        self._files.cleanup()


def _holds(answer: GuardMessage) -> bool:
    """Whether an answer holds a jog at rest."""
    return answer.monitor_speed == 0.0 and not answer.emergency_stop


@dataclass(frozen=True)
class Protection:
    """Guard, settings and link of guarded runs; the defaults are the correct ones.

    Attributes
    ----------
    guard
        Type of the guard.
    assumed
        The settings that it assumes, as a function of the true ones.
    patience
        Factor on the time for which the controller waits for answers.
    link
        Type of the cell's link.
    """

    guard: type[Guard] = Guard
    assumed: Callable[[GuardSettings], GuardSettings] = lambda true: true
    patience: float = 1.0
    link: type[Link] = Link


class GuardedRuns:
    """Runs scenarios with a guard.

    Parameters
    ----------
    simulation
        The cell.
    guard
        Its guard.
    max_age
        Of the controller, s; None: that of the guard.
    link_type
        Type of the link by which the cell receives answers.

    Attributes
    ----------
    log
        Decisions of the last run, with the times of their states on the controller's clock, s.
    """

    def __init__(
        self, simulation: Simulation, guard: Guard, max_age: float | None = None, link_type: type[Link] = Link
    ) -> None:
        self._simulation = simulation
        self._max_age = guard.settings.max_age if max_age is None else max_age
        self._link_type = link_type
        self.log: list[tuple[float, Decision]] = []
        self._observed = _Observed(guard, self.log)

    def run(self, scenario: Scenario, network: LinkDescription, seed: int = 0) -> MotionRecord:
        """Record of a scenario; `seed` determines the faults of the network."""
        self._observed.reset()

        def link() -> Link:
            transport = InProcess(self._observed, _COMPUTE)
            return faulty_link(transport, network, self._max_age, seed, self._link_type)

        return self._simulation.run(scenario, link, self._max_age)


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
        """Reset the guard and clear the log."""
        self._log.clear()
        self._guard.reset()
