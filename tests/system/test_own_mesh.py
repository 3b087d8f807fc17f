"""A mesh of the user's own, in any format and unit, is scanned without a line of configuration."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
import trimesh
from commands import scancell

from scancell.reconstruction.cloud_files import read_ply

MM_PER_UNIT = {"mm": 1.0, "m": 1000.0, "inch": 25.4}
# Nobody's default place: the cloud must come out in these coordinates.
ORIGIN_MM = np.array([310.0, -45.0, 22.0])


def bracket() -> trimesh.Trimesh:
    """A stepped block with a round boss, in mm, about 60 × 40 × 35."""
    solids = [
        trimesh.creation.box(bounds=[[-30, -20, 0], [30, 20, 12]]),
        trimesh.creation.box(bounds=[[-30, -20, 0], [-12, 20, 24]]),
        trimesh.creation.cylinder(radius=9, segment=[[14, 0, 0], [14, 0, 35]], sections=96),
    ]
    part = trimesh.boolean.union(solids, engine="manifold")
    part.apply_translation(ORIGIN_MM)
    return part


@pytest.mark.parametrize(
    ("suffix", "unit", "engine", "most"),
    [("stl", "mm", "ray-traced", 80), ("obj", "m", "geometric", 650), ("ply", "inch", "geometric", 80)],
)
def test_own_mesh_is_scanned(tmp_path, suffix, unit, engine, most) -> None:
    part = bracket()
    part.apply_scale(1 / MM_PER_UNIT[unit])
    part.export(tmp_path / f"bracket.{suffix}")
    words = ["--engine", engine, "--unit", unit] if unit != "mm" else ["--engine", engine]
    fewer = ("--set", f"scan.max_profiles={most}")
    done = scancell("scan", f"bracket.{suffix}", *words, *fewer, "--ideal", "--out", "run", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    report = done.last_line
    assert report["ok"] is True
    figures = report["figures"]
    print(suffix, unit, engine, figures["points"], figures["deviation"], figures["coverage"], report["warnings"])
    assert 0.6 * most < figures["profiles"] <= most
    limit_um = 0.1 if engine == "geometric" else 10.0
    assert figures["deviation"]["rms_um"] <= limit_um
    assert figures["deviation"]["d99_9_um"] <= 60.0
    if most > 500:
        assert figures["coverage"] >= 0.95
    else:  # profiles lie centimetres apart
        assert 0.05 < figures["coverage"] < 0.5
    names = {"cloud.ply", "deviation.json", "deviation.png", "recording.parquet", "resolved.toml", "manifest.json"}
    assert names <= {path.name for path in (tmp_path / "run").iterdir()}
    assert all((tmp_path / file).exists() for file in report["files"])
    check_cloud(tmp_path, figures)
    check_records(tmp_path, f"bracket.{suffix}", unit, most)


def check_cloud(folder, figures) -> None:
    """The cloud lies in the file's own coordinate system, in mm."""
    cloud = read_ply(folder / "run" / "cloud.ply")
    points_mm = cloud.points_in_part * 1e3 - ORIGIN_MM
    assert len(cloud) == figures["points"] > 20_000
    low, high = points_mm.min(0), points_mm.max(0)
    assert low == pytest.approx([-30, -20, 0.5], abs=0.6)
    assert high == pytest.approx([30, 20, 35], abs=0.1)
    length = np.linalg.norm(cloud.normals, axis=1)
    alone = np.isnan(length)  # a profile far from its neighbours spans no surface
    assert alone.sum() == figures["points_without_normal"] < 0.05 * len(cloud)
    assert length[~alone] == pytest.approx(1.0, abs=1e-5)


def check_records(folder, name, unit, most) -> None:
    with (folder / "run" / "resolved.toml").open("rb") as stream:
        resolved = tomllib.load(stream)
    assert resolved["run"]["unit"] == unit
    assert resolved["scan"]["max_profiles"] == most
    manifest = json.loads((folder / "run" / "manifest.json").read_text())
    assert name in manifest["inputs"]
    deviation = json.loads((folder / "run" / "deviation.json").read_text())
    assert set(deviation["all"]) >= {"mean_um", "standard_deviation_um", "rms_um", "d95_um", "d99_9_um", "max_abs_um"}
    assert 0 <= deviation["coverage"]["fraction"] <= 1
