"""Motions that a guard must not overlook: short ones, those after a new session, of the fingers, of the table."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cells import GRIPPER, block, export_mm
from guard_rig import Distance, GuardRig, guard_rig

from bench.guard_search.mutations import MUTATIONS
from scancell.cell.driver import Operation
from scancell.config.cell import CellDescription
from scancell.config.loading import assets_dir, load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, joined
from scancell.guard.guard import GuardSettings
from scancell.nominal.cell import flange_from_tool, nominal_cell

PAIR = ("sensor", "part")
PART = block(0.06, 0.06, 0.05)
ERROR = 0.98 * GuardSettings().position_error  # m, of true bodies
SHOULDER = np.eye(7)[1]  # joint 2 brings the sensor down
DOWN = np.array([0.0, 0.0, -1.0])


def above_part(nominal, gap: float) -> np.ndarray:
    """Axes with the sensor above the part, from which joint 2 has brought them `gap` (m) to each other."""
    sensor = nominal.world_from_sensor(nominal.home).copy()
    sensor[:3, 3] = nominal.world_from_table[:3, 3] + [0.0, 0.0, 0.2]
    branches = nominal.arm.ik(sensor @ pose.inverse(nominal.flange_from_sensor), nominal.home)[0]
    q = branches[np.nanargmin(np.abs(branches - nominal.home).max(-1))]
    return Distance(nominal, PAIR).reached(np.append(q, 0.0), SHOULDER, gap)


# Short motions towards a part: each returns whether it arrived.


def two_set_points(rig: GuardRig) -> bool:
    return rig.run_program(0.6e-3 * SHOULDER)


def three_set_points(rig: GuardRig) -> bool:
    return rig.run_program(0.6e-3 * SHOULDER, points=3)


def joint_move(rig: GuardRig) -> bool:
    return rig.move(1e-5 * SHOULDER)


def slow_joint_move(rig: GuardRig) -> bool:
    return rig.move(1e-4 * SHOULDER, speed=0.01)


def line_move(rig: GuardRig) -> bool:
    rig.session.start_move_line(pose.translation(5e-6 * DOWN) @ rig.nominal.world_from_sensor(rig.now[:-1]))
    return rig.until_there()


SHORT: dict[Callable[[GuardRig], bool], tuple[float, int]] = {
    two_set_points: (8e-3, 40),
    three_set_points: (8e-3, 40),
    joint_move: (2e-3, 570),
    slow_joint_move: (3e-3, 90),
    line_move: (2e-3, 430),
}


@pytest.mark.parametrize(
    "motion",
    SHORT,
    ids=lambda motion: motion.__name__,
)
def test_short_motions_do_not_creep_into_contact(motion: Callable[[GuardRig], bool], tmp_path: Path) -> None:
    """Each is shorter than a controller cycle, or than the noise of the encoders; together they reach the part."""
    gap, count = SHORT[motion]
    cell = load_setup().cell
    start = above_part(nominal_cell(cell, PART), gap)
    with guard_rig(tmp_path, cell, PART, start) as rig:
        arrived = 0
        for _ in range(count):
            if not motion(rig):
                break
            arrived += 1
        assert rig.contacts() == set()
        assert arrived < count
        assert Distance(rig.nominal, PAIR)(rig.axes[-1]) > 1e-3


@pytest.mark.parametrize("motion", SHORT, ids=lambda motion: motion.__name__)
def test_short_motions_far_from_bodies_are_permitted(motion: Callable[[GuardRig], bool], tmp_path: Path) -> None:
    cell = load_setup().cell
    start = above_part(nominal_cell(cell, PART), 0.06)
    with guard_rig(tmp_path, cell, PART, start) as rig:
        assert [motion(rig) for _ in range(10)] == 10 * [True]
        assert rig.stops == 0


@pytest.mark.parametrize(("renewed", "version"), [("session", 2), ("guard", 2), ("session", 1)])
def test_new_sessions_and_guards_do_not_permit_further_approaches(renewed: str, version: int, tmp_path: Path) -> None:
    """An approach within the errors of the angles is permitted once, not once a session."""
    cell = load_setup().cell
    nominal = nominal_cell(cell, PART)
    start = above_part(nominal, 2.04e-3)
    with guard_rig(tmp_path, cell, PART, start, version) as rig:
        for _ in range(5):
            for _ in range(5):
                rig.move(2e-4 * SHOULDER, speed=2e-3, patience=0.3)
            rig.renew_session(restarts=renewed == "guard")
        assert rig.contacts({"part": -ERROR * DOWN}) == set()
        distance = Distance(nominal, PAIR)
        assert distance(start) - distance(rig.axes[-1]) < 0.8e-3


def cell_with(folder: Path, name: str, mesh: Mesh, *settings: str) -> CellDescription:
    """The default cell with `settings` and a fixed obstacle, a mesh in the world (m)."""
    file = export_mm(mesh, folder / f"{name}.stl")
    obstacle = f'cell.obstacle=[{{ name = "{name}", mesh = "{file}", pose = {{}} }}]'
    return load_setup(settings=[obstacle, *settings]).cell


def beside_finger(cell: CellDescription, gap: float, size: tuple[float, float, float]) -> tuple[Mesh, np.ndarray]:
    """A box `gap` (m) outside the first finger at home, across its stroke, and the direction to it in the world."""
    nominal = nominal_cell(cell, PART)
    poses = dict(zip((b.name for b in nominal.bodies), nominal.body_poses(nominal.home), strict=True))
    body = next(b for b in nominal.bodies if b.name == "finger1")
    outside = body.mesh.bounds[1][0] + gap + size[0] / 2
    middle = body.mesh.bounds.mean(0)
    placed = pose.translation((outside, middle[1], body.mesh.bounds[1][2]))
    return box_mesh(size).transformed(poses["finger1"] @ placed), poses["finger1"][:3, 0]


def towards(rig: GuardRig, direction: np.ndarray, length: float) -> None:
    """Straight moves of the sensor, 1 mm each; the guard may hold them."""
    for _ in range(round(length / 1e-3)):
        target = pose.translation(1e-3 * direction) @ rig.nominal.world_from_sensor(rig.now[:-1])
        rig.session.start_move_line(target, speed=0.02)
        if not rig.until_there(0.6):
            return


def test_opened_fingers_keep_away_from_a_wall(tmp_path: Path) -> None:
    """The fingers start closed, 35 mm in front of the wall, and open 20 mm each before the robot moves."""
    closed = "cell.gripper.start_mm=5.0"
    free = load_setup(settings=[*GRIPPER, closed]).cell
    wall, direction = beside_finger(free, 0.035, (0.01, 0.2, 0.03))
    cell = cell_with(tmp_path, "wall", wall, *GRIPPER, closed)
    with guard_rig(tmp_path, cell, PART, np.append(nominal_cell(cell, PART).home, 0.0)) as rig:
        rig.session.start_open_gripper(0.045)
        rig.cycles(60)
        assert rig.session.gripper_width == pytest.approx(0.045, abs=1e-3)
        towards(rig, direction, 0.025)
        assert rig.contacts() == set()


def test_closed_fingers_keep_away_from_a_post(tmp_path: Path) -> None:
    """The fingers start open above a thin post, close, and come down on it."""
    free = load_setup(settings=GRIPPER).cell
    nominal = nominal_cell(free, PART)
    assert nominal.flange_from_finger is not None
    middle, second = (nominal.arm.fk(nominal.home) @ one for one in nominal.flange_from_finger)
    tip = next(body.mesh.bounds[1][2] for body in nominal.bodies if body.name == "finger1")
    down = middle[:3, 2]
    centre = (middle[:3, 3] + second[:3, 3]) / 2
    placed = pose.from_rotation(middle[:3, :3], centre + (tip + 0.02 + 0.03) * down)
    post = box_mesh((0.006, 0.006, 0.06)).transformed(placed)
    cell = cell_with(tmp_path, "post", post, *GRIPPER)
    with guard_rig(tmp_path, cell, PART, np.append(nominal.home, 0.0)) as rig:
        rig.session.start_open_gripper(0.002)
        rig.cycles(60)
        assert rig.session.gripper_width < 0.005
        towards(rig, down, 0.03)
        assert not any("post" in pair for pair in rig.contacts())


def test_gripped_part_keeps_away_from_a_wall(tmp_path: Path) -> None:
    """A long bar between the fingers, lifted off the belt, reaches 40 mm farther than the gripper."""
    shipped, bar = assets_dir() / "cells" / "pick_and_place.toml", block(0.12, 0.03, 0.03)
    placed = ["cell.part.arrival.pose.x_mm=123.0", "cell.part.arrival.pose.rz_deg=-90.0"]
    centre, height = np.array([0.37, -0.312, 0.149]), 0.08
    wall = box_mesh((0.01, 0.05, 0.02)).transformed(pose.translation(centre + np.array([0.085, 0.0, height - 0.034])))
    file = export_mm(wall, tmp_path / "wall.stl")
    obstacle = f'cell.obstacle=[{{ name = "wall", mesh = "{file}", pose = {{}} }}]'
    cell = load_setup(shipped, settings=[*placed, obstacle]).cell
    nominal = nominal_cell(cell, bar)
    down = pose.from_rotation(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), centre)
    gripper = pose.inverse(flange_from_tool(nominal, "gripper"))
    branches = nominal.arm.ik(down @ gripper, nominal.home)[0]
    start = np.append(branches[np.nanargmin(np.abs(branches - nominal.home).max(-1))], 0.0)
    with guard_rig(tmp_path, cell, bar, start) as rig:
        rig.session.start_close_gripper(30.0)
        rig.cycles(50)
        lifted = pose.translation((0.0, 0.0, height)) @ rig.nominal.world_from_sensor(rig.now[:-1])
        rig.session.start_move_line(lifted, speed=0.3)
        assert rig.until_there(3.0)
        assert rig.session.cell.get_boolean("measured.gripper.gripped")
        towards(rig, np.array([1.0, 0.0, 0.0]), 0.035)
        assert ("part", "wall") not in rig.contacts()


def plate_and_post(folder: Path) -> tuple[CellDescription, Mesh]:
    """A part that extends beyond the table, and a post in its way at 0.5 rad of the table."""
    plate = joined(
        [
            box_mesh((0.32, 0.05, 0.006)).transformed(pose.translation((0.0, 0.0, 0.003))),
            box_mesh((0.004, 0.05, 0.1)).transformed(pose.translation((0.158, 0.0, 0.05))),
        ],
        "plate",
    )
    described = load_setup().cell
    placed = nominal_cell(described, plate).world_from("part", [0.0] * 6 + [0.5]) @ pose.translation((0.15, 0.0, 0.08))
    return cell_with(folder, "post", box_mesh((0.01, 0.01, 0.16)).transformed(placed)), plate


@pytest.mark.parametrize("motion", ["jog", "move", "program"])
def test_table_does_not_turn_a_part_into_a_post(motion: str, tmp_path: Path) -> None:
    cell, plate = plate_and_post(tmp_path)
    turn = np.eye(7)[6]
    with guard_rig(tmp_path, cell, plate, np.append(nominal_cell(cell, plate).home, 0.0)) as rig:
        if motion == "jog":
            rig.session.request_operation(Operation.MANUAL)
            rig.cycles(4)
            rig.session.start_jog_joints(turn)
            rig.cycles(150)
        elif motion == "move":
            rig.move(1.0 * turn, speed=0.1, patience=5.0)
        else:
            for _ in range(60):
                if not rig.run_program(0.01 * turn, points=61, patience=2.0):
                    break
        assert rig.contacts() == set()
        assert rig.axes[-1][-1] > 0.2  # it turns as far as it may


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_bodies_that_are_both_off_by_their_error_do_not_touch(share: float, tmp_path: Path) -> None:
    """A link near the base, where the errors of the angles add little, and a block in its way."""
    free = nominal_cell(load_setup().cell, PART)
    poses = dict(zip([body.name for body in free.bodies], free.body_poses(free.home), strict=True))
    points = pose.transform_points(poses["link1"], next(b.mesh.vertices for b in free.bodies if b.name == "link1"))
    foremost = points[np.argmax(np.hypot(points[:, 0], points[:, 1]))]
    ahead = pose.from_rotation(pose.rotation_about(2, -0.6)) @ pose.translation(foremost)
    cell = cell_with(tmp_path, "block", box_mesh((0.02, 0.02, 0.02)).transformed(ahead))
    nominal, turn = nominal_cell(cell, PART), -np.eye(7)[0]
    distance = Distance(nominal, ("link1", "block"))
    start = distance.reached(np.append(nominal.home, 0.0), turn, 3.5e-3)
    with guard_rig(tmp_path, cell, PART, start) as rig:
        rig.session.request_operation(Operation.MANUAL)
        rig.cycles(4)
        rig.session.start_jog_joints(share * turn)
        rig.cycles(round(0.08 / share / rig.session.cycle))
        nearer = ERROR * distance.direction(rig.axes[-1])
        assert rig.contacts({"link1": nearer, "block": -nearer}) == set()
        assert rig.stops == 0
        assert distance(rig.axes[-1]) < 5e-3  # the jog is slowed near the block, and not before


@pytest.mark.parametrize("after", [0, 1])
def test_jog_at_once_after_a_change_of_operation_is_slowed_and_not_stopped(after: int, tmp_path: Path) -> None:
    """The change and the jog are given in the same cycle, at any time between two polls."""
    cell = load_setup().cell
    start = above_part(nominal_cell(cell, PART), 0.03)
    with guard_rig(tmp_path, cell, PART, start) as rig:
        rig.cycles(20 + after)
        rig.session.request_operation(Operation.MANUAL)
        rig.session.start_jog_sensor([0.0, 0.0, -0.3, 0.0, 0.0, 0.0])
        rig.cycles(200)
        assert rig.stops == 0
        assert rig.contacts() == set()
        assert Distance(rig.nominal, PAIR)(rig.axes[-1]) < 8e-3


@pytest.mark.parametrize(
    ("error", "scenario"),
    [
        ("unchecked-short-motions", partial(test_short_motions_do_not_creep_into_contact, two_set_points)),
        ("start-width", test_opened_fingers_keep_away_from_a_wall),
        ("start-width", test_closed_fingers_keep_away_from_a_post),
        ("forgotten-distance", partial(test_new_sessions_and_guards_do_not_permit_further_approaches, "session", 1)),
    ],
)
def test_guards_with_deliberate_errors_let_bodies_collide(
    error: str, scenario: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scancell.scanning.session.Guard", MUTATIONS[error].guard)
    with pytest.raises(AssertionError) as failure:
        scenario(tmp_path)
    assert "rig.contacts(" in str(failure.traceback[-1].statement)
