"""Rules of the architecture, checked by reading imports, includes and names; planted violations are found."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "orchestrator" / "scancell"

# A package may import packages of earlier tiers, and itself.
TIERS = [
    {
        "arguments",
        "closing",
        "errors",
        "extras",
        "files",
        "text_table",
        "progress",
        "stopwatch",
        "arrays",
        "values",
        "geometry",
        "sensor",
    },
    {"config"},
    {"nominal"},
    {"proximity", "reconstruction", "visibility"},
    {"cell"},
    {"planning", "guard"},
    {"scanning"},
    {"evaluation"},
    {"output"},
    {"results", "inspection"},
    {"calibration"},
    {"recorded"},
    {"scanner"},
    {"studies"},
    {"api"},
    {"live"},
    {"programs"},
    {"exercises"},
    {"wire"},
    {"views"},
    {"browser"},
    {"cli"},
    {"__main__"},
]
# Results of evaluations write and draw themselves: their methods import what does it when they are called.
LATE = {("evaluation", "output")}
TIER_OF = {name: level for level, names in enumerate(TIERS) for name in names}

# All other packages work with measured and nominal values only.
MAY_USE_TRUTH = {
    *("config", "cell", "scanning", "evaluation", "output", "results", "scanner", "studies", "api"),
    *("live", "programs", "exercises", "views", "browser", "cli"),
}

# Modules of the other packages that simulate a measurement, or compare what was found with the truth.
COMPARE_WITH_TRUTH = {
    *("calibration/report.py", "calibration/cell/report.py"),
    *("calibration/sensor/report.py", "calibration/sensor/simulated.py"),
}
# Objects that hold as-built values: `World.true`, `World.sensor_true`, `ScanSession.true`, `world_from_part_true`.
AS_BUILT = re.compile(r"(?:^|_)true(?:_|$)")

# What each folder of sensor_rt may include besides itself.
SENSOR_RT = {
    "geometry": set(),
    "detector": {"geometry"},
    "optics": {"geometry"},
    "scene": {"geometry"},
    "tracing": {"geometry", "scene"},
    "visibility": {"geometry", "scene"},
    "render": {"geometry", "optics", "scene", "tracing"},
    "fan": {"geometry", "optics", "scene", "tracing"},
    "imaging": {"geometry", "optics"},
    "cloud": {"geometry"},
    "pipeline": {"geometry", "optics", "scene", "tracing", "render", "fan", "detector", "imaging"},
    "fmi": {"pipeline", "scene", "fmu/fmi", "fmu/model"},  # the sensor as an FMU: the one place that knows both
    "bindings": {
        "geometry",
        "optics",
        "scene",
        "tracing",
        "visibility",
        "render",
        "fan",
        "detector",
        "imaging",
        "cloud",
        "pipeline",
        "bindings",
    },
}
FMU = {
    "kinematics": set(),
    "control": set(),
    "model": {"kinematics", "control", "proximity"},
    "proximity": {"kinematics"},
    "fmi": {"kinematics", "control", "model", "proximity"},
    "sequencer": {"control", "model", "fmi"},
    "windows": set(),
}
FORBIDDEN_TEXT = {
    "sensor_rt/detector": r"embree|[Ss]cene|sensor_rt/(?:scene|tracing|render|optics)",
    "sensor_rt/imaging": r"(?i:embree)",
    "fmu/control": r"dart/|\bfmi[23][A-Z]",
    "fmu/model": r"\bfmi[23][A-Z]",
}


def imported_modules(tree: ast.AST) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def python_files(package: Path) -> Iterator[tuple[str, Path, ast.Module]]:
    """Top-level name inside `package`, path and syntax tree of every Python file."""
    for path in sorted(package.rglob("*.py")):
        yield path.relative_to(package).parts[0].removesuffix(".py"), path, ast.parse(path.read_text())


def layer_violations(package: Path) -> list[str]:
    found = []
    for name, path, tree in python_files(package):
        if name == "__init__":
            continue
        if name not in TIER_OF:
            found.append(f"{path}: {name} has no tier")
            continue
        for module in imported_modules(tree):
            top, _, rest = module.partition(".")
            if top in ("orchestrator", "sensor_rt"):
                found.append(f"{path}: imports {module}")
            target = rest.split(".")[0]
            if top != "scancell" or target not in TIER_OF or target == name or (name, target) in LATE:
                continue
            if TIER_OF[target] > TIER_OF[name] or (TIER_OF[target] == TIER_OF[name] and TIER_OF[name] > 0):
                found.append(f"{path}: {name} must not import {target}")
    return found


def docstrings(tree: ast.AST) -> set[int]:
    """Identities of the constants that are docstrings."""
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    first = [node.body[0] for node in ast.walk(tree) if isinstance(node, owners) and node.body]
    return {id(node.value) for node in first if isinstance(node, ast.Expr)}


def truth_violations(package: Path) -> list[str]:
    """Names and strings that mention truth, ``"truth.q[1]"``, and names of as-built values, ``world.true``."""
    found = []
    for name, path, tree in python_files(package):
        if name in MAY_USE_TRUTH or name == "__init__":
            continue
        skipped = docstrings(tree)
        for node in ast.walk(tree):
            word, is_name = "", True
            if isinstance(node, ast.Attribute):
                word = node.attr
            elif isinstance(node, ast.Name):
                word = node.id
            elif isinstance(node, ast.alias):
                word = node.name
            elif isinstance(node, ast.arg | ast.keyword):
                word = node.arg or ""
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped:
                word, is_name = node.value, False
            knows = path.relative_to(package).as_posix() in COMPARE_WITH_TRUTH
            if "truth" in word.lower() or (is_name and not knows and AS_BUILT.search(word)):
                found.append(f"{path}:{getattr(node, 'lineno', 0)}: {word}")
    return found


def cpp_files(folder: Path) -> list[Path]:
    files = [*folder.rglob("*.h"), *folder.rglob("*.cpp")]
    return sorted(file for file in files if "third_party" not in file.parts)


def include_violations(root: Path, library: str, rules: dict[str, set[str]], other: str) -> list[str]:
    """Includes that the `rules` of a `library` do not allow: of its folders, and of those of the `other` library."""
    found = []
    for folder in sorted(path for path in (root / library).iterdir() if path.is_dir() and cpp_files(path)):
        if folder.name not in rules:
            found.append(f"{folder}: has no rule")
            continue
        for path in cpp_files(folder):
            for header in re.findall(r'^\s*#\s*include\s*"([^"]+)"', path.read_text(), re.MULTILINE):
                top, _, rest = header.partition("/")
                target = rest.split("/")[0]
                named = target if top == library else f"{top}/{target}"
                if top in (library, other) and named not in {folder.name, "third_party"} | rules[folder.name]:
                    found.append(f"{path}: includes {header}")
    return found


def text_violations(root: Path) -> list[str]:
    found = []
    for folder, pattern in FORBIDDEN_TEXT.items():
        assert cpp_files(root / folder), folder
        for path in cpp_files(root / folder):
            code = re.sub(r"//[^\n]*", "", path.read_text())
            found += [f"{path}: {match}" for match in re.findall(pattern, code)]
    return found


def composing_scans(package: Path) -> list[str]:
    """Calls outside of ``scanning`` of the steps that a scan is composed of."""
    steps = {"drive", "sense", "reconstruct"}
    return [
        f"{path}: calls {ast.unparse(node.func)}"
        for name, path, tree in python_files(package)
        for node in ast.walk(tree)
        if name != "scanning" and isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        if node.func.attr in steps and ast.unparse(node.func.value).endswith(("pipeline", "world"))
    ]


def exposing(package: Path) -> list[str]:
    """Uses of the ray tracer's `scan` outside of ``scanning/sense.py``, whose `expose` serves all."""
    found = []
    for name, path, tree in python_files(package):
        if name == "sensor" or path.relative_to(package).as_posix() == "scanning/sense.py":
            continue
        names = imported_modules(tree) & {"scancell.sensor.scan"}
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "scan"]
        used = [ast.unparse(node) for node in calls if ast.unparse(node.value) in ("sensor_rt", "sensor")]
        found += [f"{path}: {word}" for word in [*names, *used]]
    return found


def test_exposures_are_made_in_one_place() -> None:
    assert exposing(PACKAGE) == []


@pytest.mark.parametrize(
    "line", ["found = sensor_rt.scan(scene, sensor, exposures)", "from scancell.sensor import scan as trace"]
)
def test_planted_exposure_is_found(tmp_path: Path, line: str) -> None:
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "trial.py").write_text(line + "\n")
    assert len(exposing(tmp_path)) == 1


def test_scanning_alone_composes_scans() -> None:
    assert composing_scans(PACKAGE) == []


def test_planted_composition_is_found(tmp_path: Path) -> None:
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "trial.py").write_text("recording = self.pipeline.drive(world, plan, progress)\n")
    assert len(composing_scans(tmp_path)) == 1


def test_imports_point_to_lower_tiers() -> None:
    assert layer_violations(PACKAGE) == []


def test_measured_side_never_mentions_truth() -> None:
    assert truth_violations(PACKAGE) == []


def test_modules_that_compare_with_truth_exist() -> None:
    assert all((PACKAGE / name).is_file() for name in COMPARE_WITH_TRUTH)


def test_sensor_rt_includes() -> None:
    assert include_violations(ROOT, "sensor_rt", SENSOR_RT, "fmu") == []


def test_fmu_includes() -> None:
    assert include_violations(ROOT, "fmu", FMU, "sensor_rt") == []


def test_detector_knows_no_scene_control_no_dart_model_no_fmi() -> None:
    assert text_violations(ROOT) == []


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("planning/late.py", "from scancell.scanning import sense"),
        ("cell/late.py", "import scancell.studies.study"),
        ("planning/late.py", "from scancell import scanner"),
        ("planning/late.py", "import orchestrator.cell"),
        ("unknown/late.py", "import numpy"),
    ],
)
def test_planted_import_is_found(tmp_path: Path, file: str, line: str) -> None:
    (tmp_path / file).parent.mkdir()
    (tmp_path / file).write_text(line + "\n")
    assert len(layer_violations(tmp_path)) >= 1


@pytest.mark.parametrize(
    "line",
    [
        "poses = recording.truth",
        'value = session.value("truth.q[1]")',
        'columns = f"trigger.truth.{frame}"',
        "from scancell.cell.recording import ExposureTruth",
        "bodies = world.true.bodies",
        "image = render(world.sensor_true)",
        "detector = world.sensor_true_description.detector",
        "cell = session.true",
        "world = World(setup, true=cell)",
        "def pose(world_from_part_true): ...",
    ],
)
@pytest.mark.parametrize("package", sorted(set(TIER_OF) - MAY_USE_TRUTH))
def test_planted_truth_is_found(tmp_path: Path, package: str, line: str) -> None:
    (tmp_path / package).mkdir()
    (tmp_path / package / "late.py").write_text(f'"""No truth here."""\n{line}\n')
    assert len(truth_violations(tmp_path)) >= 1


@pytest.mark.parametrize(
    ("folder", "line"),
    [
        ("detector", '#include "sensor_rt/scene/scene.h"'),
        ("imaging", '#include "sensor_rt/render/lamps.h"'),
        ("cloud", '#include "sensor_rt/scene/scene.h"'),
        ("optics", '#include "fmu/model/cell.h"'),
    ],
)
def test_planted_include_is_found(tmp_path: Path, folder: str, line: str) -> None:
    (tmp_path / "sensor_rt" / folder).mkdir(parents=True)
    (tmp_path / "sensor_rt" / folder / "late.h").write_text(line + "\n")
    assert len(include_violations(tmp_path, "sensor_rt", SENSOR_RT, "fmu")) == 1


@pytest.mark.parametrize(
    ("folder", "line"),
    [
        ("sensor_rt/detector", "void look(const Scene& scene);"),
        ("sensor_rt/imaging", "#include <embree3/rtcore.h>"),
        ("fmu/control", "#include <dart/dart.hpp>"),
        ("fmu/model", "fmi2Status step();"),
    ],
)
def test_planted_text_is_found(tmp_path: Path, folder: str, line: str) -> None:
    for other in FORBIDDEN_TEXT:
        (tmp_path / other).mkdir(parents=True)
        (tmp_path / other / "fine.h").write_text("int fine();\n")
    (tmp_path / folder / "late.h").write_text(line + "\n")
    assert text_violations(tmp_path)
