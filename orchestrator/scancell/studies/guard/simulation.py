"""Runs of a simulated cell with and without its guard, and what an independent judge says of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scancell.cell.fmu_file import cell_json
from scancell.cell.instance import CellInstance
from scancell.cell.reusable import ReusableCell
from scancell.closing import Closing
from scancell.config.cell import CellDescription
from scancell.geometry.reduction import reduced
from scancell.guard.guarded_cell import GuardedCell
from scancell.guard.link import Link
from scancell.guard.messages import GuardMessage
from scancell.nominal.cell import NominalCell
from scancell.proximity.cell_scene import arm_chain, cell_scene
from scancell.proximity.judge import Judge
from scancell.proximity.scene import ProximityScene
from scancell.studies.guard.scenario import Operator, Scenario

Array = NDArray[np.float64]

SAMPLES = 4  # of the motion in a controller cycle that is judged
_MAX_FACES = 5000
_MAX_ERROR = 0.5e-3  # m
_ROUGH_FACES = 400
_ROUGH_ERROR = 1e-3  # m
_RANGE_MM = 1.0
_FAR = 0.15  # m: distances are not searched beyond

# States of the controller, as its output `controller.state` numbers them.
_EMERGENCY_STOP = 3


@dataclass(frozen=True)
class Course:
    """What happened in a run.

    Attributes
    ----------
    times, axes
        (n,), s, and true joints and table (n, joints + 1), rad.
    answers
        Of the guard, as the controller received them, with the times of receipt, s.
    stopped_at
        Time of an emergency stop, s; None: there was none.
    arrived_at
        Time at which the last move was at its destination, s; None: it was not, or there was none.
    rate
        Of the path clock at the end.
    touched
        Whether the cell's own collision outputs reported a contact.
    """

    times: Array
    axes: Array
    answers: tuple[tuple[float, GuardMessage], ...]
    stopped_at: float | None
    arrived_at: float | None
    rate: float
    touched: bool


class Simulation(Closing):
    """A cell that is run again and again. Use it as a context manager.

    Parameters
    ----------
    cell
        Description.
    nominal
        Its geometry with a part.
    folder
        For the files of the FMU; None: where the system keeps temporary files.
    """

    def __init__(self, cell: CellDescription, nominal: NominalCell, folder: Path | None = None) -> None:
        self.description, self.nominal = cell, nominal
        self._cycle_us = cell.world.controller_cycle_us
        # Where nothing but the controller moves the bodies, one step of the dynamics in a sample is enough. Of the
        # collision outputs contacts are read, not clearances.
        step_us = self._cycle_us // SAMPLES if cell.robot.drive == "kinematic" else cell.world.time_step_us
        world = cell.world.model_copy(update={"time_step_us": step_us})
        collision = cell.collision.model_copy(update={"range_mm": _RANGE_MM})
        stepped = cell.model_copy(update={"world": world, "collision": collision})
        self._described = {seen: cell_json(stepped, nominal, 0, collision_outputs=seen) for seen in (False, True)}
        self._cells = {seen: ReusableCell(folder) for seen in self._described}

    @cached_property
    def scene(self) -> ProximityScene:
        """Bodies and the pairs to check."""
        return self._scene_of(_MAX_FACES, _MAX_ERROR)

    @cached_property
    def _rough_scene(self) -> ProximityScene:
        """The same pairs of bodies of few triangles, within 1 mm."""
        scene = self._scene_of(_ROUGH_FACES, _ROUGH_ERROR)
        kept = {frozenset(pair) for pair in self.scene.pairs}
        return scene.without([frozenset(pair) for pair in scene.pairs if frozenset(pair) not in kept])

    def _scene_of(self, faces: int, error: float) -> ProximityScene:
        bodies = self.nominal.bodies
        return cell_scene(self.nominal, {body.name: reduced(body.mesh, faces, error).mesh for body in bodies})

    @cached_property
    def _judge(self) -> Judge:
        return Judge({body.name: body.mesh for body in self.nominal.bodies}, self.scene.pairs, self.scene.names)

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
    ) -> Course:
        """Run a scenario, with a guard behind a link or without.

        The run ends with a contact. A `rough` course has one sample in a cycle of the controller, and no contacts.
        """
        cell = self._started(scenario.start, not rough)
        samples = 1 if rough else SAMPLES
        guarded = GuardedCell(cell, self._cycle_us, link() if link else None, max_age)
        operator = Operator(cell, scenario)
        truth = cell.real_group(cell.axis_names("truth."))
        times, axes, answers = [0.0], [cell.get(truth).copy()], []
        stopped = arrived = None
        touched = False
        while cell.time_us < scenario.duration * 1e6 and not touched:
            now = cell.time_us * 1e-6
            operator.act()
            answers += [(now, answer) for answer in guarded.poll()]
            start_us = cell.time_us
            for k in range(1, samples + 1):
                cell.step_to(start_us + k * self._cycle_us // samples)
                times.append(cell.time_us * 1e-6)
                axes.append(cell.get(truth).copy())
            touched = not rough and cell.get_integer("truth.collision.pairs") > 0
            if stopped is None and cell.get_integer("controller.state") == _EMERGENCY_STOP:
                stopped = now
            if operator.done and cell.get_boolean("controller.at_destination"):
                arrived = now if arrived is None else arrived
        rate = float(cell.get(cell.real_group(["controller.rate"]))[0])
        return Course(np.array(times), np.array(axes), tuple(answers), stopped, arrived, rate, touched)

    def _started(self, start: Array, seen: bool) -> CellInstance:
        described = self._described[seen]
        for joint, angle in zip(described["robot"]["joints"], start[:-1], strict=True):
            joint["start"] = float(angle)
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

    def clearance(self, course: Course, farthest: float, rough: bool = False) -> float:
        """Smallest distance of the arm to other bodies, m, at most `farthest`."""
        outside = ~self.inner
        clearances = self.clearances(course.axes[::SAMPLES], np.where(outside, farthest, 0.0), rough)
        return float(clearances[:, outside].min())

    def contact(self, course: Course) -> tuple[float, str] | None:
        """Time and pair of the first contact that python-fcl finds in the recorded motion."""
        poses = self.nominal.body_poses(course.axes[:, :-1], course.axes[:, -1])
        found = self._judge.first_collision(poses)
        return None if found is None else (float(course.times[found.index]), f"{found.body_a} - {found.body_b}")

    def close(self) -> None:
        """Free the FMU and its files."""
        for cell in self._cells.values():
            cell.close()
