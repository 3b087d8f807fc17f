"""The stripe, drawn from a mesh of the lit surface, compared with path tracing of every pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import (
    Array,
    cluttered_exposures,
    fast_and_paths,
    moving,
    plane,
    pose,
    probe,
    still,
    stripe_centres,
)

from scancell.sensor import Exposures, Material, Scene, expected_electrons

DN_PER_ELECTRON = 0.0225


def grid_mesh(spacing: float, amplitude: float) -> tuple[Array, NDArray[np.uint32]]:
    """Waves of `amplitude` (m) as triangles with edges of about `spacing` (m)."""
    count = round(0.06 / spacing)
    place = np.stack(np.meshgrid(np.linspace(-0.03, 0.03, count), np.linspace(-0.03, 0.03, count), indexing="ij"), -1)
    height = amplitude * np.sin(300 * place[..., 1] + 0.3) * np.cos(200 * place[..., 0])
    vertices = np.concatenate([place, height[..., None]], axis=-1).reshape(-1, 3)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    lower = np.stack([corner, corner + count, corner + 1], 1)
    upper = np.stack([corner + 1, corner + count, corner + count + 1], 1)
    return vertices, np.concatenate([lower, upper]).astype(np.uint32)


def exposures_of(place: Array, moves: bool) -> Exposures:
    """A shift and a turn by up to 0.9 px at the ends of the line during the exposure, or none."""
    later: Array = pose((1.2e-5, -8e-6, 8e-6), (8e-5, 4e-5, 8e-5)) @ place
    return moving([[place], [later]], [np.eye(4)] * 2) if moves else still(place)


def assert_same_stripe(fast: Array, paths: Array, pixel: float = 3e-3, centre_px: float = 1e-3) -> None:
    """Compares pixels (relative to their light and a tenth of the peak) and centres and sums of columns."""
    peak = paths.max()
    bright = paths > 0.01 * peak
    assert bright.sum() > 1000
    error = (np.abs(fast - paths) / (paths + 0.1 * peak))[bright]
    assert np.quantile(error, 0.99) < pixel
    assert error.max() < 3 * pixel
    (centre, total), (true_centre, true_total) = stripe_centres(fast), stripe_centres(paths)
    whole = true_total > 0.5 * np.median(true_total[true_total > 0])
    assert whole.sum() > 150
    assert np.abs(centre - true_centre)[whole].max() < 3 * centre_px
    assert np.sqrt(np.mean((centre - true_centre)[whole] ** 2)) < centre_px
    np.testing.assert_allclose(total[whole], true_total[whole], rtol=pixel)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("angles", [(0.25, -0.2, 0.4), (-0.5, 0.4, 0.0)])
@pytest.mark.parametrize("z", [0.08, 0.155])
def test_plane_matches_path_tracing(z: float, angles: tuple[float, float, float], moves: bool) -> None:
    fast, paths = fast_and_paths(plane(size=0.1), exposures_of(pose((0, 0, z), angles), moves), 1024)
    assert_same_stripe(fast, paths)
    assert fast.sum() == pytest.approx(paths.sum(), rel=5e-5)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("amplitude", [5e-5, 5e-4])
@pytest.mark.parametrize("spacing", [2e-4, 1e-3])
def test_faceted_surface_matches_path_tracing(spacing: float, amplitude: float, moves: bool) -> None:
    """Edges between faces cross many pixels; with the larger amplitude they form angles of some degrees."""
    scene = Scene()
    scene.add_mesh("waves", *grid_mesh(spacing, amplitude), 0.5)
    fast, paths = fast_and_paths(scene, exposures_of(pose((0, 0, 0.13), (0.1, 0.2, 0.3)), moves), 1024)
    assert_same_stripe(fast, paths, pixel=5e-3)


@pytest.mark.parametrize("model", ["oren_nayar", "rough_conductor", "rough_dielectric"])
def test_materials_match_path_tracing(model: str) -> None:
    scene = Scene()
    scene.add_mesh("waves", *grid_mesh(1e-3, 5e-5), Material(0.6, model, 0.2, 1.5))
    fast, paths = fast_and_paths(scene, exposures_of(pose((0, 0, 0.13), (0.1, 0.25, 0.3)), True), 1024)
    assert_same_stripe(fast, paths, pixel=5e-3)


STRAIGHTNESS = [0.0, 2e-4, 3e-4, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "sensor",
    [
        {"laser": {"straightness": STRAIGHTNESS, "turn_y": 0.004, "turn_z": 0.01}},
        {"laser": {"profile_angle": [-0.28, 0.0, 0.28], "profile_power": [0.4, 1.0, 0.4]}},
        {"camera": {"distortion": [-0.12, 0.05, 0.002, -0.001, 0.03]}},
        {"camera": {"scheimpflug_x": 0.1, "scheimpflug_y": -0.05, "roll": 0.02, "pan": 0.01, "offset_y": 1e-3}},
        {"camera": {"roll": 0.6}},
    ],
    ids=["bent and turned", "uneven", "distortion", "tilted sensor", "roll"],
)
def test_sensors_match_path_tracing(sensor: dict[str, Any]) -> None:
    scene = Scene()
    scene.add_mesh("waves", *grid_mesh(1e-3, 5e-5), 0.5)
    fast, paths = fast_and_paths(scene, still(pose((0, 0, 0.125), (0.1, 0.2, 0.3))), 1024, **sensor)
    assert_same_stripe(fast, paths, pixel=5e-3)


@pytest.mark.parametrize("moves", [False, True])
def test_cluttered_scene_is_within_one_digital_number(moves: bool) -> None:
    """Steps, slots, wires, steep walls and silhouettes, of which some move by 7 px."""
    scene, exposures = cluttered_exposures(moves)
    fast, paths = fast_and_paths(scene, exposures, 256, columns=(500, 700))
    lit = paths > 0
    assert lit.sum() > 1500
    error = np.abs(fast - paths) * DN_PER_ELECTRON
    assert np.mean(error <= 1.0) > 0.999
    assert np.mean(error[lit] <= 1.0) > 0.97
    assert fast.sum() == pytest.approx(paths.sum(), rel=1e-3)


def fine_waves(gap: float, facet: float) -> tuple[Array, NDArray[np.uint32]]:
    """Shallow waves with faces of about that size (m), in two pieces separated by a gap."""
    across = np.linspace(-0.004, 0.004, round(0.008 / facet) + 1)
    along = np.linspace(-0.006, 0.006, 2 * round(0.006 / facet))
    beyond = np.tile(along > 0, len(across))
    along = along + np.where(along > 0, gap - (along[1] - along[0]), 0.0)
    place = np.stack(np.meshgrid(across, along, indexing="ij"), axis=-1)
    height = 1e-4 * np.sin(800 * place[..., 1]) * np.cos(500 * place[..., 0])
    vertices = np.concatenate([place, height[..., None]], axis=-1).reshape(-1, 3)
    rows = len(along)
    corner = (np.arange(len(across) - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + rows, corner + 1], 1), np.stack([corner + 1, corner + rows, corner + rows + 1], 1)]
    )
    in_one_piece = beyond[faces].all(axis=1) | ~beyond[faces].any(axis=1)
    return vertices, faces[in_one_piece].astype(np.uint32)


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("gap", [6e-5, 1e-4])  # the pixel footprint is 40 µm
def test_gap_between_fine_faces_is_dark(gap: float, moves: bool) -> None:
    scene = Scene()
    scene.add_mesh("waves", *fine_waves(gap, 3e-5), 0.5)
    place = pose((0, 0, 0.14), (0.1, 0.2, 0.3))
    later: Array = pose((5e-6, -1e-5, 5e-6), (5e-5, 2e-5, 0)) @ place
    exposures = moving([[place], [later]], [np.eye(4)] * 2) if moves else still(place)
    fast, paths = fast_and_paths(scene, exposures, 256)
    (centre, total), (true_centre, true_total) = stripe_centres(fast), stripe_centres(paths)
    assert true_total.min() < 0.6 * np.median(true_total)  # the gap
    for share, limit in ((0.1, 0.1), (0.9, 0.02)):
        bright = true_total > share * true_total.max()
        assert np.abs(centre - true_centre)[bright].max() < limit
    np.testing.assert_allclose(total, true_total, atol=0.03 * true_total.max())
    assert fast.sum() == pytest.approx(paths.sum(), rel=2e-3)


@pytest.mark.parametrize("motion", ["rotation about Z", "vibration"])
def test_thin_strip_that_passes_the_line_is_seen(motion: str) -> None:
    """A strip along the line is beside it at both ends of the exposure."""
    scene = Scene()
    scene.add_plane("table", pose((0, 0, 0.01)), [0.2, 0.2], 0.2)
    scene.add_plane("strip", np.eye(4), [1.2e-4, 0.06], 0.9)
    aside, at = pose((4e-4, 0, 0.12)), pose((-4e-4, 0, 0.12))
    turned = [pose((0, 0, 0.12), (0, 0, angle)) for angle in (-0.02, 0.02)]
    poses = turned if motion == "rotation about Z" else [aside, at, aside]
    exposures = moving([[p, p] for p in poses], [np.eye(4)] * len(poses))
    fast, paths = fast_and_paths(scene, exposures, 1024)
    assert fast.sum() == pytest.approx(paths.sum(), rel=0.01)
    (_, total), (_, true_total) = stripe_centres(fast), stripe_centres(paths)
    np.testing.assert_allclose(total, true_total, rtol=0.05)


def test_surface_that_leaves_the_light_during_the_exposure_is_averaged() -> None:
    """A plane that moves along its normal: the mean of images at rest."""
    place, end = pose((0, 0, 0.12), (0.1, 0.3, 0.0)), pose((0, 0, 0.1206), (0.1, 0.3, 0.0))
    sensor = probe(1)
    scene = plane(size=0.1)
    moved = expected_electrons(scene, sensor, moving([[place], [end]], [np.eye(4)] * 2))[0, 0].astype(float)
    steps = (np.arange(200) + 0.5) / 200
    stills = [expected_electrons(scene, sensor, still(place + s * (end - place)))[0, 0] for s in steps]
    mean = np.mean(np.asarray(stills, float), axis=0)
    np.testing.assert_allclose(moved, mean, atol=5e-3 * mean.max())
    (centre, total), (true_centre, true_total) = stripe_centres(moved), stripe_centres(mean)
    inside = slice(100, -100)
    assert np.abs(centre - true_centre)[inside].max() < 2e-3
    np.testing.assert_allclose(total[inside], true_total[inside], rtol=1e-3)


def test_ambient_light_is_included() -> None:
    scene = plane(size=0.1)
    exposures = still(pose((0, 0, 0.13), (0.1, 0.2, 0.3)))
    dark, bright = (probe(1, ambient={"irradiance": e}) for e in (0.0, 2.0))
    added = expected_electrons(scene, bright, exposures) - expected_electrons(scene, dark, exposures)
    alone = expected_electrons(scene, probe(1, ambient={"irradiance": 2.0}, laser={"power": 0.0}), exposures)
    np.testing.assert_allclose(added, alone, rtol=2e-3)
