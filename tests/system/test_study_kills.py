"""A study that is killed loses nothing; `python -m bench.study_kills` does the same more often."""

from __future__ import annotations

import random

import pytest
from bench.study_kills import VICTIMS, Campaign


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return Campaign(tmp_path_factory.mktemp("kills"))


@pytest.mark.parametrize("victim", VICTIMS)
def test_a_killed_study_resumes_to_the_same_bytes(campaign, victim) -> None:
    moment = random.Random(VICTIMS.index(victim)).uniform(0.3, 0.8) * campaign.length_s
    attempt = campaign.attempt(victim, moment)
    print(attempt.line())
    assert attempt.identical
    if victim == "scheduler":
        assert attempt.exit_code == 1, "the command says that the scheduler is gone"
