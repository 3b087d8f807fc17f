"""Scans of artefacts: without noise, every point lies on the exact shapes; commands take artefact files."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pyarrow.parquet
import pytest
from commands import QUICK, scancell_here

import scancell
from scancell.config.loading import assets_dir
from scancell.evaluation.deviation import deviation_from_mesh
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import ShapeMesh
from scancell.nominal.parts import load_part
from scancell.output.run_folder import sha256
from scancell.reconstruction.cloud_files import read_ply
from scancell.studies.engine import close_workers

FOLDER = assets_dir() / "artefacts"
SPHERE = FOLDER / "sphere.toml"
# Float64 coordinates of up to 0.3 m have steps of 5.6e-17 m; a few transforms add up to some of these.
ROUNDING = 2e-15


@pytest.fixture(scope="module")
def scanner():
    with scancell.Scanner(settings={"scan.max_profiles": 200}, ideal=True) as opened:
        yield opened


@pytest.mark.parametrize("name", ["sphere", "cone", "cylinder", "ring", "step", "plane", "v_groove", "ball_plate"])
def test_ideal_geometric_scan_has_no_facets(scanner, name) -> None:
    """The same cloud deviates from the tessellation by its chord error."""
    result = scanner.scan(FOLDER / f"{name}.toml", engine="geometric")
    part = result.nominal.part
    assert isinstance(part, ShapeMesh)
    assert len(result.cloud) > 30_000
    assert result.deviation.is_exact
    assert result.deviation.max_abs < ROUNDING
    facets = deviation_from_mesh(result.cloud, Mesh(part.vertices, part.faces))
    assert not facets.is_exact
    flat = name in ("step", "plane", "v_groove")
    assert (facets.max_abs < 1e-12) if flat else (3e-6 < facets.max_abs < 10e-6)
    print(name, len(result.cloud), result.deviation.max_abs, facets.max_abs, result.coverage.fraction)


@pytest.mark.parametrize("name", ["sphere", "cone"])
def test_bias_of_ideal_ray_traced_scan_is_small(scanner, name) -> None:
    """Light and images leave the centre of the stripe in place to a fraction of a pixel, which is 25 µm or so."""
    result = scanner.scan(FOLDER / f"{name}.toml", engine="ray-traced")
    found = result.deviation
    print(name, found.figures.as_um())
    assert abs(found.mean) < 1e-6
    assert found.rms < 2e-6


def test_public_interface_takes_an_artefact(scanner) -> None:
    shot = scanner.shot(SPHERE, scancell.location(0.0, 0.0, 0.18, rx=np.pi), engine="geometric")
    part = scanner.load_part(SPHERE)
    assert len(shot.points_in_part) > 100
    assert np.abs(part.shapes.nearest(shot.points_in_part)[0]).max() < ROUNDING


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    """`scancell scan` of a copied artefact file, with its folder."""
    folder = tmp_path_factory.mktemp("artefact")
    (folder / "ball.toml").write_text(SPHERE.read_text())
    done = scancell_here("scan", "ball.toml", *QUICK, "--out", "run", "--json", cwd=folder)
    assert done.code == 0, done.err
    return folder, done.last_line


def test_scan_command_records_the_artefact_file(scanned) -> None:
    folder, report = scanned
    assert report["figures"]["deviation"]["max_abs_um"] < 1e6 * ROUNDING
    deviation = json.loads((folder / "run" / "deviation.json").read_text())
    assert deviation["what"] == (
        "distance from each exported point to the nearest point of the exact shapes, positive outside"
    )
    manifest = json.loads((folder / "run" / "manifest.json").read_text())
    assert manifest["inputs"]["ball.toml"] == sha256(folder / "ball.toml")
    assert tomllib.loads((folder / "run" / "resolved.toml").read_text())["run"]["part"] == str(folder / "ball.toml")
    points = read_ply(folder / "run" / "cloud.ply").points_in_part
    assert len(points) == report["figures"]["points"]


def test_rerun_and_render_reproduce_the_cloud(scanned) -> None:
    folder, _ = scanned
    done = scancell_here("rerun", "run", "--out", "again", "--json", cwd=folder)
    assert done.code == 0, done.err
    words = ("run/recording.parquet", "ball.toml", *QUICK, "--out", "rendered", "--json")
    done = scancell_here("render", *words, cwd=folder)
    assert done.code == 0, done.err
    cloud = (folder / "run" / "cloud.ply").read_bytes()
    assert (folder / "again" / "cloud.ply").read_bytes() == cloud
    assert (folder / "rendered" / "cloud.ply").read_bytes() == cloud


def test_plan_and_shot_commands_take_an_artefact(tmp_path: Path) -> None:
    done = scancell_here("plan", SPHERE, "--set", "scan.max_profiles=60", "--out", "plan.json", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    words = ("--pose=0,0,150,180,0,0", "--engine", "geometric", "--ideal", "--out", "shot", "--json")
    done = scancell_here("shot", SPHERE, *words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert (tmp_path / "shot" / "profile.csv").is_file()


def test_study_and_batch_take_an_artefact(tmp_path: Path) -> None:
    factor = '[[factor]]\npath = "as_built.tool.x_mm"\ndistribution = { kind = "normal", std = 0.1 }\n'
    (tmp_path / "study.toml").write_text(
        f'name = "tool"\npart = "{SPHERE}"\nengine = "geometric"\nset = ["scan.max_profiles=24"]\n'
        f'[design]\nkind = "monte_carlo"\ntrials = 2\n{factor}'
    )
    try:
        done = scancell_here("study", "run", "study.toml", "--shard", "1/1", "--out", "study", "--json", cwd=tmp_path)
        assert done.code == 0, done.err
        words = ("--engine", "geometric", "--set", "scan.max_profiles=24", "--out", "batch", "--json", "--shard", "1/1")
        done = scancell_here("batch", SPHERE, *words, cwd=tmp_path)
        assert done.code == 0, done.err
    finally:
        close_workers()
    (row,) = pyarrow.parquet.read_table(tmp_path / "batch" / "index.parquet").to_pylist()
    assert row["status"] == "ok", row
    assert row["mesh_sha256"] == sha256(SPHERE)
    # The true surface points lie on the shapes, those of noisy measurements near them.
    with h5py.File(tmp_path / "batch" / row["file.truth.h5"]) as file:
        truth = file["truth/cloud"]
        points, normals, shape = (truth[key][:] for key in ("points_in_part_mm", "normals", "face"))
        part = list(file["truth"].attrs["bodies"]).index("part")
        on_part = truth["body"][:] == part
    assert on_part.sum() > 1000
    signed, expected, index = load_part(SPHERE).shapes.nearest(points[on_part] * 1e-3)
    assert np.abs(signed).max() < ROUNDING
    np.testing.assert_allclose(normals[on_part], expected, atol=1e-6)
    np.testing.assert_array_equal(shape[on_part], index)
