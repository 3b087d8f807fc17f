"""Write `slow.txt`, the tests that `make test` leaves out, from the times of a run of all tests.

``make test-all`` writes the times (``build/tests.xml``), then: ``python tests/slow_tests.py build/tests.xml``.

A case is kept that takes less than `_CASE` seconds, and of each function the shortest one that takes less than
`_FUNCTION`, and of each file the shortest one that takes less than `_FILE`.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

_CASE, _FUNCTION, _FILE = 1.5, 4.0, 15.0  # s
_HEAD = """\
# Tests that `make test` leaves out and `make test-all` runs: cases and whole functions that take long, by their
# identifiers. Made by tests/slow_tests.py, which states the rule.
"""


def left_out(times: dict[str, float]) -> list[str]:
    """Identifiers of the tests that are left out, where all cases of a function are: of the function."""
    functions: defaultdict[str, list[str]] = defaultdict(list)
    files: defaultdict[str, list[str]] = defaultdict(list)
    for name in times:
        functions[name.partition("[")[0]].append(name)
        files[name.partition("::")[0]].append(name)
    kept = {name for name, time in times.items() if time < _CASE}
    for cases in functions.values():
        kept |= _shortest(cases, kept, times, _FUNCTION)
    for cases in files.values():
        kept |= _shortest(cases, kept, times, _FILE)
    return sorted(
        line
        for function, cases in functions.items()
        for line in ([function] if not kept & {*cases} else [name for name in cases if name not in kept])
    )


def _shortest(cases: list[str], kept: set[str], times: dict[str, float], limit: float) -> set[str]:
    """The shortest case if none is kept and it takes less than `limit`."""
    one = min(cases, key=times.__getitem__)
    return {one} if times[one] < limit and not kept & {*cases} else set()


def read_times(file: Path) -> dict[str, float]:
    """Seconds of each test of a report of JUnit's format."""
    cases: Iterable[ElementTree.Element] = ElementTree.parse(file).iter("testcase")
    return {
        f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}": float(case.attrib["time"])
        for case in cases
    }


if __name__ == "__main__":
    lines = left_out(read_times(Path(sys.argv[1])))
    Path(__file__).with_name("slow.txt").write_text(_HEAD + "\n".join(lines) + "\n")
