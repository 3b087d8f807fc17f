"""Saved plans: the same scan again, refused where the cell, the part or the file is another."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import scancell_here

import scancell
from scancell.config.files import assets_dir
from scancell.errors import DescriptionError, PlanningError
from scancell.planning.plan import Plan, plan_json

PART = assets_dir() / "parts" / "step_block.stl"
SMALL = {"scan.max_profiles": 60, "scan.raster.enabled": False}


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("plan") / "plan.json"
    with scancell.Scanner(settings=SMALL) as scanner:
        file.write_text(json.dumps(plan_json(scanner.plan(PART))))
    return file


def test_a_plan_without_sensor_paths_says_that_it_has_no_configuration_map(tmp_path: Path) -> None:
    made = scancell_here("plan", PART, "--picture", "map.png", "--set", "scan.max_profiles=60", cwd=tmp_path)
    assert made.code == 0
    assert "map.png is not written" in made.err
    assert not (tmp_path / "map.png").exists()


def changed(saved: Path, folder: Path, change: object) -> Path:
    data = json.loads(saved.read_text())
    change(data)  # type: ignore[operator]
    file = folder / "changed.json"
    file.write_text(json.dumps(data))
    return file


def test_a_plan_survives_its_file(saved: Path) -> None:
    assert plan_json(Plan.load(saved)) == json.loads(saved.read_text())


def test_a_scan_with_a_saved_plan_is_the_scan_that_makes_it(saved: Path) -> None:
    with scancell.Scanner(settings=SMALL) as scanner:
        own, again = (scanner.scan(PART, engine="geometric", plan=plan) for plan in (None, saved))
    np.testing.assert_array_equal(own.cloud.points_in_part, again.cloud.points_in_part)


def test_a_run_with_a_saved_plan_is_repeated_with_it(saved: Path, tmp_path: Path) -> None:
    """The plan has fewer exposures than the descriptions of the second run ask for."""
    words = ["--engine", "geometric", "--plan", str(saved)]
    assert scancell_here("scan", PART, *words, "--out", "a", cwd=tmp_path).code == 0
    assert scancell_here("rerun", "a", "--out", "b", cwd=tmp_path).code == 0
    plans = [json.loads((tmp_path / name / "plan.json").read_text()) for name in "ab"]
    assert plans[0] == plans[1] == json.loads(saved.read_text())


def test_another_part_in_the_way_is_refused(saved: Path) -> None:
    tall = {**SMALL, "cell.part.z_mm": 110.0}
    with scancell.Scanner(settings=tall) as scanner, pytest.raises(PlanningError, match=r"plan\.json: segment .*part"):
        scanner.scan(PART, engine="geometric", plan=saved)


def shift_joint(data: dict) -> None:
    data["segments"][1]["q"][0][2] += 0.01


def jump(data: dict) -> None:
    data["segments"][0]["q"][3][2] += 0.02


def other_cycle(data: dict) -> None:
    data["segments"][0]["time"][-1] += 0.004


def seven_joints(data: dict) -> None:
    for rows in (*(segment["q"] for segment in data["segments"]), data["exposures"]["q"]):
        for row in rows:
            row.append(0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (shift_joint, r"segment 2 .*starts 0\.573 deg from where the motion before it ends"),
        (jump, r"segment 1 .*joint 3 exceeds a limit"),
        (other_cycle, r"segment 1 .*every 16 ms"),
        (seven_joints, r"segment 1 .*7 joints, the arm has 6"),
    ],
)
def test_plans_for_another_cell_are_refused(saved: Path, tmp_path: Path, change: object, message: str) -> None:
    file = changed(saved, tmp_path, change)
    with scancell.Scanner(settings=SMALL) as scanner, pytest.raises(PlanningError, match=message):
        scanner.scan(PART, engine="geometric", plan=file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data.update(format=9), "format = 9"),
        (lambda data: data["segments"][0].update(table=[0.0]), r"segments\[1\].*1 table"),
        (lambda data: data["segments"][0]["q"][2].pop(), "one number of joints"),
        (lambda data: data.pop("segments"), "segments"),
    ],
)
def test_files_that_hold_no_plan_are_refused(saved: Path, tmp_path: Path, change: object, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        Plan.load(changed(saved, tmp_path, change))


def test_a_missing_or_broken_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"none\.json: no such file"):
        Plan.load(tmp_path / "none.json")
