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
from scancell.errors import DescriptionError
from scancell.geometry.mesh import load_mesh
from scancell.guard.parts import Tool
from scancell.nominal.cell import nominal_cell
from scancell.scanning.session import settings_of
from scancell.studies.guard.campaign import Campaign, RunRow, stated_distance
from scancell.studies.guard.draws import BLOCK, DECADES, FAULTS, KINDS, LENGTHS
from scancell.studies.guard.run import CampaignOptions, RowFile, run_campaign, summary, tables
from scancell.studies.guard.scenario import Kind, Motion, Scenario
from scancell.studies.guard.simulation import Network, Simulation
from scancell.studies.guard.worlds import World, described_cells, standing_parts

OPTIONS = CampaignOptions(None, str(PARTS / "free_form.stl"))
OF_TABLE = replace(OPTIONS, seed=4)  # whose first jog of the table soon collides
# Errors that take few runs to find.
TILT = replace(OPTIONS, cell=str(PARTS.parent / "cells/tilt_turn.toml"))
HELD = replace(OPTIONS, cell=str(PARTS.parent / "cells/held_part.toml"))
QUICK = {
    "stale-answers": OPTIONS,
    "begun-is-permitted": OPTIONS,
    "no-table-rate": OF_TABLE,
    "no-axis-rate": TILT,
    "no-axis-path": TILT,
    "no-part": HELD,
}


@pytest.fixture(scope="module")
def campaign() -> Iterator[Campaign]:
    """All shipped cells, each with a plate that sticks out of the table."""
    with Campaign(described_cells(None), {"plate": standing_parts()["plate"]}, 1) as made:
        yield made


@pytest.mark.parametrize("block", range(len(FAULTS)))
def test_guarded_robots_do_not_collide(campaign: Campaign, block: int) -> None:
    """A fault of the network: a run in each decade of speed, of kinds that change from fault to fault."""
    kinds = [(4 * block + 5 * decade) % len(KINDS) for decade in range(len(DECADES))]
    numbers = [BLOCK * block + len(KINDS) * decade + kind for decade, kind in enumerate(kinds)]
    rows = [campaign.run(number) for number in numbers]
    assert {row.decade for row in rows} == set(DECADES)
    assert {row.fault for row in rows} == {list(FAULTS)[block]}
    assert [row for row in rows if row.collided] == []
    assert [row for row in rows if row.false_stop] == []


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
    described = described_cells(None)[cell]
    nominal = nominal_cell(described, load_mesh(PARTS / "free_form.stl", "mm"))
    start = np.append(nominal.home, 0.0) if start_deg is None else np.radians(start_deg)
    tool = Motion(Kind.TOOL_JOG, np.array(jog), 1.0, 4.0)
    with Simulation(World(described, nominal, settings_of(described))) as simulation:
        record = simulation.run(Scenario(start, (tool,), 4.0), Network())
    least = np.linalg.svd(Tool(nominal).poses(record.axes[::20, :-1])[1], compute_uv=False)[:, -1]
    assert least.min() < 0.5 * least[0]
    assert record.stopped_at is None
    assert min(decision.monitor_speed for _, decision in record.decisions) < 0.9


def test_a_run_follows_from_its_number(campaign: Campaign) -> None:
    first, other = campaign.run(3), campaign.run(4)
    again = asdict(campaign.run(3))
    exact = {name: value for name, value in asdict(first).items() if not isinstance(value, float)}
    assert {name: again[name] for name in exact} == exact
    assert first.kind != other.kind


def test_stated_distances_grow_with_the_speed() -> None:
    speeds = np.linspace(0.0, 0.5, 101)
    shown, silent = ([stated_distance(speed, silent) for speed in speeds] for silent in (False, True))
    assert (np.diff(silent) >= 0.0).all()
    assert (np.array(shown) <= silent).all()
    assert stated_distance(0.25, silent=False) == pytest.approx(0.005)
    assert stated_distance(0.25, silent=True) == pytest.approx(0.072)


def row_of(number: int, **values: object) -> RunRow:
    given = {
        "number": number, "kind": "joint move", "decade": DECADES[0], "length": LENGTHS[0], "near": False,
        "fault": "none", "cell": "default", "part": "plate", "silent": False, "version": 1, "rival": "", "pair": "",
        "gap": float("nan"), "speed": 0.005, "motions": 10, "short": 4, "twin_contact_at": float("nan"),
        "twin_contact": "", "contact_at": float("nan"), "contact": "", "by_gripper": False, "contact_kind": "",
        "contact_length": float("nan"), "clearance": 0.02, "stop": "", "stop_at": float("nan"), "stopped_pair": "",
        "stop_kind": "", "false_stop": False, "slowed": False, "resets": 0, "sessions": 0,
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


def test_summary_counts_collisions_false_stops_and_short_motions() -> None:
    rows = [
        row_of(0, contact="sensor - table", contact_kind="joint jog"),
        row_of(1, contact="finger1 - post", by_gripper=True, contact_kind="joint jog"),
        row_of(2, contact="sensor - part", contact_kind="servo", twin_contact="sensor - part"),
        row_of(3, decade=DECADES[2], length=LENGTHS[1], stop="guard", false_stop=True),
        row_of(4, decade=DECADES[2], stop="refused"),
    ]
    figures = summary(rows)
    assert (figures["collisions"], figures["collisions_by_kind"]) == (2, {"joint jog": 1, "servo": 1})
    assert figures["contacts_by_gripper"] == 1
    assert figures["probability_bound"] is None
    assert figures["false_stops_by_speed"] == {DECADES[0]: 0.0, DECADES[1]: None, DECADES[2]: 0.5}
    assert figures["false_stops_by_length"][LENGTHS[1]] == 1.0
    assert figures["motions_of_at_most_a_cycle"] == pytest.approx(0.4)
    assert summary(rows[3:])["probability_bound"] == pytest.approx(1 - 0.05**0.5)
    header, _, slow, fast, *_ = tables(rows)
    assert header.startswith("| speed | runs | twins collided | collisions | stopped by the guard | refused | held |")
    assert slow.startswith(f"| {DECADES[0]} | 3 | 1 | 2 | 0 | 0 | 0 |")
    assert fast.startswith(f"| {DECADES[2]} | 2 | 0 | 0 | 1 | 1 | 0 | 1 |")


def test_a_folder_of_another_campaign_is_refused(tmp_path: Path) -> None:
    done = scancell_here("guard", "check", PARTS / "free_form.stl", "--runs", "1", "--out", "here", cwd=tmp_path)
    assert done.code == 0, done.err
    other = CampaignOptions(None, str(PARTS / "machined.stl"))
    with pytest.raises(DescriptionError, match="another campaign"):
        run_campaign(other, 1, tmp_path / "here", workers=1)


def test_the_guard_holds_at_the_limits_of_its_assumptions() -> None:
    """Steered runs by hand in a cell that brakes as late and as weakly as the guard assumes."""
    found = search(OPTIONS, 20)  # how fast it gets near depends on the rounding of the machine
    assert (found.runs, found.contact) == (20, "")
    assert found.clearance is not None
    assert found.clearance < 6e-3  # the search gets near


@pytest.mark.parametrize("error", QUICK)
def test_a_search_finds_what_is_wrong_with_a_guard(error: str) -> None:
    assert search(QUICK[error], 40, error).contact


def test_jogs_of_the_table_are_stopped_at_the_limits() -> None:
    found = search(OF_TABLE, 1, TABLE)
    assert (found.runs, found.contact) == (1, "")


def test_moves_to_the_contact_of_a_pair_are_stopped_unless_it_is_ignored() -> None:
    pair = ("sensor", "table")
    guarded, ignored = search(OPTIONS, 1, "", pair), search(OPTIONS, 3, IGNORED, pair)
    assert (guarded.runs, guarded.contact) == (1, "")
    assert ignored.contact == " - ".join(pair)


def test_errors_with_axes_beyond_the_table_need_a_cell_with_these() -> None:
    with pytest.raises(DescriptionError, match="expected a cell with axes beyond the table"):
        search(OPTIONS, 1, "no-axis-rate")


def test_unknown_errors_of_a_guard_are_refused() -> None:
    with pytest.raises(DescriptionError, match=f"expected one of {', '.join(MUTATIONS)}"):
        search(OPTIONS, 1, "none-such")
