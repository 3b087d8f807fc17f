"""The map's rules, checked by reading imports and includes."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Who may import whom inside the orchestrator: a package may use those of lower tiers, and itself.
TIERS = [
    {"errors", "geometry", "files", "progress"},
    {"config", "proximity"},
    {"cell", "reconstruction"},
    {"planning", "guard", "calibration"},
    {"scanning"},
    {"evaluation"},
    {"studies"},
    {"workspace", "terminal"},
    {"cli"},
]
TIER_OF = {name: level for level, names in enumerate(TIERS) for name in names}

# What each folder of sensor_rt may include besides itself.
SENSOR_RT = {
    "geometry": set(),
    "detector": {"geometry"},
    "optics": {"geometry"},
    "scene": {"geometry"},
    "tracing": {"geometry", "scene"},
    "render": {"geometry", "optics", "scene", "tracing"},
    "fan": {"geometry", "optics", "scene", "tracing"},
    "imaging": {"geometry", "optics"},
    "pipeline": {"geometry", "optics", "scene", "tracing", "render", "fan", "detector", "imaging"},
    "bindings": {
        "geometry",
        "optics",
        "scene",
        "tracing",
        "render",
        "fan",
        "detector",
        "imaging",
        "pipeline",
        "bindings",
    },
}
FMU = {
    "control": set(),
    "model": {"control", "proximity"},
    "proximity": set(),
    "fmi": {"control", "model", "proximity"},
}
TRUTH_BLIND = ("planning", "guard", "calibration", "reconstruction", "geometry", "proximity")


def python_files(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def cpp_files(folder: str) -> list[Path]:
    files = [*(ROOT / folder).rglob("*.h"), *(ROOT / folder).rglob("*.cpp")]
    return sorted(file for file in files if "third_party" not in file.parts)


def imported_modules(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def orchestrator_package(path: Path) -> str:
    return path.relative_to(ROOT / "orchestrator").parts[0].removesuffix(".py")


def includes(path: Path) -> list[str]:
    return re.findall(r'^\s*#\s*include\s*"([^"]+)"', path.read_text(), re.MULTILINE)


@pytest.mark.parametrize("path", python_files("orchestrator"), ids=lambda p: str(p.relative_to(ROOT)))
def test_orchestrator_imports_point_downwards(path: Path) -> None:
    package = orchestrator_package(path)
    if package == "__init__":
        return
    assert package in TIER_OF, f"{package} has no place on the map"
    for module in imported_modules(path):
        if not module.startswith("orchestrator."):
            continue
        target = module.split(".")[1]
        if target in TIER_OF and target != package:
            allowed = TIER_OF[target] < TIER_OF[package] or {target, package} <= {
                "geometry",
                "errors",
                "files",
                "progress",
            }
            assert allowed, f"{package} must not import {target}"


@pytest.mark.parametrize("folder", SENSOR_RT)
def test_sensor_rt_includes(folder: str) -> None:
    for path in cpp_files(f"sensor_rt/{folder}"):
        for header in includes(path):
            if header.startswith("sensor_rt/"):
                target = header.split("/")[1]
                assert target == folder or target in SENSOR_RT[folder], f"{path.relative_to(ROOT)} includes {header}"
            assert not header.startswith("fmu/"), f"{path.relative_to(ROOT)} includes {header}"


@pytest.mark.parametrize("folder", FMU)
def test_fmu_includes(folder: str) -> None:
    for path in cpp_files(f"fmu/{folder}"):
        for header in includes(path):
            assert not header.startswith("sensor_rt/"), f"{path.relative_to(ROOT)} includes {header}"
            if header.startswith("fmu/"):
                target = header.split("/")[1]
                allowed = target in {folder, "third_party"} or target in FMU[folder]
                assert allowed, f"{path.relative_to(ROOT)} includes {header}"


@pytest.mark.parametrize("folder", ["control", "model"])
def test_model_and_controller_know_no_fmi(folder: str) -> None:
    for path in cpp_files(f"fmu/{folder}"):
        assert not re.search(r"\bfmi[23][A-Z]", path.read_text()), f"{path.relative_to(ROOT)} speaks FMI"


def test_the_detector_knows_no_scene_and_the_controller_no_dart() -> None:
    for path in cpp_files("fmu/control"):
        assert "dart/" not in path.read_text(), f"{path.relative_to(ROOT)} knows DART"


@pytest.mark.parametrize("package", TRUTH_BLIND)
def test_packages_on_the_measured_side_never_mention_truth(package: str) -> None:
    for path in python_files(f"orchestrator/{package}"):
        tree = ast.parse(path.read_text())
        names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        names |= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        offenders = {name for name in names if "truth" in name.lower()}
        assert not offenders, f"{path.relative_to(ROOT)} uses {offenders}"


def test_imaging_takes_nothing_of_the_renderer() -> None:
    for path in cpp_files("sensor_rt/imaging"):
        assert "embree" not in path.read_text().lower(), f"{path.relative_to(ROOT)} knows the ray tracer"
