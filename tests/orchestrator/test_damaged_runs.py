"""Files of a run folder with values that cannot be: each numeric array is changed in turn, and refused by its name."""

from __future__ import annotations

import copy
import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

import scancell
from compatibility import SETS, copy_of
from scancell.cell.recording import read_any_recording, read_exposure_times
from scancell.config.loading import load_setup
from scancell.errors import ScancellError
from scancell.recorded.measurements import read_table_of
from scancell.views.recorded_run import open_archive, open_run

Damage = Callable[[list[Any]], list[Any]]

# Of the values of a column, or of the last rows of an array.
DAMAGES: dict[str, Damage] = {
    "nan": lambda values: [*values[:-1], float("nan")],
    "infinite": lambda values: [*values[:-1], float("-inf")],
    "huge": lambda values: [*values[:-1], 1e308],
    "text": lambda values: [*map(str, values[:-1]), "one"],
    "none": lambda values: [*values[:-1], None],
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_of(SETS[-1], tmp_path_factory.mktemp("damaged") / "set")


def refused(read: Callable[[], object], *names: str) -> str:
    with pytest.raises(ScancellError) as caught:
        read()
    for name in names:
        assert name in str(caught.value), f"{name} is missing in: {caught.value}"
    return str(caught.value)


def write_column(source: Path, target: Path, name: str, change: Damage | None) -> None:
    """A table with one column changed, or left out."""
    table = pyarrow.parquet.read_table(source)
    if change is None:
        table = table.drop_columns([name])
    else:
        table = table.set_column(table.column_names.index(name), name, pa.array(change(table.column(name).to_pylist())))
    pyarrow.parquet.write_table(table, target)


def columns_of_each_kind(source: Path) -> list[str]:
    """The last column of each kind: of joints, of frames, and of the axes of a vector."""
    names = pyarrow.parquet.read_schema(source).names
    kinds = {re.sub(r"\[\d+\]|truth\.\w+", "", name): name for name in names}
    return list(kinds.values())


@pytest.mark.parametrize("damage", [*DAMAGES, "left out"])
@pytest.mark.parametrize("name", ["scan_sweep/recording.parquet", "program_run/motion.parquet"])
def test_every_column_of_a_recording_is_checked(files: Path, tmp_path: Path, name: str, damage: str) -> None:
    target = tmp_path / "recording.parquet"
    for column in columns_of_each_kind(files / name):
        write_column(files / name, target, column, DAMAGES.get(damage))
        if damage in ("nan", "none") and ".truth." in column:
            read_any_recording(target)  # a recording may state no truth; who needs it checks that
        else:
            refused(lambda: read_any_recording(target), "recording.parquet", column)


@pytest.mark.parametrize("name", ["trigger.index", "trigger.time"])
def test_recordings_that_run_backwards_are_refused(files: Path, tmp_path: Path, name: str) -> None:
    run = shutil.copytree(files / "scan_sweep", tmp_path / "run")
    write_column(files / "scan_sweep" / "recording.parquet", run / "recording.parquet", name, lambda v: v[::-1])
    refused(lambda: open_run(run), "recording.parquet", f"column '{name}', row 2", "expected more than")


def test_exposures_of_a_program_that_run_backwards_are_refused(files: Path, tmp_path: Path) -> None:
    target = tmp_path / "recording.parquet"
    write_column(files / "program_run" / "recording.parquet", target, "trigger.time", lambda values: values[::-1])
    refused(lambda: read_exposure_times(target), "recording.parquet", "trigger.time")


@pytest.mark.parametrize("change", [0.0, 2.0])
def test_orientations_are_quaternions(files: Path, tmp_path: Path, change: float) -> None:
    table = pyarrow.parquet.read_table(files / "scan_sweep" / "recording.parquet")
    for i in range(1, 5):
        name = f"trigger.truth.sensor.orientation[{i}]"
        values = table.column(name).to_numpy().copy()
        values[3] *= change
        table = table.set_column(table.column_names.index(name), name, pa.array(values))
    pyarrow.parquet.write_table(table, tmp_path / "recording.parquet")
    read = lambda: scancell.read_recording(tmp_path / "recording.parquet")  # noqa: E731
    refused(read, "trigger.truth.sensor.orientation", "row 4", "norm 1")


def test_integers_are_integers_and_exposures_last(files: Path, tmp_path: Path) -> None:
    source, target = files / "scan_sweep" / "recording.parquet", tmp_path / "recording.parquet"
    for name, value in (("trigger.index", 2.5), ("trigger.segment", -1.0), ("trigger.exposure", -1e-3)):
        write_column(source, target, name, lambda values, value=value: [values[0], value, *values[2:]])
        refused(lambda: scancell.read_recording(target), f"column '{name}', row 2", "expected")


def test_recording_of_another_arm_is_refused(files: Path, tmp_path: Path) -> None:
    run = shutil.copytree(files / "reconstruction", tmp_path / "run")
    table = pyarrow.parquet.read_table(files / "reconstruction" / "recording.parquet")
    table = table.drop_columns(["trigger.measured.q[6]", "trigger.measured.qd[6]"])
    pyarrow.parquet.write_table(table, run / "recording.parquet")
    refused(lambda: open_run(run), "recording.parquet", "states 5 joints", "expected 6")
    simulated = pyarrow.parquet.read_table(files / "scan_geometric" / "recording.parquet")
    names = [name for name in simulated.column_names if name.startswith("trigger.truth.link[6]")]
    pyarrow.parquet.write_table(
        simulated.drop_columns(["trigger.measured.q[6]", "trigger.measured.qd[6]", *names]), tmp_path / "five.parquet"
    )
    with scancell.Scanner(files / "cell.toml", files / "sensor.toml") as scanner:
        refused(lambda: scanner.render(tmp_path / "five.parquet", files / "part.stl"), "states 5 joints", "expected 6")


def plan_arrays(plan: dict[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    segment = plan["segments"][1]
    for key in ("time", "q", "table"):
        yield segment, key
    for key in ("segment", "q", "table"):
        yield plan["exposures"], key


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("damage", [*DAMAGES, "shorter", "longer", "empty", "scalar"])
def test_every_array_of_a_plan_is_checked(files: Path, tmp_path: Path, number: int, damage: str) -> None:
    plan = json.loads((files / "plan.json").read_text())
    owner, key = list(plan_arrays(plan))[number]
    values = owner[key]
    if damage == "shorter":
        owner[key] = values[:-1]
    elif damage == "longer":
        owner[key] = [*values, values[-1]]
    elif damage in ("empty", "scalar"):
        owner[key] = [] if damage == "empty" else 1.0
    elif key == "q":
        owner[key] = [*values[:-1], DAMAGES[damage](values[-1])]
    else:
        owner[key] = DAMAGES[damage](values)
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    where = "segments[2]" if number < 3 else "exposures"
    refused(lambda: scancell.Plan.load(tmp_path / "plan.json"), "plan.json", where)


def set_key(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(plan: dict[str, Any]) -> None:
        *tables, key = path
        node: Any = plan
        for part in tables:
            node = node[part]
        node[key] = value

    return change


def reverse_time(plan: dict[str, Any]) -> None:
    plan["segments"][1]["time"].reverse()


def repeat_time(plan: dict[str, Any]) -> None:
    plan["segments"][1]["time"][5] = plan["segments"][1]["time"][4]


def no_joints(plan: dict[str, Any]) -> None:
    for owner in (*plan["segments"], plan["exposures"]):
        owner["q"] = [[] for _ in owner["q"]]


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (reverse_time, ("segments[2]", "time[1]", "expected 0")),
        (repeat_time, ("segments[2]", "time[6]", "expected more than time[5]")),
        (no_joints, ("segments[1].q[1]",)),
        (set_key("settle", value=1e308), ("settle = 1e+308",)),
        (set_key("segments", 1, "id", value=1), ("id = 1", "an id of its own")),
        (set_key("segments", 1, "trigger", "interval", value=1e308), ("segments[2].trigger.interval",)),
        (set_key("segments", 1, "trigger_to", value=float("inf")), ("segments[2].trigger_to",)),
        (set_key("exposures", "segment", 2, value=99), ("exposures.segment[3] = 99",)),
        (set_key("exposures", "q", 2, 1, value=-1e308), ("exposures.q[3][2] = -1e+308",)),
    ],
)
def test_plans_that_cannot_be_are_refused(files: Path, tmp_path: Path, change: Any, names: tuple[str, ...]) -> None:
    plan = json.loads((files / "plan.json").read_text())
    change(plan)
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    refused(lambda: scancell.Plan.load(tmp_path / "plan.json"), "plan.json", *names)


def plan_of_joints(run: Path, joints: int) -> tuple[str, ...]:
    """Write a plan for another arm into a run; what its refusal names."""
    plan = json.loads((run / "plan.json").read_text())
    for owner in (*plan["segments"], plan["exposures"]):
        owner["q"] = [[*row, 0.0][:joints] for row in owner["q"]]
    (run / "plan.json").write_text(json.dumps(plan))
    return "plan.json", f"segments[1].q: has rows of {joints} joints", "expected 6"


@pytest.mark.parametrize("joints", [5, 7])
def test_a_plan_for_another_arm_is_refused_by_name(files: Path, tmp_path: Path, joints: int) -> None:
    run = shutil.copytree(files / "scan_geometric", tmp_path / "run")
    refused(lambda: open_run(run), *plan_of_joints(run, joints))
    with scancell.Scanner(files / "cell.toml", files / "sensor.toml") as scanner:
        refused(
            lambda: scanner.scan(files / "part.stl", engine="geometric", plan=run / "plan.json"), f"{joints} joints"
        )


@pytest.mark.parametrize("owner", ["segments", "exposures"])
@pytest.mark.parametrize(("key", "rows"), [("q", "q: rows of [5, 6] joints"), ("further", "further: rows of [0, 1]")])
def test_plan_rows_of_unequal_lengths_are_refused(files: Path, tmp_path: Path, owner: str, key: str, rows: str) -> None:
    plan = json.loads((files / "scan_geometric" / "plan.json").read_text())
    points = plan["segments"][-1] if owner == "segments" else plan["exposures"]
    if key == "q":
        points["q"][-1].pop()
    else:
        points["further"] = [[0.0] for _ in points["q"]]
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    refused(lambda: scancell.Plan.load(tmp_path / "plan.json"), "plan.json", rows)


def test_an_upload_with_a_plan_for_another_arm_is_refused_by_name(files: Path, tmp_path: Path) -> None:
    """It is read in a process of its own, which ended in a traceback."""
    run = shutil.copytree(files / "scan_geometric", tmp_path / "run")
    names = plan_of_joints(run, 5)
    archive = shutil.make_archive(str(tmp_path / "run"), "zip", run)
    refused(lambda: open_archive(Path(archive).read_bytes(), "run.zip"), "run.zip", *names)


@pytest.mark.parametrize("damage", [*DAMAGES, "left out"])
def test_every_column_of_profiles_is_checked_by_a_comparison(files: Path, tmp_path: Path, damage: str) -> None:
    run = shutil.copytree(files / "scan_geometric", tmp_path / "run")
    source = files / "scan_geometric" / "profiles.parquet"
    for column in pyarrow.parquet.read_schema(source).names:
        write_column(source, run / "profiles.parquet", column, DAMAGES.get(damage))
        refused(lambda: scancell.compare(run), "profiles.parquet", column)


def test_points_of_exposures_that_the_recording_lacks_are_refused(files: Path, tmp_path: Path) -> None:
    run = shutil.copytree(files / "scan_geometric", tmp_path / "run")
    for column, value in (("profile", 999), ("camera", 2)):
        source = files / "scan_geometric" / "profiles.parquet"
        write_column(source, run / "profiles.parquet", column, lambda values, value=value: [*values[:-1], value])
        refused(lambda: scancell.compare(run), "profiles.parquet", f"column '{column}'", f"= {value}", "expected")


@pytest.mark.parametrize("damage", DAMAGES)
def test_every_column_of_measured_points_is_checked(files: Path, tmp_path: Path, damage: str) -> None:
    joints = len(load_setup(files / "cell.toml").cell.robot.joint)
    source, target = files / "reconstruction" / "points.parquet", tmp_path / "points.parquet"
    for column in pyarrow.parquet.read_schema(source).names:
        write_column(source, target, column, DAMAGES[damage])
        if column == "z_mm" and damage in ("nan", "infinite", "none"):  # a point without a height is none, and counted
            assert "1 rows are left out, which have no z_mm" in " ".join(read_table_of(target, joints).notes)
        else:
            refused(lambda: read_table_of(target, joints), "points.parquet", column)


@pytest.mark.parametrize("suffix", ["ply", "npz"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308])
def test_clouds_with_impossible_points_are_refused(files: Path, tmp_path: Path, suffix: str, value: float) -> None:
    cloud = scancell.Cloud.load(files / "scan_geometric" / "cloud.npz")
    for name in ("points_in_part", "time"):
        damaged = copy.deepcopy(cloud)
        getattr(damaged, name).reshape(len(cloud), -1)[6, -1] = value
        with np.errstate(over="ignore"):
            damaged.save(tmp_path / f"cloud.{suffix}")
        refused(lambda: scancell.Cloud.load(tmp_path / f"cloud.{suffix}"), f"cloud.{suffix}", "of point 7")
