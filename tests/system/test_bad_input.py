"""Bad input gets one clear message, a non-zero exit code, no traceback, and leaves nothing behind."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import PARTS, QUICK, Finished, scancell, scancell_here

SPHERE = PARTS / "sphere_on_foot.stl"


def refused(done: Finished, folder: Path, *before: str) -> str:
    """Check what every refusal has in common: nothing in `folder` but what was there `before`; its message."""
    assert done.code not in (0, 130), done
    assert "Traceback" not in done.err + done.out
    report = done.last_line
    assert report["ok"] is False
    assert set(report) == {"command", "ok", "error"}
    assert done.err.strip() == f"scancell: {done.message}"
    assert len(done.out.splitlines()) == 1
    assert sorted(path.name for path in folder.iterdir()) == sorted(before)
    return done.message


def scan(folder: Path, part: str | Path, *words: str | Path, out: str = "run") -> Finished:
    return scancell_here("scan", part, *QUICK, "--out", out, "--json", *words, cwd=folder)


# --- meshes ---------------------------------------------------------------------------------------------------------

TRIANGLE = "v 0 0 0\nv 10 0 0\nv 0 10 0\n"
PLY_HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)
BROKEN = {
    "text.stl": ("these are words, not triangles\n", ["text.stl"]),
    "words.obj": ("once upon a time\n", ["words.obj", "no"]),
    "zero.stl": ("", ["zero.stl", "empty"]),
    "no_faces.obj": (TRIANGLE, ["no_faces.obj", "no triangles"]),
    "nan.obj": (TRIANGLE + "v nan 0 1\nf 1 2 4\nf 1 2 3\n", ["nan.obj", "vertex 3", "nan"]),
    "range.obj": (TRIANGLE + "f 1 2 9\n", ["range.obj", "face 0", "8", "0 to 2"]),
    "range.ply": (PLY_HEADER + "0 0 0\n10 0 0\n0 10 0\n3 0 1 7\n", ["range.ply"]),
    "nan.ply": (PLY_HEADER + "0 0 0\n10 nan 0\n0 10 0\n3 0 1 2\n", ["nan.ply", "nan"]),
    "part.step": ("ISO-10303-21;\n", ["part.step", "no STEP data"]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_mesh(tmp_path, name) -> None:
    content, expected = BROKEN[name]
    (tmp_path / name).write_text(content)
    message = refused(scan(tmp_path, name), tmp_path, name)
    for word in expected:
        assert word in message


@pytest.mark.parametrize("run", [scancell, scancell_here])
def test_missing_mesh(tmp_path, run) -> None:
    done = run("scan", "gone.stl", "--json", "--out", "run", cwd=tmp_path)
    assert refused(done, tmp_path) == "gone.stl: no such file"
    assert done.code == 1


def test_unknown_unit(tmp_path) -> None:
    message = refused(scan(tmp_path, SPHERE, "--unit", "cm"), tmp_path)
    assert "cm" in message
    assert "mm, m" in message


def test_part_too_large_for_table(tmp_path) -> None:
    trimesh.creation.box((400.0, 300.0, 20.0)).export(tmp_path / "plate.stl")
    message = refused(scan(tmp_path, "plate.stl"), tmp_path, "plate.stl")
    # Half the diagonal is 250 mm, the table's radius 120 mm.
    assert "too large for the table" in message
    assert "250.0 mm" in message
    assert "130.0 mm beyond" in message


@pytest.mark.parametrize("command", [("plan", "--set", "scan.coverage.enabled=true"), ("place",)])
def test_plan_and_place_of_part_too_large_for_table(tmp_path, command) -> None:
    trimesh.creation.box((400.0, 300.0, 250.0)).export(tmp_path / "crate.stl")
    name, *words = command
    message = refused(scancell_here(name, "crate.stl", *words, "--json", cwd=tmp_path), tmp_path, "crate.stl")
    assert "crate.stl: too large for the table" in message


def test_part_too_tall(tmp_path) -> None:
    trimesh.creation.box((60.0, 60.0, 900.0)).export(tmp_path / "mast.stl")
    words = ("--engine", "geometric", "--ideal", "--set", "scan.max_profiles=1300", "--out", "run", "--json")
    message = refused(scancell_here("scan", "mast.stl", *words, cwd=tmp_path), tmp_path, "mast.stl")
    print(message)
    assert "reach" in message or "hits" in message or "outside its limits" in message
    assert any(unit in message for unit in (" mm", " deg"))


# --- descriptions ---------------------------------------------------------------------------------------------------


def test_unknown_key(tmp_path) -> None:
    (tmp_path / "my_scan.toml").write_text('mode = "dynamic"\n[sweep]\nelevation_deg = [30]\n')
    message = refused(scan(tmp_path, SPHERE, "--scan", "my_scan.toml"), tmp_path, "my_scan.toml")
    assert "my_scan.toml" in message
    assert "sweep.elevation_deg" in message
    assert "elevations_deg" in message


def test_value_out_of_bounds(tmp_path) -> None:
    message = refused(scan(tmp_path, SPHERE, "--set", "sensor.detector.quantum_efficiency=1.5"), tmp_path)
    assert "detector.quantum_efficiency = 1.5" in message
    assert "less than or equal to 1" in message


def test_invalid_toml(tmp_path) -> None:
    (tmp_path / "cell.toml").write_text("name = \n")
    message = refused(scan(tmp_path, SPHERE, "--cell", "cell.toml"), tmp_path, "cell.toml")
    assert "cell.toml" in message
    assert "line 1" in message


@pytest.mark.parametrize("option", ["--cell", "--sensor", "--scan"])
def test_missing_description(tmp_path, option) -> None:
    assert refused(scan(tmp_path, SPHERE, option, "gone.toml"), tmp_path) == "gone.toml: no such file"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--set", "scan.max_profile=3"), ["max_profile", "did you mean 'max_profiles'"]),
        (("--set", "nonsense"), ["nonsense", "key=value"]),
        (("--set", "robot.name=3"), ["robot.name", "cell, sensor, scan"]),
        (("--as-built", "tool.x_cm=1"), ["tool.x_cm", "tool.x_mm"]),
        (("--as-built", "tool.x=1"), ["tool.x", "tool.x_mm"]),
        (("--as-built", "tool.x_mm=nan"), ["tool.x_mm", "finite"]),
        (("--set", 'scan.mode="sideways"'), ["mode", "sideways", "'dynamic' or 'stop-and-look'"]),
    ],
)
def test_invalid_option_value(tmp_path, words, expected) -> None:
    message = refused(scan(tmp_path, SPHERE, *words), tmp_path)
    for word in expected:
        assert word in message


def test_error_leaves_no_parent_folders(tmp_path) -> None:
    refused(scan(tmp_path, "gone.stl", out="a/b/run"), tmp_path)


# --- places and paths -----------------------------------------------------------------------------------------------


def test_output_is_a_file(tmp_path) -> None:
    (tmp_path / "taken").write_text("mine")
    message = refused(scan(tmp_path, SPHERE, out="taken"), tmp_path, "taken")
    assert "taken" in message
    assert (tmp_path / "taken").read_text() == "mine"


def test_output_below_a_file(tmp_path) -> None:
    (tmp_path / "taken").write_text("mine")
    message = refused(scan(tmp_path, SPHERE, out="taken/run"), tmp_path, "taken")
    assert "taken" in message
    assert "cannot be written" in message


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is unwritable for root")
def test_output_without_permission(tmp_path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    assert "Permission denied" in refused(scan(tmp_path, SPHERE, out="locked/run"), tmp_path, "locked")


def test_output_in_read_only_folder(tmp_path) -> None:
    """/proc takes no new folders, not even from root."""
    message = refused(scan(tmp_path, SPHERE, out="/proc/scancell/run"), tmp_path)
    assert "/proc/scancell" in message
    assert "cannot be written" in message


def write_poses(folder: Path, *poses: str) -> str:
    (folder / "poses.toml").write_text("".join(f"[[pose]]\n{pose}\n" for pose in poses))
    return "poses.toml"


def test_unreachable_poses(tmp_path) -> None:
    good = "z_mm = 150.0\nrx_deg = 180.0"
    file = write_poses(tmp_path, good, "x_mm = 3000.0\nz_mm = 100.0\nrx_deg = 180.0", good)
    message = refused(scan(tmp_path, SPHERE, "--scan", file), tmp_path, file)
    assert "pose 2" in message
    assert "pose 1" not in message
    assert "pose 3" not in message
    assert "reach" in message
    # The shoulder is 0.335 m up at 75 mm from the base axis; how far off the pose is follows from that.
    missing = float(message.split("by ")[-1].split(" mm")[0])
    wanted = np.hypot(3000.0 + 450.0, 0.0) - (75 + 270 + np.hypot(90, 295))
    assert 0 < missing == pytest.approx(wanted, rel=0.35)


def test_colliding_pose(tmp_path) -> None:
    file = write_poses(tmp_path, "z_mm = 20.0\nrx_deg = 180.0")
    message = refused(scan(tmp_path, SPHERE, "--scan", file), tmp_path, file)
    assert "pose 1" in message
    assert "hits part" in message or "part hits" in message or "hits table" in message


@pytest.mark.parametrize("pose", ["1,2,3", "a,b,c,d,e,f", "0,0,nan,0,0,0"])
def test_shot_requires_six_numbers(tmp_path, pose) -> None:
    message = refused(scancell_here("shot", SPHERE, "--pose", pose, "--out", "run", "--json", cwd=tmp_path), tmp_path)
    assert "--pose" in message


def test_render_requires_recording(tmp_path) -> None:
    (tmp_path / "table.csv").write_text("time,q\n1,2\n")
    for name, word in {"gone.csv": "no such file", "table.csv": "columns are missing"}.items():
        done = scancell_here("render", name, SPHERE, "--out", "run", "--json", cwd=tmp_path)
        assert word in refused(done, tmp_path, "table.csv")


def test_shot_and_render_accept_sensor_perturbations_only(tmp_path) -> None:
    (tmp_path / "table.csv").write_text("time,q\n1,2\n")
    for command in (("shot", SPHERE, "--pose", "0,0,130,180,0,0"), ("render", "table.csv", SPHERE)):
        done = scancell_here(*command, "--as-built", "tool.x_mm=0.1", "--out", "run", "--json", cwd=tmp_path)
        message = refused(done, tmp_path, "table.csv")
        assert "tool.x_mm=0.1" in message
        assert "sensor." in message


def test_fmu_info_requires_fmu(tmp_path) -> None:
    (tmp_path / "thing.fmu").write_text("no zip")
    for name, word in {"gone.fmu": "no such file", "thing.fmu": "not a readable FMU"}.items():
        assert word in refused(scancell_here("fmu", "info", name, "--json", cwd=tmp_path), tmp_path, "thing.fmu")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("scan",), "part"),
        (("scan", "x.stl", "--seed", "-3"), "--seed"),
        (("scan", "x.stl", "--no-such"), "--no-such"),
        (("scan", "x.stl", "--engine", "magic"), "magic"),
        (("scan", "x.stl", "--mode", "sideways"), "sideways"),
        (("fmu", "build", "--seed", "x"), "--seed"),
        (("sacn",), "sacn"),
    ],
)
def test_usage_error(tmp_path, words, expected) -> None:
    done = scancell_here(*words, "--json", cwd=tmp_path)
    assert done.code == 2
    assert "Traceback" not in done.err
    assert expected in done.err
    assert done.last_line["ok"] is False
    assert expected in done.message
    assert not list(tmp_path.iterdir())
