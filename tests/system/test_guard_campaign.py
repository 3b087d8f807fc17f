"""A small campaign of a guarded cell: no collisions, few false stops; campaigns go on where they were stopped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from commands import PARTS, scancell_here

from scancell.config.cell import CellDescription
from scancell.errors import DescriptionError
from scancell.geometry.mesh import load_mesh
from scancell.guard.guard import Guard
from scancell.jobs.guard_job import settings_of
from scancell.nominal.cell import nominal_cell
from scancell.studies.guard.campaign import Campaign, RunRow
from scancell.studies.guard.mutations import MUTATIONS
from scancell.studies.guard.rows import RowFile, summary, tables
from scancell.studies.guard.run import IGNORED, CampaignOptions, campaign_of, run_campaign, search
from scancell.studies.guard.simulation import Simulation
from scancell.studies.guard.twins import THIRDS

LONG = ("short-delay", "no-tool-path")  # errors that take hundreds of runs to find
OPTIONS = CampaignOptions(None, str(PARTS / "free_form.stl"))


@pytest.fixture(scope="module")
def campaign() -> Iterator[Campaign]:
    with campaign_of(OPTIONS) as made:
        yield made


@pytest.mark.slow
@pytest.mark.parametrize("block", range(4))
def test_guarded_robots_do_not_collide(campaign: Campaign, block: int) -> None:
    """200 runs: every third twin collides, and every one of them comes near or does ordinary work as it should."""
    rows = [campaign.run(number) for number in range(50 * block, 50 * (block + 1))]
    assert [row for row in rows if row.contact or row.touched] == []
    assert sum(row.false_stop for row in rows) <= 1
    assert [row for row in rows if row.warned_retreating] == []
    for row in rows:
        assert bool(row.twin_contact) == (row.third == THIRDS[0])
        assert (row.twin_clearance < 0.05) == (row.third == THIRDS[1]) or row.third == THIRDS[0]
        assert np.isnan(row.twin_contact_at) or row.twin_contact_at >= 1.0
    # The guard is needed: most of those whose twins collide are stopped, or wait in front of the contact.
    colliding = [row for row in rows if row.third == THIRDS[0]]
    kept = [row for row in colliding if row.stop or not np.isfinite(row.arrived_at)]
    assert len(kept) >= 0.9 * len(colliding)


def test_a_run_follows_from_its_number(campaign: Campaign) -> None:
    first, other = campaign.run(3), campaign.run(4)
    assert asdict(campaign.run(3)) == pytest.approx(asdict(first), nan_ok=True)
    assert first.third != other.third


def row_of(number: int, **values: object) -> RunRow:
    given = {
        "number": number, "third": "ordinary", "operation": "manual", "fault": "none", "draws": 1,
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


def test_summary_counts_collisions_and_false_stops_by_third() -> None:
    rows = [
        row_of(0, third="collision", contact="sensor - table"),
        row_of(1, third="collision", touched=True, twin_contact="sensor - part"),
        row_of(2, stop="guard", false_stop=True),
        row_of(3),
    ]
    figures = summary(rows)
    assert figures["collisions"] == 2
    assert figures["probability_bound"] is None
    assert figures["false_stops"] == {"collision": 0.0, "near miss": None, "ordinary": 0.5}
    assert figures["cycle_time_loss_median"] == pytest.approx(0.05)
    assert summary(rows[2:])["probability_bound"] == pytest.approx(1 - 0.05**0.5)
    assert any("| ordinary | 2 | manual | 0 | 1 | 1 |" in line for line in tables(rows))


def test_a_folder_of_another_campaign_is_refused(tmp_path: Path) -> None:
    done = scancell_here("guard", "campaign", PARTS / "free_form.stl", "--runs", "1", "--out", "here", cwd=tmp_path)
    assert done.code == 0
    other = CampaignOptions(None, str(PARTS / "machined.stl"))
    with pytest.raises(DescriptionError, match="another campaign"):
        run_campaign(other, 1, tmp_path / "here", workers=1)


def test_the_guard_holds_at_the_limits_of_its_assumptions() -> None:
    """Steered runs by hand in a cell that brakes as late and as weakly as the guard assumes."""
    found = search(OPTIONS, 21)
    assert (found.runs, found.contact) == (21, "")
    assert found.clearance is not None
    assert found.clearance < 5e-3  # the search gets near


@pytest.mark.slow
@pytest.mark.parametrize("error", [name for name in MUTATIONS if name not in LONG])
def test_a_search_finds_what_is_wrong_with_a_guard(error: str) -> None:
    assert search(OPTIONS, 100, error).contact


@pytest.mark.slow
@pytest.mark.parametrize("pair", [("base", "link3"), ("sensor", "table"), ("sensor", "part")])
def test_moves_to_contacts_of_a_pair_are_stopped_unless_it_is_ignored(pair: tuple[str, str]) -> None:
    guarded, ignored = search(OPTIONS, 3, "", pair), search(OPTIONS, 6, IGNORED, pair)
    assert (guarded.runs, guarded.contact) == (3, "")
    assert ignored.contact == " - ".join(pair)


def test_unknown_errors_of_a_guard_are_refused() -> None:
    with pytest.raises(DescriptionError, match="expected one of"):
        search(OPTIONS, 1, "none-such")


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 3])
def test_an_arm_with_motors_does_not_collide(number: int) -> None:
    """Motors, gears and inertia delay the arm behind its set-points: by hand, and in automatic operation."""
    shipped = CellDescription.default()
    described = shipped.model_copy(update={"robot": shipped.robot.model_copy(update={"drive": "dynamic"})})
    nominal = nominal_cell(described, load_mesh(OPTIONS.part, "mm"))
    guard = Guard(nominal, described.robot, settings_of(described))
    with Campaign(Simulation(described, nominal), guard, 1) as campaign:
        row = campaign.run(number)
    assert row.twin_contact
    assert (row.contact, row.touched) == ("", False)
