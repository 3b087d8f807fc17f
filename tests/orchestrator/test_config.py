"""Descriptions: units, overrides, errors, files, schemas."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from cells import GRIPPER

from scancell.config.artefact import ArtefactDescription
from scancell.config.cell import CellDescription, LinkDescription
from scancell.config.description import FileDescription, PoseDescription, si_value, split_unit, to_si
from scancell.config.files import join_path
from scancell.config.loading import assets_dir, load_resolved, load_setup, parse_assignment, split_path
from scancell.config.robot import RobotDescription
from scancell.config.scan import ScanDescription
from scancell.config.schema import json_schemas
from scancell.config.sensor import SensorDescription, sensor_json
from scancell.config.study import load_study
from scancell.errors import DescriptionError, OutputError
from scancell.output.run_folder import resolved_toml

_ENDS = (("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum"))
FILES: list[type[FileDescription]] = [
    ArtefactDescription,
    CellDescription,
    RobotDescription,
    SensorDescription,
    ScanDescription,
]


def test_units_are_converted_once() -> None:
    si = to_si({"a_mm": 335.0, "tilt_deg": 180.0, "nested": [{"t_ms": 2.0}], "width_px": 1280, "pitch_um": 5.0})
    assert si["a"] == pytest.approx(0.335)
    assert si["tilt"] == pytest.approx(math.pi)
    assert si["nested"][0]["t"] == pytest.approx(0.002)
    assert si["width_px"] == 1280
    assert si["pitch"] == pytest.approx(5e-6)


def test_single_si_value_matches_full_conversion() -> None:
    table = load_setup().cell.table
    for key in ("radius_mm", "max_speed_deg_s", "friction"):
        assert si_value(table, key) == to_si(table.model_dump())[split_unit(key)[0]]


def test_all_sensor_keys_with_units_are_converted() -> None:
    resolved = sensor_json(load_setup().sensor, seed=3)
    camera = resolved["cameras"][0]
    assert resolved["render"]["seed"] == 3
    assert camera["baseline"] == pytest.approx(0.06)
    assert camera["focal_px"] == pytest.approx(512 / math.tan(math.radians(9.34)))
    assert not [key for key in camera if key.endswith(("_mm", "_deg", "_um"))]


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("cell.table.raduis_mm=3", "table.raduis_mm: unknown key; did you mean 'radius_mm'?"),
        ("cell.table.radius_mm=-3", "table.radius_mm = -3: must be greater than or equal to 0.001"),
        ("cell.table.radius_mm=nan", "table.radius_mm = nan: must be a finite number"),
        ("cell.table.radius_mm=wide", "table.radius_mm = 'wide': must be a valid number"),
        ("sensor.detector.bit_depth=99", "detector.bit_depth = 99: must be less than or equal to 16"),
        ("sensor.camera[3].tilt_deg=2", "index [3] does not exist, there are 2"),
        ("sensor.camera[0].tilt_deg=2", "counting from 1"),
        ("scan.mode='fly'", "mode = 'fly': must be 'dynamic' or 'stop-and-look'"),
        ("table.radius_mm=3", "must begin with one of cell, sensor, scan"),
        ("cell.part.x_mm", "expected key=value"),
        ("cell.name.x=1", "'x' is not inside a table"),
        ("cell.gripper.stroke_mm=30", "gripper.pose: missing, and it has no default"),
        ("sensor.camera[2].psf_sigma_px=-1", "camera[2].psf_sigma_px = -1: must be"),
        ("cell.sensor_mesh=absent.stl", "sensor_mesh = 'absent.stl': no such file"),
    ],
)
def test_invalid_override_error(word: str, expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        load_setup(settings=["cell.part.y_mm=1", word])
    message = str(caught.value)
    assert expected in message
    assert word.partition("=")[0] in message
    assert ".toml" not in message


@pytest.mark.parametrize(
    ("word", "file", "expected"),
    [
        ("sensor.camera[1].half_angle_deg=40", "two_camera_probe.toml", "camera[1]: half_angle_deg (40) must be below"),
        ("cell.robot.joint[2].min_deg=90", "six_axis.toml", "joint[2]: min_deg (90) must be below max_deg (45)"),
        ("cell.robot.home_deg=[0, 90, 0, 0, 0, 0]", "six_axis.toml", "home_deg[2] = 90: expected an angle between"),
        ("cell.world.controller_cycle_us=1500", "`settings`", "controller_cycle_us (1500) must be a multiple"),
    ],
)
def test_override_conflict_names_both_sources(word: str, file: str, expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        load_setup(settings=[word])
    assert expected in str(caught.value)
    assert f"`settings` {word}" in str(caught.value)
    assert file in str(caught.value)


FREE = 'cell.part.fixture="free"'


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([*GRIPPER, "cell.gripper.start_mm=60"], "stroke_mm=50 with .*start_mm=60: gripper: start_mm"),
        ([*GRIPPER, "cell.gripper.stroke_mm=0"], "stroke_mm"),
        (["cell.part.soft.stiffness_n_mm=1"], "a soft part cannot be clamped"),
        ([FREE, "cell.part.soft.damping_ratio=1"], "stiffness_n_mm"),
        ([FREE, "cell.part.soft.stiffness_n_mm=0"], "stiffness_n_mm"),
        ([FREE, "cell.part.soft={stiffness_n_mm=1, longest_edge_mm=-1}"], "longest_edge_mm"),
        (["cell.part.material.preset=chrome"], "matt_white"),
        (["cell.part.material.roughness=0.4"], "preset"),
        (["cell.part.material={preset='polished_steel', roughness=0.001}"], "0.01"),
        (["cell.part.material={model='lambert', reflectance=1.3}"], "reflectance"),
        (["cell.robot.joint[1].drive.max_torque_n_m=-1"], "drive"),
    ],
)
def test_wrong_or_contradictory_values_are_rejected(words: list[str], message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_setup(settings=words)


def test_wrong_item_alone_in_its_list_is_one_error() -> None:
    with pytest.raises(DescriptionError) as caught:
        load_setup(sensor=assets_dir() / "sensors/short_range_25.toml", settings=["sensor.camera[1].tilt_deg=1"])
    assert "must be below tilt_deg (1)" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(DescriptionError) as caught:
        load_setup(sensor=assets_dir() / "sensors/short_range_25.toml", settings=["sensor.camera[1].tilt_deg='steep'"])
    assert "must be a valid number" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(DescriptionError, match="at least 1 item"):
        load_setup(settings=["sensor.camera=[]"])


def test_invalid_study_override_error() -> None:
    with pytest.raises(DescriptionError, match=r"^`settings` design.trials=-1: design.trials = -1: must be"):
        load_study(assets_dir() / "studies/vibration.toml", ["design.trials=-1"])


def test_invalid_file_error(tmp_path: Path) -> None:
    wrong = tmp_path / "sensor.toml"
    wrong.write_text("name = 1 2\n")
    with pytest.raises(DescriptionError, match=r"sensor.toml: not valid TOML.*line"):
        load_setup(sensor=wrong)
    with pytest.raises(DescriptionError, match=r"missing\.toml: no such file"):
        load_setup(cell=tmp_path / "missing.toml")
    with pytest.raises(DescriptionError, match="is a folder; expected a regular file"):
        load_setup(cell=tmp_path)
    wrong.write_bytes(b"\xff\xfe")
    with pytest.raises(DescriptionError, match="not valid TOML"):
        load_setup(sensor=wrong)


def test_invalid_robot_value_names_robot_file(tmp_path: Path) -> None:
    robot = (
        (assets_dir() / "robots/six_axis.toml").read_text().replace("max_speed_deg_s = 600.0", "max_speed_deg_s = 0")
    )
    (tmp_path / "arm.toml").write_text(robot)
    cell = (assets_dir() / "cells/default.toml").read_text().replace("../robots/six_axis.toml", "arm.toml")
    (tmp_path / "cell.toml").write_text(cell)
    with pytest.raises(
        DescriptionError, match=r"arm\.toml: joint\[6\]\.max_speed_deg_s = 0: must be greater than or equal to 0\.001"
    ):
        CellDescription.from_toml(tmp_path / "cell.toml")


def test_all_errors_of_file_are_listed(tmp_path: Path) -> None:
    text = (assets_dir() / "scans" / "default.toml").read_text()
    wrong = tmp_path / "scan.toml"
    wrong.write_text("max_profile = 3\nsettle_ms = -1\n" + text)
    with pytest.raises(DescriptionError) as caught:
        load_setup(scan=wrong)
    assert "scan.toml: max_profile: unknown key; did you mean 'max_profiles'?" in str(caught.value)
    assert "scan.toml: settle_ms = -1: must be greater than or equal to 0" in str(caught.value)


def test_ideal_disables_noise_only() -> None:
    noisy, ideal = load_setup(), load_setup(ideal=True)
    assert not ideal.sensor.render.noise
    assert all(j.encoder_noise_deg == j.encoder_resolution_deg == 0.0 for j in ideal.cell.robot.joint)
    assert ideal.sensor.detector == noisy.sensor.detector
    assert ideal.scan == noisy.scan


def test_setup_from_descriptions_and_files(tmp_path: Path) -> None:
    words = ["cell.table.radius_mm=100", "sensor.camera[2].tilt_deg=29.5", "scan.sweep.elevations_deg[2]=50"]
    defaults = (CellDescription.default(), SensorDescription.default(), ScanDescription.default())
    assert load_setup(*defaults, settings=words, ideal=True) == load_setup(
        settings=words[:2], ideal=True, scan=(ScanDescription.default().replace({"sweep.elevations_deg[2]": 50}))
    )
    with pytest.raises(DescriptionError, match=r"^`settings` scan.max_profiles=0: max_profiles = 0"):
        load_setup(*defaults, settings=["scan.max_profiles=0"])


def test_replace_returns_validated_copy() -> None:
    cell = CellDescription.default()
    changed = cell.replace({"part.x_mm": 20, "robot.joint[2].max_deg": 40, "part.material.preset": "matt_white"})
    assert (changed.part.x_mm, changed.robot.joint[1].max_deg) == (20.0, 40.0)
    assert changed.part.material is not None
    assert (cell.part.x_mm, cell.robot.joint[1].max_deg, cell.part.material) == (0.0, 45.0, None)
    assert changed.replace({"part.x_mm": 0, "robot.joint[2].max_deg": 45, "part.material": None}) == cell
    assert cell.table.replace(pose=PoseDescription(x_mm=1)).pose.x_mm == 1
    assert cell.replace({"table.pose": PoseDescription(x_mm=1), "table.pose.y_mm": 2}).table.pose.y_mm == 2


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"part.y_m": 1}, "part.y_m: unknown key; did you mean 'y_mm'?"),
        ({"part.x_mm": "left"}, "part.x_mm = 'left': must be a valid number"),
        ({"robot.joint[7].a_mm": 1}, "index [7] does not exist, there are 6"),
        ({"name.x": 1}, "'x' is not inside a table"),
        ({"table.platter_mesh": "absent.stl"}, "table.platter_mesh = 'absent.stl': no such file"),
    ],
)
def test_invalid_replacement_is_rejected(changes: dict[str, Any], expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        CellDescription.default().replace(changes)
    assert str(caught.value).startswith("CellDescription.replace")
    assert expected in str(caught.value)


@pytest.mark.parametrize("model", FILES, ids=lambda model: model.kind)
def test_written_description_round_trips(
    model: type[FileDescription], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    description = model.default()
    written = tmp_path / "new" / "file.toml"
    description.to_toml(written)
    moved = tmp_path / "moved.toml"
    written.replace(moved)
    monkeypatch.chdir(tmp_path)
    assert model.from_toml(moved) == description
    assert model.from_toml("moved.toml") == description
    again = moved.read_text()
    model.from_toml(moved).to_toml(moved)
    assert moved.read_text() == again


def test_meshes_below_written_file_stay_relative(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    (folder / "meshes").mkdir(parents=True)
    mesh = folder / "meshes" / "probe.stl"
    mesh.write_bytes((assets_dir() / "sensors/profile_probe.stl").read_bytes())
    CellDescription.default().replace(sensor_mesh=str(mesh)).to_toml(folder / "cell.toml")
    moved = folder.rename(tmp_path / "yours")
    read = CellDescription.from_toml(moved / "cell.toml")
    assert read.sensor_mesh == str(moved / "meshes" / "probe.stl")


def test_unwritable_file_raises_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        ScanDescription.default().to_toml(tmp_path / "file" / "scan.toml")


def test_copied_sample_cell_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("default", "pick_and_place"):
        sample = assets_dir() / "cells" / f"{name}.toml"
        Path("my.toml").write_bytes(sample.read_bytes())
        assert CellDescription.from_toml("my.toml") == CellDescription.from_toml(sample)
    robot = assets_dir() / "robots/six_axis.toml"
    Path("my_robot.toml").write_bytes(robot.read_bytes())
    assert RobotDescription.from_toml("my_robot.toml") == RobotDescription.default()


def test_local_mesh_takes_precedence(tmp_path: Path) -> None:
    (tmp_path / "cells").mkdir()
    (tmp_path / "sensors").mkdir()
    own = tmp_path / "sensors" / "profile_probe.stl"
    own.write_bytes(b"")
    file = tmp_path / "cells" / "cell.toml"
    file.write_bytes((assets_dir() / "cells/default.toml").read_bytes())
    cell = CellDescription.from_toml(file)
    assert cell.sensor_mesh == str(own)
    assert cell.robot == RobotDescription.default()


def test_missing_mesh_names_key_and_search_paths(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    text = (assets_dir() / "cells/default.toml").read_text()
    file.write_text(text.replace("../sensors/profile_probe.stl", "absent.stl"))
    with pytest.raises(DescriptionError) as caught:
        load_setup(file)
    places = f"{tmp_path / 'absent.stl'} and {assets_dir() / 'cells' / 'absent.stl'}"
    assert str(caught.value) == f"{file}: sensor_mesh = 'absent.stl': no such file; tried {places}"
    file.write_text(text.replace("../robots/six_axis.toml", "absent.toml"))
    with pytest.raises(DescriptionError, match=r"cell.toml: robot = 'absent.toml': no such file; tried .* and "):
        load_setup(file)


RUN = {"part": "part.stl", "as_built": ["tool.x_mm=0.1"], "seed": 3, "ideal": False, "threshold": None}


def test_resolved_file_round_trips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [
        "cell.part.x_mm=0.1",
        "sensor.camera[2].cx_px=600.25",
        'cell.part.material.preset="black_rubber"',
        "cell.light=[{kind='point', power_mw=3, in_band=0.5}]",
        "scan.pose=[{z_mm=100.1}]",
    ]
    setup = load_setup(assets_dir() / "cells/pick_and_place.toml", settings=words, ideal=True)
    (tmp_path / "out").mkdir()
    file = tmp_path / "out" / "resolved.toml"
    file.write_text(resolved_toml(setup, RUN))
    monkeypatch.chdir(tmp_path)
    read, run = load_resolved("out/resolved.toml")
    assert read == setup
    assert run == {key: value for key, value in RUN.items() if value is not None}
    assert load_setup(cell=file, sensor=file, scan=file) == setup
    assert load_setup(sensor=file).sensor == setup.sensor
    assert resolved_toml(read, run) == file.read_text()


def test_sectioned_file_requires_expected_section(tmp_path: Path) -> None:
    file = tmp_path / "resolved.toml"
    file.write_text(resolved_toml(load_setup(), RUN).replace("[sensor", "[other"))
    with pytest.raises(
        DescriptionError, match=r"resolved.toml: holds \[cell\], \[scan\]; expected a section \[sensor\]"
    ):
        load_setup(sensor=file)
    with pytest.raises(DescriptionError, match=r"default.toml: expected a section \[run\]"):
        load_resolved(assets_dir() / "cells/default.toml")
    file.write_text(resolved_toml(load_setup(), RUN).replace("settle_ms = 100.0", "settle_ms = -1"))
    with pytest.raises(DescriptionError, match=r"resolved.toml \[scan\]: settle_ms = -1: must be"):
        load_setup(scan=file)


def test_override_words_and_paths() -> None:
    assert parse_assignment("a.b=[1, 2]") == ("a.b", [1, 2])
    assert parse_assignment("mode=dynamic") == ("mode", "dynamic")
    assert split_path("camera[2].tilt_deg") == ["camera", 1, "tilt_deg"]
    assert join_path(["camera", 1, "tilt_deg"]) == "camera[2].tilt_deg"


def test_schemas_are_complete_and_strict() -> None:
    schemas = json_schemas()
    assert set(schemas) == {
        "cell",
        "robot",
        "sensor",
        "scan",
        "path",
        "artefact",
        "study",
        "batch",
        "format",
        "characteristics",
    }
    assert set(schemas["scan"]["properties"]) == set(ScanDescription.model_fields)
    assert all(schema["additionalProperties"] is False for schema in schemas.values())


def properties(node: Any, path: str) -> list[tuple[str, dict[str, Any]]]:
    """All properties of a schema and its definitions, with their paths."""
    if isinstance(node, list):
        return [found for item in node for found in properties(item, path)]
    if not isinstance(node, dict):
        return []
    own = [(f"{path}.{key}", value) for key, value in node.get("properties", {}).items()]
    return own + [found for key, value in node.items() for found in properties(value, f"{path}.{key}")]


@pytest.mark.parametrize("kind", sorted(json_schemas()))
def test_schema_properties_have_descriptions(kind: str) -> None:
    found = properties(json_schemas()[kind], kind)
    assert len(found) > 15
    assert [path for path, value in found if len(value.get("description", "")) < 8] == []


def numbers(node: Any, path: str) -> list[tuple[str, dict[str, Any]]]:
    """All schemas of numbers below a node of a schema, with their paths."""
    if isinstance(node, list):
        return [found for item in node for found in numbers(item, path)]
    if not isinstance(node, dict):
        return []
    is_free = node.get("type") in ("number", "integer") and not {"enum", "const"} & node.keys()
    own = [(path, node)] if is_free else []
    return own + [found for key, value in node.items() for found in numbers(value, f"{path}.{key}")]


@pytest.mark.parametrize("kind", [*sorted(json_schemas()), "link"])
def test_every_number_has_finite_bounds(kind: str) -> None:
    schema = LinkDescription.model_json_schema() if kind == "link" else json_schemas()[kind]
    # Marks of invalid points are compared, not computed with.
    found = [
        one
        for one in numbers(schema, kind)
        if not one[0].startswith("format.$defs.FormatDescription.properties.invalid.")
    ]
    assert len(found) > 10
    ends = {path: [[value.get(key) for key in pair] for pair in _ENDS] for path, value in found}
    assert [path for path, pairs in ends.items() if any(pair == [None, None] for pair in pairs)] == []
    assert max(abs(end) for pairs in ends.values() for pair in pairs for end in pair if end is not None) <= 1e15


@pytest.mark.parametrize("kind", sorted(json_schemas()))
def test_schema_files_are_up_to_date(kind: str) -> None:
    file = Path(__file__).resolve().parents[2] / "docs" / "schemas" / f"{kind}.schema.json"
    assert json.loads(file.read_text()) == json_schemas()[kind], "run: scancell schema"


def test_shipped_files_name_their_schema() -> None:
    kinds = {
        "cells": "cell",
        "exercises": "cell",
        "robots": "robot",
        "sensors": "sensor",
        "scans": "scan",
        "studies": "study",
    }
    for folder, kind in {**kinds, "batches": "batch", "artefacts": "artefact", "formats": "format"}.items():
        files = list((assets_dir() / folder).glob("*.toml"))
        assert files
        for file in files:
            schema = file.parent / file.read_text().splitlines()[0].removeprefix("#:schema ")
            assert schema.is_file()
            assert schema.name == f"{kind}.schema.json"


def test_config_imports_no_heavy_package() -> None:
    code = "import scancell.config.loading, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "scancell.config.cell" in loaded
    assert not loaded & {"scipy", "trimesh", "pyarrow", "matplotlib", "scancell.sensor"}
