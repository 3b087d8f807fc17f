"""Scans that several tests look at, made once."""

from __future__ import annotations

from functools import cache

import pytest
from line import OFF_AXIS, Line, make_line

# Parts of the accuracy claims, with their place on the table.
PLACED = {"sphere_on_foot": (OFF_AXIS,), "free_form": ()}


@cache
def _planned(part: str, words: tuple[str, ...], ideal: bool) -> Line:
    return make_line(part, *PLACED[part], *words, ideal=ideal)


@pytest.fixture(scope="session")
def planned():
    """`planned(part, *overrides, ideal=True)`: the line for a part, planned once for the session."""

    def get(part: str, *words: str, ideal: bool = True) -> Line:
        return _planned(part, words, ideal)

    return get
