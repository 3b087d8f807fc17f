"""Pictures: they appear whole, show what is asked for, and hold up against clouds that are hard to draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.image import imread

from orchestrator.errors import OutputError
from orchestrator.evaluation.coverage import sample_surface
from orchestrator.evaluation.deviation import deviation_from_mesh
from orchestrator.evaluation.pictures import colour_limit_um, deviation_picture
from orchestrator.evaluation.scene_picture import scene_picture
from orchestrator.evaluation.stripe_picture import stripe_picture
from orchestrator.evaluation.surface_view import view_axes
from orchestrator.geometry.mesh import Mesh
from orchestrator.reconstruction import Cloud


def box(size: tuple[float, float, float], shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    solid = trimesh.creation.box(size)
    return Mesh(np.asarray(solid.vertices) + np.array(shift), np.asarray(solid.faces, np.int64), "box")


BOX = box((0.08, 0.06, 0.04))


def cloud_of(points: np.ndarray) -> Cloud:
    n, ones = len(points), np.ones(len(points))
    camera, segment = np.zeros(n, np.int32), np.ones(n, np.int32)
    return Cloud(points, np.zeros((n, 3)), ones, ones, ones, camera, camera, np.zeros(n, np.int64), segment, ones)


@pytest.mark.parametrize("count", [0, 1, 3000])
def test_deviation_picture_of_many_few_and_no_points(tmp_path: Path, count: int) -> None:
    points = sample_surface(BOX, 3000, seed=1)[0][:count]
    offset = 1e-6 * np.arange(count)
    face = np.zeros(count, np.int64)
    deviation = deviation_from_mesh(cloud_of(points), BOX, lambda v, f, p: (p, face, offset))
    deviation_picture(tmp_path / "deviation.png", cloud_of(points), deviation, BOX, name="box", coverage_fraction=0.5)
    image = imread(tmp_path / "deviation.png")
    assert image.shape[0] > 800 and image.shape[1] > 1200
    assert [entry.name for entry in tmp_path.iterdir()] == ["deviation.png"]


def test_a_picture_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match=r"file"):
        stripe_picture(tmp_path / "file" / "a.png", [np.zeros((40, 80), np.uint16)], [(np.zeros(0),) * 2], names=["a"])


@pytest.mark.parametrize("spread", [1e-9, 3e-7, 8e-6, 2e-3])
def test_colour_scale_is_round_and_holds_nineteen_points_of_twenty(spread: float) -> None:
    signed = np.random.default_rng(2).normal(0, spread, 5000)
    limit = colour_limit_um(signed)
    assert np.mean(np.abs(1e6 * signed) <= limit) >= 0.95 - 1e-12
    assert limit <= 2 * max(1e6 * np.quantile(np.abs(signed), 0.95), 1e-3)


def test_one_wild_point_does_not_bleach_the_scale() -> None:
    signed = np.random.default_rng(3).normal(0, 5e-6, 5000)
    assert colour_limit_um(np.append(signed, 0.05)) == colour_limit_um(signed)


@pytest.mark.parametrize("azimuth", [-200.0, -55.0, 0.0, 125.0])
def test_view_axes_are_right_handed_and_upright(azimuth: float) -> None:
    axes = view_axes(azimuth, 35.0)
    assert axes @ axes.T == pytest.approx(np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[0, 2] == pytest.approx(0.0) and axes[1, 2] > 0
    assert axes[2, 2] == pytest.approx(np.sin(np.radians(35.0)))


def test_stripe_picture_takes_any_number_of_cameras_and_no_peaks(tmp_path: Path) -> None:
    columns = np.arange(20.0, 100.0)
    image = np.full((96, 128), 4, np.uint16)
    image[50] = 200
    found, nothing = (columns, np.full(80, 50.2)), (np.zeros(0), np.zeros(0))
    for count in (1, 2, 3):
        path = tmp_path / f"{count}.png"
        peaks = [found] * (count - 1) + [nothing]
        stripe_picture(path, [image] * count, peaks, names=[f"camera {i}" for i in range(count)], title="t")
        assert imread(path).shape[1] > 600 * count


def test_scene_shows_colours_where_things_stand(tmp_path: Path) -> None:
    red, blue = box((0.1, 0.1, 0.1), (-0.1, 0.0, 0.05)), box((0.1, 0.1, 0.1), (0.1, 0.0, 0.05))
    scene_picture(
        tmp_path / "scene.png",
        [red, blue],
        [(0.9, 0.1, 0.1), (0.1, 0.1, 0.9)],
        eye=(0.0, -1.0, 0.4),
        target=(0.0, 0.0, 0.05),
        size_px=(200, 150),
    )
    image = imread(tmp_path / "scene.png")[:, :, :3]
    left, right = image[:, :100].reshape(-1, 3), image[:, 100:].reshape(-1, 3)
    assert ((left[:, 0] > 2 * left[:, 2]).mean() > 0.02) and not (left[:, 2] > 2 * left[:, 0]).any()
    assert ((right[:, 2] > 2 * right[:, 0]).mean() > 0.02) and not (right[:, 0] > 2 * right[:, 2]).any()
