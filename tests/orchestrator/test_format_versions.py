"""Versions of formats: stated by what is written, accepted when missing or known, and refused when newer."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pyarrow.parquet
import pytest

import scancell
from compatibility import SETS, copy_of
from scancell.errors import DescriptionError
from scancell.files import MANIFEST_VERSION, PLAN_VERSION, RECORDING_VERSION
from scancell.views.recorded_run import open_archive, open_run

NEWEST = {
    "plan.json": PLAN_VERSION,
    "recording.parquet": RECORDING_VERSION,
    "manifest.json": MANIFEST_VERSION,
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_of(SETS[0], tmp_path_factory.mktemp("versions") / "set")


@pytest.fixture
def run(files: Path, tmp_path: Path) -> Path:
    return shutil.copytree(files / "scan_geometric", tmp_path / "run")


def state(file: Path, version: Any) -> None:
    """State a version in a file."""
    if file.suffix == ".json":
        file.write_text(json.dumps({**json.loads(file.read_text()), "format_version": version}))
    else:
        table = pyarrow.parquet.read_table(file)
        pyarrow.parquet.write_table(table.replace_schema_metadata({"format_version": str(version)}), file)


def stated(file: Path) -> int | None:
    if file.suffix == ".json":
        version: int | None = json.loads(file.read_text()).get("format_version")
        return version
    metadata = pyarrow.parquet.read_schema(file).metadata or {}
    return int(metadata[b"format_version"]) if b"format_version" in metadata else None


def test_what_is_written_states_its_version(files: Path, tmp_path: Path) -> None:
    described = {"cell": files / "cell.toml", "sensor": files / "sensor.toml", "scan": files / "scan.toml"}
    with scancell.Scanner(**described) as scanner:
        result = scanner.scan(files / "part.stl", engine="geometric")
    result.save(tmp_path / "run")
    assert {name: stated(tmp_path / "run" / name) for name in NEWEST} == NEWEST
    assert stated(result.plan.save(tmp_path / "plan.json")) == PLAN_VERSION
    assert open_run(tmp_path / "run").cloud_points == len(result.cloud)


@pytest.mark.parametrize("name", NEWEST)
def test_files_without_a_version_and_of_the_newest_one_are_read(run: Path, name: str) -> None:
    assert stated(run / name) is None
    open_run(run)
    state(run / name, NEWEST[name])
    open_run(run)


@pytest.mark.parametrize("name", NEWEST)
def test_newer_versions_are_refused_with_the_newest_known_one(run: Path, name: str) -> None:
    newer = NEWEST[name] + 1
    state(run / name, newer)
    expected = rf"{name}: format_version = {newer}: .*newer version .* reads up to {NEWEST[name]}: update scancell"
    with pytest.raises(DescriptionError, match=expected):
        open_run(run)


def test_a_newer_run_is_refused_in_an_upload(run: Path) -> None:
    state(run / "manifest.json", MANIFEST_VERSION + 1)
    archive = Path(shutil.make_archive(str(run), "zip", run))
    with pytest.raises(DescriptionError, match=r"run\.zip: manifest\.json: format_version .*: update scancell"):
        open_archive(archive.read_bytes(), "run.zip")


@pytest.mark.parametrize("name", NEWEST)
@pytest.mark.parametrize("version", [0, -1, "two", 1.5])
def test_versions_that_are_none_are_refused(run: Path, name: str, version: Any) -> None:
    state(run / name, version)
    with pytest.raises(DescriptionError, match=rf"{name}: format_version = .*expected an integer from 1"):
        open_run(run)


def test_newer_plan_is_refused_by_its_version_though_it_has_other_keys(run: Path) -> None:
    plan = json.loads((run / "plan.json").read_text())
    (run / "plan.json").write_text(json.dumps({**plan, "format_version": PLAN_VERSION + 1, "axes": []}))
    with pytest.raises(DescriptionError, match="update scancell"):
        scancell.Plan.load(run / "plan.json")
