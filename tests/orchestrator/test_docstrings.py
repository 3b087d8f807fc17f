"""Docstrings of the public names: examples that run, and a word on every parameter."""

from __future__ import annotations

import doctest
import inspect
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import scancell

ROOT = Path(__file__).resolve().parents[2]
OBJECTS = {name: getattr(scancell, name) for name in scancell.__all__ if not isinstance(getattr(scancell, name), float)}
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def examples(name: str) -> list[doctest.DocTest]:
    """Doctests of a public name and its methods, which begin with ``import scancell`` and ``numpy as np``."""
    value = OBJECTS[name]
    module = value if inspect.ismodule(value) else sys.modules[value.__module__]
    found = doctest.DocTestFinder().find(value, name, module=module, globs={"scancell": scancell, "np": np})
    return [one for one in found if one.examples]


@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder with a part, ``part.stl``."""
    shutil.copy(ROOT / "assets" / "parts" / "step_block.stl", tmp_path / "part.stl")
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    tests = examples(name)
    assert tests, f"{name}: expected an example in its docstring"
    for one in tests:
        doctest.DocTestRunner(optionflags=FLAGS).run(one, out=said.append)
    assert not said, "".join(said)
