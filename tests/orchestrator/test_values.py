"""Results and other data: equality that holds for arrays, short representations, pickling."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

import scancell
from scancell.values import Result, Value

PART = scancell.assets_dir() / "parts" / "step_block.stl"


@dataclass(frozen=True, eq=False, repr=False)
class Reading(Value):
    points: np.ndarray
    inner: object = None
    time: float = field(default=0.0, compare=False)


@pytest.mark.parametrize(
    ("other", "is_equal"),
    [
        (Reading(np.array([1.0, np.nan])), True),
        (Reading(np.array([1.0, np.nan]), time=3.0), True),
        (Reading(np.array([1.0, 2.0])), False),
        (Reading(np.array([[1.0, np.nan]])), False),
        (Reading(np.array([1.0, np.nan]), inner=Reading(np.zeros(2))), False),
        (None, False),
    ],
)
def test_equality_compares_arrays_and_not_what_is_left_out(other: object, is_equal: bool) -> None:
    assert (Reading(np.array([1.0, np.nan])) == other) is is_equal


def test_equality_reaches_into_mappings_sequences_and_other_data() -> None:
    def reading(last: float) -> Reading:
        return Reading(np.zeros(0), {"a": [1, (Reading(np.array([last])), float("nan"))]})

    assert reading(1.0) == reading(1.0)
    assert reading(1.0) != reading(2.0)


def test_data_with_arrays_cannot_be_hashed() -> None:
    with pytest.raises(TypeError, match="unhashable"):
        hash(Reading(np.zeros(2)))


def test_representation_names_shapes_and_not_contents() -> None:
    shown = repr(Reading(np.zeros((1000, 3)), inner={"a": 1, "b": 2}, time=0.5))
    assert shown == "Reading(points=<float64 (1000, 3)>, inner=<2 items>, time=0.5)"
    assert repr(Reading(np.zeros(2), inner="x" * 500)).count("x") == 40


@dataclass(frozen=True, eq=False, repr=False)
class Finding(Result):
    figures: dict[str, object]  # type: ignore[assignment]

    def summary(self) -> str:
        return "two lines\n  of text"


def test_result_prints_its_summary_and_shows_a_table_of_its_figures() -> None:
    found = Finding({"rms_um": 1.23456789, "by": {"<camera>": 3}, "rows": [1, 2]})
    assert str(found) == "two lines\n  of text"
    html = found._repr_html_()
    assert "<th>rms_um</th><td>1.23457</td>" in html
    assert "<th>by.&lt;camera&gt;</th><td>3</td>" in html
    assert "rows" not in html
    assert found._repr_png_() is None


@pytest.fixture(scope="module")
def scanner() -> Iterator[scancell.Scanner]:
    with scancell.Scanner(settings={"scan.max_profiles": 30}) as opened:
        yield opened


@pytest.fixture(scope="module")
def result(scanner: scancell.Scanner) -> scancell.ScanResult:
    return scanner.scan(PART, engine="geometric", as_built={"sensor.laser.turn_y_deg": 0.01}, seed=2)


def test_scan_can_be_pickled_before_and_after_its_evaluation(result: scancell.ScanResult) -> None:
    fresh = pickle.loads(pickle.dumps(replace(result)))
    evaluated = pickle.loads(pickle.dumps(result.evaluate()))
    assert fresh == evaluated == result
    assert fresh.deviation.rms == pytest.approx(result.deviation.rms)
    assert evaluated.coverage == result.coverage
    assert len(repr(result)) < 200


@pytest.mark.parametrize(("name", "rounding"), [("cloud.ply", 1e-6), ("cloud.npz", 2e-7)])
def test_cloud_is_saved_and_loaded(result: scancell.ScanResult, tmp_path: Path, name: str, rounding: float) -> None:
    loaded = scancell.Cloud.load(result.cloud.save(tmp_path / name))
    for column in ("points_in_part", "normals", "sigma", "time", "profile", "camera"):
        np.testing.assert_allclose(getattr(loaded, column), getattr(result.cloud, column), rounding, 1e-15)


def test_file_that_is_no_cloud_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", points_in_part_mm=np.zeros((2, 3)))
    (tmp_path / "broken.npz").write_bytes(b"PK no archive")
    for name in ("other.npz", "broken.npz", "none.npz"):
        with pytest.raises(scancell.MeshError, match=name):
            scancell.Cloud.load(tmp_path / name)


def test_part_of_a_cloud_is_chosen_by_a_mask_indices_or_a_slice(result: scancell.ScanResult) -> None:
    cloud = result.cloud
    assert cloud[:2] == cloud[[0, 1]] == cloud[np.arange(len(cloud)) < 2]
    with pytest.raises(scancell.DescriptionError, match=r"cloud\[0\]: expected a mask"):
        cloud[0]  # type: ignore[index]


def test_shot_is_taken_from_a_pose_and_can_be_pickled(scanner: scancell.Scanner) -> None:
    shot = scanner.shot(PART, scancell.location(0.0, 0.0, 0.18, rx=180 * scancell.deg), engine="geometric")
    assert pickle.loads(pickle.dumps(shot)) == shot
    assert shot.figures["points"] == len(shot.points_in_part) > 100
    scaled = 2 * np.eye(4)
    with pytest.raises(scancell.DescriptionError, match=r"part_from_sensor = .*expected a pose"):
        scanner.shot(PART, scaled)
