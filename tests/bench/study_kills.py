"""`python -m bench.study_kills` (in tests/): studies killed at random moments and resumed, as a table in docs/.

Each attempt starts the same small study, kills a worker, the scheduler or the command with SIGKILL at a random moment
of an undisturbed run's length, resumes where that was not enough to finish, and compares every row with the
undisturbed run's, byte by byte.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil
import pyarrow.parquet

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "system")]

from commands import COMMAND, environment  # noqa: E402

from studies_files import GLOSS, HEAD, OFFSET, write_study  # noqa: E402

from .table import cpu_model, replace_paragraphs  # noqa: E402

TRIALS = 12
VICTIMS = ("worker", "command", "scheduler")
PATIENCE_S = 300
_SCHEDULER = "from distributed.cli.dask_scheduler import main; main()"
_WORKER = "from distributed.cli.dask_worker import main; main()"


@dataclass(frozen=True)
class Attempt:
    """What was killed when, how far the study was then, what the command said, and how it ended after resuming."""

    victim: str
    moment_s: float
    finished_before: int
    exit_code: int
    partials: int
    identical: bool

    def line(self) -> str:
        """A row of the table."""
        code = "killed" if self.exit_code == -signal.SIGKILL else self.exit_code
        same = "yes" if self.identical else "NO"
        return f"| {self.victim} | {self.moment_s:.1f} | {self.finished_before} | {code} | {self.partials} | {same} |"


class Campaign:
    """The same study again and again in `folder`, each time in a folder of its own."""

    def __init__(self, folder: Path, trials: int = TRIALS) -> None:
        self.folder, self.trials = folder, trials
        design = f'[design]\nkind = "monte_carlo"\ntrials = {trials}\n'
        self.study = write_study(folder, HEAD, design, OFFSET, GLOSS)
        start = time.monotonic()
        self._finish(self._start("run", "undisturbed"))
        self.length_s = time.monotonic() - start
        self.expected = self._rows("undisturbed")

    def attempt(self, victim: str, moment_s: float, trials: int = 0) -> Attempt:
        """Kill `victim` so long after the start and with so many trials finished, resume if need be, and compare."""
        name = f"{victim}-{moment_s:.3f}-{trials}"
        with self._cluster() if victim == "scheduler" else contextlib.nullcontext() as scheduler:
            words = ("--scheduler", scheduler[0]) if scheduler else ()
            command = self._start("run", name, *words)
            time.sleep(moment_s)
            while (finished := len(self._finished(name))) < trials and command.poll() is None:
                time.sleep(0.01)
            if victim == "command":
                command.kill()
            elif scheduler:
                scheduler[1].kill()
            else:
                self._kill_a_worker(command)
            code = command.wait(PATIENCE_S)
        partials = len(list((self.folder / name / "tasks").glob("*.partial")))
        if not (self.folder / name / "results.parquet").exists():
            # Killed before it had claimed its folder, it has to be run anew.
            begun = (self.folder / name / "description.json").exists()
            self._finish(self._start("resume" if begun else "run", name))
        same = self._rows(name) == self.expected and len(self._finished(name)) == self.trials
        same = same and not list((self.folder / name / "tasks").glob(".*"))
        shutil.rmtree(self.folder / name)
        return Attempt(victim, moment_s, finished, code, partials, same)

    def _start(self, verb: str, name: str, *words: str) -> subprocess.Popen[bytes]:
        given = ["study", verb, str(self.study), "--out", str(self.folder / name), *(words or ("--workers", "2"))]
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen([*COMMAND, *given], env=environment(), stdout=log, stderr=log)

    @staticmethod
    def _finish(command: subprocess.Popen[bytes]) -> None:
        code = command.wait(PATIENCE_S)
        if code:
            raise RuntimeError(f"{command.args} ended with {code}")

    @staticmethod
    def _kill_a_worker(command: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(psutil.NoSuchProcess):
            children = psutil.Process(command.pid).children(recursive=True)
            workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
            if workers:
                random.choice(workers).kill()

    def _finished(self, name: str) -> list[Path]:
        return sorted((self.folder / name / "tasks").glob("trial-*"))

    def _rows(self, name: str) -> tuple[bytes, ...]:
        """The results table and the rows of each task, as bytes."""
        rows = [(task / "rows.json").read_bytes() for task in self._finished(name)]
        table = self.folder / name / "results.parquet"
        assert pyarrow.parquet.read_table(table).num_rows == self.trials
        return (table.read_bytes(), *rows)

    @contextlib.contextmanager
    def _cluster(self) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
        """A scheduler and two workers in processes of their own, as on a cluster."""
        with tempfile.TemporaryDirectory(dir=self.folder) as folder, (Path(folder) / "log").open("ab") as log:
            file = Path(folder) / "scheduler.json"

            def start(code: str, *words: str) -> subprocess.Popen[bytes]:
                command = [sys.executable, "-c", code, "--scheduler-file", str(file), *words]
                return subprocess.Popen(command, env=environment(), stdout=log, stderr=log, cwd=folder)

            common = ("--host", "127.0.0.1", "--no-dashboard")
            scheduler = start(_SCHEDULER, *common, "--port", "0")
            workers = [start(_WORKER, *common, "--nthreads", "1", "--no-nanny") for _ in range(2)]
            try:
                yield self._address(file), scheduler
            finally:
                for process in (scheduler, *workers):
                    process.kill()
                    process.wait()

    @staticmethod
    def _address(file: Path) -> str:
        end = time.monotonic() + PATIENCE_S
        while not file.exists():
            if time.monotonic() > end:
                raise TimeoutError("the scheduler does not start")
            time.sleep(0.1)
        return str(json.loads(file.read_text())["address"])


def campaign(kills: int, seed: int) -> Iterator[tuple[Attempt, float]]:
    """Attempts with the victims in turn, each with the seconds of an undisturbed run."""
    moments = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="scancell-kills-") as folder:
        study = Campaign(Path(folder))
        for k in range(kills):
            yield study.attempt(VICTIMS[k % 3], moments.uniform(0.05, 0.95) * study.length_s), study.length_s


def write_page(file: Path, attempts: Sequence[Attempt], length_s: float) -> None:
    """Replace the figures of docs/study_kills.md."""
    good = sum(attempt.identical for attempt in attempts)
    command = f"`PYTHONPATH=tests python -m bench.study_kills --kills {len(attempts)}`"
    written = [
        f"Written by {command} on {cpu_model()},",
        f"load {os.getloadavg()[0]:.0f}; a study of {TRIALS} scans on two workers takes {length_s:.0f} s"
        " without kills.",
    ]
    table = [
        "| killed | after s | finished trials | exit code | incomplete folders | identical after resume |",
        "|---|---|---|---|---|---|",
        *(attempt.line() for attempt in attempts),
    ]
    identical = f"**{good} of {len(attempts)} identical.**"
    replace_paragraphs(file, {"Written by": written, "**": [identical], "| killed": table})


def main() -> None:
    """Kill, resume, compare, and write after each attempt."""
    parser = argparse.ArgumentParser(prog="python -m bench.study_kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=21)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--page", type=Path, default=Path("docs/study_kills.md"))
    options = parser.parse_args()
    attempts: list[Attempt] = []
    for attempt, length_s in campaign(options.kills, options.seed):
        attempts.append(attempt)
        print(attempt.line(), flush=True)
        write_page(options.page, attempts, length_s)
    if not all(attempt.identical for attempt in attempts):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
