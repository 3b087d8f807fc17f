"""Generated pages of the site: every command, option, public name and key is on them."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

import scancell
from scancell.reconstruction.cloud_files import FORMATS
from scancell.reconstruction.cloud_files.formats import RECORD

ROOT = Path(__file__).resolve().parents[2]
SCHEMAS = sorted((ROOT / "docs" / "schemas").glob("*.schema.json"))


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    specification = importlib.util.spec_from_file_location("reference", ROOT / "docs" / "site" / "reference.py")
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_page_of_commands_has_every_command_of_the_help(reference: ModuleType) -> None:
    text = reference.commands()
    entry = [sys.executable, "-c", "from scancell.cli import main; main()"]
    done = subprocess.run([*entry, "--help"], capture_output=True, text=True, check=True)
    listed = re.findall(r"^  (\w[\w-]*)\s{2,}", done.stdout, re.MULTILINE)
    assert len(listed) > 20
    assert [name for name in listed if not re.search(rf"^## scancell {name}\b", text, re.MULTILINE)] == []
    calibrate = text.partition("## scancell calibrate")[2].partition("\n## ")[0]
    assert "`--from-points <path>`" in calibrate


def test_pages_of_python_have_every_public_name(reference: ModuleType) -> None:
    pages = reference.python_pages(ROOT / "orchestrator" / "scancell" / "__init__.pyi")
    named = set(re.findall(r"^\.\. auto\w+:: scancell\.([\w.]+)$", "".join(pages.values()), re.MULTILINE))
    modules = {"pose": "geometry.pose"}
    assert named == {modules.get(name, name) for name in scancell.__all__}


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda path: path.name.split(".")[0])
def test_pages_of_keys_have_every_key_and_lead_to_its_type(reference: ModuleType, schema: Path) -> None:
    content = json.loads(schema.read_text(encoding="utf-8"))
    text = reference.keys(schema.name.split(".")[0], content)
    names = {key for one in (content, *content["$defs"].values()) for key in one.get("properties", {})}
    assert [key for key in names if f"\n| `{key}` | " not in text] == []
    headings = {line[3:].lower() for line in text.splitlines() if line.startswith("## ")}
    assert set(re.findall(r"\]\(#(\w+)\)", text)) <= headings


def test_row_of_a_key_has_bounds_default_and_meaning(reference: ModuleType) -> None:
    schema = json.loads((ROOT / "docs" / "schemas" / "scan.schema.json").read_text(encoding="utf-8"))
    row = "| `elevation_deg` | number ≥ 0 ≤ 90 | `30.0` | angle of the viewing direction above the horizontal"
    assert row in reference.keys("scan", schema)


def test_page_of_files_has_every_field_and_format_of_a_cloud() -> None:
    text = (ROOT / "docs" / "files.md").read_text(encoding="utf-8").partition("## Cloud")[2]
    named = set(re.findall(r"`(\w+)`", text))
    assert {*(RECORD.names or ()), *FORMATS} <= named


def test_citation_names_the_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {project['version']}\n" in citation
    assert f"\nlicense: {project['license']}\n" in citation
