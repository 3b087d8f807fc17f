"""`scancell evaluate` and `scancell mesh`: from a scan to figures of a part or an artefact, and to a new part."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from commands import PARTS, Finished, scancell_here

import scancell
from scancell.config.loading import assets_dir
from scancell.geometry.mesh import box_mesh, load_mesh
from scancell.reconstruction.cloud import write_surface

ARTEFACTS = assets_dir() / "artefacts"
EXACT = ("--engine", "geometric", "--ideal")


def run(*words: str | Path, cwd: Path) -> Finished:
    done = scancell_here(*words, "--json", cwd=cwd)
    assert done.code == 0, done.err
    return done


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run folder of a scan of the free-form part."""
    folder = tmp_path_factory.mktemp("scan")
    run("scan", PARTS / "free_form.stl", *EXACT, "--set", "scan.max_profiles=300", "--out", "run", cwd=folder)
    return folder / "run"


def test_cloud_against_its_mesh(scan: Path, tmp_path: Path) -> None:
    mesh = PARTS / "free_form.stl"
    words = ("--align", "best-fit", "--out", "results")
    done = run("evaluate", scan, "--mesh", mesh, *words, cwd=tmp_path)
    assert "region 0: centre (" in done.err
    figures = done.last_line["figures"]
    of_scan = json.loads((scan / "deviation.json").read_text())
    assert figures["all"]["count"] == of_scan["all"]["count"]
    assert figures["all"]["rms_um"] == pytest.approx(of_scan["all"]["rms_um"], abs=1e-3)
    assert np.abs(np.array(figures["alignment"]["part_from_cloud"]) - np.eye(3, 4)).max() < 1e-4
    written = json.loads((tmp_path / "results" / "evaluation.json").read_text())
    assert written == figures
    with (tmp_path / "results" / "evaluation.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert sum(int(row["count"]) for row in rows) == figures["all"]["count"]
    assert (tmp_path / "results" / "evaluation.png").read_bytes().startswith(b"\x89PNG")


def test_datum_faces_are_named_with_their_frames(tmp_path: Path) -> None:
    block = box_mesh((0.03, 0.02, 0.01), "block")
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (3000, 3))
    points[np.arange(3000), np.arange(3000) % 3] = 0.5
    np.savetxt(tmp_path / "cloud.xyz", 1e3 * points * (0.03, 0.02, 0.01))
    write_surface(block, tmp_path / "block.stl")
    done = run("evaluate", "cloud.xyz", "--mesh", "block.stl", "--align", "datum", cwd=tmp_path)
    assert done.err.count("datum face: region") == 3
    assert "plane, normal (0.00, 0.00, 1.00), centre (0.0, 0.0, 5.0) mm" in done.err
    assert done.last_line["figures"]["all"]["rms_um"] < 1e-3
    assert done.last_line["warnings"] == []


def test_surface_of_a_scan_is_scanned_again(scan: Path, tmp_path: Path) -> None:
    made = run("mesh", scan, "--out", "surface.ply", "--spacing-mm", "0.5", cwd=tmp_path).last_line
    assert made["figures"]["faces"] > 1000
    against = run("evaluate", scan, "--mesh", "surface.ply", cwd=tmp_path).last_line["figures"]
    assert against["all"]["d95_um"] < 30.0
    again = run("scan", "surface.ply", *EXACT, "--set", "scan.max_profiles=60", "--out", "again", cwd=tmp_path)
    assert again.last_line["figures"]["points"] > 1000


def test_artefact_is_scanned_and_measured(tmp_path: Path) -> None:
    """A calibrated ball whose true diameter is 10 um larger than the nominal one."""
    nominal = ARTEFACTS / "sphere.toml"
    text = nominal.read_text()
    assert "diameter_mm = 25.0" in text
    (tmp_path / "true.toml").write_text(text.replace("diameter_mm = 25.0", "diameter_mm = 25.01"))
    run("scan", "true.toml", *EXACT, "--set", "scan.max_profiles=400", "--out", "run", cwd=tmp_path)
    found = scancell.evaluate(tmp_path / "run", artefact=nominal, align="best-fit")
    size = next(one for one in found.characteristics if one.name == "probing size")
    assert size.error == pytest.approx(10e-6, abs=0.1e-6)
    form = next(one for one in found.characteristics if one.name == "probing form")
    assert form.value < 1e-6
    shown = run("evaluate", "run", "--artefact", nominal, "--out", "results", cwd=tmp_path)
    row = next(row for row in shown.last_line["figures"]["characteristics"] if row["name"] == "probing size")
    assert row["error_um"] == pytest.approx(10.0, abs=0.1)


def test_wrong_requests_name_what_was_expected(scan: Path, tmp_path: Path) -> None:
    for words, expected in (
        ((), "either a mesh or an artefact"),
        (("--mesh", PARTS / "free_form.stl", "--align", "datum", "--datum", "top"), "numbers of plane regions"),
        (("--artefact", ARTEFACTS / "sphere.toml", "--align", "datum", "--datum", "cube"), "no face cube"),
    ):
        done = scancell_here("evaluate", scan, *words, "--json", cwd=tmp_path)
        assert done.code == 1
        assert expected in done.message
    done = scancell_here("evaluate", tmp_path, "--mesh", PARTS / "free_form.stl", "--json", cwd=tmp_path)
    assert "holds no cloud.ply" in done.message


def test_written_surface_is_a_mesh_of_the_part(scan: Path, tmp_path: Path) -> None:
    surface = scancell.mesh(scan, tmp_path / "surface.stl", method="ball-pivoting", spacing_mm=0.5)
    part = load_mesh(PARTS / "free_form.stl")
    assert (surface.bounds[0] >= part.bounds[0] - 1e-4).all()
    assert (surface.bounds[1] <= part.bounds[1] + 1e-4).all()
    assert len(load_mesh(tmp_path / "surface.stl").faces) > 0.99 * len(surface.faces)
