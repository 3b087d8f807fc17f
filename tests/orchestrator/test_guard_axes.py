"""The guard over axes beyond the table: proved stops, contacts of the true motion, messages, parts that axes carry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import GRIPPER, block, cell_file, export_mm
from guard_rig import Distance, GuardRig, guard_rig
from guard_walls import behind_wall, boxes, distances, is_clear
from test_further_axes import STACKED

from bench.guard_search.mutations import MUTATIONS
from guard_motions import AXIS, WITH_AXES, cell_of, described_cell, random_motion, random_start, stopping_motion, unit
from scancell.cell.driver import Mode, Operation
from scancell.config.cell import CellDescription
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import DescriptionError, MessageError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.guard.check import ManualCheck
from scancell.guard.endpoints import Identifier
from scancell.guard.guard import Guard, GuardSettings
from scancell.guard.messages import CellState, PlacedPart, axes_digest, axis_bits, decode
from scancell.guard.parts import NearPairs, PartTracker, Tool, UnseenApproach, carriers, jog_limits
from scancell.guard.stopping import Hypothesis, MeasuredState, Predictor, WorstCase
from scancell.guard.stopping import Path as Course
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.proximity.scene import cell_scene
from scancell.scanning.session import guard_of, settings_of

PART = block(0.06, 0.06, 0.05)
KINDS = (AXIS, "joints", AXIS, "table", "single joint", "base", AXIS, "tool")
MOVED_BY_AXIS = {"track": "sensor", "tilt_turn": "table"}
CONTACT = 0.5e-3  # m
REACTION = 0.3  # s
TIMES = 0.032 * np.arange(3)


def worst_of(arm: str, reaction: float = REACTION) -> WorstCase:
    """At what the axes of a cell can do, with the errors of its encoders."""
    braking = 0.9 * boxes(arm).axis_max_acceleration
    return WorstCase(0.0, 0.0, reaction, braking, settings_of(described_cell(arm)).angle_error)


def stops_near_walls(arm: str, count: int) -> np.ndarray:
    """Random motions (count, 3) towards walls.

    Whether the stop is proved, whether it would be with a tenth of the reaction time, and whether it ends in contact.
    """
    rng, found = np.random.default_rng(61), []
    times = np.append(TIMES, TIMES[-1] + np.linspace(0, REACTION, 25)[1:])
    noise, body = np.asarray(settings_of(described_cell(arm)).noise), MOVED_BY_AXIS[arm]
    cell, home = boxes(arm), boxes(arm).home
    number = [one.name for one in cell.bodies].index(body)
    while len(found) < count:
        start = random_start(cell, rng)
        start[: len(home)] = home + rng.uniform(-0.2, 0.2, len(home))
        motion = random_motion(arm, KINDS[len(found) % len(KINDS)], rng, times, start)
        corner = rng.choice(cell.bodies[number].mesh.vertices)
        at = pose.transform_points(cell.body_poses(motion.axes[[1, 2]])[:, number], corner[None])
        moved = at[1, 0] - at[0, 0]
        speed = float(np.linalg.norm(moved)) / 0.032
        ahead = moved / (0.032 * speed) if speed > 1e-4 else unit(rng)
        direction = ahead * rng.choice([1, 1, 1, -1]) + 0.3 * unit(rng)
        gap, now = 0.55e-3 + speed * float(rng.uniform(0.0, 2.0)) * REACTION, motion.axes[2]
        walled, scene = behind_wall(now, direction / np.linalg.norm(direction), gap, arm, body)
        if not is_clear(walled, scene, now, gap):
            continue
        hypotheses = Identifier(walled, noise).identify(motion.states(rng, noise)).hypotheses
        near = NearPairs(walled, scene.pairs, CONTACT, noise)
        checks = (ManualCheck(walled, scene, near, worst_of(arm, share * REACTION), 0.5) for share in (1.0, 0.1))
        proved, hastily = (check.check(hypotheses, only_stop=True).stop_is_proved for check in checks)
        rates = (motion.axes[-1] - motion.axes[-2]) / (times[-1] - times[-2])
        braked = motion.axes[-1] + stopping_motion(rates, 0.0, worst_of(arm).deceleration, np.linspace(0, 0.6, 60))
        hit = (distances(walled, scene, np.vstack([motion.axes[2:], braked])) <= 0).any()
        found.append([proved, hastily, bool(hit)])
    return np.array(found)


@pytest.mark.parametrize("arm", WITH_AXES)
def test_proved_stops_are_free_of_contact_in_the_worst_case(arm: str) -> None:
    """With a tenth of the reaction time, motions would be released into walls."""
    proved, hastily, hit = stops_near_walls(arm, 100).T
    assert not (proved & hit).any()
    assert proved.sum() >= 25
    assert (hit & ~proved).sum() >= 4
    assert (hastily & hit).sum() >= 2


@pytest.mark.parametrize("arm", WITH_AXES)
def test_changes_of_jogs_stay_within_the_bound_of_their_approach(arm: str) -> None:
    """All axes accelerate from rest as the limits of jogs allow, those of the tool in the world included."""
    nominal, rng, used = boxes(arm), np.random.default_rng(62), 0.0
    scene = cell_scene(nominal, {body.name: body.mesh for body in nominal.bodies})
    limits = jog_limits(described_cell(arm).robot, nominal)
    unseen, time = UnseenApproach(nominal, scene.pairs, limits), 0.3
    for _ in range(60):
        start = random_start(nominal, rng)
        kept = rng.choice([1.0, 0.0], len(start), p=[0.5, 0.5])
        wanted = (rng.choice([-1.0, 1.0], len(start)) * kept + 1e-6) * limits.axes
        tool = nominal.tree.jacobian("sensor", start)[:, : len(start)] @ wanted
        share = max(1.0, np.linalg.norm(tool[:3]) / limits.line, np.linalg.norm(tool[3:]) / limits.turn)
        axes = np.stack([start, start + wanted / share * time**2 / 2])
        even, changed = distances(nominal, scene, axes, np.inf)
        nearer = np.where((even > 0) & (changed > 0), even - changed, 0.0)
        bound = unseen.bound(start, time**2)
        assert (nearer <= bound + 1e-12).all(), np.array(scene.pairs)[nearer > bound]
        used = max(used, float((nearer[bound > 0] / bound[bound > 0]).max()))
    assert used > 0.5


# Contacts that python-fcl finds in the true motion.


def with_obstacle(folder: Path, cell: str, mesh: Mesh, *settings: str) -> CellDescription:
    file = export_mm(mesh, folder / "block.stl")
    obstacle = f'cell.obstacle=[{{ name = "block", mesh = "{file}", pose = {{}} }}]'
    return load_setup(assets_dir() / f"cells/{cell}.toml", settings=[obstacle, *settings]).cell


def in_the_way(folder: Path, cell: str) -> tuple[CellDescription, str, np.ndarray]:
    """A block in the way of what the axis of a cell carries, the name of that body, and the direction to the block."""
    if cell == "tilt_turn":  # beside the platter, whose edge rises towards it
        placed = box_mesh((0.1, 0.02, 0.2)).transformed(pose.translation((0.45, 0.16, 0.15)))
        return with_obstacle(folder, cell, placed), "table", np.eye(8)[7]
    free = nominal_cell(load_setup(assets_dir() / "cells/track.toml").cell, PART)
    base = next(body.mesh for body in free.bodies if body.name == "base")
    aside = base.bounds[1][1] + 0.1
    placed = box_mesh((0.1, 0.02, 0.1)).transformed(pose.translation((0.0, aside + 0.01, 0.05)))
    return with_obstacle(folder, cell, placed), "base", np.eye(8)[7]


def jog(rig: GuardRig, along: np.ndarray) -> None:
    rig.session.request_operation(Operation.MANUAL)
    rig.cycles(4)
    rig.session.start_jog_joints(along)
    rig.cycles(350)


def move(rig: GuardRig, along: np.ndarray) -> None:
    rig.move(0.4 * along, speed=0.2, patience=4.0)


def programs(rig: GuardRig, along: np.ndarray) -> None:
    fastest = float(along @ rig.nominal.axis_max_acceleration) * rig.session.cycle**2 / 6  # step of equidistant points
    for _ in range(60):
        if not rig.run_program(0.9 * 60 * fastest * along, points=61, patience=2.0):
            break


@pytest.mark.parametrize("cell", WITH_AXES)
@pytest.mark.parametrize("motion", [jog, move, programs], ids=lambda motion: motion.__name__)
def test_axis_carries_nothing_into_an_obstacle(
    motion: Callable[[GuardRig, np.ndarray], None], cell: str, tmp_path: Path
) -> None:
    description, body, along = in_the_way(tmp_path, cell)
    nominal = nominal_cell(description, PART)
    with guard_rig(tmp_path, description, PART, nominal.start) as rig:
        motion(rig, along)
        assert rig.contacts() == set()
        distance = Distance(nominal, (body, "block"))
        assert rig.stops == 0
        assert distance(rig.axes[-1]) < 6e-3  # it goes as far as it may


@pytest.mark.parametrize(
    ("error", "motion"),
    [("no-axis-path", jog), ("no-axis-path", move), ("nothing-carried", move)],
    ids=lambda given: getattr(given, "__name__", given),
)
def test_guard_that_overlooks_the_axis_lets_it_collide(
    error: str, motion: Callable[[GuardRig, np.ndarray], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scancell.scanning.session.Guard", MUTATIONS[error].guard)
    with pytest.raises(AssertionError) as failure:
        test_axis_carries_nothing_into_an_obstacle(motion, "track", tmp_path)
    assert "rig.contacts(" in str(failure.traceback[-1].statement)


@pytest.mark.parametrize("cell", WITH_AXES)
def test_axis_may_leave_a_body_within_its_clearance_but_not_approach_it(cell: str, tmp_path: Path) -> None:
    description, body, along = in_the_way(tmp_path, cell)
    nominal = nominal_cell(description, PART)
    distance = Distance(nominal, (body, "block"))
    near = distance.reached(nominal.start, along, 1.2e-3)
    with guard_rig(tmp_path, description, PART, near) as rig:
        assert not rig.move(1e-3 * along, speed=0.1, patience=0.5)
        assert rig.move(-0.05 * along, speed=0.2, patience=3.0)
        assert rig.stops == 0
        assert distance(rig.axes[-1]) > 1.2e-3
        assert rig.contacts() == set()


@pytest.mark.parametrize("cell", WITH_AXES)
def test_jogs_at_either_end_of_the_range_end_without_a_stop(cell: str, tmp_path: Path) -> None:
    """Nothing is in the way: the axis reaches its limit, and leaves it again."""
    description = load_setup(assets_dir() / f"cells/{cell}.toml").cell
    nominal = nominal_cell(description, None)
    (axis,) = nominal.further_axes
    for end, sign in ((axis.min, -1.0), (axis.max, 1.0)):
        start = nominal.start
        start[-1] = end - sign * 0.01
        with guard_rig(tmp_path / f"{sign}", description, None, start) as rig:
            rig.session.request_operation(Operation.MANUAL)
            rig.cycles(4)
            rig.session.start_jog_joints(sign * np.eye(8)[7])
            rig.cycles(200)
            assert rig.now[-1] == pytest.approx(end, abs=1e-4)
            rig.session.start_jog_joints(-sign * np.eye(8)[7])
            rig.cycles(100)
            assert abs(rig.now[-1] - end) > 0.01
            assert rig.stops == 0


# Messages.


def state_of(nominal: NominalCell, **changed: object) -> CellState:
    prismatic = axis_bits(nominal.prismatic)
    names = [*(f"q[{i}]" for i in range(1, 7)), "table", *(f"axis.{axis.name}" for axis in nominal.further_axes)]
    digest = axes_digest(names, prismatic)
    state = CellState(
        1, 0.016, Operation.AUTOMATIC, Mode.HOLD, False, nominal.start, prismatic=prismatic, digest=digest
    )
    return replace(state, **changed)


def test_state_of_the_cell_survives_the_packet_and_is_answered(tmp_path: Path) -> None:
    description = load_setup(assets_dir() / "cells/track.toml").cell
    nominal = nominal_cell(description, PART)
    with guard_rig(tmp_path, description, PART, nominal.start) as rig:
        state = rig.guarded.state()
        assert state.prismatic == 1 << 7
        assert state.digest == state_of(nominal).digest
        found = decode(state.encode(1, 2)).message
        assert (found.prismatic, found.digest) == (state.prismatic, state.digest)
        np.testing.assert_array_equal(found.ahead, state.ahead)
        assert guard_of(description, PART).answer(found).monitor_speed == 1.0


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"digest": 1}, r"digest = 1: expected \d+, of q\[1\], .*, table, axis\.track"),
        ({"prismatic": 0}, r"prismatic = 0: expected 128, of which axis\.track slide"),
        ({"prismatic": 64}, "prismatic = 64: expected 128"),
        ({"axes": np.zeros(7), "prismatic": 0}, r"axes = 7: expected 8, the cell's joints and table, and axis\.track"),
        ({"version": 1, "prismatic": 0, "digest": 0}, r"version = 1: expected 2, which has axes such as axis\.track"),
    ],
    ids=["digest", "revolute", "table slides", "no track", "version 1"],
)
def test_states_of_other_axes_are_refused(changed: dict[str, object], expected: str) -> None:
    nominal = nominal_cell(load_setup(assets_dir() / "cells/track.toml").cell, PART)
    guard = guard_of(assets_dir() / "cells/track.toml", PART)
    assert guard.answer(state_of(nominal)).monitor_speed == 1.0
    assert guard.answer(state_of(nominal, digest=0)).monitor_speed == 1.0  # not stated
    with pytest.raises(MessageError, match=expected):
        guard.answer(state_of(nominal, **changed))


def test_state_of_a_tilt_is_none_of_a_track() -> None:
    """Both have eight axes: their kinds differ, and so do their names where the kinds do not."""
    tilt = nominal_cell(load_setup(assets_dir() / "cells/tilt_turn.toml").cell, PART)
    with pytest.raises(MessageError, match="prismatic"):
        guard_of(assets_dir() / "cells/track.toml", PART).answer(state_of(tilt))
    with pytest.raises(MessageError, match="digest"):
        guard_of(assets_dir() / "cells/tilt_turn.toml", PART).answer(
            state_of(tilt, digest=axes_digest([*(f"q[{i}]" for i in range(1, 8)), "table"]))
        )


def test_errors_of_axes_are_one_or_one_for_each() -> None:
    setup = load_setup(assets_dir() / "cells/track.toml")
    nominal = nominal_cell(setup.cell, PART)
    for key in ("noise", "angle_error"):
        with pytest.raises(DescriptionError, match=f"{key} = .*: expected one number, or 8 for all axes"):
            Guard(nominal, setup.cell.robot, GuardSettings(**{key: (1e-4,) * 7}))
        Guard(nominal, setup.cell.robot, GuardSettings(**{key: (1e-4,) * 8}))


def test_errors_of_a_described_track_are_lengths() -> None:
    """The encoder of a prismatic axis counts in mm, and does not change the errors of the angles."""
    fine, coarse = (
        settings_of(
            load_setup(assets_dir() / "cells/track.toml", settings=[f"cell.axis[1].encoder_noise_mm={mm}"]).cell
        )
        for mm in (0.0, 0.3)
    )
    assert np.asarray(fine.noise)[-1] == pytest.approx(1e-5)
    assert np.asarray(coarse.noise)[-1] == pytest.approx(3e-4, rel=1e-5)
    assert np.asarray(coarse.angle_error)[-1] == pytest.approx(1.5e-3, rel=1e-5)
    assert np.asarray(coarse.noise)[:-1] == pytest.approx(np.radians(0.005))
    tilt = settings_of(load_setup(assets_dir() / "cells/tilt_turn.toml").cell)
    assert tilt.noise == pytest.approx(np.radians(0.005))
    assert len(np.asarray(tilt.angle_error)) == 8


# Parts that axes carry.

TILT = """
[[axis]]
name = "tilt"
kind = "revolute"
along = "x"
pose = { x_mm = 450.0, z_mm = 200.0 }
min_deg = -60.0
max_deg = 60.0
max_speed_deg_s = 90.0
max_acceleration_deg_s2 = 180.0
"""


def test_parts_are_numbered_by_the_axis_that_carries_them() -> None:
    nominal = nominal_cell(load_setup(assets_dir() / "cells/tilt_turn.toml").cell, PART)
    assert carriers(nominal) == ("world", *(f"link[{i}]" for i in range(1, 7)), "table", "tilt")
    setup = load_setup(assets_dir() / "cells/tilt_turn.toml")
    guard = Guard(nominal, setup.cell.robot, movable=[1])
    at = (0.1, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0)
    axes = nominal.start
    axes[-2:] = 0.4, 0.3
    for carrier, frame in enumerate(carriers(nominal)):
        guard.answer(state_of(nominal, axes=axes, parts=(PlacedPart(1, carrier, at),)))
        placed = guard._with_parts((PlacedPart(1, carrier, at),))
        body = next(body for body in placed.bodies if body.name == "part")
        assert body.moves_with == frame
        assert body.mesh.bounds.mean(0) == pytest.approx(PART.bounds.mean(0) + at[:3], abs=1e-9)


def test_part_is_released_on_the_table_where_the_table_is(tmp_path: Path) -> None:
    """A gripper opens above the tilted platter, 95 mm beside where its middle is at rest."""
    settings = [
        *GRIPPER,
        'cell.table.moves_with="tilt"',
        "cell.table.pose={ z_mm = -150.0 }",
        'cell.part.fixture="free"',
    ]
    cell = load_setup(cell_file(tmp_path, TILT), settings=[*settings, "cell.table.radius_mm=60"]).cell
    nominal = nominal_cell(cell, PART)
    tracker, axes = PartTracker(cell, nominal), nominal.start
    assert tracker.update(axes, [], 0.05, False)[0].carrier == 7
    axes[-2:] = 0.3, 0.7
    over = nominal.world_from("table", axes) @ nominal.table_from_part
    grip = over @ pose.from_rotation(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.04))
    flange = grip @ pose.inverse(pose.translation((0.06, 0.0, 0.09)))
    q = nominal.arm.ik(flange, nominal.home)[0]
    axes[:6] = q[np.flatnonzero(np.isfinite(q).all(1))[0]]
    tracker.update(axes, [], 0.02, True)
    (held,) = tracker.update(axes, [], 0.02, True)
    assert held.carrier == 6
    (put,) = tracker.update(axes, [], 0.04, False)
    assert put.carrier == 7
    assert put.pose[:3] == pytest.approx(nominal.table_from_part[:3, 3], abs=1e-9)
    # Where the platter was at rest is nothing below the part any more.
    away = axes.copy()
    away[7] = -0.7
    tracker.update(axes, [], 0.02, True)
    tracker.update(axes, [], 0.02, True)
    (dropped,) = tracker.update(away, [], 0.04, False)
    assert dropped.carrier == 0


def test_cells_of_boxes_have_the_axes() -> None:
    """The cells of these tests are the shipped ones."""
    for arm, file in WITH_AXES.items():
        assert len(boxes(arm).further_axes) == 1
        assert cell_of(arm)[0].axes[-1] == load_setup(assets_dir() / f"cells/{file}.toml").cell.axis[0].name


# Arms that several axes carry.


@pytest.fixture(scope="module")
def stacked(tmp_path_factory: pytest.TempPathFactory) -> NominalCell:
    """A track and a turning column carry the arm, a lift the table."""
    settings = ['cell.robot_moves_with="column"', 'cell.table.moves_with="lift"']
    file = cell_file(tmp_path_factory.mktemp("stacked"), STACKED)
    return nominal_cell(load_setup(file, settings=settings).cell, PART)


def anywhere(nominal: NominalCell, rng: np.random.Generator) -> np.ndarray:
    joints = nominal.home + rng.uniform(-0.3, 0.3, len(nominal.home))
    return np.array([*joints, rng.uniform(-3, 3), *(rng.uniform(axis.min, axis.max) for axis in nominal.further_axes)])


def test_kinematics_of_the_tool_are_those_of_the_tree(stacked: NominalCell) -> None:
    tool, rng = Tool(stacked), np.random.default_rng(63)
    assert tool.held.tolist() == [7, 8, 9]
    for _ in range(10):
        axes, rates = anywhere(stacked, rng), rng.standard_normal(10)
        jacobian = stacked.tree.jacobian("sensor", axes)[:, :10]
        (placed,), (columns,) = tool.poses(axes[None])
        assert placed == pytest.approx(stacked.world_from_sensor(axes), abs=1e-12)
        assert columns == pytest.approx(jacobian[:, :6], abs=1e-12)
        assert tool.twist(axes, rates) == pytest.approx(jacobian @ rates, abs=1e-12)


@pytest.mark.parametrize("path", [Course.BASE, Course.TOOL])
def test_tool_moves_straight_in_the_world_wherever_its_axes_rest(stacked: NominalCell, path: Course) -> None:
    """The path that is identified from noisy states leads to the poses of the tool that the motion has."""
    tool, predictor, rng = Tool(stacked), Predictor(stacked), np.random.default_rng(64)
    noise = np.where(stacked.prismatic, 1e-5, np.radians(0.005))
    identifier, tick = Identifier(stacked, noise), 0.004
    for _ in range(40):
        axes, twist = anywhere(stacked, rng), np.append(0.15 * unit(rng), 0.3 * unit(rng))
        course = [axes]
        for _ in range(42):
            placed, jacobian = tool.poses(course[-1][None])
            turned = (placed[0, :3, :3] @ twist.reshape(2, 3).T).T.ravel() if path is Course.TOOL else twist
            half = course[-1].copy()
            half[:6] += tick / 2 * tool.rates(jacobian, turned[None])[0]
            placed, jacobian = tool.poses(half[None])
            turned = (placed[0, :3, :3] @ twist.reshape(2, 3).T).T.ravel() if path is Course.TOOL else twist
            nxt = course[-1].copy()
            nxt[:6] += tick * tool.rates(jacobian, turned[None])[0]
            course.append(nxt)
        states = [MeasuredState(0.032 * k, course[8 * k] + noise * rng.standard_normal(len(axes))) for k in range(3)]
        found = identifier.identify(states)
        assert path in [hypothesis.path for hypothesis in found.hypotheses]
        _, jacobian = tool.poses(course[0][None])
        turned = (stacked.world_from_sensor(axes)[:3, :3] @ twist.reshape(2, 3).T).T.ravel()
        rates = np.zeros(10)
        rates[:6] = tool.rates(jacobian, (turned if path is Course.TOOL else twist)[None])[0]
        exact = Hypothesis(path, MeasuredState(0.0, axes), rates, np.zeros(10), 0.0)
        reached = predictor.axes([exact], np.array([[tick * 20, tick * 42]]))[0]
        expected = tool.poses(np.array([course[20], course[42]]))[0]
        assert tool.poses(reached)[0] == pytest.approx(expected, abs=2e-5)
        assert (reached[:, 6:] == axes[6:]).all()
