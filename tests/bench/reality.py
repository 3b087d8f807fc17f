"""Public recordings of real sensors: ``PYTHONPATH=tests python -m bench.reality --data FOLDER``.

FOLDER holds checkouts of the public repositories, whatever their names: those with ``etna_calib/data``,
``data/Standard_sphere_seg_dataset_v1`` and ``data/ScanData``. The tables go to docs/reality.md, between its marks.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest, t

from bench.ball_prediction import prediction_lines
from bench.ball_profiles import BALL_RADIUS, Circle, FoundBall, circle_of, read_profiles, repeated_poses
from bench.board_prediction import displacement, prediction_error, seen_pose
from bench.robot_ball import robot_ball_lines
from scancell.calibration.board.solve import (
    COUNT,
    BoardView,
    Rig,
    calibrate_cameras,
    plane_frame,
    solve,
    start_rig,
    stripes_in_camera,
)
from scancell.calibration.board.views import Board, BoardViews, read_views
from scancell.calibration.measured_table import write_measured_table
from scancell.calibration.pose_files import flange_columns
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.progress import NullProgress

Array = NDArray[np.float64]

REPORT = Path(__file__).resolve().parents[2] / "docs" / "reality.md"
BOARD = Board(7, 6, 0.010)
# Of the folders with images; those of calib5 are those of calib4.
HAS_VISION_CALIBRATION = importlib.util.find_spec("vision_calibration") is not None
HAS_ENGEOM = importlib.util.find_spec("engeom") is not None
LEAST_HALF = 4  # images
FOLDERS = (".", "calib1", "calib2", "calib3", "calib4", "calib6")


@dataclass(frozen=True)
class Held:
    """Errors of a left-out image: corners (px, RMS), board (mm, deg), stripe to board (mm, RMS; NaN without one)."""

    corners: float
    position: float
    orientation: float
    stripe: float


def etna_views(data: Path, folder: str) -> BoardViews:
    """The images of a folder of etna, with its poses as a table; those whose names begin with ``frame`` count."""
    with tempfile.TemporaryDirectory() as made:
        names, poses = [], []
        for image in sorted((data / folder).glob("frame0*.png")):
            stated = image.with_name(image.name.replace("frame", "pose")).with_suffix(".txt")
            if stated.exists():
                position, quaternion = ast.literal_eval(stated.read_text())
                names.append(image.name)
                poses.append(pose.from_rotation(Rotation.from_quat(quaternion).as_matrix(), position))
                (Path(made) / image.name).symlink_to(image.resolve())
        write_measured_table(Path(made) / "poses.csv", {"image": names, **flange_columns(np.array(poses))})
        return read_views(Path(made), BOARD, load_setup().sensor, None, 1, NullProgress())


def opencv_chain(views: Sequence[BoardView], size: tuple[int, int]) -> Rig:
    """One after the other: intrinsics, hand-eye, mean of the boards, plane through the stripes."""
    intrinsics, boards = calibrate_cameras(views, size)
    flange = np.stack([view.flange for view in views])
    rotation, offset = cv2.calibrateHandEye(
        list(flange[:, :3, :3]),
        list(flange[:, :3, 3]),
        list(boards[:, :3, :3]),
        list(boards[:, :3, 3]),
        method=cv2.CALIB_HAND_EYE_PARK,
    )
    camera = pose.from_rotation(rotation, np.ravel(offset))
    in_base = flange @ camera @ boards
    u, _, vt = np.linalg.svd(in_base[:, :3, :3].mean(0))
    rig = Rig(intrinsics, camera, pose.from_rotation(u @ vt, in_base[:, :3, 3].mean(0)), np.eye(4))
    return replace(rig, sheet=plane_frame(stripes_in_camera(rig, views, boards)))


def vision_calibration_chain(views: Sequence[BoardView]) -> tuple[Rig, float]:
    """The package of that name: camera, hand-eye and board in one adjustment; plane through the stripes on the boards.

    Returns the rig with one focal length, and the factor by which rows are stretched for it.
    """
    import vision_calibration as peer  # noqa: PLC0415  (not required)

    def posed(view: BoardView) -> Any:
        quaternion = Rotation.from_matrix(view.flange[:3, :3]).as_quat()
        return peer.Pose(tuple(quaternion.tolist()), tuple(view.flange[:3, 3].tolist()))

    seen = [
        peer.SingleCamHandeyeView(
            peer.Observation(
                [tuple(point) for point in view.corners.tolist()], [tuple(p) for p in view.corner_pixels.tolist()]
            ),
            posed(view),
        )
        for view in views
    ]
    found = peer.run_single_cam_handeye(peer.SingleCamHandeyeDataset(seen), peer.SingleCamHandeyeCalibrationConfig())
    camera, board = (
        pose.from_rotation(Rotation.from_quat(one.rotation_xyzw).as_matrix(), np.array(one.translation_xyz))
        for one in (found.gripper_se3_camera, found.base_se3_target)
    )
    k, d = found.camera.intrinsics, found.camera.distortion
    aspect = k.fx / k.fy
    rig = Rig(np.array([k.fx, k.cx, aspect * k.cy, d.k1, d.k2, d.p1, d.p2]), camera, board, np.eye(4))
    stretched = [stretched_rows(view, aspect) for view in views]
    sheet = plane_frame(stripes_in_camera(rig, stretched, np.stack([seen_pose(rig, view) for view in stretched])))
    return replace(rig, sheet=sheet), aspect


def stretched_rows(view: BoardView, factor: float) -> BoardView:
    """The view with the rows of its image stretched."""
    by = np.array([1.0, factor])
    return replace(view, corner_pixels=view.corner_pixels * by, stripe=view.stripe * by)


def held_errors(rig: Rig, view: BoardView) -> Held:
    """Errors of a rig at an image that it was not calibrated by."""
    board = rig.camera_from_board(view.flange)
    pixels = rig.project(pose.transform_points(board, view.corners)) - view.corner_pixels
    away = displacement(board, seen_pose(rig, view))
    stripe = pose.transform_points(pose.inverse(board), rig.on_sheet(view.stripe))[:, 2]
    return Held(
        float(np.sqrt(np.mean(np.sum(pixels**2, 1)))),
        float(np.linalg.norm(away[:3])),
        float(np.degrees(1e-3 * np.linalg.norm(away[3:]))),
        1e3 * float(np.sqrt(np.mean(stripe**2))) if len(stripe) else float("nan"),
    )


def ball_half_lines(data: Path) -> Iterator[str]:
    """Table of what the simulation of one half of the poses predicts of the other."""
    found = [
        FoundBall(profile, circle)
        for profile in read_profiles(data)
        if profile.pose is not None and (circle := circle_of(profile.points)) is not None
    ]
    yield from prediction_lines(repeated_poses(found))


@dataclass
class FolderResult:
    """Calibration of a folder, and errors of every image by what the others give; `inside` (n, 6) of the intervals."""

    name: str
    images: int
    sizes: Array
    focal: tuple[float, float]
    ours: list[Held]
    chain: list[Held]
    peer: list[Held]
    inside: NDArray[np.bool_]


def etna_folder(data: Path, folder: str) -> FolderResult:
    """Leave one image out at a time."""
    found = etna_views(data, folder)
    views, size = found.views, found.size
    whole = solve(views, start_rig(views, size))
    half_width = whole.estimate.half_widths(np.eye(1, COUNT))[0]
    focal = (float(whole.rig.intrinsics[0]), float(10.0 * half_width))
    result = FolderResult(
        folder.replace(".", "data"), len(views), whole.sizes, focal, [], [], [], np.zeros((0, 6), bool)
    )
    for i, held in enumerate(views):
        others = [view for k, view in enumerate(views) if k != i]
        one = solve(others, start_rig(others, size))
        result.ours.append(held_errors(one.rig, held))
        result.chain.append(held_errors(opencv_chain(others, size), held))
        if HAS_VISION_CALIBRATION:
            rig, aspect = vision_calibration_chain(others)
            result.peer.append(held_errors(rig, stretched_rows(held, aspect)))
        error = prediction_error(one, held)
        half = error.half_width
        result.inside = np.vstack([result.inside, np.abs(error.displacement) < half])
    return result


def board_errors(fitted: Sequence[BoardView], others: Sequence[BoardView], size: tuple[int, int]) -> Array:
    """Predicted and measured mean squares (2, 2) of position (mm²) and orientation (mrad²) of the other boards."""
    one = solve(fitted, start_rig(fitted, size))
    squares = np.zeros((2, 2))
    for view in others:
        error = prediction_error(one, view)
        variance, away = error.standard_deviation**2, error.displacement
        squares += [[variance[:3].sum(), variance[3:].sum()], [(away[:3] ** 2).sum(), (away[3:] ** 2).sum()]]
    return squares / len(others)


def half_lines(data: Path) -> Iterator[str]:
    """Table of what halves of the board's images predict of the others."""
    yield "| folder | fitted, predicted images | board, mm: predicted, measured | board, deg: predicted, measured |"
    yield "|---|---|---|---|"
    halves, counts = [], []
    for folder in FOLDERS:
        found = etna_views(data, folder)
        for first in (0, 1):
            fitted, others = found.views[first::2], found.views[1 - first :: 2]
            if min(len(fitted), len(others)) < LEAST_HALF:
                continue
            squares = board_errors(fitted, others, found.size)
            halves.append(len(others) * squares)
            counts.append(len(others))
            cells = " | ".join(_predicted_measured(squares))
            print("half of", folder, "done", flush=True)
            yield f"| `{folder.replace('.', 'data')}` | {len(fitted)}, {len(others)} | {cells} |"
    if not halves:
        return
    sums = np.array(halves)
    ratios = [rms_ratio(sums[:, 0, i], sums[:, 1, i]) for i in range(2)]
    said = _predicted_measured(sums.sum(0) / sum(counts))
    cells = (f"{cell}; ratio {ratio}" for cell, ratio in zip(said, ratios, strict=True))
    yield f"| all | {sum(counts)} | {' | '.join(cells)} |"


def _predicted_measured(squares: Array) -> list[str]:
    """Predicted and measured RMS of position, mm, and orientation, deg, of mean squares (2, 2) in mm² and mrad²."""
    roots = np.sqrt(squares) * [1.0, np.degrees(1e-3)]
    return [f"{predicted:.2f}, {measured:.2f}" for predicted, measured in roots.T.tolist()]


def rms_ratio(above: Array, below: Array) -> str:
    """Root of the ratio of sums of squares (n,), with its 95 % interval: the n pairs are drawn with replacement."""
    drawn = np.random.default_rng(0).integers(0, len(above), (10_000, len(above)))
    low, high = np.quantile(np.sqrt(above[drawn].sum(1) / below[drawn].sum(1)), [0.025, 0.975])
    return f"{np.sqrt(above.sum() / below.sum()):.2f} [{low:.2f}, {high:.2f}]"


def rms(held: Sequence[Held], name: str) -> float:
    """Root mean square over images of one of their errors."""
    return float(np.sqrt(np.nanmean([getattr(one, name) ** 2 for one in held])))


def share(inside: int, count: int) -> str:
    """A share with its 95 % interval (Clopper and Pearson)."""
    interval = binomtest(inside, count).proportion_ci(0.95)
    return f"{inside} of {count}, {100 * inside / count:.1f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def etna_lines(data: Path) -> Iterator[str]:
    """Tables of the board's images."""
    results = []
    for folder in FOLDERS:
        results.append(etna_folder(data, folder))
        print("etna", results[-1].name, "done", flush=True)
    yield "| folder | images | focal length, px | corners, px | board from image to image | stripe offset, px |"
    yield "|---|---|---|---|---|---|"
    for one in results:
        corners, _, position, orientation, offset = one.sizes
        yield (
            f"| `{one.name}` | {one.images} | {one.focal[0]:.1f} ± {one.focal[1]:.1f} | {corners:.2f} |"
            f" {position:.2f} mm, {np.degrees(1e-3 * orientation):.2f}° | {offset:.1f} |"
        )
    yield ""
    yield "| folder | corners, px | board, mm | board, deg | stripe to board, mm | inside 95 % intervals |"
    yield "|---|---|---|---|---|---|"
    every = FolderResult("all", 0, np.zeros(5), (0.0, 0.0), [], [], [], np.zeros((0, 6), bool))
    for one in results:
        every.ours, every.chain, every.peer = every.ours + one.ours, every.chain + one.chain, every.peer + one.peer
        every.inside = np.vstack([every.inside, one.inside])
    for one in (*results, every):
        cells = [
            " / ".join(f"{rms(held, name):.2f}" if held else "-" for held in (one.ours, one.chain, one.peer))
            for name in ("corners", "position", "orientation", "stripe")
        ]
        inside = share(int(one.inside.sum()), one.inside.size)
        yield f"| {one.name if one is every else f'`{one.name}`'} | {' | '.join(cells)} | {inside} |"
    ratios = []
    for name in ("corners", "position", "orientation", "stripe"):
        ours, chain = (np.nan_to_num([getattr(one, name) for one in held]) ** 2 for held in (every.ours, every.chain))
        ratios.append(rms_ratio(ours, chain))
    yield f"| this over OpenCV | {' | '.join(ratios)} | |"


def ball_lines(data: Path) -> Iterator[str]:
    """Tables of the profiles of the ball."""
    profiles, found, agree = 0, list[FoundBall](), []
    for profile in read_profiles(data):
        profiles += 1
        circle = circle_of(profile.points)
        if circle is None:
            continue
        found.append(FoundBall(profile, circle))
        labelled = circle_of(profile.points[profile.is_ball])
        if labelled is not None:
            agree.append(np.linalg.norm((labelled.values - circle.values)[:2]))
    circles = [one.circle for one in found]
    poses = repeated_poses(found)
    repeated = [[one.circle for one in group] for group in poses]
    agreed = np.array(agree)
    yield "| | |"
    yield "|---|---|"
    yield f"| profiles; with a circle of the ball, found without the labels | {profiles}; {len(circles)} |"
    yield (
        f"| centre by the labelled points within 0.1 mm of it |"
        f" {100 * np.mean(agreed < 0.1e-3):.1f} %, median distance {1e6 * np.median(agreed):.1f} µm |"
    )
    distance, noise = (1e6 * np.median([getattr(one, name) for one in circles]) for name in ("distance", "noise"))
    yield f"| deviation of points from the circle; from point to point; median | {distance:.1f}; {noise:.1f} µm |"
    yield f"| points whose errors count as one, median | {np.median([one.lag for one in circles]):.1f} |"
    scatter = [np.std([one.values for one in group], axis=0, ddof=1) for group in repeated]
    stated = [np.sqrt(np.mean([np.diag(one.covariance) for one in group], axis=0)) for group in repeated]
    for i, name in enumerate(("x of the centre", "z of the centre", "radius")):
        yield (
            f"| repeatability of the {name}: median (5 % to 95 %) of {len(scatter)} poses; stated, median |"
            f" {_quantiles([one[i] for one in scatter])}; {1e6 * np.median([one[i] for one in stated]):.1f} µm |"
        )
    if HAS_ENGEOM:
        yield from engeom_lines(poses)
    for title, effect in (("by the points of the profile alone", False), ("with an effect of the repeat", True)):
        inside, count = _left_out(repeated, effect)
        yield f"| left-out repeats inside the 95 % interval of x, z, radius, {title} | {share(inside, count)} |"


def engeom_lines(poses: Sequence[Sequence[FoundBall]]) -> Iterator[str]:
    """The circles of the package engeom (MAGSAC++ on all points of the profile) beside ours."""
    away, scatter = [], []
    for group in poses:
        theirs = np.array([_circle_of_engeom(one.profile.points) for one in group])
        away += np.linalg.norm(theirs[:, :2] - [one.circle.values[:2] for one in group], axis=1).tolist()
        scatter.append(theirs.std(0, ddof=1))
    x, z, radius = 1e6 * np.median(scatter, axis=0)
    yield f"| centre by `engeom`, distance from ours, median | {1e6 * np.median(away):.1f} µm |"
    yield f"| repeatability by `engeom`, median: x, z, radius | {x:.1f}, {z:.1f}, {radius:.1f} µm |"


def _circle_of_engeom(profile: Array) -> Array:
    """Centre and radius (3,), m, of the ball in a profile (n, 2), m."""
    from engeom.geom2 import Circle2  # noqa: PLC0415  (not required)

    found = Circle2.from_consensus(1e3 * profile, 0.04, max_r=1.01e3 * BALL_RADIUS, seed=0)
    return 1e-3 * np.array([found.x, found.y, found.r])


def _quantiles(values: Sequence[float]) -> str:
    low, middle, high = 1e6 * np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:.1f} ({low:.1f} to {high:.1f}) µm"


def _left_out(groups: Sequence[Sequence[Circle]], effect: bool) -> tuple[int, int]:
    """Values of left-out repeats inside the interval that the others of their pose give, and their number.

    The variance of a repeat is that of its circle, or with `effect` that of the other repeats about their mean.
    """
    inside = count = 0
    for group in groups:
        values = np.array([one.values for one in group])
        variances = np.array([np.diag(one.covariance) for one in group])
        for i in range(len(group)):
            others = np.arange(len(group)) != i
            n = int(others.sum())
            variance, degrees = variances[others].mean(0), float(sum(group[k].points for k in np.flatnonzero(others)))
            if effect:
                variance, degrees = values[others].var(0, ddof=1), float(n - 1)
            half = t.ppf(0.975, degrees) * np.sqrt(variance * (1 + 1 / n))
            inside += int((np.abs(values[i] - values[others].mean(0)) < half).sum())
            count += 3
    return inside, count


def below(folder: Path, inner: str) -> Path | None:
    """The folder `inner` of a checkout in a folder."""
    found = [path / inner for path in (folder, *sorted(folder.iterdir())) if (path / inner).is_dir()]
    return found[0] if found else None


def _written(text: str, mark: str, lines: Sequence[str]) -> str:
    """The text with lines between the marks."""
    begin, end = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    head, rest = text.split(begin)
    return head + begin + "\n" + "\n".join(lines) + "\n\n" + end + rest.split(end, 1)[1]


def main() -> None:
    """Write the tables of the sets that the folder holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder with checkouts of the public repositories")
    parser.add_argument("--out", type=Path, default=REPORT, help="page with the marks")
    sets = {
        "etna": ("etna_calib/data", etna_lines),
        "halves": ("etna_calib/data", half_lines),
        "ball": ("data/Standard_sphere_seg_dataset_v1", ball_lines),
        "robot ball": ("data/ScanData", robot_ball_lines),
        "ball halves": ("data/Standard_sphere_seg_dataset_v1", ball_half_lines),
    }
    parser.add_argument("--only", choices=list(sets), help="one of the tables")
    given = parser.parse_args()
    for mark, (inner, lines) in sets.items():
        if given.only not in (None, mark):
            continue
        data = below(given.data, inner)
        if data is None:
            print(f"no checkout with {inner} in {given.data}")
            continue
        made = list(lines(data))
        print("\n".join(made))
        given.out.write_text(_written(given.out.read_text(encoding="utf-8"), mark, made), encoding="utf-8")


if __name__ == "__main__":
    main()
