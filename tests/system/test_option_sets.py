"""Scans with combined options are repeated by their run folder, and do not depend on what was scanned before."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bench.option_sets import check, differences, draw, same
from scancell import Mesh, Scanner
from scancell.config.cell import EstimatedDescription
from scancell.config.files import assets_dir
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import box_mesh, load_mesh
from scancell.views.recorded_run import open_run
from system.commands import scancell_here

FEW = {"scan.max_profiles": 40}
PART = assets_dir() / "parts" / "free_form.stl"


@pytest.fixture(scope="module")
def used() -> Iterator[Scanner]:
    with Scanner() as scanner:
        yield scanner


@pytest.mark.parametrize("number", range(6))
def test_scan_is_repeated_by_its_run_folder_and_by_a_used_scanner(number: int, tmp_path: Path, used: Scanner) -> None:
    assert check(number, tmp_path, used)[1] == [], draw(number)


def test_rerun_keeps_what_is_estimated_of_the_cell(tmp_path: Path) -> None:
    estimated = EstimatedDescription.of({"tool.x": 1e-3, "table.y": -5e-3}, joints=6)
    with Scanner(settings=FEW, ideal=True) as scanner:
        result = scanner.scan(
            PART, engine="geometric", as_built={"tool.x_mm": 1.0, "table.y_mm": -5.0}, estimated=estimated
        )
    assert result.deviation.rms < 5e-6
    result.save(tmp_path / "run", ["ply", "npz"], frame="base")
    assert scancell_here("rerun", tmp_path / "run", "--out", tmp_path / "again", cwd=tmp_path).code == 0
    assert differences(tmp_path / "run", tmp_path / "again") == []
    # The cloud in the frame of the base comes back into that of the part by the same cell.
    cloud = open_run(tmp_path / "run").cloud
    assert cloud is not None
    order = np.argsort(result.cloud.time, kind="stable")
    assert np.abs(cloud.points_in_part - result.cloud.points_in_part[order]).max() < 1e-6


def test_changed_file_of_an_obstacle_is_read_again(tmp_path: Path) -> None:
    """The obstacle, unknown to planning, hides half of the part from the sensor, or nothing."""
    file = tmp_path / "hood.stl"
    cell = load_setup().cell.model_dump()
    placed = {"x_mm": 450.0, "y_mm": 0.0, "z_mm": 0.0}
    cell["obstacle"] = [{"name": "hood", "mesh": str(file), "pose": placed, "known": False}]
    counts = []
    with Scanner(settings=FEW, ideal=True) as scanner:
        for size in (0.002, 0.06, 0.002):
            _write_stl(box_mesh((0.06, size, 0.002)), file, height=0.155)
            setup = load_setup(type(scanner.setup.cell).model_validate(cell), settings=FEW, ideal=True)
            counts.append(len(scanner.scan(PART, engine="geometric", setup=setup).cloud))
    assert counts[0] == counts[2]
    assert counts[1] < 0.9 * counts[0]


def _write_stl(mesh: Mesh, file: Path, height: float) -> None:
    raised = 1e3 * mesh.transformed(pose.translation((0.0, 0.0, height))).vertices
    lines = ["solid hood"]
    for face in mesh.faces:
        corners = [f"vertex {x} {y} {z}" for x, y, z in raised[face].tolist()]
        lines += ["facet normal 0 0 0", "outer loop", *corners, "endloop", "endfacet"]
    file.write_text("\n".join([*lines, "endsolid hood", ""]))


def test_mesh_does_not_change_between_two_scans() -> None:
    mesh = load_mesh(PART)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[:, 2] /= 2
    vertices = mesh.vertices.copy()
    own = Mesh(vertices, mesh.faces)
    with Scanner(settings=FEW) as scanner:
        first = scanner.scan(own, engine="geometric")
        vertices[:, 2] /= 2
        assert same(first, scanner.scan(own, engine="geometric")) == []
        lower = scanner.scan(Mesh(vertices, mesh.faces), engine="geometric")
    assert lower.cloud.points_in_part[:, 2].max() < 0.6 * first.cloud.points_in_part[:, 2].max()
