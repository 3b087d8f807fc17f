"""Set-ups of free parts: which resting poses, where, and that a scan of the proposal covers what it promises."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import trimesh
from cells import ball, block, mesh_of

from scancell.cli.scan import _write
from scancell.config.loading import load_setup
from scancell.errors import MeshError, PlanningError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.nominal.cell import nominal_cell
from scancell.planning import setups
from scancell.planning.model import WorkLimitError
from scancell.planning.setups import riser_for
from scancell.planning.views import coverage
from scancell.scanner import Scanner

SWEEPS = {"scan.raster.enabled": False}  # Sweeps alone see all sides of a block, and are chosen sooner.


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer samples and placements, also in the scans of them."""
    monkeypatch.setattr(setups, "_SAMPLES", 600)
    monkeypatch.setattr(setups, "_HEIGHTS_MM", (0.0, 60.0))
    monkeypatch.setattr(setups, "_OFFSETS", (0.0,))
    monkeypatch.setattr(coverage, "_MOST_SAMPLES", 2000)


def test_one_set_up_of_a_block_misses_its_underside_and_a_scan_of_each_covers_what_is_promised(
    tmp_path: Path, coarse: None
) -> None:
    part = block(0.05, 0.04, 0.03)
    with Scanner(settings=SWEEPS) as scanner:
        found = scanner.place(part, 0.99)
    assert len(found.chosen) == 2
    assert found.rests == 6
    assert found.accessible == pytest.approx(1.0, abs=0.005)
    assert found.reached >= 0.99
    # Each side on which it may rest is a part of the surface.
    sides = np.array([0.05 * 0.04, 0.05 * 0.03, 0.04 * 0.03])
    assert found.best_single <= 1 - sides.min() / (2 * sides.sum()) + 0.01
    for number, one in enumerate(found.chosen):
        assert one.scanned <= one.measurable + 1e-9
        file = tmp_path / f"cell{number}.toml"
        assert one.riser is None
        one.in_cell(load_setup().cell, "").to_toml(file)
        with Scanner(cell=file, settings={**SWEEPS, "scan.coverage.enabled": True}) as scanner:
            result = scanner.scan(part, engine="geometric", samples=False)
        assert result.nominal.table_from_part[:3, :3] == pytest.approx(
            pose.rotation_from_euler_xyz(np.radians([one.part.rx_deg, one.part.ry_deg, one.part.rz_deg])), abs=1e-9
        )
        assert result.coverage.measurable_fraction == pytest.approx(one.measurable, abs=0.01)
        assert result.coverage.surface_fraction >= one.scanned - 0.02


def test_snippet_is_the_part_of_a_cell(coarse: None) -> None:
    part = block(0.05, 0.04, 0.03)
    with Scanner(settings=SWEEPS) as scanner:
        found = scanner.place(part, 0.5)
    (one,) = found.chosen
    section = tomllib.loads(one.toml)
    assert set(section) == {"part"}
    described = load_setup().cell.replace({f"part.{key}": value for key, value in section["part"].items()})
    assert described == one.in_cell(load_setup().cell, "")
    assert tomllib.loads(tomli_w.dumps(section)) == section


def test_riser_reaches_from_the_table_to_the_feet() -> None:
    feet = [trimesh.creation.box((0.01, 0.04, 0.01), pose.translation((x, 0, 0.005))) for x in (-0.02, 0.02)]
    plate = trimesh.creation.box((0.08, 0.06, 0.01), pose.translation((0, 0, 0.015)))
    part = mesh_of(trimesh.boolean.union([*feet, plate], engine="manifold"))
    assert riser_for(nominal_cell(load_setup().cell, part)) is None
    lifted = nominal_cell(load_setup(settings=["cell.part.z_mm=30", "cell.part.x_mm=10"]).cell, part)
    riser = riser_for(lifted)
    assert riser is not None
    assert riser.bounds == pytest.approx(np.array([[-0.015, -0.02, 0.0], [0.035, 0.02, 0.03]]))


@pytest.mark.parametrize(
    ("part", "kind", "message"),
    [
        (block(0.5, 0.5, 0.5), PlanningError, "no resting pose of the part is feasible: .*too large for the table"),
        (ball(), PlanningError, "has no stable resting pose; clamp it"),
        (Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), "empty.stl"), MeshError, "empty.stl: no triangles"),
    ],
    ids=["large", "ball", "empty"],
)
def test_part_that_cannot_be_set_up_is_refused(part: Mesh, kind: type[Exception], message: str) -> None:
    with Scanner() as scanner, pytest.raises(kind, match=message):
        scanner.place(part)


def test_part_out_of_reach_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(setups, "_SAMPLES", 20)
    monkeypatch.setattr(setups, "_MOST_RESTS", 2)
    with (
        Scanner(settings={"cell.table.pose.x_mm": 3000}) as scanner,
        pytest.raises(PlanningError, match="nothing of its surface is measurable in any resting pose"),
    ):
        scanner.place(block(0.05, 0.04, 0.03))


def test_work_of_all_set_ups_is_limited(coarse: None) -> None:
    with (
        Scanner(settings={**SWEEPS, "scan.max_planning_work": 1e-3}) as scanner,
        pytest.raises(WorkLimitError, match="planning reached its limit of work while"),
    ):
        scanner.place(block(0.05, 0.04, 0.03))


def test_command_writes_a_cell_with_riser_that_can_be_scanned(tmp_path: Path) -> None:
    part = block(0.05, 0.04, 0.03)
    lifted = nominal_cell(load_setup(settings=["cell.part.z_mm=30"]).cell, part)
    one = setups.SetUp(load_setup(settings=["cell.part.z_mm=30"]).cell.part, riser_for(lifted), 0.5, 0.8, 0.8, 10.0)
    file = tmp_path / "placed.toml"
    written = _write(one, load_setup().cell, file)
    assert written == [str(file), str(tmp_path / "placed_riser.stl")]
    with Scanner(cell=file) as scanner:
        loaded = scanner.pipeline.load(scanner.setup, part).nominal
        result = scanner.scan(part, engine="geometric", samples=False)
    (riser,) = [body for body in loaded.bodies if body.name == "riser"]
    assert riser.mesh.bounds == pytest.approx(np.array([[-0.025, -0.02, 0.0], [0.025, 0.02, 0.03]]), abs=1e-8)
    # The underside rests on the riser.
    under = 0.05 * 0.04 / (2 * (0.05 * 0.04 + 0.05 * 0.03 + 0.04 * 0.03))
    assert result.coverage.measurable_fraction == pytest.approx(1 - under, abs=0.01)
    assert result.coverage.fraction > 0.9
