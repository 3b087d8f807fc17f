"""Two builds of scancell are told apart by what they are made of, and one is the same wherever it lies."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path
from types import ModuleType

import orchestrator
from orchestrator.evaluation.build import build_version, fingerprint, sources
from orchestrator.studies.run_record import told_builds

ROOT = Path(__file__).resolve().parents[2]


def test_a_copy_is_the_same_build_and_a_changed_one_is_not(tmp_path) -> None:
    # An editable installation has a folder for the sources and one for what is built.
    copy = ModuleType("orchestrator")
    copy.__path__ = []
    for number, folder in enumerate(orchestrator.__path__):
        copy.__path__.append(shutil.copytree(folder, tmp_path / f"copy {number}", symlinks=True))
    own = fingerprint(sources(orchestrator))
    assert fingerprint(sources(copy)) == own
    (report,) = tmp_path.glob("copy */evaluation/report.py")
    with report.open("a") as file:
        file.write("# another word\n")
    assert fingerprint(sources(copy)) != own


def test_names_and_contents_count_and_folders_do_not(tmp_path) -> None:
    def made(folder: str, **contents: str) -> str:
        (tmp_path / folder).mkdir()
        for name, text in contents.items():
            (tmp_path / folder / name).write_text(text)
        return fingerprint([(name, tmp_path / folder / name) for name in contents])

    first = made("first", a="x", b="y")
    assert made("second", b="y", a="x") == first
    assert (
        len({first, made("changed", a="x", b="z"), made("renamed", a="x", c="y"), made("more", a="x", b="y", c="")})
        == 4
    )


def test_the_version_is_that_of_the_project() -> None:
    release = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.fullmatch(rf"{re.escape(release)}\+[0-9a-f]{{12}}", build_version())
    assert f"project(scancell VERSION {release} " in (ROOT / "CMakeLists.txt").read_text()


def test_results_of_other_builds_are_counted() -> None:
    own = build_version()
    assert told_builds([own, own, None]) == []
    (told,) = told_builds([own, "0.1.0+0123", own, None])
    assert told.endswith(f"({own}): 1 by 0.1.0+0123, 2 by {own}")
    assert told_builds(["0.1.0+0123"]) != []
