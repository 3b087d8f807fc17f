"""What errors carry, how their messages are composed, and how they cross processes."""

import copy
import inspect
import pickle
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from typing_extensions import TypeAliasType

from scancell import errors
from scancell.arguments import checked_value
from scancell.cell.fmu_file import parse_as_built
from scancell.config.files import assets_dir, read_toml
from scancell.config.loading import as_built_sensor, load_setup, require_sensor_words
from scancell.config.scan import ScanDescription
from scancell.config.sensor import SensorDescription
from scancell.config.study import load_batch
from scancell.errors import DescriptionError, MeshError, ScancellError, named_by, shown
from scancell.geometry.fits import fit_sphere
from scancell.geometry.mesh import load_mesh
from scancell.guard.messages import CellState, Mode, Operation
from scancell.output.image_files import read_index
from scancell.planning.plan import Plan
from scancell.reconstruction.cloud_files import parse_formats
from scancell.reconstruction.cloud_files.read import read_cloud_file

TREE = [one for one in vars(errors).values() if inspect.isclass(one) and issubclass(one, ScancellError)]
ABOUT_VALUES = {"DescriptionError", "MeshError", "SensorError", "ImageError", "MessageError", "FitError"}
MISSING = Path("nowhere.toml")


def raised(work) -> ScancellError:
    with pytest.raises(ScancellError) as caught:
        work()
    return caught.value


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def scan_file(folder: Path, text: str) -> Path:
    path = folder / "scan.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"problem": "a sentence"}, "a sentence"),
        ({"problem": "no such file", "file": Path("a.toml")}, "a.toml: no such file"),
        ({"key": "seed", "value": -1, "expected": "an integer from 0"}, "seed = -1: expected an integer from 0"),
        ({"key": "seed", "value": None, "expected": "an integer"}, "seed = None: expected an integer"),
        ({"problem": "is missing", "file": "a.csv", "key": "column 'x'"}, "a.csv: column 'x': is missing"),
        (
            {"problem": "half a file", "file": "a", "key": "k", "value": "v", "expected": "a whole one"},
            "a: k = 'v': half a file; expected a whole one",
        ),
        ({"problem": "must be above 0", "key": "k", "value": 0.0, "expected": "above 0"}, "k = 0.0: must be above 0"),
    ],
)
def test_message_is_composed_of_what_the_error_carries(parts, message) -> None:
    error = DescriptionError(**parts)
    assert str(error) == message
    assert error.file == (str(parts["file"]) if "file" in parts else None)
    assert (error.key, error.value, error.expected) == tuple(parts.get(name) for name in ("key", "value", "expected"))


@pytest.mark.parametrize(
    ("work", "carried"),
    [
        (lambda _: checked_value("seed", 1.5, int), (None, "seed", 1.5, "an integer")),
        (lambda _: checked_value("datum", [1, "a"], tuple[int, ...]), (None, "datum[1]", "a", "an integer")),
        (lambda _: read_toml(MISSING), ("nowhere.toml", None, None, None)),
        (lambda _: load_mesh("nowhere.stl"), ("nowhere.stl", None, None, None)),
        (lambda _: load_mesh(assets_dir() / "x.stl", "cm"), (None, "unit", "cm", "one of mm, m, inch")),
        (lambda _: Plan.load(Path("no.json")), ("no.json", None, None, None)),
        (
            lambda folder: load_setup(scan=scan_file(folder, "max_profiles = 0")),
            ("{}/scan.toml", "max_profiles", 0, "greater than or equal to 1"),
        ),
        (
            lambda _: load_setup(settings=["scan.max_profiles=0"]),
            ("`settings` scan.max_profiles=0", "max_profiles", 0, "greater than or equal to 1"),
        ),
        (
            lambda _: load_setup(settings=["robot.x=0"]),
            (None, "settings", "robot.x=0", "one of cell, sensor, scan"),
        ),
        (
            lambda _: ScanDescription.default().replace(max_profiles=0),
            ("ScanDescription.replace", "max_profiles", 0, "greater than or equal to 1"),
        ),
        (
            lambda _: parse_as_built(["tool.x_mm=a"], {"as_built.tool.x": "m"}),
            (None, "as_built", "tool.x_mm=a", "a finite number, got 'a'"),
        ),
        (
            lambda _: require_sensor_words(["tool.x_mm=1"], "no robot"),
            (None, "as_built", "tool.x_mm=1", "a key of the sensor (sensor.…)"),
        ),
        (
            lambda _: load_batch(None, {"design": {"kind": "full_factorial"}}, 3),
            (None, "variants", 3, None),
        ),
        (lambda _: parse_formats("las", "formats"), (None, "formats", "las", "ply, npz, laz, e57, pcd or xyz")),
        (
            lambda folder: read_cloud_file(written(folder / "a.gif", b"GIF89a")),
            ("{}/a.gif", None, None, "a point cloud: .ply, .pcd, .las, .laz, .e57, .npz, .xyz, .txt, .asc, .csv, .pts"),
        ),
        (lambda _: read_index(Path("no.csv")), ("no.csv", None, None, None)),
        (
            lambda _: CellState(0, 0.0, Operation.MANUAL, Mode.CARTESIAN_JOG, False, np.zeros(7), rate=2.0),
            (None, "rate", 2.0, "0 to 1"),
        ),
        (lambda _: fit_sphere(np.zeros(3)), (None, None, None, "finite points of shape (n, 3)")),
    ],
)
def test_errors_carry_file_key_value_and_what_was_expected(tmp_path, work, carried) -> None:
    error = raised(lambda: work(tmp_path))
    file, *rest = carried
    assert (error.file, error.key, error.value, error.expected) == (file and file.format(tmp_path), *rest)
    assert isinstance(error, ValueError) == (type(error).__name__ in ABOUT_VALUES)
    for part in (error.file, error.key, error.expected):
        assert part is None or part in str(error)


@pytest.mark.parametrize("value", [np.float64(0.5), np.array(0.5), 0.5])
def test_scalars_of_numpy_are_shown_as_plain_numbers(value) -> None:
    assert str(DescriptionError(key="k", value=value, expected="1")) == "k = 0.5: expected 1"


def test_errors_about_values_are_value_errors() -> None:
    assert {one.__name__ for one in TREE if issubclass(one, ValueError)} == ABOUT_VALUES


def test_all_wrong_keys_of_a_description_are_carried(tmp_path) -> None:
    path = scan_file(tmp_path, "max_profiles = 0\nmaks = 1\n")
    error = raised(lambda: ScanDescription.from_toml(path))
    assert [one.key for one in error.problems] == ["max_profiles", "maks"]
    assert (error.key, error.value) == ("max_profiles", 0)
    assert str(error) == "\n".join(map(str, error.problems))
    (single,) = error.problems[1].problems
    assert single is error.problems[1]


def test_source_of_an_error_is_named_before_it() -> None:
    inner = raised(lambda: load_setup(settings=["scan.max_profiles=0", "scan.mode=1"]))
    outer = inner.within("study.toml")
    assert [str(one) for one in outer.problems] == [f"study.toml: {one}" for one in inner.problems]
    assert (outer.key, outer.value) == (inner.key, inner.value)
    assert not str(inner).startswith("study.toml")


@pytest.mark.parametrize("kind", TREE)
@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda error: pickle.loads(pickle.dumps(error))])
def test_copied_and_pickled_errors_are_the_same(kind, again) -> None:
    for error in (kind("a sentence"), kind("wrong", file="a.toml", key="k", value=np.float64(0.5), expected="1")):
        twin = again(error)
        assert type(twin) is kind
        assert str(twin) == str(error)
        assert [getattr(twin, name) for name in ("problem", "file", "key", "value", "expected")] == [
            getattr(error, name) for name in ("problem", "file", "key", "value", "expected")
        ]


def test_alias_of_an_array_type_takes_what_the_type_takes() -> None:
    """NumPy 2.5 makes `NDArray` an alias with a value."""
    kind = TypeVar("kind", bound=np.generic)
    alias = TypeAliasType("alias", np.ndarray[tuple[Any, ...], np.dtype[kind]], type_params=(kind,))
    values = np.zeros(3)
    assert checked_value("x", values, alias[np.float64]) is values
    with pytest.raises(DescriptionError, match="expected an array or None"):
        checked_value("x", "none", alias[np.float64] | None)


def test_joined_errors_can_be_pickled() -> None:
    error = raised(lambda: load_setup(settings=["scan.max_profiles=0", "scan.mode=1"]))
    twin = pickle.loads(pickle.dumps(error))
    assert list(map(str, twin.problems)) == list(map(str, error.problems))
    assert twin.in_options({"settings": "--set"}) == error.in_options({"settings": "--set"})


def test_error_of_a_value_that_cannot_be_pickled_holds_its_text() -> None:
    error = raised(lambda: checked_value("seed", lambda: 1, int))
    twin = pickle.loads(pickle.dumps(error))
    assert str(twin) == str(error)
    assert twin.value == shown(error.value)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (DescriptionError(key="time", value=4.5, expected="0 to 3 s"), "--time 4.5: expected 0 to 3 s"),
        (DescriptionError(key="as_built", value="tool.x=1", expected="a unit"), "--as-built tool.x=1: expected a unit"),
        (DescriptionError("the engine has none", key="time"), "--time: the engine has none"),
        (DescriptionError(file="run.toml", key="time", value=1, expected="2"), "run.toml: time = 1: expected 2"),
        (DescriptionError(key="other", value=1, expected="2"), "other = 1: expected 2"),
        (MeshError("is 3 m: `as_built`, `other`", file="a.stl"), "a.stl: is 3 m: --as-built, `other`"),
    ],
)
def test_messages_of_commands_name_options_instead_of_arguments(error, message) -> None:
    assert error.in_options({"time": "--time", "as_built": "--as-built"}) == message


def test_messages_of_the_library_name_no_options() -> None:
    words = ["sensor.laser.power_mw=-1"]
    error = raised(lambda: as_built_sensor(SensorDescription.default(), words))
    assert "--" not in str(error)
    assert error.in_options({"as_built": "--as-built"}).startswith(
        "--as-built sensor.laser.power_mw=-1: laser.power_mw"
    )
    assert named_by("differs; `out` names another folder", {"out": "--out"}) == "differs; --out names another folder"
