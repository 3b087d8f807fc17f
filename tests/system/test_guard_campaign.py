"""A small campaign of a guarded cell: no collisions, few false stops; campaigns go on where they were stopped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from commands import PARTS, scancell_here

from bench.guard_search.mutations import MUTATIONS
from bench.guard_search.outcomes import IGNORED, TABLE, search
from scancell.cell.controller import JogFrame, Mode, Operation
from scancell.config.channel import LinkDescription
from scancell.errors import DescriptionError
from scancell.geometry.mesh import load_mesh
from scancell.geometry.reduction import protrusion_bound
from scancell.guard.tool import Tool
from scancell.proximity.scene import arm_chain
from scancell.studies.guard.campaign import Campaign, RunRow, stated_distance
from scancell.studies.guard.jogs import program_points
from scancell.studies.guard.run import CampaignOptions, RowFile, run_campaign, summary, tables
from scancell.studies.guard.scenario import Command, Scenario
from scancell.studies.guard.simulation import GuardedRuns, Simulation
from scancell.studies.guard.strata import BLOCK, DECADES, FAULTS, THIRDS, stratum_of
from scancell.studies.guard.worlds import KnownWorld, described_cells, known_world, standing_parts, true_world

OPTIONS = CampaignOptions(None, str(PARTS / "free_form.stl"))
OF_TABLE = replace(OPTIONS, seed=4)  # whose first jog of the table soon collides
# Errors that take few runs to find.
QUICK = {"stale-answers": OPTIONS, "begun-is-permitted": OPTIONS, "no-table-rate": OF_TABLE}


@pytest.fixture(scope="module")
def campaign() -> Iterator[Campaign]:
    """All shipped cells, each with a plate that sticks out of the table."""
    with Campaign(described_cells(None), {"plate": standing_parts()["plate"]}, 1) as made:
        yield made


@pytest.fixture(scope="module")
def known() -> KnownWorld:
    return known_world(described_cells(None)["default"], load_mesh(PARTS / "machined.stl", "mm"))


@pytest.mark.slow
@pytest.mark.parametrize("block", range(len(FAULTS)))
def test_guarded_robots_do_not_collide(campaign: Campaign, block: int) -> None:
    """A fault of the network: a run in each decade of speed, by hand or automatic, in turn from fault to fault."""
    runs = [(decade, (block + decade) % 2) for decade in range(len(DECADES))]
    numbers = [BLOCK * block + 6 * decade + 3 * kind + (block + decade + kind) % 3 for decade, kind in runs]
    rows = [campaign.run(number) for number in numbers]
    assert {row.decade for row in rows} == set(DECADES)
    assert {row.operation for row in rows} == {"manual", "automatic"}
    assert {row.fault for row in rows} == {list(FAULTS)[block]}
    assert [row for row in rows if row.collided] == []
    assert [row for row in rows if row.false_stop] == []
    for row in rows:
        assert bool(row.twin_contact) == (row.third == THIRDS[0])
        assert (row.twin_clearance < 0.05) == (row.third == THIRDS[1]) or row.third == THIRDS[0]
        # The guard is needed: those whose twins collide are stopped, or wait in front of the contact.
        assert row.stop or row.halted or row.third != THIRDS[0]


@pytest.mark.parametrize(
    ("cell", "start_deg", "jog"),
    [
        ("default", None, (0, 0, 1, 0, 0, 0, 0)),
        ("seven_axis", (37, -20.5, 0, -108.9, 24.2, -31.5, 30.5, -90), (0.96, 0.96, -0.96, -0.96, -0.96, -0.96, 0, 0)),
        (
            "seven_axis",
            (-39.6, -15.1, 0, -87.1, -37.7, -40.9, -30.7, -130),
            (0.16, 0.16, 0.16, 0.16, -0.16, -0.16, 0, 0),
        ),
    ],
)
def test_jog_into_a_singular_position_is_slowed_and_not_stopped_by_the_guard(
    cell: str, start_deg: tuple[float, ...] | None, jog: tuple[float, ...]
) -> None:
    """The links of the wrist turn fast there, a few millimetres from each other, but never nearer."""
    known = known_world(described_cells(None)[cell], load_mesh(PARTS / "free_form.stl", "mm"))
    tool = Command(0.1, Mode.CARTESIAN_JOG, np.array(jog), JogFrame.SENSOR)
    start = np.append(known.nominal.home, 0.0) if start_deg is None else np.radians(start_deg)
    scenario = Scenario(Operation.MANUAL, start, (tool,), 4.0)
    with Simulation(known.described, known.nominal, known.ignored) as simulation:
        guarded = GuardedRuns(simulation, known.guard())
        course = guarded.run(scenario, LinkDescription())
        axes = course.axes[:, :-1]
    least = np.linalg.svd(Tool(known.nominal).poses(axes[::20])[1], compute_uv=False)[:, -1]
    assert least.min() < 0.5 * least[0]
    assert course.stopped_at is None
    assert min(decision.monitor_speed for _, decision in guarded.log) < 0.9


def test_strata_have_equal_counts() -> None:
    strata = [stratum_of(number) for number in range(BLOCK * len(FAULTS))]
    keys = [(one.third, one.operation, one.decade, one.fault) for one in strata]
    assert len(set(keys)) == len(keys) == 180
    assert np.mean([stratum_of(number).silent for number in range(1440)]) == pytest.approx(1 / 8)


@pytest.mark.parametrize("decade", range(len(DECADES)))
def test_speeds_are_within_their_decade(decade: int) -> None:
    rng = np.random.default_rng(0)
    stratum = replace(stratum_of(0), decade=decade)
    speeds = np.log10([stratum.random_speed(rng) for _ in range(200)])
    assert -3 + decade <= speeds.min() < -2.9 + decade
    assert -2.1 + decade < speeds.max() <= -2 + decade


def test_a_run_follows_from_its_number(campaign: Campaign) -> None:
    first, other = campaign.run(3), campaign.run(4)
    assert asdict(campaign.run(3)) == pytest.approx(asdict(first), nan_ok=True)
    assert first.third != other.third


def test_true_bodies_are_off_by_no_more_than_the_guard_assumes(known: KnownWorld) -> None:
    names = [body.name for body in known.nominal.bodies]
    chain = [names.index(name) for name in arm_chain(known.nominal)]
    largest = []
    for seed in range(8):
        world = true_world(known, np.random.default_rng(seed))
        if world is known.nominal:
            continue
        shifts = []
        for true in world.bodies:
            found = known.meshes[true.name]
            outwards = true.mesh.vertices - found.mesh.vertices
            shifts.append(np.linalg.norm(outwards.mean(0)) if found.error == 0.0 else 0.0)
            beyond = protrusion_bound(true.mesh, found.mesh, 1e-5)
            assert beyond <= found.error + known.settings.position_error + 2e-5
            largest.append(beyond - found.error)
        assert max(shifts) <= known.settings.position_error + 1e-9
        assert np.max(np.array(shifts)[chain]) <= known.settings.position_error / 2 + 1e-9
    assert max(largest) > 0.5 * known.settings.position_error


def test_programs_pass_their_points_within_the_limits(known: KnownWorld) -> None:
    nominal, cycle = known.nominal, 0.016
    start = np.append(nominal.home, 0.0)
    through = [start, start + 0.3, start - 0.2]
    for speed in (0.01, 1.0):  # the slower one takes less than the longest time of a program
        points = program_points(nominal, through, speed, cycle)
        rates = np.diff(points, axis=0) / cycle
        for point in through:
            assert np.abs(points - point).max(1).min() <= np.abs(np.diff(points, axis=0)).max()
        assert (np.abs(rates) <= speed * nominal.axis_max_speed).all()
        assert (np.abs(np.diff(rates, axis=0) / cycle) <= nominal.axis_max_acceleration).all()


def test_stated_distances_grow_with_the_speed() -> None:
    speeds = np.linspace(0.0, 0.5, 101)
    shown, silent = ([stated_distance(speed, silent) for speed in speeds] for silent in (False, True))
    assert (np.diff(silent) >= 0.0).all()
    assert (np.array(shown) <= silent).all()
    assert stated_distance(0.25, silent=False) == pytest.approx(0.005)
    assert stated_distance(0.25, silent=True) == pytest.approx(0.072)


def row_of(number: int, **values: object) -> RunRow:
    given = {
        "number": number, "third": "ordinary", "operation": "manual", "decade": DECADES[0], "fault": "none",
        "cell": "default", "part": "plate", "silent": False, "draws": 1, "speed": 0.005, "motion": "joint_jog",
        "twin_contact_at": float("nan"), "twin_contact": "", "twin_clearance": 0.06, "contact": "", "touched": False,
        "clearance": 0.05, "stop": "", "stop_at": float("nan"), "stopped_pair": "", "false_stop": False,
        "halted": False, "warnings": 0, "warned_retreating": 0, "twin_arrived_at": 2.0, "arrived_at": 2.1,
    }  # fmt: skip
    return RunRow(**{**given, **values})  # type: ignore[arg-type]


def test_rows_survive_an_interrupt(tmp_path: Path) -> None:
    """A line that was cut short is dropped, and its run done again."""
    path = tmp_path / "rows.csv"
    file = RowFile(path)
    file.append(row_of(0, stop="guard", stopped_pair="sensor - table"))
    file.append(row_of(1))
    text = path.read_text()
    path.write_text(text[:-20])
    again = RowFile(path)
    assert [row.number for row in again.rows] == [0]
    assert again.rows[0].stopped_pair == "sensor - table"
    path.write_text("number,third\n0,ordinary\n")
    with pytest.raises(DescriptionError, match="columns"):
        RowFile(path)


def test_summary_counts_collisions_and_false_stops_by_decade() -> None:
    rows = [
        row_of(0, third="collision", contact="sensor - table"),
        row_of(1, third="collision", touched=True, twin_contact="sensor - part"),
        row_of(2, decade=DECADES[2], stop="guard", false_stop=True),
        row_of(3, decade=DECADES[2], stop="refused"),
    ]
    figures = summary(rows)
    assert figures["collisions_by_decade"] == {DECADES[0]: 2, DECADES[1]: 0, DECADES[2]: 0}
    assert figures["probability_bound"] is None
    assert figures["false_stops"] == {DECADES[0]: 0.0, DECADES[1]: None, DECADES[2]: 0.5}
    assert figures["cycle_time_loss_median"] == pytest.approx(0.05)
    assert summary(rows[2:])["probability_bound"] == pytest.approx(1 - 0.05**0.5)
    header, _, slow, fast, *_ = tables(rows)
    assert header.startswith("| speed | runs | twins collided | collisions | stopped by the guard | refused | false |")
    assert slow.startswith(f"| {DECADES[0]} | 2 | 1 | 2 | 0 | 0 | 0 |")
    assert fast.startswith(f"| {DECADES[2]} | 2 | 0 | 0 | 1 | 1 | 1 |")


def test_a_folder_of_another_campaign_is_refused(tmp_path: Path) -> None:
    done = scancell_here("guard", "check", PARTS / "free_form.stl", "--runs", "1", "--out", "here", cwd=tmp_path)
    assert done.code == 0
    other = CampaignOptions(None, str(PARTS / "machined.stl"))
    with pytest.raises(DescriptionError, match="another campaign"):
        run_campaign(other, 1, tmp_path / "here", workers=1)


@pytest.mark.slow
def test_the_guard_holds_at_the_limits_of_its_assumptions() -> None:
    """Steered runs by hand in a cell that brakes as late and as weakly as the guard assumes."""
    found = search(OPTIONS, 7)
    assert (found.runs, found.contact) == (7, "")
    assert found.clearance is not None
    assert found.clearance < 6e-3  # the search gets near


@pytest.mark.slow
@pytest.mark.parametrize("error", QUICK)
def test_a_search_finds_what_is_wrong_with_a_guard(error: str) -> None:
    assert search(QUICK[error], 40, error).contact


@pytest.mark.slow
def test_jogs_of_the_table_are_stopped_at_the_limits() -> None:
    found = search(OF_TABLE, 1, TABLE)
    assert (found.runs, found.contact) == (1, "")


@pytest.mark.slow
def test_moves_to_the_contact_of_a_pair_are_stopped_unless_it_is_ignored() -> None:
    pair = ("sensor", "table")
    guarded, ignored = search(OPTIONS, 1, "", pair), search(OPTIONS, 3, IGNORED, pair)
    assert (guarded.runs, guarded.contact) == (1, "")
    assert ignored.contact == " - ".join(pair)


def test_unknown_errors_of_a_guard_are_refused() -> None:
    with pytest.raises(DescriptionError, match=f"expected one of {', '.join(MUTATIONS)}"):
        search(OPTIONS, 1, "none-such")
