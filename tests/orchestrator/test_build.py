"""Build fingerprints of scancell: dependence on contents, independence of the folder."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path
from types import ModuleType

import scancell
from scancell.output.run_folder import build_version, fingerprint, sources
from scancell.studies.run_record import mixed_build_warnings

ROOT = Path(__file__).resolve().parents[2]


def test_fingerprint_detects_changed_sources(tmp_path) -> None:
    # An editable installation has one folder for sources and one for built modules.
    copy = ModuleType("scancell")
    copy.__path__ = []
    for number, folder in enumerate(scancell.__path__):
        copy.__path__.append(shutil.copytree(folder, tmp_path / f"copy {number}", symlinks=True))
    own = fingerprint(sources(scancell))
    assert fingerprint(sources(copy)) == own
    (report,) = tmp_path.glob("copy */output/run_folder.py")
    with report.open("a") as file:
        file.write("# another word\n")
    assert fingerprint(sources(copy)) != own


def test_fingerprint_depends_on_names_and_contents(tmp_path) -> None:
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


def test_build_version_matches_project() -> None:
    release = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.fullmatch(rf"{re.escape(release)}\+[0-9a-f]{{12}}", build_version())
    assert f"project(scancell VERSION {release} " in (ROOT / "CMakeLists.txt").read_text()


def test_mixed_build_warning_counts_results() -> None:
    own = build_version()
    assert mixed_build_warnings([own, own, None]) == []
    (warning,) = mixed_build_warnings([own, "0.1.0+0123", own, None])
    assert warning.endswith(f"({own}): 1 by 0.1.0+0123, 2 by {own}")
    assert mixed_build_warnings(["0.1.0+0123"]) != []
