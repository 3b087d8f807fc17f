"""Deliberate errors of a guard: whether a search finds a collision shows what it can find."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from scancell.geometry.mesh import Mesh
from scancell.geometry.tree import WORLD
from scancell.guard.check import ManualCheck
from scancell.guard.endpoints import Identifier, _Window
from scancell.guard.guard import Decision, Guard, GuardSettings
from scancell.guard.messages import CellState, GuardMessage, decode
from scancell.guard.parts import FreePath, NearPairs, movable_parts
from scancell.guard.stopping import Hypothesis, Kind, Path
from scancell.guard.transport import Link, faulty_link
from scancell.nominal.cell import NominalCell
from scancell.scanning.session import touching, with_finger_travel
from scancell.studies.guard.draws import MIXED, Stratum
from scancell.studies.guard.scenario import JOGGED, MOVED
from scancell.studies.guard.scenario import Kind as Kinds
from scancell.studies.guard.simulation import Network, Servers, Simulation

_POLL = 0.032  # s
_SLOW = 0.01  # rad/s
_OF_AXES = (Kinds.TABLE_MOVE, Kinds.TABLE_JOG)  # of any axis beyond the joints


@dataclass(frozen=True)
class Mutation:
    """An error of how runs are guarded; the defaults are correct.

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
    ignored
        Pairs of bodies that the guard does not compare, beside those that may touch.
    alone
        Axes of which the search jogs one alone: the ``table``, which carries a plate that extends beyond it, or those
        beyond it (``further``); empty: anything is jogged.
    further
        Whether it is an error with axes beyond the table, which the cell must have.
    strata
        Whether runs of a campaign like this one are to find it, not the search at the limits; None: the search is.
    """

    guard: type[Guard] = Guard
    assumed: Callable[[GuardSettings], GuardSettings] = lambda true: true
    patience: float = 1.0
    link: type[Link] = Link
    ignored: tuple[tuple[str, str], ...] = ()
    alone: Literal["", "table", "further"] = ""
    further: bool = False
    strata: Callable[[Stratum], bool] | None = None


class MutatedSimulation(Simulation):
    """A simulation whose runs are guarded with an error; the other arguments are those of `Simulation`."""

    def __init__(self, mutation: Mutation, *others: Any, **named: Any) -> None:
        super().__init__(*others, **named)
        self._mutation = mutation
        self._max_age *= mutation.patience

    def new_guard(self) -> Guard:
        mutation, described = self._mutation, self.world.described
        known = with_finger_travel(self.world.nominal, described)
        may_touch = (*touching(known, described), *mutation.ignored)
        settings = mutation.assumed(self.world.settings)
        return mutation.guard(known, described.robot, settings, may_touch, movable_parts(described))

    def new_link(self, servers: Servers, network: Network) -> Link:
        return faulty_link(servers, network.faults, self._max_age, network.seed, self._mutation.link)


class _AcceptsStaleAnswers(Link):
    """A link that takes every answer for one to the present state."""

    _received = -float("inf")

    def poll(self, time: float) -> list[GuardMessage]:
        messages = [decode(arrival.packet).message for arrival in self._transport.receive(time)]
        answers = [message for message in messages if isinstance(message, GuardMessage)]
        if answers:
            self._received = time
        return answers

    def age(self, time: float) -> float:
        return time - self._received


class _IgnoresPermittedSpeed(Link):
    """A link to a controller that reports the permitted speed, but jogs as fast as the operator wants.

    It rests only where the guard permits no speed at all.
    """

    _permitted = 1.0

    def send(self, state: CellState, time: float) -> None:
        super().send(replace(state, rate=min(state.rate, self._permitted)), time)

    def poll(self, time: float) -> list[GuardMessage]:
        answers = super().poll(time)
        if answers:
            self._permitted = answers[-1].monitor_speed
        return [replace(answer, monitor_speed=float(answer.monitor_speed > 0)) for answer in answers]


def _without(path: Path) -> Mutation:
    class OmitsPath(Identifier):
        """Omits one path, and takes a motion along it for one along another path."""

        def _paths(self, kind: Kind, window: _Window) -> list[Path]:
            others = [found for found in Path if found is not path]
            return [found for found in super()._paths(kind, window) if found is not path] or others

    class OmitsHypothesis(Guard):
        """A guard that omits one path of the motion."""

        def __init__(self, nominal: NominalCell, *others: Any) -> None:
            super().__init__(nominal, *others)
            self._identifier = OmitsPath(nominal, self.settings.noise)

    return Mutation(OmitsHypothesis)


class _NoClearance(Guard):
    """A guard that takes positions of bodies and its own meshes for exact."""

    def __init__(self, nominal: NominalCell, *others: Any) -> None:
        super().__init__(nominal, *others)
        known, scene, worst = self.settings, self._manual._scene, self._manual._worst
        near = NearPairs(nominal, scene.pairs, 0.0, known.angle_error)
        self._manual = ManualCheck(nominal, scene, near, worst, known.horizon)
        self._free_path = FreePath(nominal, scene, near)
        self._jogs._free_path = self._automatic._free_path = self._free_path


class _NoTable(Guard):
    """A guard for which the table rests while a person jogs."""

    def _hypotheses(self) -> Sequence[Hypothesis]:
        return _at_rest(super()._hypotheses(), [self._names.index("table")])


class _NoFurtherRate(Guard):
    """A guard for which the axes beyond the table rest while a person jogs."""

    def _hypotheses(self) -> Sequence[Hypothesis]:
        return _at_rest(super()._hypotheses(), range(self._names.index("table") + 1, self._axes))


def _overlooks(name: str) -> type[Guard]:
    class Overlooks(Guard):
        """A guard that does not know a body of the cell."""

        def __init__(self, nominal: NominalCell, *others: Any) -> None:
            bodies = tuple(body for body in nominal.bodies if body.name != name)
            super().__init__(replace(nominal, bodies=bodies), *others)

    return Overlooks


def _at_rest(hypotheses: Sequence[Hypothesis], axes: Sequence[int]) -> list[Hypothesis]:
    """The hypotheses with some axes at rest."""
    found = []
    for hypothesis in hypotheses:
        moving = np.isin(np.arange(len(hypothesis.rates)), axes, invert=True)
        rates, error = moving * hypothesis.rates, moving * hypothesis.rate_error
        found.append(replace(hypothesis, rates=rates, rate_error=error))
    return found


class _FurtherPathIgnored(Guard):
    """A guard that does not see on a path where the axes beyond the table lead."""

    def answer(self, state: CellState) -> GuardMessage:
        ahead, first = np.array(state.ahead), self._names.index("table") + 1
        if len(ahead):
            ahead[:, first:] = ahead[0, first:]
        return super().answer(replace(state, ahead=ahead))


class _NothingCarried(Guard):
    """A guard for which the axes beyond the table carry nothing."""

    def __init__(self, nominal: NominalCell, *others: Any) -> None:
        further = [axis.name for axis in nominal.further_axes]
        bodies = tuple(
            replace(body, moves_with=WORLD) if body.moves_with in further else body for body in nominal.bodies
        )
        super().__init__(replace(nominal, arm_on=WORLD, table_on=WORLD, bodies=bodies), *others)


class _SlowIsRest(Guard):
    """A guard for which slow motion is none: that of version 0.2.0."""

    def _by_hand(self, state: CellState) -> Decision:
        decision = super()._by_hand(state)
        known = len(self._states) >= 2 and not np.size(state.ahead)
        is_slow = known and all(np.abs(found.rates).max() <= _SLOW for found in self._hypotheses())
        return Decision() if is_slow else decision


class _BegunIsPermitted(Guard):
    """A guard that checks what a jog shows before it begins, and not again."""

    def _by_hand(self, state: CellState) -> Decision:
        decision = super()._by_hand(state)
        return Decision() if state.moving and np.size(state.ahead) else decision


class _QuarterAsFast(Guard):
    """A guard that takes what a jog shows for a motion of a quarter of its speed."""

    def _by_hand(self, state: CellState) -> Decision:
        return super()._by_hand(replace(state, spacing=4 * state.spacing))


class _ForgetsPermittedSpeeds(Guard):
    """A guard that forgets which speeds its earlier answers permit."""

    def _allowed(self, state: CellState) -> float:
        return 0.0


class _ShortMotionsAreUnchecked(Guard):
    """A guard that takes a path that ends within a cycle of the controller for rest."""

    def _on_path(self, state: CellState) -> Decision:
        later = np.asarray(state.ahead)[1:]
        is_short = not state.moving and len(later) > 0 and not np.ptp(later, axis=0).any()
        return Decision() if is_short else super()._on_path(state)


class _StartWidth(Guard):
    """A guard for which the fingers stay in the middle of their space, as wide as they are."""

    def __init__(self, nominal: NominalCell, *others: Any) -> None:
        bodies = tuple(
            replace(body, mesh=_middle_half(body.mesh)) if body.moves_with.startswith("finger[") else body
            for body in nominal.bodies
        )
        super().__init__(replace(nominal, bodies=bodies), *others)


def _middle_half(mesh: Mesh) -> Mesh:
    """A mesh of half its length along x, about the middle."""
    middle = mesh.bounds.mean(0)
    return Mesh(middle + (mesh.vertices - middle) * [0.5, 1.0, 1.0], mesh.faces, mesh.source)


class _ForgetsDistances(Guard):
    """A guard that forgets in a new session how near two bodies within their clearance have come."""

    def reset(self) -> None:
        super().reset()
        self._near.release()


def _shown(stratum: Stratum) -> bool:
    """Whether the guard sees what jogs are about to do."""
    return stratum.kind in (*JOGGED, MIXED) and not stratum.silent


def _identified(stratum: Stratum) -> bool:
    """Whether the guard identifies jogs by measured states."""
    return stratum.kind in (*JOGGED, MIXED) and stratum.silent


def _moved(stratum: Stratum) -> bool:
    """Whether the robot moves on paths, by short motions."""
    return stratum.kind in (*MOVED, MIXED) and (stratum.length < 2 or stratum.kind == MIXED)


MUTATIONS: dict[str, Mutation] = {
    "short-delay": Mutation(assumed=lambda true: replace(true, max_age=true.max_age - _POLL)),
    "high-deceleration": Mutation(assumed=lambda true: replace(true, deceleration=1.25 * true.deceleration)),
    "no-joint-path": _without(Path.JOINT),
    "no-base-path": _without(Path.BASE),
    "no-tool-path": _without(Path.TOOL),
    "double-age": Mutation(patience=2.0),
    "stale-answers": Mutation(link=_AcceptsStaleAnswers),
    "no-clearance": Mutation(_NoClearance, strata=lambda _: True),
    "no-table-rate": Mutation(_NoTable, alone="table"),
    "no-axis-rate": Mutation(_NoFurtherRate, alone="further", further=True),
    "no-axis-path": Mutation(_FurtherPathIgnored, strata=lambda one: one.kind in _OF_AXES, further=True),
    "nothing-carried": Mutation(_NothingCarried, strata=lambda one: one.kind in _OF_AXES, further=True),
    "no-part": Mutation(_overlooks("part"), strata=lambda _: True),
    "no-sensor": Mutation(_overlooks("sensor"), strata=lambda _: True),
    "slow-is-rest": Mutation(_SlowIsRest, strata=lambda stratum: _identified(stratum) and stratum.decade < 2),
    "begun-is-permitted": Mutation(_BegunIsPermitted, strata=_shown),
    "quarter-as-fast": Mutation(_QuarterAsFast, strata=_shown),
    "ignored-speed": Mutation(link=_IgnoresPermittedSpeed, strata=_shown),
    "forgotten-speeds": Mutation(_ForgetsPermittedSpeeds, strata=_shown),
    "unchecked-short-motions": Mutation(_ShortMotionsAreUnchecked, strata=_moved),
    "start-width": Mutation(_StartWidth, strata=lambda _: True),
    "forgotten-distance": Mutation(_ForgetsDistances, strata=lambda stratum: stratum.kind == MIXED),
}
