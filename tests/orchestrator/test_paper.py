"""docs/paper.md: it names what it must, refers to what exists, and states what the code computes."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import requires
from pathlib import Path

import pytest

import paper_errata
import scancell
from bench.paper import BEGIN, END, between_marks
from paper_errata import sensor_of
from scancell.config.scan import QualityDescription
from scancell.planning.model import SensorRange

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "paper.md"
PACKAGE = ROOT / "orchestrator" / "scancell"
PACKAGES = ("fmpy", "dartpy", "pybind11", "Embree", "OpenCV", "numpy", "python-fcl")
TEXT = PAGE.read_text(encoding="utf-8")


def section(title: str) -> str:
    return TEXT.split(f"\n## {title}\n")[1].split("\n## ")[0]


def table(title: str) -> dict[str, str]:
    """Lines of a section's table by their first cell."""
    rows = [line for line in section(title).splitlines() if line.startswith("| ")]
    return {line.split(" | ")[0].strip("| "): line for line in rows[1:]}


def words(text: str) -> str:
    """The text in one line."""
    return " ".join(text.split())


@pytest.mark.parametrize("package", PACKAGES)
def test_page_says_which_module_needs_a_package(package: str) -> None:
    modules = re.findall(r"`([\w/]+\.(?:py|cpp|h))`", table("Required packages")[package])
    files = [PACKAGE / name if name.endswith(".py") else ROOT / name for name in modules]
    assert [str(file) for file in files if not file.is_file()] == []
    assert files or package == "pybind11"
    imported = {"OpenCV": "cv2", "python-fcl": "fcl"}.get(package, package)
    used = r"\brtc[A-Z]\w+\(" if package == "Embree" else rf"import.*\b{imported}\b|from {imported}\b"
    missing = [str(file) for file in files if not re.search(used, file.read_text(encoding="utf-8"))]
    assert missing == []


def test_packages_are_those_of_the_installation() -> None:
    needed = " ".join(requires("scancell") or [])
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    for name in ("fmpy", "dartpy", "opencv-python-headless", "numpy", "python-fcl"):
        assert name in needed
    assert any(one.startswith("pybind11") for one in build)


def test_citation_states_title_authors_and_affiliation() -> None:
    cited = words(section("Citation"))
    for text in (
        "An Integrated Robot Simulation Workspace for Real Time Collision Free 3D Laser Scanning Applications",
        "Alexandru Dumitrache, Theodor Borangiu",
        "University Politehnica of Bucharest",
        "neither year nor venue",
    ):
        assert text in cited


def test_default_arm_has_the_parameters_of_table_1() -> None:
    """a, d in mm and alpha in degrees of the six links, as the paper prints them."""
    joints = scancell.Scanner().setup.cell.robot.joint
    printed = [(75, 335, -90), (270, 0, 0), (-90, 0, 90), (0, 295, -90), (0, 0, 90), (0, 80, 0)]
    assert [(joint.a_mm, joint.d_mm, joint.alpha_deg) for joint in joints] == printed


def test_every_erratum_has_its_switch_or_says_that_it_has_none() -> None:
    rows = table("Errata")
    assert list(rows) == ["4", "5", "7", "8", "10"]
    switches = {"4": '`triangulation = "eq4_as_printed"`', "5": '`triangulation = "eq5_as_printed"`'}
    switches["8"] = '`[quality] equations = "printed"`'
    for equation, row in rows.items():
        assert switches.get(equation, "not selectable") in row.split(" | ")[-1]
    for form in ("eq4_as_printed", "eq5_as_printed"):
        assert sensor_of(form)  # the sensor takes it
    assert QualityDescription(equations="printed")


def test_errors_of_equations_4_and_5_are_those_of_the_shipped_sensor() -> None:
    rows, four, five = table("Errata"), paper_errata.equation_4(), paper_errata.equation_5()
    assert f"up to {100 * four['ratio']:.2f} %, {four['y_mm']:.3f} mm" in rows["4"]
    assert f"({four['focal_px']:.0f} px)" in rows["4"]
    assert four["z_mm"] < 1e-9
    near = f"{five['printed_near_mm']:.2f} instead of {five['near_mm']:.2f} mm at the near end"
    far = f"{five['printed_far_mm']:.2f} instead of {five['far_mm']:.2f} mm at the far end"
    assert f"{near}, {far}: −{-100 * five['ratio']:.1f} %" in rows["5"]


def test_printed_equation_5_narrows_the_range_of_planning() -> None:
    exact, printed = (SensorRange.of(sensor_of(form)) for form in ("exact", "eq5_as_printed"))
    ratio = 1 + paper_errata.equation_5()["ratio"]
    assert (printed.near, printed.far) == (exact.near, exact.far)
    assert printed.half_near == pytest.approx(ratio * exact.half_near, rel=1e-12)
    assert printed.half_far == pytest.approx(ratio * exact.half_far, rel=1e-12)


def test_errors_of_equations_7_and_8_are_those_of_the_shipped_cell() -> None:
    rows = table("Errata")
    printed, corrected = paper_errata.equation_7()
    assert f"{printed:.3f} instead of {corrected:g}." in rows["7"]
    printed, corrected = paper_errata.equation_8()
    low, high, distance = paper_errata.LIMITS_MM
    assert (
        f"limits of {low:g} and {high:g} mm, at {distance:g} mm: {printed:.3f} instead of {corrected:.3f}" in rows["8"]
    )


def test_axis_of_equation_10_is_arbitrary_in_translations() -> None:
    found = paper_errata.equation_10()
    assert f"feigns {found['turn']:.3f}°" in table("Errata")["10"]
    assert f"differ by {found['between']:.0f}° in the median" in table("Errata")["10"]
    assert found["between"] == pytest.approx(90, abs=5)


def test_lower_residual_picks_another_path_more_often_than_chi_squared_tests_lose_it() -> None:
    shares, kept = paper_errata.lower_residual()
    assert kept == 1
    text = words(section("Deviations and reasons"))
    percent = [int(found) for found in re.findall(r"(\d+) %", text.split("picks the path")[1].split("The chi")[0])]
    assert percent == pytest.approx([100 * share for share in shares.values()], abs=0.6)
    assert max(shares.values()) < 0.9


def test_page_refers_to_what_exists() -> None:
    for name in re.findall(r"`scancell\.(\w+)`", TEXT):
        assert name in scancell.__all__, name
    for file, test in re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", TEXT):
        assert not test or f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"), (file, test)
        assert (ROOT / file).is_file(), file
    for target, anchor in re.findall(r"\]\(([\w./]+\.md)(?:#([\w-]+))?\)", TEXT):
        headings = re.findall(r"^#+ (.*)$", (PAGE.parent / target).read_text(encoding="utf-8"), re.MULTILINE)
        slugs = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
        assert not anchor or anchor in slugs, (target, anchor)


def test_page_holds_one_row_for_each_statement_of_the_paper() -> None:
    made = TEXT.split(BEGIN)[1].split(END)[0]
    assert between_marks(TEXT, made.strip()) == TEXT
    subjects = re.findall(r"^\| ([a-z][^|]*) \|", made, re.MULTILINE)[1:]
    assert subjects == [
        "collision query of the whole scene",
        "the whole simulation",
        "controller cycle",
        "poll of the guard",
        "geometric sensing",
        "stop-and-look scan",
    ]
