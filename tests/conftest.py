"""Cache and order of the tests when several processes share them, and a table of the slowest files."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections import Counter, OrderedDict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from threading import Lock

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

_SECONDS: Counter[str] = Counter()
_COLLECTED: set[str] = set()
_ROOT = Path(__file__).parents[1]

LISTED = {
    mark: {line for line in (_ROOT / f"tests/{mark}.txt").read_text().splitlines() if line.startswith("tests/")}
    for mark in ("slow", "campaign")
}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slowest-files", type=int, default=0, metavar="N", help="print the N slowest test files")


def pytest_configure(config: pytest.Config) -> None:
    """A cache of the tests' own for what `scancell` keeps between scans, which the processes of one run share.

    Each of them has a core: threads of the linear algebra, whose matrices are small, would only wait for each other.
    """
    if not hasattr(config, "workerinput"):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        os.environ["SCANCELL_CACHE"] = tempfile.mkdtemp(prefix="scancell-cache-")


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove it."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ["SCANCELL_CACHE"], ignore_errors=True)


def pytest_itemcollected(item: pytest.Item) -> None:
    names = {item.nodeid, item.nodeid.partition("[")[0]}
    _COLLECTED.update(names)
    for mark, listed in LISTED.items():
        if names & listed:
            item.add_marker(mark)


@pytest.fixture(scope="session", autouse=True)
def plans_are_shared() -> Iterator[None]:
    """Keep plans from one scanner to the next: they are found by a digest of all their inputs."""
    from scancell.scanning import pipeline  # noqa: PLC0415

    plans: OrderedDict[str, pipeline.Plan] = OrderedDict()
    planning = Lock()

    class SharedPlans(pipeline.ScanPipeline):
        def __init__(self, threads: int = 0) -> None:
            super().__init__(threads)
            self._plans, self._planning = plans, planning

        def close(self) -> None:
            self._plans = OrderedDict()
            super().close()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scancell.scanner.ScanPipeline", SharedPlans)
        yield


@cache
def _group(file: str) -> str:
    """Tests of a group share a process: those of a file, and all that have a browser, which runs once at a time."""
    return "browser" if "from chromium import" in (_ROOT / file).read_text() else file


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files first, so that no process is left alone with one of them at the end.

    Those with a browser, one group, come before all.
    """
    if not any("::" in argument for argument in config.args):
        files = {_file(name) for name in _COLLECTED}
        for mark, listed in LISTED.items():
            if missing := sorted(name for name in listed - _COLLECTED if _file(name) in files):
                raise pytest.UsageError(f"tests/{mark}.txt: no such tests: {', '.join(missing)}")
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: (_group(_file(item.nodeid)) != "browser", item.path.parent.name != "system"))


class GroupScheduling(LoadScopeScheduling):
    """A group of files to a process; pytest-xdist's own groups are lost with pytest 9.2."""

    def _split_scope(self, nodeid: str) -> str:
        return _group(_file(nodeid))


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> GroupScheduling:
    return GroupScheduling(config, log)


def _file(nodeid: str) -> str:
    return nodeid.partition("::")[0]


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _SECONDS[_file(report.nodeid)] += report.duration


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    count = config.getoption("--slowest-files")
    if not count:
        return
    terminalreporter.section(f"slowest {count} test files")
    for file, seconds in _SECONDS.most_common(count):
        terminalreporter.write_line(f"{seconds:8.1f} s  {file}")
    terminalreporter.write_line(f"{sum(_SECONDS.values()):8.1f} s  all {len(_SECONDS)} files")
