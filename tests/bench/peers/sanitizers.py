"""The native cell under sanitizers: ``PYTHONPATH=.:tests python -m bench.peers.sanitizers``.

Builds the C++ tests, the call fuzzer and the parallel instances twice (AddressSanitizer with leak search and
UndefinedBehaviorSanitizer; ThreadSanitizer) and runs them all. The engine's libraries are those of the system, without
instrumentation: what is found is found in the cell's own code, and in what it hands to them.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .check import Check, write_table

_ROOT = Path(__file__).parents[3]
_CELLS = sorted((_ROOT / "tests/fmu/cells").iterdir())
_TARGETS = ("fmu_tests", "robotcell-fuzz", "robotcell-parallel")
_FINDING = re.compile(r"(ERROR|WARNING): (Address|Leak|Thread)Sanitizer|runtime error: ")


@dataclass(frozen=True)
class Sanitizer:
    """A build: name, value of SCANCELL_SANITIZE."""

    name: str
    flags: str

    @property
    def folder(self) -> Path:
        return _ROOT / "build" / f"sanitize-{self.flags.replace(',', '-')}"


SANITIZERS = (Sanitizer("Address and UndefinedBehavior", "address,undefined"), Sanitizer("Thread", "thread"))


def build(sanitizer: Sanitizer, jobs: int) -> Path:
    """Folder with the programs."""
    options = [f"-DSCANCELL_SANITIZE={sanitizer.flags}", "-DSCANCELL_TESTS=ON"]
    options += ["-DSCANCELL_SENSOR_RT=OFF", "-DSCANCELL_PROXIMITY=OFF"]
    # A little optimisation: without it the tests take too long, with all of it the compiler does.
    options += ["-DCMAKE_BUILD_TYPE=None", "-DCMAKE_CXX_FLAGS=-O1 -g1", f"-DPython3_EXECUTABLE={sys.executable}"]
    commands: list[list[str | Path]] = [
        ["cmake", "-S", _ROOT, "-B", sanitizer.folder, *options],
        ["cmake", "--build", sanitizer.folder, "--parallel", str(jobs), "--target", *_TARGETS],
    ]
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError((done.stdout + done.stderr)[-4000:])
    return sanitizer.folder / "tests/fmu"


def findings(program: Path, *arguments: str | Path) -> tuple[int, str]:
    """Number of reports in a run, and what was said; a run that fails counts as one at least."""
    environment = {**os.environ, "ASAN_OPTIONS": "detect_leaks=1", "UBSAN_OPTIONS": "print_stacktrace=1"}
    # Addresses that are not spread: the sanitizers cannot place their shadows otherwise on every kernel.
    command = ["setarch", "--addr-no-randomize", str(program), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    said = done.stdout + done.stderr
    return max(len(_FINDING.findall(said)), int(done.returncode != 0)), said


def sanitizer_checks(calls: int, jobs: int = 2) -> Iterator[Check]:
    """Findings by sanitizer and program; each must be none."""
    for sanitizer in SANITIZERS:
        folder = build(sanitizer, jobs)
        runs: dict[str, tuple[str | Path, ...]] = {
            "C++ tests": (folder / "fmu_tests", "--gtest_brief=1"),
            f"{calls} random calls": (folder / "robotcell-fuzz", "calls", str(calls), "1", *_CELLS),
            "4 threads with instances": (folder / "robotcell-parallel", "4", "5", *_CELLS),
        }
        for what, (program, *arguments) in runs.items():
            count, said = findings(Path(program), *arguments)
            if count:
                print(said[-6000:])
            yield Check(f"{sanitizer.name}Sanitizer, {what}: findings", count, "", 0)


def main() -> int:
    """Run everything; 1 when something is found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=100_000, help="random calls of the FMI functions")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="compilers at once")
    parser.add_argument("--write", type=Path, help="file for the table of the results")
    options = parser.parse_args()
    checks = []
    for check in sanitizer_checks(options.calls, options.jobs):
        print(check, flush=True)
        checks.append(check)
    if options.write:
        write_table(checks, options.write, "# The FMU under sanitizers", "python -m bench.peers.sanitizers")
    return 0 if all(check.passed for check in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
