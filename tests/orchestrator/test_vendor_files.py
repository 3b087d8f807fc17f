"""Files of profiles and poses in the forms of manuals and public repositories, each to a cloud by one command.

All files are made here; the forms are those of the sources in docs/how_to/own_profiles.md. Expected points are
calculated from the numbers by matrices of this module.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from typer.testing import CliRunner

import scancell
from scancell.cli import app
from scancell.config.table_format import read_format, shipped_formats
from scancell.errors import DescriptionError
from scancell.geometry.orientation import CONVENTIONS
from scancell.nominal.cell import nominal_cell

X = np.array([-4.0, -2.0, 0.0, 2.5, 4.0, 6.0, 8.0, 10.0, 12.0])  # mm along the profile
Z = np.array([[np.nan, 101.5, 102.0, 102.25, np.nan, 101.0, 100.5, 99.75, 99.0],
              [100.0, 101.0, 103.0, 102.5, 101.25, np.nan, 100.25, 99.5, 98.75],
              [99.5, 100.5, 101.75, 102.75, 101.5, 101.125, np.nan, 99.25, 98.5]])  # fmt: skip
POSITIONS = np.array([[812.25, -103.5, 640.125], [790.5, 12.75, 655.0], [805.0, 98.25, 610.5]])  # mm
ANGLES = np.array([[10.5, -20.25, 170.0], [-35.0, 12.5, -160.25], [80.125, 5.0, 155.5]])  # deg


def turn(axis: str, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def rotations(order: str) -> list[np.ndarray]:
    """Rotations (3, 3) by each of the `ANGLES` about moving axes in an order."""
    return [turn(order[0], a) @ turn(order[1], b) @ turn(order[2], c) for a, b, c in ANGLES]


def quaternion(matrix: np.ndarray) -> list[float]:
    """W, x, y, z by the eigenvector of the matrix and the sense of the turn."""
    values, vectors = np.linalg.eig(matrix)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1))])
    skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    angle = np.arctan2(axis @ skew, np.trace(matrix) - 1)
    return [float(np.cos(angle / 2)), *(np.sin(angle / 2) * axis).tolist()]


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    w, *v = quaternion(matrix)
    return np.array(v) / np.linalg.norm(v) * 2 * np.arctan2(np.linalg.norm(v), w)


def reconstruct(folder: Path, *words: object) -> tuple[np.ndarray, str]:
    """Points of the cloud, mm, and the output of the command."""
    done = CliRunner().invoke(app, ["reconstruct", *map(str, words), "--out", str(folder / "out")])
    assert done.exit_code == 0, done.output
    return 1e3 * scancell.Cloud.load(folder / "out" / "cloud.ply").points_in_part, " ".join(done.output.split())


def require_points(found: np.ndarray, expected: np.ndarray) -> None:
    assert len(found) == len(expected)
    assert cKDTree(found).query(expected)[0].max() < 1e-3  # mm; sources state 1e-3 mm and less
    assert cKDTree(expected).query(found)[0].max() < 1e-3


def surface(y: np.ndarray, z: np.ndarray = Z, x: np.ndarray = X) -> np.ndarray:
    """Points of profiles at positions y of the travel."""
    grid = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y[:, None], z.shape), z], -1).reshape(-1, 3)
    return grid[np.isfinite(grid).all(1)]


def text(value: float, missing: str = "") -> str:
    return missing if np.isnan(value) else f"{value:.5f}"


def scancontrol(separator: str = ";", decimal: str = ",", heading: str = "Profile") -> str:
    rows = [f"{i}{separator}{a:.3f}{separator}{text(b, '0.000')}" for i, z in enumerate(Z, 1)
            for a, b in zip(X, z, strict=True)]  # fmt: skip
    header = separator.join([heading, "X [mm]", "Z [mm]"])
    return "Device" + separator + "LLT2900-50\n\n" + header + "\n" + "\n".join(rows).replace(".", decimal) + "\n"


def gocator(section: str) -> str:
    head = ["Info", "CSV Version,Sensor Count,Trigger Mode,ZResolution", "2,1,0,0.00300", "End", "",
            "DeviceInfo", "ID,Model,Version", "40959,313109A-LED-B-01,5.1.6.79", "End", "", section]  # fmt: skip
    stamp = "{},0,5448204247{},{},0,0,46928.000,{:.5f},{}"
    if section == "Part":
        head += ["Frame,Source,Time,Encoder,Z Encoder,Inputs,Row Count,Column Count,X Offset,Y Offset,Z Offset",
                 f"1,0,544820424776,0,0,0,{len(Z)},{len(X)},-4.0,0.0,1.694",
                 "Y\\X," + ",".join(text(x) for x in X)]  # fmt: skip
        return "\n".join([*head, *(f"{0.5 * i:.5f}," + ",".join(map(text, z)) for i, z in enumerate(Z)), "End\n"])
    names = [text(x) for x in X] if section == "Profile" else [str(i) for i in range(len(X))]
    head += ["Frame Count,Column Count,X Offset,Y Offset,Z Offset", f"{len(Z)},{len(X)},0,0,0",
             "Frame,Source,Time,Encoder,Z Encoder,Inputs,Exposure,Y,Axis," + ",".join(names)]  # fmt: skip
    rows = []
    for i, z in enumerate(Z):
        kinds = [("X", X)] * (section == "RawProfile") + [("Z", z), ("I", np.arange(9.0))]
        rows += [",".join([stamp.format(i, i, 100 * i, 0.5 * i, kind), *map(text, v)]) for kind, v in kinds]
    return "\n".join([*head, *rows, "End", ""])


def opencv(z: np.ndarray, name: str = "scan_line", more: str = "") -> str:
    numbers = [f"{n:.8e}" if np.isfinite(n) else ".Nan" for x, h in zip(X, z, strict=True) for n in (x, 0.0, h)]
    lines = ["    " + ", ".join(numbers[i : i + 4]) for i in range(0, len(numbers), 4)]
    return f"%YAML:1.0\n---\n{name}: [ " + ",\n".join(lines).strip() + " ]\n" + more


def own_format(folder: Path, body: str) -> Path:
    (folder / "format.toml").write_text("[format]\n" + body)
    return folder / "format.toml"


STEP = np.array([0.0, 0.5, 1.0])


def keyence_tsv() -> str:
    def count(value: float) -> str:
        return "-2147483648" if np.isnan(value) else f"{round(1e5 * value)}"

    return "\n".join("\t".join([count(x), *map(count, z)]) for x, z in zip(X, Z.T, strict=True)) + "\n"


def keyence_csv() -> str:
    return "\n".join("".join(f"{-999.9999 if np.isnan(v) else v - 100:.4f}," for v in z) for z in Z) + "\n"


def counts(scale: float, offset: float) -> np.ndarray:
    """Image of 16 bits."""
    return np.where(np.isnan(Z), 0, np.round((Z - offset) / scale)).astype(np.uint16)


EVEN = np.arange(9) * 0.2 - 0.8
PITCHES = "x = { pitch_mm = 0.2, offset_mm = -0.8 }\ny = { pitch_mm = 0.5 }\n"


def test_shipped_formats_state_their_source() -> None:
    formats = shipped_formats()
    assert len(formats) >= 8
    assert all(form.source for form in formats.values())


@pytest.mark.parametrize("section", ["Part", "Profile", "RawProfile"])
def test_gocator_csv(tmp_path, section) -> None:
    (tmp_path / "replay.csv").write_text(gocator(section))
    found, said = reconstruct(tmp_path, tmp_path / "replay.csv")
    require_points(found, surface(STEP))
    assert ("matrix of heights" if section == "Part" else "taken for LMI Gocator") in said
    assert "4 without a height" in said


def test_scancontrol_csv_with_encoder_counts(tmp_path) -> None:
    """The travel by counts, which turn opposite to the axis; time stamps and intensity are columns like others."""
    rows = "".join(f"{1000 + 250 * i};{x};{z if np.isfinite(z) else 0.0};{200 + i};{0.01 * i:.2f}\n".replace(".", ",")
                   for i, h in enumerate(Z) for x, z in zip(X, h, strict=True))  # fmt: skip
    (tmp_path / "p.csv").write_text("Encoder;X [mm];Z [mm];Intensity;Time [s]\n" + rows)
    form = own_format(
        tmp_path,
        'name = "counts"\nlayout = "points"\ninvalid = [0]\nprofile_column = "encoder"\n'
        'intensity_column = "intensity"\n'
        'time_column = "time_s"\nx = { column = "x_mm" }\nz = { column = "z_mm" }\n'
        'y = { column = "encoder", scale_mm = -0.002, offset_mm = 2.0 }\n',
    )
    found, _ = reconstruct(tmp_path, tmp_path / "p.csv", "--table-format", form)
    require_points(found, surface(-STEP))


@pytest.mark.parametrize(
    ("preset", "suffix", "write", "more", "y", "z", "x"),
    [
        ("keyence_ljv_tsv", "tsv", keyence_tsv, "y = { pitch_mm = 0.5 }\n", STEP, Z, X),
        ("keyence_ljx_csv", "csv", keyence_csv, PITCHES, STEP, Z - 100, EVEN),
        ("keyence_ljx_tiff", "tif", lambda: counts(0.0016, 0.0 - 52.4288 + 100), PITCHES, STEP, Z - 100, EVEN),
        ("range_image_16bit", "png", lambda: counts(0.005, 90.0),
         PITCHES + "z = { scale_mm = 0.005, offset_mm = 90.0 }\n", STEP, Z, EVEN),
    ],
)  # fmt: skip
def test_heights_with_pitches_of_an_own_file(tmp_path, preset, suffix, write: Callable, more, y, z, x) -> None:
    file = tmp_path / f"heights.{suffix}"
    content = write()
    if isinstance(content, str):
        file.write_text(content)
    else:
        cv2.imwrite(str(file), content)
    form = own_format(tmp_path, f'preset = "{preset}"\n{more}')
    found, said = reconstruct(tmp_path, file, "--table-format", form)
    expected = surface(y, z, x)
    assert len(found) == len(expected)
    assert cKDTree(found).query(expected)[0].max() < 2.6e-3  # half a step of 16 bits
    assert f"taken for {read_format(preset).name}" in said


def folder_of_profiles(folder: Path) -> Path:
    """p1.yml, p2.yml and p10.yml beside another file."""
    (folder / "scans").mkdir()
    for number, z in zip((1, 2, 10), Z, strict=True):
        (folder / "scans" / f"p{number}.yml").write_text(opencv(z))
    (folder / "scans" / "notes.txt").write_text("ball of 25 mm\n")
    return folder / "scans"


def base_points(flange: list[np.ndarray]) -> np.ndarray:
    """Points of the profiles in the base, mm, with rotations of the flange at `POSITIONS`."""
    mounted = nominal_cell(scancell.load_setup().cell, None).flange_from_sensor
    points = []
    for turn_, position, z in zip(flange, POSITIONS, Z, strict=True):
        in_sensor = np.stack([np.zeros(len(X)), X, z], -1)[np.isfinite(z)]
        in_flange = in_sensor @ mounted[:3, :3].T + 1e3 * mounted[:3, 3]
        points.append(in_flange @ turn_.T + position)
    return np.concatenate(points)


def each(row: Callable[[int, np.ndarray, np.ndarray], str]) -> str:
    return "".join(row(i, p, a) for i, (p, a) in enumerate(zip(POSITIONS, ANGLES, strict=True), 1))


FIXED = [turn("z", c) @ turn("y", b) @ turn("x", a) for a, b, c in ANGLES]  # W, P, R


def fanuc(group: str = "") -> str:
    return "/PROG  CALIB\n/ATTR\nOWNER = MNEDITOR;\n/MN\n   1:J P[1] 100% FINE ;\n/POS\n" + each(
        lambda i, p, a: f"P[{i}:\"a\"]{{\n   GP1:\n\tUF : 0, UT : 0,\t\tCONFIG : 'N U T, 0, 0, 0',\n"
        f"\tX = {p[0]:9.3f}  mm,\tY = {p[1]:9.3f}  mm,\tZ = {p[2]:9.3f}  mm,\n"
        f"\tW = {a[0]:9.3f} deg,\tP = {a[1]:9.3f} deg,\tR = {a[2]:9.3f} deg{group}\n}};\n"
    ) + "/END\n"  # fmt: skip


POSES: dict[str, tuple[str, str, list[np.ndarray], tuple[str, ...]]] = {
    "FANUC": ("calib.ls", fanuc(",\n   GP2:\n\tUF : 0, UT : 0,\n\tJ1=     6.428 deg"), FIXED, ()),
    "RobPoses": (
        "RobPoses.rob",
        '{\n    "RobPoses": ['
        + ",".join("\n        [\n" + ",\n".join(f"\t\t\t{n:.3f}" for n in (*p, *a)) + "\n        ]"
                   for p, a in zip(POSITIONS, ANGLES, strict=True)) + "\n    ]\n}\n",
        FIXED, (),
    ),
    "KUKA": (
        "scan.dat",
        "&ACCESS RVP\nDEFDAT scan PUBLIC\nDECL FDAT FP1={TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}\n"
        + each(lambda i, p, a: f"DECL E6POS XP{i}={{X {p[0]},Y {p[1]},Z {p[2]},A {a[0]},B {a[1]},C {a[2]},S 2,T 35,"
                               "E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}\n") + "ENDDAT\n",
        rotations("zyx"), (),
    ),
    "ABB": (
        "Module1.mod",
        "MODULE Module1\n  PERS tooldata t1:=[TRUE,[[1,2,3],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
        + "".join(f"\tCONST robtarget p{i}0:=[[{p[0]},{p[1]},{p[2]}],[{','.join(f'{q:.9f}' for q in quaternion(r))}],"
                  "[-1,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];\n"
                  for i, (p, r) in enumerate(zip(POSITIONS, rotations("xyz"), strict=True), 1)) + "ENDMODULE\n",
        rotations("xyz"), (),
    ),
    "Universal Robots": (
        "scan.script",
        "def scan():\n  set_tcp(p[0,0,0,0,0,0])\n"
        + "".join("  movel(p[" + ", ".join(f"{n:.9f}" for n in (*(1e-3 * p), *rotation_vector(r))) + "], a=1.2)\n"
                  for p, r in zip(POSITIONS, rotations("zyz"), strict=True)) + "end\n",
        rotations("zyz"), (),
    ),
    "V+ locations": (
        "scan.v2",
        ".PROGRAM scan()\n"
        + each(lambda i, p, a: f"  SET loc[{i}] = TRANS({','.join(map(str, (*p, *a)))})\n") + ".END\n",
        rotations("zyz"), (),
    ),
    "V+": (
        "scan.lc",
        ".LOCATIONS\n" + each(lambda i, p, a: f"loc[{i}]  " + " ".join(f"{n:.3f}" for n in (*p, *a)) + "\n")
        + "#safe 0 -90 180 0 0 0\n.END\n",
        rotations("zyz"), (),
    ),
    "6 numbers": (
        "robpose.txt",
        each(lambda i, p, a: " ".join(f"{n:.3f}" for n in (*p, *a)) + "\n"), rotations("yzx"), ("--convention", "yzx"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("robot", POSES)
def test_poses_of_a_controller(tmp_path, robot) -> None:
    name, content, turns, words = POSES[robot]
    scans = folder_of_profiles(tmp_path)
    (tmp_path / name).write_text(content)
    found, said = reconstruct(tmp_path, scans, "--flange", tmp_path / name, *words)
    require_points(found, base_points(turns))
    assert robot in said and "3 profiles, 27 points, 4 of them without a height" in said


@pytest.mark.parametrize(("separator", "decimal", "encoding"), [(";", ",", "utf-16"), ("\t", ".", "latin-1")])
def test_scancontrol_csv_with_poses(tmp_path, separator, decimal, encoding) -> None:
    (tmp_path / "profiles.csv").write_bytes(scancontrol(separator, decimal).encode(encoding))
    (tmp_path / "calib.ls").write_text(fanuc())
    found, said = reconstruct(tmp_path, tmp_path / "profiles.csv", "--flange", tmp_path / "calib.ls")
    require_points(found, base_points(FIXED))
    assert "taken for Micro-Epsilon scanCONTROL" in said


def test_profiles_beside_other_lists_of_the_file(tmp_path) -> None:
    (tmp_path / "p1.yml").write_text(opencv(Z[0], "profile", 'feature_point: [ 60.7, 0., 4.99 ]\ntype: "Edge"\n'))
    found, _ = reconstruct(tmp_path, tmp_path / "p1.yml")
    require_points(found, surface(np.zeros(1), Z[:1]))


def test_every_order_of_angles_is_a_convention() -> None:
    orders = [a + b + c for a in "xyz" for b in "xyz" for c in "xyz" if a != b != c]
    assert len(orders) == 12
    for order in orders:
        found = CONVENTIONS[order].rotations(np.radians(ANGLES)).as_matrix()
        assert found == pytest.approx(np.array(rotations(order)), abs=1e-12)


def test_points_without_a_height_are_left_out_of_a_table(tmp_path) -> None:
    """Rows with nan, an empty field or a mark; the numbers of rows in messages stay those of the file."""
    columns = ",".join(
        ["exposure,x_mm,z_mm", *(f"flange_{a}_mm" for a in "xyz"), *(f"flange_xyzwpr_{i}_deg" for i in (1, 2, 3))]
    )
    marks = iter(["nan", "", "---", "NaN"])
    rows = [
        f"{i},{x},{next(marks) if np.isnan(h) else h},{','.join(map(str, (*p, *a)))}"
        for i, (z, p, a) in enumerate(zip(Z, POSITIONS, ANGLES, strict=True), 1)
        for x, h in zip(X, z, strict=True)
    ]
    (tmp_path / "table.csv").write_text("\n".join([columns, *rows, ""]))
    found, said = reconstruct(tmp_path, tmp_path / "table.csv")
    require_points(found, base_points(FIXED))
    assert "4 rows are left out, which have no z_mm" in said
    rows[7] = rows[7].replace("10.0,", "ten,", 1)
    (tmp_path / "table.csv").write_text("\n".join([columns, *rows, ""]))
    with pytest.raises(DescriptionError, match="column 'x_mm', row 8"):
        scancell.reconstruct(tmp_path / "table.csv")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ls", fanuc().replace("X =   812.250  mm", "J1 =   8.250 deg", 1), "line 7 holds no such pose"),
        ("a.dat", POSES["KUKA"][1].replace("C 155.5", "C ?"), "line 6 holds no such pose"),
        ("a.rob", POSES["RobPoses"][1].replace("\t\t\t155.500", ""), "holds no such pose"),
        ("a.mod", POSES["ABB"][1].replace("p10:=[[", "p10:=[[9E9,", 1), "line 3 holds no such pose"),
        ("a.txt", "1 2 3 4 5 6\n" * 3, "needs a `convention`"),
    ],
)
def test_lost_poses_are_refused(tmp_path, name, content, message) -> None:
    scans = folder_of_profiles(tmp_path)
    (tmp_path / name).write_text(content)
    with pytest.raises(DescriptionError, match=message):
        scancell.reconstruct(scans, flange=tmp_path / name)


@pytest.mark.parametrize(
    ("name", "content", "body", "message"),
    [
        ("p.csv", scancontrol(), None, "states no travel from one profile to the next"),
        ("p.csv", keyence_csv(), None, "states no positions along the profile"),
        ("p.csv", gocator("RawProfile").replace(",X,", ",Z,", 1), None, "rows Z, and as many rows X and I"),
        ("p.csv", gocator("Profile").replace(",101.50000", "", 1), None, "expected 18 values as in the first line"),
        ("p.yml", opencv(Z[1])[:-9], None, "one without its end"),
        ("p.yml", opencv(Z[1]).replace("0.00000000e+00, ", "", 1), None, "no whole number of points of 3"),
        ("p.tsv", keyence_tsv(), 'preset = "nothing"\n', "format.preset"),
        ("p.tsv", keyence_tsv(), 'preset = "keyence_ljv_tsv"\nunknown = 1\n', "unknown"),
        ("p.tsv", keyence_tsv(), 'preset = "keyence_ljv_tsv"\nbegin = "("\n', "no regular expression"),
        ("p.tsv", keyence_tsv(), 'name = "a"\nlayout = "points"\n', "x.column and z.column are needed"),
        ("p.tsv", keyence_tsv(), 'preset = "keyence_ljv_tsv"\nz = { scale_mm = 1e9 }\n', "is its scale right"),
        ("p.png", "no image", 'preset = "range_image_16bit"\n', "one channel of 16 bits"),
    ],
)  # fmt: skip
def test_wrong_files_of_profiles_are_refused(tmp_path, name, content, body, message) -> None:
    (tmp_path / name).write_text(content)
    form = None if body is None else own_format(tmp_path, body)
    with pytest.raises(DescriptionError, match=message):
        scancell.reconstruct(tmp_path / name, table_format=form)
