"""The public Python API: results, what a `Scanner` keeps, frames, estimated cells, cancellation, sessions."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scancell
from scancell.cell.program import Program
from scancell.cell.recording import write_recording
from scancell.config.cell import EstimatedDescription
from scancell.errors import CancelledError, DescriptionError, EmptyScanError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, load_mesh
from scancell.reconstruction.cloud_files import read_ply

PART = Path(__file__).parents[2] / "assets/parts/step_block.stl"
FEW = {"scan.max_profiles": 60}


@pytest.fixture(scope="module")
def scanner():
    with scancell.Scanner(settings=FEW, ideal=True) as opened:
        yield opened


@pytest.fixture(scope="module")
def result(scanner):
    return scanner.scan(PART, engine="geometric", as_built={"tool.x_mm": 0.1}, seed=3)


def test_result_has_cloud_deviation_and_coverage(result) -> None:
    assert result.cloud.points_in_part.shape == (len(result.cloud), 3)
    # The tool is 0.1 mm off along the sensor's X, so faces across it appear shifted by up to that.
    assert 1e-6 < result.deviation.rms < 0.1e-3
    assert 0.0 < result.coverage.fraction <= 1.0
    assert {"load", "plan", "drive", "sense", "reconstruct", "evaluate"} <= set(result.timings)


def test_second_scan_reuses_plan_scene_and_fmu(scanner, result) -> None:
    builds, token = scanner.pipeline.builds, scanner.pipeline.runner.token
    again = scanner.scan(PART, engine="geometric", as_built={"tool.x_mm": 0.1}, seed=3)
    assert again.plan is result.plan
    assert scanner.pipeline.builds == builds
    assert scanner.pipeline.runner.token == token
    np.testing.assert_array_equal(again.cloud.points_in_part, result.cloud.points_in_part)


def test_plan_follows_the_descriptions_that_it_depends_on(scanner, result) -> None:
    placed = scancell.Setup(scanner.setup.cell.replace({"part.x_mm": 5.0}), scanner.setup.sensor, scanner.setup.scan)
    assert scanner.plan(PART, setup=placed) is not result.plan
    lit = scancell.Setup(
        scanner.setup.cell.replace({"part.reflectance": 0.4}), scanner.setup.sensor, scanner.setup.scan
    )
    assert scanner.plan(PART, setup=lit).program.duration == result.plan.program.duration


def test_saved_run_holds_every_file_and_reads_back(result, tmp_path) -> None:
    files = {path.name for path in result.save(tmp_path / "run", ["ply", "npz"], command_line=[])}
    assert files == {
        *("cloud.ply", "cloud.npz", "profiles.parquet", "plan.json", "recording.parquet"),
        *("deviation.json", "deviation.png", "deviation.html", "resolved.toml", "manifest.json"),
    }
    plan = json.loads((tmp_path / "run/plan.json").read_text())
    assert [segment["name"] for segment in plan["segments"]] == list(result.plan.program.names.values())
    assert all(segment["name"] for segment in plan["segments"])
    assert np.array_equal(plan["segments"][0]["q"], result.plan.program.segments[0].axes[:, :-1])
    figures = json.loads((tmp_path / "run/deviation.json").read_text())
    assert set(figures["by_camera"]) == set(result.camera_names)


def test_clouds_in_other_frames_are_rigid_copies(result, tmp_path) -> None:
    nominal = result.nominal
    result.save(tmp_path / "run", ["ply"], frame="base", command_line=[])
    written = read_ply(tmp_path / "run/cloud.ply").points_in_part
    base_from_part = pose.inverse(nominal.arm.world_from_base) @ nominal.world_from_table @ nominal.table_from_part
    expected = pose.transform_points(base_from_part, result.cloud.points_in_part)
    assert np.abs(written - expected).max() < 1e-9
    assert np.abs(result.points_in("base") - expected).max() < 1e-12
    with pytest.raises(DescriptionError, match=r"frame = .moon.: expected .part., .table., .base., .world."):
        result.points_in("moon")


def test_estimated_cell_removes_a_known_error(scanner) -> None:
    plain = scanner.scan(PART, engine="geometric", as_built={"tool.z_mm": 0.2})
    estimated = EstimatedDescription().replace({"tool.z_mm": 0.2})
    known = scanner.scan(PART, engine="geometric", as_built={"tool.z_mm": 0.2}, estimated=estimated)
    assert plain.deviation.rms > 50e-6
    assert known.deviation.rms < 0.05 * plain.deviation.rms


def test_callback_receives_stages_and_cancels(scanner) -> None:
    stages: list[str] = []

    def hear(stage: str, done: float, total: float) -> bool:
        assert 0 <= done <= total + 1e-9
        stages.append(stage)
        return stage != "driving" or done == 0

    with pytest.raises(CancelledError, match="cancelled while driving"):
        scanner.scan(PART, engine="geometric", progress=hear)
    assert dict.fromkeys(stages).keys() >= {"loading", "planning", "driving"}
    assert len(scanner.scan(PART, engine="geometric").cloud) > 1000, "the scanner works after a cancelled scan"


@pytest.mark.parametrize("thickness", [0.4e-3, 0.5e-3])
def test_sheet_no_thicker_than_the_table_margin_is_measured_without_bias(scanner, thickness) -> None:
    result = scanner.scan(box_mesh((0.06, 0.04, thickness), "sheet"), engine="geometric")
    dropped = result.dropped
    assert abs(result.deviation.mean) < 1e-9
    assert (np.ptp(result.cloud.points_in_part[:, :2], axis=0) > (0.0598, 0.0398)).all()
    assert dropped.kept_low > 0.4 * len(result.cloud)
    assert 0 < dropped.low == result.figures["points_on_table"]
    assert f"dropped    {dropped.low} points on the table; {dropped.kept_low} as low are on" in str(result)
    assert not any("table_margin_mm" in warning for warning in result.warnings)
    lost = result.recording.without_truth()
    again, counts = scanner.pipeline.reconstruct(result.world.estimated, lost, result.profiles, result.setup)
    np.testing.assert_array_equal(again.points_in_part, result.cloud.points_in_part)
    assert counts == dropped


def test_sheet_on_a_lower_table_is_kept_with_a_warning(scanner, tmp_path) -> None:
    sheet = box_mesh((0.06, 0.04, 0.0005), "sheet")
    result = scanner.scan(sheet, engine="geometric", as_built={"table.z_mm": -0.4})
    assert (np.ptp(result.cloud.points_in_part[:, :2], axis=0) > (0.057, 0.037)).all()
    (warning,) = [warning for warning in result.warnings if "table_margin_mm" in warning]
    assert "do table, part and tool stand as described?" in warning
    result.save(tmp_path / "run")
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert warning in manifest["warnings"]
    assert manifest["points"] == {
        "measured": result.dropped.measured,
        "kept": len(result.cloud),
        "dropped_on_table": result.dropped.low,
        "of_these_above_noise": result.dropped.raised,
        "dropped_above": result.dropped.high,
        "dropped_beside_table": result.dropped.outside,
        "dropped_on_neighbours": {},
        "kept_as_low_as_table": result.dropped.kept_low,
        "ambiguous": result.dropped.ambiguous,
    }


def test_walls_below_the_margin_are_counted_and_kept_by_a_lower_one(scanner) -> None:
    """In a cell as described nobody is asked whether it is; the points that the margin takes are the part's."""
    base = np.array([[0.01 * np.cos(a), 0.01 * np.sin(a), 0.0] for a in np.linspace(0, 2 * np.pi, 49)[:-1]])
    ring, after = np.arange(48), (np.arange(48) + 1) % 48
    corners = np.concatenate([base, [[0.0, 0.0, 0.0018], [0.0, 0.0, 0.0]]])
    sides = np.stack([ring, after, np.full(48, 48)], 1)
    cone = Mesh(corners, np.concatenate([sides, np.stack([after, ring, np.full(48, 49)], 1)]), "cone")
    for part in (box_mesh((0.06, 0.04, 0.0018), "plate"), cone):
        result = scanner.scan(part, engine="geometric")
        raised = result.dropped.raised
        assert raised > 100
        assert f"{raised} of them lie above the noise of the table, lower than scan.table_margin_mm = 0.5" in str(
            result
        )
        assert not any("stand as described?" in warning for warning in result.warnings)
        setup = scanner.setup
        lower = replace(setup, scan=setup.scan.model_copy(update={"table_margin_mm": 0.02}))
        more = scanner.scan(part, engine="geometric", setup=lower)
        assert more.dropped.raised < 0.2 * raised
        assert len(more.cloud) > len(result.cloud) + 0.7 * raised
        assert more.deviation.figures.d99_9 < 1e-6


def test_sheet_farther_below_than_errors_explain_is_an_error_that_names_the_key(scanner) -> None:
    sheet = box_mesh((0.06, 0.04, 0.0005), "sheet")
    with pytest.raises(EmptyScanError, match=r"scan\.table_margin_mm = 0\.5.*highest of them at -2\.5"):
        scanner.scan(sheet, engine="geometric", as_built={"table.z_mm": -3})


def test_images_of_the_geometric_engine_are_refused(scanner) -> None:
    with pytest.raises(DescriptionError, match="makes no images"):
        scanner.scan(PART, engine="geometric", on_images=lambda images: None)


def test_session_measures_where_the_sensor_stands(scanner, result) -> None:
    assert isinstance(result.plan.program, Program)
    exposed = len(result.plan.q) // 2
    q, table = result.plan.q[exposed], float(result.plan.table[exposed])
    with scanner.session(PART) as session:
        session.move_joints(q, table)
        found = session.profile("geometric")
        assert len(found.points_in_base) > 50
        assert session.profile("geometric").profile.points_in_sensor.shape == found.profile.points_in_sensor.shape
        world_from_base = scanner.plan(PART) and result.nominal.arm.world_from_base
        world = pose.transform_points(world_from_base, found.points_in_base)
        part = pose.transform_points(pose.inverse(result.nominal.world_from("part", [*q, table])), world)
        assert np.abs(part - found.points_in_part).max() < 1e-6
        from_mesh = scancell.sensor.closest_points(
            result.nominal.part.vertices, result.nominal.part.faces, found.points_in_part
        )[2]
        on_part = found.points_in_part[:, 2] > 1e-3
        assert np.abs(from_mesh[on_part]).max() < 1e-5


def test_notebook_display_has_a_picture_and_figures(result) -> None:
    page = result._repr_html_()
    assert "data:image/png;base64," in page
    assert "rms_um" in page
    assert result.picture().startswith(b"\x89PNG")


def test_a_recording_of_a_mesh_in_memory_keeps_the_name_of_the_mesh(scanner, tmp_path) -> None:
    mesh = load_mesh(PART)
    write_recording(scanner.scan(mesh, engine="geometric").recording, tmp_path / "recording.parquet")
    made = scanner.render(tmp_path / "recording.parquet", mesh, engine="geometric")
    assert made.part == mesh.source
    made.save(tmp_path / "run")
    run = tomllib.loads((tmp_path / "run/resolved.toml").read_text())["run"]
    assert run["part"] == mesh.source
    assert Path(run["recording"]).name == "recording.parquet"
