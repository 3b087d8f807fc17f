"""Random starts and motions: from near a body towards it, or from anywhere to anywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scancell.arrays import Array
from scancell.config.cell import ChannelDescription, LinkDescription
from scancell.config.description import si_value, to_si
from scancell.geometry import pose
from scancell.guard.parts import Tool
from scancell.nominal.cell import NominalCell, flange_from_tool, world_from_tool
from scancell.proximity.scene import ProximityScene
from scancell.studies.guard.scenario import (
    FURTHER,
    JOGGED,
    Event,
    Kind,
    Motion,
    Scenario,
    program_duration,
    short_program_length,
)
from scancell.studies.guard.simulation import shifted
from scancell.studies.guard.worlds import World

DECADES = ("0.1-1 %", "1-10 %", "10-100 %")  # of the full speed
LENGTHS = ("0.01-0.1 mrad", "0.1-1 mrad", "1-10 mrad", "10-100 mrad", "100-3000 mrad")
MIXED = "mixed"  # kinds, or lengths, of a run that draws those of each motion
_PARTED = tuple(kind for kind in Kind if kind not in FURTHER)  # those of the table are of any axis beyond the joints
KINDS = (*_PARTED, MIXED, MIXED, MIXED)
BLOCK = len(KINDS) * len(DECADES)  # runs with one cell, part and fault
VERSIONS = (2, 2, 2, 1)  # of the protocol, which alternate
_SLOWEST = 1e-3
_SHORTEST, _LONGEST = 1e-5, 3.0  # rad, and m
_SILENT = 8  # blocks per block with a controller that does not show its jogs
_NEAR = 3, 5  # runs of so many that start near a body
_SLOW = ChannelDescription(delay_ms=4.0, jitter_ms=2.0)

_TRIES = 4000  # starts of a run
_RANDOM = 60  # axes by which the usual clearances are known
_INSIDE = 0.02  # rad, of the limits
_AT_END = 1e-5  # rad and m from the limits of an axis beyond the table
_NEAR_HOME = 0.7  # rad
_FAR_OUTSIDE, _FAR_INSIDE = 0.06, 0.015  # m: clearances of a start far from all bodies, and of two bodies of the arm
_OTHERS = 5e-3  # m: clearances of the other pairs at a start near a body
_GAPS = 0.5e-3, 20e-3  # m between the true bodies at such a start
_APART = 1e-3  # m before the contact, where the direction of the approach is taken
_SILENT_GAP = 22e-3  # m: nearer, a controller that does not send its jogs may collide before the first answer
_DESCENTS, _STEP, _DIFFERENCE = 25, 0.3, 1e-4  # steps to a contact, and rad
_EARLIER_GAP = 6e-3  # m: nearer, version 1 of the protocol permits an approach within the errors of the measured angles
_FLAT = 1e-3  # m/rad
_SHORT = 0.01  # rad, in which the distance of a pair grows evenly
_BACK = np.geomspace(1e-5, 0.8, 120)  # rad, from the contact back
_SHIFTED = 0.75  # share of the runs whose bodies are off by their stated errors
_MOST = 1000  # motions
_CAP, _LONG_CAP, _LONG = 6.0, 40.0, 1 / 20  # s of simulated time, and share of the long runs
_CARRYING = 5.0  # s more with a part in the gripper
_ANSWER = 0.05  # s for which a motion waits for an answer
_LONGEST_JOG = 5.0  # s
_LONGEST_LINE = 0.3  # rad
_INSISTS, _RETREATS = 0.8, 0.1  # shares of the motions of a run towards a body
_LIFTED = 0.06, 0.05  # m and rad
_EVENTS = tuple(event for event in Event if event not in (Event.GRIP, Event.RELEASE, Event.GRIPPER))


def _both(name: str, **faults: float) -> tuple[str, LinkDescription]:
    channel = _SLOW.model_copy(update=faults)
    return name, LinkDescription(to_guard=channel, to_cell=channel)


FAULTS: dict[str, LinkDescription] = dict(
    [
        _both("none", delay_ms=0.0, jitter_ms=0.0),
        _both("delay"),
        _both("jitter", jitter_ms=10.0),
        _both("loss", loss=0.05),
        _both("bursts", burst=0.01, burst_packets=4.0),
        _both("reordering", jitter_ms=20.0),
        _both("duplication", duplication=0.3, replay=0.1, replay_ms=300.0),
        ("clock", LinkDescription(to_guard=_SLOW, to_cell=_SLOW, clock_offset_ms=-700.0, clock_drift_ppm=2000.0)),
        ("stale", LinkDescription(to_guard=_SLOW, to_cell=_SLOW, stale=0.2)),
        ("dead", LinkDescription(to_guard=_SLOW, to_cell=_SLOW)),
    ]
)


@dataclass(frozen=True)
class Stratum:
    """The stratum that a run samples.

    Attributes
    ----------
    number, block
        Numbers of the run, and of the block of `BLOCK` runs with one cell that it belongs to.
    kind
        Kind of the motions: a `Kind`, or `MIXED`.
    decade, length
        Numbers of the decades of speed and of length; length `len(LENGTHS)`: each motion has its own.
    near
        Whether the robot starts near a body and insists on approaching it.
    fault
        Fault of the network: a key of `FAULTS`.
    silent
        Whether the controller does not send the paths of jogs.
    version
        Version of the controller's protocol.
    """

    number: int
    block: int
    kind: str
    decade: int
    length: int
    near: bool
    fault: str
    silent: bool
    version: int

    @property
    def lengths(self) -> str:
        """Name of the decade of length."""
        return (*LENGTHS, MIXED)[self.length]

    def random_speed(self, rng: np.random.Generator) -> float:
        """Share of the full speed, log-uniform in the decade."""
        return float(_SLOWEST * 10.0 ** (self.decade + rng.random()))

    def random_length(self, rng: np.random.Generator) -> float:
        """Largest travel (rad or m) of an axis in a motion, log-uniform in the decade or over all of them."""
        share = (self.length + rng.random()) if self.length < len(LENGTHS) else len(LENGTHS) * rng.random()
        decades = np.append(np.arange(len(LENGTHS)), np.log10(_LONGEST / _SHORTEST))
        return float(_SHORTEST * 10.0 ** np.interp(share, np.arange(len(LENGTHS) + 1), decades))

    def random_kind(self, rng: np.random.Generator) -> Kind:
        """Kind of a motion; half of the mixed ones are jogs."""
        if self.kind != MIXED:
            return Kind(self.kind)
        jogs = rng.random() < 0.5
        return Kind(rng.choice([kind for kind in _PARTED if (kind in JOGGED) == jogs]))


def stratum_of(number: int) -> Stratum:
    """Stratum of a run: all kinds have equal counts at each speed in a block, and all lengths in five blocks."""
    within, block = number % BLOCK, number // BLOCK
    decade, kind = divmod(within, len(KINDS))
    length = (within + block) % len(LENGTHS) if KINDS[kind] != MIXED else len(LENGTHS)
    near = (within + 2 * block + decade) % _NEAR[1] < _NEAR[0]
    turn = block + block // len(FAULTS)
    fault = list(FAULTS)[block % len(FAULTS)]
    version = VERSIONS[block // 2 % len(VERSIONS)]
    return Stratum(number, block, KINDS[kind], decade, length, near, fault, turn % _SILENT == _SILENT - 1, version)


def random_network(fault: str, duration: float, rng: np.random.Generator) -> tuple[LinkDescription, int]:
    """Faults of a run of `duration` s, and their seed."""
    description, seed = FAULTS[fault], int(rng.integers(2**32))
    if fault == "dead":
        dead = description.to_cell.model_copy(update={"dead_from_s": float(rng.uniform(0.1, 0.8) * duration)})
        description = description.model_copy(update={"to_cell": dead})
    return description, seed


@dataclass(frozen=True)
class Draw:
    """A scenario, the errors of the true bodies, and the pair that it approaches.

    Attributes
    ----------
    shifts
        (bodies, 3), m, in the bodies' frames.
    pair
        Names of two bodies; empty: none.
    gap
        Distance of the pair at the start, m; NaN without a pair.
    """

    scenario: Scenario
    shifts: Array
    pair: tuple[str, ...]
    gap: float


class Draws:
    """Draws scenarios of a world."""

    def __init__(self, world: World, cycle: float) -> None:
        self._world, self._cycle = world, cycle
        nominal = world.nominal
        self._limits = to_si(world.described.robot.motion.model_dump())
        self._held = [joint.index for joint in nominal.arm.held]
        self._tool = Tool(nominal)
        self._is_cartesian = len(self._tool.active) == 6
        lower, upper = nominal.arm.limits
        self._lower, self._upper = lower + _INSIDE, upper - _INSIDE
        self._free = np.array([i for i in range(len(nominal.axes)) if i not in self._held])
        gripper = world.described.gripper
        self._carried: dict[bool, ProximityScene] = {}
        self._single: dict[tuple[int, int], tuple[ProximityScene, ProximityScene]] = {}
        self._stroke = None if gripper is None else si_value(gripper, "stroke_mm")

    def draw(self, stratum: Stratum, rng: np.random.Generator) -> Draw:
        """The scenario of a stratum.

        Raises
        ------
        RuntimeError
            If there is no start for it.
        """
        for _ in range(_TRIES):
            found = self._gripped(stratum, rng) if self._world.grips else self._from_anywhere(stratum, rng)
            if found is not None:
                return found
        raise RuntimeError(f"run {stratum.number}: no start was found in {_TRIES} tries")

    # Starts

    def _from_anywhere(self, stratum: Stratum, rng: np.random.Generator) -> Draw | None:
        nominal, width, span = self._world.nominal, None, _LONG_CAP if rng.random() < _LONG else _CAP
        if self._stroke is not None and rng.random() < 0.7:
            width = self._stroke * float(rng.random())
            nominal = self._world.opened(width)
        scene = self._world.scene
        silent_jogs = stratum.silent and (stratum.kind == MIXED or stratum.kind in JOGGED)
        start, direction, pair = self.anywhere(rng), np.zeros(len(nominal.axes)), -1
        contact, least = start, self.least
        if not self._is_free(nominal, scene, start, least):  # from there the contact is rarely behind other bodies
            return None
        if stratum.near or rng.random() < 0.5:
            pair = self._random_pair(rng)
            approach = self.contact(nominal, scene, start, pair)
            if approach is None:
                return None
            contact, direction = approach
        before = contact - _BACK[:, None] * direction
        shifts = self._shifts(nominal, scene, before, pair, rng)
        if pair >= 0 and not stratum.near:
            direction = (contact - start) / np.abs(contact - start).max()
        motions = self._motions(stratum, direction, contact, silent_jogs, span, rng)
        if stratum.near:
            wanted = self._gap(nominal, scene, contact, direction, pair, motions, rng)
            wanted = max(wanted, _SILENT_GAP if silent_jogs else _EARLIER_GAP if stratum.version == 1 else 0.0)
            far = np.flatnonzero(self._distance(nominal, scene, before, pair, shifts) >= wanted)
            if not len(far):
                return None
            start = before[far[0]]
            least = np.where(np.arange(len(least)) == pair, _GAPS[0] / 2, np.minimum(least, _OTHERS))
        inside = ((start >= self._all_limits[0]) & (start <= self._all_limits[1])).all()
        cells = (nominal, self._world.nominal) if width is not None else (nominal,)
        if not inside or not all(self._is_free(cell, scene, start, least, shifts) for cell in cells):
            return None
        gap = float(self._distance(nominal, scene, start[None], pair, shifts)[0]) if pair >= 0 else np.nan
        if width is not None:
            motions[0] = replace(motions[0], event=Event.RELEASE, width=width)
        return self._made(start, motions, shifts, pair, gap, span)

    def _gripped(self, stratum: Stratum, rng: np.random.Generator) -> Draw | None:
        """The gripper takes the part, lifts it and approaches something with it, or puts it down and approaches it."""
        world, start = self._world, self._world.start
        held, span = rng.random() < 0.6, _LONG_CAP if rng.random() < _LONG else _CAP
        carrying = world.carrying(held)
        scene = self._carrying_scene(held)
        up = world_from_tool(world.nominal, start)
        up[2, 3] += _LIFTED[0]
        lifted = self._joints_at(up, start)
        if lifted is None:
            return None
        pair = self._random_pair(rng, "part" if rng.random() < 0.7 else "")
        there = lifted.copy()
        there[: self._tool.joints] += rng.uniform(-1.0, 1.0, self._tool.joints) * rng.choice([0.1, 0.5])
        approach = self.contact(carrying, scene, np.clip(there, *self._all_limits), pair)
        if approach is None:
            return None
        contact, direction = approach
        before = contact - _BACK[:, None] * direction
        shifts = self._shifts(carrying, scene, before, pair, rng)
        shifts[world.names.index("part")] = 0.0
        creeping = self._motions(stratum, direction, contact, False, span, rng)
        wanted = 2 * self._gap(carrying, scene, contact, direction, pair, creeping, rng)
        wanted = max(wanted, _EARLIER_GAP if stratum.version == 1 else 0.0)
        far = np.flatnonzero(self._distance(carrying, scene, before, pair, shifts) >= wanted)
        if not len(far):
            return None
        near = before[far[0]]
        least = np.minimum(self.least, _OTHERS / 2)
        least[pair] = _GAPS[0] / 2
        if not self._is_free(carrying, scene, near, least, shifts):
            return None
        lift = Motion(Kind.JOINT_MOVE, lifted - start, 0.3, event=Event.GRIP, length=_LIFTED[1])
        motions = [lift]
        if not held:
            motions.append(Motion(Kind.JOINT_MOVE, start - lifted, 0.1, length=_LIFTED[1]))
            release = Motion(Kind.JOINT_MOVE, lifted - start, 0.3, event=Event.RELEASE, width=self._stroke or 0.0)
            motions.append(replace(release, length=_LIFTED[1]))
        motions.append(Motion(Kind.JOINT_MOVE, near - lifted, 0.3, length=float(np.abs(near - lifted).max())))
        motions += creeping
        return self._made(start, motions, shifts, pair, wanted, span + _CARRYING)

    def _made(self, start: Array, motions: list[Motion], shifts: Array, pair: int, gap: float, duration: float) -> Draw:
        names = self._world.pairs[pair] if pair >= 0 else ()
        return Draw(Scenario(start, tuple(motions), duration), shifts, names, gap)

    def anywhere(self, rng: np.random.Generator) -> Array:
        """Axes (axes,), rad or m: near home in half of all cases, else anywhere within the limits; any table angle.

        Further axes are at either end of their range in half of all cases, else anywhere in it.
        """
        home = self._world.nominal.home
        q = home + rng.uniform(-_NEAR_HOME, _NEAR_HOME, len(home))
        if rng.random() < 0.5:
            q = rng.uniform(self._lower, self._upper)
        q[self._held] = home[self._held]
        axes = np.append(np.clip(q, self._lower, self._upper), rng.uniform(-np.pi, np.pi))
        further = [rng.choice([low, high, *rng.uniform(low, high, 2)]) for low, high in self._further_limits]
        return np.append(axes, further) if further else axes

    @cached_property
    def _further_limits(self) -> list[tuple[float, float]]:
        return [(axis.min + _AT_END, axis.max - _AT_END) for axis in self._world.nominal.further_axes]

    def _is_free(
        self, nominal: NominalCell, scene: ProximityScene, axes: Array, least: Array, shifts: Array | float = 0.0
    ) -> bool:
        """Whether all pairs keep their `least` distances (pairs,), m, at axes (axes,)."""
        shifts = np.zeros((len(self._world.names), 3)) + shifts
        poses = shifted(nominal.body_poses(axes[None]), shifts)
        return bool((scene.distances(poses, least, 1)[0] >= least - 1e-9).all())

    @cached_property
    def _all_limits(self) -> tuple[Array, Array]:
        low, high = np.reshape(self._further_limits, (-1, 2)).T
        return np.concatenate([self._lower, [-np.inf], low]), np.concatenate([self._upper, [np.inf], high])

    @cached_property
    def least(self) -> Array:
        """Least clearances (pairs,), m, of a start: smaller for pairs that are always near each other."""
        rng = np.random.default_rng(0)
        axes = np.array([self.anywhere(rng) for _ in range(_RANDOM)])
        apart = np.where(self._world.inner, _FAR_INSIDE, _FAR_OUTSIDE)
        nominal = self._world.carrying(held=True) if self._world.grips else self._world.nominal
        scene = self._carrying_scene(True) if self._world.grips else self._world.scene
        found = scene.distances(nominal.body_poses(axes), 2 * apart, 1)
        return np.asarray(np.minimum(apart, found.max(0) / 2))

    def _carrying_scene(self, held: bool) -> ProximityScene:
        if held not in self._carried:
            meshes = {body.name: body.mesh for body in self._world.carrying(held).bodies}
            self._carried[held] = ProximityScene(meshes, self._world.pairs)
        return self._carried[held]

    def _random_pair(self, rng: np.random.Generator, name: str = "") -> int:
        """A pair of the arm and another body in most cases, or one with the table, or of two bodies of the arm."""
        weight = np.where(self._world.inner, 0.15, 1.0)
        on_table = np.array(["fixed_post" in pair for pair in self._world.pairs])
        weight = np.where(on_table, 4.0, weight)
        if name:
            weight = weight * np.array([name in pair for pair in self._world.pairs])
        return int(rng.choice(len(weight), p=weight / weight.sum()))

    def _distance(self, nominal: NominalCell, scene: ProximityScene, axes: Array, pair: int, shifts: Array) -> Array:
        """Distances (n,), m, of a pair at axes (n, axes)."""
        key = id(scene), pair
        if key not in self._single:  # the scene is kept, so that its number stays its own
            others = [frozenset(names) for i, names in enumerate(scene.pairs) if i != pair]
            self._single[key] = scene, scene.without(others)
        poses = shifted(nominal.body_poses(axes), shifts)
        return np.asarray(self._single[key][1].distances(poses, np.inf, 1)[:, 0])

    def _gap(
        self,
        nominal: NominalCell,
        scene: ProximityScene,
        contact: Array,
        direction: Array,
        pair: int,
        motions: list[Motion],
        rng: np.random.Generator,
    ) -> float:
        """Distance (m) of a pair at the start that the motions cover in most cases."""
        still = np.zeros((len(self._world.names), 3))
        apart = float(self._distance(nominal, scene, (contact - _SHORT * direction)[None], pair, still)[0])
        covered = apart / _SHORT * sum(motion.length for motion in motions)
        wanted = _GAPS[0] * (_GAPS[1] / _GAPS[0]) ** float(rng.random())
        return float(np.clip(min(wanted, rng.uniform(0.1, 0.6) * covered), *_GAPS))

    def contact(
        self, nominal: NominalCell, scene: ProximityScene, axes: Array, pair: int
    ) -> tuple[Array, Array] | None:
        """Axes at which a pair is in contact, and the direction (largest component 1) in which it approaches there."""
        still = np.zeros((len(self._world.names), 3))
        steps = _DIFFERENCE * np.eye(len(axes))[self._free]
        down = np.zeros_like(axes)
        for _ in range(_DESCENTS):
            found = self._distance(nominal, scene, np.vstack([axes, axes + steps]), pair, still)
            if found[0] == 0.0:
                return (axes, down) if down.any() else None
            slope = (found[1:] - found[0]) / _DIFFERENCE
            size = float(np.linalg.norm(slope))
            if size < _FLAT:
                return None
            down = np.zeros_like(axes)
            down[self._free] = -slope / np.abs(slope).max()
            length = min(_STEP, (1.01 * found[0] + 1e-4) * float(np.abs(slope).max()) / size**2)
            stepped = np.clip(axes + length * down, *self._all_limits)
            if np.abs(stepped - axes).max() < 1e-6:
                return None
            axes = stepped
        return None

    def _shifts(
        self, nominal: NominalCell, scene: ProximityScene, before: Array, pair: int, rng: np.random.Generator
    ) -> Array:
        """Errors (bodies, 3), m, of the bodies in their own frames: of a pair towards each other, else anywhere.

        `before` are axes (n, axes) on the way back from the contact of the pair.
        """
        error, count = self._world.settings.position_error, len(self._world.names)
        still = np.zeros((count, 3))
        if rng.random() >= _SHIFTED:
            return still
        shifts = rng.normal(size=(count, 3))
        shifts *= 0.999 * error / np.linalg.norm(shifts, axis=1, keepdims=True)
        if pair < 0:
            return shifts
        apart = np.flatnonzero(self._distance(nominal, scene, before, pair, still) >= _APART)
        if not len(apart):
            return shifts
        axes = before[apart[0]][None]
        poses = nominal.body_poses(axes)
        bound = np.where(np.arange(len(scene.pairs)) == pair, np.inf, 0.0)
        first, second = scene.closest_points(poses, bound, 1)[1][0, pair]
        across = (second - first) / np.linalg.norm(second - first)
        for name, sign in zip(self._world.pairs[pair], (1.0, -1.0), strict=True):
            body = self._world.names.index(name)
            shifts[body] = sign * 0.999 * error * poses[0, body, :3, :3].T @ across
        return shifts

    def _joints_at(self, target: Array, near: Array) -> Array | None:
        nominal = self._world.nominal
        joints, others = np.split(near, [self._tool.joints])
        flange = target @ np.linalg.inv(flange_from_tool(nominal))
        branches = nominal.arm.ik(pose.inverse(nominal.world_from(nominal.arm_on, near)) @ flange, joints)[0]
        apart = np.abs(branches - joints).max(-1)
        if not np.isfinite(apart).any():
            return None
        return np.append(branches[np.nanargmin(apart)], others)

    # Motions

    def _motions(
        self, stratum: Stratum, direction: Array, start: Array, silent_jogs: bool, span: float, rng: np.random.Generator
    ) -> list[Motion]:
        """Motions of a run, along a `direction` (axes,) in most cases, or in random ones if it is 0."""
        drawn = float(rng.random())
        if stratum.near:  # a robot creeps towards a body by many motions
            drawn = max(drawn, float(rng.random()))
        count = 1 if silent_jogs else round(_MOST**drawn)
        speed = stratum.random_speed(rng)
        pause = 0.0 if rng.random() < 0.5 else self._cycle * (2.0 / self._cycle) ** float(rng.random())
        eventful = 0.0 if rng.random() < 0.6 else float(rng.choice([0.02, 0.1, 0.3]))
        motions: list[Motion] = []
        for _ in range(count):
            along = self.along(direction, rng)
            length = stratum.random_length(rng)
            motion = self.motion(stratum.random_kind(rng), along, length, speed, start, rng)
            waits = pause * 2.0 * float(rng.random())
            motion = replace(motion, pause=waits if waits >= self._cycle else 0.0)
            if not silent_jogs and rng.random() < eventful:
                motion = self._eventful(motion, rng, restarts=stratum.version > 1)
            motions.append(motion)
            span -= motion.pause + _ANSWER + motion.duration
            if span < 0:
                break
        return motions

    def _eventful(self, motion: Motion, rng: np.random.Generator, restarts: bool) -> Motion:
        if self._stroke is not None and not self._world.grips and rng.random() < 0.4:
            return replace(motion, event=Event.GRIPPER, width=self._stroke * float(rng.random()))
        return replace(
            motion, event=Event(rng.choice([event for event in _EVENTS if restarts or event is not Event.RESTART]))
        )

    def along(self, direction: Array, rng: np.random.Generator) -> Array:
        drawn = rng.random()
        if direction.any() and drawn < _INSISTS:
            return direction
        if direction.any() and drawn < _INSISTS + _RETREATS:
            return -direction
        along = np.zeros(len(direction))
        chosen = rng.permutation(self._free)[: int(rng.integers(1, len(self._free) + 1))]
        along[chosen] = rng.uniform(-1.0, 1.0, len(chosen))
        return np.asarray(along / np.abs(along).max())

    def motion(
        self, kind: Kind, along: Array, length: float, speed: float, start: Array, rng: np.random.Generator
    ) -> Motion:
        """A motion of a kind along `along` (axes,), largest component 1, by `length` (rad or m) at a share of the full
        speed; of the nearest possible kind. One of the table is of any axis beyond the joints."""
        nominal, by = self._world.nominal, length * along
        if kind in (Kind.TABLE_MOVE, Kind.TABLE_JOG):
            table = self._tool.joints
            number = int(rng.integers(table, len(along))) if nominal.further_axes else table
            if number > table:
                kind = Kind.AXIS_MOVE if kind is Kind.TABLE_MOVE else Kind.AXIS_JOG
            sign = np.sign(along[number]) if abs(along[number]) > 1e-3 else rng.choice([-1.0, 1.0])
            along = np.zeros(len(along))
            along[number] = sign
            by = length * along
        if kind is Kind.LINE_MOVE:
            kind = kind if self._is_cartesian else Kind.JOINT_MOVE
            by = min(1.0, _LONGEST_LINE / length) * by
        if kind in JOGGED:
            return self._jog(kind, along, length, speed, start, rng)
        duration = 0.0
        if kind is Kind.SHORT_PROGRAM:
            points = int(rng.choice([2, 3]))
            by = min(1.0, short_program_length(points, by, nominal.axis_max_acceleration, self._cycle)) * by
            duration = (points - 1) * self._cycle
        elif kind is Kind.PROGRAM:
            maxima = nominal.axis_max_speed, nominal.axis_max_acceleration
            duration = program_duration(by, speed, *maxima, self._cycle)
            if duration > _CAP:
                by, duration = _CAP / duration * by, _CAP
        elif kind is Kind.SERVO:
            duration = float((np.abs(by) / (speed * nominal.axis_max_speed)).max())
            duration = self._cycle * (min(np.ceil(duration / self._cycle), 60) + 3)
        return Motion(kind, by, speed, float(duration), length=float(np.abs(by).max()))

    def _jog(
        self, kind: Kind, along: Array, length: float, speed: float, start: Array, rng: np.random.Generator
    ) -> Motion:
        """Deflections that move the axes along `along` for the time that they take for `length`; longer in half of
        all cases, by what the answer of a guard takes."""
        nominal, limits, table = self._world.nominal, self._limits, self._tool.joints
        shares = along / (limits["jog_joint_share"] * nominal.axis_max_speed)
        values, scale = shares, float(np.abs(shares).max())
        if kind in (Kind.BASE_JOG, Kind.TOOL_JOG) and self._is_cartesian:
            tool, twist = self._tool.poses(start[None])[0], self._tool.twist(start, along)
            if kind is Kind.TOOL_JOG:
                twist = (tool[0, :3, :3].T @ twist.reshape(2, 3).T).T.ravel()
            parts = np.concatenate([twist[:3] / limits["jog_speed"], twist[3:] / limits["jog_turn_speed"]])
            scale = max(np.linalg.norm(parts[:3]), np.linalg.norm(parts[3:]), abs(shares[table]), 1e-9)
            values = np.zeros(len(along))
            values[:6], values[table] = parts, shares[table]
        elif kind in (Kind.BASE_JOG, Kind.TOOL_JOG):
            kind = Kind.JOINT_JOG
        duration = length * scale / speed + (_ANSWER if rng.random() < 0.5 else 0.0)
        cycles = np.clip(np.ceil(duration / self._cycle), 1, _LONGEST_JOG / self._cycle)
        return Motion(kind, speed * values / scale, speed, self._cycle * float(cycles), length=length)
