"""Random starts and motions of the guard's campaign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import block

from scancell.config.loading import assets_dir, load_setup
from scancell.geometry.mesh import decimated
from scancell.nominal.cell import nominal_cell
from scancell.scanning.session import settings_of
from scancell.studies.guard.draws import BLOCK, KINDS, LENGTHS, MIXED, Draw, Draws, stratum_of
from scancell.studies.guard.scenario import JOGGED, Kind
from scancell.studies.guard.simulation import MotionRecord, Simulation, shifted
from scancell.studies.guard.worlds import World, described_cells, standing_parts, world_of

CYCLE = 0.016


@pytest.fixture(scope="module")
def world() -> World:
    """The default cell with simple meshes."""
    cell = load_setup().cell
    nominal = nominal_cell(cell, block(0.06, 0.06, 0.05))
    bodies = tuple(replace(body, mesh=decimated(body.mesh, 100)) for body in nominal.bodies)
    return World(cell, replace(nominal, bodies=bodies), settings_of(cell))


@pytest.fixture(scope="module")
def drawn(world: World) -> list[tuple[int, Draw]]:
    draws = Draws(world, CYCLE)
    return [(k, draws.draw(stratum_of(k), np.random.default_rng([1, k]))) for k in range(0, BLOCK, 3)]


def test_starts_are_inside_the_limits_and_free_of_contact(world: World, drawn: list[tuple[int, Draw]]) -> None:
    lower, upper = world.nominal.arm.limits
    for number, draw in drawn:
        start = draw.scenario.start
        assert (np.minimum(start[:-1] - lower, upper - start[:-1]) > 0.01).all()
        poses = shifted(world.nominal.body_poses(start[None]), draw.shifts)
        distances = world.scene.distances(poses, 1.0, 1)[0]
        assert distances.min() > 0.2e-3
        if stratum_of(number).near:
            assert 0.4e-3 < draw.gap < 25e-3
            names = [set(pair) for pair in world.pairs]
            assert distances[names.index(set(draw.pair))] == pytest.approx(draw.gap, abs=1e-6)


def test_bodies_are_off_by_their_stated_error_towards_each_other(world: World, drawn: list[tuple[int, Draw]]) -> None:
    error = world.settings.position_error
    nearer = []
    for _, draw in drawn:
        sizes = np.linalg.norm(draw.shifts, axis=1)
        assert (sizes <= error).all()
        if draw.pair and sizes.any():
            start = draw.scenario.start
            poses = world.nominal.body_poses(start[None])
            bound = np.where([set(pair) == set(draw.pair) for pair in world.pairs], np.inf, 0.0)
            true, nominal = (world.scene.distances(one, bound, 1)[0] for one in (shifted(poses, draw.shifts), poses))
            nearer.append((nominal - true)[np.isinf(bound)][0])
    assert max(nearer) == pytest.approx(2 * error, rel=0.02)


def test_motions_have_the_kind_and_length_of_their_stratum(drawn: list[tuple[int, Draw]]) -> None:
    for number, draw in drawn:
        stratum = stratum_of(number)
        for motion in draw.scenario.motions:
            if stratum.kind != MIXED:
                assert motion.kind == stratum.kind
                assert motion.length <= 1e-5 * 10 ** (stratum.length + 1) * (3.0 if stratum.length == 4 else 1.0)
            assert motion.kind not in JOGGED or np.abs(motion.by).max() <= motion.speed + 1e-9


def test_strata_have_equal_counts_of_kinds_lengths_and_speeds() -> None:
    strata = [stratum_of(number) for number in range(5 * BLOCK)]
    pure = [one for one in strata if one.kind != MIXED]
    keys = [(one.kind, one.decade, one.length) for one in pure]
    kinds = len(set(KINDS) - {MIXED})
    assert len(set(keys)) == len(keys) == kinds * 3 * len(LENGTHS)
    assert len(strata) - len(pure) == 5 * 3 * (len(KINDS) - kinds)
    assert 0.5 < np.mean([one.near for one in strata]) < 0.7
    assert np.mean([stratum_of(number).silent for number in range(0, 80 * BLOCK, BLOCK)]) == pytest.approx(1 / 8)


def test_speeds_and_lengths_are_within_their_decades() -> None:
    rng = np.random.default_rng(0)
    for number in range(0, BLOCK, 3):
        stratum = stratum_of(number)
        speeds = np.log10([stratum.random_speed(rng) for _ in range(50)])
        assert ((speeds >= -3 + stratum.decade) & (speeds <= -2 + stratum.decade)).all()
        lengths = np.log10([stratum.random_length(rng) for _ in range(200)])
        if stratum.kind == MIXED:
            assert lengths.min() < -4.8
            assert lengths.max() > 0.2
        else:
            assert ((lengths >= -5 + stratum.length) & (lengths <= max(-4 + stratum.length, 0.5))).all()


def test_judged_pairs_hold_what_turns_with_the_table_and_what_does_not() -> None:
    """The judge has a list of its own: not one of the product's scene."""
    cells, parts = described_cells(None), standing_parts()
    found = [world_of(cells["default"], parts["plate"], "plate", np.random.default_rng(seed)) for seed in range(6)]
    with_post = next(world for world in found if "fixed_post" in world.names)
    pairs = {frozenset(pair) for pair in with_post.pairs}
    assert {frozenset(pair) for pair in (("part", "fixed_post"), ("sensor", "part"), ("link1", "link3"))} <= pairs
    assert not pairs & {frozenset(pair) for pair in (("table", "part"), ("link1", "link2"), ("table", "table_base"))}


@pytest.fixture(scope="module")
def gripping() -> World:
    cell = described_cells(None)["pick_and_place"]
    worlds = (world_of(cell, block(0.03, 0.03, 0.03), "block", np.random.default_rng(seed)) for seed in range(40))
    return next(world for world in worlds if world.grips)


def test_part_is_displaced_by_what_it_moves_after_the_gripper_has_closed_or_opened(gripping: World) -> None:
    times = np.arange(0.0, 2.2, 0.004)
    moved = np.interp(times, [0.6, 0.7, 1.0, 1.2, 1.8, 1.9], [0.0, 2e-3, 2e-3, 7e-3, 7e-3, 1e-2])
    with Simulation(gripping) as simulation:
        frames = np.zeros((len(times), 3, 7))  # two fingers and the part
        frames[..., 3] = 1.0
        frames[..., 0] = moved[:, None]
        axes = np.tile(gripping.start, (len(times), 1))
        gripped = (times > 0.1) & (times < 1.0)
        record = MotionRecord(times, axes, frames, (), (), (), None, None, None, 0, 0, gripped)
        found = [simulation.displacement(record, time) for time in (0.5, 0.75, 1.5, 2.0)]
    np.testing.assert_allclose(found, [0.0, 2e-3, 0.0, 3e-3], atol=1e-9)


def test_fingers_are_around_the_part_of_a_gripping_robot(gripping: World) -> None:
    world = gripping
    carrying = world.carrying(held=False)
    names, poses = world.names, carrying.body_poses(world.start)
    centres = [
        pose[:3, :3] @ body.mesh.bounds.mean(0) + pose[:3, 3] for body, pose in zip(carrying.bodies, poses, strict=True)
    ]
    part, one, other = (centres[names.index(name)] for name in ("part", "finger1", "finger2"))
    np.testing.assert_allclose(((one + other) / 2)[:2], part[:2], atol=1e-3)
    assert one[2] - part[2] < 0.03


@pytest.mark.parametrize("cell", ["track", "tilt_turn"])
def test_axes_beyond_the_table_start_at_both_ends_and_move_in_all_kinds_of_motions(cell: str) -> None:
    """They are jogged and moved alone half as often as all axes beyond the joints, and together with the joints."""
    described = described_cells(str(assets_dir() / "cells" / f"{cell}.toml"))[cell]
    world = world_of(described, standing_parts()["post"], "post", np.random.default_rng(3))
    draws, (axis,) = Draws(world, CYCLE), world.nominal.further_axes
    rng = np.random.default_rng(4)
    starts = np.array([draws.anywhere(rng)[-1] for _ in range(200)])
    assert ((starts >= axis.min) & (starts <= axis.max)).all()
    assert min((starts < axis.min + 1e-4).sum(), (starts > axis.max - 1e-4).sum()) >= 25
    assert np.abs(starts[(starts > axis.min + 1e-3) & (starts < axis.max - 1e-3)]).min() < 0.2 * axis.max
    alone = []
    for kind in set(KINDS) - {MIXED}:
        for _ in range(20):
            along = draws.along(np.zeros(8), rng)
            motion = draws.motion(Kind(kind), along, 0.01, 0.5, world.nominal.start, rng)
            if kind in (Kind.TABLE_MOVE, Kind.TABLE_JOG):
                assert np.count_nonzero(motion.by) == 1
                alone.append(motion.by[-1] != 0)
                assert (motion.kind in (Kind.AXIS_MOVE, Kind.AXIS_JOG)) == alone[-1]
            elif kind not in (Kind.BASE_JOG, Kind.TOOL_JOG):
                assert (motion.by[-1] != 0) == (along[-1] != 0)
    assert 8 <= sum(alone) <= 32
