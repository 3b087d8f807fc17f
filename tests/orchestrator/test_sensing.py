"""Sensors and collision outputs: from the description to the FMU; lighter meshes and what they cost."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import ball, block, mesh_of

from orchestrator.cell.fmu_file import build_fmu, cell_json
from orchestrator.cell.fmu_package.contents import THROWN_AWAY
from orchestrator.cell.instance import CellInstance
from orchestrator.cell.nominal import nominal_cell
from orchestrator.cell.sensing import sensing_json, simplified
from orchestrator.config.loading import assets_dir, load_setup
from orchestrator.errors import CellError, DescriptionError
from orchestrator.geometry.decimation import decimated, deviation

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


def setup_of(folder, text: str, *words: str):
    default = (assets_dir() / "cells" / "default.toml").read_text()
    file = folder / "cell.toml"
    file.write_text(default.replace("../", f"{assets_dir()}/") + text)
    return load_setup(file, overrides=list(words))


def opened(setup, folder):
    fmu = folder / "cell.fmu"
    build_fmu(cell_json(setup.cell, nominal_cell(setup.cell, BLOCK), 0), fmu, 3, THROWN_AWAY)
    return CellInstance(fmu)


def test_a_flat_body_is_simplified_without_deviation() -> None:
    dense = mesh_of(trimesh.creation.box((0.1, 0.08, 0.06)).subdivide_loop(0).subdivide().subdivide().subdivide())
    light = decimated(dense, 100)
    assert len(dense.faces) == 12 * 4**3
    assert len(light.faces) <= 100
    assert deviation(dense, light) < 1e-7  # single precision of the library, about the mesh's centre


def test_triangles_without_common_vertices_are_simplified_as_one_surface() -> None:
    """An STL file has three vertices a triangle: a sphere of such triangles must stay closed."""
    sphere = trimesh.creation.icosphere(4, 0.05)
    soup = mesh_of(trimesh.Trimesh(sphere.triangles.reshape(-1, 3), np.arange(15360).reshape(-1, 3), process=False))
    light = decimated(soup, 1000)
    assert len(light.faces) <= 1000
    assert deviation(soup, light) < 4e-4
    assert trimesh.Trimesh(light.vertices, light.faces).is_watertight


def test_deviation_of_inscribed_spheres_is_their_sagitta() -> None:
    """Between two icospheres of one radius the coarse one's face centres lie deepest, below the sphere."""
    coarse, fine = mesh_of(trimesh.creation.icosphere(1, 0.05)), mesh_of(trimesh.creation.icosphere(5, 0.05))
    deepest = 0.05 - np.linalg.norm(coarse.vertices[coarse.faces].mean(1), axis=1).min()
    assert deviation(coarse, fine) == pytest.approx(deepest, rel=0.02)
    assert deviation(coarse, fine) == deviation(fine, coarse)
    assert deviation(fine, fine) < 1e-15


def test_a_dense_body_tells_what_simplifying_costs(tmp_path) -> None:
    setup = setup_of(tmp_path, "", "cell.collision.max_faces=500")
    nominal = nominal_cell(setup.cell, ball())  # 5120 triangles
    changed = {body.body: body for body in simplified(setup.cell, nominal)}
    part = changed["part"]
    assert (part.faces, part.kept <= 500) == (5120, True)
    assert 1e-5 < part.deviation < 1e-3
    assert "5120 triangles simplified" in part.line()
    written = {body["name"]: len(body["mesh"]["faces"]) for body in sensing_json(setup.cell, nominal)["bodies"]}
    assert max(written.values()) < max(len(body.mesh.faces) for body in nominal.bodies) / 4


def test_neighbours_on_the_arm_and_the_part_on_the_table_are_no_collisions(tmp_path) -> None:
    setup = setup_of(tmp_path, "")
    pairs = {
        frozenset(pair) for pair in sensing_json(setup.cell, nominal_cell(setup.cell, BLOCK))["collision"]["pairs"]
    }
    assert frozenset({"sensor", "part"}) in pairs
    assert not any(pair <= {"part", "platter", "table_base", "fixture"} for pair in pairs)
    with opened(setup, tmp_path) as cell:
        cell.step_to(100_000)
        assert cell.get_integer("truth.collision.pairs") == 0


def test_outputs_may_be_left_out(tmp_path) -> None:
    setup = setup_of(tmp_path, "", "cell.collision.outputs=false")
    sensing = sensing_json(setup.cell, nominal_cell(setup.cell, BLOCK))
    assert (sensing["bodies"], sensing["collision"]["pairs"]) == ([], [])


@pytest.mark.parametrize(("pose", "expected"), [(ABOVE_TABLE, True), (ABOVE_TABLE.replace("450", "490"), False)])
def test_a_described_volume_sees_the_part(tmp_path, pose, expected) -> None:
    setup = setup_of(tmp_path, PRESENCE.format(pose=pose))
    with opened(setup, tmp_path) as cell:
        cell.step_to(50_000)
        assert cell.get_boolean("presence[1].detected") == expected


def test_a_described_distance_sensor_measures_the_part(tmp_path) -> None:
    """From 250 mm down to the top of the part, 20 mm above where its underside stands."""
    setup = setup_of(tmp_path, DISTANCE)
    nominal = nominal_cell(setup.cell, BLOCK)
    with opened(setup, tmp_path) as cell:
        cell.step_to(50_000)
        valid = cell.get_boolean("distance[1].valid")
        (measured,) = cell.get(cell.real_group(["distance[1].value"]))
    part = [body.name for body in nominal.bodies].index("part")
    top = nominal.body_poses(nominal.home[None], np.zeros(1))[0, part, 2, 3] + 0.02
    assert valid
    assert measured == pytest.approx(0.25 - top, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (DISTANCE + "nearest_mm = 400.0\n", ("distance_sensor", "nearest_mm (400)", "farthest_mm (300)")),
        (PRESENCE.format(pose="") + 'moves_with = "link[9]"\n', ("presence_sensor", "moves_with", "link[9]")),
        (PRESENCE.format(pose="").replace("x_size_mm = 10.0", "x_size_mm = 0.0"), ("x_size_mm", "0")),
    ],
)
def test_errors_name_the_key_and_the_value(tmp_path, text, words) -> None:
    with pytest.raises(DescriptionError) as error:
        setup_of(tmp_path, text)
    assert all(word in str(error.value) for word in (*words, "cell.toml"))


def test_a_period_off_the_time_step_is_refused(tmp_path) -> None:
    setup = setup_of(tmp_path, PRESENCE.format(pose="") + "period_ms = 1.5\n")
    with pytest.raises(CellError, match=r"gate: period_ms = 1.5: expected a multiple of world.time_step_us \(1000\)"):
        sensing_json(setup.cell, nominal_cell(setup.cell, BLOCK))
