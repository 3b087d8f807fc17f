"""Packages of extras: imported where they are used, and named with the command that installs them."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import scancell
from scancell.errors import MissingExtraError, require
from scancell.reconstruction.cloud_files import parse_formats

PROJECT = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())["project"]
MODULES = {
    "studies": ("distributed", "dask", "bokeh", "SALib", "jinja2", "matplotlib"),
    "formats": ("laspy", "lazrs", "pye57", "h5py", "rosbags", "mcap"),
    "mesh": ("open3d",),
    "workspace": ("viser", "mcap_protobuf", "foxglove_schemas_protobuf"),
}


def test_missing_package_is_named_with_the_command_that_installs_it() -> None:
    with pytest.raises(MissingExtraError, match=r'^no_such_package .*: pip install "scancell\[studies\]"$'):
        require("no_such_package.inside", "studies")


def test_missing_dependency_of_an_installed_package_is_not_blamed_on_the_extra(tmp_path, monkeypatch) -> None:
    (tmp_path / "installed_but_broken.py").write_text("import no_such_package")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="no_such_package"):
        require("installed_but_broken", "studies")


def test_format_without_its_package_is_refused_before_any_scan(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pye57", None)
    monkeypatch.delitem(sys.modules, "scancell.reconstruction.cloud_files.e57", raising=False)
    with pytest.raises(MissingExtraError, match=r"pye57 .*scancell\[formats\]"):
        parse_formats("ply,e57", "--format")


def test_recorder_names_its_missing_package_when_used(tmp_path, monkeypatch) -> None:
    for module in ("mcap_protobuf", "mcap_protobuf.writer"):
        monkeypatch.setitem(sys.modules, module, None)
    cell = scancell.nominal_cell(scancell.load_setup().cell, scancell.box_mesh((0.01, 0.01, 0.01)))
    with pytest.raises(MissingExtraError, match=r"mcap_protobuf .*scancell\[workspace\]"):
        scancell.SessionRecorder(tmp_path / "session.mcap", cell)


def test_modules_import_without_the_extras() -> None:
    """All modules but the ones that run Dask and make the report of a study."""
    blocked = [module for modules in MODULES.values() for module in modules]
    script = f"""
import sys, pkgutil
sys.modules.update(dict.fromkeys({blocked}))
import scancell.studies, scancell.output, scancell.cli
for package in (scancell.studies, scancell.output, scancell.cli):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if not module.name.endswith(("dask_cluster", "page", "plots")):
            __import__(module.name)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_extras_of_the_project_provide_the_modules() -> None:
    extras, core = PROJECT["optional-dependencies"], " ".join(PROJECT["dependencies"])
    for extra, modules in MODULES.items():
        listed = " ".join(extras[extra]).replace("-", "_")
        for module in modules:
            assert module in listed or module == "dask", (extra, module)  # distributed requires dask
            assert module not in core
        assert extra in extras["all"][0]
