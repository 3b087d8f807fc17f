"""Which changes of what is asked for let the results in a folder count, and which do not."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from studies_files import DESIGN, GLOSS, HEAD, OFFSET, write_study

from orchestrator.config.description import validate
from orchestrator.config.loading import assets_dir
from orchestrator.config.study import StudyDescription
from orchestrator.errors import DescriptionError
from orchestrator.evaluation.manifest import versions
from orchestrator.studies.run_record import recorded_terms
from orchestrator.studies.scan_worker import setup_of
from orchestrator.studies.study import Study, begin, check_same, open_study
from orchestrator.studies.task import request_digest
from orchestrator.studies.trial import open_trials


@pytest.fixture
def study(tmp_path) -> Study:
    return open_study(write_study(tmp_path, HEAD, DESIGN, OFFSET, GLOSS))


@pytest.fixture
def out(study, tmp_path):
    begin(study, tmp_path / "out")
    return tmp_path / "out"


def rewrite(out, change) -> None:
    """The folder as another version would have left it."""
    record = out / "description.json"
    content = json.loads(record.read_text())
    change(content)
    record.write_text(json.dumps(content))


def every_key(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where a table has a key, at any depth."""
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
    """What the schema of today makes of an older description; None where it makes nothing."""
    try:
        setup = setup_of(terms["setup"])
        return validate(StudyDescription, terms["study"], ""), setup.cell, setup.sensor, setup.scan
    except DescriptionError:
        return None


def test_a_folder_without_a_key_goes_on_exactly_where_the_schema_would_give_the_key_its_value(study, out) -> None:
    whole = recorded_terms(out)
    today = resolved_again(whole)
    paths = [
        path for path in every_key(whole) if path[0] in {"study", "setup"} and len(path) > 1 + (path[0] == "setup")
    ]
    paths.remove(("study", "part"))  # told by what the file holds
    accepted = 0
    for path in paths:
        older = without(whole, path)
        rewrite(out, lambda content, older=older: (content.clear(), content.update(older)))
        key = ".".join(str(piece) for piece in path if not isinstance(piece, int))
        if resolved_again(older) == today:
            assert check_same(study, out).new_keys, key
            accepted += 1
        else:
            with pytest.raises(DescriptionError, match=f"{path[-1]} was not known then and is"):
                check_same(study, out)
    assert accepted > 100
    assert len(paths) - accepted > 100


def test_a_folder_without_a_new_key_keeps_its_results(study, out) -> None:
    rewrite(out, lambda content: content["setup"]["sensor"]["render"].pop("bounces"))
    found = check_same(study, out)
    assert found.new_keys == ["setup.sensor.render.bounces"]
    assert "description.json does not know setup.sensor.render.bounces" in found.warnings[0]
    # The digest is that of the words in the folder, so what carries it there is an answer.
    job, kept = study.job(out), json.loads((out / "description.json").read_text())
    del kept["versions"]
    assert job.digest == request_digest(open_trials, kept)
    assert job.digest != request_digest(open_trials, study.spec)


def test_all_that_differs_is_told_with_file_key_and_values(study, out) -> None:
    rewrite(out, lambda content: content["setup"]["cell"]["part"].update(reflectance=0.123, fame=7))
    expected = r"small\.toml: .*description\.json: .*part\.reflectance was 0\.123, is .*part\.fame was 7, is not known"
    with pytest.raises(DescriptionError, match=expected):
        check_same(study, out)


def test_lists_of_another_length_are_another_question(study, out) -> None:
    rewrite(out, lambda content: content["study"]["factor"].pop())
    with pytest.raises(DescriptionError, match=r"study\.factor was \[.* is \["):
        check_same(study, out)


def test_how_a_value_came_to_be_is_no_difference(study, out) -> None:
    rewrite(out, lambda content: content["study"].update(set=["scan.max_profiles=3"], ideal=False))
    check_same(study, out)
    other = open_study(study.source, ['set=["scan.raster.enabled=false", "scan.max_profiles=20"]'])
    assert check_same(other, out).warnings == []


def test_another_version_is_told(study, out) -> None:
    rewrite(out, lambda content: content["versions"].update(scancell="0.0.1"))
    (warning,) = check_same(study, out).warnings
    assert f"begun with scancell 0.0.1 (now {versions()['scancell']})" in warning


@pytest.mark.parametrize("content", ["", "[]", "{"])
def test_a_mutilated_record_is_named(study, out, content) -> None:
    (out / "description.json").write_text(content)
    with pytest.raises(DescriptionError, match=r"description\.json: cannot be read"):
        check_same(study, out)


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


def test_a_study_that_was_moved_with_its_files_goes_on(tmp_path) -> None:
    study = with_own_files(tmp_path / "before")
    begin(study, tmp_path / "before" / "out")
    digest = study.job(tmp_path / "before" / "out").digest
    (tmp_path / "before").rename(tmp_path / "after")
    moved, out = of_folder(tmp_path / "after"), tmp_path / "after" / "out"
    assert check_same(moved, out).warnings == []
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
def test_a_file_that_holds_something_else_is_told(tmp_path, name, key) -> None:
    begin(with_own_files(tmp_path / "folder"), tmp_path / "out")
    shutil.copy(PARTS / "free_form.stl", tmp_path / "folder" / f"{name}.stl")
    with pytest.raises(
        DescriptionError, match=rf"differs.*: {key}: .*{name}\.stl does not hold what .*{name}\.stl held"
    ):
        check_same(of_folder(tmp_path / "folder"), tmp_path / "out")


def test_a_file_that_is_gone_is_told(tmp_path) -> None:
    study = with_own_files(tmp_path / "folder")
    (tmp_path / "folder" / "base.stl").unlink()
    with pytest.raises(DescriptionError, match=r"base\.stl: cannot be read: No such file"):
        begin(study, tmp_path / "out")


def test_a_folder_that_has_the_checksum_of_its_part_alone_goes_by_the_paths_of_the_others(tmp_path) -> None:
    study, out = with_own_files(tmp_path / "before"), tmp_path / "out"
    begin(study, out)

    def older(content) -> None:
        content["part_sha256"] = content.pop("files")[content["part"]]

    rewrite(out, older)
    (warning,) = check_same(study, out).warnings
    assert f"does not know what {tmp_path / 'before' / 'other.stl'}, " in warning
    (tmp_path / "before").rename(tmp_path / "after")
    with pytest.raises(DescriptionError, match=r"other\.stl") as refused:
        check_same(of_folder(tmp_path / "after"), out)
    assert "part.stl" not in str(refused.value)
