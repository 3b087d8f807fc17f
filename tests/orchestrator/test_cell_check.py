"""Bodies that stand in each other are refused with both names and the depth; touching ones are fine."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from cells import ball, block, cell_file, export_mm, mesh_of

from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CellError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, load_mesh
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.proximity.judge import check_cell, penetration

BLOCK = block(0.06, 0.04, 0.03)
BELT = """
[[conveyor]]
name = "belt"
pose = {{ x_mm = {x}, y_mm = -350.0, z_mm = 110.0 }}
length_mm = 400.0
width_mm = {width}
"""
NEIGHBOUR = """
[[further_part]]
name = "neighbour"
mesh = "neighbour.stl"
fixture = "clamped"
pose = {{ x_mm = {x}, z_mm = {z} }}
"""


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return pose.translation((x, y, z))


def cell(tmp_path, more: str = "", part: Mesh = BLOCK, *overrides: str) -> NominalCell:
    export_mm(BLOCK, tmp_path / "neighbour.stl")
    return nominal_cell(load_setup(cell_file(tmp_path, more), settings=overrides).cell, part)


@pytest.mark.parametrize("file", sorted((assets_dir() / "cells").glob("*.toml")), ids=lambda file: file.stem)
@pytest.mark.parametrize("part", ["machined", "step_block"])
def test_shipped_cells_are_accepted(file, part):
    check_cell(nominal_cell(load_setup(file).cell, load_mesh(assets_dir() / "parts" / f"{part}.stl")))


@pytest.mark.parametrize(
    ("more", "overrides", "pair", "keys"),
    [
        ("", ["cell.table.pose.x_mm=150"], "'base' and 'table'", "robot.base or table.pose"),
        ("", ["cell.part.z_mm=-4"], "'table' and 'part' intersect, about 4 mm deep", "part.z_mm"),
        (BELT.format(x=450.0, width=600.0), [], "'table' and 'belt'", "the pose of 'belt'"),
        (
            NEIGHBOUR.format(x=55.0, z=0.0),
            [],
            "'part' and 'neighbour' intersect, about 5 mm deep",
            "further_part[1].pose",
        ),
        (NEIGHBOUR.format(x=0.0, z=0.0), [], "'part' and 'neighbour'", "further_part[1].pose"),
        (NEIGHBOUR.format(x=80.0, z=-2.0), [], "'table' and 'neighbour' intersect, about 2 mm deep", "further_part[1]"),
    ],
)
def test_intersection_error_names_bodies_and_depth(tmp_path, more, overrides, pair, keys):
    with pytest.raises(CellError) as caught:
        check_cell(cell(tmp_path, more, BLOCK, *overrides))
    assert pair in str(caught.value)
    assert keys in str(caught.value)


def test_enclosed_part_is_detected(tmp_path):
    nominal = cell(tmp_path, NEIGHBOUR.format(x=0.0, z=20.0), block(0.1, 0.1, 0.1))
    with pytest.raises(CellError, match=r"'part' and 'neighbour' intersect, about (50|49) mm deep"):
        check_cell(nominal)


OBSTACLES = """
robot_moves_with = "{arm_on}"
[[axis]]
name = "track"
kind = "prismatic"
min_mm = -1.0
max_mm = 1.0
max_speed_mm_s = 1.0
max_acceleration_mm_s2 = 1.0
[[obstacle]]
name = "post"
mesh = "neighbour.stl"
moves_with = "{first}"
pose = {{ x_mm = {x}, z_mm = 20.0 }}
[[obstacle]]
name = "lamp"
mesh = "neighbour.stl"
moves_with = "{second}"
pose = {{ x_mm = {x}, z_mm = 25.0 }}
"""


def obstacles(tmp_path, arm_on: str, first: str, second: str, x: float) -> NominalCell:
    export_mm(BLOCK, tmp_path / "neighbour.stl")
    more = OBSTACLES.format(arm_on=arm_on, first=first, second=second, x=x)
    top, _, rest = more.partition("[[axis]]")
    text = (assets_dir() / "cells" / "default.toml").read_text()
    (tmp_path / "cell.toml").write_text(f"{top}{text}\n[[axis]]{rest}")
    return nominal_cell(load_setup(tmp_path / "cell.toml").cell, BLOCK)


def test_obstacles_on_one_carrier_are_one_body(tmp_path):
    for carrier in ("world", "table", "track"):
        check_cell(obstacles(tmp_path, "world", carrier, carrier, 2000.0))
    check_cell(obstacles(tmp_path, "world", "world", "track", 2000.0))  # a bearing


def test_an_arm_stands_on_its_carriage(tmp_path):
    check_cell(obstacles(tmp_path, "track", "track", "track", 0.0))
    with pytest.raises(CellError, match="'base' and 'lamp' intersect"):
        check_cell(obstacles(tmp_path, "track", "track", "world", 0.0))
    with pytest.raises(CellError, match="'base' and 'post' intersect"):
        check_cell(obstacles(tmp_path, "world", "world", "world", 0.0))
    with pytest.raises(CellError, match="'part' and 'post' intersect"):
        check_cell(obstacles(tmp_path, "world", "table", "table", 0.0))


def test_touching_bodies_are_accepted(tmp_path):
    check_cell(cell(tmp_path, NEIGHBOUR.format(x=60.0, z=0.0)))


def test_coincident_bodies_are_detected():
    assert penetration(BLOCK, BLOCK) == pytest.approx(0.015, rel=0.1)


@pytest.mark.parametrize("gap", [-5e-3, -1e-3, -0.2e-3, -0.05e-3, 0.0, 1e-3])
@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_penetration_of_boxes(gap, turn):
    turned = pose.from_rotation(pose.rotation_about(0, turn))
    below, above = box_mesh((0.2, 0.1, 0.02)), box_mesh((0.05, 0.03, 0.02)).transformed(at(z=0.02 + gap))
    depth = penetration(below.transformed(turned), above.transformed(turned))
    assert depth == pytest.approx(-gap if gap < -0.1e-3 else 0.0, abs=1e-9)


def test_penetration_of_crossing_bars():
    """Crossing bars: the sides of either are half of the other's width away from its surface."""
    one, other = box_mesh((0.3, 0.02, 0.02)), box_mesh((0.02, 0.3, 0.0101))
    assert penetration(one, other) == pytest.approx(0.01, rel=0.15)


def test_penetration_of_ball_and_plate_is_symmetric():
    plate, sphere = box_mesh((0.1, 0.1, 0.05)), ball(0.02).transformed(at(z=0.025 + 0.013))
    assert penetration(plate, sphere) == pytest.approx(0.007, abs=1e-4)
    assert penetration(sphere, plate) == penetration(plate, sphere)


def test_overlapping_bounding_boxes_are_accepted():
    ring = mesh_of(trimesh.creation.annulus(0.05, 0.06, 0.04))
    assert penetration(ring, ball(0.03)) == 0.0
    assert penetration(ring, ball(0.055)) > 4e-3


def test_fine_and_open_meshes():
    fine = mesh_of(trimesh.creation.icosphere(7, 0.05))
    assert len(fine.faces) > 100_000
    plate = box_mesh((0.2, 0.2, 0.02))
    assert penetration(fine.transformed(at(z=0.06)), plate) == 0.0
    assert penetration(fine.transformed(at(z=0.055)), plate) == pytest.approx(0.005, abs=1e-3)
    lidless = Mesh(plate.vertices, plate.faces[2:])
    assert penetration(ball(0.03), lidless) == pytest.approx(0.02, abs=5e-4)  # the plate cuts the ball
    assert penetration(lidless, lidless) == 0.0
