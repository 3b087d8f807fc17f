"""Wrong arguments to the public functions raise errors that name the argument; long work can be cancelled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scancell
from bench.api_fuzzer import Fuzzer, cancels
from scancell.arguments import Seed, checked_arguments, checked_value
from scancell.calibration.measured_table import MeasuredTable
from scancell.config.files import Assignments
from scancell.errors import CancelledError, DescriptionError, PlanningError, ScancellError

CALLS = 1  # of each target; `make campaign` makes more


@pytest.fixture(scope="module")
def fuzzer() -> Iterator[Fuzzer]:
    with Fuzzer() as made:
        yield made


def test_random_arguments_return_or_raise_a_scancell_error(fuzzer: Fuzzer) -> None:
    outcomes = [fuzzer.run(target, CALLS, seed=1) for target in fuzzer.targets]
    assert [defect for outcome in outcomes for defect in outcome.defects] == []
    made = CALLS * len(outcomes)
    assert sum(outcome.returned for outcome in outcomes) > made / 6
    assert sum(outcome.refused for outcome in outcomes) > made / 6


# Made by calls, not by users; their constructors take what they are given. Enumerations, constants and modules.
MADE = {
    *("AcceptanceReport", "ArtefactEvaluation", "BatchResult", "BoardCalibrationReport", "CalibrationReport"),
    *("ComparisonResult", "ExposureImages", "MeshEvaluation", "ReconstructionResult"),
    *("NominalCell", "Profile", "RunReport", "SensorCalibrationReport", "SetUps", "ShapeGroup", "StudyReport"),
    *("EstimatedDescription", "JogFrame", "LiveState", "Mode", "Operation", "Progress", "deg", "mm", "pose"),
}


def test_every_exported_name_is_called_with_random_arguments(fuzzer: Fuzzer) -> None:
    errors = {name for name in scancell.__all__ if name.endswith("Error")}
    assert {target.exported for target in fuzzer.targets} | errors | MADE == set(scancell.__all__)


@pytest.mark.parametrize(
    ("value", "hint", "expected"),
    [
        (np.float32(0.5), float, 0.5),
        (np.array(3), int, 3),
        (np.bool_(True), bool, True),
        (np.int64(4), Seed, 4),
        ({"tool.x_mm": np.float64(0.1)}, Assignments, {"tool.x_mm": 0.1}),
        (np.arange(2.0), list[float], [0.0, 1.0]),
    ],
)
def test_numpy_values_become_plain_ones(value: Any, hint: Any, expected: Any) -> None:
    found = checked_value("x", value, hint)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("value", "hint", "message"),
    [
        (3.0, int, "x = 3.0: expected an integer"),
        (True, float, "x = True: expected a finite number"),
        (np.nan, float, "x = nan: expected a finite number"),
        (-1, Seed, "x = -1: expected an integer from 0 to 2147483647"),
        ([("tool.x_mm", 0.1)], Assignments, r"x\[0\] = \('tool.x_mm', 0.1\): expected text"),
        ({"tool.x_mm": None}, Assignments, r"x\['tool.x_mm'\] = None: expected"),
        ("a\0b", str | Path, "without NUL"),
        ("a" * 300, str | Path, "at most 255 bytes"),
    ],
)
def test_wrong_value_is_named(value: Any, hint: Any, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        checked_value("x", value, hint)


def test_arguments_that_do_not_fit_the_signature_are_a_type_error() -> None:
    @checked_arguments
    def function(number: int) -> int:
        return number

    assert function(np.int64(2)) == 2
    with pytest.raises(TypeError, match="nonsense"):
        function(1, nonsense=2)  # type: ignore[call-arg]


WRONG: list[tuple[Callable[[Fuzzer], Any], str]] = [
    (lambda _: scancell.Scanner(scan={"mode": "dynamic"}), "scan = {'mode': 'dynamic'}: expected"),
    (lambda _: scancell.Scanner(sensor=5), "sensor = 5: expected"),
    (lambda _: scancell.scan(3), "part = 3: expected"),
    (lambda f: f.scanner.scan(f.part, seed=-1), "seed = -1: expected"),
    (lambda f: f.scanner.scan(f.part, as_built=[("tool.x_mm", 0.1)]), r"as_built\[0\] ="),
    (lambda f: scancell.evaluate(np.full((3, 3), np.nan), mesh=f.part), "cloud = .* 9 are not finite"),
    (
        lambda f: scancell.evaluate(np.zeros((3, 2)), mesh=f.part),
        r"cloud = .*: the shape is \(3, 2\); expected .* shape \(n, 3\)",
    ),
    (lambda f: scancell.evaluate(np.zeros((0, 3)), mesh=f.part), "cloud: holds no points"),
    (lambda f: scancell.evaluate(np.zeros((3, 3)), mesh=f.part, align="bestfit"), "align = 'bestfit': expected"),
    (lambda _: scancell.ScanDescription(mode="sideways"), "ScanDescription: mode = 'sideways': must be"),
    (lambda f: f.scanner.survey(f.part, voxel=1.0), "survey: voxel = 1.0: expected at most"),
    (lambda _: scancell.extract([], "out"), "images: expected at least one"),
    (lambda _: scancell.build_fmu({"a": object()}, Path("cell.fmu"), 2), "description = .*expected numbers, text"),
    (lambda f: f.result.cloud[0], r"cloud\[0\]: expected a mask"),
]


@pytest.mark.parametrize(("call", "message"), WRONG)
def test_wrong_argument_is_named(call: Callable[[Fuzzer], Any], message: str, fuzzer: Fuzzer) -> None:
    with pytest.raises(DescriptionError, match=message):
        call(fuzzer)


def test_numpy_numbers_give_the_same_scan_as_plain_ones(fuzzer: Fuzzer) -> None:
    plain = fuzzer.scanner.scan(fuzzer.part, engine="geometric", as_built={"tool.x_mm": 0.5}, seed=3)
    other = fuzzer.scanner.scan(
        fuzzer.part, engine="geometric", as_built={"tool.x_mm": np.float32(0.5)}, seed=np.int64(3)
    )
    assert other.as_built == plain.as_built
    np.testing.assert_array_equal(other.cloud.points_in_part, plain.cloud.points_in_part)


def test_settings_take_arrays_and_text_with_quotes() -> None:
    with scancell.Scanner(
        settings={"scan.sweep.elevations_deg": np.array([20.0, 40.0]), "cell.name": 'a "b"\nc'}
    ) as scanner:
        assert scanner.setup.scan.sweep.elevations_deg == (20.0, 40.0)
        assert scanner.setup.cell.name == 'a "b"\nc'


def test_closed_scanner_refuses(fuzzer: Fuzzer) -> None:
    closed = fuzzer.closed
    closed.close()
    for call in (closed.scan, closed.plan, closed.place, closed.survey, closed.load_part, closed.calibrate):
        with pytest.raises(ScancellError, match="the scanner is closed"):
            call(fuzzer.part) if call != closed.calibrate else call("tool")
    with pytest.raises(ScancellError, match="the scanner is closed"), closed:
        pass


@pytest.mark.parametrize("coverage", [False, True])
def test_planning_ends_at_its_limit_of_work_and_states_what_it_reached(fuzzer: Fuzzer, coverage: bool) -> None:
    limits = {"scan.max_planning_work": 1e-3, "scan.coverage.enabled": coverage}
    with scancell.Scanner(settings=limits) as scanner:
        messages = []
        for _ in range(2):
            with pytest.raises(
                PlanningError, match=r"scan\.max_planning_work = 0\.001: .* limit of work while "
            ) as caught:
                scanner.plan(fuzzer.part)
            messages.append(str(caught.value))
    assert messages[0] == messages[1], "work is counted, not timed"


def test_coverage_plan_keeps_the_views_that_its_limit_of_work_allowed(fuzzer: Fuzzer) -> None:
    settings = {"scan.coverage.enabled": True}
    with scancell.Scanner(settings={**settings, "scan.max_planning_work": 3.2}) as scanner:
        few = scanner.plan(fuzzer.part)
    assert few.report is not None
    assert few.report.views >= 1
    assert any("views were chosen until 70 % of scan.max_planning_work = 3.2 was used" in text for text in few.warnings)


def test_planning_is_cancelled_by_its_progress(fuzzer: Fuzzer) -> None:
    calls = 0

    def later(*_: object) -> bool:
        nonlocal calls
        calls += 1
        return calls < 20

    with scancell.Scanner(scan=scancell.ScanDescription(), settings={"scan.coverage.enabled": True}) as scanner:
        with pytest.raises(CancelledError, match="cancelled while planning"):
            scanner.plan(fuzzer.part, progress=later)
        with pytest.raises(CancelledError):
            scanner.plan(fuzzer.part, progress=lambda *_: np.bool_(cancels()))


# --- files ------------------------------------------------------------------------------------------------------------


def test_missing_plan_file_is_named(fuzzer: Fuzzer) -> None:
    with pytest.raises(DescriptionError, match=r"missing\.json: no such file"):
        fuzzer.scanner.scan(fuzzer.part, plan="missing.json")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("", r"points\.csv: holds no rows below its header"),
        ("1,nan\n", r"points\.csv: column 'b', row 1 = nan: expected a finite number"),
        ("1,\n", r"points\.csv: column 'b', row 1: is empty; expected a finite number"),
    ],
)
def test_table_without_rows_and_value_that_is_no_number_are_named(tmp_path: Path, rows: str, message: str) -> None:
    file = tmp_path / "points.csv"
    file.write_text("a,b\n" + rows)
    with pytest.raises(DescriptionError, match=message):
        MeasuredTable(file).numbers("b")


@pytest.mark.parametrize("kind", ["xyz", "ply", "csv"])
def test_points_file_with_a_header_alone_is_named(fuzzer: Fuzzer, tmp_path: Path, kind: str) -> None:
    text = {
        "xyz": "x y z\n",
        "csv": "x_mm,y_mm,z_mm\n",
        "ply": "ply\nformat ascii 1.0\nelement vertex 0\n"
        + "".join(f"property float {axis}\n" for axis in "xyz")
        + "end_header\n",
    }
    file = tmp_path / f"points.{kind}"
    file.write_text(text[kind])
    with pytest.raises(ScancellError, match=rf"points\.{kind}"):
        scancell.evaluate(file, mesh=fuzzer.part)
    if kind == "csv":
        with pytest.raises(ScancellError, match=r"points\.csv: holds no rows"):
            fuzzer.scanner.calibrate("tool", from_points=file)
