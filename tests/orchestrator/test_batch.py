"""Parts of a batch, errors found before anything runs, and the inputs of its scans."""

from __future__ import annotations

import pytest

from scancell.config.loading import assets_dir
from scancell.config.study import load_batch
from scancell.errors import DescriptionError
from scancell.studies.batch import Batch, find_parts, open_batch
from scancell.studies.run_record import Comparison, recorded_terms

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


def claim(batch: Batch, out) -> Comparison:
    batch.begin(out)
    return batch.check_same(out)


def test_folders_are_searched_for_meshes_of_all_formats(tmp_path) -> None:
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
        (("notes.txt",), "", "holds no part"),
        (("x.stl", "x.obj"), "", "has the same name 'x' as"),
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
        ('engine = "geometric"\nimages = true', "renders none"),
        ('[design]\nkind = "latin_hypercube"', "needs at least one"),
        (OFFSET.replace("tool.x", "tool.w"), r"batch\.toml: factor as_built\.tool\.w_mm: .*unknown perturbation"),
        (OFFSET.replace("[[factor]]", '[[factor]]\nname = "seed"'), "column of this name"),
        (OFFSET + OFFSET, "is given twice"),
        ('sensor = "none.toml"', r"none\.toml: no such file"),
        ('as_built = ["tool.w_mm=1"]', "unknown perturbation"),
        ("design = 3", "design"),
    ],
)
def test_wrong_descriptions_are_refused(tmp_path, text, fragment) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        opened(tmp_path, text).check()


def test_number_of_variants_is_refused_for_designs_that_fix_it(tmp_path) -> None:
    with pytest.raises(DescriptionError, match=r"variants = 3: .*full_factorial"):
        opened(tmp_path, OFFSET + '[design]\nkind = "full_factorial"\n', variants=3)


def test_scans_of_a_part_do_not_depend_on_other_parts_or_the_number_of_variants(tmp_path) -> None:
    touch(tmp_path, "x.stl", "y.stl")
    alone = opened(tmp_path, OFFSET, 2, [tmp_path / "y.stl"])
    many = opened(tmp_path, OFFSET, 5, [tmp_path / "x.stl", tmp_path / "y.stl"])
    assert many.tasks[5:7] == alone.tasks
    for batch, out in ((alone, tmp_path / "alone"), (many, tmp_path / "many")):
        batch.begin(out)
    assert recorded_terms(tmp_path / "alone") == recorded_terms(tmp_path / "many")
    assert len({task.payload["seed"] for task in many.tasks}) == 10
    assert len({task.payload["values"][0] for task in many.tasks}) == 10


def test_without_factors_variants_differ_in_their_noise(tmp_path) -> None:
    tasks = opened(tmp_path, variants=3).tasks
    assert [task.payload["values"] for task in tasks] == [[], [], []]
    assert len({task.payload["seed"] for task in tasks}) == 3


def test_another_batch_is_refused_in_the_same_folder(tmp_path) -> None:
    claim(opened(tmp_path, variants=2), tmp_path / "out")
    claim(opened(tmp_path, variants=7), tmp_path / "out")
    with pytest.raises(DescriptionError, match=r"batch\.seed was 0, is 4; `out`"):
        claim(opened(tmp_path, seed=4), tmp_path / "out")
    with pytest.raises(DescriptionError, match=r"setup\.scan\.max_profiles was"):
        claim(opened(tmp_path, set=["scan.max_profiles=9"]), tmp_path / "out")


@pytest.mark.parametrize("file", sorted((assets_dir() / "batches").glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_batches_are_valid(file, tmp_path) -> None:
    open_batch(load_batch(file, {}), file, [PARTS / "step_block.stl"], tmp_path / "out").check()
