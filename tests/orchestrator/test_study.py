"""Study files: valid keys, errors found before anything runs, and the inputs of a trial."""

from __future__ import annotations

import pytest

from scancell.errors import DescriptionError, OutputError
from scancell.studies.study import begin_new, open_study
from studies_files import DESIGN, GLOSS, HEAD, OFFSET, write_study

UNITS = {"as_built.tool.x": "m", "as_built.vibration.base.frequency": "Hz", "as_built.trigger.latency": "s"}


def factor(path: str, mode: str = "additive", distribution: str = 'kind = "normal", std = 0.1') -> str:
    return f'[[factor]]\npath = "{path}"\nmode = "{mode}"\ndistribution = {{ {distribution} }}\n'


def discrete(path: str, values: str, mode: str = "absolute") -> str:
    return factor(path, mode, f'kind = "discrete", values = {values}')


@pytest.mark.parametrize(
    ("factors", "fragment"),
    [
        (factor("cell.part.reflectence"), "did you mean 'reflectance'"),
        (factor("part.reflectance"), "begins with cell., sensor., scan. or as_built."),
        (factor("as_built.tool.w_mm"), "unknown perturbation 'tool.w_mm'"),
        (factor("as_built.tool.x"), "tool.x_mm"),
        (factor("as_built.tool.x_mm", "relative"), 'use mode = "additive"'),
        (factor("cell.part.x_mm", "relative"), "nominal value is 0"),
        (factor("as_built.sensor.laser.no_such_key"), "unknown key"),
        (factor("as_built.sensor.render.bounces"), "sensor.laser"),
        (factor("sensor.camera[3].tilt_deg"), "index \\[3\\] does not exist"),
        (factor("sensor.detector.bit_depth"), "whole number"),
        (factor("cell.part.fixture"), "is not a number"),
        (factor("cell.part.reflectance", "additive", 'kind = "uniform", low = -0.1, high = 0.9'), "less than or equal"),
        (discrete("cell.part.material.preset", '["matt_white", "chrome"]'), "chrome"),
        (OFFSET + OFFSET, "is given twice"),
        (factor("as_built.tool.x_mm", distribution='kind = "normal", std = -1'), "greater than or equal to 0.00"),
        (factor("as_built.tool.x_mm", distribution='kind = "uniform", low = 2, high = 1'), "must be below"),
        (discrete("as_built.tool.x_mm", '["far"]', "additive"), "is not a number"),
        ("", "nothing varies"),
    ],
)
def test_wrong_factors_are_refused_with_file_and_reason(tmp_path, factors, fragment) -> None:
    path = write_study(tmp_path, HEAD, DESIGN, factors)
    with pytest.raises(DescriptionError, match=fragment) as caught:
        open_study(path).factors.check(UNITS)
    assert "small.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("design", "fragment"),
    [
        ('[design]\nkind = "sobol"\ntrials = 100\n', "powers of 2"),
        ('[design]\nkind = "morris"\nlevels = 5\n', "even number"),
        ('[design]\nkind = "monte_carlo"\nquantiles = [0.9, 0.1]\n', "rising"),
        ('[design]\nkind = "guess"\n', "monte_carlo"),
        ('[design]\nkind = "monte_carlo"\ntrails = 5\n', "did you mean 'trials'"),
    ],
)
def test_wrong_designs_are_refused(tmp_path, design, fragment) -> None:
    with pytest.raises(DescriptionError, match=fragment):
        open_study(write_study(tmp_path, HEAD, design, OFFSET))


@pytest.mark.parametrize(
    ("block", "fragment"),
    [
        ("covariance = [[1, 2], [2, 1]]", "negative eigenvalues"),
        ("covariance = [[1, 0.5], [0.4, 1]]", "symmetric"),
        ("std = [1, 1]\ncorrelation = [[2, 0], [0, 2]]", "ones"),
        ("std = [1, 1]", "either covariance"),
        ("covariance = [[1, 0], [0, 1]]\nmean = [1]", "expected 2 numbers"),
    ],
)
def test_wrong_blocks_are_refused(tmp_path, block, fragment) -> None:
    text = f'[[block]]\npaths = ["as_built.tool.x_mm", "as_built.tool.y_mm"]\n{block}\n'
    with pytest.raises(DescriptionError, match=fragment):
        open_study(write_study(tmp_path, HEAD, DESIGN, text))


def test_indices_need_independent_factors(tmp_path) -> None:
    block = '[[block]]\npaths = ["as_built.tool.x_mm", "as_built.tool.y_mm"]\ncovariance = [[1, 0], [0, 1]]\n'
    with pytest.raises(DescriptionError, match="independent"):
        open_study(write_study(tmp_path, HEAD, '[design]\nkind = "sobol"\ntrials = 8\n', block))


def test_a_missing_part_is_named(tmp_path) -> None:
    with pytest.raises(DescriptionError, match=r"small\.toml: part = 'none\.stl'"):
        open_study(write_study(tmp_path, HEAD.split("part")[0], 'part = "none.stl"', DESIGN, OFFSET))


def test_trial_changes_only_what_its_factors_name(tmp_path) -> None:
    shiny = discrete("cell.part.material.preset", '["polished_steel"]')
    turned = factor("as_built.sensor.camera[1].tilt_deg")
    study = open_study(
        write_study(tmp_path, HEAD, 'as_built = ["tool.x_mm=0.3"]', DESIGN, OFFSET, GLOSS, shiny, turned)
    )
    found = study.factors.inputs([0.05, -0.1, "polished_steel", 0.2])
    nominal = study.setup
    assert found.setup.cell.part.reflectance == pytest.approx(0.9 * nominal.cell.part.reflectance)
    assert found.setup.cell.part.material.preset == "polished_steel"
    assert found.setup.sensor is nominal.sensor
    assert found.setup.scan is nominal.scan
    given = dict(word.split("=") for word in found.as_built)
    assert float(given["tool.x_mm"]) == pytest.approx(0.35)
    assert float(given["sensor.camera[1].tilt_deg"]) == pytest.approx(nominal.sensor.camera[0].tilt_deg + 0.2)


def test_common_noise_means_one_seed(tmp_path) -> None:
    path = write_study(tmp_path, HEAD, DESIGN, OFFSET)
    assert len({trial.seed for trial in open_study(path, ['noise="common"']).trials}) == 1


def test_trials_with_images_repeat_the_first_ones(tmp_path) -> None:
    trials = open_study(write_study(tmp_path, HEAD, "ray_traced_trials = 2", DESIGN, OFFSET)).trials
    assert [(t.number, t.engine) for t in trials[3:]] == [(4, "geometric"), (5, "ray-traced"), (6, "ray-traced")]
    assert [(t.seed, t.values) for t in trials[4:]] == [(t.seed, t.values) for t in trials[:2]]


def test_a_folder_is_begun_once_and_for_one_study(tmp_path) -> None:
    path, out = write_study(tmp_path, HEAD, DESIGN, OFFSET), tmp_path / "out"
    study = open_study(path)
    with pytest.raises(DescriptionError, match="no study was begun"):
        study.check_same(out)
    begin_new(study, out)
    study.check_same(out)
    with pytest.raises(OutputError, match="resume"):
        begin_new(study, out)
    study.begin(out)  # as the shards of a job array do, any of which may come first
    with pytest.raises(DescriptionError, match=r"study\.seed was 0, is 9"):
        open_study(path, ["seed=9"]).check_same(out)


SOBOL = '[design]\nkind = "sobol"\ntrials = 4\n'
LATIN = '[design]\nkind = "latin_hypercube"\ntrials = 4\n'


@pytest.mark.parametrize("design", [DESIGN, SOBOL], ids=["monte_carlo", "sobol"])
def test_study_with_more_trials_keeps_finished_tasks(tmp_path, design) -> None:
    path, out = write_study(tmp_path, HEAD, design, OFFSET, GLOSS), tmp_path / "out"
    short, long = open_study(path), open_study(path, ["design.trials=8"])
    short.begin(out)
    assert not long.check_same(out).warnings
    digests = [[study.job(out).digest_of_task(task) for task in study.tasks] for study in (short, long)]
    assert digests[1][: len(digests[0])] == digests[0]
    assert len(digests[1]) == 2 * len(digests[0])
    assert long.spec["study"]["design"]["trials"] == 8


def test_study_with_more_trials_is_refused_if_its_points_move(tmp_path) -> None:
    path, out = write_study(tmp_path, HEAD, LATIN, OFFSET), tmp_path / "out"
    open_study(path).begin(out)
    with pytest.raises(DescriptionError, match=r"trials was 4, is 8 .*only monte_carlo and sobol .*latin_hypercube"):
        open_study(path, ["design.trials=8"]).check_same(out)
