"""Figures of artefacts from clouds whose true deviations are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scancell.config.loading import assets_dir
from scancell.errors import DescriptionError, FitError
from scancell.evaluation.artefact import ArtefactEvaluation, evaluate_against_artefact
from scancell.evaluation.characteristics import Characteristic, assign, faces_of, narrowest_range
from scancell.geometry import pose
from scancell.geometry.mesh import sample_surface
from scancell.geometry.shapes import Box, Cone, Cylinder, PlacedShape, Plane, Ring, Shape, ShapeGroup, Sphere
from scancell.nominal.parts import load_artefact

NOISE = 5e-6  # m
FINE = 0.5e-6  # m: chord error of the surfaces that points are taken from


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    return pose.from_euler_xyz([x, y, z], np.radians(turn))


def part(name: str, shape: Shape, frame: np.ndarray | None = None, role: str = "measured") -> PlacedShape:
    return PlacedShape(name, shape, np.eye(4) if frame is None else frame, role)  # type: ignore[arg-type]


def group(*shapes: PlacedShape) -> ShapeGroup:
    return ShapeGroup(shapes, "artefact")


def cloud(shapes: ShapeGroup, count: int = 40_000, noise: float = NOISE, seed: int = 1) -> np.ndarray:
    """Points (n, 3), m, on the outside of the shapes, displaced along the normals."""
    points, _ = sample_surface(shapes.mesh(FINE), count, seed)
    signed, normal, _ = shapes.nearest(points)
    points = points - signed[:, None] * normal
    points = points[np.abs(shapes.nearest(points)[0]) < 1e-9]
    return points + noise * np.random.default_rng(seed).standard_normal((len(points), 1)) * shapes.nearest(points)[1]


def figure(found: ArtefactEvaluation, name: str, of: str) -> Characteristic:
    (one,) = (figure for figure in found.characteristics if figure.name == name and figure.of == of)
    return one


def agrees(one: Characteristic, error: float) -> bool:
    """Whether the error is as given within four standard uncertainties."""
    return bool(abs(one.error - error) < 4 * one.uncertainty)


BALL = group(part("ball", Sphere(12.5e-3), at(z=45e-3)), part("stem", Cylinder(4e-3, 35e-3), at(z=17.5e-3), "support"))


def test_size_and_form_of_a_sphere_that_is_too_large() -> None:
    true = group(part("ball", Sphere(12.51e-3), at(z=45e-3)), BALL.shapes[1])
    found = evaluate_against_artefact(cloud(true), BALL, "best-fit")
    size = figure(found, "probing size", "ball")
    assert agrees(size, 20e-6)
    assert size.uncertainty < 1e-6
    form = figure(found, "probing form", "ball").value
    count = len(found.faces[0].points)
    assert form == pytest.approx(2 * NOISE * np.sqrt(2 * np.log(count)), rel=0.25)  # range of normal deviates
    assert figure(found, "probing form, 95 % of the points", "ball").value == pytest.approx(3.92 * NOISE, rel=0.05)
    assert figure(found, "probing form, minimum zone", "ball").value <= form
    assert figure(found, "dispersion", "ball").value == pytest.approx(NOISE, rel=0.05)


def test_points_near_the_stem_do_not_count() -> None:
    points = cloud(BALL)
    faces = faces_of(BALL)
    assigned = assign(points, BALL, faces, 2e-3, 1e-3)
    of_ball = points[assigned.face == 0]
    assert np.abs(np.linalg.norm(of_ball - [0, 0, 45e-3], axis=1) - 12.5e-3).max() < 6 * NOISE
    below = of_ball[of_ball[:, 2] < 45e-3]
    assert np.hypot(below[:, 0], below[:, 1]).min() >= 4.9e-3
    assert not assigned.outlier.any()


def test_spacing_of_spheres_and_its_uncertainty() -> None:
    def bar(length: float) -> ShapeGroup:
        rod = part("rod", Cylinder(3e-3, 100e-3), at(turn=(0, 90, 0)), "support")
        return group(*(part(n, Sphere(10e-3), at(x=s * length / 2)) for n, s in (("a", -1), ("b", 1))), rod)

    errors = []
    for seed in range(30):
        found = evaluate_against_artefact(cloud(bar(100.03e-3), 2000, seed=seed), bar(100e-3), "best-fit")
        spacing = figure(found, "sphere spacing", "a - b")
        errors.append((spacing.error - 30e-6) / spacing.uncertainty)
    assert abs(np.mean(errors)) < 0.75
    assert 0.65 < np.std(errors) < 1.4


def test_step_height_of_two_planes_and_length_of_a_box() -> None:
    def step(height: float) -> ShapeGroup:
        return group(
            part("low", Plane(40e-3, 40e-3), at(x=-20e-3)), part("high", Plane(40e-3, 40e-3), at(x=20e-3, z=height))
        )

    found = evaluate_against_artefact(cloud(step(5.008e-3)), step(5e-3))
    height = figure(found, "step height", "low - high")
    assert agrees(height, 8e-6)
    assert height.nominal == pytest.approx(5e-3)
    box = group(part("block", Box(30e-3, 20e-3, 10e-3)))
    true = group(part("block", Box(30.02e-3, 20e-3, 10e-3)))
    found = evaluate_against_artefact(cloud(true), box, "best-fit")
    assert agrees(figure(found, "length", "block:+x - block:-x"), 20e-6)
    assert agrees(figure(found, "length", "block:+z - block:-z"), 0.0)


def test_flatness_of_a_bent_plane() -> None:
    plane = group(part("plane", Plane(60e-3, 40e-3)))
    x, y = np.meshgrid(np.linspace(-28e-3, 28e-3, 101), np.linspace(-18e-3, 18e-3, 61))
    points = np.stack([x, y, 10e-6 * (x / 28e-3) ** 2], -1).reshape(-1, 3)
    found = evaluate_against_artefact(points, plane, "best-fit")
    assert figure(found, "flatness", "plane").value == pytest.approx(10e-6, rel=0.01)
    assert figure(found, "flatness, minimum zone", "plane").value == pytest.approx(10e-6, rel=1e-3)
    assert figure(found, "max - min", "plane").value == pytest.approx(10e-6, rel=0.01)


def test_angle_and_depth_of_a_groove() -> None:
    def groove(angle_deg: float, depth: float) -> ShapeGroup:
        half = np.radians(angle_deg / 2)
        width, length = depth / np.cos(half), 40e-3
        flanks = []
        for name, sign in (("left", -1), ("right", 1)):
            middle = np.array([sign * width * np.sin(half) / 2, 0, -depth + width * np.cos(half) / 2])
            flanks.append(part(name, Plane(width, length), at(*middle, turn=(0, -sign * (90 - angle_deg / 2), 0))))
        return group(*flanks, part("top", Plane(20e-3, length), at(x=10e-3 + width * np.sin(half))))

    found = evaluate_against_artefact(cloud(groove(90.02, 8.012e-3)), groove(90.0, 8e-3))
    assert figure(found, "groove angle", "left - right").nominal == pytest.approx(np.pi / 2)
    assert agrees(figure(found, "groove angle", "left - right"), np.radians(0.02))
    depth = figure(found, "groove depth", "left - right / top")
    assert depth.nominal == pytest.approx(8e-3)
    assert agrees(depth, 12e-6)
    angle_row, depth_row = figure(found, "groove angle", "left - right").as_row(), depth.as_row()
    assert (angle_row["nominal_deg"], depth_row["nominal_mm"]) == pytest.approx((90.0, 8.0))
    assert (angle_row["error_deg"], depth_row["error_um"]) == pytest.approx((0.02, 12.0), rel=0.1)


def test_ring_cylinder_and_cone() -> None:
    nominal = group(
        part("ring", Ring(20e-3, 30e-3, 15e-3)),
        part("pin", Cylinder(8e-3, 40e-3), at(x=80e-3)),
        part("cone", Cone(15e-3, 5e-3, 30e-3), at(x=-80e-3)),
    )
    true = group(
        part("ring", Ring(20.004e-3, 30e-3, 15e-3)),
        part("pin", Cylinder(8.006e-3, 40e-3), at(x=80e-3)),
        part("cone", Cone(15.01e-3, 4.99e-3, 30e-3), at(x=-80e-3)),
    )
    found = evaluate_against_artefact(cloud(true, 100_000), nominal)
    assert agrees(figure(found, "diameter", "ring"), 8e-6)
    assert agrees(figure(found, "diameter", "pin"), 12e-6)
    assert figure(found, "bias", "ring").value == pytest.approx(-4e-6, abs=0.5e-6)  # a wider bore lies in the material
    angle = figure(found, "cone angle", "cone")
    assert agrees(angle, 2 * (np.arctan(10.02 / 30) - np.arctan(10 / 30)))
    assert angle.nominal == pytest.approx(2 * np.arctan(1 / 3))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sphere", {"probing size"}),
        ("ball_bar", {"probing size", "sphere spacing"}),
        ("ball_plate", {"probing size", "sphere spacing"}),
        ("plane", {"flatness"}),
        ("step", {"step height", "flatness"}),
        ("v_groove", {"groove angle", "flatness"}),
        ("ring", {"diameter"}),
        ("cone", {"cone angle"}),
        ("cylinder", {"diameter", "form"}),
    ],
)
def test_shipped_artefacts_without_noise_have_no_errors(name: str, expected: set[str]) -> None:
    artefact = load_artefact(assets_dir() / "artefacts" / f"{name}.toml")
    found = evaluate_against_artefact(cloud(artefact, 20_000, 0.0), artefact)
    assert expected <= {figure.name for figure in found.characteristics}
    assert max(abs(figure.error) for figure in found.characteristics) < 1e-9
    assert found.outlier_rate == 0.0


@pytest.mark.parametrize("align", ["best-fit", "datum"])
def test_alignment_recovers_the_pose_of_the_artefact(align: str) -> None:
    box = group(part("block", Box(30e-3, 20e-3, 10e-3)))
    moved = pose.from_rotation(Rotation.from_rotvec([0.01, -0.02, 0.015]).as_matrix(), [0.5e-3, -0.3e-3, 0.4e-3])
    points = pose.transform_points(moved, cloud(box, noise=0.0))
    datum = ("block:+z", "block:+x", "block:+y") if align == "datum" else ()
    found = evaluate_against_artefact(points, box, align, datum)  # type: ignore[arg-type]
    assert np.abs(found.artefact_from_cloud @ moved - np.eye(4)).max() < 1e-9
    assert found.statistics.max_abs < 1e-9


def test_datum_faces_without_points_are_named() -> None:
    box = group(part("block", Box(30e-3, 20e-3, 10e-3)))
    points = cloud(box, noise=0.0)
    points = points[points[:, 2] > -4.9e-3]
    with pytest.raises(FitError, match=r"datum: 0 points lie on block:-z of .*; measured: block:\+x, "):
        evaluate_against_artefact(points, box, "datum", ("block:-z", "block:+x", "block:+y"))
    assert evaluate_against_artefact(points, box, "datum").datum == tuple(
        f"block:{f}" for f in ("+x", "-x", "+y", "-y", "+z")
    )
    with pytest.raises(DescriptionError, match="align = 'bestfit'"):
        evaluate_against_artefact(points, box, "bestfit")  # type: ignore[arg-type]
    with pytest.raises(DescriptionError, match="holds no points"):
        evaluate_against_artefact(points[:0], box)


def test_datum_makes_the_primary_plane_fit_and_leaves_the_deviation_elsewhere() -> None:
    box, true = (group(part("block", Box(30e-3, 20e-3, height))) for height in (10e-3, 10.02e-3))
    found = evaluate_against_artefact(cloud(true, noise=0.0), box, "datum", ("block:+z", "block:+x", "block:+y"))
    assert figure(found, "bias", "block:+z").value == pytest.approx(0.0, abs=1e-9)
    assert figure(found, "bias", "block:-z").value == pytest.approx(20e-6, abs=1e-9)


def test_outliers_and_missing_points_are_counted() -> None:
    plane = group(part("plane", Plane(60e-3, 40e-3)))
    points = cloud(plane, noise=0.0)
    points = points[points[:, 0] > 0]
    stray = np.tile([0.0, 0.0, 10e-3], (len(points) // 99, 1))
    found = evaluate_against_artefact(np.concatenate([points, stray]), plane)
    assert found.outlier_rate == pytest.approx(0.01, rel=0.02)
    # Of the half without points a strip as wide as the tolerance has points near it: 1 of 58 mm.
    assert found.missing_rate["plane"] == pytest.approx(28 / 58, abs=0.01)


def test_a_face_seen_along_one_line_is_named_and_the_others_are_measured() -> None:
    box = group(part("block", Box(30e-3, 20e-3, 10e-3)))
    points = cloud(box, noise=0.0)
    line = np.stack([np.full(50, 15e-3), np.linspace(-8e-3, 8e-3, 50), np.zeros(50)], 1)
    found = evaluate_against_artefact(np.concatenate([points[points[:, 2] > 4.99e-3], line]), box)
    assert [one.face.name for one in found.faces] == ["block:+z"]
    assert "on one line" in found.unfitted["block:+x"]


def test_narrowest_range_holds_the_share() -> None:
    values = np.concatenate([np.linspace(0, 1, 95), np.full(5, 10.0)])
    assert narrowest_range(values) == pytest.approx(1.0)
    assert narrowest_range(np.arange(100.0), 1.0) == 99.0


def test_a_cloud_elsewhere_is_rejected() -> None:
    with pytest.raises(FitError, match="in the frame of the artefact"):
        evaluate_against_artefact(cloud(BALL) + np.array([1.0, 0, 0]), BALL)
