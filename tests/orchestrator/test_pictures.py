"""Pictures: they appear whole, show what is asked for, and hold up against clouds that are hard to draw."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from cells import cloud_of, mesh_of
from PIL import Image

from scancell.errors import OutputError
from scancell.evaluation.deviation import Deviation
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, sample_surface
from scancell.output.deviation_report import colour_limit_um, deviation_colours, deviation_picture
from scancell.output.pictures import SurfaceView, sharp_edges, stripe_picture, view_axes
from scancell.output.sheet import Sheet, _font, ticks


def box(size: tuple[float, float, float], shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    return mesh_of(trimesh.creation.box(size, pose.translation(shift)))


BOX = box((0.08, 0.06, 0.04))
RED = np.array([255.0, 0.0, 0.0])


def imread(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def is_red(image: np.ndarray) -> np.ndarray:
    """Pixels of a colour that neither the grey part nor its edges have."""
    return (image[..., 0] > 100) & (image[..., 0].astype(int) - image[..., 1] > 60)


@pytest.mark.parametrize("count", [0, 1, 3000])
def test_deviation_picture_of_many_few_and_no_points(tmp_path: Path, count: int) -> None:
    points = sample_surface(BOX, 3000, seed=1)[0][:count]
    offset = 1e-6 * np.arange(count)
    face = np.zeros(count, np.int64)
    deviation = Deviation.of(cloud_of(points), offset, face)
    deviation_picture(points, deviation, BOX, name="box", coverage_fraction=0.5).write(tmp_path / "deviation.png")
    image = imread(tmp_path / "deviation.png")
    assert image.shape[0] > 800 and image.shape[1] > 1200
    assert [entry.name for entry in tmp_path.iterdir()] == ["deviation.png"]


def test_a_picture_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match=r"file"):
        stripe_picture([np.zeros((40, 80), np.uint16)], [(np.zeros(0),) * 2], names=["a"]).write(
            tmp_path / "file" / "a.png"
        )


@pytest.mark.parametrize("d95", [3e-10, 1e-9, 3.1e-7, 8e-6, 2e-3])
def test_colour_scale_holds_the_95_percent_quantile_and_is_round(d95: float) -> None:
    limit = colour_limit_um(d95)
    assert 1e6 * d95 <= limit <= 2 * max(1e6 * d95, 1e-3)
    assert f"{limit:e}"[:4] in {"1.00", "1.50", "2.00", "3.00", "5.00", "7.00"}


def test_colour_scale_of_an_empty_cloud_is_finite() -> None:
    assert colour_limit_um(float("nan")) == 1.0


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
        stripe_picture([image] * count, peaks, names=[f"camera {i}" for i in range(count)], title="t").write(path)
        assert imread(path).shape[1] > 600 * count


def on_surface(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    points, face = trimesh.sample.sample_surface(
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), count, seed=1
    )
    return np.asarray(points), np.asarray(face)


def red_view(mesh: Mesh, points: np.ndarray, face: np.ndarray) -> SurfaceView:
    return SurfaceView(mesh, points, np.zeros(len(points)), face, lambda values: np.tile(RED, (len(values), 1)))


def test_views_show_points_from_their_side_only() -> None:
    points, face = on_surface(BOX, 80_000)
    front = np.isclose(points[:, 0], 0.04)
    view = red_view(BOX, points[front], face[front])
    shown, _ = view.draw(view_axes(0.0, 0.0), 300, 300)
    hidden, _ = view.draw(view_axes(180.0, 0.0), 300, 300)
    part = (shown < 250).any(2)
    assert is_red(shown).sum() > 0.7 * part.sum()
    assert is_red(hidden).sum() == 0


def test_a_part_hides_what_lies_behind_it() -> None:
    """The near one of two blocks stands before the lower half of the far one."""
    near, far = box((0.01, 0.06, 0.02), (0.05, 0.0, -0.01)), box((0.01, 0.06, 0.04))
    both = Mesh(np.concatenate([near.vertices, far.vertices]), np.concatenate([near.faces, far.faces + 8]), "two")
    points, face = on_surface(both, 40_000)
    on_far = np.isclose(points[:, 0], 0.005)
    image, px_per_m = red_view(both, points[on_far], face[on_far]).draw(view_axes(0.0, 0.0), 400, 300)
    red = np.flatnonzero(is_red(image).mean(1) > 0.5)
    assert len(red) == pytest.approx(0.02 * px_per_m, abs=3)
    assert red.max() == pytest.approx(image.shape[0] / 2, abs=3)


@pytest.mark.parametrize(("azimuth", "width", "height"), [(0.0, 0.06, 0.04), (90.0, 0.08, 0.04)])
def test_views_are_to_scale(azimuth: float, width: float, height: float) -> None:
    view = red_view(BOX, np.zeros((0, 3)), np.zeros(0, np.int64))
    image, px_per_m = view.draw(view_axes(azimuth, 0.0), 400, 300)
    part = (image < 250).any(2)
    assert part.any(0).sum() == pytest.approx(width * px_per_m, abs=2)
    assert part.any(1).sum() == pytest.approx(height * px_per_m, abs=2)
    assert 0.9 * 400 < image.shape[1] <= 400 or 0.9 * 300 < image.shape[0] <= 300


def test_outlying_points_do_not_break_a_view() -> None:
    points = np.array([[0.04, 0.0, 0.0], [5.0, 5.0, 5.0], [0.04, -3.0, 0.01]])
    image, _ = red_view(BOX, points, np.full(3, int(np.argmax(BOX.normals[:, 0])))).draw(view_axes(0.0, 0.0), 300, 200)
    assert is_red(image).any()


@pytest.mark.parametrize("soup", [False, True])
def test_sharp_edges_are_those_of_the_shape(soup: bool) -> None:
    def edges_of(made: trimesh.Trimesh) -> np.ndarray:
        corners, faces = np.asarray(made.vertices), np.asarray(made.faces, np.int64)
        if soup:
            corners, faces = corners[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
        return np.linalg.norm(np.diff(sharp_edges(Mesh(corners, faces))[0], axis=1), axis=-1)

    assert edges_of(trimesh.creation.box((0.08, 0.06, 0.04))).sum() == pytest.approx(4 * 0.18)
    assert len(edges_of(trimesh.creation.icosphere(3, 0.02))) == 0
    rims = edges_of(trimesh.creation.cylinder(0.02, 0.03, sections=128))
    assert rims.sum() == pytest.approx(4 * np.pi * 0.02, rel=1e-3)


@pytest.mark.parametrize(("low", "high"), [(-0.7, 0.7), (0.0, 9.9), (-3e-4, 3e-4), (0.0, 1234.0), (-20.0, 20.0)])
def test_ticks_are_round_and_evenly_spaced(low: float, high: float) -> None:
    marks = ticks(low, high, 8)
    values = np.array([value for value, _ in marks])
    assert 3 <= len(marks) <= 9
    assert low - 1e-12 <= values.min() and values.max() <= high * (1 + 1e-12)
    np.testing.assert_allclose(np.diff(values), values[1] - values[0])
    labels = [float(label.replace("\N{MINUS SIGN}", "-")) for _, label in marks]
    np.testing.assert_allclose(labels, values, atol=1e-9 * high)
    assert not any(label.strip("\N{MINUS SIGN}0.") == "" and label[0] == "\N{MINUS SIGN}" for _, label in marks)


def test_colours_go_from_blue_through_pale_to_red() -> None:
    blue, pale, red = deviation_colours(np.array([-5.0, 0.0, 5.0]), 5.0)
    assert blue[2] > 2 * blue[0] and red[0] > 2 * red[2]
    assert pale.min() > 180
    assert (deviation_colours(np.array([-50.0, 50.0]), 5.0) == [blue, red]).all()


def test_the_font_has_the_letters_that_are_used() -> None:
    missing = bytes(_font(16.5, False).getmask("\uf8ff"))
    for bold in (False, True):
        for letter in "µ±°·×−äéßŁσЖ≤":
            assert bytes(_font(16.5, bold).getmask(letter)) != missing, letter


def test_text_is_anchored_at_its_position() -> None:
    for anchor, left in (("ls", 100), ("ms", 50), ("rs", 0)):
        sheet = Sheet(200, 40)
        sheet.text(100, 30, "HHHHHHHHHH", 12, anchor=anchor)
        dark = np.flatnonzero((sheet.pixels < 128).any((0, 2)))
        assert left - 2 <= dark.min() and dark.max() <= left + 102
        assert np.flatnonzero((sheet.pixels < 128).any((1, 2))).max() == 29


def test_the_found_stripe_is_drawn_where_it_is(tmp_path: Path) -> None:
    image = np.full((96, 128), 4, np.uint16)
    columns = np.concatenate([np.arange(10.0, 50.0), np.arange(70.0, 120.0)])
    stripe_picture([image], [(columns, np.full(90, 30.0))], names=["a"]).write(tmp_path / "a.png")
    picture = imread(tmp_path / "a.png")
    left = np.flatnonzero((picture[130:600] == 0).all(2).mean(0) > 0.5)  # the dark image on its paper
    orange = (picture[..., 0] > 200) & (picture[..., 2] < 120)
    line = orange[: 92 + 540]
    rows = np.flatnonzero(line[:, left].sum(1) > 100)
    assert rows.mean() == pytest.approx(92 + 30.5 * 720 / 128, abs=1.5)
    drawn = np.flatnonzero(line[rows[0]]) - left.min()
    gap = np.argmax(np.diff(drawn))
    assert drawn[gap] == pytest.approx(49.5 * 720 / 128, abs=3)
    assert drawn[gap + 1] == pytest.approx(70.5 * 720 / 128, abs=3)
