"""Contents of an FMU besides binary and description: terminals, documentation, licences, reference trajectory."""

from __future__ import annotations

import csv
import re
import struct
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections import Counter
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from cell_fixture import Array, Build, cell_description, read_description
from fmpy.validation import validate_fmu
from lxml import etree

from scancell.cell.fmu_file import FmiVersion, build_fmu
from scancell.cell.fmu_package import FmuOptions

VERSIONS: tuple[FmiVersion, ...] = (2, 3)
TOLERANCE = 1e-9
REFERENCE = "extra/org.fmi-standard.fmi-ls-ref"


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """FMUs with all additional files, by FMI version."""
    files = {version: tmp_path_factory.mktemp("whole") / f"RobotCell{version}.fmu" for version in VERSIONS}
    for version, file in files.items():
        build_fmu(cell_description(), file, version)
    return files


@pytest.fixture(scope="module")
def unpacked_fmus(fmus: dict[int, Path]) -> dict[int, Path]:
    return {version: Path(fmpy.extract(str(file), str(file.with_suffix("")))) for version, file in fmus.items()}


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_validator_reports_no_problems(fmus: dict[int, Path], version: int) -> None:
    assert validate_fmu(str(fmus[version])) == []
    assert not [v for v in fmpy.read_model_description(str(fmus[version])).modelVariables if v.type == "Clock"]


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_validator_reports_no_problems_with_clock(tmp_path: Path, version: FmiVersion) -> None:
    """But that FMPy expects output clocks in InitialUnknown, where the standard has none. FMI 2 has no clocks."""
    file = tmp_path / "RobotCell.fmu"
    build_fmu(cell_description(), file, version, FmuOptions(clock=True))
    findings = validate_fmu(str(file))
    assert len(findings) == version - 2
    for finding in findings:
        expected, found = re.findall(r"\{([^}]*)\}", finding)
        assert set(expected.split(", ")) ^ set(found.split(", ")) == {"trigger.clock"}
    clocks = [v for v in fmpy.read_model_description(str(file)).modelVariables if v.type == "Clock"]
    assert len(clocks) == version - 2


def variables(folder: Path) -> list[Any]:
    return list(read_description(folder).modelVariables)


def terminal_members(terminal: ET.Element, path: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    """(variable, terminal path and member name) of every member."""
    for member in terminal.findall("TerminalMemberVariable"):
        yield member.attrib["variableName"], ".".join([*path, member.attrib["memberName"]])
    for inner in terminal.findall("Terminal"):
        yield from terminal_members(inner, (*path, inner.attrib["name"]))


def test_terminals_contain_every_input_and_output_once(unpacked_fmus: dict[int, Path]) -> None:
    file = unpacked_fmus[3] / "terminalsAndIcons/terminalsAndIcons.xml"
    schema = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema/fmi3/fmi3TerminalsAndIcons.xsd"))
    schema.assertValid(etree.parse(str(file)))
    top = ET.parse(file).getroot().find("Terminals")
    assert top is not None
    found = list(terminal_members(top))
    assert all(variable == path for variable, path in found)
    expected = [v.name for v in variables(unpacked_fmus[3]) if v.causality in ("input", "output")]
    assert Counter(variable for variable, _ in found) == Counter(expected)
    assert {t.attrib["name"] for t in top} >= {"command", "measured", "truth", "trigger"}


def test_icons_are_at_standard_locations(unpacked_fmus: dict[int, Path]) -> None:
    for icon in (unpacked_fmus[2] / "model.png", unpacked_fmus[3] / "terminalsAndIcons/icon.png"):
        head = icon.read_bytes()[:24]
        assert head.startswith(b"\x89PNG\r\n\x1a\n")
        assert struct.unpack(">II", head[16:]) == (256, 256)
    assert ET.parse(unpacked_fmus[3] / "terminalsAndIcons/icon.svg").getroot().tag.endswith("svg")
    assert not (unpacked_fmus[2] / "terminalsAndIcons").exists()
    assert not (unpacked_fmus[3] / "model.png").exists()


class Page(HTMLParser):
    """Text, links and ids of a page; rejects tags that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name in ("href", "src"):
                self.links.append(value or "")
            if name == "id":
                self.ids.add(value or "")
        if tag not in ("meta", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data + "\n"


@pytest.mark.parametrize("version", VERSIONS)
def test_documentation_covers_every_variable_offline(unpacked_fmus: dict[int, Path], version: int) -> None:
    file = unpacked_fmus[version] / "documentation/index.html"
    source = file.read_text(encoding="utf-8")
    page = Page(source)
    assert "http" not in source.replace("http-equiv", "")
    for link in page.links:
        assert link.removeprefix("#") in page.ids if link.startswith("#") else (file.parent / link).is_file(), link
    lines = set(page.text.split("\n"))
    for variable in variables(unpacked_fmus[version]):
        assert variable.name in lines
        assert variable.description in lines
        if variable.declaredType is not None and variable.declaredType.unit is not None:
            assert f"{variable.declaredType.unit} ({variable.declaredType.displayUnit})" in lines
        if variable.start is not None:
            assert variable.start in lines


def needed_versions(folder: Path, name: str) -> set[tuple[int, ...]]:
    """Symbol versions required by the binaries, from their undefined dynamic symbols."""
    found = set()
    for library in next((folder / "binaries").iterdir()).iterdir():
        symbols = subprocess.run(["objdump", "-T", library], check=True, capture_output=True, text=True).stdout
        for version in re.findall(rf"\*UND\*.*\({name}_([0-9.]+)\)", symbols):
            found.add(tuple(int(part) for part in version.split(".")))
    return found


@pytest.mark.parametrize("version", VERSIONS)
def test_documented_glibc_version_matches_binaries(unpacked_fmus: dict[int, Path], version: int) -> None:
    folder = unpacked_fmus[version]
    floor = ".".join(map(str, max(needed_versions(folder, "GLIBC"))))
    description = read_description(folder).description
    page = Page((folder / "documentation/index.html").read_text()).text
    for text in (description, page):
        assert re.findall(r"glibc ([0-9.]+[0-9]) or later", text)[0] == floor
    outside = (folder / "documentation/externalDependencies.txt").read_text()
    for name in ("GLIBC", "GLIBCXX", "CXXABI"):
        newest = ".".join(map(str, max(needed_versions(folder, name))))
        assert f"{name}_{newest} or later" in outside
        assert f"{name}_{newest} or later" in page


@pytest.mark.parametrize("version", VERSIONS)
def test_licences_of_all_bundled_files_are_present(unpacked_fmus: dict[int, Path], version: int) -> None:
    folder = unpacked_fmus[version] / "documentation/licenses"
    lines = (folder / "license.txt").read_text().split("\n\n")[1].strip().split("\n")
    rows = [re.split(r": |; ", line) for line in lines]
    assert {file for file, *_ in rows} == {f.name for f in (unpacked_fmus[version] / "binaries").glob("*/*")}
    assert {text for *_, text in rows} | {"license.txt"} == {f.name for f in folder.iterdir()}
    compiled_in = {source.split()[0] for file, source, *_ in rows if file == "RobotCell.so"}
    assert compiled_in == {"scancell", "fmi", "libeigen3-dev", "nlohmann-json3-dev"}
    for _, source, license_name, text in rows:
        assert license_name != "see text", source
        assert not license_name.startswith(("GPL", "LGPL", "AGPL")), source
        assert "copyright" in (folder / text).read_text(errors="replace").lower()


def read_table(file: Path) -> tuple[list[str], Array]:
    with file.open() as lines:
        names, *rows = list(csv.reader(lines))
    return names, np.array(rows, dtype=float)


@pytest.mark.parametrize("version", VERSIONS)
def test_reference_trajectory_is_reproduced(unpacked_fmus: dict[int, Path], open_fmu: Build, version: int) -> None:
    folder = unpacked_fmus[version]
    input_names, inputs = read_table(folder / REFERENCE / "reference_inputs.csv")
    names, outputs = read_table(folder / REFERENCE / "reference_outputs.csv")
    cell = open_fmu(folder)
    reals = [n for n in names if cell.variables[n].type in ("Real", "Float64")]
    others = [n for n in names if n not in reals]
    assert names[1:] == [*reals[1:], *others]
    counted = {
        v.name for v in cell.variables.values() if v.causality == "output" and v.type not in ("Boolean", "String")
    }
    assert set(names[1:]) == counted
    for k, expected in enumerate(outputs):
        seen = [*cell.get(*reals), *(cell.get_int(n) for n in others)]
        np.testing.assert_allclose(seen, expected, rtol=0, atol=TOLERANCE, err_msg=f"row {k}")
        if k < len(inputs):
            for name, value in zip(input_names[1:], inputs[k, 1:], strict=True):
                whole_number = cell.variables[name].type.startswith(("Int", "Enum"))
                cell.set(name, int(value) if whole_number else float(value))
            cell.step(round((outputs[k + 1, 0] - expected[0]) * 1e6))
    moved = dict(zip(names, np.ptp(outputs, axis=0), strict=True))
    assert all(moved[f"truth.q[{i}]"] > np.radians(0.6) for i in range(1, 7))
    assert moved["truth.table"] > 0.5
    assert moved["trigger.index"] > 30


def test_manifest_refers_to_reference_files(unpacked_fmus: dict[int, Path]) -> None:
    for folder in unpacked_fmus.values():
        manifest = ET.parse(folder / REFERENCE / "fmi-ls-manifest.xml").getroot()
        space = "{http://fmi-standard.org/fmi-ls-manifest}"
        assert manifest.attrib[f"{space}fmi-ls-name"] == "org.fmi-standard.fmi-ls-ref"
        related = {e.attrib["role"]: folder / REFERENCE / e.attrib["source"] for e in manifest.findall("Related")}
        assert set(related) == {"testcase", "result"}
        assert all(file.is_file() for file in related.values())


@pytest.mark.parametrize("version", VERSIONS)
def test_packing_is_reproducible(fmus: dict[int, Path], tmp_path: Path, version: FmiVersion) -> None:
    again = tmp_path / "again.fmu"
    build_fmu(cell_description(), again, version)
    assert again.read_bytes() == fmus[version].read_bytes()
    with zipfile.ZipFile(again) as archive:
        assert len(archive.namelist()) == len(set(archive.namelist()))
        assert all(entry.compress_type in (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED) for entry in archive.infolist())


def test_reference_is_reproduced_in_clean_environment(fmus: dict[int, Path], tmp_path: Path) -> None:
    """Empty environment, other working directory, FMPy and the standard library only."""
    files = list(fmus.values())
    program = Path(__file__).with_name("clean_root.py")
    command = [sys.executable, "-I", str(program), "--here", *map(str, files)]
    done = subprocess.run(command, env={}, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout.splitlines() == [f"{f.name}: greatest difference from the reference 0" for f in files]
