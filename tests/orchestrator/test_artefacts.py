"""Artefact files: shipped ones have their stated geometry, wrong ones are refused by file, key and value."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scancell import sensor as sensor_rt
from scancell.config.artefact import ArtefactDescription
from scancell.config.cell import CellDescription
from scancell.config.loading import assets_dir, load_setup
from scancell.errors import CellError, DescriptionError, MeshError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh
from scancell.geometry.shapes import Box, Cone, Cylinder, PartSurface, Plane, Ring, ShapeMesh, Sphere
from scancell.nominal.cell import nominal_cell
from scancell.nominal.parts import PartCache, load_part, shape_group
from scancell.scanning.world import build_scene, visible_bodies

FOLDER = assets_dir() / "artefacts"
NAMES = ["ball_bar", "ball_plate", "cone", "cylinder", "plane", "ring", "sphere", "step", "v_groove"]


def load(name: str) -> ShapeMesh:
    part = load_part(FOLDER / f"{name}.toml")
    assert isinstance(part, ShapeMesh)
    return part


def test_shipped_artefacts_are_the_listed_ones() -> None:
    assert sorted(file.stem for file in FOLDER.glob("*.toml")) == NAMES
    text = (assets_dir().parent / "docs" / "artefacts.md").read_text()
    assert [name for name in NAMES if f"`{name}`" not in text] == []


@pytest.mark.parametrize("name", NAMES)
def test_artefact_stands_on_the_default_table(name: str) -> None:
    part = load(name)
    assert part.source == str(FOLDER / f"{name}.toml")
    assert ArtefactDescription.from_toml(part.source).name == name
    low, high = part.bounds
    assert low[2] == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(part.vertices[:, :2], axis=1).max() < 0.12
    assert high[2] < 0.08
    assert part.shapes.measured


@pytest.mark.parametrize("name", NAMES)
def test_mesh_lies_on_the_shapes_and_shows_facets_beside_them(name: str) -> None:
    """No vertex outside the union; points between vertices deviate by the chord error where a surface is curved."""
    part = load(name)
    assert np.max(part.shapes.nearest(part.vertices)[0]) < 1e-15
    curved = any(not isinstance(one.shape, Box | Plane) for one in part.shapes.shapes)
    middle = part.vertices[part.faces].mean(1)
    signed, _, index = part.shapes.nearest(middle)
    on_surface = signed > -20e-6  # not within another solid
    deepest = -signed[on_surface].min()
    assert deepest < 10e-6
    assert (deepest > 1e-6) == curved
    assert len(np.unique(index)) == len(part.shapes.shapes)


def test_dimensions_of_shipped_artefacts() -> None:
    def measured(name: str, kind: type) -> list:
        return [one for one in load(name).shapes.measured if isinstance(one.shape, kind)]

    (ball,) = measured("sphere", Sphere)
    assert ball.shape.radius == pytest.approx(0.0125)
    first, second = (one.frame_from_shape[:3, 3] for one in measured("ball_bar", Sphere))
    assert np.linalg.norm(second - first) == pytest.approx(0.120)
    assert len(measured("ball_plate", Sphere)) == 6
    (plane,) = measured("plane", Plane)
    assert (plane.shape.size_x, plane.shape.size_y) == pytest.approx((0.12, 0.08))
    (ring,) = measured("ring", Ring)
    assert (ring.shape.inner_radius, ring.shape.outer_radius) == pytest.approx((0.03, 0.045))
    (cone,) = measured("cone", Cone)
    assert (cone.shape.bottom_radius, cone.shape.top_radius, cone.shape.height) == pytest.approx((0.03, 0.01, 0.04))
    upright, lying = (one.frame_from_shape[:3, 2] for one in measured("cylinder", Cylinder))
    np.testing.assert_allclose(upright, [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(np.abs(lying), [0, 1, 0], atol=1e-15)


def test_step_has_the_stated_heights() -> None:
    group = load("step").shapes
    points = [[-0.05, 0, 20e-3], [-0.03, 0, 21e-3], [-0.01, 0, 22e-3], [0.01, 0, 25e-3], [0.03, 0, 30e-3]]
    for above in (-3e-6, 0.0, 3e-6):
        signed, normal, index = group.nearest(points + np.array([0, 0, above]))
        np.testing.assert_allclose(signed, above, atol=1e-12)
        np.testing.assert_allclose(normal, np.tile([0, 0, 1], (5, 1)), atol=1e-12)
        np.testing.assert_array_equal(index, range(5))


def test_distance_below_a_step_is_exact_beside_the_next_one() -> None:
    """The wall of the higher step runs on inside the lower one, but is no surface there."""
    group = load("step").shapes
    corners = np.array([[-0.04, 0, 20e-3], [-0.02, 0, 21e-3], [0.0, 0, 22e-3], [0.02, 0, 25e-3]])
    signed, normal, index = group.nearest(corners + np.array([-1e-6, 0, -3e-6]))
    np.testing.assert_allclose(signed, -3e-6, atol=1e-12)
    np.testing.assert_allclose(normal, np.tile([0, 0, 1], (4, 1)), atol=1e-12)
    np.testing.assert_array_equal(index, range(4))
    signed, normal, index = group.nearest(corners + np.array([-1e-6, 0, 3e-6]))
    np.testing.assert_allclose(signed, 1e-6, atol=1e-12)
    np.testing.assert_allclose(normal, np.tile([-1, 0, 0], (4, 1)), atol=1e-12)
    np.testing.assert_array_equal(index, range(1, 5))


def test_flanks_of_v_groove_meet_at_right_angles_above_the_table() -> None:
    group = load("v_groove").shapes
    distance = np.linspace(0.001, 0.02, 20)
    for side in (-1.0, 1.0):
        flank = np.stack([0 * distance, side * distance, 0.018 + distance], 1)
        signed, normal, _ = group.nearest(flank)
        assert np.abs(signed).max() < 1e-9  # the file has its positions to a nanometre
        np.testing.assert_allclose(normal, np.tile([0, -side / np.sqrt(2), 1 / np.sqrt(2)], (20, 1)), atol=1e-12)


def test_scene_traces_the_shapes_of_the_part() -> None:
    """Rays onto each artefact end on its shapes to rounding, onto its mesh they do not."""
    rng = np.random.default_rng(5)
    for name in NAMES:
        part = load(name)
        nominal = nominal_cell(load_setup().cell, part)
        body = next(body for body in visible_bodies(nominal) if body.name == "part")
        scene = build_scene([body])
        targets = rng.uniform(*part.bounds, (4000, 3))
        origins = targets + np.array([0, 0, 0.3]) + rng.uniform(-0.15, 0.15, (4000, 3))
        directions = (targets - origins) / np.linalg.norm(targets - origins, axis=1, keepdims=True)
        distance, _, _ = sensor_rt.cast_rays(scene, np.eye(4)[None], origins, directions)
        hit = np.isfinite(distance)
        assert hit.sum() > 500
        points = origins[hit] + distance[hit, None] * directions[hit]
        signed, _ = PartSurface(part).distances(points)
        assert np.abs(signed).max() < 1e-15
        facets, _ = PartSurface(Mesh(part.vertices, part.faces)).distances(points)
        curved = any(not isinstance(one.shape, Box | Plane) for one in part.shapes.shapes)
        assert (np.abs(facets).max() > 1e-6) == curved


def test_artefact_may_be_a_further_part_or_an_obstacle(tmp_path: Path) -> None:
    file = str(FOLDER / "sphere.toml")
    cell = CellDescription.default().replace(
        {
            "further_part": [{"name": "ball", "mesh": file, "fixture": "clamped", "pose": {"x_mm": 80.0}}],
            "obstacle": [{"name": "post", "mesh": file, "pose": {"x_mm": -200.0, "rx_deg": 90.0}}],
        }
    )
    nominal = nominal_cell(cell, load("cone"))
    for name in ("part", "ball", "post"):
        body = next(body for body in nominal.bodies if body.name == name)
        assert isinstance(body.mesh, ShapeMesh)
        assert np.max(body.mesh.shapes.nearest(body.mesh.vertices)[0]) < 1e-15
    post = next(body.mesh for body in nominal.bodies if body.name == "post")
    centre = pose.from_euler_xyz((-0.2, 0, 0), (np.pi / 2, 0, 0)) @ [0, 0, 0.06, 1]
    np.testing.assert_allclose(post.shapes.measured[0].frame_from_shape[:3, 3], centre[:3], atol=1e-15)


def test_material_regions_of_an_artefact_are_refused() -> None:
    region = {"min_mm": [0, 0, 0], "material": {"preset": "matt_white"}}
    cell = CellDescription.default().replace({"part.material_region": [region]})
    with pytest.raises(CellError, match=r"sphere\.toml: part\.material_region: an artefact has one material"):
        nominal_cell(cell, load("sphere"))


BALL = '[[shape]]\nname = "ball"\nkind = "sphere"\ndiameter_mm = 20.0\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BALL.replace("20.0", "-20.0"), r"shape\[1\]\.diameter_mm = -20\.0: must be greater than or equal to 0\.001"),
        (BALL.replace("20.0", "1e6"), r"shape\[1\]\.diameter_mm = 1000000\.0: must be less than or equal to 2000"),
        (BALL.replace("diameter_mm", "diameter"), r"shape\[1\]\.diameter: unknown key; did you mean 'diameter_mm'\?"),
        (BALL.replace("sphere", "torus"), r"shape\[1\].*'torus'.*'sphere'"),
        (BALL + BALL, r"two shapes have the name 'ball'"),
        (BALL + 'role = "support"\n', r'none has the role "measured"'),
        (BALL + 'role = "stand"\n', r"shape\[1\]\.role = 'stand': .*'measured' or 'support'"),
        (BALL + "pose = { x_m = 1.0 }\n", r"shape\[1\]\.pose\.x_m: unknown key; did you mean 'x_mm'\?"),
        ('name = "empty"\nshape = []\n', r'none has the role "measured"; expected at least one'),
        (
            '[[shape]]\nname = "r"\nkind = "ring"\ninner_diameter_mm = 50\nouter_diameter_mm = 40\nheight_mm = 9\n',
            r"shape\[1\]: inner_diameter_mm = 50: must be less than outer_diameter_mm = 40",
        ),
        ('[[shape]]\nname = "p"\nkind = "plane"\nsize_mm = [5]\n', r"shape\[1\]\.size_mm\[2\]"),
    ],
)
def test_wrong_file_is_refused_by_file_key_and_value(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(DescriptionError, match=message) as caught:
        load_part(file)
    assert all(line.startswith(f"{file}: ") for line in str(caught.value).splitlines())


def test_missing_file_and_unknown_unit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=r"absent\.toml: no such file"):
        load_part(tmp_path / "absent.toml")
    with pytest.raises(MeshError, match="unit = 'cm': expected"):
        load_part(FOLDER / "sphere.toml", "cm")


def test_changed_file_is_read_again(tmp_path: Path) -> None:
    cache, file = PartCache(), tmp_path / "ball.toml"
    file.write_text(BALL)
    first = cache.part(file, "mm")
    assert cache.part(file, "mm") is first
    file.write_text(BALL.replace("20.0", "100.0"))
    second = cache.part(file, "mm")
    assert isinstance(second, ShapeMesh)
    assert second.shapes.measured[0].shape == Sphere(0.05)


def test_description_from_python_makes_the_same_shapes_as_its_file(tmp_path: Path) -> None:
    description = ArtefactDescription.default()
    group = shape_group(description)
    assert group.source == "sphere"
    assert [one.shape for one in group.shapes] == [one.shape for one in load("sphere").shapes.shapes]
