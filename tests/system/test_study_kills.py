"""A study that is killed loses nothing; `python -m bench.study_kills` does the same more often."""

from __future__ import annotations

import random

import pytest

from bench.study_kills import VICTIMS, Campaign

TRIALS = 6


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return Campaign(tmp_path_factory.mktemp("kills"), TRIALS)


@pytest.mark.parametrize("victim", VICTIMS)
def test_killed_study_resumes_identically(campaign, victim) -> None:
    # By what is finished, for a neighbour's load changes how long that takes.
    trials = random.Random(VICTIMS.index(victim)).randint(TRIALS // 4, 3 * TRIALS // 4)
    attempt = campaign.attempt(victim, 0.0, trials)
    print(attempt.line())
    assert trials <= attempt.finished_before < TRIALS
    assert attempt.identical
    if victim == "scheduler":
        assert attempt.exit_code == 1, "the command says that the scheduler is gone"
