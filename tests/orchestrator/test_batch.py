"""What a batch takes as parts, what it refuses before anything runs, and what its scans depend on."""

from __future__ import annotations

import json
import shutil

import pytest

from orchestrator.config.batch import load_batch
from orchestrator.config.loading import assets_dir
from orchestrator.errors import DescriptionError
from orchestrator.studies.batch import Batch, check_batch, claim, find_parts, open_batch

PARTS = assets_dir() / "parts"
OFFSET = '[[factor]]\npath = "as_built.tool.x_mm"\ndistribution = { kind = "normal", std = 0.05 }\n'


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)


def opened(folder, text="", variants=None, parts=(PARTS / "step_block.stl",), **changes) -> Batch:
    file = folder / "batch.toml"
    file.write_text(text)
    return open_batch(load_batch(file, changes, variants), file, list(parts), folder / "out")


def test_folders_are_searched_for_meshes_of_all_kinds(tmp_path) -> None:
    touch(tmp_path, "b.STL", "a/b.obj", "a/c d.ply", "notes.txt", ".hidden/x.stl", "out/scans/b-000001/cloud.ply")
    found = find_parts([tmp_path], tmp_path / "out")
    assert [(part.name, part.mesh.relative_to(tmp_path).as_posix()) for part in found] == [
        ("a-b", "a/b.obj"),
        ("a-c-d", "a/c d.ply"),
        ("b", "b.STL"),
    ]


def test_a_mesh_given_twice_is_one_part(tmp_path) -> None:
    touch(tmp_path, "x.stl")
    assert len(find_parts([tmp_path, tmp_path / "x.stl"], tmp_path / "out")) == 1


@pytest.mark.parametrize(
    ("files", "given", "fragment"),
    [
        ((), "none", "none: no such file or folder"),
        (("notes.txt",), "", "holds no mesh"),
        (("x.stl", "x.obj"), "", "would bear the name 'x' as does"),
    ],
)
def test_wrong_parts_are_refused(tmp_path, files, given, fragment) -> None:
    touch(tmp_path, *files)
    with pytest.raises(DescriptionError, match=fragment):
        find_parts([tmp_path / given], tmp_path / "out")


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("image = true", "did you mean 'images'"),
        ('formats = ["las"]', "ply"),
        ('engine = "geometric"\nimages = true', "makes none"),
        ('[design]\nkind = "latin_hypercube"', "needs at least one"),
        (OFFSET.replace("tool.x", "tool.w"), r"batch\.toml: factor as_built\.tool\.w_mm: .*unknown perturbation"),
        (OFFSET.replace("[[factor]]", '[[factor]]\nname = "seed"'), "column of this name"),
        (OFFSET + OFFSET, "is there twice"),
        ('sensor = "none.toml"', r"none\.toml: no such file"),
        ('as_built = ["tool.w_mm=1"]', "unknown perturbation"),
        ("design = 3", "design"),
    ],
)
def test_wrong_descriptions_are_refused(tmp_path, text, fragment) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        check_batch(opened(tmp_path, text))


def test_a_design_that_counts_by_itself_takes_no_number_of_variants(tmp_path) -> None:
    with pytest.raises(DescriptionError, match=r"--variants 3: .*full_factorial"):
        opened(tmp_path, OFFSET + '[design]\nkind = "full_factorial"\n', variants=3)


def test_scans_of_a_part_depend_on_no_other_part_and_not_on_how_many_there_are(tmp_path) -> None:
    touch(tmp_path, "x.stl", "y.stl")
    alone = opened(tmp_path, OFFSET, 2, [tmp_path / "y.stl"])
    many = opened(tmp_path, OFFSET, 5, [tmp_path / "x.stl", tmp_path / "y.stl"])
    assert many.tasks[5:7] == alone.tasks
    assert alone.spec == many.spec
    assert len({task.payload["seed"] for task in many.tasks}) == 10
    assert len({task.payload["values"][0] for task in many.tasks}) == 10


def test_without_factors_variants_differ_in_their_noise(tmp_path) -> None:
    tasks = opened(tmp_path, variants=3).tasks
    assert [task.payload["values"] for task in tasks] == [[], [], []]
    assert len({task.payload["seed"] for task in tasks}) == 3


def test_another_batch_is_refused_in_the_same_folder(tmp_path) -> None:
    claim(opened(tmp_path, variants=2), tmp_path / "out")
    claim(opened(tmp_path, variants=7), tmp_path / "out")
    with pytest.raises(DescriptionError, match=r"batch\.seed was 0, is 4; --out"):
        claim(opened(tmp_path, seed=4), tmp_path / "out")
    with pytest.raises(DescriptionError, match=r"setup\.scan\.max_profiles was"):
        claim(opened(tmp_path, set=["scan.max_profiles=9"]), tmp_path / "out")


def test_a_mesh_of_the_cell_that_changed_is_another_batch_and_one_that_moved_is_not(tmp_path) -> None:
    base, moved = tmp_path / "base.stl", tmp_path / "moved.stl"
    shutil.copy(PARTS / "step_block.stl", base)
    claim(opened(tmp_path, set=[f'cell.table.base_mesh="{base}"']), tmp_path / "out")
    base.rename(moved)
    of_moved = {"set": [f'cell.table.base_mesh="{moved}"']}
    assert claim(opened(tmp_path, **of_moved), tmp_path / "out").warnings == []
    shutil.copy(PARTS / "free_form.stl", moved)
    with pytest.raises(DescriptionError, match=r"cell\.table\.base_mesh: .*moved\.stl does not hold what .*base\.stl"):
        claim(opened(tmp_path, **of_moved), tmp_path / "out")


def test_a_batch_of_a_version_that_knew_fewer_keys_goes_on(tmp_path) -> None:
    batch, out = opened(tmp_path, variants=2), tmp_path / "out"
    claim(batch, out)
    kept = json.loads((out / "description.json").read_text())
    del kept["batch"]["truth"], kept["setup"]["sensor"]["render"]["noise"]
    (out / "description.json").write_text(json.dumps(kept))
    found = claim(batch, out)
    assert set(found.new_keys) == {"batch.truth", "setup.sensor.render.noise"}
    assert json.loads((out / "description.json").read_text()) == kept, "what is there stays as it was begun"
    with pytest.raises(DescriptionError, match=r"batch\.truth was not known then and is False"):
        claim(opened(tmp_path, truth=False), out)


@pytest.mark.parametrize("file", sorted((assets_dir() / "batches").glob("*.toml")), ids=lambda path: path.stem)
def test_the_shipped_batches_can_be_made(file, tmp_path) -> None:
    check_batch(open_batch(load_batch(file, {}), file, [PARTS / "step_block.stl"], tmp_path / "out"))
