"""Which changes of a request keep the results of a folder valid, and which do not."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scancell.config.description import validate
from scancell.config.loading import Setup, assets_dir
from scancell.config.study import StudyDescription
from scancell.errors import DescriptionError
from scancell.output.run_folder import versions
from scancell.studies.engine import request_digest
from scancell.studies.factors import checked_sections
from scancell.studies.run_record import recorded_terms
from scancell.studies.study import Study, open_study, open_trials
from studies_files import DESIGN, GLOSS, HEAD, OFFSET, write_study


@pytest.fixture
def study(tmp_path) -> Study:
    return open_study(write_study(tmp_path, HEAD, DESIGN, OFFSET, GLOSS))


@pytest.fixture
def out(study, tmp_path):
    study.begin(tmp_path / "out")
    return tmp_path / "out"


def rewrite(out, change) -> None:
    """Change the record to one of another version."""
    record = out / "description.json"
    content = json.loads(record.read_text())
    change(content)
    record.write_text(json.dumps(content))


def every_key(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all keys of tables, at any depth."""
    pairs = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in pairs:
        if isinstance(node, dict):
            yield (*path, key)
        yield from every_key(value, (*path, key))


def without(terms: dict[str, Any], path: tuple[Any, ...]) -> dict[str, Any]:
    changed = copy.deepcopy(terms)
    node: Any = changed
    for key in path[:-1]:
        node = node[key]
    del node[path[-1]]
    return changed


def resolved_again(terms: dict[str, Any]) -> tuple[Any, ...] | None:
    """An older description resolved by the present schema; None where it is refused."""
    try:
        setup = Setup(**checked_sections(terms["setup"]))
        return validate(StudyDescription, terms["study"], ""), setup.cell, setup.sensor, setup.scan
    except DescriptionError:
        return None


def test_folder_without_a_key_continues_only_if_the_key_is_at_its_default(study, out) -> None:
    whole = recorded_terms(out)
    today = resolved_again(whole)
    paths = [
        path for path in every_key(whole) if path[0] in {"study", "setup"} and len(path) > 1 + (path[0] == "setup")
    ]
    paths.remove(("study", "part"))  # compared by the content of the file
    accepted = 0
    for path in paths:
        older = without(whole, path)
        rewrite(out, lambda content, older=older: (content.clear(), content.update(older)))
        key = ".".join(str(piece) for piece in path if not isinstance(piece, int))
        if resolved_again(older) == today:
            assert study.check_same(out).new_keys, key
            accepted += 1
        else:
            with pytest.raises(DescriptionError, match=f"{path[-1]} was unknown then and is"):
                study.check_same(out)
    assert accepted > 100
    assert len(paths) - accepted > 100


def test_folder_without_a_new_key_keeps_its_results(study, out) -> None:
    rewrite(out, lambda content: content["setup"]["sensor"]["render"].pop("bounces"))
    found = study.check_same(out)
    assert found.new_keys == ["setup.sensor.render.bounces"]
    assert "description.json does not contain setup.sensor.render.bounces" in found.warnings[0]
    # The digest is that of the words in the folder, so what carries it there is an answer.
    job, kept = study.job(out), json.loads((out / "description.json").read_text())
    del kept["versions"]
    assert job.digest == request_digest(open_trials, kept)
    assert job.digest != request_digest(open_trials, study.spec)


def test_differences_are_listed_with_file_key_and_values(study, out) -> None:
    rewrite(out, lambda content: content["setup"]["cell"]["part"].update(reflectance=0.123, fame=7))
    expected = r"small\.toml: .*description\.json: .*part\.reflectance was 0\.123, is .*part\.fame was 7, is unknown"
    with pytest.raises(DescriptionError, match=expected):
        study.check_same(out)


def test_lists_of_another_length_differ(study, out) -> None:
    rewrite(out, lambda content: content["study"]["factor"].pop())
    with pytest.raises(DescriptionError, match=r"study\.factor was \[.* is \["):
        study.check_same(out)


def test_origin_of_a_value_does_not_matter(study, out) -> None:
    rewrite(out, lambda content: content["study"].update(set=["scan.max_profiles=3"], ideal=False))
    study.check_same(out)
    other = open_study(Path(study.source), ['set=["scan.raster.enabled=false", "scan.max_profiles=20"]'])
    assert other.check_same(out).warnings == []


def test_another_version_is_a_warning(study, out) -> None:
    rewrite(out, lambda content: content["versions"].update(scancell="0.0.1"))
    (warning,) = study.check_same(out).warnings
    assert f"begun with scancell 0.0.1 (now {versions()['scancell']})" in warning


@pytest.mark.parametrize("content", ["", "[]", "{"])
def test_damaged_record_is_named(study, out, content) -> None:
    (out / "description.json").write_text(content)
    with pytest.raises(DescriptionError, match=r"description\.json: cannot be read"):
        study.check_same(out)


PARTS = assets_dir() / "parts"


def with_own_files(folder: Path) -> Study:
    """A study in `folder`, which also holds its part and two meshes, one of the cell's and one of a factor's."""
    folder.mkdir()
    for name in ("part", "base", "other"):
        shutil.copy(PARTS / "step_block.stl", folder / f"{name}.stl")
    shutil.copy(PARTS / "sphere_on_foot.stl", folder / "part.stl")
    return of_folder(folder)


def of_folder(folder: Path) -> Study:
    meshes = f"set = ['cell.table.base_mesh=\"{folder / 'base.stl'}\"']"
    factor = '[[factor]]\npath = "cell.table.platter_mesh"\nmode = "absolute"\n'
    values = f'distribution = {{ kind = "discrete", values = ["{folder / "other.stl"}"] }}\n'
    return open_study(write_study(folder, 'name = "small"\npart = "part.stl"', meshes, DESIGN, factor + values))


def test_study_moved_with_its_files_continues(tmp_path) -> None:
    study = with_own_files(tmp_path / "before")
    study.begin(tmp_path / "before" / "out")
    digest = study.job(tmp_path / "before" / "out").digest
    (tmp_path / "before").rename(tmp_path / "after")
    moved, out = of_folder(tmp_path / "after"), tmp_path / "after" / "out"
    assert moved.check_same(out).warnings == []
    assert moved.job(out).digest == digest, "what is finished counts"
    assert moved.spec["part"] == str(tmp_path / "after" / "part.stl")


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("part", "part"),
        ("base", "setup.cell.table.base_mesh"),
        ("other", r"study\.factor\[1\]\.distribution\.values\[1\]"),
    ],
)
def test_file_with_other_content_is_named(tmp_path, name, key) -> None:
    with_own_files(tmp_path / "folder").begin(tmp_path / "out")
    shutil.copy(PARTS / "free_form.stl", tmp_path / "folder" / f"{name}.stl")
    with pytest.raises(DescriptionError, match=rf"differs.*: {key}: .*{name}\.stl differs from .*{name}\.stl"):
        of_folder(tmp_path / "folder").check_same(tmp_path / "out")


def test_missing_file_is_named(tmp_path) -> None:
    study = with_own_files(tmp_path / "folder")
    (tmp_path / "folder" / "base.stl").unlink()
    with pytest.raises(DescriptionError, match=r"base\.stl: cannot be read: No such file"):
        study.begin(tmp_path / "out")
