"""Mutants, one operator of the product changed at a time: ``python -m bench.mutants [--language C++]``.

PYTHONPATH=tests. A mutant is killed if a test fails or does not end. A mutant in Python meets the tests in the file
named after its module, then those in files that import the module, or its folder if there are none; one in C++ meets
the native tests, then the Python tests named after its file, those named after its folder, and the others of `fmu` or
`sensor_rt`. The tests that only `make campaign` runs meet the survivors, for the table to state what is lost without
them. The checkout must be without changes; each file is put back.
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
import sys
import sysconfig
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / "orchestrator" / "scancell"
CPP = ("fmu", "sensor_rt")
CHANGED = {
    **{"+": "-", "-": "+", "*": "/", "/": "*", "//": "/", "%": "*", "**": "*", "@": "*"},
    **{"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="},
    **{
        "and": "or",
        "or": "and",
        "&&": "||",
        "||": "&&",
        "is": "is not",
        "is not": "is",
        "in": "not in",
        "not in": "in",
    },
}
_ENDLESS = 600.0  # s of a file of tests, or of the native ones: they do not end
_USAGE, _NO_TESTS = 4, 5  # status of pytest that refuses its arguments, and that collects no test
_BINARY = re.compile(r"(?<= )(\+|-|\*|/|%|<|<=|>|>=|==|!=|&&|\|\|)(?= )")  # clang-format puts no space inside `int*`
_IMPORT = re.compile(r"^\s*(?:from (scancell[\w.]*) import|import (scancell[\w.]*))", re.MULTILINE)


@dataclass(frozen=True)
class Mutant:
    """An operator at a place (offset in the text of a file) and what stands there instead."""

    path: Path
    offset: int
    operator: str

    def text(self) -> str:
        """Of the changed file."""
        text = self.path.read_text()
        end = self.offset + len(self.operator)
        return text[: self.offset] + CHANGED[self.operator] + text[end:]

    def __str__(self) -> str:
        line = self.path.read_text().count("\n", 0, self.offset) + 1
        return f"{self.path.relative_to(ROOT)}:{line}: {self.operator} -> {CHANGED[self.operator]}"


def python_mutants(path: Path) -> Iterator[Mutant]:
    """Of a file in Python: arithmetic, comparisons, and logic."""
    text = path.read_text()
    starts = np.cumsum([0, *(len(line) for line in text.splitlines(keepends=True))])
    encoded = [line.encode() for line in text.splitlines(keepends=True)]

    def offset(line: int, column: int) -> int:
        return int(starts[line - 1]) + len(encoded[line - 1][:column].decode())

    def between(left: ast.expr, right: ast.expr) -> Iterator[Mutant]:
        assert left.end_lineno is not None
        assert left.end_col_offset is not None
        begin = offset(left.end_lineno, left.end_col_offset)
        gap = re.sub(r"#.*", lambda found: " " * len(found[0]), text[begin : offset(right.lineno, right.col_offset)])
        found = re.search(r"not in|is not|\b(?:and|or|is|in)\b|\*\*|//|[<>=!]=|[-+*/%@<>]", gap)
        if found:
            yield Mutant(path, begin + found.start(), found[0])

    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.BinOp) and not isinstance(node.op, ast.BitOr | ast.BitAnd):
            yield from between(node.left, node.right)
        elif isinstance(node, ast.Compare):
            for left, right in zip([node.left, *node.comparators], node.comparators, strict=False):
                yield from between(left, right)
        elif isinstance(node, ast.BoolOp):
            for left, right in zip(node.values, node.values[1:], strict=False):
                yield from between(left, right)


def cpp_mutants(path: Path) -> Iterator[Mutant]:
    """Of a file in C++: binary operators outside comments, texts and preprocessor lines."""
    start = 0
    for line in path.read_text().splitlines(keepends=True):
        code = re.sub(r'"(?:\\.|[^"\\])*"', lambda found: "_" * len(found[0]), line.partition("//")[0])
        if not code.lstrip().startswith(("#", "*", "template")):
            for found in _BINARY.finditer(code):
                yield Mutant(path, start + found.start(), found[0])
        start += len(line)


def all_mutants(language: str) -> list[Mutant]:
    """Of all product code in a language, in a fixed order."""
    if language == "Python":
        return [one for path in sorted(PYTHON.rglob("*.py")) for one in python_mutants(path)]
    sources = [
        path for folder in CPP for path in sorted((ROOT / folder).rglob("*.[ch]*")) if path.suffix in (".cpp", ".h")
    ]
    return [one for path in sources if "third_party" not in path.parts for one in cpp_mutants(path)]


def python_tests(path: Path) -> list[Path]:
    """Test files for a module, the most particular ones first."""
    module = ".".join(("scancell", *path.relative_to(PYTHON).with_suffix("").parts)).removesuffix(".__init__")
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    named = [file for file in files if file.stem == f"test_{path.stem}"]

    def imports(file: Path) -> set[str]:
        return {one or other for one, other in _IMPORT.findall(file.read_text())}

    importing = [file for file in files if module in imports(file)]
    if not named + importing:
        package = module.rpartition(".")[0]
        importing = [file for file in files if any(name.startswith(package) for name in imports(file))]
    return list(dict.fromkeys(named + importing))


def cpp_tests(path: Path) -> list[Path]:
    """Python test files for a file in C++, the most particular ones first."""
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    named = [file for word in (path.stem, path.parent.name) for file in files if word in file.stem]
    others = [file for file in files if file.parent.name == path.relative_to(ROOT).parts[0]]
    return list(dict.fromkeys(named + others))


def succeeds(command: list[str], limit: float) -> bool:
    """Whether no test of a command fails within a time, s."""
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, check=False, timeout=limit)
    except subprocess.TimeoutExpired:
        return False
    if done.returncode == _USAGE and b"conftest" not in done.stderr:  # a mutant can fail where conftest imports it
        raise RuntimeError(f"pytest refuses its arguments: {' '.join(command)}")
    return done.returncode in (0, _NO_TESTS)


def builds() -> bool:
    """Whether the native code compiles, and is installed for Python; a mutant that does not compile is none."""
    folder = str(next((ROOT / "build").glob("cp3*")))
    # The prefix of the build itself is a temporary folder of pip.
    install = ["cmake", "--install", folder, "--prefix", sysconfig.get_path("platlib")]
    return succeeds(["cmake", "--build", folder], 3600.0) and succeeds(install, 3600.0)


def is_killed(files: list[Path], limit: float, marked: str) -> bool:
    """Whether a test of the files with the mark fails, in the files that are begun within a time, s."""
    pytest = [sys.executable, "-m", "pytest", "-q", "-x", "-n0", "-p", "no:cacheprovider", "-m", marked]
    end = time.monotonic() + limit
    for file in files:
        if time.monotonic() > end:
            return False
        if not succeeds([*pytest, str(file)], _ENDLESS):
            return True
    return False


def fate(mutant: Mutant, limit: float) -> str:
    """``killed``, ``survived``, or ``campaign`` if only tests of `make campaign` kill it."""
    if mutant.path.suffix == ".py":
        files = python_tests(mutant.path)
    else:
        folder = next((ROOT / "build").glob("cp3*"))
        if not succeeds(["ctest", "--test-dir", str(folder), "-j2", "--stop-on-failure"], _ENDLESS):
            return "killed"
        files = cpp_tests(mutant.path)
    if is_killed(files, limit, "not campaign"):
        return "killed"
    return "campaign" if is_killed(files, limit, "campaign") else "survived"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.mutants", description=__doc__)
    parser.add_argument("--language", choices=("Python", "C++"), default="Python")
    parser.add_argument("--count", type=int, default=0, help="0: 200 in Python, 60 in C++")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--limit", type=float, default=150.0, help="s of a mutant's tests, then no further file is begun"
    )
    options = parser.parse_args()
    if subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, check=True).stdout:
        sys.exit("the checkout has changes: commit them first")
    count = options.count or {"Python": 200, "C++": 60}[options.language]
    sites = all_mutants(options.language)
    fates = Counter[str]()
    for index in np.random.default_rng(options.seed).permutation(len(sites)):
        if fates.total() == count:
            break
        mutant = sites[index]
        name, original = str(mutant), mutant.path.read_bytes()
        try:
            mutant.path.write_text(mutant.text())
            if options.language == "C++" and not builds():
                continue
            found = fate(mutant, options.limit)
        finally:
            mutant.path.write_bytes(original)
        fates[found] += 1
        print(f"{found}  {name}", flush=True)
    if options.language == "C++":
        builds()
    print(f"{dict(fates)} of {len(sites)} places")


if __name__ == "__main__":
    main()
