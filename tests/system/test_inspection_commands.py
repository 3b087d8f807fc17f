"""`scancell characteristics`, `plan`, `inspect` and `capability`: from a STEP file with tolerances to verdicts."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from commands import PARTS, Finished, scancell_here

import scancell
from bench.cad_variants import write_variant

pytest.importorskip("OCP")

BLOCK = PARTS / "drilled_block.step"
FEW = ("--engine", "geometric", "--set", "scan.max_profiles=250")


def run(*words: str | Path, cwd: Path) -> Finished:
    done = scancell_here(*words, "--json", cwd=cwd)
    assert done.code == 0, done.err
    return done


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Characteristics of the block, and scans of it and of one whose ``bore_b`` is 30 um beside its place."""
    made = tmp_path_factory.mktemp("inspection")
    run("characteristics", BLOCK, "--out", "stated.toml", cwd=made)
    text = (made / "stated.toml").read_text().replace("tolerance_mm = 0.1\n", "tolerance_mm = 0.03\n")
    (made / "narrow.toml").write_text(text)
    variant = write_variant("drilled_block", 0.03, made / "variant.step")
    for name, part in (("nominal", BLOCK), ("shifted", variant)):
        run("scan", part, *FEW, "--characteristics", "stated.toml", "--out", name, cwd=made)
    return made


def _verdicts(done: Finished) -> dict[str, str]:
    rows = done.last_line["figures"]["characteristics"]
    return {f"{row['kind']} {row['faces']}": row["verdict"] for row in rows}


def test_a_bore_beside_its_place_does_not_conform(folder: Path) -> None:
    nominal = _verdicts(run("inspect", "nominal", BLOCK, "--characteristics", "narrow.toml", cwd=folder))
    done = run("inspect", "shifted", BLOCK, "--characteristics", "narrow.toml", "--out", "results", cwd=folder)
    shifted = _verdicts(done)
    assert nominal["position bore_b"] == "conforms" and shifted["position bore_b"] == "does not conform"
    assert {key for key in nominal if nominal[key] != shifted[key]} == {"position bore_b"}
    (row,) = (row for row in done.last_line["figures"]["characteristics"] if row["name"] == "position bore_b")
    assert row["value_mm"] == pytest.approx(0.06, abs=0.002)
    written = json.loads((folder / "results" / "inspection.json").read_text())
    assert written["characteristics"] == done.last_line["figures"]["characteristics"]
    assert (folder / "results" / "inspection.html").stat().st_size > 100_000


def test_tolerances_of_the_file_are_inspected_without_a_description(folder: Path) -> None:
    stated = run("inspect", "nominal", BLOCK, "--characteristics", "stated.toml", cwd=folder)
    own = run("inspect", "nominal", BLOCK, cwd=folder)
    assert _verdicts(own) == _verdicts(stated) and len(_verdicts(own)) == 10


def test_capability_of_a_misaligned_cell_widens_uncertainties(folder: Path) -> None:
    (folder / "factors.toml").write_text(
        'name = "tool"\npart = "none"\ndesign = { kind = "latin_hypercube", trials = 2 }\n'
        '[[factor]]\npath = "as_built.tool.ry_deg"\ndistribution = { kind = "normal", std = 0.05 }\n'
    )
    words = ("--characteristics", "stated.toml", "--factors", "factors.toml", "--draws", "4", "--out", "capability")
    done = run("capability", BLOCK, *words, "--set", "scan.max_profiles=60", cwd=folder)
    rows = {row["name"]: row for row in done.last_line["figures"]["characteristics"]}
    assert max(row["by_cell_um"] for row in rows.values() if row["by_noise_um"]) > 1.0
    before = run("inspect", "nominal", BLOCK, "--characteristics", "stated.toml", cwd=folder)
    file = ("--capability", "capability/capability.json")
    after = run("inspect", "nominal", BLOCK, "--characteristics", "stated.toml", *file, cwd=folder)
    for old, new in zip(*(done.last_line["figures"]["characteristics"] for done in (before, after)), strict=True):
        if old["uncertainty_um"] is not None and rows[old["name"]]["by_cell_um"]:
            assert new["uncertainty_um"] > old["uncertainty_um"]


def test_views_for_tolerances_take_less_time_than_those_of_the_whole_part() -> None:
    whole = scancell.plan(BLOCK, settings={"scan.coverage.enabled": True, "scan.coverage.share": 0.8})
    times = []
    for tolerance in (0.1, 0.002):
        bore = scancell.CharacteristicDescription(
            name="bore", kind="position", faces=("bore_a",), datums=("A",), tolerance_mm=tolerance
        )
        datum = scancell.DatumDescription(name="A", faces=("top",))
        goals = scancell.InspectionDescription(characteristic=(bore,), datum=(datum,)).feature_goals()
        settings = {"scan.coverage.enabled": True, "scan.coverage.feature": [goal.model_dump() for goal in goals]}
        made = scancell.plan(BLOCK, settings=settings)
        assert made.report is not None
        times.append(made.report.time)
        met = [one.predicted <= one.wanted for one in made.report.features]
        assert all(met) if tolerance == 0.1 else not all(met)
        assert any("noise" in warning for warning in made.warnings) == (tolerance != 0.1)
    assert whole.report is not None
    assert times[0] < times[1] and times[0] < 0.5 * whole.report.time


def test_scans_of_meshes_import_neither_kernel_nor_inspection(folder: Path) -> None:
    words = ["scancell", "scan", str(PARTS / "step_block.stl"), "--engine", "geometric", "--out", "mesh"]
    script = f"""
import sys
from scancell.cli import main
sys.argv = {[*words, "--set", "scan.max_profiles=20"]}
try:
    main()
except SystemExit as ended:
    assert not ended.code
loaded = [name for name in sys.modules if name.startswith(("OCP", "scancell.inspection"))]
assert not loaded, loaded
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("inspect", "nominal", PARTS / "free_form.stl"), "has no CAD faces"),
        (("inspect", "nominal", BLOCK, "--characteristics", "missing.toml"), "missing.toml"),
        (("inspect", "nominal", BLOCK, "--capability", "stated.toml"), "stated.toml"),
        (("characteristics", PARTS / "free_form.stl"), "has no CAD faces"),
        (("plan", PARTS / "free_form.stl", "--characteristics", "stated.toml"), "scan.coverage.feature[1].faces"),
    ],
)
def test_wrong_inputs_are_named(folder: Path, words: tuple[str | Path, ...], message: str) -> None:
    done = scancell_here(*words, cwd=folder)
    assert done.code == 1 and message in done.err and "Traceback" not in done.err
