"""Device sensors and collision outputs of the FMU, and the error of simplified meshes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import ball, block, cell_file, mesh_of

from mesh_json import read_mesh_json
from scancell.cell.fmu_file import cell_json, make_temporary_fmu, sensing_json, simplified
from scancell.cell.instance import CellInstance
from scancell.config.loading import load_setup
from scancell.errors import CellError, DescriptionError
from scancell.geometry.mesh import decimated, deviation
from scancell.nominal.cell import nominal_cell

BLOCK = block(0.04, 0.03, 0.02)
ABOVE_TABLE = "x_mm = 450.0, z_mm = 110.0"
PRESENCE = """
[[presence_sensor]]
name = "gate"
pose = {{ {pose} }}
x_size_mm = 10.0
y_size_mm = 10.0
z_size_mm = 10.0
"""
DISTANCE = """
[[distance_sensor]]
name = "height"
pose = { x_mm = 450.0, z_mm = 250.0, rx_deg = 180.0 }
farthest_mm = 300.0
"""


CURTAIN = """
[[light_curtain]]
name = "gate"
pose = { x_mm = 450.0, y_mm = -300.0, z_mm = 101.0, rx_deg = -90.0, rz_deg = -90.0 }
width_mm = 600.0
height_mm = 60.0
beam_spacing_mm = 3.0
"""


def setup_of(folder, text: str, *words: str):
    return load_setup(cell_file(folder, text), settings=list(words))


def opened(setup, folder):
    description = cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0)
    return CellInstance(make_temporary_fmu(description, folder / "fmu", 3))


def test_decimation_of_flat_body_is_exact() -> None:
    dense = mesh_of(trimesh.creation.box((0.1, 0.08, 0.06)).subdivide_loop(0).subdivide().subdivide().subdivide())
    light = decimated(dense, 100)
    assert len(dense.faces) == 12 * 4**3
    assert len(light.faces) <= 100
    assert deviation(dense, light) < 1e-7  # single precision of the library


def test_decimation_welds_triangle_soup() -> None:
    """Meshes from STL files have three vertices per triangle: a sphere must remain closed."""
    sphere = trimesh.creation.icosphere(4, 0.05)
    soup = mesh_of(trimesh.Trimesh(sphere.triangles.reshape(-1, 3), np.arange(15360).reshape(-1, 3), process=False))
    light = decimated(soup, 1000)
    assert len(light.faces) <= 1000
    assert deviation(soup, light) < 4e-4
    assert trimesh.Trimesh(light.vertices, light.faces).is_watertight


def test_deviation_of_icospheres_is_sagitta() -> None:
    """The largest distance between icospheres of equal radius is at the face centres of the coarser one."""
    coarse, fine = mesh_of(trimesh.creation.icosphere(1, 0.05)), mesh_of(trimesh.creation.icosphere(5, 0.05))
    deepest = 0.05 - np.linalg.norm(coarse.vertices[coarse.faces].mean(1), axis=1).min()
    assert deviation(coarse, fine) == pytest.approx(deepest, rel=0.02)
    assert deviation(coarse, fine) == deviation(fine, coarse)
    assert deviation(fine, fine) < 1e-15


def test_simplification_reports_deviation(tmp_path) -> None:
    setup = setup_of(tmp_path, "", "cell.collision.max_faces=500")
    nominal = nominal_cell(setup.cell, ball())  # 5120 triangles
    changed = {body.body: body for body in simplified(setup.cell, nominal)}
    part = changed["part"]
    assert (part.faces, part.kept <= 500) == (5120, True)
    assert 1e-5 < part.deviation < 1e-3
    assert "5120 triangles simplified" in part.line()
    written = [len(read_mesh_json(body["mesh"])[1]) for body in sensing_json(setup.cell, nominal)["bodies"]]
    assert max(written) < max(len(body.mesh.faces) for body in nominal.bodies) / 4


def test_adjacent_links_and_resting_part_do_not_collide(tmp_path) -> None:
    setup = setup_of(tmp_path, "")
    pairs = {
        frozenset(pair) for pair in sensing_json(setup.cell, nominal_cell(setup.cell, BLOCK))["collision"]["pairs"]
    }
    assert frozenset({"sensor", "part"}) in pairs
    assert not {frozenset({"part", "table"}), frozenset({"table", "table_base"})} & pairs
    with opened(setup, tmp_path) as cell:
        cell.step_to(100_000)
        assert cell.get_integer("truth.collision.pairs") == 0


def test_collision_outputs_are_optional(tmp_path) -> None:
    setup = setup_of(tmp_path, "", "cell.collision.outputs=false")
    sensing = sensing_json(setup.cell, nominal_cell(setup.cell, BLOCK))
    assert (sensing["bodies"], sensing["collision"]["pairs"]) == ([], [])


def test_described_sensors_measure_the_part(tmp_path) -> None:
    """Presence on the table and beside the part, its height from above, and light beams along y, 3 mm apart."""
    beside = PRESENCE.format(pose=ABOVE_TABLE.replace("450", "490")).replace("gate", "beside")
    setup = setup_of(tmp_path, PRESENCE.format(pose=ABOVE_TABLE) + beside + DISTANCE + CURTAIN.replace("gate", "door"))
    nominal = nominal_cell(setup.cell, BLOCK)
    with opened(setup, tmp_path) as cell:
        cell.step_to(50_000)
        assert [cell.get_boolean(f"presence[{number}].detected") for number in (1, 2)] == [True, False]
        assert cell.get_boolean("distance[1].valid")
        assert cell.get_boolean("light_curtain[1].interrupted")
        beams = cell.get_integer("light_curtain[1].beams")
        measured, bottom = cell.get(cell.real_group(["distance[1].value", "truth.part[1].position[3]"]))
    part = [body.name for body in nominal.bodies].index("part")
    assert measured == pytest.approx(0.25 - nominal.body_poses(nominal.home[None])[0, part, 2, 3] - 0.02)
    assert bottom == pytest.approx(0.1, abs=1e-6)
    assert beams == np.sum(0.101 + 0.003 * np.arange(21) < bottom + 0.02)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (DISTANCE + "nearest_mm = 400.0\n", ("distance_sensor", "nearest_mm (400)", "farthest_mm (300)")),
        (PRESENCE.format(pose="") + 'moves_with = "link[9]"\n', ("presence_sensor", "moves_with", "link[9]")),
        (CURTAIN.replace("spacing_mm = 3.0", "spacing_mm = 0.01"), ("light_curtain", "0.01", "at most 1000 beams")),
        (PRESENCE.format(pose="").replace("x_size_mm = 10.0", "x_size_mm = 0.0"), ("x_size_mm", "0")),
    ],
)
def test_errors_name_key_and_value(tmp_path, text, words) -> None:
    with pytest.raises(DescriptionError) as error:
        setup_of(tmp_path, text)
    assert all(word in str(error.value) for word in (*words, "cell.toml"))


def test_period_must_be_multiple_of_time_step(tmp_path) -> None:
    setup = setup_of(tmp_path, PRESENCE.format(pose="") + "period_ms = 1.5\n")
    with pytest.raises(CellError, match=r"gate: period_ms = 1.5: expected a multiple of world.time_step_us \(1000\)"):
        sensing_json(setup.cell, nominal_cell(setup.cell, BLOCK))
