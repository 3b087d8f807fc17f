"""`PYTHONPATH=tests python -m bench.run_time`: wall time of whole commands, written to docs/run_time.md.

Every figure is the median of `--repeats` runs from command to prompt, or of one call in a process of its own; a warm-up
run fills the cache of the measurable surface, whose cost is stated apart. Processor seconds stand beside wall seconds,
because other work on the machine lengthens only the latter. Peak memory is that of the process.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scancell.config.loading import assets_dir

from .table import cpu_model, replace_paragraphs

PAGE = Path(__file__).resolve().parents[2] / "docs/run_time.md"
SCANCELL = [sys.executable, "-c", "from scancell.cli import main; main()"]
FREE_FORM = assets_dir() / "parts/free_form.stl"
# Prints a figure that the calling process takes over: JSON in the last line.
SECOND_SCAN = f"""
import json, time, scancell
with scancell.Scanner() as scanner:
    first = scanner.scan({str(FREE_FORM)!r}, engine="geometric")
    first.deviation, first.coverage
    start, processor = time.perf_counter(), time.process_time()
    second = scanner.scan({str(FREE_FORM)!r}, engine="geometric", seed=1)
    second.deviation, second.coverage
    print(json.dumps([time.perf_counter() - start, time.process_time() - processor]))
"""
TRIAL = f"""
import json, time
from scancell.config.loading import load_setup
from scancell.scanner import Scanner
setup = load_setup(settings=["scan.max_profiles=20"])
with Scanner(setup=setup, threads=1) as scanner:
    part = scanner.load_part({str(FREE_FORM)!r})
    times = []
    for seed in range(12):
        wall, start = time.perf_counter(), time.process_time()
        result = scanner.scan(part, engine="geometric", as_built={{"tool.x_mm": 0.01 * seed}}, seed=seed,
                              normals=False, samples=False)
        result.deviation.figures
        times.append((time.perf_counter() - wall, time.process_time() - start))
    print(json.dumps(sorted(times[2:])[5]))
"""


@dataclass(frozen=True)
class Task:
    """A command, with its limits in seconds: with AVX2 alone, and with AVX-512."""

    name: str
    command: Sequence[str]
    avx2: float
    avx512: float
    version_0_1_0: str
    inner: bool = False  # the command prints its own seconds


@dataclass(frozen=True)
class Measured:
    """Medians over the runs."""

    wall: float
    processor: float
    memory_mb: float


def tasks(folder: Path) -> list[Task]:
    """Everything that is measured; results go into `folder`."""
    dense = folder / "dense.stl"
    # In a process of its own: a child's peak memory counts from the size of its parent.
    writer = multiprocessing.Process(target=write_dense_mesh, args=(dense, 1_300_000))
    writer.start()
    writer.join()

    def scan(part: Path, *words: str) -> list[str]:
        return [*SCANCELL, "scan", str(part), "--out", str(folder / "run"), *words]

    python = [sys.executable, "-c"]
    return [
        Task("`scancell scan --engine geometric`", scan(FREE_FORM, "--engine", "geometric"), 6.0, 4.0, "16.8 / 11.5"),
        Task("`scancell scan`", scan(FREE_FORM), 58.0, 27.0, "68.8 / 36"),
        Task("`scancell --help`", [*SCANCELL, "--help"], 0.25, 0.25, "0.32"),
        Task("`import scancell`", [*python, "import scancell"], 0.4, 0.4, ""),
        Task("second geometric scan in a `Scanner`", [*python, SECOND_SCAN], 2.5, 2.5, "", True),
        Task(
            "1.3 M triangles, geometric, 100 profiles",
            scan(dense, "--engine", "geometric", "--set", "scan.max_profiles=100"),
            12.0,
            12.0,
            "72.6",
        ),
        Task("study trial, geometric, 20 profiles (processor)", [*python, TRIAL], 0.15, 0.15, "0.4", True),
    ]


def write_dense_mesh(path: Path, triangles: int) -> None:
    """A wavy round plate of about so many triangles, 80 mm wide, as binary STL in mm."""
    count = int(np.sqrt(triangles / 8))
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * count + 1)[:-1], np.linspace(0.5, 40, count))
    height = 20 + 3 * np.sin(radius / 4) * np.cos(3 * angle)
    top = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1)
    bottom = top * [1, 1, 0]
    quads = []
    for sheet, flip in ((top, False), (bottom, True)):
        a, b = sheet, np.roll(sheet, -1, axis=1)
        corners = [a[:-1], a[1:], b[1:], b[:-1]]
        quads.append(np.stack(corners[::-1] if flip else corners, 2).reshape(-1, 4, 3))
        centre = np.broadcast_to(sheet[0].mean(0), a[0].shape)
        fan = [centre, a[0], b[0], b[0]]
        quads.append(np.stack(fan if not flip else [centre, b[0], a[0], a[0]], 1))
    rim = [top[-1], bottom[-1], np.roll(bottom[-1], -1, axis=0), np.roll(top[-1], -1, axis=0)]
    quads.append(np.stack(rim, 1))
    corners = np.concatenate(quads)
    faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    area = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    faces = faces[area > 0]
    record = np.zeros(len(faces), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")]))
    record["corners"] = faces
    path.write_bytes(bytes(80) + np.uint32(len(record)).tobytes() + record.tobytes())


def run(task: Task, environment: dict[str, str]) -> Measured:
    """One run of a command."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        start = time.perf_counter()
        process = subprocess.Popen(task.command, env=environment, stdout=out, stderr=err)
        # Unlike RUSAGE_CHILDREN, the peak memory of this process alone.
        _, status, used = os.wait4(process.pid, 0)
        wall, process.returncode = time.perf_counter() - start, os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if process.returncode != 0:
            raise SystemExit(f"{task.name}: {err.read()}")
        processor = used.ru_utime + used.ru_stime
        if task.inner:
            wall, processor = json.loads(out.read().splitlines()[-1])
    return Measured(wall, processor, used.ru_maxrss / 1e3)


def measure(task: Task, repeats: int, environment: dict[str, str]) -> Measured:
    """Medians of `repeats` runs."""
    runs = [run(task, environment) for _ in range(repeats)]
    median: Callable[[str], float] = lambda name: statistics.median(getattr(one, name) for one in runs)  # noqa: E731
    return Measured(median("wall"), median("processor"), median("memory_mb"))


def write_page(file: Path, rows: Sequence[tuple[Task, Measured]], repeats: int, wide: bool) -> None:
    """Replace the figures of docs/run_time.md."""
    width = "AVX-512" if wide else "AVX2, no AVX-512"
    table = [
        "| command or call | seconds | processor s | peak MB | limit s | version 0.1.0 (AVX2 / AVX-512) |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for task, found in rows:
        limit = task.avx512 if wide else task.avx2
        table.append(
            f"| {task.name} | {found.wall:.2f} | {found.processor:.2f} | {found.memory_mb:.0f} | {limit:g} |"
            f" {task.version_0_1_0} |"
        )
    machine = f"Median of {repeats} runs on {cpu_model()} ({width}), load {os.getloadavg()[0]:.1f} at the end."
    replace_paragraphs(file, {"Median of": [machine], "| command or call |": table})


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m bench.run_time", description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", type=int, action="append", help="number of a row, from 0; may be repeated")
    parser.add_argument("--page", type=Path, default=PAGE)
    options = parser.parse_args()
    wide = "avx512f" in Path("/proc/cpuinfo").read_text()
    rows = []
    with tempfile.TemporaryDirectory(prefix="scancell-run-time-") as name:
        environment = {**os.environ, "SCANCELL_CACHE": str(Path(name) / "cache")}
        for number, task in enumerate(tasks(Path(name))):
            if options.only and number not in options.only:
                continue
            if "scan" in task.name:
                warm = run(task, environment)
                print(f"{task.name}: first run {warm.wall:.2f} s")
            rows.append((task, measure(task, options.repeats, environment)))
            found = rows[-1][1]
            print(f"{task.name}: {found.wall:.2f} s, processor {found.processor:.2f} s, {found.memory_mb:.0f} MB")
    write_page(options.page, rows, options.repeats, wide)


if __name__ == "__main__":
    main()
