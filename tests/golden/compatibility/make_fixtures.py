"""Make small files of every kind that scancell writes, by the installed version, for tests of later versions.

    python tests/golden/compatibility/make_fixtures.py FOLDER

Never overwrites a set: files of an older version are made once, by that version.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet

import scancell
from scancell.config.files import assets_dir

_HERE = Path(__file__).parent
sys.path.insert(0, str(_HERE.parents[1] / "fmu"))

from cell_fixture import CYCLE_US, CellFmu, write_fmu  # noqa: E402

# Absolute paths in text files; tests put the present folders in their places.
PLACES = {"@ASSETS@": assets_dir(), "@SET@": Path()}
_TEXT = {".toml", ".json", ".csv"}
_DROPPED = ("deviation.png", "deviation.html", "residuals.png", "distances.png", "report.html", "profile_*.png")

# A step with a slope, no symmetry: outline in x and z, mm; extruded along y.
_OUTLINE = ((0.0, 0.0), (36.0, 0.0), (36.0, 8.0), (20.0, 12.0), (20.0, 18.0), (0.0, 18.0))
_WIDTH = 24.0

# Few pixels, eight times as large as those of the shipped sensor, under a thicker sheet.
_SENSOR = """
name = "coarse_probe"
[laser]
wavelength_nm = 660.0
power_mw = 0.2
fan_half_angle_deg = 16.0
sheet_sigma_mm = 0.35
waist_z_mm = 120.0
[range]
near_mm = 75.1
far_mm = 165.0
[[camera]]
name = "plus"
side = 1
baseline_mm = 60.0
tilt_deg = 29.3
half_angle_deg = 9.34
width_px = 64
height_px = 128
f_number = 11.0
pixel_pitch_um = 40.0
transmission = 0.8
[[camera]]
name = "minus"
side = -1
baseline_mm = 60.0
tilt_deg = 29.3
half_angle_deg = 9.34
width_px = 64
height_px = 128
f_number = 11.0
pixel_pitch_um = 40.0
transmission = 0.8
[detector]
exposure_ms = 0.5
quantum_efficiency = 0.55
full_well_e = 11000.0
read_noise_e = 5.0
dark_current_e_per_s = 20.0
gain_dn_per_e = 0.0225
bit_depth = 8
black_level_dn = 4.0
prnu = 0.005
dsnu_e = 1.0
[geometric]
rays = 300
"""
# The shipped arm and table without meshes: nothing that a later version may change is named.
_CELL = """
name = "bare_cell"
[robot]
name = "six_axis"
home_deg = [35.0, -60.0, 185.0, 0.0, 55.0, 0.0]
{joints}
[tool.fixture]
plate_mm = 10.0
reach_mm = 70.0
[table]
pose = {{ x_mm = 450.0, z_mm = 100.0 }}
radius_mm = 120.0
thickness_mm = 20.0
max_speed_deg_s = 180.0
max_acceleration_deg_s2 = 360.0
encoder_resolution_deg = 0.0002
[part]
x_mm = 12.0
y_mm = -7.0
rz_deg = 20.0
"""
_JOINTS = (
    (75.0, 335.0, -90.0, -170.0, 170.0, 328.0),
    (270.0, 0.0, 0.0, -190.0, 45.0, 300.0),
    (-90.0, 0.0, 90.0, -29.0, 256.0, 375.0),
    (0.0, 295.0, -90.0, -190.0, 190.0, 375.0),
    (0.0, 0.0, 90.0, -120.0, 120.0, 375.0),
    (0.0, 80.0, 0.0, -360.0, 360.0, 600.0),
)
_SCAN = """
mode = "dynamic"
max_profiles = 12
[sweep]
enabled = false
[raster]
pitch_mm = 5.0
speed_mm_s = 80.0
"""
_POSES = """
mode = "stop-and-look"
[[pose]]
z_mm = 110.0
x_mm = 10.0
y_mm = 12.0
rx_deg = 180.0
[[pose]]
x_mm = 28.0
y_mm = 60.0
z_mm = 105.0
rx_deg = 150.0
[[pose]]
x_mm = 60.0
y_mm = 12.0
z_mm = 105.0
rx_deg = 180.0
ry_deg = 25.0
"""
_STUDY = """
name = "compatibility"
part = "part.stl"
cell = "cell.toml"
sensor = "sensor.toml"
scan = "scan.toml"
engine = "geometric"
coverage_samples = 200
seed = 5
[design]
kind = "monte_carlo"
trials = 3
[[factor]]
path = "as_built.tool.x_mm"
distribution = { kind = "normal", std = 0.05 }
[[factor]]
path = "cell.part.reflectance"
mode = "relative"
distribution = { kind = "uniform", low = -0.2, high = 0.2 }
"""
_BATCH = """
cell = "cell.toml"
sensor = "sensor.toml"
scan = "scan.toml"
engine = "geometric"
formats = ["npz"]
seed = 6
[design]
kind = "latin_hypercube"
trials = 2
[[factor]]
path = "as_built.tool.x_mm"
distribution = { kind = "uniform", low = 0.05, high = 0.2 }
"""
_BALLS = """
name = "three_balls"
[[shape]]
name = "ball1"
kind = "sphere"
diameter_mm = 40.0
pose = { x_mm = -45.0, y_mm = -20.0, z_mm = 30.0 }
[[shape]]
name = "ball2"
kind = "sphere"
diameter_mm = 40.0
pose = { x_mm = 40.0, y_mm = -30.0, z_mm = 40.0 }
[[shape]]
name = "ball3"
kind = "sphere"
diameter_mm = 40.0
pose = { x_mm = 10.0, y_mm = 45.0, z_mm = 25.0 }
"""
_PROGRAM = '''"""A line over the part, and a turn of the table."""

from scancell import Robot, deg, location, mm


def main(robot: Robot) -> None:
    """Scan and turn."""
    robot.move_tool(location(450 * mm, 5 * mm, 215 * mm, rx=180 * deg))
    robot.scan_line(location(470 * mm, 5 * mm, 215 * mm, rx=180 * deg), spacing=4 * mm)
    robot.turn_table(30 * deg)
'''
_DESCRIBED = ("--cell", "cell.toml", "--sensor", "sensor.toml", "--scan", "scan.toml")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="new folder of the set, named by the version")
    target = parser.parse_args().folder.resolve()
    if target.exists():
        parser.error(f"{target} exists: a set is made once, by the version of its name")
    with tempfile.TemporaryDirectory(prefix="scancell-") as name:
        folder = Path(name).resolve()
        _write_inputs(folder)
        _write_runs(folder)
        _write_states(folder)
        _neutralize(folder)
        shutil.copytree(folder, target)


def _run(folder: Path, *words: str) -> None:
    command = [sys.executable, "-c", "from scancell.cli import main; main()", *words]
    print("scancell", *words, flush=True)
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}")


def _write_inputs(folder: Path) -> None:
    _write_part(folder / "part.stl")
    (folder / "parts").mkdir()
    shutil.copy(folder / "part.stl", folder / "parts" / "part.stl")
    keys = ("a_mm", "d_mm", "alpha_deg", "min_deg", "max_deg", "max_speed_deg_s")
    joints = [[f"{key} = {value}" for key, value in zip(keys, row, strict=True)] for row in _JOINTS]
    fixed = ["max_acceleration_deg_s2 = 1000.0", "encoder_resolution_deg = 0.0002"]
    tables = ["\n".join(["[[robot.joint]]", *own, *fixed]) for own in joints]
    texts = {
        "sensor.toml": _SENSOR,
        "cell.toml": _CELL.format(joints="\n".join(tables)),
        "scan.toml": _SCAN,
        "poses.toml": _POSES,
        "balls.toml": _BALLS,
        "program.py": _PROGRAM,
        "study.toml": _STUDY,
        "batch.toml": _BATCH,
    }
    for name, text in texts.items():
        (folder / name).write_text(text.lstrip())


def _write_part(path: Path) -> None:
    count = len(_OUTLINE)
    near, far = ([(x, y, z) for x, z in _OUTLINE] for y in (0.0, _WIDTH))
    faces = []
    for i in range(count):
        k = (i + 1) % count
        faces += [(near[i], near[k], far[k]), (near[i], far[k], far[i])]
    for a, b, c in ((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)):
        faces += [(near[c], near[b], near[a]), (far[a], far[b], far[c])]
    # The outline turns clockwise seen from -y, so that the faces above point inwards: turn all.
    corners = np.array([face[::-1] for face in faces])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    record = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["normal"], record["corners"] = normals / np.linalg.norm(normals, axis=1, keepdims=True), corners
    path.write_bytes(b"\0" * 80 + np.uint32(len(record)).tobytes() + record.tobytes())


def _write_runs(folder: Path) -> None:
    geometric = ("--engine", "geometric", "--as-built", "tool.x_mm=0.1", "--seed", "3")
    _run(folder, "plan", "part.stl", *_DESCRIBED, "--out", "plan.json")
    _run(folder, "scan", "part.stl", *_DESCRIBED, *geometric, "--out", "scan_geometric", "--format", "ply,npz")
    poses = ("--cell", "cell.toml", "--sensor", "sensor.toml", "--scan", "poses.toml")
    _run(folder, "scan", "part.stl", *poses, "--images", "--seed", "4", "--out", "scan_ray_traced")
    words = ("max_profiles=8", "raster.enabled=false", "sweep.elevations_deg=[45]", "sweep.speed_deg_s=170")
    shipped = [item for word in words for item in ("--set", f"scan.{word}")]
    _run(
        folder, "scan", "part.stl", *shipped, "--sensor", "sensor.toml", "--engine", "geometric", "--out", "scan_sweep"
    )
    recording = scancell.read_recording(folder / "scan_geometric" / "recording.parquet")
    recording.save(folder / "recording.csv")
    words = ("--part", "part.stl", "--engine", "geometric", "--seed", "9", "--out", "program_run")
    _run(folder, "run", "program.py", *_DESCRIBED[2:4], *words)
    _run(folder, "study", "run", "study.toml", "--out", "study", "--shard", "1/1")
    # One of three trials is left to be finished by whoever resumes.
    shutil.rmtree(sorted((folder / "study" / "tasks").iterdir())[-1])
    _run(folder, "batch", "parts", "--config", "batch.toml", "--out", "batch", "--shard", "1/1")
    _run(
        folder,
        *("calibrate", "tool", "cell.toml", "--artefact", "balls.toml", "--sensor", "sensor.toml", "--poses", "8"),
        *("--as-built", "tool.x_mm=0.3", "--as-built", "tool.rz_deg=0.1", "--seed", "7", "--out", "calibration"),
    )
    _run(folder, "calibrate", "sensor", "sensor.toml", "--seed", "7", "--out", "sensor_calibration")
    _write_measurements(folder)
    _run(
        folder,
        *("reconstruct", "points.csv", "--part", "part.stl", "--cell", "cell.toml", "--sensor", "sensor.toml"),
        *("--out", "reconstruction"),
    )
    _run(folder, "guard", "check", "part.stl", "--runs", "6", "--seed", "2", "--out", "guard", "--workers", "1")


def _write_measurements(folder: Path) -> None:
    """Points and joints of a run as a real cell would leave them."""
    recording = scancell.read_recording(folder / "scan_geometric" / "recording.parquet").measured
    points = pyarrow.parquet.read_table(folder / "scan_geometric" / "profiles.parquet")
    points = points.take(np.arange(0, len(points), 3))
    row = np.searchsorted(recording.index, points.column("profile").to_numpy())
    columns = {"exposure": recording.index[row]}
    columns |= {f"q{i}_deg": column[row] for i, column in enumerate(np.degrees(recording.q).T, 1)}
    columns |= {f"qd{i}_deg_s": column[row] for i, column in enumerate(np.degrees(recording.rates[:, :6]).T, 1)}
    columns |= {
        "table_deg": np.degrees(recording.table)[row],
        "table_rate_deg_s": np.degrees(recording.rates[:, 6])[row],
    }
    columns |= {name: points.column(name).to_numpy().astype(float) for name in ("x_mm", "y_mm", "z_mm")}
    pyarrow.csv.write_csv(pyarrow.table(columns), folder / "points.csv")


def _write_states(folder: Path) -> None:
    """FMU of the shipped cell with a free part, at a time within a motion: its state, and its values then and later."""
    out = folder / "fmu"
    out.mkdir()
    settings = {"cell.part.fixture": "free", "cell.part.x_mm": 12.0, "cell.contact.cell_bodies": False}
    setup = scancell.load_setup(settings=settings)
    nominal = scancell.nominal_cell(setup.cell, scancell.load_part(folder / "part.stl"))
    description = json.loads(
        json.dumps(scancell.cell_json(setup.cell, nominal, seed=8, collision_outputs=False), default=_plain)
    )
    (out / "cell.json.gz").write_bytes(gzip.compress(json.dumps(description).encode(), mtime=0))
    for version in (2, 3):
        cell = CellFmu(write_fmu(description, version, folder / f"unpacked{version}"))
        start = cell.vector("measured.q", 6)
        cell.trigger(2, 0.05, exposure=0.003)
        for k in range(60):
            cell.command(start + 0.1 * np.sin(0.1 * k), 0.02 * k)
            cell.step(CYCLE_US)
        cell.step(250)
        state = cell.save()
        (out / f"fmi{version}.state").write_bytes(cell.serialize(state))
        facts = {"token": cell.description.guid, "time_us": cell.time_us, "before": _values(cell)}
        cell.step(CYCLE_US, 10)
        facts["after_10_cycles"] = _values(cell)
        (out / f"fmi{version}.json").write_text(json.dumps(facts, indent=1) + "\n")
        cell.free_state(state)
        cell.close()
        shutil.rmtree(folder / f"unpacked{version}")


def _values(cell: CellFmu) -> dict[str, float]:
    """What is measured and true, and the present trigger record."""
    names = [
        name
        for name, variable in cell.variables.items()
        if variable.type in {"Real", "Float64"} and name.startswith(("measured.", "truth.", "trigger."))
    ]
    return dict(zip(names, cell.get(*names).tolist(), strict=True))


def _plain(value: np.ndarray) -> object:
    return value.tolist()


def _neutralize(folder: Path) -> None:
    """Drop drawings, and put marks in the places of absolute paths."""
    for path in [path for path in folder.rglob("*") if path.is_file()]:
        if any(path.match(pattern) for pattern in _DROPPED):
            path.unlink()
        elif path.suffix in _TEXT and not {"study", "batch"} & {*path.relative_to(folder).parts}:  # they hold checksums
            text = path.read_text()
            for mark, place in {**PLACES, "@SET@": folder}.items():
                text = text.replace(str(place), mark)
            path.write_text(text)
    os.sync()


if __name__ == "__main__":
    main()
