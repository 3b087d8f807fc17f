"""Continuous collision check of joint motions: bounds on the motion, thin obstacles, brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scancell.config.loading import load_setup
from scancell.config.material import Material
from scancell.geometry.mesh import Mesh, box_mesh
from scancell.geometry.pose import transform_points, translation
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import Body
from scancell.proximity.motion_check import Budget, MotionBounds, MotionCheck
from scancell.proximity.scene import ProximityScene, cell_scene

BLOCK = box_mesh((0.06, 0.04, 0.05)).transformed(translation((0.02, 0.0, 0.025)))


def small_box(mesh: Mesh) -> Mesh:
    """A box of half the size of the mesh, so that neighbouring links do not overlap."""
    lower, upper = mesh.bounds
    return box_mesh(tuple((upper - lower) / 2)).transformed(translation((lower + upper) / 2))


@pytest.fixture(scope="module")
def cell() -> NominalCell:
    """The default cell with a box in place of each body, so that brute force is cheap."""
    nominal = nominal_cell(load_setup().cell, BLOCK)
    return replace(nominal, bodies=tuple(replace(b, mesh=small_box(b.mesh)) for b in nominal.bodies))


def scene_of(cell: NominalCell) -> ProximityScene:
    return cell_scene(cell, {body.name: body.mesh for body in cell.bodies})


def random_motions(cell: NominalCell, count: int, travel: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Ends (count, 7) of motions in which every axis moves by at most `travel`, rad."""
    rng = np.random.default_rng(seed)
    lower, upper = cell.arm.limits
    start = np.column_stack([rng.uniform(lower, upper, (count, 6)), rng.uniform(-np.pi, np.pi, count)])
    return start, start + rng.uniform(-travel, travel, (count, 7))


def with_body(cell: NominalCell, name: str, mesh) -> NominalCell:
    return replace(cell, bodies=(*cell.bodies, Body(name, "world", mesh, Material(0.5))))


def test_distances_change_by_no_more_than_the_motion_bound(cell):
    scene = scene_of(cell)
    start, end = random_motions(cell, 20, 0.6, 1)
    middle, half = (start + end) / 2, np.abs(end - start) / 2
    bound = MotionBounds(cell, scene.pairs).pairs(middle, half)
    before = scene.distances(cell.body_poses(middle), np.inf)
    largest = np.zeros_like(bound)
    for fraction in np.linspace(0, 1, 9):
        at = start + fraction * (end - start)
        change = np.abs(scene.distances(cell.body_poses(at), np.inf) - before)
        largest = np.maximum(largest, change)
    assert (largest <= bound + 1e-12).all()
    moving = bound > 0
    assert np.median(largest[moving] / bound[moving]) > 0.1  # not true only because the bound is huge


def test_bound_of_a_straight_motion_holds_and_is_tighter(cell):
    """Joints that move together cancel each other; slack is on top."""
    scene = scene_of(cell)
    start, end = random_motions(cell, 20, 0.3, 4)
    middle, half, slack = (start + end) / 2, (end - start) / 2, np.full(7, 0.01)
    bounds = MotionBounds(cell, scene.pairs)
    straight, summed = bounds.straight(middle, half, slack), bounds.pairs(middle, np.abs(half) + slack)
    assert (straight <= summed + 1e-12).all()
    moving = summed > 0
    assert np.median(straight[moving] / summed[moving]) < 0.97
    before = scene.distances(cell.body_poses(middle), np.inf)
    rng = np.random.default_rng(5)
    for fraction in np.linspace(-1, 1, 9):
        at = middle + fraction * half + rng.choice([-1, 1], half.shape) * slack
        change = np.abs(scene.distances(cell.body_poses(at), np.inf) - before)
        assert (change <= straight + 1e-12).all()


def test_violations_of_a_way_match_those_of_its_motions(cell):
    """Pair by pair; the first of them begins in the part in which fine sampling finds it, or just before."""
    scene = scene_of(cell)
    check = MotionCheck(cell, scene, 0.01)
    start, end = random_motions(cell, 60, 0.5, 6)
    counts = {True: 0, False: 0}
    for a, b in zip(start, end, strict=True):
        way = np.linspace(a, b, 5)
        violated, first = check.violations(way[:-1], way[1:]), check.first_violations(way[:-1], way[1:], 8)
        fine = np.linspace(a, b, 4 * 8 * 20 + 1)
        nearest = scene.distances(cell.body_poses(fine), 0.05)
        assert violated[nearest.min(0) < 0.01].all()
        assert (nearest.min(0)[violated] < 0.011).all()
        assert np.isfinite(first).any() == violated.any()
        counts[bool(violated.any())] += 1
        if violated.any():
            part = round(first.min() * 8)
            assert (nearest[: part * 20] >= 0.01).all()
            assert nearest[part * 20 : (part + 1) * 20 + 1].min() < 0.011
    assert min(counts.values()) > 5


def test_motion_along_a_wall_is_proved_with_little_work(cell):
    """A slab below the sensor, which joint 1 moves along it: work does not grow as the room beyond the clearance falls.

    The slab is proved for what is just nearer than the true distance, and not for what is farther.
    """
    slab = with_body(cell, "slab", box_mesh((4.0, 4.0, 0.01)))
    scene = ProximityScene({body.name: body.mesh for body in slab.bodies}, [("sensor", "slab")])
    start, end = np.append(cell.home, 0.0), np.append(cell.home, 0.0)
    start[0], end[0] = -0.4, 0.4
    distance = scene.distances(slab.body_poses(start[None]), np.inf)[0, 0]
    works = []
    for room in (1e-2, 1e-4, 1e-6):
        budget = Budget(100_000)
        assert not MotionCheck(slab, scene, distance - room).violations(start[None], end[None], budget=budget).any()
        works.append(100_000 - budget.left)
        assert MotionCheck(slab, scene, distance + room).violations(start[None], end[None]).all()
    assert max(works) < 20 * min(works)


def test_unused_shares_of_a_budget_go_to_the_others():
    whole = Budget(100)
    first = whole.share(4)
    assert first.left == 25
    first.spend(5)
    assert (first.left, whole.left) == (20, 95)
    assert whole.share(3).left == 31


def test_used_up_budget_proves_nothing(cell):
    scene = scene_of(cell)
    check = MotionCheck(cell, scene, 0.0)
    way = np.linspace(*(np.append(cell.home + 0.01 * k, 0.0) for k in (0, 1)), 3)
    assert not check.violations(way[:-1], way[1:]).any()
    assert check.violations(way[:-1], way[1:], budget=Budget(0)).all()
    assert (check.first_violations(way[:-1], way[1:], 4, budget=Budget(0)) == 0).any()
    budget = Budget(10)
    assert check.violations(way[:-1], way[1:], budget=budget).any()
    assert budget.left <= 0


@pytest.mark.parametrize("clearance", [0.0, 0.01])
def test_verdicts_match_fine_sampling(cell, clearance):
    scene = scene_of(cell)
    start, end = random_motions(cell, 200, 0.5, 2)
    clashes = MotionCheck(cell, scene, clearance).first_clashes(start, end)
    verdicts = {True: 0, False: 0}
    for i, clash in enumerate(clashes):
        steps = int(np.ceil(np.abs(end[i] - start[i]).max() / np.radians(0.05))) + 1
        path = np.linspace(start[i], end[i], steps)
        sampled = scene.distances(cell.body_poses(path), max(clearance, 1e-3))
        nearest = sampled.min()
        verdicts[clash is None] += 1
        if clash is None:
            assert nearest >= clearance
            assert clearance > 0 or nearest > 0
        else:
            assert clash.index == i
            assert nearest <= clearance + 1e-3
            at = start[i] + clash.fraction * (end[i] - start[i])
            pair = scene.pairs.index((clash.body_a, clash.body_b))
            there = scene.distances(cell.body_poses(at[None]), 0.05)[0, pair]
            assert there == pytest.approx(clash.distance, abs=1e-9)
    assert min(verdicts.values()) > 5


def test_thin_obstacle_between_samples_is_found(cell):
    """A foil of 0.5 mm across the path of the sensor: the ends of the motion, and coarse samples, are free."""
    home = np.append(cell.home, 0.0)
    away = home.copy()
    away[0] += np.radians(40)
    between = cell.world_from_sensor(((home + away) / 2)[:6])[:3, 3]
    direction = np.arctan2(between[1], between[0])
    foil = box_mesh((0.3, 0.0005, 0.3)).transformed(
        translation(between) @ np.block([[rotation(direction), np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]])
    )
    blocked = with_body(cell, "foil", foil)
    scene = scene_of(blocked)
    (clash,) = MotionCheck(blocked, scene, 0.0).first_clashes(home, away)
    assert clash is not None
    assert "foil" in (clash.body_a, clash.body_b)
    free = MotionCheck(cell, scene_of(cell), 0.0).first_clashes(home, away)
    assert free == [None]


def rotation(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def test_table_turns_its_part_into_an_obstacle(cell):
    """A pin beside the table, in reach of the block's corner only at some table angles."""
    part = next(body.mesh for body in cell.bodies if body.name == "part")
    on_table = transform_points(cell.table_from_part, part.vertices)
    corner = np.linalg.norm(on_table[:, :2], axis=1).max()
    pin = box_mesh((0.0005, 0.0005, 0.02)).transformed(
        translation(cell.world_from_table[:3, 3] + np.array([0.0, corner - 0.001, 0.02]))
    )
    blocked = with_body(cell, "pin", pin)
    scene = ProximityScene({body.name: body.mesh for body in blocked.bodies}, [("part", "pin")])
    start, end = np.append(cell.home, np.radians(-20)), np.append(cell.home, np.radians(200))
    (clash,) = MotionCheck(blocked, scene, 0.0).first_clashes(start, end)
    assert clash is not None
    angles = np.radians(np.arange(-20, 200, 0.05))
    hit = scene.native.collisions(
        blocked.body_poses(np.column_stack([np.broadcast_to(cell.home, (len(angles), 6)), angles]))
    )[:, 0]
    free = angles[: int(np.argmax(hit))]
    (clear,) = MotionCheck(blocked, scene, 0.0).first_clashes(start, np.append(cell.home, free[-2]))
    assert clear is None


def test_clearance_per_pair_and_deviation(cell):
    """A motion that keeps 10 mm is refused when it may deviate by as much as brings the bodies nearer."""
    scene = scene_of(cell)
    start, end = random_motions(cell, 60, 0.2, 3)
    plain = MotionCheck(cell, scene, 0.01).first_clashes(start, end)
    deviating = MotionCheck(cell, scene, 0.01).first_clashes(start, end, deviation=0.02)
    assert all(b is not None for a, b in zip(plain, deviating, strict=True) if a is not None)
    assert sum(b is not None for b in deviating) > sum(a is not None for a in plain)
    only = np.where([pair == ("sensor", "part") for pair in scene.pairs], 0.01, 0.0)
    assert sum(c is not None for c in MotionCheck(cell, scene, only).first_clashes(start, end)) <= sum(
        c is not None for c in plain
    )


def test_clash_names_the_pair_that_lacks_most(cell):
    """Of pairs with clearances of 10 to 200 mm, in motions so short that no pair is judged by its spheres alone."""
    scene = scene_of(cell)
    start, end = random_motions(cell, 100, 0.005, 4)
    clearance = np.random.default_rng(5).uniform(0.01, 0.2, len(scene.pairs))
    several = 0
    for clash in MotionCheck(cell, scene, clearance).first_clashes(start, end):
        if clash is None:
            continue
        at = start[clash.index] + clash.fraction * (end[clash.index] - start[clash.index])
        lack = scene.distances(cell.body_poses(at[None]), 0.25)[0] - clearance
        pair = scene.pairs.index((clash.body_a, clash.body_b))
        assert lack[pair] == pytest.approx(lack.min(), abs=1e-9)
        several += int(np.count_nonzero(lack < -1e-6) > 1)
    assert several > 10


def test_pairs_of_no_clearance_are_not_checked(cell):
    """Without the pairs that clash, the same motions are free; a clearance per motion replaces the common one."""
    scene = scene_of(cell)
    start, end = random_motions(cell, 200, 0.5, 2)
    check = MotionCheck(cell, scene, 0.01)
    clashes = check.first_clashes(start, end)
    assert 5 < sum(clash is not None for clash in clashes) < 195
    assert check.first_clashes(start, end, clearance=np.full(len(scene.pairs), -np.inf)) == [None] * 200
    only_last = np.full((200, len(scene.pairs)), -np.inf)
    only_last[100:] = 0.01
    part = check.first_clashes(start, end, clearance=only_last)
    assert part[:100] == [None] * 100
    assert [clash and clash.fraction for clash in part[100:]] == [clash and clash.fraction for clash in clashes[100:]]


def test_motion_without_travel_is_a_static_check(cell):
    home = np.append(cell.home, 0.0)
    assert MotionCheck(cell, scene_of(cell), 0.001).first_clashes(home, home) == [None]


@pytest.mark.parametrize(("argument", "value"), [("clearance", np.nan), ("deviation", np.nan), ("deviation", -1e-9)])
def test_clearances_and_deviations_that_prove_nothing_are_rejected(cell, argument, value):
    check = MotionCheck(cell, scene_of(cell), 0.0)
    path = np.linspace(*(np.append(cell.home + 0.01 * k, 0.0) for k in (0, 1)), 3)
    for function, motions in (
        (check.violations, (path[:-1], path[1:])),
        (check.first_clashes, (path[:-1], path[1:])),
        (check.first_violations, (path[:-1], path[1:], 4)),
    ):
        with pytest.raises(ValueError, match=r"expected (finite )?(angles|clearances)"):
            function(*motions, **{argument: value})
