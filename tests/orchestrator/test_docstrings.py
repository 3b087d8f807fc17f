"""Docstrings of the public names: examples that run, and a word on every parameter."""

from __future__ import annotations

import doctest
import enum
import inspect
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import suppress
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

import scancell
import scancell.scanner
from scancell.config.description import Description
from scancell.scanning.pipeline import ScanPipeline

ROOT = Path(__file__).resolve().parents[2]
OBJECTS = {name: getattr(scancell, name) for name in scancell.__all__ if not isinstance(getattr(scancell, name), float)}
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def examples(name: str) -> list[doctest.DocTest]:
    """Doctests of a public name and its methods, which begin with ``import scancell`` and ``numpy as np``."""
    value = OBJECTS[name]
    module = value if inspect.ismodule(value) else sys.modules[value.__module__]
    found = doctest.DocTestFinder().find(value, name, module=module, globs={"scancell": scancell, "np": np})
    return [one for one in found if one.examples]


class SharedPipeline(ScanPipeline):
    """Keeps plans and the simulated cell from one example to the next."""

    def close(self) -> None:
        """Nothing: others go on."""


@pytest.fixture(scope="module")
def pipeline() -> Iterator[ScanPipeline]:
    shared = SharedPipeline()
    yield shared
    ScanPipeline.close(shared)


@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_examples_run(name: str, pipeline: ScanPipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder with a part, ``part.stl``."""
    monkeypatch.setattr(scancell.scanner, "ScanPipeline", lambda _: pipeline)
    shutil.copy(ROOT / "assets" / "parts" / "step_block.stl", tmp_path / "part.stl")
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    tests = examples(name)
    if other := re.search(r"See the example of `(\w+)`", OBJECTS[name].__doc__ or ""):
        assert examples(other.group(1))
        return
    assert tests, f"{name}: expected an example in its docstring"
    for one in tests:
        doctest.DocTestRunner(optionflags=FLAGS).run(one, out=said.append)
    assert not said, "".join(said)


def members(name: str) -> dict[str, object]:
    """A public function, or a class with its public methods, by name."""
    value = OBJECTS[name]
    found: dict[str, object] = {name: value}
    if inspect.isclass(value) and not issubclass(value, (Exception, enum.Enum, Description)):
        for key in (key for key in dir(value) if not key.startswith("_")):
            member = inspect.getattr_static(value, key)
            function = getattr(member, "__func__", member)
            if inspect.isfunction(function):
                found[f"{name}.{key}"] = function
    return found


def stated(docstring: str, depth: int = 2) -> str:
    """A docstring with those of the public names that it refers to."""
    parts = [docstring]
    for word in re.findall(r"`([A-Za-z][\w.]*)`", docstring) if depth else []:
        with suppress(AttributeError):
            parts.append(stated(inspect.getdoc(attrgetter(word)(scancell)) or "", depth - 1))
    return "\n".join(parts)


def parameters(value: object) -> set[str]:
    """Names of the parameters of a function or constructor, options that are passed on left out."""
    try:
        found = inspect.signature(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return set()
    kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return {name for name, one in found.parameters.items() if one.kind not in kinds and name not in ("self", "cls")}


@pytest.mark.parametrize("name", sorted(name for name, value in OBJECTS.items() if callable(value)))
def test_parameters_are_explained(name: str) -> None:
    """In the docstring, or in that of a public name that it refers to."""
    if isinstance(OBJECTS[name], type) and issubclass(OBJECTS[name], (Exception, enum.Enum, Description)):
        return
    unexplained = {}
    for key, value in members(name).items():
        text = stated(inspect.getdoc(value) or "")
        if missing := [one for one in sorted(parameters(value)) if not re.search(rf"\b{one}\b", text)]:
            unexplained[key] = missing
    assert not unexplained
