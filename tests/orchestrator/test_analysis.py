"""The analysis and the report of a study's rows, made here instead of by scans."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from scancell.config.description import validate
from scancell.config.study import StudyDescription
from scancell.studies.analysis import analyse
from scancell.studies.factors import design
from scancell.studies.page import study_answers, study_page
from scancell.studies.report import StudyReport
from scancell.studies.study import Collected

NAMES = ["a", "b & <b>", "c"]


def study_of(kind: str, trials: int) -> StudyDescription:
    distribution = {"kind": "uniform", "low": 0, "high": 1}
    factors = [{"path": f"cell.{n}", "name": name, "distribution": distribution} for n, name in enumerate(NAMES)]
    plain = {"name": "<script>", "part": "x.stl", "design": {"kind": kind, "trials": trials}, "factor": factors}
    return validate(StudyDescription, plain, "test")


def rows_of(study: StudyDescription, failed: tuple[int, ...] = ()) -> list[dict]:
    values = design(study.design, [None] * 3, study.seed)
    noise = np.random.default_rng(0).standard_normal(len(values))
    outputs = values @ [3.0, 4.0, 0.0] + 0.05 * noise
    return [
        {
            "number": n,
            "seed": n,
            "engine": "geometric",
            "values": point.tolist(),
            "status": "failed" if n in failed else "ok",
            "message": "<i>broken</i>" if n in failed else "",
            "figures": {} if n in failed else {"points": 5, "rms_um": output},
        }
        for n, (point, output) in enumerate(zip(values, outputs, strict=True), 1)
    ]


@pytest.mark.parametrize(("kind", "trials"), [("monte_carlo", 200), ("latin_hypercube", 60), ("sobol", 32)])
def test_budget_adds_up_and_names_the_main_contributor(kind, trials) -> None:
    study = study_of(kind, trials)
    found = analyse(study, NAMES, rows_of(study, failed=(3,)))
    rms = found["engines"]["geometric"]["sensitivity"]["rms_um"]
    assert [row["factor"] for row in rms["budget"]][:2] == ["b & <b>", "a"]
    assert rms["budget"][0]["share"] == pytest.approx(0.64, abs=0.1)
    assert sum(row["share"] for row in rms["budget"]) + rms["unexplained"] == pytest.approx(1)
    assert found["engines"]["geometric"]["undetected"] == ["c"]
    assert found["notes"] == []
    for row in rms["budget"]:
        for key in ("share", "uncertainty"):
            low, high = row[f"{key}_interval"]
            assert 0 <= low <= row[key] <= high
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize("kind", ["monte_carlo", "morris", "one_at_a_time"])
def test_command_states_the_interval_of_every_share_and_uncertainty_that_it_prints(kind) -> None:
    study = study_of(kind, 40)
    rows = rows_of(study)
    lines = StudyReport(analyse(study, NAMES, rows), Collected(rows, [], []), []).summary().splitlines()
    (line,) = (line for line in lines if line.split()[0] == "b")
    number = r"[\d.e+-]+"
    if kind == "morris":
        assert re.search(rf"mean magnitude of the effect {number} \+- {number}$", line)
    else:
        percent = rf"{number}%"
        expected = rf"{percent} \[{percent}, {percent}\] of the variance, uncertainty {number} \[{number}, {number}\]$"
        assert re.search(expected, line)


def test_few_trials_are_noted() -> None:
    study = study_of("monte_carlo", 12)
    notes = analyse(study, NAMES, rows_of(study))["notes"]
    assert notes[0] == "12 trials for 3 factors: too few for reliable shares; 30 or more are recommended"


def test_unsettled_ranking_is_noted() -> None:
    study = study_of("monte_carlo", 40)
    rows = rows_of(study)
    for row, noise in zip(rows, np.random.default_rng(1).standard_normal(len(rows)), strict=True):
        row["figures"]["rms_um"] = noise
    (note,) = analyse(study, NAMES, rows)["notes"]
    assert note == "the interval of the largest share is wider than the share itself: rms_um"


@pytest.mark.parametrize("kind", ["monte_carlo", "sobol", "morris", "one_at_a_time", "full_factorial"])
def test_page_escapes_text_and_lists_every_factor_and_the_rest(kind) -> None:
    study = study_of(kind, 8)
    rows = rows_of(study, failed=(2,))
    page = study_page(analyse(study, NAMES, rows), rows, {"study": "<file>"})
    text = re.sub("<svg.*?</svg>", "", page, flags=re.DOTALL)
    assert page.count("<svg") >= 2
    assert "<script>" not in page
    assert "<td>b &amp; &lt;b&gt;</td>" in text
    assert "<td>&lt;i&gt;broken&lt;/i&gt;</td>" in text
    assert "<td>&lt;file&gt;</td>" in text
    assert "unexplained (noise" in text or kind in {"morris", "one_at_a_time"}


@pytest.mark.parametrize("kind", ["monte_carlo", "sobol", "morris", "one_at_a_time"])
def test_page_opens_with_the_factor_that_matters(kind) -> None:
    """The second factor has the largest effect, the third none."""
    study = study_of(kind, 64)
    analysis = analyse(study, NAMES, rows_of(study))
    page = study_page(analysis, rows_of(study), {})
    answer = re.search(r'<p class="answer">(.*?)</p>', page, re.DOTALL)[1]
    assert page.index('class="answer"') < page.index("<h2>")
    order = [answer.find(name) for name in ("b &amp; &lt;b&gt;:", " a:", " c:")]
    assert 0 < order[0] < order[1]
    assert order[2] == -1 or (kind in {"morris", "one_at_a_time"} and order[1] < order[2])  # noise has an effect, too
    if kind == "monte_carlo":
        found = analysis["engines"]["geometric"]["sensitivity"]["rms_um"]["budget"][0]
        assert f"{100 * found['share']:.0f} % of the variance" in answer


def test_answer_says_that_no_factor_matters() -> None:
    study = study_of("monte_carlo", 60)
    rows = rows_of(study)
    for row, noise in zip(rows, np.random.default_rng(3).standard_normal(len(rows)), strict=True):
        row["figures"]["rms_um"] = noise
    ((name, _, words),) = study_answers(analyse(study, NAMES, rows))
    assert name == "rms_um"
    assert words == "no factor has a detectable share of the variance"
